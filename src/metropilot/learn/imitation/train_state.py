"""The policy that is taught: its network, the labels it imitates, and the steps by which it learns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy import ndarray

from metropilot._typing import Array, Float, Scalar
from metropilot.env import RegimeAction
from metropilot.learn.config import TeacherConfig
from metropilot.learn.networks import MLP
from metropilot.learn.optimiser import AdamState, adam_init, adam_step
from metropilot.policy import Params, PolicySpec, network_output

COASTS = 0.02
"""A command up to this size is still coasting, growing into the dead zone's edge."""
FULL_FROM, FULL_TO = 0.95, 0.99
NEAR = 0.1
"""Error at which the loss of the imitation turns from square to linear."""
STATISTICS = ("observation.mean", "observation.scale")
LEAST_DEVIATION = 1e-3


class TrainState(NamedTuple):
    """The policy as it stands, with the moments of its optimiser.

    Attributes:
        params: Of the policy, statistics of the observations included.
        adam: Moments of those that learn.
    """

    params: Params
    adam: AdamState


def imitation_spec(config: TeacherConfig, observation_size: int) -> PolicySpec:
    """Layout of the policy's parameters."""
    return PolicySpec(
        output="clip",
        observation_size=observation_size,
        hidden=config.hidden,
        activation=config.activation,
        actions=1,
        width=1,
        normalised=True,
    )


def new_train_state(config: TeacherConfig, seed: int, observations: Float[ndarray, "n o"]) -> TrainState:
    """A policy that has learned nothing but how observations scatter."""
    size = observations.shape[1]
    network = MLP((size, *config.hidden, 1), config.activation, config.initialiser)
    params = network.init("policy", jax.random.key(seed))
    adam = adam_init(params)
    mean = observations.mean(axis=0, dtype=np.float64)
    deviation = np.maximum(observations.std(axis=0, dtype=np.float64), LEAST_DEVIATION)
    statistics = (mean, 1.0 / deviation)
    known = {name: jnp.asarray(v, jnp.float32) for name, v in zip(STATISTICS, statistics, strict=True)}
    return TrainState(params | known, adam)


def hide_features(train_state: TrainState, hidden: Sequence[bool]) -> TrainState:
    """The policy without some numbers of its observation: they are zero, whatever they are."""
    shown = jnp.asarray(~np.asarray(hidden), jnp.float32)
    scale = {STATISTICS[1]: train_state.params[STATISTICS[1]] * shown}
    return train_state._replace(params=train_state.params | scale)


def reset_optimiser(train_state: TrainState) -> TrainState:
    """The policy without its optimiser's memory: another loss has gradients of another size.

    With the moments of the imitation, whose gradients are small, the first steps in closed loop would be many
    times too long.
    """
    moving = {name: value for name, value in train_state.params.items() if name not in STATISTICS}
    return TrainState(train_state.params, adam_init(moving))


def labels(action: RegimeAction, commands: Float[ndarray, " n"]) -> Float[ndarray, " n"]:
    """The actions that mean these commands, without a jump between the regimes. Shape (N,), float32."""
    size = np.abs(commands)
    rising = action.coast * np.minimum(size / COASTS, 1.0)
    last = (1.0 - action.full) * np.clip((size - FULL_FROM) / (FULL_TO - FULL_FROM), 0.0, 1.0)
    found = np.sign(commands) * (rising + (action.full - action.coast) * size + last)
    return found.astype(np.float32)


def imitation_loss(
    spec: PolicySpec,
    params: Params,
    observations: Float[Array, "batch features"],
    wanted: Float[Array, " batch"],
) -> Scalar:
    """Huber's loss of the actions."""
    given = jax.vmap(lambda x: network_output(spec, params, x, jnp)[0])(observations)
    off = jnp.abs(given - wanted)
    return jnp.mean(jnp.where(off < NEAR, off * off / (2.0 * NEAR), off - NEAR / 2.0))


def round_weights(params: Params) -> dict[str, ndarray]:
    """Parameters with the weights of the layers rounded to the upper half of single precision.

    Eight significant bits (bfloat16): a controller stores a weight in two bytes (decision 0020).
    """

    def round_value(value: Array) -> ndarray:
        return np.asarray(value.astype(jnp.bfloat16).astype(value.dtype) if value.ndim > 1 else value)

    return {name: round_value(jnp.asarray(value)) for name, value in params.items()}


def apply_gradient(
    train_state: TrainState, gradient: Params, rate: Scalar, max_norm: float | None
) -> TrainState:
    """One step against a gradient; the statistics stay, and so does everything if it is not finite."""
    moving = {name: value for name, value in train_state.params.items() if name not in STATISTICS}
    slope = {name: gradient[name] for name in moving}
    fine = jnp.all(jnp.stack([jnp.isfinite(value).all() for value in slope.values()]))
    moved, adam = adam_step(moving, slope, train_state.adam, rate, max_norm)
    after = TrainState(train_state.params | moved, adam)
    return jax.tree.map(lambda new, old: jnp.where(fine, new, old), after, train_state)

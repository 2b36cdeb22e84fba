"""Learned policies: networks as plain functions of a flat dict of arrays, and the meaning of their numbers.

Everything is written for one observation; batch with ``jax.vmap``. A layer ``policy.0`` is two entries,
``policy.0.weight`` of shape (inputs, outputs) and ``policy.0.bias`` of shape (outputs,), named alike in the
policy file and the ONNX graph. The functions take their array namespace, so that a driver in the cab runs
them in NumPy without importing JAX.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from itertools import pairwise
from types import ModuleType
from typing import Any, Literal

import numpy as np

from metropilot._typing import Array, Bool, Float, Index, Num

Params = dict[str, Float[Array, "..."]]
Activation = Literal["tanh", "relu", "silu"]
ACTIVATIONS: tuple[Activation, ...] = ("tanh", "relu", "silu")
Output = Literal["clip", "tanh", "argmax", "dueling", "table"]
OUTPUTS: tuple[Output, ...] = ("clip", "tanh", "argmax", "dueling", "table")
# Observations are normalised to at most this many deviations.
NORMALISED_RANGE = 10.0


def activate(name: str, x: Float[Array, "*shape"], xp: ModuleType) -> Float[Array, "*shape"]:
    """One of the three nonlinearities, elementwise.

    Args:
        name: Key of :data:`ACTIVATIONS`.
        x: Input.
        xp: ``numpy`` or ``jax.numpy``.
    """
    if name == "tanh":
        return xp.tanh(x)
    if name == "relu":
        return xp.maximum(x, 0.0)
    return x / (1.0 + xp.exp(-x))


def forward(
    params: Params, prefix: str, x: Float[Array, "*batch inputs"], activation: str, xp: ModuleType
) -> Float[Array, "*batch outputs"]:
    """Run the layers ``prefix.0``, ``prefix.1``, ... on one input; linear at the end.

    Args:
        params: Flat parameters.
        prefix: Prefix of the network's parameters.
        x: Input; batches in NumPy only.
        activation: Between the layers.
        xp: ``numpy`` or ``jax.numpy``.
    """
    k = 0
    while f"{prefix}.{k}.weight" in params:
        x = activate(activation, x, xp) if k else x
        x = x @ params[f"{prefix}.{k}.weight"] + params[f"{prefix}.{k}.bias"]
        k += 1
    return x


def dueling(
    value: Float[Array, "*batch 1"], advantage: Float[Array, "*batch choices"]
) -> Float[Array, "*batch choices"]:
    """Action values from state value and advantages, ``V + D - mean(D)`` (Lu23 eq. 10)."""
    return value + (advantage - advantage.mean(-1, keepdims=True))


@dataclass(frozen=True)
class PolicySpec:
    """Meaning of the parameters of a policy.

    Attributes:
        output: Treatment of the last layer: clipped to [-1, 1] (PPO), tanh (SAC, DDPG, NAF), the largest
            chosen (DQN, discrete PPO), the largest of state value and advantages (dueling DQN), or a table
            looked up.
        observation_size: Length of the observation.
        actions: Number of continuous actions, or of choices.
        hidden: Widths of the hidden layers; of a table: cells along each observation.
        activation: Between the layers.
        width: Outputs of the last layer (SAC's also has the deviations, which a driver leaves alone).
        normalised: True if observations are normalised first.
    """

    output: Output
    observation_size: int
    actions: int
    hidden: tuple[int, ...]
    activation: Activation
    width: int
    normalised: bool = False

    @property
    def discrete(self) -> bool:
        """True if the action is an integer choice."""
        return self.output in {"argmax", "dueling", "table"}

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every parameter."""
        if self.output == "table":
            size = self.observation_size
            return {
                "policy.table": (math.prod(self.hidden), self.actions),
                "policy.low": (size,),
                "policy.high": (size,),
            }
        shapes: dict[str, tuple[int, ...]] = {}
        sizes = (self.observation_size, *self.hidden)
        for k, (inputs, outputs) in enumerate(pairwise(sizes)):
            shapes |= _layer(f"policy.{k}", inputs, outputs)
        if self.output == "dueling":
            shapes |= _layer("policy.value.0", sizes[-1], 1) | _layer(
                "policy.advantage.0", sizes[-1], self.width
            )
        else:
            shapes |= _layer(f"policy.{len(self.hidden)}", sizes[-1], self.width)
        if self.normalised:
            shapes |= {"observation.mean": sizes[:1], "observation.scale": sizes[:1]}
        return shapes

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self) | {"hidden": list(self.hidden)}


def _layer(name: str, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
    """The two entries of a layer."""
    return {f"{name}.weight": (inputs, outputs), f"{name}.bias": (outputs,)}


def normalise(
    params: Params, observation: Float[Array, "*batch features"], xp: ModuleType
) -> Float[Array, "*batch features"]:
    """Subtract the mean, divide by the deviation, keep in range; without statistics, nothing."""
    if "observation.mean" not in params:
        return observation
    centred = (observation - params["observation.mean"]) * params["observation.scale"]
    # a third of the time of ``clip`` on the host
    return xp.minimum(xp.maximum(centred, -NORMALISED_RANGE), NORMALISED_RANGE)


def network_output(
    spec: PolicySpec, params: Params, observation: Float[Array, " features"], xp: ModuleType
) -> Float[Array, " width"]:
    """Output of the last layer, or the row of the table: action values, logits, means.

    Args:
        spec: Meaning of the parameters.
        params: Flat parameters.
        observation: As the task gives it.
        xp: ``numpy`` or ``jax.numpy``.
    """
    if spec.output == "table":
        return params["policy.table"][table_cell(spec, params, observation, xp)]
    x = normalise(params, observation, xp)
    if spec.output != "dueling":
        return forward(params, "policy", x, spec.activation, xp)
    features = forward(params, "policy", x, spec.activation, xp)
    features = activate(spec.activation, features, xp)
    value = forward(params, "policy.value", features, spec.activation, xp)
    return dueling(value, forward(params, "policy.advantage", features, spec.activation, xp))


def output_gradient(
    policy: Policy, observations: Float[np.ndarray, "batch features"], weights: Float[np.ndarray, " width"]
) -> Float[np.ndarray, "batch features"]:
    """Gradient of a weighted sum of a network's outputs by the observation, in NumPy.

    Args:
        policy: The policy; not a table, which has none.
        observations: Observations, one a row.
        weights: Weights of the outputs, those of :func:`network_output`.
    """
    spec, params = policy.spec, policy.params
    x = normalise(params, observations, np)
    inputs, k = [], 0
    while f"policy.{k}.weight" in params:
        x = activate(spec.activation, x, np) if k else x
        x = x @ params[f"policy.{k}.weight"] + params[f"policy.{k}.bias"]
        inputs.append(x)
        k += 1
    if spec.output == "dueling":
        value, advantage = (params[f"policy.{part}.0.weight"] for part in ("value", "advantage"))
        back = weights.sum() * value[:, 0] + advantage @ (weights - weights.mean())
        back = back * _activation_slope(spec.activation, inputs[-1])
    else:
        back = np.broadcast_to(weights, inputs[-1].shape)
    for layer in reversed(range(k)):
        back = back @ params[f"policy.{layer}.weight"].T
        if layer:
            back = back * _activation_slope(spec.activation, inputs[layer - 1])
    if "observation.mean" not in params:
        return back
    centred = (observations - params["observation.mean"]) * params["observation.scale"]
    return np.where(np.abs(centred) < NORMALISED_RANGE, back * params["observation.scale"], 0.0)


def _activation_slope(name: str, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """Slope of one of the nonlinearities."""
    if name == "tanh":
        return 1.0 - np.tanh(x) ** 2
    if name == "relu":
        return (x > 0.0).astype(x.dtype)
    share = 1.0 / (1.0 + np.exp(-x))
    return share * (1.0 + x * (1.0 - share))


def table_cell(
    spec: PolicySpec, params: Params, observation: Float[Array, " features"], xp: ModuleType
) -> Index:
    """Row of the table that an observation falls in."""
    bins = np.asarray(spec.hidden, np.float32)
    strides = np.asarray([math.prod(spec.hidden[k + 1 :]) for k in range(len(spec.hidden))], np.int32)
    share = (observation - params["policy.low"]) / (params["policy.high"] - params["policy.low"])
    along = xp.clip(xp.floor(share * bins), 0.0, bins - 1.0).astype(np.int32)
    return (along * strides).sum()


def act(
    spec: PolicySpec,
    params: Params,
    observation: Float[Array, " features"],
    mask: Bool[Array, " choices"] | None = None,
    xp: Any = None,  # noqa: ANN401 (a module)
) -> Num[Array, "*actions"]:
    """The action of a policy that no longer explores.

    Args:
        spec: Meaning of the parameters.
        params: Flat parameters.
        observation: As the task gives it.
        mask: Choices allowed; None: all.
        xp: ``numpy``, or ``jax.numpy`` (the default).
    """
    if xp is None:
        import jax.numpy as xp
    return choose_action(spec, network_output(spec, params, observation, xp), mask, xp)


def choose_action(
    spec: PolicySpec, output: Float[Array, " width"], mask: Bool[Array, " choices"] | None, xp: ModuleType
) -> Num[Array, "*actions"]:
    """The action that an output of the network stands for; see :func:`act`."""
    if spec.discrete:
        if mask is not None:
            # A mask that allows nothing allows all. Finite, so that NaN cannot arise.
            output = xp.where(mask | ~mask.any(), output, -1e9)
        return xp.argmax(output)
    output = output[: spec.actions]
    return xp.tanh(output) if spec.output == "tanh" else xp.minimum(xp.maximum(output, -1.0), 1.0)


@dataclass(frozen=True)
class Policy:
    """Parameters with what they mean; a pytree, so that many seeds' policies are one with a leading axis.

    Attributes:
        spec: Meaning of the parameters.
        params: Flat parameters, exactly those of ``spec.shapes()``.
    """

    spec: PolicySpec
    params: Params

    def __call__(
        self, observation: Float[Array, " features"], mask: Bool[Array, " choices"] | None = None
    ) -> Num[Array, "*actions"]:
        """The action in NumPy, for one observation."""
        return act(self.spec, self.params, observation, mask, np)


def in_precision(params: Params, number: type) -> Params:
    """Parameters of a policy in a number type, in which the network then computes.

    A sum of products in single precision depends on its order, which each library and compiler chooses; in
    double precision that is lost in the rounding of the observation, and C gives what Python gives.
    """
    return {name: np.asarray(value, number) for name, value in params.items()}


def only_policy(spec: PolicySpec, params: Params) -> Params:
    """The parameters that a policy consists of, without critics, targets and deviations."""
    return {name: params[name] for name in spec.shapes()}

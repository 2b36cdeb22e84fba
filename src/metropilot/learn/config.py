"""Configuration of learning: one frozen dataclass a learner.

The CLI, the docs and the run record are derived from them; :mod:`metropilot.learn.config` reads them.
"""

from __future__ import annotations

import math
from abc import ABC
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from typing import Any, ClassVar, Literal, get_args, get_origin, get_type_hints

from metropilot._registry import did_you_mean
from metropilot._schema import FieldSpec, Range, declare, field_specs
from metropilot.errors import InputError
from metropilot.learn.networks import Initialiser
from metropilot.learn.schedules import Schedule, Scheduled, highest, read_schedule
from metropilot.policy import Activation

Keep = Literal["best", "last"]


@dataclass(frozen=True)
class AbstractConfig(ABC):
    """Configuration that every learner shares.

    Attributes:
        steps: Environment steps in all, over all environments.
        environments: Number of environments side by side.
        evaluations: Learning is cut into this many chunks; after each the policy is evaluated and may be
            saved.
        evaluation_episodes: Episodes of one evaluation, always the same ones.
        evaluation_steps: Steps at which an evaluation episode is cut off.
        keep: ``best``: the policy with the highest evaluation score, the earlier one of equals; ``last``: the
            last.
        gamma: Discount; 1 is fine for episodes that end.
        reward_factor: Every reward is multiplied by it.
        reward_scaling: Divide rewards by the running deviation of the discounted return (Chen23a eq. 23).
        normalise_observations: Subtract the running mean and divide by the running deviation.
        hidden: Widths of the hidden layers.
        activation: Between the layers.
        initialiser: Initialiser of the weights.
        max_gradient_norm: Longer gradients are shortened to this.
    """

    algorithm: ClassVar[str]

    steps: int = declare(100_000, low=1)
    environments: int = declare(8, low=1)
    evaluations: int = declare(20, low=1)
    evaluation_episodes: int = declare(16, low=1)
    evaluation_steps: int = declare(1_000, low=1)
    keep: Keep = declare("best", choices=get_args(Keep))
    gamma: float = declare(0.99, low=0.0, high=1.0)
    reward_factor: float = 1.0
    reward_scaling: bool = False
    normalise_observations: bool = False
    hidden: tuple[int, ...] = declare((64, 64), low=1)
    activation: Activation = declare("tanh", choices=get_args(Activation))
    initialiser: Initialiser = declare("orthogonal", choices=get_args(Initialiser))
    max_gradient_norm: float | None = None

    def __post_init__(self) -> None:
        """Refuse numbers outside their range."""
        # a subclass that gives a field another default keeps the range that its base declares
        for kind in type(self).__mro__:
            for name, spec in field_specs(kind).items() if is_dataclass(kind) else ():
                self.check(name, spec)

    def check(self, name: str, spec: FieldSpec) -> None:
        """Check a field, the ends of a schedule, or each item of a tuple."""
        value = getattr(self, name)
        if not isinstance(value, Schedule):
            for item in value if isinstance(value, tuple) else (value,):
                spec.check(name, item)
        elif spec.range and not (spec.range.admit(value.start) and spec.range.admit(value.end)):
            words = f"schedule out of range, {value.start:g} to {value.end:g}"
            raise InputError(words, field=name, allowed=spec.describe_allowed())


@dataclass(frozen=True)
class AbstractReplayConfig(AbstractConfig):
    """Configuration that learners with a replay memory share besides.

    Attributes:
        collect: Steps of each environment between updates.
        updates: Gradient steps after each.
        buffer_size: Transitions kept.
        batch_size: Transitions of one gradient step.
        warmup: Environment steps with random actions before the first.
        n_step: Rewards summed before the value of a later state stands for the rest.
        tau: Share by which the target network follows at every gradient step.
    """

    environments: int = 1
    collect: int = declare(1, low=1)
    updates: int = declare(1, low=1)
    buffer_size: int = declare(100_000, low=1)
    batch_size: int = declare(64, low=1)
    warmup: int = declare(1_000, low=1)
    n_step: int = declare(1, low=1)
    tau: float = declare(0.005, low=0.0, high=1.0, above=True)

    def __post_init__(self) -> None:
        """Refuse numbers outside their range, and a buffer that is not filled evenly."""
        super().__post_init__()
        if self.buffer_size % self.environments:
            allowed = f"a multiple of environments = {self.environments}"
            raise InputError(
                "does not fill evenly", field="buffer_size", value=self.buffer_size, allowed=allowed
            )
        if self.n_step > 1 and self.warmup < self.n_step * self.environments:
            allowed = f"at least n_step x environments = {self.n_step * self.environments}"
            raise InputError("too short", field="warmup", value=self.warmup, allowed=allowed)


BETA_ANNEALING = Schedule(0.4, 1.0)
EPSILON_DECAY = Schedule(1.0, 0.05, over=0.3)
COSINE_LR = Schedule(3e-4, 1.5e-5, shape="cosine")
MAX_PRIORITISED = 1 << 20
"""Priorities are summed in single precision."""


@dataclass(frozen=True)
class PPOConfig(AbstractConfig):
    """Proximal policy optimisation; its defaults are those recommended for Chen23a, over more environments.

    Attributes:
        rollout: Steps of each environment between updates.
        epochs: Passes over each rollout.
        minibatches: Into how many each epoch is cut.
        learning_rate: Of Adam.
        lambda_: Of the generalised advantage (0.995 with gamma 1 suits sparse terminal rewards).
        clip: Epsilon of the clipped ratio.
        entropy: Weight of the entropy bonus.
        value_weight: Weight of the critic's loss.
        normalise_advantages: Over each minibatch; without it the scale of the rewards reaches the actor.
        initial_std: Deviation of the actions at first.
        min_std: Deviation never falls below (the entropy floor); let it fall only once the policy is good: a
            narrow policy learns slowly, a wide one drives differently from the one without exploration.
        initial_bias: Action at first: 0.5 sets a trainset moving before anything is learned.
    """

    algorithm: ClassVar[str] = "ppo"

    environments: int = 64
    max_gradient_norm: float | None = 0.5
    rollout: int = declare(128, low=1)
    epochs: int = declare(10, low=1)
    minibatches: int = declare(16, low=1)
    learning_rate: Scheduled = declare(3e-4, low=0.0)
    lambda_: float = declare(0.95, low=0.0, high=1.0)
    clip: Scheduled = declare(0.2, low=0.0, high=1.0, above=True)
    entropy: Scheduled = 0.0
    value_weight: float = 0.5
    normalise_advantages: bool = True
    initial_std: float = 0.6
    min_std: Scheduled = declare(0.01, low=0.0)
    initial_bias: float = 0.0

    def __post_init__(self) -> None:
        """Refuse numbers outside their range, and minibatches that do not divide a rollout."""
        super().__post_init__()
        self.check("initial_std", FieldSpec(range=Range(highest(self.min_std), above=True)))
        if self.rollout * self.environments % self.minibatches:
            allowed = f"a divisor of environments x rollout = {self.rollout * self.environments}"
            raise InputError(
                "minibatches are unequal", field="minibatches", value=self.minibatches, allowed=allowed
            )


@dataclass(frozen=True)
class DQNConfig(AbstractReplayConfig):
    """Deep Q-learning; ``double``, ``dueling`` and ``prioritised`` together are Lu23's improved DQN.

    Attributes:
        learning_rate: Of Adam.
        double: The online network chooses the next action, the target network judges it (Lu23 eq. 8).
        dueling: State value and advantages apart (Lu23 eq. 10).
        prioritised: Replay by temporal-difference error (Lu23 eqs. 11 and 12).
        priority_exponent: alpha; Lu23 uses 1.
        priority_floor: l of Lu23 eq. 12.
        importance: beta.
        mask_targets: The next action of the target, too, is one the task allows.
        epsilon: Share of random actions.
        target_period: Copy the target every so many gradient steps; 0: follow by ``tau`` at each.
        huber: Error at which the loss turns from square to linear; None: square everywhere.
    """

    algorithm: ClassVar[str] = "dqn"

    activation: Activation = "relu"
    initialiser: Initialiser = "he"
    max_gradient_norm: float | None = 10.0
    learning_rate: Scheduled = declare(5e-4, low=0.0)
    double: bool = False
    dueling: bool = False
    prioritised: bool = False
    priority_exponent: float = declare(0.6, low=0.0)
    priority_floor: float = declare(1e-3, low=0.0, above=True)
    importance: Scheduled = declare(BETA_ANNEALING, low=0.0, high=1.0)
    mask_targets: bool = True
    epsilon: Scheduled = declare(EPSILON_DECAY, low=0.0, high=1.0)
    target_period: int = declare(200, low=0)
    huber: float | None = declare(1.0, low=0.0, above=True)

    def __post_init__(self) -> None:
        """Refuse numbers outside their range."""
        super().__post_init__()
        if self.prioritised:
            self.check("buffer_size", FieldSpec(range=Range(1, MAX_PRIORITISED)))


@dataclass(frozen=True)
class DDPGConfig(AbstractReplayConfig):
    """Deep deterministic policy gradient; ``twin``, ``smoothing`` and ``delay`` make it TD3.

    Attributes:
        actor_rate: Adam's learning rate of the actor.
        critic_rate: And of the critic.
        noise: Deviation of the exploration noise.
        noise_kind: White Gaussian noise, or an Ornstein-Uhlenbeck process.
        noise_pull: theta of the Ornstein-Uhlenbeck process, per step.
        initial_bias: Action at first, before tanh.
        saturation_cost: Price of the squared size, before tanh, of what the actor asks for: at the ends of
            its range tanh lets no gradient pass, and an actor that went there does not come back.
        twin: Two critics, of which the lower one makes the target (Fujimoto et al. 2018).
        smoothing: Deviation of the noise on the target's action; it is cut at 2.5 times as much.
        delay: Steps of the critics for one of the actor and the targets.
    """

    algorithm: ClassVar[str] = "ddpg"

    activation: Activation = "relu"
    initialiser: Initialiser = "uniform"
    actor_rate: Scheduled = declare(1e-3, low=0.0)
    critic_rate: Scheduled = declare(1e-3, low=0.0)
    noise: Scheduled = declare(0.2, low=0.0)
    noise_kind: Literal["gaussian", "ornstein_uhlenbeck"] = declare(
        "gaussian", choices=("gaussian", "ornstein_uhlenbeck")
    )
    noise_pull: float = declare(0.15, low=0.0, high=1.0)
    initial_bias: float = 0.0
    saturation_cost: float = declare(0.0, low=0.0)
    twin: bool = False
    smoothing: float = declare(0.0, low=0.0)
    delay: int = declare(1, low=1)


@dataclass(frozen=True)
class SACConfig(AbstractReplayConfig):
    """Soft actor-critic with twin critics.

    Attributes:
        actor_rate: Adam's learning rate of the actor.
        critic_rate: And of both critics.
        temperature_rate: And of the temperature; 0 keeps it.
        initial_temperature: alpha at first.
        target_entropy: Per action; the usual choice is -1.
        initial_bias: Action at first, before tanh.
    """

    algorithm: ClassVar[str] = "sac"

    activation: Activation = "relu"
    initialiser: Initialiser = "he"
    batch_size: int = 256
    actor_rate: Scheduled = declare(3e-4, low=0.0)
    critic_rate: Scheduled = declare(1e-3, low=0.0)
    temperature_rate: Scheduled = declare(3e-4, low=0.0)
    initial_temperature: float = declare(0.2, low=0.0, above=True)
    target_entropy: float = -1.0
    initial_bias: float = 0.0


@dataclass(frozen=True)
class NAFConfig(AbstractReplayConfig):
    """Normalised advantage functions: Q-learning with continuous actions (the STON baseline of Huang25).

    Attributes:
        learning_rate: Of Adam.
        noise: Deviation of the exploration noise.
        initial_bias: Action at first, before tanh.
    """

    algorithm: ClassVar[str] = "naf"

    learning_rate: Scheduled = declare(1e-3, low=0.0)
    noise: Scheduled = declare(0.3, low=0.0)
    initial_bias: float = 0.0


@dataclass(frozen=True)
class TabularConfig(AbstractConfig):
    """Tabular Q-learning over a grid of observations (the ITOR baseline of Huang25).

    Attributes:
        bins: Cells along each observation; one number stands for all.
        low: Lower end of the grid along each observation; outside, the outermost cell counts.
        high: Its upper end.
        initial_value: Every entry at first; a high one makes the learner curious.
        learning_rate: Share of the error that an entry takes in.
        epsilon: Share of random actions.
        rollout: Steps of each environment in one iteration.
    """

    algorithm: ClassVar[str] = "tabular"

    bins: tuple[int, ...] = declare((10,), low=1)
    low: tuple[float, ...] = (-1.0,)
    high: tuple[float, ...] = (1.0,)
    initial_value: float = 0.0
    learning_rate: Scheduled = declare(0.1, low=0.0, high=1.0)
    epsilon: Scheduled = declare(0.1, low=0.0, high=1.0)
    rollout: int = declare(32, low=1)

    def __post_init__(self) -> None:
        """Refuse numbers outside their range."""
        super().__post_init__()
        if self.normalise_observations or self.reward_scaling:
            name = "normalise_observations" if self.normalise_observations else "reward_scaling"
            raise InputError("a table does not need it", field=name, value=True, allowed="false")
        if not all(a < b for a, b in zip(self.low, self.high, strict=False)):
            raise InputError(
                "empty grid", field="bins, low, high", value=f"{self.bins} {self.low} {self.high}"
            )


@dataclass(frozen=True)
class TeacherConfig(AbstractConfig):
    """Learning from the optimal plan: first by imitation, then in closed loop with the gradient of the bill.

    ``steps`` counts the decisions driven in closed loop.

    Attributes:
        worlds: Random worlds that lessons and drives are drawn from.
        wide_share: Share of them with trainsets as different as real ones, on sections of 0.2 to 20 km.
        plans: Optimal plans of each, all but one from a state beside the first.
        states: States along each plan.
        batches: Gradient steps of the imitation.
        batch_size: States of each.
        imitation_rate: Of Adam, falling to nothing over the imitation.
        learning_rate: Of Adam, in closed loop.
        decisions: Driven in one closed-loop gradient step: many short drives or a few long ones.
        imitation_weight: Of the imitation's loss in closed loop.
        late_per_s: Price of a second off time beyond what it costs anyway, as a share of the energy.
        unseen: Features that the policy does not see, for an ablation.
    """

    algorithm: ClassVar[str] = "teacher"

    keep: Keep = "last"
    steps: int = 48_000_000
    evaluations: int = 6
    hidden: tuple[int, ...] = (128, 128, 128)
    activation: Activation = "silu"
    normalise_observations: bool = True
    gamma: float = 1.0
    max_gradient_norm: float | None = 0.5
    worlds: int = declare(3_000, low=1)
    wide_share: float = declare(0.25, low=0.0, high=1.0)
    plans: int = declare(7, low=1)
    states: int = declare(60, low=1)
    batches: int = declare(20_000, low=1)
    batch_size: int = declare(1_024, low=1)
    imitation_rate: float = declare(1.5e-3, low=0.0)
    learning_rate: Scheduled = declare(COSINE_LR, low=0.0, high=1.0)
    decisions: int = declare(38_400, low=9_600)
    imitation_weight: float = declare(0.3, low=0.0)
    late_per_s: float = declare(0.04, low=0.0)
    unseen: tuple[str, ...] = ()


CONFIGS: dict[str, type[AbstractConfig]] = {
    kind.algorithm: kind
    for kind in (DDPGConfig, DQNConfig, NAFConfig, PPOConfig, SACConfig, TabularConfig, TeacherConfig)
}


LARGEST = 10**18


def config_from_mapping(algorithm: str, values: Mapping[str, Any], *, file: object = None) -> AbstractConfig:
    """A learner's configuration from plain values, as they stand in TOML or JSON.

    Args:
        algorithm: ``ddpg dqn naf ppo sac tabular``.
        values: Fields by name; whatever is missing keeps its default.
        file: Named in error messages.

    Raises:
        InputError: An algorithm or key that does not exist (the nearest is named), a wrong type or range.
    """
    if algorithm not in CONFIGS:
        known = ", ".join(sorted(CONFIGS))
        raise InputError("unknown algorithm", file=file, field="algorithm", value=algorithm, allowed=known)
    try:
        return change_config(CONFIGS[algorithm](), values)
    except InputError as error:
        raise error.at(file=file) from None


def change_config(config: AbstractConfig, values: Mapping[str, Any]) -> AbstractConfig:
    """A configuration with some of its fields set from plain values.

    Raises:
        InputError: A key that does not exist (the nearest is named), a wrong type or range.
    """
    every = get_type_hints(type(config))
    hints = {field.name: every[field.name] for field in fields(config)}
    return replace(config, **{key: _read(key, value, hints) for key, value in values.items()})


def config_to_mapping(config: AbstractConfig) -> dict[str, Any]:
    """Every field as a plain value, None left out; :func:`config_from_mapping` reads it back."""
    plain = {key: value for key, value in asdict(config).items() if value is not None}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in plain.items()}


def _read(key: str, value: Any, hints: Mapping[str, Any]) -> Any:
    """One value as the type of its field."""
    if key not in hints:
        raise InputError(f"unknown key{did_you_mean(key, hints)}", field=str(key), allowed=", ".join(hints))
    if not _countable(value):
        raise InputError("out of range", field=key, allowed=f"whole numbers below {LARGEST:.0e}")
    return _convert(key, value, hints[key])


def _countable(value: Any) -> bool:
    """Tell if every whole number in a value has a float; larger ones than that no learner counts to."""
    todo = [value]
    while todo:
        found = todo.pop()
        if isinstance(found, Mapping | list | tuple):
            todo += found.values() if isinstance(found, Mapping) else found
        elif isinstance(found, int) and abs(found) > LARGEST:
            return False
    return True


def _convert(key: str, value: Any, hint: Any) -> Any:
    """A value if it is of the type, lists as tuples and whole numbers as floats where such are wanted."""
    if hint == Scheduled:
        return read_schedule(key, value)
    if get_origin(hint) is tuple:
        items = value if isinstance(value, list | tuple) else [value]
        try:
            return tuple(_convert(key, item, get_args(hint)[0]) for item in items)
        except InputError as error:
            allowed = f"{error.allowed}, or a list of such"
            raise InputError(error.message, field=key, value=error.value, allowed=allowed) from None
    if get_origin(hint) is Literal:
        kind, fits = "one of " + ", ".join(get_args(hint)), value in get_args(hint)
    elif hint is bool:
        kind, fits = "true or false", isinstance(value, bool)
    elif hint is str:
        kind, fits = "words", isinstance(value, str)
    elif hint is int:
        kind, fits = "a whole number", isinstance(value, int) and not isinstance(value, bool)
    else:
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
        optional = hint == float | None
        kind, fits = "a number" + (" or nothing" if optional else ""), optional and value is None
    if not fits:
        raise InputError("wrong type or choice", field=key, value=repr(value), allowed=kind)
    return value

"""Configuration of learning: one frozen dataclass a learner.

The CLI, the docs and the run record are derived from them; :mod:`metropilot.learn.config_reading` reads them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

from metropilot.errors import InputError
from metropilot.learn.config_base import AbstractConfig, AbstractReplayConfig, Keep
from metropilot.learn.networks import Initialiser
from metropilot.learn.schedules import Schedule, Scheduled, highest
from metropilot.policy import Activation

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
    rollout: int = 128
    epochs: int = 10
    minibatches: int = 16
    learning_rate: Scheduled = 3e-4
    lambda_: float = 0.95
    clip: Scheduled = 0.2
    entropy: Scheduled = 0.0
    value_weight: float = 0.5
    normalise_advantages: bool = True
    initial_std: float = 0.6
    min_std: Scheduled = 0.01
    initial_bias: float = 0.0

    def __post_init__(self) -> None:
        """Refuse numbers outside their range, and minibatches that do not divide a rollout."""
        super().__post_init__()
        for name in ("rollout", "epochs", "minibatches"):
            self.within(name, 1, math.inf)
        self.within("lambda_", 0.0, 1.0)
        self.within("learning_rate", 0.0, math.inf)
        self.within("clip", 0.0, 1.0, open_low=True)
        self.within("min_std", 0.0, math.inf)
        self.within("initial_std", highest(self.min_std), math.inf, open_low=True)
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
    learning_rate: Scheduled = 5e-4
    double: bool = False
    dueling: bool = False
    prioritised: bool = False
    priority_exponent: float = 0.6
    priority_floor: float = 1e-3
    importance: Scheduled = BETA_ANNEALING
    mask_targets: bool = True
    epsilon: Scheduled = EPSILON_DECAY
    target_period: int = 200
    huber: float | None = 1.0

    def __post_init__(self) -> None:
        """Refuse numbers outside their range."""
        super().__post_init__()
        self.within("learning_rate", 0.0, math.inf)
        self.within("epsilon", 0.0, 1.0)
        self.within("importance", 0.0, 1.0)
        self.within("priority_exponent", 0.0, math.inf)
        self.within("priority_floor", 0.0, math.inf, open_low=True)
        self.within("target_period", 0, math.inf)
        self.within("huber", 0.0, math.inf, open_low=True)
        if self.prioritised:
            self.within("buffer_size", 1, MAX_PRIORITISED)


@dataclass(frozen=True)
class DDPGConfig(AbstractReplayConfig):
    """Deep deterministic policy gradient.

    Attributes:
        actor_rate: Adam's learning rate of the actor.
        critic_rate: And of the critic.
        noise: Deviation of the exploration noise.
        noise_kind: White Gaussian noise, or an Ornstein-Uhlenbeck process.
        noise_pull: theta of the Ornstein-Uhlenbeck process, per step.
        initial_bias: Action at first, before tanh.
        saturation_cost: Price of the squared size, before tanh, of what the actor asks for: at the ends of
            its range tanh lets no gradient pass, and an actor that went there does not come back.
    """

    algorithm: ClassVar[str] = "ddpg"

    activation: Activation = "relu"
    initialiser: Initialiser = "uniform"
    actor_rate: Scheduled = 1e-3
    critic_rate: Scheduled = 1e-3
    noise: Scheduled = 0.2
    noise_kind: Literal["gaussian", "ornstein_uhlenbeck"] = "gaussian"
    noise_pull: float = 0.15
    initial_bias: float = 0.0
    saturation_cost: float = 0.0

    def __post_init__(self) -> None:
        """Refuse numbers outside their range."""
        super().__post_init__()
        for name in ("actor_rate", "critic_rate", "noise", "saturation_cost"):
            self.within(name, 0.0, math.inf)
        self.within("noise_pull", 0.0, 1.0)
        self.one_of("noise_kind", ("gaussian", "ornstein_uhlenbeck"))


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
    actor_rate: Scheduled = 3e-4
    critic_rate: Scheduled = 1e-3
    temperature_rate: Scheduled = 3e-4
    initial_temperature: float = 0.2
    target_entropy: float = -1.0
    initial_bias: float = 0.0

    def __post_init__(self) -> None:
        """Refuse numbers outside their range."""
        super().__post_init__()
        for name in ("actor_rate", "critic_rate", "temperature_rate"):
            self.within(name, 0.0, math.inf)
        self.within("initial_temperature", 0.0, math.inf, open_low=True)


@dataclass(frozen=True)
class NAFConfig(AbstractReplayConfig):
    """Normalised advantage functions: Q-learning with continuous actions (the STON baseline of Huang25).

    Attributes:
        learning_rate: Of Adam.
        noise: Deviation of the exploration noise.
        initial_bias: Action at first, before tanh.
    """

    algorithm: ClassVar[str] = "naf"

    learning_rate: Scheduled = 1e-3
    noise: Scheduled = 0.3
    initial_bias: float = 0.0

    def __post_init__(self) -> None:
        """Refuse numbers outside their range."""
        super().__post_init__()
        for name in ("learning_rate", "noise"):
            self.within(name, 0.0, math.inf)


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

    bins: tuple[int, ...] = (10,)
    low: tuple[float, ...] = (-1.0,)
    high: tuple[float, ...] = (1.0,)
    initial_value: float = 0.0
    learning_rate: Scheduled = 0.1
    epsilon: Scheduled = 0.1
    rollout: int = 32

    def __post_init__(self) -> None:
        """Refuse numbers outside their range."""
        super().__post_init__()
        self.within("learning_rate", 0.0, 1.0)
        self.within("epsilon", 0.0, 1.0)
        self.within("rollout", 1, math.inf)
        if self.normalise_observations or self.reward_scaling:
            name = "normalise_observations" if self.normalise_observations else "reward_scaling"
            raise InputError("a table does not need it", field=name, value=True, allowed="false")
        if min(self.bins) < 1 or not all(a < b for a, b in zip(self.low, self.high, strict=False)):
            raise InputError(
                "empty grid", field="bins, low, high", value=f"{self.bins} {self.low} {self.high}"
            )


@dataclass(frozen=True)
class TeacherConfig(AbstractConfig):
    """Learning from the optimal plan: first by imitation, then in closed loop with the gradient of the bill.

    ``steps`` counts the decisions driven in closed loop.

    Attributes:
        worlds: Random worlds that lessons and drives are drawn from.
        plans: Optimal plans of each, all but one from a state beside the first.
        states: States along each plan.
        batches: Gradient steps of the imitation.
        batch_size: States of each.
        imitation_rate: Of Adam, falling to nothing over the imitation.
        learning_rate: Of Adam, in closed loop.
        decisions: Driven in one closed-loop gradient step: many short drives or a few long ones.
        imitation_weight: Of the imitation's loss in closed loop.
        late_per_s: Price of a second off time beyond what it costs anyway, as a share of the energy.
    """

    algorithm: ClassVar[str] = "teacher"

    keep: Keep = "last"
    steps: int = 30_000_000
    evaluations: int = 6
    hidden: tuple[int, ...] = (128, 128, 128)
    activation: Activation = "silu"
    normalise_observations: bool = True
    gamma: float = 1.0
    max_gradient_norm: float | None = 0.5
    worlds: int = 2_000
    plans: int = 7
    states: int = 60
    batches: int = 12_000
    batch_size: int = 1_024
    imitation_rate: float = 1.5e-3
    learning_rate: Scheduled = COSINE_LR
    decisions: int = 38_400
    imitation_weight: float = 0.3
    late_per_s: float = 0.04

    def __post_init__(self) -> None:
        """Refuse numbers outside their range."""
        super().__post_init__()
        for name in ("worlds", "plans", "states", "batches", "batch_size"):
            self.within(name, 1, math.inf)
        self.within("decisions", 9_600, math.inf)
        self.within("learning_rate", 0.0, 1.0)
        for name in ("imitation_rate", "imitation_weight", "late_per_s"):
            self.within(name, 0.0, math.inf)


CONFIGS: dict[str, type[AbstractConfig]] = {
    kind.algorithm: kind
    for kind in (DDPGConfig, DQNConfig, NAFConfig, PPOConfig, SACConfig, TabularConfig, TeacherConfig)
}

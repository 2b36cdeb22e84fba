"""Configuration that every learner shares, and that of learners with a replay memory."""

from __future__ import annotations

import math
from abc import ABC
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

from metropilot.errors import InputError
from metropilot.learn.networks import Initialiser
from metropilot.learn.schedules import Schedule, highest, lowest
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

    steps: int = 100_000
    environments: int = 8
    evaluations: int = 20
    evaluation_episodes: int = 16
    evaluation_steps: int = 1_000
    keep: Keep = "best"
    gamma: float = 0.99
    reward_factor: float = 1.0
    reward_scaling: bool = False
    normalise_observations: bool = False
    hidden: tuple[int, ...] = (64, 64)
    activation: Activation = "tanh"
    initialiser: Initialiser = "orthogonal"
    max_gradient_norm: float | None = None

    def __post_init__(self) -> None:
        """Refuse numbers outside their range."""
        for name in ("steps", "environments", "evaluations", "evaluation_episodes", "evaluation_steps"):
            self.within(name, 1, math.inf)
        self.within("gamma", 0.0, 1.0)
        for name, choices in (("keep", Keep), ("activation", Activation), ("initialiser", Initialiser)):
            self.one_of(name, get_args(choices))
        for width in self.hidden:
            if width < 1:
                raise InputError("width out of range", field="hidden", value=width, allowed="at least 1")

    def within(self, name: str, low: int | float, high: int | float, *, open_low: bool = False) -> None:
        """Raise InputError unless a field lies in [low, high]; ``open_low``: above low."""
        value = getattr(self, name)
        if value is None:
            return
        below = lowest(value) <= low if open_low else lowest(value) < low
        if below or highest(value) > high or math.isnan(lowest(value)):
            scheduled = isinstance(value, Schedule)
            words = (
                f"schedule out of range, {value.start:g} to {value.end:g}" if scheduled else "out of range"
            )
            least = "above" if open_low else "at least"
            allowed = f"{least} {low:.12g}" + ("" if high == math.inf else f", at most {high:.12g}")
            raise InputError(words, field=name, value=None if scheduled else value, allowed=allowed)

    def one_of(self, name: str, choices: tuple[str, ...]) -> None:
        """Raise InputError unless a field is one of the choices."""
        if getattr(self, name) not in choices:
            raise InputError(
                "unknown choice", field=name, value=getattr(self, name), allowed=", ".join(choices)
            )


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
    collect: int = 1
    updates: int = 1
    buffer_size: int = 100_000
    batch_size: int = 64
    warmup: int = 1_000
    n_step: int = 1
    tau: float = 0.005

    def __post_init__(self) -> None:
        """Refuse numbers outside their range, and a buffer that is not filled evenly."""
        super().__post_init__()
        for name in ("collect", "updates", "buffer_size", "batch_size", "warmup", "n_step"):
            self.within(name, 1, math.inf)
        self.within("tau", 0.0, 1.0, open_low=True)
        if self.buffer_size % self.environments:
            allowed = f"a multiple of environments = {self.environments}"
            raise InputError(
                "does not fill evenly", field="buffer_size", value=self.buffer_size, allowed=allowed
            )
        if self.n_step > 1 and self.warmup < self.n_step * self.environments:
            allowed = f"at least n_step x environments = {self.n_step * self.environments}"
            raise InputError("too short", field="warmup", value=self.warmup, allowed=allowed)

"""Drivers that learned inside the expert: the policy changes the rate, all else is the expert's."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np

from metropilot.drivers.expert.driving import ExpertMemory, RateInputs, decide, prepare_expert
from metropilot.drivers.expert.hoa import SETTLED, Hoa
from metropilot.drivers.shipped import PolicyOptions
from metropilot.env import ExpertAction, ExpertChoiceAction, expert_state
from metropilot.errors import InputError
from metropilot.physics import scalars
from metropilot.policy import LoadedPolicy, load_driving_policy, shipped_policy
from metropilot.sim import AbstractDriver, Observation, Run

EARLY_S = 1e-6


class PolicyMemory(NamedTuple):
    """Memory of such a driver between two periods.

    Attributes:
        expert: The expert's.
        decided: Decisions of the policy so far.
        change: The last of them, over the largest change.
    """

    expert: ExpertMemory
    decided: int = 0
    change: float = 0.0


class AbstractExpertPolicyDriver(AbstractDriver):
    """A driver whose policy changes the rate inside the expert's rules.

    Args:
        options: Another policy than the one shipped.
    """

    def __init__(self, options: PolicyOptions | None = None) -> None:
        self.options = options or PolicyOptions()

    @property
    def path(self) -> Path:
        """The file given, or the one shipped."""
        return Path(self.options.policy) if self.options.policy else shipped_policy(self.id)

    @cached_property
    def loaded(self) -> LoadedPolicy:
        """The policy and what is known about it.

        Raises:
            InputError: The file cannot be used, or its policy did not learn inside the expert.
        """
        loaded = load_driving_policy(self.path)
        action, seen = loaded.perception.action, loaded.perception.features
        if not isinstance(action, ExpertAction | ExpertChoiceAction) or seen != ("expert",):
            raise InputError("did not learn inside the expert", file=self.path, field="perception.action")
        return loaded

    def read_policy(self) -> object:
        """Read the policy that changes the rate."""
        return self.loaded

    @cached_property
    def _action(self) -> ExpertAction | ExpertChoiceAction:
        return cast("ExpertAction | ExpertChoiceAction", self.loaded.perception.action)

    def init(self, run: Run) -> PolicyMemory:
        """Read the policy, and build the tables of the section."""
        return PolicyMemory(prepare_expert(run, run.section, self._action.rules, Hoa(sigma=SETTLED)))

    def act(self, memory: PolicyMemory, observation: Observation) -> tuple[float, PolicyMemory]:
        """One decision of the expert; the policy is asked once in its own period."""
        period, chosen = self.loaded.perception.period_s, memory.change
        decided = memory.decided

        def change(seen: RateInputs) -> float:
            nonlocal chosen, decided
            if observation.time_s >= decided * period - EARLY_S:
                chosen = self._evaluate(seen)
                decided = int((observation.time_s + EARLY_S) / period) + 1
            return chosen * self._action.change_mps2

        share, expert = decide(memory.expert, observation, change)
        return share, PolicyMemory(expert, decided, chosen)

    def _evaluate(self, seen: RateInputs) -> float:
        """Evaluate the policy: a change of the rate, as a share of the largest."""
        observed = expert_state(
            scalars,
            seen.window,
            seen.speed_mps,
            seen.left_m,
            seen.time_left_s,
            seen.rate_mps2,
            seen.traction_mps2,
        )
        answer = self.loaded.policy(np.asarray(observed, np.float32))
        return min(max(float(self._action.change(answer)), -1.0), 1.0)

"""Actions inside the expert of Huang25: the policy chooses the change of the rate, the rules bound it."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import final

import numpy as np

from metropilot._typing import Array
from metropilot.env.actions import AbstractAction
from metropilot.env.expert import ExpertRules
from metropilot.env.expert_view import expert_command
from metropilot.env.features import FeatureContext
from metropilot.env.interface import ActionSpace

SURE_S = 2.0
"""The window a policy drives in: a second inside the 3 s, so that the worst policy still arrives on time."""


@dataclass(frozen=True)
class AbstractExpertAction(AbstractAction):
    """A change of the rate inside the expert's rules (Huang25 eqs. 22 to 24).

    Attributes:
        start_mps2: Largest acceleration.
        change_mps2: Largest change of the rate in an interval.
        interval_s: Interval of that change.
    """

    start_mps2: float = 0.8
    change_mps2: float = 0.3
    interval_s: float = 0.2

    @property
    def rules(self) -> ExpertRules:
        """The expert's constants."""
        return ExpertRules(self.start_mps2, self.change_mps2, self.interval_s, SURE_S)

    @abstractmethod
    def change(self, action: Array) -> Array:
        """Wanted over largest change, of an action on the host."""


@final
@dataclass(frozen=True)
class ExpertAction(AbstractExpertAction):
    """Number: the wanted over the largest change."""

    @property
    def space(self) -> ActionSpace:
        """Action space of one number."""
        return ActionSpace(size=1)

    def change(self, action: Array) -> Array:
        """Wanted over largest change."""
        return action[0]

    def command(self, sight: FeatureContext, action: Array, period_s: float) -> Array:
        """Command of the last rate with the change that the rules allow."""
        change = sight.xp.clip(self.change(action), -1.0, 1.0)
        return expert_command(sight, self.rules, change, period_s)


@final
@dataclass(frozen=True)
class ExpertChoiceAction(AbstractExpertAction):
    """Choice of a few changes, for tabular learners (ITOR).

    Attributes:
        changes: Changes over the largest, increasing.
    """

    start_mps2: float = 0.6
    changes: tuple[float, ...] = (-1.0, 0.0, 1.0)

    @property
    def space(self) -> ActionSpace:
        """Action space of one choice a change."""
        return ActionSpace(count=len(self.changes))

    def change(self, action: Array) -> Array:
        """Wanted over largest change, of a choice on the host."""
        return self.changes[int(action)]

    def command(self, sight: FeatureContext, action: Array, period_s: float) -> Array:
        """Command of the last rate with the change that the rules allow."""
        return expert_command(sight, self.rules, sight.xp.asarray(self.changes, np.float32)[action], period_s)

"""The expert of Huang25 in a task: its features, and actions that change the rate inside its rules.

The drivers on the host use the same rules with a station stop that learns; in a task the assists stop the
trainset and avoid interventions.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from metropilot import env
from metropilot._typing import Array
from metropilot.control import AT_ONCE_MPS3
from metropilot.physics import command_for_effort
from metropilot.studies.huang2025 import laws

MARGIN_MPS = 0.25
RELEASE = 0.5
"""Jerk at which the stop assist lets go of the brake, over the trainset's limit."""


class View(NamedTuple):
    """Inputs of the expert. All 0-d.

    Attributes:
        window: The speed window.
        rate_mps2: The rate now.
        drag_mps2: Resistance and gradient.
        traction_mps2: Largest traction.
        brake_mps2: Full service brake.
        time_left_s: Time left, less what letting go of the last brake takes.
    """

    window: laws.ExpertWindow
    rate_mps2: Array
    drag_mps2: Array
    traction_mps2: Array
    brake_mps2: Array
    time_left_s: Array


def view_of(context: env.FeatureContext, rules: laws.ExpertRules) -> View:
    """Window of the destination, and the effort limits at a state."""
    xp, vehicle, v = context.rows.xp, context.vehicle, context.speed_mps
    mass = vehicle.effective_mass_kg
    drag, traction, brake = context.effort_limits[2:]
    rate = context.command * xp.where(context.command >= 0.0, traction, brake)
    jerk = xp.minimum(vehicle.jerk_mps3, AT_ONCE_MPS3)
    pulling = xp.maximum(context.acceleration_mps2, 0.0)
    coasts_at = v + pulling * (vehicle.delay_s + vehicle.lag_s + 0.5 * pulling / jerk)
    left = xp.maximum(context.left_m, 1e-3)
    at = context.position_m + left / laws.SEGMENTS * xp.arange(laws.SEGMENTS + 1, dtype=left.dtype)
    climb = context.rows.curve_at(env.CLIMB_COLUMN, context.case, at)
    cap = xp.maximum(context.rows.curve_at(env.PERMITTED_COLUMN, context.case, at) - MARGIN_MPS, 0.0)
    stretch = laws.ExpertStretch(left, climb, 0.5 * cap * cap, 0.0)
    davis = [vehicle.davis_n[k] / mass for k in range(3)]
    coasting = laws.coasting_time(xp, davis, rules.brake_mps2, coasts_at, stretch)
    time_left = context.left_s - laws.RELEASE_SHARE * rules.brake_mps2 / (RELEASE * jerk)
    window = laws.expert_window(xp, rules, left, coasting, time_left)
    return View(window, rate, drag, traction, brake, time_left)


def expert_features(context: env.FeatureContext) -> Sequence[Array]:
    """State of Huang25 eq. 19, the rate, and the position in the window."""
    view = view_of(context, laws.ExpertRules())
    return laws.expert_state(
        context.xp,
        view.window,
        context.speed_mps,
        context.left_m,
        view.time_left_s,
        view.rate_mps2,
        view.traction_mps2,
    )


def expert_command(
    context: env.FeatureContext, rules: laws.ExpertRules, change: Array, period_s: float
) -> Array:
    """The command after a change of the rate, which the rules bound."""
    view, part = view_of(context, rules), period_s / rules.interval_s
    top = context.xp.minimum(rules.start_mps2 + view.drag_mps2, view.traction_mps2)
    most = rules.change_mps2 * part
    rate = laws.next_expert_rate(context.xp, most, view.window, view.rate_mps2, change * most, top)
    return command_for_effort(rate, view.traction_mps2, view.brake_mps2)


SURE_S = 2.0
"""The window a policy drives in: a second inside the 3 s, so that the worst policy still arrives on time."""


@dataclass(frozen=True)
class AbstractExpertAction(env.AbstractAction):
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
    def rules(self) -> laws.ExpertRules:
        """The expert's constants."""
        return laws.ExpertRules(self.start_mps2, self.change_mps2, self.interval_s, SURE_S)

    @abstractmethod
    def change(self, action: Array) -> Array:
        """Wanted over largest change, of an action on the host."""


@final
@dataclass(frozen=True)
class ExpertAction(AbstractExpertAction):
    """Number: the wanted over the largest change."""

    kind = "expert"

    @property
    def space(self) -> env.ActionSpace:
        """Action space of one number."""
        return env.ActionSpace(size=1)

    def change(self, action: Array) -> Array:
        """Wanted over largest change."""
        return action[0]

    def command(self, context: env.FeatureContext, action: Array, period_s: float) -> Array:
        """Command of the last rate with the change that the rules allow."""
        change = context.xp.clip(self.change(action), -1.0, 1.0)
        return expert_command(context, self.rules, change, period_s)


@final
@dataclass(frozen=True)
class ExpertChoiceAction(AbstractExpertAction):
    """Choice of a few changes, for tabular learners (ITOR).

    Attributes:
        changes: Changes over the largest, increasing.
    """

    kind = "expert_choice"

    start_mps2: float = 0.6
    changes: tuple[float, ...] = (-1.0, 0.0, 1.0)

    @property
    def space(self) -> env.ActionSpace:
        """Action space of one choice a change."""
        return env.ActionSpace(count=len(self.changes))

    def change(self, action: Array) -> Array:
        """Wanted over largest change, of a choice on the host."""
        return self.changes[int(action)]

    def command(self, context: env.FeatureContext, action: Array, period_s: float) -> Array:
        """Command of the last rate with the change that the rules allow."""
        return expert_command(
            context, self.rules, context.rows.xp.asarray(self.changes, np.float32)[action], period_s
        )

"""Expert of Huang25 in a task: its view of a state, and the command of a change of the rate.

A host driver uses the same rules in plain numbers (:mod:`metropilot.drivers.expert.driving`) with an adaptive
station stop; in a task the assists stop the trainset and avoid interventions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from metropilot._typing import Array
from metropilot.control import AT_ONCE_MPS3
from metropilot.env.assists import needs_of
from metropilot.env.expert import (
    EXPERT_RELEASE_SHARE,
    EXPERT_SEGMENTS,
    ExpertRules,
    ExpertStretch,
    ExpertWindow,
    coasting_time,
    expert_state,
    expert_window,
    next_expert_rate,
)
from metropilot.env.features import FeatureContext
from metropilot.env.tables import CLIMB, PERMITTED_COLUMN
from metropilot.physics import command_for_effort

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

    window: ExpertWindow
    rate_mps2: Array
    drag_mps2: Array
    traction_mps2: Array
    brake_mps2: Array
    time_left_s: Array


def view_of(sight: FeatureContext, rules: ExpertRules) -> View:
    """Window of the destination, and the effort limits at a state."""
    xp, vehicle, v = sight.xp, sight.vehicle, sight.speed_mps
    mass = vehicle.effective_mass_kg
    drag, traction, brake = needs_of(sight)
    rate = sight.command * xp.where(sight.command >= 0.0, traction, brake)
    jerk = xp.minimum(vehicle.jerk_mps3, AT_ONCE_MPS3)
    pulling = xp.maximum(sight.acceleration_mps2, 0.0)
    coasts_at = v + pulling * (vehicle.delay_s + vehicle.lag_s + 0.5 * pulling / jerk)
    left = xp.maximum(sight.left_m, 1e-3)
    at = sight.position_m + left / EXPERT_SEGMENTS * xp.arange(EXPERT_SEGMENTS + 1, dtype=left.dtype)
    climb = sight.rows.ground_at(CLIMB, sight.case, at)
    cap = xp.maximum(sight.rows.ground_at(PERMITTED_COLUMN, sight.case, at) - MARGIN_MPS, 0.0)
    stretch = ExpertStretch(left, climb, 0.5 * cap * cap, 0.0)
    davis = [vehicle.davis_n[k] / mass for k in range(3)]
    coasting = coasting_time(xp, davis, rules.brake_mps2, coasts_at, stretch)
    time_left = sight.left_s - EXPERT_RELEASE_SHARE * rules.brake_mps2 / (RELEASE * jerk)
    window = expert_window(xp, rules, left, coasting, time_left)
    return View(window, rate, drag, traction, brake, time_left)


def expert_features(sight: FeatureContext) -> Sequence[Array]:
    """State of Huang25 eq. 19, the rate, and the position in the window."""
    view = view_of(sight, ExpertRules())
    return expert_state(
        sight.xp,
        view.window,
        sight.speed_mps,
        sight.left_m,
        view.time_left_s,
        view.rate_mps2,
        view.traction_mps2,
    )


def expert_command(sight: FeatureContext, rules: ExpertRules, change: Array, period_s: float) -> Array:
    """The command after a change of the rate, which the rules bound."""
    view, part = view_of(sight, rules), period_s / rules.interval_s
    top = sight.xp.minimum(rules.start_mps2 + view.drag_mps2, view.traction_mps2)
    most = rules.change_mps2 * part
    rate = next_expert_rate(sight.xp, most, view.window, view.rate_mps2, change * most, top)
    return command_for_effort(rate, view.traction_mps2, view.brake_mps2)

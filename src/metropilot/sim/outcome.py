"""The rule that ends a run, and the key figures of an episode: one drive and a compiled batch alike."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, no_type_check

import numpy as np

from metropilot.physics import namespace
from metropilot.sim.run import STOP_TOLERANCE_M, Outcome

Array = Any

RUNNING = -1
CODES: tuple[Outcome, ...] = tuple(Outcome)
"""Outcomes by number; :data:`RUNNING` is none yet."""
_ARRIVED, _OVERSHOT, _OVERSPEED, _STALLED, _OUT_OF_TIME = (
    CODES.index(outcome)
    for outcome in (
        Outcome.ARRIVED,
        Outcome.OVERSHOT,
        Outcome.OVERSPEED,
        Outcome.STALLED,
        Outcome.OUT_OF_TIME,
    )
)
OVERSPEED_MPS = 1e-6
"""A larger excess over the limit makes the outcome of a whole run ``overspeed``, wherever it ended."""


@dataclass(frozen=True)
class OutcomeRule:
    """Conditions that end a run; the defaults are those of every drive that is reported.

    A task may end its episodes sooner (see :class:`metropilot.env.DrivingConfig`): from the rest of a lost
    run a learner learns nothing.

    Attributes:
        tolerance_m: A trainset that stands this near to the stop has arrived, m.
        stalled_s: A trainset that has stood this long anywhere else is stalled, s.
        give_up_m: This far beyond the stop it has overshot, moving or not, m.
        late_ratio: Out of time when more than this times the scheduled running time ...
        late_s: ... and this much more has passed, s.
        overspeed_mps: A speed this much over the limit ends the run; infinite: the run goes on, m/s.
    """

    tolerance_m: float = STOP_TOLERANCE_M
    stalled_s: float = 20.0
    give_up_m: float = 100.0
    late_ratio: float = 2.0
    late_s: float = 120.0
    overspeed_mps: float = float("inf")


NEVER_ENDS = OutcomeRule(stalled_s=float("inf"), give_up_m=float("inf"), late_s=float("inf"))
"""For whoever decides otherwise when to stop: convoys, courses of a reference, differentiable rollouts."""


@no_type_check
def outcome_of(
    rule: OutcomeRule,
    *,
    error_m: Array,
    speed_mps: Array,
    time_s: Array,
    stood_since_s: Array,
    scheduled_s: Array,
    overspeed_mps: Array,
) -> Array:
    """Number of the outcome in :data:`CODES`, or :data:`RUNNING`. NumPy and JAX alike, all 0-d.

    Args:
        rule: The conditions.
        error_m: Position less the stop, m.
        speed_mps: Speed, m/s.
        time_s: Time since departure, s.
        stood_since_s: Time of the last standstill, s.
        scheduled_s: Scheduled running time as it stands, s.
        overspeed_mps: Largest excess over the limit in the last control period, m/s.
    """
    xp = namespace(speed_mps, error_m, time_s)
    stands = speed_mps <= 0.0
    near = xp.abs(error_m) <= rule.tolerance_m
    beyond = (error_m > rule.give_up_m) | (stands & (error_m > 0.0))
    code = xp.where(time_s > rule.late_ratio * scheduled_s + rule.late_s, _OUT_OF_TIME, RUNNING)
    code = xp.where(stands & (time_s - stood_since_s > rule.stalled_s), _STALLED, code)
    code = xp.where(overspeed_mps > rule.overspeed_mps, _OVERSPEED, code)
    code = xp.where(beyond, _OVERSHOT, code)
    code = xp.where(stands & near, _ARRIVED, code)
    return code if isinstance(code, int) else code.astype(np.int32)


def final_outcome(code: int, max_overspeed_mps: float) -> Outcome:
    """Outcome of a whole run: the way it ended, or ``overspeed`` if it ever exceeded a limit.

    Args:
        code: Number of the outcome, not :data:`RUNNING`.
        max_overspeed_mps: Largest excess over the limit in the whole run, m/s.
    """
    return Outcome.OVERSPEED if max_overspeed_mps > OVERSPEED_MPS else CODES[code]


class Episode(NamedTuple):
    """Key figures of an episode, readable from any state of it. All 0-d, or batched alike.

    Attributes:
        outcome: Number of the outcome in :data:`CODES`, or :data:`RUNNING`.
        case: Row of the task's cases.
        running_time_s: Time since departure, to the standstill if it stands.
        scheduled_s: Scheduled running time as it stands.
        wheel_j: Traction energy at the wheel.
        line_j: Net energy at the line.
        stop_error_m: Position minus the stop.
        interventions: Interventions of protection; an uninterrupted spell counts once.
        max_jerk_mps3: Largest jerk.
        jerk_mps2: Integral of the size of the jerk.
        max_overspeed_mps: Largest excess over the limit.
        decisions: Decisions taken.
    """

    outcome: Array
    case: Array
    running_time_s: Array
    scheduled_s: Array
    wheel_j: Array
    line_j: Array
    stop_error_m: Array
    interventions: Array
    max_jerk_mps3: Array
    jerk_mps2: Array
    max_overspeed_mps: Array
    decisions: Array

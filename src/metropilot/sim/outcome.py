"""Rule that ends a run, and the key figures of an episode, for one drive and a compiled batch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, no_type_check

import numpy as np

from metropilot._typing import Index, Scalar
from metropilot.physics import namespace
from metropilot.sim.run import STOP_TOLERANCE_M, Outcome

RUNNING = -1
"""Number of the outcome of a run that has not ended."""
CODES: tuple[Outcome, ...] = tuple(Outcome)
"""Outcomes by number."""
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
"""Excess over the limit, m/s, beyond which the outcome of a whole run is ``overspeed`` wherever it ended."""


@dataclass(frozen=True)
class OutcomeRule:
    """Conditions that end a run; the defaults are those of every drive that is reported.

    A task may end its episodes sooner (see :class:`metropilot.env.DrivingConfig`), as the remainder of a
    failed run carries no training signal.

    Attributes:
        tolerance_m: Largest distance from the stop at standstill that counts as arrived, m.
        stalled_s: Standstill elsewhere after which the run is stalled, s.
        give_up_m: Distance beyond the stop at which the run is overshot, moving or not, m.
        late_ratio: Ratio of the limit ``late_ratio * scheduled + late_s`` on the time since departure; what
            restrictions announced on the way take is added to it.
        late_s: Constant term of that limit, s.
        overspeed_mps: Excess over the limit that ends the run, m/s; infinite: the run continues.
    """

    tolerance_m: float = STOP_TOLERANCE_M
    stalled_s: float = 20.0
    give_up_m: float = 100.0
    late_ratio: float = 2.0
    late_s: float = 120.0
    overspeed_mps: float = float("inf")


NEVER_ENDS = OutcomeRule(stalled_s=float("inf"), give_up_m=float("inf"), late_s=float("inf"))
"""For callers with an end of their own: convoys, tracking of a reference, differentiable rollouts."""


@no_type_check
def outcome_of(
    rule: OutcomeRule,
    *,
    error_m: Scalar,
    speed_mps: Scalar,
    time_s: Scalar,
    stood_since_s: Scalar,
    scheduled_s: Scalar,
    overspeed_mps: Scalar,
    restricted_s: Scalar = 0.0,
) -> Index:
    """Number of the outcome in :data:`CODES`, or :data:`RUNNING`. NumPy and JAX alike, all 0-d.

    Args:
        rule: The conditions.
        error_m: Position minus the stop, m.
        speed_mps: Speed, m/s.
        time_s: Time since departure, s.
        stood_since_s: Time at which the trainset last came to a standstill, s.
        scheduled_s: Scheduled running time in force, s.
        overspeed_mps: Largest excess over the limit in the last control period, m/s.
        restricted_s: Time that restrictions announced on the way take at their speed, s.
    """
    xp = namespace(speed_mps, error_m, time_s)
    stands = speed_mps <= 0.0
    near = xp.abs(error_m) <= rule.tolerance_m
    beyond = (error_m > rule.give_up_m) | (stands & (error_m > 0.0))
    # Later lines take precedence: an arrival counts even after the time limit.
    latest_s = rule.late_ratio * scheduled_s + rule.late_s + restricted_s
    code = xp.where(time_s > latest_s, _OUT_OF_TIME, RUNNING)
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
    """Key figures of an episode, available in any state of it. All 0-d, or batched alike.

    Attributes:
        outcome: Number of the outcome in :data:`CODES`, or :data:`RUNNING`.
        case: Row of the task's cases.
        running_time_s: Time from departure to now, or to the standstill at the end.
        scheduled_s: Scheduled running time in force.
        wheel_j: Traction energy at the wheel.
        line_j: Net energy at the line.
        stop_error_m: Position minus the stop.
        interventions: Interventions of protection; consecutive periods count once.
        max_jerk_mps3: Largest jerk.
        jerk_mps2: Integral of the absolute jerk.
        max_overspeed_mps: Largest excess over the limit.
        decisions: Decisions taken.
    """

    outcome: Index
    case: Index
    running_time_s: Scalar
    scheduled_s: Scalar
    wheel_j: Scalar
    line_j: Scalar
    stop_error_m: Scalar
    interventions: Index
    max_jerk_mps3: Scalar
    jerk_mps2: Scalar
    max_overspeed_mps: Scalar
    decisions: Index

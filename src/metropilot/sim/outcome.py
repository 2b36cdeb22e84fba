"""How an episode ends, and what it amounted to: the same rules as on the host, compiled."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from metropilot.sim.run import STOP_TOLERANCE_M, Outcome

Array = Any

RUNNING = -1
CODES: tuple[Outcome, ...] = tuple(Outcome)
"""Outcomes by number; :data:`RUNNING` is none yet."""


@dataclass(frozen=True)
class OutcomeRule:
    """When an episode is over.

    Attributes:
        tolerance_m: A trainset that stands this near to the stop has arrived.
        stalled_s: A trainset that has stood this long anywhere else is stalled.
        give_up_m: So far beyond the stop it has overshot, standing or not.
        late_ratio: Out of time when more than this times the scheduled time ...
        late_s: ... and this much more has gone by.
        overspeed_mps: A speed this much over the limit ends the episode; infinite: it goes on.
    """

    tolerance_m: float = STOP_TOLERANCE_M
    stalled_s: float = 20.0
    give_up_m: float = 20.0
    late_ratio: float = 1.25
    late_s: float = 30.0
    overspeed_mps: float = float("inf")


class OutcomeFacts(NamedTuple):
    """What the rule looks at. All 0-d.

    Attributes:
        error_m: Position minus the stop.
        speed_mps: Speed.
        time_s: Time since departure.
        stood_s: How long the trainset has stood.
        scheduled_s: Scheduled running time.
        overspeed_mps: Largest excess over the limit in this step.
    """

    error_m: Array
    speed_mps: Array
    time_s: Array
    stood_s: Array
    scheduled_s: Array
    overspeed_mps: Array


def outcome_of(rule: OutcomeRule, facts: OutcomeFacts) -> Array:
    """Number of the outcome, or :data:`RUNNING` (JAX)."""
    import jax.numpy as jnp

    stands = facts.speed_mps <= 0.0
    near = jnp.abs(facts.error_m) <= rule.tolerance_m
    late = facts.time_s > rule.late_ratio * facts.scheduled_s + rule.late_s
    past = (facts.error_m > rule.give_up_m) | (stands & ~near & (facts.error_m > 0.0))
    tests = (
        (stands & near, Outcome.ARRIVED),
        (past, Outcome.OVERSHOT),
        (facts.overspeed_mps > rule.overspeed_mps, Outcome.OVERSPEED),
        (stands & (facts.stood_s > rule.stalled_s), Outcome.STALLED),
        (late, Outcome.OUT_OF_TIME),
    )
    code = jnp.full((), RUNNING, jnp.int32)
    for holds, outcome in reversed(tests):
        code = jnp.where(holds, CODES.index(outcome), code)
    return code


class Episode(NamedTuple):
    """KPIs of an episode, readable from any state of it. All 0-d, or batched alike.

    Attributes:
        outcome: Number of the outcome in :data:`CODES`, or :data:`RUNNING`.
        case: Row of the task's cases.
        running_time_s: Time since departure, to the stand if it stands.
        scheduled_s: Scheduled running time as it stands.
        wheel_j: Traction energy at the wheel.
        line_j: Net energy at the line.
        stop_error_m: Position minus the stop.
        interventions: Spells in which protection overruled the command.
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

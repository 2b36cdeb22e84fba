"""The expert of Huang25: a coasting forecast, the speed window of its eq. 14, the rules of eqs. 15 to 24.

Everything is written over the array namespace ``xp``: the compiled task calls it with JAX, a driver on the
host with :data:`metropilot.physics.arrays.scalars`, so there is one expert. Rates ``u`` are wheel effort
over mass, as in the paper, which keeps them within 1 m/s^2.

What the paper leaves open is decided so: the speed that is compared with the window is the mean speed a
trainset would have that coasts from here and brakes as late as it may. The plain speed would hold a trainset
near the mean speed it needs, and the published drive (19.49 m/s at most, then 900 m of coasting) does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from metropilot._typing import Array
from metropilot.errors import InputError

EXPERT_SEGMENTS = 16
SLOWEST_MPS = 0.5
"""A trainset that coasts slower than this counts as going this fast: far too late for any timetable."""
LEAST_S = 0.1
SURE = 0.2
"""Least share of the largest change that a trainset outside its window makes back into it."""
GENTLE_MPS2 = 0.5
"""Braking of a trainset that is early even if it coasts."""
EXPERT_RELEASE_SHARE = 0.5
"""Jerk at which the last brake is let go, over the trainset's limit."""
OBSERVED = 7


@dataclass(frozen=True)
class ExpertRules:
    """The expert's constants.

    Attributes:
        start_mps2: Largest acceleration (rule 2; 0.6 in the paper).
        change_mps2: Largest change of the rate in an interval (rule 3; 0.3 in the paper).
        interval_s: That interval; our control period. (The paper's step is 0.02 s, which would be no limit.)
        tolerance_s: ``T0`` of Algorithm 1.
        brake_mps2: Deceleration the last braking is forecast with.
        safe_share: Speed scaling factor of eq. 17.
        intervals: Share the time left out among the speed-limit intervals as Algorithm 1 prints it, and keep
            to the time of each. Otherwise the window is always that of the destination; see the study.
    """

    start_mps2: float = 0.6
    change_mps2: float = 0.3
    interval_s: float = 0.2
    tolerance_s: float = 3.0
    brake_mps2: float = 0.9
    safe_share: float = 0.95
    intervals: bool = False

    def __post_init__(self) -> None:
        for name, high in (
            ("start_mps2", 2.0),
            ("change_mps2", 2.0),
            ("interval_s", 5.0),
            ("tolerance_s", 30.0),
            ("brake_mps2", 2.0),
            ("safe_share", 1.0),
        ):
            value = getattr(self, name)
            if not 0.0 < value <= high:
                raise InputError(
                    "out of range", field=name, value=value, allowed=f"above 0, at most {high:g}"
                )


class ExpertStretch(NamedTuple):
    """Ground between here and the end of the interval, at :data:`EXPERT_SEGMENTS` + 1 even nodes.

    Attributes:
        left_m: Distance to its end.
        climb: Work of gradients and curves since the first node, J/kg. One entry a node.
        cap: Highest kinetic energy kept there, J/kg. One entry a node.
        end_mps: Speed to have at the end: 0 at the stop.
    """

    left_m: Array
    climb: Sequence[Array]
    cap: Sequence[Array]
    end_mps: Array


class ExpertWindow(NamedTuple):
    """Place of a trainset between too slow and too fast (Huang25 eq. 14). Speeds are means to the end.

    Attributes:
        mean_mps: Mean speed of a trainset that coasts from here.
        low_mps: Slower than this and even 3 s late are too few: ``d / T+``.
        middle_mps: Exactly on time.
        high_mps: Faster than this and it is more than 3 s early: ``d / T-``.
        late_s: Seconds it would come late.
    """

    mean_mps: Array
    low_mps: Array
    middle_mps: Array
    high_mps: Array
    late_s: Array


def coasting_time(
    xp: Any,  # noqa: ANN401 (a module)
    davis: Sequence[Array],
    brake_mps2: Array,
    speed_mps: Array,
    stretch: ExpertStretch,
) -> Array:
    """Time to the end of a stretch: coast, and brake at a constant rate as late as that allows, s.

    Energy over distance: in each segment ``e`` falls by resistance and climb; where the coasting line meets
    the braking line ``e_end + b (d - s)``, the rest is braking.

    Args:
        xp: Array namespace.
        davis: Constant, linear and quadratic resistance over mass. Three numbers.
        brake_mps2: Braking rate.
        speed_mps: Speed now.
        stretch: What lies ahead.
    """
    ds = xp.maximum(stretch.left_m, 1e-3) / EXPERT_SEGMENTS
    least = 0.5 * SLOWEST_MPS * SLOWEST_MPS
    end = 0.5 * stretch.end_mps * stretch.end_mps
    v = xp.maximum(speed_mps, SLOWEST_MPS)
    e, total, over = 0.5 * v * v, 0.0 * v, v < 0.0
    for k in range(EXPERT_SEGMENTS):
        pull = davis[0] + v * (davis[1] + v * davis[2]) + (stretch.climb[k + 1] - stretch.climb[k]) / ds
        behind = (EXPERT_SEGMENTS - 1 - k) * ds
        after = e - pull * ds
        s = xp.clip((end + brake_mps2 * (behind + ds) - e) / xp.maximum(brake_mps2 - pull, 0.05), 0.0, ds)
        meets = after >= end + brake_mps2 * behind
        crossing = xp.sqrt(2.0 * xp.maximum(e - pull * s, least))
        braking = 2.0 * s / (v + crossing) + xp.maximum(crossing - stretch.end_mps, 0.0) / brake_mps2
        e = xp.maximum(xp.minimum(after, stretch.cap[k + 1]), least)
        faster = xp.sqrt(2.0 * e)
        total = total + xp.where(over, 0.0, xp.where(meets, braking, 2.0 * ds / (v + faster)))
        over = over | meets
        v = faster
    return total


def expert_window(
    xp: Any,  # noqa: ANN401 (a module)
    rules: ExpertRules,
    left_m: Array,
    coasting: Array,
    time_left_s: Array,
    share: Array = 1.0,
) -> ExpertWindow:
    """The speed window (Huang25 eq. 14, Algorithm 1).

    Args:
        xp: Array namespace.
        rules: The expert's constants.
        left_m: ``d_k``, distance to the end of the interval.
        coasting: Time to there if it coasts, from :func:`coasting_time`.
        time_left_s: ``Tr``, reserved time to the destination.
        share: ``tau_k / tau_D``, least time to the end of the interval over that to the destination.
    """
    coasting = xp.maximum(coasting, LEAST_S)
    late, on_time, early = (
        xp.maximum((time_left_s + t) * share, LEAST_S) for t in (rules.tolerance_s, 0.0, -rules.tolerance_s)
    )
    return ExpertWindow(
        left_m / coasting, left_m / late, left_m / on_time, left_m / early, coasting - on_time
    )


def constant_rate_change(xp: Any, rules: ExpertRules, window: ExpertWindow, rate_mps2: Array) -> Array:  # noqa: ANN401
    """EITOE's change of the rate in an interval: up while too slow, down while too fast (eqs. 15 and 16).

    Inside the window, which the paper leaves open, a trainset under traction goes on until it would come
    exactly on time, and a coasting one coasts on.
    """
    goes_on = (rate_mps2 > 0.0) & (window.mean_mps < window.middle_mps)
    up = (window.mean_mps < window.low_mps) | goes_on
    return xp.where(up, rules.change_mps2, -rules.change_mps2)


def next_expert_rate(
    xp: Any,  # noqa: ANN401 (a module)
    most_mps2: Array,
    window: ExpertWindow,
    rate_mps2: Array,
    change_mps2: Array,
    top_mps2: Array,
) -> Array:
    """The rate after a change of it (eqs. 15 and 16; 22 to 24 with a change of the policy's choice).

    The window has the last word on the direction: below it the rate rises, above it falls. A trainset that is
    too fast even when it coasts brakes gently, once it coasts, until it would come on time; the paper's EITOP
    does so when it is told of a later arrival.

    Args:
        xp: Array namespace.
        most_mps2: Largest change of the rate in this period.
        window: From :func:`expert_window`.
        rate_mps2: The rate now.
        change_mps2: Wanted change.
        top_mps2: Largest rate here.
    """
    late, early = window.mean_mps < window.low_mps, window.mean_mps > window.high_mps
    sure = SURE * most_mps2
    change = xp.where(late, xp.maximum(change_mps2, sure), change_mps2)
    change = xp.where(early, xp.minimum(change, -sure), change)
    slows = (rate_mps2 <= 0.0) & (early | ((rate_mps2 < 0.0) & (window.mean_mps > window.middle_mps)))
    change = xp.where(slows, xp.minimum(change, -sure), change)
    eased = xp.minimum(rate_mps2 + most_mps2, 0.0)
    pulled = xp.clip(rate_mps2 + change, 0.0, xp.maximum(top_mps2, 0.0))
    braked = xp.maximum(rate_mps2 + change, -GENTLE_MPS2)
    return xp.where(slows, braked, xp.where(rate_mps2 < 0.0, eased, pulled))


def expert_state(
    xp: Any,  # noqa: ANN401 (a module)
    window: ExpertWindow,
    speed_mps: Array,
    left_m: Array,
    time_left_s: Array,
    rate_mps2: Array,
    traction_mps2: Array,
) -> list[Array]:
    """Observation of a policy inside the expert: the state of Huang25 eq. 19 and its place in the window."""
    late = xp.clip(window.late_s, -9.0, 9.0)
    return [
        left_m / 1000.0,
        speed_mps / 20.0,
        time_left_s / 100.0,
        rate_mps2,
        traction_mps2,
        late / 3.0,
        xp.clip(late, -1.0, 1.0),
    ]


def expert_safe_speed(
    xp: Any,  # noqa: ANN401 (a module)
    rules: ExpertRules,
    brake_mps2: Array,
    lower_mps: Array,
    left_m: Array,
    limit_mps: Array,
) -> Array:
    """Speed to stay under, m/s (Huang25 eqs. 17 and 18).

    Args:
        xp: Array namespace.
        rules: The expert's constants.
        brake_mps2: Largest deceleration.
        lower_mps: Limit of the next, slower interval.
        left_m: Distance to where it begins.
        limit_mps: Limit here.
    """
    before = xp.sqrt(lower_mps * lower_mps + 2.0 * brake_mps2 * xp.maximum(left_m, 0.0))
    return xp.minimum(rules.safe_share * before, limit_mps)

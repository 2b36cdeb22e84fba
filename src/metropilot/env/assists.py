"""Two assists a task may give its policy: the last braking to the stop point, and keeping under the ceiling.

With the stop assist a policy decides when to power, hold and coast, and how early it slows down by itself;
when the last braking must begin, and how it ends, is given by the stop curve: build up to a deceleration at
the jerk limit, hold it, let it go at a softer jerk to a small deceleration, stand (the closed forms of
:mod:`metropilot.control.stopping`). With the ceiling assist traction is eased off, and the brake comes in,
before protection would have to. Both are pure functions over the array namespace, the same in the compiled
task and on the host.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, NamedTuple

from metropilot.env.features import FeatureContext
from metropilot.env.tables import LEAST_STOP_MPS2, PERMITTED, STOP_USE, SectionRows
from metropilot.errors import InputError
from metropilot.physics import resistance_and_gradient
from metropilot.physics.effort import effort_at

Array = Any

RELEASE_SHARE = 0.5
"""Jerk at which the last brake is let go, over the trainset's limit, unless the assists say otherwise."""
END_SHARE = 0.8
"""Deceleration the stop is planned to end with, over what the jerk limit allows to drop in one period."""
RETURN_GAIN = 0.5
"""How strongly a departure from the planned deceleration is answered beyond what the stop needs."""
STRONGEST_MPS2 = 3.0
AT_ONCE_MPS3 = 1e4
INCH_M = 0.2
"""A trainset that stands nearer to the stop than this is left to stand."""
HOLD_MPS2 = 0.3
EASE_SHARE = 0.4
"""Jerk at which traction is eased off under the ceiling, over the trainset's limit."""
LET_GO_SHARE = 0.75
"""Below this share of the planned deceleration the last braking was too early, and the policy drives on."""
LAST_M = 1.0
"""Nearer to the stop than this the last braking is not given up again."""
CREEP_MPS, CREEP_M = 0.06, 0.05
"""Slower and nearer than this it is stood still."""
SOFT_SHARE = 0.9
"""Deceleration at the stand, at most, over the same."""
NEWTON_STEPS = 3
SHORTEST_M = 0.5
SHARED_M = 10.0
"""Nearer to the stop the deceleration asked for is what it is."""

RANGES = MappingProxyType(
    {
        "margin_mps": (0.0, 5.0),
        "stop_mps2": (0.0, STRONGEST_MPS2),
        "stop_use": (0.1, 1.0),
        "release": (0.1, 1.0),
    }
)
"""What the numbers of :class:`Assists` may be."""


@dataclass(frozen=True)
class Assists:
    """Which assists a task gives.

    Attributes:
        stop: The last braking to the stop point.
        ceiling: Keeping under the permitted speed and the acceleration limit.
        margin_mps: How far under the permitted speed.
        stop_mps2: Deceleration of the last braking; 0: what is surely at hand at any speed, which is very
            little for a brake that fades, while a low limit before the stop may allow much more.
        stop_use: Share of what is surely at hand that the last braking is planned with.
        release: Jerk at which the last brake is let go, over the trainset's limit: a soft one takes longer.
        late: Brake as late as the brakes surely allow: the last braking is planned with what the gradient
            leaves at each place, not with what it leaves at the worst, and begins within a period if that is
            when it must; and the speed is kept from which a lower ceiling ahead can be met.
    """

    stop: bool = True
    ceiling: bool = True
    margin_mps: float = 0.15
    stop_mps2: float = 0.0
    stop_use: float = STOP_USE
    release: float = RELEASE_SHARE
    late: bool = False

    def __post_init__(self) -> None:
        """Refuse numbers that no last braking or ceiling can be planned with."""
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError("out of range", field=name, value=value, allowed=f"{low:g} to {high:g}")

    def planned_mps2(self, rows: SectionRows, case: Array, sure_mps2: Array, position_m: Array) -> Array:
        """Deceleration to plan the last braking with from a position.

        Args:
            rows: The task's tables.
            case: Row of the case.
            sure_mps2: That of its row, which was built for ``STOP_USE``.
            position_m: Where.
        """
        if not self.late:
            return sure_mps2 * (self.stop_use / STOP_USE)
        position_m = rows.xp.minimum(position_m, rows.length_m[case] - SHORTEST_M)
        left_m = rows.length_m[case] - position_m
        work, _ = rows.stop_at(case, position_m)
        return self.stop_use * rows.xp.maximum(work / left_m, LEAST_STOP_MPS2)


class EffortLimits(NamedTuple):
    """What turns accelerations into commands here, per kilogram of effective mass.

    Attributes:
        drag_mps2: Resistance and gradient.
        traction_mps2: Largest traction.
        brake_mps2: Largest service braking.
    """

    drag_mps2: Array
    traction_mps2: Array
    brake_mps2: Array


def needs_of(sight: FeatureContext) -> EffortLimits:
    """The needs at a state, as the driver's data have it."""
    vehicle = sight.vehicle
    resistance, gradient = resistance_and_gradient(vehicle, sight.track, sight.position_m, sight.speed_mps)
    effort = effort_at(vehicle, sight.speed_mps)
    mass, xp = vehicle.effective_mass_kg, sight.xp
    return EffortLimits(
        (resistance + gradient) / mass,
        xp.maximum(effort.traction_n, 1.0) / mass,
        xp.maximum(effort.brake_n, 1.0) / mass,
    )


def share_for(sight: FeatureContext, needs: EffortLimits, wanted_mps2: Array) -> Array:
    """The command that gives an acceleration."""
    xp = sight.xp
    effort = wanted_mps2 + needs.drag_mps2
    available = xp.where(effort >= 0, needs.traction_mps2, needs.brake_mps2)
    return xp.clip(effort / available, -1.0, 1.0)


def assisted(
    assists: Assists, sight: FeatureContext, command: Array, stopping: Array, dt: float
) -> tuple[Array, Array]:
    """The command after the assists, and whether the last braking is on.

    Args:
        assists: Which.
        sight: What the driver sees.
        command: The policy's command.
        stopping: Whether the last braking was on.
        dt: Control period, s.
    """
    if not (assists.stop or assists.ceiling):
        return command, stopping
    xp, needs = sight.xp, needs_of(sight)
    if assists.stop_mps2 > 0.0:
        sight = sight._replace(stop_mps2=xp.asarray(assists.stop_mps2, sight.speed_mps.dtype))
    ceiling = command
    if assists.ceiling:
        ceiling = share_for(sight, needs, ceiling_mps2(assists, sight, dt))
        command = xp.minimum(command, ceiling)
    if assists.stop:
        stopping, wanted = stop_mps2(sight, stopping, dt, assists.release)
        entering = xp.asarray(False)
        if assists.late:
            wanted, entering = late_mps2(assists, sight, wanted, dt)
        stop = share_for(sight, needs, -wanted)
        highest = xp.minimum(stop, ceiling) if assists.ceiling else stop
        highest = xp.where(entering, xp.minimum(highest, command), highest)
        command = xp.where(stopping, highest, command)
    return command, stopping


def ceiling_at(assists: Assists, rows: SectionRows, case: Array, position_m: Array) -> Array:
    """The speed to keep under at a position, m/s."""
    if assists.late:
        return rows.follow_at(case, position_m)
    return rows.ground_at(PERMITTED, case, position_m)


def ceiling_mps2(assists: Assists, sight: FeatureContext, dt: float) -> Array:
    """Largest acceleration that protection lets pass and the trainset's limits allow.

    An acceleration must stop in time for the reaction of the emergency brake even if the trainset is as
    light as the bounds allow (:func:`metropilot.protection.approach_margin`).
    """
    xp, rates = sight.xp, sight.rates
    v, x = sight.speed_mps, sight.position_m
    spread = rates.mass_high / rates.mass_low

    def permitted(at: Array) -> Array:
        return ceiling_at(assists, sight.rows, sight.case, at) - assists.margin_mps - rates.speed_error_mps

    jerk = xp.minimum(sight.vehicle.jerk_mps3, AT_ONCE_MPS3)
    ahead_s = dt + rates.reaction_s + 1.0 / jerk
    near = xp.minimum(permitted(x), permitted(x + v * dt)) - v
    later = permitted(x + v * ahead_s) - v
    rise = xp.maximum(xp.minimum(near, later), 0.0)
    upward = xp.minimum(rise / (dt + spread * rates.reaction_s), xp.sqrt(2.0 * EASE_SHARE * jerk * rise))
    downward = xp.minimum(xp.minimum(near / dt, later / ahead_s), 0.0)
    return xp.minimum(upward + downward, sight.vehicle.max_acceleration_mps2)


def stop_mps2(
    sight: FeatureContext, stopping: Array, dt: float, release: float = RELEASE_SHARE
) -> tuple[Array, Array]:
    """Whether the last braking is on, and the deceleration it needs now, m/s^2.

    Args:
        sight: What the driver sees.
        stopping: Whether it was on.
        dt: Control period, s.
        release: Jerk at which the brake is let go, over the limit.
    """
    xp, vehicle = sight.xp, sight.vehicle
    v, a, s = sight.speed_mps, sight.acceleration_mps2, sight.length_m - sight.position_m
    jerk = xp.minimum(vehicle.jerk_mps3, AT_ONCE_MPS3)
    planned = sight.stop_mps2
    end = xp.minimum(END_SHARE * jerk * dt, planned)
    quick, gone = _built_up(xp, v, a, planned, jerk)
    reach = gone + _braking_distance(quick, planned, end, release * jerk)
    begins = s <= reach + xp.maximum(v + 0.5 * xp.maximum(a, 0.0) * dt, 0.0) * dt
    short = (v <= 0) & (s > INCH_M)
    required, falling = _required(xp, v, s, planned, end, release * jerk)
    for _ in range(2):
        quick, gone = _built_up(xp, v, a, required, jerk)
        again, _ = _required(xp, quick, s - gone, planned, end, release * jerk)
        required = xp.where(falling > 0, required, again)
    early = (required < LET_GO_SHARE * planned) & (falling <= 0) & (s > LAST_M)
    stopping = (stopping & (early ^ True) | begins) & (short ^ True)
    held = xp.maximum(required + RETURN_GAIN * (required - planned), 0.0)
    let_go = required - 0.5 * falling * dt
    last = v * v / (2.0 * xp.maximum(s, 1e-3))
    let_go = xp.where(v <= let_go * dt, last, let_go)
    wanted = xp.where(falling > 0, let_go, xp.where(required < STRONGEST_MPS2, held, required))
    wanted = xp.where(jerk < AT_ONCE_MPS3, wanted, xp.minimum(last, STRONGEST_MPS2))
    wanted = xp.where((v < CREEP_MPS) & (s < CREEP_M), xp.maximum(wanted, HOLD_MPS2), wanted)
    wanted = xp.where(s > 1e-3, wanted, STRONGEST_MPS2)
    wanted = xp.where(jerk < AT_ONCE_MPS3, xp.minimum(wanted, _softly(xp, v, jerk * dt, dt)), wanted)
    return stopping, xp.where(v > 0, wanted, HOLD_MPS2)


def late_mps2(assists: Assists, sight: FeatureContext, wanted: Array, dt: float) -> tuple[Array, Array]:
    """The deceleration that follows what the gradient leaves at each place, m/s^2; whether it only begins.

    Without a jerk limit it is the one that is on the stop curve at the end of the period, ``v'^2 = 2 b s'``
    with ``v' = v - a dt``: small in the period in which the braking begins, and on the curve from then on.
    With one, the deceleration asked for is shared out as the brakes can give it.

    Args:
        assists: How the last braking is planned.
        sight: What the driver sees.
        wanted: What a constant deceleration would be.
        dt: Control period, s.
    """
    xp, v, s, planned = sight.xp, sight.speed_mps, sight.length_m - sight.position_m, sight.stop_mps2
    _, able = sight.rows.stop_at(sight.case, sight.position_m + 0.5 * v * dt)
    shape = xp.where(s > SHARED_M, xp.clip(assists.stop_use * able / planned, 0.5, 2.0), 1.0)
    room, turn = 2.0 * s - v * dt, planned * dt
    after = 0.5 * (xp.sqrt(turn * turn + 4.0 * planned * xp.maximum(room, 0.0)) - turn)
    onto = xp.clip((v - after) / dt, 0.0, STRONGEST_MPS2)
    at_once = (sight.vehicle.jerk_mps3 >= AT_ONCE_MPS3) & (v > turn) & (room > v * dt)
    found = shape * xp.where(at_once, onto, wanted)
    return xp.where(v > 0, found, wanted), at_once & (onto < LET_GO_SHARE * planned)


def _softly(xp: Any, v: Array, drop: Array, dt: float) -> Array:  # noqa: ANN401 (a module)
    """The deceleration from which the jerk limit still lets go before standing; see ``drivers.stopping``."""
    last, half = SOFT_SHARE * drop, 0.5 * drop
    more = (last - half) * (last - half) + 4.0 * half * xp.maximum(v, 0.0) / dt
    periods = (half - last + xp.sqrt(more)) / (2.0 * half)
    return last + xp.maximum(periods - 1.0, 0.0) * drop


def _built_up(xp: Any, v: Array, a: Array, wanted: Array, jerk: Array) -> tuple[Array, Array]:  # noqa: ANN401
    """Speed, and distance gone, when a deceleration has been built up from the acceleration ``a``."""
    t = xp.maximum(wanted + a, 0.0) / jerk
    after = xp.maximum(v + a * t - 0.5 * jerk * t * t, 0.0)
    return after, v * t + 0.5 * a * t * t - jerk * t * t * t / 6.0


def _braking_distance(v: Array, b: Array, end: Array, jerk: Array) -> Array:
    """Distance to a stand: hold ``b``, then release at ``jerk`` to ``end``."""
    t = (b - end) / jerk
    released = (b * b - end * end) / (2.0 * jerk)
    return (v * v - released * released) / (2.0 * b) + t * t * (b / 6.0 + end / 3.0)


def _required(
    xp: Any,  # noqa: ANN401 (a module)
    v: Array,
    s: Array,
    planned: Array,
    end: Array,
    jerk: Array,
) -> tuple[Array, Array]:
    """Deceleration whose curve ends at the stop, and the jerk at which it falls (0: it is held).

    Newton's method on :func:`_braking_distance`, from the deceleration without a release.
    """
    s = xp.maximum(s, 1e-3)
    top = xp.sqrt(end * end + 2.0 * jerk * v)
    b = xp.minimum(xp.maximum(v * v / (2.0 * s), 0.05), xp.minimum(top, STRONGEST_MPS2) + 0.05)
    for _ in range(NEWTON_STEPS):
        t, released = (b - end) / jerk, (b * b - end * end) / (2.0 * jerk)
        slope = (released * released - v * v) / (2.0 * b * b) - released / jerk
        slope = slope + (2.0 * t / jerk) * (b / 6.0 + end / 3.0) + t * t / 6.0
        step = (_braking_distance(v, b, end, jerk) - s) / xp.minimum(slope, -1e-2)
        b = xp.minimum(xp.maximum(b - step, 0.05), STRONGEST_MPS2)
    least = _braking_distance(v, xp.maximum(top, 0.05), end, jerk)
    p = 2.0 * v
    left_s = 12.0 * s / (xp.sqrt(p * p + 24.0 * end * s) + p + 1e-9)
    now = p / xp.maximum(left_s, 1e-6) - end
    releasing = s <= least
    falling = xp.maximum(now - end, 0.0) / xp.maximum(left_s, 1e-6)
    del planned
    return xp.where(releasing, now, b), xp.where(releasing, xp.maximum(falling, 1e-6), 0.0)

"""Place of a follower in a convoy: its own planned motion behind that of the trainset ahead.

A trainset sends its planned motion to the one behind, with its messages. The follower plans the same motion
at the desired gap, later by what protection needs, and sends it on. What the trainset ahead does otherwise
is then known as a departure from its plan, and is small.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.convoy.model import Member
from metropilot.convoy.needed import NeededGap, delay_along
from metropilot.convoy.own_plant import most_bandwidth
from metropilot.convoy.plan import STANDING_MPS, MotionPlan, PlannedMotion, lead_to, plan_times, stand_on
from metropilot.convoy.step import gap_per_mps
from metropilot.physics import effort_limits, kept_share
from metropilot.protection import permitted_speed

SLOPE_MPS, FASTEST_SLOPE_MPS, SLOPE_PER_S = 0.5, 3.0, 0.05
"""Rate at which a gap is opened or closed: least, largest, and over the change of the gap."""
PLANNED_UNDER_MPS = 0.1
"""Margin of a planned speed below the permitted one while a gap is closed."""
GAP_SHARE = 0.3
"""Rate at which a gap is opened at most, over the speed: a trainset does not stand still for it."""
BRAKING_MPS2 = 0.3
"""Deceleration from which on a motion brakes."""
EASING_MPS2 = 0.15
"""Deceleration for a delay that is needed at once."""
OPENING_MPS = 0.3
"""Speed that a trainset gives up for a delay that it needs later."""
FASTEST_SHARE, CLOSING_SHARE, BRAKING_SHARE = 0.3, 0.05, 0.1
"""Changes of a delay over time: at most; at most made up for; while it brakes."""
FITTED_S = 1.0
"""Time over which the speed of now is taken from the positions before."""
SMOOTH_S = 3.0
"""Length of each of the three means that smooth a planned gap or delay."""
EFFORT_USE, RATE_USE = 0.97, 0.97
"""Shares of efforts, and of rates and jerk limit, that a planned motion uses; the rest is for corrections."""
BRAKE_USE, BRAKE_LIMIT = 0.85, 0.92
"""Shares of the brake: with which a trainset makes up for a delay while braking; that a plan uses at most."""
CLOSED_MPS = 3.0
"""Speed of the trainset ahead below which its stop is so near that the gap should be closed."""
TRACKING_PER_S, CATCH_UP_MPS2, CATCH_UP_PER_S2 = 0.8, 0.2, 0.012
"""Bandwidth with which a planned motion comes back to the wanted one, the most that it accelerates for it,
and for each metre that it is behind: a large command takes a large gap."""
FALL_BACK_MPS2 = 0.15
"""The most that it decelerates for it if its commands act late: the trainsets behind would have to decelerate
more."""
CLOSING_S, CLOSES_AFTER = 20.0, 20.0
"""Time for closing a gap after the trainset ahead stands: least, and over the time that the brakes take."""
CREEP_MPS, CREEP_M = 0.05, 0.2
"""Speed and distance with which a planned motion ends: it is shifted to the mark and does not creep there."""
SHIFT_FROM_M, SHIFT_TO_M = 60.0, 1.0
"""Distances to the own mark between which a planned motion is shifted to end there."""
PASSES, FAR_BEHIND_M = 8, 10.0
"""Most passes that find a motion far from the wanted one; distance up to which one is enough."""
APPROACH_S = 1.0
"""Time constant with which a planned motion approaches the permitted speed, without dead time and lag."""
DELAY_USE, BRAKING_USE = 0.4, 0.85
"""Share of the gap beyond the needed one that making up for a delay may take; while it brakes."""
CLOSING_USE, LATEST_USE, LATEST_SLOPE_MPS = 0.3, 0.6, 1.0
"""The same of closing a gap; where the stop is near; rate there."""


PlannedGap = Callable[[ndarray], ndarray]
"""Gap at times, as planned so far."""


def place_behind(
    ahead: MotionPlan,
    member: Member,
    length_ahead_m: float,
    now_s: float,
    planned_gap: PlannedGap,
    now: PlannedMotion | None = None,
) -> MotionPlan:
    """Planned motion of a follower behind that of the trainset ahead (NumPy).

    It passes every place as the trainset ahead would at the desired gap, but later where protection needs
    more distance for it: whoever accelerates later has the gap by then, and needs no brake to open it.

    Args:
        ahead: Planned motion of the trainset ahead.
        member: The follower.
        length_ahead_m: Length of the trainset ahead.
        now_s: Time from which the motion can be changed.
        planned_gap: Gap planned so far.
        now: Motion at that time; None: at the gap planned so far.
    """
    rows, dt, longer_s = ahead.position_m.size, float(ahead.period_s), _closing_s(member)
    if now is not None:
        passed_s = np.interp(now.position_m, ahead.position_m - length_ahead_m, plan_times(ahead))
        longer_s += max(now_s - float(passed_s), 0.0)
    ahead = stand_on(ahead, round(longer_s / dt))
    times = plan_times(ahead)
    rear = ahead.position_m - length_ahead_m
    first = min(max(round((now_s - times[0]) / dt), 0), times.size - 2)
    before = rear[: first + 1] - planned_gap(times[: first + 1])
    # An emergency brake ends a manoeuvre: what is left of it is the gap at its end.
    coordinated = manoeuvres(member) and now is None
    if now is None:
        now = _motion_now(before, dt)
    # A departure from an earlier plan is not carried into the new one.
    before = before + (now.position_m - before[-1])
    # It parts where the trainset ahead passes the place; one that ends before it stays coupled.
    parts = not coordinated and rear[-1] - member.gap_m >= member.uncouple_at_m
    base = ahead._replace(position_m=rear - float(member.apart_m if parts else member.gap_m))
    need = None
    if member.protection is not None:
        need = NeededGap(member.protection, ahead, member, length_ahead_m, base)
    if coordinated:
        apart = base.position_m >= member.uncouple_at_m
        asked = np.where(apart, float(member.apart_m), float(member.gap_m))
        needed = np.zeros(times.size) if need is None else need.along_m()
        gap = smooth_gap(member, base, asked, needed, first, planned_gap)
        opening = np.gradient(gap, dt)
        wanted = base._replace(position_m=rear - gap, speed_mps=np.maximum(ahead.speed_mps - opening, 0.0))
    else:
        wanted = delay_motion(base, needed_delay(member, need, base, first, float(before[-1])))
    own = make_drivable(member, wanted, first, now, coordinated=coordinated)
    known_mps = np.gradient(before, dt) if first else own.speed_mps[:1]
    own = own._replace(
        position_m=np.concatenate([before[:-1], own.position_m]),
        speed_mps=np.concatenate([lead_to(known_mps, own.speed_mps[0])[:-1], own.speed_mps]),
    )
    moving = np.flatnonzero(own.speed_mps > STANDING_MPS)
    # As long as that of the trainset ahead, or until it stands.
    rows = max(rows, moving[-1] + 2 if moving.size else 0)
    return own._replace(position_m=own.position_m[:rows], speed_mps=own.speed_mps[:rows])


def _closing_s(member: Member) -> float:
    """Time for closing a gap after the trainset ahead stands, s.

    The way that protection admits shrinks as fast as the brakes answer: by its share every such time.
    """
    if member.protection is None:
        return CLOSING_S
    rates, believed = member.protection.rates, member.believed
    builds_s = float(member.bounds.held_mps2) / min(float(rates.jerk_mps3), float(believed.jerk_mps3))
    late_s = float(rates.reaction_s) + float(believed.delay_s + believed.lag_s)
    return max(CLOSING_S, CLOSES_AFTER * (late_s + builds_s))


def _motion_now(before_m: Float[ndarray, " known"], dt: float) -> PlannedMotion:
    """Motion at the last of the positions before."""
    last = before_m[-round(FITTED_S / dt) :]
    if last.size < 3:
        return PlannedMotion(before_m[-1], 0.0, 0.0)
    half_mps2, speed_mps, _ = np.polyfit(dt * np.arange(1.0 - last.size, 1.0), last, 2)
    return PlannedMotion(before_m[-1], max(float(speed_mps), 0.0), 2.0 * float(half_mps2))


def manoeuvres(member: Member) -> bool:
    """Tell if a trainset couples or uncouples on the move."""
    return bool(member.first_gap_m != member.gap_m or np.isfinite(member.uncouple_at_m))


def delay_motion(base: MotionPlan, delay_s: Float[ndarray, " rows"]) -> MotionPlan:
    """Delay a motion: it passes every place later, by what may change along it (NumPy)."""
    times, dt = plan_times(base), float(base.period_s)
    slower = np.maximum(1.0 + np.gradient(delay_s, dt), 0.2)
    passes_s = np.maximum.accumulate(times + delay_s)
    speeds = np.interp(times, passes_s, base.speed_mps / slower)
    return base._replace(position_m=np.interp(times, passes_s, base.position_m), speed_mps=speeds)


def needed_delay(
    member: Member, need: NeededGap | None, base: MotionPlan, first: int, position_m: float
) -> Float[ndarray, " rows"]:
    """Delay behind a motion with which protection passes the same commands, at its rows (NumPy).

    Smooth, and as it is now at first. It grows before it is needed, as far as that costs little speed, and
    is made up for as fast as permitted speed and protection admit.

    Args:
        member: The follower.
        need: Gap that protection needs along the motion; None: it has no protection.
        base: Motion of the follower without delay.
        first: Row of now.
        position_m: Its position now.
    """
    times, dt, count = plan_times(base), float(base.period_s), base.position_m.size
    row, late_s = first, 0.0
    if base.position_m[first] > position_m + 1e-3:
        row = max(int(np.searchsorted(base.position_m, position_m)) - 1, 0)
        passes_s = np.interp(position_m, base.position_m[row : row + 2], times[row : row + 2])
        late_s = float(times[first] - passes_s)
    needed = np.zeros(count) if need is None else delay_along(need, row)
    half = max(round(0.5 * SMOOTH_S / dt), 1)
    reach, speed = 3 * half, base.speed_mps
    wide = hold_largest(needed, reach)
    opens = OPENING_MPS / np.maximum(speed, OPENING_MPS / FASTEST_SHARE)
    for j in range(count - 2, row, -1):
        wide[j] = max(wide[j], wide[j + 1] - opens[j] * dt)
    use, room = _limit_closing(member, base)
    takes = gap_per_mps(speed, float(member.bounds.held_mps2))
    delay, own_mps = np.full(count, late_s), speed[row]
    for j in range(row + 1, count):
        before = delay[j - 1]
        closes = min(use[j] * max(before - wide[j], 0.0) / takes[j], room[j])
        # It eases off for a delay, and brakes only where the motion itself does.
        slowest = own_mps * min(speed[j] / max(speed[j - 1], 0.1), 1.0) - EASING_MPS2 * dt
        most = min(max(speed[j] / max(slowest, 0.1) - 1.0, 0.0), FASTEST_SHARE)
        delay[j] = min(max(wide[j], before - closes * dt), before + most * dt)
        own_mps = speed[j] / max(1.0 + (delay[j] - before) / dt, 0.1)
    smooth = smooth_out(np.pad(delay, reach, "edge"), half)
    fade_from(late_s, smooth[row : row + reach], reach)
    smooth[:row] = late_s
    return smooth


def _limit_closing(
    member: Member, base: MotionPlan
) -> tuple[Float[ndarray, " rows"], Float[ndarray, " rows"]]:
    """Share of the spare gap that making up for a delay may take, and the most of it over time."""
    braking_mps2 = -np.gradient(base.speed_mps, float(base.period_s))
    brakes = braking_mps2 > BRAKING_MPS2
    use, room = np.where(brakes, BRAKING_USE, DELAY_USE), np.where(brakes, BRAKING_SHARE, CLOSING_SHARE)
    if member.protection is None:
        return use, room
    permitted = permitted_speed(member.protection, base.position_m) - PLANNED_UNDER_MPS
    faster = np.clip(1.0 - base.speed_mps / np.maximum(permitted, 0.1), 0.0, room)
    # Whoever makes up for a delay while it brakes brakes harder.
    most = BRAKE_USE * min(float(member.most_mps2), float(member.believed.max_deceleration_mps2))
    share = np.clip(braking_mps2 / most, 0.0, 1.0)
    return use, np.minimum(faster, 1.0 - np.sqrt(share))


def hold_largest(values: Float[ndarray, " rows"], reach: int) -> Float[ndarray, " rows"]:
    """The largest value within so many rows on either side."""
    window = np.lib.stride_tricks.sliding_window_view(np.pad(values, reach, "edge"), 2 * reach + 1)
    return window.max(axis=1)


def fade_from(first: float, values: Float[ndarray, " rows"], reach: int) -> None:
    """Move values, in place, so that they begin with the first; the difference fades over so many rows."""
    values += (first - values[0]) * np.linspace(1.0, 0.0, reach)[: values.size]


def smooth_out(values: Float[ndarray, " padded"], half: int) -> Float[ndarray, " rows"]:
    """Three moving means, each over so many rows on either side; shorter by three times as many on both."""
    mean = np.ones(2 * half + 1) / (2 * half + 1)
    for _ in range(3):
        values = np.convolve(values, mean, "valid")
    return values


def make_drivable(
    member: Member, wanted: MotionPlan, first: int, now: PlannedMotion, *, coordinated: bool = False
) -> MotionPlan:
    """Motion near a wanted one that the trainset can drive: within its rates, efforts and jerk limit (NumPy).

    Args:
        member: The trainset.
        wanted: Wanted motion.
        first: Row at which the motion begins.
        now: Motion there.
        coordinated: True while the trainset couples or uncouples: it closes a gap no faster than that allows.
    """
    wanted = wanted._replace(position_m=wanted.position_m[first:], speed_mps=wanted.speed_mps[first:])
    own = wanted
    # Far behind the wanted motion efforts and limits are not those of its places and speeds. That of a
    # manoeuvre is not far: it opens and closes the gap little by little.
    for _ in range(1 if coordinated else PASSES):
        along, own = own, _drive_near(member, wanted, own, now, coordinated=coordinated)
        if np.abs(own.position_m - along.position_m).max() <= FAR_BEHIND_M:
            break
    # The end is the own mark, whatever the corrections have left.
    moved, length_m = own.position_m, SHIFT_FROM_M - SHIFT_TO_M
    shift_m = wanted.position_m[-1] - moved[-1]
    done = np.clip((moved - moved[-1] + SHIFT_FROM_M) / length_m, 0.0, 1.0)
    return wanted._replace(
        position_m=moved + shift_m * done * done * (3.0 - 2.0 * done),
        speed_mps=own.speed_mps * (1.0 + shift_m * 6.0 * done * (1.0 - done) / length_m),
    )


def _drive_near(
    member: Member, wanted: MotionPlan, along: MotionPlan, now: PlannedMotion, *, coordinated: bool
) -> MotionPlan:
    """Motion near a wanted one, with the efforts and permitted speeds along another one that is near."""
    vehicle, dt = member.believed, float(wanted.period_s)
    position_m, speed_mps = along.position_m, along.speed_mps
    limits = effort_limits(vehicle, member.track, position_m, speed_mps)
    most = EFFORT_USE * limits.traction_mps2 - limits.drag_mps2
    most = np.minimum(most, RATE_USE * float(vehicle.max_acceleration_mps2)).tolist()
    least = np.maximum(
        -EFFORT_USE * limits.brake_mps2 - limits.drag_mps2,
        -BRAKE_LIMIT * float(vehicle.max_deceleration_mps2),
    )
    least = np.maximum(least, -BRAKE_LIMIT * float(member.most_mps2)).tolist()
    wanted_m, wanted_mps = wanted.position_m.tolist(), wanted.speed_mps.tolist()
    permitted = np.full(position_m.size, np.inf)
    if member.protection is not None:
        permitted = permitted_speed(member.protection, position_m) - PLANNED_UNDER_MPS
    late_s = APPROACH_S + float(vehicle.delay_s) + float(vehicle.lag_s)
    if member.protection is not None:
        # Whoever still accelerates stays below the permitted speed by what it gains until a brake acts.
        rates = member.protection.rates
        late_s += float(rates.mass_high / rates.mass_low * rates.reaction_s)
    rows = max(round(late_s / dt), 1)
    # Protection passes a command for a higher limit once the trainset is there, and then it is on its way.
    rows_before = max(round(float(vehicle.delay_s) / dt), 0) + 1
    lowest = np.lib.stride_tricks.sliding_window_view(
        np.pad(permitted, (rows_before, rows), "edge"), rows_before + rows + 1
    ).min(axis=1)
    cap, jerk = lowest.tolist(), RATE_USE * float(vehicle.jerk_mps3) * dt
    w = min(TRACKING_PER_S, float(most_bandwidth(vehicle)))
    takes = gap_per_mps(speed_mps, float(member.bounds.held_mps2)).tolist()
    answers = 1.0 - kept_share(float(vehicle.lag_s), dt)
    most_down = FALL_BACK_MPS2 if float(vehicle.delay_s + vehicle.lag_s) > 0.0 else np.inf
    reached_m, stop_m2ps2 = _braking_energy(
        position_m,
        np.maximum(least, -BRAKE_LIMIT * limits.brake_mps2 - limits.drag_mps2),
        float(wanted.position_m[-1]),
    )
    builds_s = max(dt, float(vehicle.lag_s) - 0.5 * min(least) * dt / jerk)
    stands = np.flatnonzero(wanted.speed_mps > CREEP_MPS).max(initial=0)
    x, v, a = now
    positions, speeds = [x], [v]
    for k in range(len(wanted_m) - 1):
        rise = (wanted_mps[k + 1] - wanted_mps[k]) / dt
        behind = wanted_m[k] - x
        most_faster = SLOPE_MPS if coordinated else BRAKING_USE * max(behind, 0.0) / takes[k]
        faster = min(max(0.5 * w * behind, -SLOPE_MPS), most_faster)
        most_up = CATCH_UP_MPS2 + CATCH_UP_PER_S2 * max(wanted_m[k] - x, 0.0)
        catching_up = max(min(2.0 * w * (wanted_mps[k] + faster - v), most_up), -most_down)
        free = min(rise + catching_up, (cap[k + 1] - v) / late_s)
        # Whoever is late still ends at its mark with its own brakes.
        # What accelerates gains speed until its jerk limit has ended that.
        ends_s = max(a, 0.0) * dt / jerk
        stop_mps = math.sqrt(2.0 * float(np.interp(x + v * (dt + ends_s), reached_m, stop_m2ps2)))
        free = min(free, least[k] + (stop_mps - v - 0.5 * a * ends_s) / builds_s)
        # A motion that a lag shapes takes no larger commands for it, which protection would count.
        lagged = a + answers * (min(max(free, least[k]), most[k]) - a)
        a = min(max(lagged, a - jerk), a + jerk)
        after = max(v + a * dt, 0.0)
        if k > stands and after < CREEP_MPS and behind < CREEP_M:
            after = 0.0
        x, v = x + 0.5 * (v + after) * dt, after
        positions.append(x)
        speeds.append(v)
    return wanted._replace(position_m=np.array(positions), speed_mps=np.array(speeds))


def _braking_energy(
    position_m: Float[ndarray, " rows"], least_mps2: Float[ndarray, " rows"], mark_m: float
) -> tuple[Float[ndarray, " reached"], Float[ndarray, " reached"]]:
    """Positions reached up to the mark, and the kinetic energy per kg there from which braking ends there."""
    reached_m = np.minimum(np.maximum.accumulate(np.append(position_m, mark_m)), mark_m)
    taken = np.maximum(-np.append(least_mps2[1:], least_mps2[-1]), 0.0) * np.diff(reached_m)
    return reached_m, np.append(np.cumsum(taken[::-1])[::-1], 0.0)


def smooth_gap(
    member: Member,
    level: MotionPlan,
    wanted_m: Float[ndarray, " rows"],
    needed_m: Float[ndarray, " rows"],
    first: int,
    planned_gap: PlannedGap,
) -> Float[ndarray, " rows"]:
    """Smooth gap over time that is at least the wanted one, as far as it can be from what it is now (NumPy).

    It is opened before it is needed. It is closed no faster than the permitted speed and protection admit:
    a speed difference at a speed ``v`` takes ``v / b`` times as much gap, at a brake rate ``b``.

    Args:
        member: The follower.
        level: Its motion at a constant gap.
        wanted_m: Wanted gap.
        needed_m: Gap that protection needs at a constant gap.
        first: Row of now; the gap before it is a fact.
        planned_gap: Gap planned so far.
    """
    dt, count = float(level.period_s), level.position_m.size
    target = np.maximum(wanted_m, needed_m)[first:]
    if target.size == 0:
        return planned_gap(plan_times(level))
    half = max(round(0.5 * SMOOTH_S / dt), 1)
    reach = 3 * half
    # As far as the means reach back to now, it is what it was planned to be.
    now_s = float(level.start_s) + first * dt
    known = planned_gap(now_s + dt * np.arange(-reach, reach + 1))
    change = max(float(np.ptp(target)), abs(float(target[0]) - float(known[reach])))
    slope = min(max(SLOPE_MPS, SLOPE_PER_S * change), FASTEST_SLOPE_MPS)
    room = np.full(count, slope)
    if member.protection is not None:
        room = permitted_speed(member.protection, level.position_m) - PLANNED_UNDER_MPS - level.speed_mps
    held = float(member.bounds.held_mps2)
    takes = gap_per_mps(level.speed_mps[first:], held)
    opening = np.minimum(slope, GAP_SHARE * level.speed_mps[first:])
    envelope = hold_largest(target, reach)
    for k in range(envelope.size - 2, -1, -1):
        envelope[k] = max(envelope[k], envelope[k + 1] - slope * dt)
    envelope[: reach + 1] = known[reach : reach + envelope.size]
    spare, room = needed_m[first:], np.clip(room[first:], 0.0, max(slope, LATEST_SLOPE_MPS))

    def closing(gap_m: float, k: int, use: float, most_mps: float) -> float:
        return min(use * max(gap_m - spare[k], 0.0) / takes[k], room[k], most_mps)

    # The latest that closing can begin to be at the last gap when the trainset ahead is about to stand.
    latest, still = np.full(envelope.size, envelope[-1]), level.speed_mps[first:] <= CLOSED_MPS
    for k in range(envelope.size - 2 - reach, -1, -1):
        rate = 0.0 if still[k] else closing(latest[k + 1], k, LATEST_USE, LATEST_SLOPE_MPS)
        latest[k] = latest[k + 1] + rate * dt
    for k in range(reach + 1, envelope.size):
        before = envelope[k - 1]
        late = before > latest[k]
        use, most = (LATEST_USE, max(slope, LATEST_SLOPE_MPS)) if late else (CLOSING_USE, slope)
        least = before - closing(before, k, use, most) * dt
        envelope[k] = min(max(envelope[k], least), before + opening[k] * dt)
    smooth = np.concatenate([known[:reach], np.pad(envelope, (0, reach), "edge")])
    smooth = smooth_out(smooth, half)
    # The means round off what is known.
    fade_from(float(known[reach]), smooth[:reach], reach)
    return np.concatenate([planned_gap(plan_times(level)[:first]), smooth])

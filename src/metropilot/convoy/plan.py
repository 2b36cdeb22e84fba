"""Planned motion of trainsets of a convoy: the head predicts its own, each follower places its own behind.

A trainset sends its planned motion to the one behind, with its messages. The follower plans the same motion
at the desired gap, or at the gap that protection will need if that is larger, and sends it on. What the
trainset ahead does otherwise is then known as a departure from its plan, and is small.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, no_type_check

import numpy as np
from numpy import ndarray

from metropilot._typing import Array, Float, Scalar
from metropilot.convoy.model import FAR_M, Member, growing_m
from metropilot.physics import effort_limits, namespace, scalars
from metropilot.protection import TrainAhead, at_start, permitted_speed, spare_gap

MARGIN_M = 0.4
"""Distance that a planned gap leaves beyond what protection needs."""
SHARE_FACTOR, SHARE_SPARE = 1.05, 0.05
"""Command that protection is asked about over the planned one, which leaves room for corrections."""
LOST_AT_ONCE = 1e-4
"""Probability of a run of lost messages that a planned gap need not allow for."""
LONGEST_SILENCE_S = 1.0
NEED_STEP_S = 0.5
"""Time between two instants at which the gap that protection needs is evaluated."""
SLOPE_MPS, FASTEST_SLOPE_MPS, SLOPE_PER_S = 0.5, 3.0, 0.05
"""Rate at which a gap is opened or closed: least, largest, and over the change of the gap."""
UNDER_MPS = 0.1
"""Margin of a planned speed below the permitted one while a gap is closed."""
OPENING_SHARE = 0.3
"""Rate at which a gap is opened at most, over the speed: a trainset does not stand still for it."""
SMOOTH_S = 3.0
"""Length of each of the three means that smooth a planned gap."""
EFFORT_USE, RATE_USE = 0.97, 0.97
"""Shares of efforts, and of rates and jerk limit, that a planned motion uses; the rest is for corrections."""
LACK_M = 0.2
"""Lack of gap behind what protection needs, margin included, for which a planned motion is planned again."""
CLOSED_MPS = 3.0
"""Speed of the trainset ahead below which its stop is so near that the gap should be closed."""
TRACKING_PER_S, CATCH_UP_MPS2, CATCH_UP_PER_S2 = 0.8, 0.2, 0.012
"""Bandwidth with which a planned motion comes back to the wanted one, the most that it accelerates for it,
and for each metre that it is behind: a large command takes a large gap."""
CLOSING_S, STANDING_MPS = 20.0, 1e-3
"""Time for closing a gap after the trainset ahead stands; speed below which a planned motion stands."""
SHIFT_FROM_M, SHIFT_TO_M = 60.0, 1.0
"""Distances to the own mark between which a planned motion is shifted to end there."""
LIMIT_S = 1.0
"""Time constant with which a planned motion approaches the permitted speed, without dead time and lag."""
CLOSING_USE, LATEST_USE, LATEST_SLOPE_MPS = 0.3, 0.6, 1.0
"""Share of the gap beyond the needed one that closing it may take up; where the stop is near; rate there."""


PlannedGap = Callable[[ndarray], ndarray]
"""Gap at times, as planned so far."""


class MotionPlan(NamedTuple):
    """Planned motion over time on a uniform grid; the trainset stands before and after it.

    Attributes:
        start_s: Time of the first row. 0-d.
        period_s: Time between rows. 0-d.
        position_m: Position of the front. Shape (T,).
        speed_mps: Speed. Shape (T,).
    """

    start_s: Scalar
    period_s: Scalar
    position_m: Float[Array, " rows"]
    speed_mps: Float[Array, " rows"]


class PlannedMotion(NamedTuple):
    """Planned motion at one time. All 0-d."""

    position_m: Scalar
    speed_mps: Scalar
    acceleration_mps2: Scalar


@no_type_check
def plan_at(plan: MotionPlan, time_s: Scalar) -> PlannedMotion:
    """Planned motion at a time; the acceleration is that of the period which begins there."""
    xp = namespace(plan.start_s, plan.position_m[0], time_s)
    last, dt = plan.position_m.shape[-1] - 1, plan.period_s
    # A clock that is a sum of periods may be a rounding error before the row.
    row = xp.clip((time_s - plan.start_s) / dt + 1e-3, 0.0, 1.0 * last)
    whole = xp.minimum(row // 1.0, last - 1.0)
    k = int(whole) if xp is scalars else whole.astype(np.int32)
    x, v = plan.position_m[k], plan.speed_mps[k]
    rise, way = plan.speed_mps[k + 1] - v, plan.position_m[k + 1] - x
    done = row - whole
    # The rows give both ends; a constant acceleration between them is right but for the period of the stop.
    moved = done * (way + 0.5 * (done - 1.0) * rise * dt)
    still = (time_s < plan.start_s - 1e-3 * dt) | (row >= last)
    return PlannedMotion(x + moved, v + done * rise, xp.where(still, 0.0 * v, rise / dt))


def plan_times(plan: MotionPlan) -> Float[ndarray, " rows"]:
    """Times of the rows of a plan (NumPy)."""
    return float(plan.start_s) + float(plan.period_s) * np.arange(plan.position_m.size)


def place_behind(
    ahead: MotionPlan, member: Member, length_ahead_m: float, now_s: float, planned_gap: PlannedGap
) -> MotionPlan:
    """Planned motion of a follower behind that of the trainset ahead (NumPy).

    The gap is the desired one or, where that is larger, the one at which protection passes the planned
    commands. Its changes are smooth, and begin before they are needed. What is left of it when the trainset
    ahead stands is closed thereafter.

    Args:
        ahead: Planned motion of the trainset ahead.
        member: The follower.
        length_ahead_m: Length of the trainset ahead.
        now_s: Time from which the gap can be changed.
        planned_gap: Gap planned so far.
    """
    rows = ahead.position_m.size
    ahead = _stand_on(ahead, round(CLOSING_S / float(ahead.period_s)))
    times, dt = plan_times(ahead), float(ahead.period_s)
    rear = ahead.position_m - length_ahead_m
    first = max(round((now_s - times[0]) / dt), 0)
    level = ahead._replace(position_m=rear - float(member.gap_m))
    apart = level.position_m >= member.uncouple_at_m
    wanted = np.where(apart, float(member.apart_m), float(member.gap_m))
    needed = needed_along(ahead, member, length_ahead_m, level)
    # A trainset that cannot follow at once makes up for it later, when the one ahead may already ease off.
    for again in (True, False):
        gap = smooth_gap(member, level, wanted, needed, first, planned_gap)
        opening = np.gradient(gap, dt)
        # It goes on as it was planned to.
        around = planned_gap(float(times[0]) + dt * np.arange(-1.0, 2.0))
        opening[0] = (around[2] - around[0]) / (2.0 * dt)
        opening[1] = opening[0] + (around[2] - 2.0 * around[1] + around[0]) / dt
        own = drivable(member, ahead, rear - gap, np.maximum(ahead.speed_mps - opening, 0.0))
        if again:
            behind = needed_along(ahead, member, length_ahead_m, own)
            lacking = behind - (rear - own.position_m) > LACK_M
            lacking &= own.speed_mps > CLOSED_MPS
            if not lacking[first:].any():
                break
            needed = np.where(lacking, np.maximum(needed, behind + LACK_M), needed)
    moving = np.flatnonzero(own.speed_mps > STANDING_MPS)
    # As long as that of the trainset ahead, or until it stands.
    rows = max(rows, moving[-1] + 2 if moving.size else 0)
    return own._replace(position_m=own.position_m[:rows], speed_mps=own.speed_mps[:rows])


def _stand_on(plan: MotionPlan, rows: int) -> MotionPlan:
    """Planned motion that stands for so many rows more at its end, if it stands there (NumPy)."""
    if plan.speed_mps[-1] > STANDING_MPS:
        return plan
    return plan._replace(
        position_m=np.pad(plan.position_m, (0, rows), "edge"), speed_mps=np.pad(plan.speed_mps, (0, rows))
    )


def drivable(
    member: Member,
    ahead: MotionPlan,
    position_m: Float[ndarray, " rows"],
    speed_mps: Float[ndarray, " rows"],
) -> MotionPlan:
    """Motion near a wanted one that the trainset can drive: within its rates, efforts and jerk limit (NumPy).

    Args:
        member: The trainset.
        ahead: Planned motion of the trainset ahead, for its times.
        position_m: Wanted positions at its rows.
        speed_mps: Wanted speeds.
    """
    vehicle, dt = member.believed, float(ahead.period_s)
    limits = effort_limits(vehicle, member.track, position_m, speed_mps)
    most = EFFORT_USE * limits.traction_mps2 - limits.drag_mps2
    most = np.minimum(most, RATE_USE * float(vehicle.max_acceleration_mps2)).tolist()
    least = np.maximum(
        -EFFORT_USE * limits.brake_mps2 - limits.drag_mps2, -float(vehicle.max_deceleration_mps2)
    )
    least = np.maximum(least, -RATE_USE * float(member.most_mps2)).tolist()
    wanted_m, wanted_mps = position_m.tolist(), speed_mps.tolist()
    permitted = np.full(position_m.size, np.inf)
    if member.protection is not None:
        permitted = permitted_speed(member.protection, position_m) - UNDER_MPS
    late_s = LIMIT_S + float(vehicle.delay_s) + float(vehicle.lag_s)
    if member.protection is not None:
        # Whoever still accelerates stays below the permitted speed by what it gains until a brake acts.
        rates = member.protection.rates
        late_s += float(rates.mass_high / rates.mass_low * rates.reaction_s)
    rows = max(round(late_s / dt), 1)
    lowest = np.lib.stride_tricks.sliding_window_view(np.pad(permitted, (0, rows), "edge"), rows + 1).min(
        axis=1
    )
    cap, jerk, w = lowest.tolist(), RATE_USE * float(vehicle.jerk_mps3) * dt, TRACKING_PER_S
    x, v = wanted_m[0], wanted_mps[0]
    a = (wanted_mps[1] - v) / dt
    positions, speeds = [x], [v]
    for k in range(len(wanted_m) - 1):
        rise = (wanted_mps[k + 1] - wanted_mps[k]) / dt
        faster = min(max(0.5 * w * (wanted_m[k] - x), -SLOPE_MPS), SLOPE_MPS)
        most_up = CATCH_UP_MPS2 + CATCH_UP_PER_S2 * max(wanted_m[k] - x, 0.0)
        catching_up = min(2.0 * w * (wanted_mps[k] + faster - v), most_up)
        free = min(rise + catching_up, (cap[k + 1] - v) / late_s)
        a = min(max(free, least[k], a - jerk), most[k], a + jerk)
        after = max(v + a * dt, 0.0)
        x, v = x + 0.5 * (v + after) * dt, after
        positions.append(x)
        speeds.append(v)
    # The end is the own mark, whatever the corrections have left.
    moved = np.array(positions)
    length_m, shift_m = SHIFT_FROM_M - SHIFT_TO_M, position_m[-1] - moved[-1]
    done = np.clip((moved - moved[-1] + SHIFT_FROM_M) / length_m, 0.0, 1.0)
    return ahead._replace(
        position_m=moved + shift_m * done * done * (3.0 - 2.0 * done),
        speed_mps=np.array(speeds) * (1.0 + shift_m * 6.0 * done * (1.0 - done) / length_m),
    )


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
        room = permitted_speed(member.protection, level.position_m) - UNDER_MPS - level.speed_mps
    held = float(member.bounds.held_mps2)
    takes = level.speed_mps[first:] / held + 1.0
    opening = np.minimum(slope, OPENING_SHARE * level.speed_mps[first:])
    window = np.lib.stride_tricks.sliding_window_view
    envelope = window(np.pad(target, reach, "edge"), 2 * reach + 1).max(axis=1)
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
    mean = np.ones(2 * half + 1) / (2 * half + 1)
    for _ in range(3):
        smooth = np.convolve(smooth, mean, "valid")
    # The means round off what is known: the difference fades.
    smooth[:reach] += (known[reach] - smooth[0]) * np.linspace(1.0, 0.0, reach)[: smooth.size]
    return np.concatenate([planned_gap(plan_times(level)[:first]), smooth])


def silence_s(member: Member, dt: float) -> float:
    """Age of messages that a planned gap allows for."""
    loss = float(member.link.loss)
    lost = np.ceil(np.log(LOST_AT_ONCE) / np.log(loss)) * dt if 0.0 < loss < 1.0 else 0.0
    late = float(member.link.delay_s) + float(member.link.jitter_s)
    # A message that is due between two periods is heard in the next.
    return np.ceil(late / dt - 1e-6) * dt + min(lost, LONGEST_SILENCE_S)


def needed_along(
    ahead: MotionPlan, member: Member, length_ahead_m: float, own: MotionPlan
) -> Float[ndarray, " rows"]:
    """Gap at which protection passes the commands of a planned motion, at its rows (NumPy).

    Zero for a trainset without protection.

    Args:
        ahead: Planned motion of the trainset ahead.
        member: The follower.
        length_ahead_m: Length of the trainset ahead.
        own: Planned motion of the follower.
    """
    if member.protection is None:
        return np.zeros(own.position_m.size)
    dt, times = float(own.period_s), plan_times(own)
    age = silence_s(member, dt)
    rise = np.append(np.diff(own.speed_mps), 0.0) / dt
    share = planned_share(member, own, rise)
    watched = at_start(member.protection)
    slots = np.arange(watched.recent.shape[0])
    rows = np.arange(0, times.size, max(round(NEED_STEP_S / dt), 1))
    found = np.zeros(rows.size)
    for i, k in enumerate(rows):
        x, v = own.position_m[k], own.speed_mps[k]
        if v <= 0.0 and share[k] <= 0.0:
            continue
        recent = share[np.maximum(k - slots, 0)]
        memory = watched._replace(
            recent=recent,
            share=recent.max(),
            acceleration_mps2=np.float64(SHARE_FACTOR * max(rise[max(k - 1, 0)], 0.0)),
        )
        heard, before = plan_at(ahead, times[k] - age), plan_at(ahead, times[k] - age - dt)
        # Far ahead, so that every command passes and tells what it leaves.
        message = TrainAhead(
            np.float64(heard.position_m - length_ahead_m + FAR_M),
            np.float64(heard.speed_mps),
            np.float64(before.acceleration_mps2),
            np.float64(age),
            member.bounds,
        )
        spare = spare_gap(member.protection, memory, x, v, share[k], message)
        then = plan_at(ahead, times[k])
        gap = then.position_m - length_ahead_m + FAR_M - x
        found[i] = gap - spare + MARGIN_M + growing_m(member, v, rise[k], v - then.speed_mps)
    return np.interp(times, times[rows], found)


def planned_share(
    member: Member, own: MotionPlan, rise_mps2: Float[ndarray, " rows"]
) -> Float[ndarray, " rows"]:
    """Command that a planned motion may take at its rows, on a trainset that answers weakly (NumPy)."""
    limits = effort_limits(member.believed, member.track, own.position_m, own.speed_mps)
    share = limits.command_for(rise_mps2)
    return np.where(share > 0.0, np.minimum(SHARE_FACTOR * share + SHARE_SPARE, 1.0), share)

"""Gap that protection needs along a planned motion, at any time at which its places are passed."""

from __future__ import annotations

from typing import no_type_check

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Scalar
from metropilot.convoy.model import FAR_M, Member
from metropilot.convoy.plan import MotionPlan, PlannedMotion, plan_at, plan_times
from metropilot.physics import effort_limits, kept_share, namespace
from metropilot.protection import Protection, TrainAhead, at_start, spare_gap

MARGIN_M = 0.4
"""Distance that a planned gap leaves beyond what protection needs."""
SHARE_FACTOR, SHARE_SPARE = 1.05, 0.05
"""Command that protection is asked about over the planned one, which leaves room for corrections."""
LOST_AT_ONCE = 1.1e-3
"""Probability of a run of lost messages that a planned gap need not allow for."""
LONGEST_SILENCE_S = 1.0
NEED_STEP_S = 0.5
"""Time between two instants at which the gap that protection needs is evaluated."""
KINK_S = 0.4
"""Time over which a planned acceleration is averaged: where a plan continues another one it has kinks."""
DELAY_TRIALS, LONGEST_DELAY_S, SAME_S = 5, 8.0, 0.02
"""Steps to the delay that protection needs at a place; the longest; a step that is no longer worth one."""
WORTH, SLOW_SHARE = 0.7, 0.25
"""Share of a lack of gap that a longer delay must bring it to; and speed of the trainset ahead, over the own
one, below which none brings anything."""


def silence_s(member: Member, dt: float) -> float:
    """Age of messages that a planned gap allows for."""
    loss = float(member.link.loss)
    lost = np.ceil(np.log(LOST_AT_ONCE) / np.log(loss)) * dt if 0.0 < loss < 1.0 else 0.0
    late = float(member.link.delay_s) + float(member.link.jitter_s)
    # A message that is due between two periods is heard in the next.
    return np.ceil(late / dt - 1e-6) * dt + min(lost, LONGEST_SILENCE_S)


@no_type_check
def growing_m(
    member: Member, speed_mps: Scalar, acceleration_mps2: Scalar, closing_mps: Scalar, ahead_mps2: Scalar
) -> Scalar:
    """Growth of the gap that protection needs, and loss of the own one, while commands are on their way.

    They cannot be taken back: a speed that rises by ``a`` a second, or that of the trainset ahead that falls
    by ``a``, takes ``v a / b`` more gap a second, at a brake rate ``b``.

    Args:
        member: The trainset.
        speed_mps: Its speed.
        acceleration_mps2: Its acceleration.
        closing_mps: Its speed less that of the trainset ahead.
        ahead_mps2: Acceleration of the trainset ahead; what it gains is not counted on.
    """
    believed = member.believed
    xp = namespace(speed_mps, closing_mps)
    late_s = believed.delay_s + believed.lag_s
    rises_mps2 = xp.maximum(acceleration_mps2 - xp.minimum(ahead_mps2, 0.0), 0.0)
    rate = speed_mps * rises_mps2 / member.bounds.held_mps2 + closing_mps
    return late_s * xp.maximum(rate, 0.0)


class NeededGap:
    """Gap that protection needs at the rows of a planned motion, whenever they are passed (NumPy).

    Attributes:
        protection: Protection of the follower.
        ahead: Planned motion of the trainset ahead.
        member: The follower.
        length_ahead_m: Length of the trainset ahead.
        own: Planned motion of the follower.
    """

    def __init__(
        self,
        protection: Protection,
        ahead: MotionPlan,
        member: Member,
        length_ahead_m: float,
        own: MotionPlan,
    ) -> None:
        self.protection = protection
        self.ahead, self.member, self.length_ahead_m, self.own = ahead, member, length_ahead_m, own
        self.dt = float(own.period_s)
        self.age = silence_s(member, self.dt)
        # Where a plan continues another one its speed has kinks, which are not commands.
        rows = 2 * round(0.5 * KINK_S / self.dt) + 1
        rise = np.pad(np.append(np.diff(own.speed_mps), 0.0) / self.dt, rows // 2, "edge")
        self.rise = np.convolve(rise, np.ones(rows) / rows, "valid")
        self.share = planned_share(member, own, self.rise)
        self.watched = at_start(protection)
        self.slots = np.arange(self.watched.recent.shape[0])

    def gaps_m(self, k: int, time_s: float) -> tuple[float, float, PlannedMotion]:
        """Needed gap, gap, and motion of the trainset ahead when a row is passed at a time."""
        x, v, rise = self.own.position_m[k], self.own.speed_mps[k], self.rise
        then = plan_at(self.ahead, time_s)
        gap = then.position_m - self.length_ahead_m - x
        if v <= 0.0 and self.share[k] <= 0.0:
            return 0.0, gap, then
        recent = self.share[np.maximum(k - self.slots, 0)]
        memory = self.watched._replace(
            recent=recent,
            share=recent.max(),
            acceleration_mps2=np.float64(SHARE_FACTOR * max(rise[max(k - 1, 0)], 0.0)),
        )
        heard, before = (plan_at(self.ahead, time_s - self.age - late) for late in (0.0, self.dt))
        # Far ahead, so that every command passes and tells what it leaves.
        message = TrainAhead(
            np.float64(heard.position_m - self.length_ahead_m + FAR_M),
            np.float64(heard.speed_mps),
            np.float64(before.acceleration_mps2),
            np.float64(self.age),
            self.member.bounds,
        )
        # It takes the speed as measured, with an error that it allows for once more.
        measured = v + self.protection.rates.speed_error_mps
        spare = spare_gap(self.protection, memory, x, measured, self.share[k], message)
        growing = growing_m(self.member, v, rise[k], v - then.speed_mps, then.acceleration_mps2)
        needed = gap + FAR_M - spare + MARGIN_M + growing
        return needed, gap, then

    def along_m(self) -> Float[ndarray, " rows"]:
        """Needed gap at the rows at their own times."""
        times = plan_times(self.own)
        rows = range(0, times.size, max(round(NEED_STEP_S / self.dt), 1))
        return np.interp(times, times[rows], [self.gaps_m(k, float(times[k]))[0] for k in rows])


def planned_share(
    member: Member, own: MotionPlan, rise_mps2: Float[ndarray, " rows"]
) -> Float[ndarray, " rows"]:
    """Command that a planned motion may take at its rows, on a trainset that answers weakly (NumPy)."""
    limits = effort_limits(member.believed, member.track, own.position_m, own.speed_mps)
    kept = kept_share(member.believed.lag_s, own.period_s)
    before = np.concatenate([rise_mps2[:1], rise_mps2[:-1]])
    share = limits.command_for((rise_mps2 - kept * before) / (1.0 - kept))
    return np.where(share > 0.0, np.minimum(SHARE_FACTOR * share + SHARE_SPARE, 1.0), share)


def delay_along(need: NeededGap, row: int) -> Float[ndarray, " rows"]:
    """Delay behind a motion with which protection passes its commands, at its rows (NumPy).

    Args:
        need: Gap that it needs along the motion.
        row: Row from which on it matters.
    """
    times, held = plan_times(need.own), float(need.member.bounds.held_mps2)
    rows = range(row, times.size, max(round(NEED_STEP_S / need.dt), 1))
    found, delay = [], 0.0
    for k in rows:
        lack_m = np.inf
        for _ in range(DELAY_TRIALS):
            needed, gap, then = need.gaps_m(k, float(times[k]) + delay)
            nearly_stands = then.speed_mps < SLOW_SHARE * need.own.speed_mps[k] and needed > gap
            if nearly_stands or (then.acceleration_mps2 < 0.0 and needed - gap > WORTH * lack_m):
                # The trainset ahead stops meanwhile: waiting longer brings no gap.
                break
            lack_m = max(needed - gap, 0.0)
            # A trainset ahead that has become faster meanwhile needs less gap behind it, too.
            per_s = then.speed_mps * (1.0 + max(then.acceleration_mps2, 0.0) / held)
            before, delay = delay, min(max(delay + (needed - gap) / max(per_s, 1.0), 0.0), LONGEST_DELAY_S)
            if abs(delay - before) < SAME_S:
                break
        found.append(delay)
    return np.interp(times, times[rows], found)

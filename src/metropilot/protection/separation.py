"""Relative-distance protection: whether the brake keeps a follower clear of the trainset ahead, over time.

The trainset ahead may brake from its last message on, as hard and as suddenly as declared; the follower does
what its command may do within its own bounds, and its emergency brake is decided one period later. Both are
motions whose acceleration only falls (held, then ramped down, then held), so both have a closed form, and the
gap between them is compared at every moment it can be smallest. A fixed end of authority is a curve over
distance; this is the same authority moving.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import NamedTuple, no_type_check

import numpy as np

from metropilot._typing import Array, Float, Scalar
from metropilot.errors import InputError
from metropilot.physics import namespace, scalars

NODES = np.arange(24) / 23.0
"""Instants at which the gap is checked while either brake still builds up, as a share of that time."""
AT_ONCE = 1e4
SLOWEST_MPS2 = 0.02


class Separation(NamedTuple):
    """Declared bounds of a follower and the trainset ahead of it. All 0-d.

    Attributes:
        leader_mps2: Strongest deceleration of the trainset ahead, gradient and resistance included.
        leader_jerk_mps3: Fastest change of its acceleration (a large finite number where it is immediate).
        held_mps2: Deceleration that the follower's emergency brake is sure to give anywhere on the section.
        period_s: Control period: the trainset ahead holds an acceleration for so long.
        margin_m: Distance never to be used up: errors of both positions, rounding.
        room_m: So much more must be left for a command to pass; the service brake then comes before the
            emergency brake. Nothing of the guarantee rests on it.
        speed_error_mps: Largest error of the speed in a message of the trainset ahead.
    """

    leader_mps2: Scalar
    leader_jerk_mps3: Scalar
    held_mps2: Scalar
    period_s: Scalar
    margin_m: Scalar
    room_m: Scalar
    speed_error_mps: Scalar


class TrainAhead(NamedTuple):
    """Last message of the trainset ahead, and its declared bounds. All 0-d.

    Attributes:
        rear_m: Its rear, in the follower's own positions, when the message was sent.
        speed_mps: Its speed then, as it measured it.
        acceleration_mps2: Its acceleration over the period before.
        age_s: Age of the message.
        bounds: Declared bounds.
    """

    rear_m: Scalar
    speed_mps: Scalar
    acceleration_mps2: Scalar
    age_s: Scalar
    bounds: Separation


@dataclass(frozen=True)
class PairBounds:
    """Declared bounds of a pair; the default is a moving block (the trainset ahead may stand at once).

    Attributes:
        leader_mps2: Strongest deceleration of the trainset ahead, gradient and resistance included; infinite:
            it may stand where it last was (moving block).
        leader_jerk_mps3: Fastest change of its acceleration.
        scatter_mps2: Shortfall of the follower's emergency brake against the rate asked for.
        margin_m: Distance never to be used up.
        room_m: Distance left on top of it that lets a command pass.
        speed_error_mps: Largest error of the speed that the trainset ahead measures and sends.
    """

    leader_mps2: float = float("inf")
    leader_jerk_mps3: float = float("inf")
    scatter_mps2: float = 0.01
    margin_m: float = 0.1
    room_m: float = 0.3
    speed_error_mps: float = 0.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            positive = name in {"leader_mps2", "leader_jerk_mps3"}
            if not (value > 0 if positive else 0 <= value < float("inf")):
                allowed = "> 0" if positive else ">= 0, finite"
                raise InputError("out of range", field=name, value=value, allowed=allowed)


def separate(pair: PairBounds, period_s: float, held_mps2: float, dtype: type = np.float64) -> Separation:
    """The declared bounds of a pair as numbers for the supervisor (NumPy).

    Args:
        pair: Declared bounds.
        period_s: Control period.
        held_mps2: Deceleration that the follower's emergency brake gives on the steepest fall of the section.
        dtype: Number type.

    Raises:
        InputError: The emergency brake hardly holds the follower.
    """
    held = held_mps2 - pair.scatter_mps2
    if held < SLOWEST_MPS2:
        raise InputError(
            "the emergency brake does not hold on the steepest fall",
            field="held_mps2",
            value=held,
            unit="m/s^2",
            allowed=f"at least {SLOWEST_MPS2:g} m/s^2 left",
        )
    values = (
        min(pair.leader_mps2, AT_ONCE),
        min(pair.leader_jerk_mps3, AT_ONCE),
        held,
        period_s,
        pair.margin_m,
        pair.room_m,
        pair.speed_error_mps,
    )
    return Separation(*(dtype(value) for value in values))


class Braking(NamedTuple):
    """A motion that only brakes: acceleration held, then falling at a jerk, then held to the stop. All 0-d.

    Attributes:
        speed_mps: Speed at first.
        steady_mps2: Acceleration held at first, at least ``-rate_mps2``.
        reaction_s: For how long.
        jerk_mps3: Rate at which it falls then.
        rate_mps2: Deceleration in the end.
        built_s: Time at which that is reached.
        stop_s: Time of the standstill.
    """

    speed_mps: Scalar
    steady_mps2: Scalar
    reaction_s: Scalar
    jerk_mps3: Scalar
    rate_mps2: Scalar
    built_s: Scalar
    stop_s: Scalar


@no_type_check
def brake_motion(
    speed_mps: Scalar, steady_mps2: Scalar, reaction_s: Scalar, jerk_mps3: Scalar, rate_mps2: Scalar
) -> Braking:
    """A motion and the moment it ends, in closed form."""
    xp = namespace(speed_mps, steady_mps2, rate_mps2)
    rate = xp.maximum(rate_mps2, SLOWEST_MPS2)
    steady = xp.maximum(steady_mps2, -rate)
    ramp = (steady + rate) / jerk_mps3
    after = speed_mps + steady * reaction_s
    built = after + (0.5 * (steady - rate)) * ramp
    early = speed_mps / xp.maximum(-steady, 1e-6)
    middle = (steady + (xp.maximum(steady * steady + 2.0 * jerk_mps3 * after, 0.0)) ** 0.5) / jerk_mps3
    late = reaction_s + ramp + xp.maximum(built, 0.0) / rate
    stop = xp.where(after <= 0, early, xp.where(built <= 0, reaction_s + middle, late))
    return Braking(speed_mps, steady, reaction_s, jerk_mps3, rate, reaction_s + ramp, stop)


@no_type_check
def distance_at(motion: Braking, time_s: Float[Array, " times"]) -> Float[Array, " times"]:
    """Distance covered by each moment, m."""
    xp = namespace(time_s, motion.speed_mps)
    t = xp.clip(time_s, 0.0, motion.stop_s)
    ramped = xp.clip(t - motion.reaction_s, 0.0, motion.built_s - motion.reaction_s)
    held = xp.maximum(t - motion.built_s, 0.0)
    ramp = motion.built_s - motion.reaction_s
    straight = t * (motion.speed_mps + 0.5 * motion.steady_mps2 * t)
    bent = motion.jerk_mps3 * ramped * ramped * (ramped / 6.0)
    beyond = motion.jerk_mps3 * ramp * held * (0.5 * ramp + 0.5 * held)
    return straight - bent - beyond


@no_type_check
def speed_at(motion: Braking, time_s: Scalar) -> Scalar:
    """Speed at a moment, m/s."""
    xp = namespace(time_s, motion.speed_mps)
    ramped = xp.clip(time_s - motion.reaction_s, 0.0, motion.built_s - motion.reaction_s)
    held = xp.maximum(time_s - motion.built_s, 0.0)
    ramp = motion.built_s - motion.reaction_s
    gone = motion.jerk_mps3 * (0.5 * ramped * ramped + ramp * held)
    return xp.maximum(motion.speed_mps + motion.steady_mps2 * time_s - gone, 0.0)


@no_type_check
def leader_motion(ahead: TrainAhead) -> Braking:
    """The hardest the trainset ahead can brake from its message on.

    It holds an acceleration for a whole period, so the fall has a period's head start.
    """
    bounds = ahead.bounds
    xp = namespace(ahead.rear_m, ahead.age_s)
    worst = ahead.acceleration_mps2 - bounds.leader_jerk_mps3 * bounds.period_s
    worst = xp.maximum(worst, -bounds.leader_mps2)
    zero = 0.0 * ahead.speed_mps
    speed = xp.maximum(ahead.speed_mps - bounds.speed_error_mps, 0.0)
    return brake_motion(speed, worst, zero, bounds.leader_jerk_mps3, bounds.leader_mps2)


@no_type_check
def least_gap(ahead: TrainAhead, position_m: Scalar, following: Braking) -> Scalar:
    """Smallest gap on the way to standstill if both brake: leader at its hardest, follower nominally.

    While a brake builds up the gap is looked at on a grid, and what it can dip in between is taken off; from
    then on it is a parabola until one of them stands, and shrinks only while the follower still moves.

    Args:
        ahead: The trainset ahead.
        position_m: Head of the follower.
        following: Fastest motion of the follower.
    """
    xp = namespace(ahead.rear_m, position_m, following.speed_mps)
    leader = leader_motion(ahead)
    building = xp.maximum(xp.maximum(following.built_s, leader.built_s - ahead.age_s), 0.0)
    gain = leader.rate_mps2 - following.rate_mps2
    closing = speed_at(following, building) - speed_at(leader, building + ahead.age_s)
    equal = building + xp.maximum(closing, 0.0) / xp.maximum(-gain, 1e-3)
    single = xp is scalars
    join = np if single else xp
    late = join.stack([equal, following.stop_s, xp.maximum(leader.stop_s - ahead.age_s, 0.0)])
    times = join.concatenate([NODES.astype(late.dtype) * building, late])
    gaps = (
        ahead.rear_m - position_m + distance_at(leader, times + ahead.age_s) - distance_at(following, times)
    )
    step = building * float(NODES[1])
    dip = 0.125 * step * step * (xp.maximum(leader.steady_mps2, 0.0) + following.rate_mps2)
    return gaps.min() - dip

"""Two assists of a policy: station-stop braking, and the speed ceiling below protection.

With the stop assist a policy decides on traction, speed holding, coasting and early braking; the station-stop
braking follows the stop curve: build up a deceleration at the jerk limit, hold it, and release it at a lower
jerk to a small deceleration at standstill (the closed forms of :mod:`metropilot.control.stopping`). The
ceiling assist reduces traction, and brakes, before protection would intervene. Both are pure functions over
the array namespace, the same in the compiled task and on the host.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from metropilot._schema import CheckedFields, declare
from metropilot._typing import Flag, Index, Scalar
from metropilot.control import (
    AT_ONCE_MPS3,
    STRONGEST_MPS2,
    StopOptions,
    braking_distance,
    build_up,
    closing_acceleration,
    curve_for,
    motion_if_braked_later,
    reachable_deceleration,
    stop_deceleration,
)
from metropilot.env.features import FeatureContext
from metropilot.env.tables import LEAST_STOP_MPS2, PERMITTED_COLUMN, STOP_USE, SectionRows
from metropilot.physics import scalars

LET_GO_SHARE = 0.75
"""Below this share of the planned deceleration a station stop of continuous effort began too early."""
LAST_M = 1.0
"""Nearer to the stop than this the station stop is not given up again."""
HARD_MPS2, PULLS_MORE = 0.8, 1.15
"""Traction per mass from which it counts that protection expects so much more of it than there is: that of a
lower speed, besides that of the lightest trainset."""
SHORTEST_M = 0.5
SHARED_M = 10.0
"""Nearer to the stop the deceleration asked for is what it is."""


@dataclass(frozen=True)
class Assists(CheckedFields):
    """Assists of a task.

    Attributes:
        stop: Station-stop braking.
        ceiling: Ceiling below the permitted speed and the acceleration limit.
        margin_mps: Margin below the permitted speed, m/s.
        stop_mps2: Deceleration of station-stop braking; 0: the one surely available at any speed, which is
            small for a brake that fades at high speed even where a low limit precedes the stop.
        stop_use: Share of the surely available deceleration that station-stop braking is planned with.
        release: Jerk of the brake release, over the trainset's limit; a lower one takes longer.
        let_go: Share of the planned deceleration below which the station stop began too early, and the policy
            drives on. Where brakes have few notches, the one that suffices may be much stronger.
        late: Brake as late as the brakes surely allow: station-stop braking is planned with the gradient at
            each position instead of the worst one, and may begin within a period; the speed stays low
            enough to brake for a lower ceiling ahead.
    """

    stop: bool = True
    ceiling: bool = True
    margin_mps: float = declare(0.15, low=0.0, high=5.0)
    stop_mps2: float = declare(0.0, low=0.0, high=STRONGEST_MPS2)
    stop_use: float = declare(STOP_USE, low=0.1, high=1.0)
    release: float = declare(0.5, low=0.1, high=1.0)
    let_go: float = declare(LET_GO_SHARE, low=0.0, high=1.0)
    late: bool = False

    @property
    def work_share(self) -> float:
        """Share of the brakes' work along the way that station-stop braking takes; 0 unless it is late."""
        return self.stop_use if self.late else 0.0

    @property
    def below_mps(self) -> float:
        """Speed by which the trainset stays below the permitted one, m/s; 0 where nothing keeps it there."""
        return self.margin_mps if self.ceiling else 0.0

    def ceiling_at(self, rows: SectionRows, case: Index, position_m: Scalar) -> Scalar:
        """The speed to keep under at one or many positions, m/s.

        Args:
            rows: The task's tables.
            case: Row of the case.
            position_m: Where.
        """
        if self.late:
            return rows.follow_at(case, position_m)
        return rows.curve_at(PERMITTED_COLUMN, case, position_m)

    def planned_mps2(self, rows: SectionRows, case: Index, sure_mps2: Scalar, position_m: Scalar) -> Scalar:
        """Deceleration to plan the last braking with from a position.

        Args:
            rows: The task's tables.
            case: Row of the case.
            sure_mps2: That of its row, which was built for ``STOP_USE``.
            position_m: Where.
        """
        if not self.late:
            return sure_mps2 * (self.stop_use / STOP_USE)
        xp = rows.namespace(position_m)
        position_m = xp.minimum(position_m, rows.length_m[case] - SHORTEST_M)
        left_m = rows.length_m[case] - position_m
        work, _ = rows.stop_at(case, position_m)
        return self.stop_use * xp.maximum(work / left_m, LEAST_STOP_MPS2)


@lru_cache
def stop_options(release_share: float) -> StopOptions:
    """Constants of the station stop with which the shipped policies were trained.

    The final deceleration is larger than that of host drivers, as the state is known exactly here; the
    policy gains the time that this saves.

    Args:
        release_share: Jerk at which the brake is released, over the trainset's limit.
    """
    return StopOptions(
        release_share=release_share,
        end_share=0.8,
        drop_share=0.9,
        at_once_gain=0.0,
        push_m=0.0,
        hold_mps2=0.3,
        creep_m=0.05,
        passes=2,
        newton_steps=3,
    )


def apply_assists(
    assists: Assists, context: FeatureContext, command: Scalar, stopping: Flag, dt: float
) -> tuple[Scalar, Flag]:
    """The command after the assists, and whether the last braking is on.

    Args:
        assists: Which.
        context: What the driver sees.
        command: The policy's command.
        stopping: Whether the last braking was on.
        dt: Control period, s.
    """
    if not (assists.stop or assists.ceiling):
        return command, stopping
    xp, limits = context.xp, context.effort_limits
    if assists.stop_mps2 > 0.0:
        context = context._replace(stop_mps2=assists.stop_mps2 + 0.0 * context.speed_mps)
    ceiling = command
    if assists.ceiling:
        ceiling = limits.command_for(ceiling_mps2(assists, context, dt))
        command = xp.minimum(command, ceiling)
    if assists.stop:
        options = stop_options(assists.release)
        stopping, wanted = stop_mps2(context, stopping, dt, options, assists.let_go)
        if xp is scalars and not stopping:
            return command, False
        entering = False
        if assists.late:
            wanted, entering = late_mps2(assists, context, wanted, dt)
        stop = limits.command_for(-wanted)
        highest = xp.minimum(stop, ceiling) if assists.ceiling else stop
        highest = xp.where(entering, xp.minimum(highest, command), highest)
        command = xp.where(stopping, highest, command)
    return command, stopping


def ceiling_mps2(assists: Assists, context: FeatureContext, dt: float, *, asked: bool = False) -> Scalar:
    """Largest acceleration that protection lets pass and the trainset's limits allow.

    An acceleration must stop in time for the reaction of the emergency brake even if the trainset is as
    light as the bounds allow (:func:`metropilot.protection.approach_margin`).

    Args:
        assists: Which; their margin is kept.
        context: What the driver sees.
        dt: Control period, s.
        asked: True if protection itself is asked about the command besides.
    """
    xp, rates = context.xp, context.rates
    v, x = context.speed_mps, context.position_m
    spread = rates.mass_high / rates.mass_low

    def ceiling(at: Scalar) -> Scalar:
        return assists.ceiling_at(context.rows, context.case, at) - assists.margin_mps - rates.speed_error_mps

    jerk = xp.minimum(context.vehicle.jerk_mps3, AT_ONCE_MPS3)
    ahead_s = dt + rates.reaction_s + 1.0 / jerk
    near = xp.minimum(ceiling(x), ceiling(x + v * dt)) - v
    later = ceiling(x + v * ahead_s) - v
    rise = xp.maximum(xp.minimum(near, later), 0.0)
    upward = closing_acceleration(rise, dt + spread * rates.reaction_s, jerk)
    if assists.late and not asked:
        # it keeps closer to the permitted speed than others
        hard = context.effort_limits.traction_mps2 > HARD_MPS2
        most = _undone_mps2(context, rise + assists.margin_mps)
        upward = xp.where(hard, xp.minimum(upward, most), upward)
    downward = xp.minimum(xp.minimum(near / dt, later / ahead_s), 0.0)
    return xp.minimum(upward + downward, context.vehicle.max_acceleration_mps2)


def _undone_mps2(context: FeatureContext, room_mps: Scalar) -> Scalar:
    """Largest acceleration that the emergency brake undoes in a room below the permitted speed."""
    xp, rates = context.xp, context.rates
    pulls, reaction_s = PULLS_MORE / rates.mass_low, rates.reaction_s
    # the permitted speed leaves room for the traction that holds a speed
    holds_mps2 = xp.maximum(context.effort_limits.drag_mps2, 0.0)
    room_mps = room_mps + reaction_s * pulls * holds_mps2
    root_s = xp.sqrt(reaction_s * reaction_s + 2.0 * room_mps / rates.jerk_mps3)
    return rates.jerk_mps3 * (root_s - reaction_s) / pulls - holds_mps2


def stop_mps2(
    context: FeatureContext, stopping: Flag, dt: float, options: StopOptions, let_go: float
) -> tuple[Flag, Scalar]:
    """State of the station stop, and the deceleration it needs now, m/s^2.

    Args:
        context: What the driver sees.
        stopping: Whether it was on.
        dt: Control period, s.
        options: Constants of the stop.
        let_go: See :class:`Assists`.
    """
    xp, vehicle = context.xp, context.vehicle
    v, a, s = context.speed_mps, context.acceleration_mps2, context.length_m - context.position_m
    planned = context.stop_mps2
    curve = curve_for(vehicle, dt, planned, options)
    limits = context.effort_limits
    most = limits.traction_mps2 - limits.drag_mps2
    then, grown, way_m = motion_if_braked_later(v, a, most, curve, dt, options)
    reached = xp.minimum(planned, reachable_deceleration(then, grown, curve))
    quick, gone, _ = build_up(then, grown, reached, curve.build_jerk_mps3)
    begins = s <= gone + braking_distance(quick, curve) + xp.maximum(way_m, 0.0)
    if xp is scalars and not (stopping or begins):
        # one state on the host, far from the stop: nothing of the rest would be used
        return False, 0.0
    short = (v <= 0) & (s > options.inch_m)
    demand = stop_deceleration(v, a, s, curve, dt, options)
    early = (demand.required_mps2 < let_go * planned) & (demand.falling_mps3 <= 0) & (s > LAST_M)
    stopping = (stopping & (early ^ True) | begins) & (short ^ True)
    return stopping, xp.where(v > 0, demand.wanted_mps2, options.hold_mps2)


def late_mps2(assists: Assists, context: FeatureContext, wanted: Scalar, dt: float) -> tuple[Scalar, Flag]:
    """The deceleration that follows what the gradient leaves at each place, m/s^2; whether it only begins.

    Without a jerk limit it is the one that is on the stop curve at the end of the period, ``v'^2 = 2 b s'``
    with ``v' = v - a dt``: small in the period in which the braking begins, and on the curve from then on.
    With one, the deceleration asked for is shared out as the brakes can give it.

    Args:
        assists: How the last braking is planned.
        context: What the driver sees.
        wanted: What a constant deceleration would be.
        dt: Control period, s.
    """
    xp, v, planned = context.xp, context.speed_mps, context.stop_mps2
    s = context.length_m - context.position_m
    _, able = context.rows.stop_at(context.case, context.position_m + 0.5 * v * dt)
    shape = xp.where(s > SHARED_M, xp.clip(assists.stop_use * able / planned, 0.5, 2.0), 1.0)
    room, turn = 2.0 * s - v * dt, planned * dt
    after = 0.5 * (xp.sqrt(turn * turn + 4.0 * planned * xp.maximum(room, 0.0)) - turn)
    onto = xp.clip((v - after) / dt, 0.0, STRONGEST_MPS2)
    at_once = (context.vehicle.jerk_mps3 >= AT_ONCE_MPS3) & (v > turn) & (room > v * dt)
    found = shape * xp.where(at_once, onto, wanted)
    return xp.where(v > 0, found, wanted), at_once & (onto < LET_GO_SHARE * planned)

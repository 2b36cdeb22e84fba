"""Coupling and uncoupling on the move: their records in a run, and the check that there is room for them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy import ndarray

from metropilot._typing import Bool, Float
from metropilot.convoy.model import Convoy, Member
from metropilot.convoy.place import place_behind
from metropilot.convoy.plan import MotionPlan
from metropilot.errors import Infeasible
from metropilot.physics import resistance_and_gradient, track_arrays, vehicle_arrays
from metropilot.units import J_PER_KWH

if TYPE_CHECKING:
    from metropilot.convoy.rollout import ConvoyDrive

BAND_M, BAND_MPS = 0.5, 0.2
"""Errors of gap and speed within which trainsets count as coupled; of the gap, as parted."""
HOLD_S = 3.0
"""Time for which they must stay within them."""
MOVES_MPS = 1.0
"""Least speed at which a planned gap must be closed: coupled on the move."""
FAR_TIMES = 10.0
"""Ways longer than so many times the room are not told in metres."""
TRIALS = 6
"""Halvings that find the largest gap, or the first place, that there is room for."""

LAST_SHARE = 0.9
"""Last place that is proposed instead of one too early, over the length of the section."""

ManoeuvreKind = Literal["coupling", "uncoupling"]


@dataclass(frozen=True)
class Manoeuvre:
    """Coupling or uncoupling of one follower on the move. Positions are fronts of the trainset ahead of it.

    Attributes:
        kind: ``coupling`` or ``uncoupling``.
        trainset: Number of the follower; 1 is the head.
        begun_s: Time since departure at which the gap begins to close, or to open from what is needed before.
        done_s: Time from which, for ``HOLD_S`` and while both it and the trainset ahead move, a gap is closed
            within ``BAND_M`` and the speed difference within ``BAND_MPS``; or is open within ``BAND_M``, and
            up to the place. None: never.
        begun_m: Position at the beginning.
        done_m: Position when it is done; None: never.
        place_m: Place by which it must be done; None for a coupling, which must be done before the stop.
        gap_from_m: Gap at the beginning.
        gap_to_m: Goal.
        gap_min_m: Smallest gap of the manoeuvre.
        speed_difference_max_mps: Largest speed difference.
        max_jerk_mps3: Largest jerk of the follower.
        energy_kwh: Traction energy of the follower at the wheel during the manoeuvre.
        apart_energy_kwh: Traction energy that it would have needed in the same time at the gap of the
            beginning, with the speeds of the head.
    """

    kind: ManoeuvreKind
    trainset: int
    begun_s: float
    done_s: float | None
    begun_m: float
    done_m: float | None
    place_m: float | None
    gap_from_m: float
    gap_to_m: float
    gap_min_m: float
    speed_difference_max_mps: float
    max_jerk_mps3: float
    energy_kwh: float
    apart_energy_kwh: float

    @property
    def in_time(self) -> bool:
        """True if it was done before the stop, or by its place."""
        if self.done_m is None:
            return False
        return self.place_m is None or self.done_m <= self.place_m


def couples(convoy: Convoy) -> bool:
    """Tell if a convoy is to couple on the move."""
    return convoy.first_gap_m > convoy.gap_m + BAND_M


def uncouples(drive: ConvoyDrive, k: int) -> bool:
    """Tell if a follower had to uncouple in a run: the trainset ahead has passed the place."""
    return float(drive.trajectories[k - 1].position_m[-1]) >= drive.convoy.uncouple_at_m


def find_manoeuvres(drive: ConvoyDrive) -> tuple[Manoeuvre, ...]:
    """Find the couplings and uncouplings of a run, follower by follower.

    Args:
        drive: The run.
    """
    found, convoy = [], drive.convoy
    for k in range(1, len(convoy.trainsets)):
        gap, last = drive.gap_m[:, k - 1], _last_moving(drive, k)
        first = 0
        if couples(convoy):
            alike = np.abs(drive.speed_difference_mps[:, k - 1]) <= BAND_MPS
            done = _first_held((gap <= convoy.gap_m + BAND_M) & alike, 0, last, convoy.dt)
            begun = max(int(np.argmax(np.abs(gap - gap[0]) > BAND_M)) - 1, 0)
            found.append(_manoeuvre(drive, "coupling", k, begun, done, last))
            first = done or 0
        if uncouples(drive, k):
            # Where protection needs more for a while, an open gap goes on to open, and closes again: the
            # difference of speeds says nothing. But it is open at the place, and has been since it was done.
            ahead, is_open = drive.trajectories[k - 1], gap >= convoy.apart_m - BAND_M
            at_m = np.interp(drive.time_s, ahead.time_s, ahead.position_m)
            place = int(np.searchsorted(at_m, convoy.uncouple_at_m))
            opened = first + int(np.flatnonzero(~is_open[first : place + 1]).max(initial=-1)) + 1
            done = _first_held(is_open, opened, last, convoy.dt)
            opens = gap[first : 1 + (last if done is None else done)]
            begun = first + _last_held(opens, max(round(HOLD_S / convoy.dt), 1))
            found.append(_manoeuvre(drive, "uncoupling", k, begun, done, last))
    return tuple(found)


def _last_moving(drive: ConvoyDrive, k: int) -> int:
    """Last row of the gaps in which both a trainset and the one ahead move."""
    ends_s = float("inf")
    for each in drive.trajectories[k - 1 : k + 1]:
        moving = each.time_s[each.speed_mps > 0.0]
        ends_s = min(ends_s, float(moving[-1]) if moving.size else 0.0)
    return max(int(np.searchsorted(drive.time_s, ends_s + 1e-6)) - 1, 0)


def _first_held(within: Bool[ndarray, " rows"], first: int, last: int, dt: float) -> int | None:
    """First row from which a condition holds for ``HOLD_S``; None: there is none between two rows."""
    rows = max(round(HOLD_S / dt), 1)
    if last - first < rows:
        return None
    held = np.lib.stride_tricks.sliding_window_view(within[first : last + 1], rows).all(axis=1)
    return first + int(held.argmax()) if held.any() else None


def _last_held(gap_m: Float[ndarray, " rows"], rows: int) -> int:
    """Last row before a gap is half open at which it has not opened for so many rows.

    Protection may have opened it before, by metres, when the convoy departed or met a fall.
    """
    earlier = np.concatenate([np.full(min(rows, gap_m.size), gap_m[0]), gap_m[:-rows]])
    held = gap_m - earlier <= BAND_M
    half = gap_m <= 0.5 * (gap_m.min() + gap_m[-1])
    return int(np.flatnonzero(held & half).max(initial=0))


def _manoeuvre(
    drive: ConvoyDrive, kind: ManoeuvreKind, k: int, begun: int, done: int | None, last: int
) -> Manoeuvre:
    """Record of one manoeuvre between two rows of the gaps."""
    convoy, ahead, own = drive.convoy, drive.trajectories[k - 1], drive.trajectories[k]
    end = last if done is None else done
    began_s, ends_s = float(drive.time_s[begun]), float(drive.time_s[end])
    rows = slice(begun, end + 1)
    within = (own.time_s >= began_s) & (own.time_s <= ends_s)
    spent_j = np.interp([began_s, ends_s], own.time_s, own.energy_wheel_j)
    at_m = np.interp([began_s, ends_s], ahead.time_s, ahead.position_m)
    coupling = kind == "coupling"
    return Manoeuvre(
        kind=kind,
        trainset=k + 1,
        begun_s=began_s,
        done_s=None if done is None else ends_s,
        begun_m=float(at_m[0]),
        done_m=None if done is None else float(at_m[1]),
        place_m=None if coupling else convoy.uncouple_at_m,
        gap_from_m=float(drive.gap_m[begun, k - 1]),
        gap_to_m=convoy.gap_m if coupling else convoy.apart_m,
        gap_min_m=float(drive.gap_m[rows, k - 1].min()),
        speed_difference_max_mps=float(np.abs(drive.speed_difference_mps[rows, k - 1]).max()),
        max_jerk_mps3=float(np.abs(own.jerk_mps3[within]).max(initial=0.0)),
        energy_kwh=float(spent_j[1] - spent_j[0]) / J_PER_KWH,
        apart_energy_kwh=keeping_energy_j(drive, k, began_s, ends_s) / J_PER_KWH,
    )


def keeping_energy_j(drive: ConvoyDrive, k: int, begun_s: float, done_s: float) -> float:
    """Traction energy of a trainset at the wheel if it kept its distance to the head, J.

    The true plant moves with the speeds of the head, at the distance of the beginning.

    Args:
        drive: The run.
        k: The trainset; 0 is the head.
        begun_s: Beginning of the time that counts.
        done_s: Its end.
    """
    convoy, head, own = drive.convoy, drive.trajectories[0], drive.trajectories[k]
    disturbance = convoy.disturbance(k)
    trainset = disturbance.nominal(convoy.trainsets[k])
    vehicle = vehicle_arrays(disturbance.true_plant(trainset))
    track = track_arrays(convoy.section, trainset)
    behind_m = np.interp(begun_s, head.time_s, head.position_m) - np.interp(
        begun_s, own.time_s, own.position_m
    )
    resistance, gradient = resistance_and_gradient(vehicle, track, head.position_m - behind_m, head.speed_mps)
    traction = np.maximum(vehicle.effective_mass_kg * head.acceleration_mps2 + resistance + gradient, 0.0)
    work_j = np.append(0.0, np.cumsum(traction[:-1] * np.diff(head.position_m)))
    spent_j = np.interp([begun_s, done_s], head.time_s, work_j)
    return float(spent_j[1] - spent_j[0])


def check_manoeuvres(convoy: Convoy, members: Sequence[Member], head: MotionPlan) -> None:
    """Refuse a convoy that has no room to couple before the stop, or to uncouple before its place.

    The room is that of the planned motions, with a perfect link.

    Args:
        convoy: The convoy.
        members: Its trainsets as arrays.
        head: Planned motion of the head.

    Raises:
        Infeasible: No room; the message says how much there is, and how much is needed.
    """
    if couples(convoy):
        _check_coupling(convoy, members, head)
    if np.isfinite(convoy.uncouple_at_m):
        _check_uncoupling(convoy, members, head)


def plan_followers(members: Sequence[Member], head: MotionPlan, first_gap_m: float) -> list[MotionPlan]:
    """Planned motions of a head and its followers, from a gap at departure."""
    plans = [head]
    for before, member in pairwise(members):
        length_m = float(before.length_m)
        plans.append(
            place_behind(
                plans[-1], member, length_m, float(head.start_s), lambda t: np.full(np.shape(t), first_gap_m)
            )
        )
    return plans


def _gaps(
    members: Sequence[Member], plans: Sequence[MotionPlan]
) -> Iterator[tuple[MotionPlan, Float[ndarray, " rows"]]]:
    """Planned motion of the trainset ahead, and planned gap behind it till it stands, of each follower."""
    for before, (ahead, own) in zip(members, pairwise(plans), strict=False):
        rows = ahead.position_m.size
        yield ahead, ahead.position_m - float(before.length_m) - own.position_m[:rows]


def _least_gaps(
    convoy: Convoy, members: Sequence[Member], head: MotionPlan, first_gap_m: float
) -> list[float]:
    """Smallest planned gap of each follower that is held before the stop or the place (``HOLD_S``)."""
    plans = plan_followers(members, head, first_gap_m)
    found = []
    for ahead, gap in _gaps(members, plans):
        moving = gap[(ahead.speed_mps > MOVES_MPS) & (ahead.position_m < convoy.uncouple_at_m)]
        rows = min(max(round(HOLD_S / convoy.dt), 1), moving.size)
        found.append(float(np.lib.stride_tricks.sliding_window_view(moving, rows).max(axis=1).min()))
    return found


def _check_coupling(convoy: Convoy, members: Sequence[Member], head: MotionPlan) -> None:
    least_m = max(_least_gaps(convoy, members, head, convoy.first_gap_m))
    if least_m <= convoy.gap_m + BAND_M:
        return
    largest_m = _last_that(
        lambda gap_m: max(_least_gaps(convoy, members, head, gap_m)) <= convoy.gap_m + BAND_M,
        convoy.gap_m,
        convoy.first_gap_m,
    )
    place_m = min(convoy.uncouple_at_m, convoy.section.length_m)
    before = "it uncouples" if place_m < convoy.section.length_m else "the stop"
    room_m = place_m * (convoy.first_gap_m - convoy.gap_m) / max(convoy.first_gap_m - least_m, 1.0)
    # A gap that hardly closes here says nothing about the way it takes elsewhere.
    takes = f"about {_round_up(room_m)} m of way" if room_m < FAR_TIMES * place_m else "much more way"
    raise Infeasible(
        f"the gap cannot be closed before {before}: it takes {takes}, there are {place_m:.0f} m",
        field="start_gap_m",
        value=convoy.first_gap_m,
        unit="m",
        allowed=f"up to about {largest_m:.0f} m here"
        if largest_m > convoy.gap_m + BAND_M
        else f"{convoy.gap_m:g} m, coupled from the start",
    )


def _opens_by(
    convoy: Convoy, members: Sequence[Member], head: MotionPlan, place_m: float, apart_m: float
) -> bool:
    """Tell if every planned gap is open when the trainset ahead reaches a place."""
    shift = place_m - convoy.uncouple_at_m
    wanted = np.asarray(apart_m, members[0].apart_m.dtype)
    moved = [each._replace(uncouple_at_m=each.uncouple_at_m + shift, apart_m=wanted) for each in members]
    plans = plan_followers(moved, head, convoy.first_gap_m)
    reached = [gap[ahead.position_m >= place_m] for ahead, gap in _gaps(members, plans)]
    return all(gap[0] >= apart_m - BAND_M for gap in reached if gap.size)


def _check_uncoupling(convoy: Convoy, members: Sequence[Member], head: MotionPlan) -> None:
    place_m, apart_m = convoy.uncouple_at_m, convoy.apart_m
    if _opens_by(convoy, members, head, place_m, apart_m):
        return
    last_m, nearest_m = LAST_SHARE * convoy.section.length_m, convoy.gap_m + BAND_M
    if _opens_by(convoy, members, head, last_m, apart_m):
        first_m = _last_that(lambda m: _opens_by(convoy, members, head, m, apart_m), last_m, place_m)
        allowed = f"from about {_round_up(first_m)} m on"
    else:
        most_m = _last_that(lambda m: _opens_by(convoy, members, head, place_m, m), nearest_m, apart_m)
        largest_m = math.floor(most_m)
        allowed = f"up to about {largest_m} m there" if largest_m > nearest_m else "a smaller gap farther on"
    raise Infeasible(
        f"gaps of {apart_m:g} m cannot be open there",
        field="uncouple_at_m",
        value=place_m,
        unit="m",
        allowed=allowed,
    )


def _last_that(holds: Callable[[float], bool], good: float, bad: float) -> float:
    """The number farthest from a good one toward a bad one that still holds, by halving."""
    for _ in range(TRIALS):
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good


def _round_up(distance_m: float) -> int:
    """A distance in tens of metres, rounded up."""
    return 10 * int(np.ceil(distance_m / 10.0))

"""Blocking times: how long a train keeps a place from the next one, and the least headway that follows.

A place is blocked from the moment at which a train's command passes its supervisor only if the place is free,
until the train's rear has passed it and the next train has been told. In a moving block, where the train
ahead may stand at once, what a train needs depends on its own motion alone, so the least headway is the
longest time for which a place is blocked. A fixed block is blocked as a whole.

Source: blocking time theory, Happel (1959), as in Pachl, Railway Operation and Control (2002), ch. 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Int
from metropilot.convoy.analysis import FAR_M, Ahead, spare_m
from metropilot.convoy.model import Convoy, ConvoyGuard, Member, convoy_member
from metropilot.physics import command_for_force, resistance_and_gradient
from metropilot.railway import Section, Trainset

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SAMPLE_S = 0.5
"""Longest interval between two looks at a motion."""
JUMP_MPS2, BEFORE_S = 0.02, 1e-6
"""Change of acceleration just before and after which a motion is looked at too: what must be free jumps."""
PLACE_M = 1.0
"""Distance between the places of a moving block."""
SAME_M = 1e-6
NEAR_REAR_M = 1e-3 + (0.2 * np.arange(11.0)) ** 2
"""Places before the rear of a train at a platform that are looked at: it leaves them slowly."""
NEAR_END_M = 1e-3
"""Last place before the end of a journey, which is passed slowly too."""
WIDTH_IN, HEIGHT_IN = 8.4, 5.2


class ServiceRun(NamedTuple):
    """Motion of the head of a convoy over all sections, in steps of time and at jumps of its acceleration.

    Attributes:
        time_s: Time since departure. Shape (T,).
        position_m: Position from the first stop. Shape (T,).
        speed_mps: Shape (T,).
        acceleration_mps2: Shape (T,).
        section: Section that the head is in. Shape (T,).
        from_m: Position at which each section begins. Shape (S,).
    """

    time_s: Float[ndarray, " times"]
    position_m: Float[ndarray, " times"]
    speed_mps: Float[ndarray, " times"]
    acceleration_mps2: Float[ndarray, " times"]
    section: Int[ndarray, " times"]
    from_m: Float[ndarray, " sections"]

    def state(self, k: int) -> tuple[int, float, float, float]:
        """Section, position in it, speed and acceleration at a sample."""
        at = int(self.section[k])
        x, v, a = (float(each[k]) for each in (self.position_m, self.speed_mps, self.acceleration_mps2))
        return at, x - float(self.from_m[at]), v, a


def sample_run(
    nodes: Sequence[tuple[ndarray, ndarray, ndarray, ndarray, ndarray]], from_m: Float[ndarray, " sections"]
) -> ServiceRun:
    """Motion in steps from its pieces, over each of which acceleration is constant between nodes.

    What a train must have free jumps with its acceleration: steps alone would see it too late.

    Args:
        nodes: Time, position, speed, acceleration from there on and section, for each piece.
        from_m: Position at which each section begins.
    """
    time, position, speed, rate, section = (np.concatenate(part) for part in zip(*nodes, strict=True))
    grid = np.arange(0.0, time[-1] + SAMPLE_S, SAMPLE_S)
    grid[-1] = time[-1]
    jumps = time[1:][np.abs(np.diff(rate)) > JUMP_MPS2]
    grid = np.unique(np.concatenate([grid, jumps - BEFORE_S, jumps]))
    node = np.searchsorted(time, grid, side="right") - 1
    since = grid - time[node]
    return ServiceRun(
        time_s=grid,
        position_m=position[node] + since * (speed[node] + 0.5 * rate[node] * since),
        speed_mps=np.maximum(speed[node] + rate[node] * since, 0.0),
        acceleration_mps2=rate[node],
        section=section[node],
        from_m=from_m,
    )


def trainset_behind(section: Section, trainset: Trainset, guard: ConvoyGuard = "moving_block") -> Member:
    """A trainset by itself behind another one on a section."""
    return convoy_member(Convoy(section=section, trainsets=(trainset,) * 2, guard=guard), 1)


def command_of(own: Member, position_m: float, speed_mps: float, acceleration_mps2: float) -> float:
    """Command with which a member has an acceleration; it holds its brakes at standstill."""
    if speed_mps <= 0:
        return -1.0
    vehicle, v = own.believed, np.float64(speed_mps)
    resistance, gradient = resistance_and_gradient(vehicle, own.track, np.float64(position_m), v)
    force = vehicle.effective_mass_kg * acceleration_mps2 + resistance + gradient
    return float(command_for_force(vehicle, v, force))


def needed_m(own: Member, position_m: float, speed_mps: float, acceleration_mps2: float) -> float:
    """Distance ahead that must be free of anything for a member's command to pass."""
    share = command_of(own, position_m, speed_mps, acceleration_mps2)
    wall = Ahead(FAR_M, 0.0)
    spare = spare_m(own, position_m, speed_mps, wall, share=share, acceleration_mps2=acceleration_mps2)
    return FAR_M - spare


def reach_m(run: ServiceRun, members: Sequence[Member]) -> Float[ndarray, " times"]:
    """Farthest place that must have been free by each moment of a motion.

    Args:
        run: Motion.
        members: A trainset behind another in each section.
    """
    need = np.empty(run.time_s.size)
    for k in range(need.size):
        stands = k > 0 and run.speed_mps[k] == run.speed_mps[k - 1] == 0.0
        if stands and run.section[k] == run.section[k - 1]:
            need[k] = need[k - 1]
        else:
            at, *state = run.state(k)
            need[k] = needed_m(members[at], *state)
    return np.maximum.accumulate(run.position_m + need)


def first_times(
    time_s: Float[ndarray, " times"], way_m: Float[ndarray, " times"], at_m: Float[ndarray, " places"]
) -> Float[ndarray, " places"]:
    """First time at which a motion that never goes back is at each place or beyond; infinite: never."""
    after = np.searchsorted(way_m, at_m, side="left")
    k = np.clip(after, 1, way_m.size - 1)
    rise = way_m[k] - way_m[k - 1]
    share = np.divide(at_m - way_m[k - 1], rise, out=np.ones_like(rise), where=rise > 0)
    found = time_s[k - 1] + share * (time_s[k] - time_s[k - 1])
    return np.where(after == 0, time_s[0], np.where(after == way_m.size, np.inf, found))


def watched_places(
    reach: Float[ndarray, " times"], end_m: float, rears_m: Float[ndarray, " stops"], step_m: float
) -> Float[ndarray, " places"]:
    """Places of a moving block in steps, with those that trains leave slowly: before a stop's rear, the end.

    Args:
        reach: Farthest place that must have been free by each moment.
        end_m: Last stop.
        rears_m: Where trains at platforms end.
        step_m: Distance between the places.
    """
    last_m = max(float(reach[-1]), end_m)
    slow_m = np.append(np.add.outer(rears_m, NEAR_REAR_M).ravel(), end_m - NEAR_END_M)
    return np.union1d(np.arange(reach[0], last_m, step_m), slow_m[(slow_m > reach[0]) & (slow_m < last_m)])


class PlaceHeadway(NamedTuple):
    """Least headway on account of one section or station: of the blocks whose end is there.

    Attributes:
        kind: ``station`` where the rear of a train passes after the stop, ``section`` before.
        name: Of the section or the station.
        headway_s: Least time between two trains.
        from_m: Beginning of the block that is blocked longest, from the first stop.
        to_m: Its end; the same in a moving block.
        blocked_from_s: Moment of the journey at which a train must have it.
        blocked_to_s: Moment at which the next one may.
        speed_mps: Speed at the first of these.
        binds: True where the line's least headway is this one.
    """

    kind: str
    name: str
    headway_s: float
    from_m: float
    to_m: float
    blocked_from_s: float
    blocked_to_s: float
    speed_mps: float
    binds: bool


@dataclass(frozen=True, eq=False)
class BlockingTimes:
    """Blocks of a journey and when a train holds them.

    Attributes:
        run: Journey.
        from_m: Beginning of each block, from the first stop. Shape (B,).
        to_m: Its end. Shape (B,).
        from_s: Time from which it must be free. Shape (B,).
        to_s: Time at which the next train knows that it is free again. Shape (B,).
        places: Least headway of each section and station.
    """

    run: ServiceRun
    from_m: Float[ndarray, " blocks"]
    to_m: Float[ndarray, " blocks"]
    from_s: Float[ndarray, " blocks"]
    to_s: Float[ndarray, " blocks"]
    places: tuple[PlaceHeadway, ...]

    @property
    def headway_s(self) -> float:
        """Least time between two trains on this journey."""
        return self.bottleneck.headway_s

    @property
    def bottleneck(self) -> PlaceHeadway:
        """The section or station that binds."""
        return next(each for each in self.places if each.binds)


def blocking_times(
    run: ServiceRun,
    reach: Float[ndarray, " times"],
    sections: Sequence[Section],
    length_m: float,
    age_s: float,
    blocks_m: Sequence[float] | None = None,
) -> BlockingTimes:
    """Compute when each block of a journey is blocked.

    Where the last station turns the trains round is left out: they are gone when they arrive. Beyond a stop a
    fixed block has an overlap of its own, as long as the supervisor asks for there.

    Args:
        run: Journey.
        reach: Farthest place that must have been free by each moment of it; see :func:`reach_m`.
        sections: Sections of the journey.
        length_m: Length of a train.
        age_s: Age of what a train knows of the one ahead.
        blocks_m: Longest fixed block of each section, which is divided evenly; None: a moving block.
    """
    end_m = float(run.position_m[-1])
    stops_m = np.append(run.from_m[1:], end_m)
    # what is asked for beyond a stop, before the train leaves it
    overlap_m = np.array([reach[run.position_m <= stop + SAME_M][-1] for stop in stops_m[:-1]]) - stops_m[:-1]
    if blocks_m is None:
        from_m = to_m = watched_places(reach, end_m, stops_m[:-1] - length_m, PLACE_M)
    else:
        starts = zip(run.from_m, stops_m, blocks_m, strict=True)
        inner = [np.linspace(a, b, int(np.ceil((b - a) / most - 1e-9)) + 1) for a, b, most in starts]
        edges = np.unique(np.concatenate([*inner, stops_m[:-1] + np.maximum(overlap_m, 0.0)]))
        from_m, to_m = edges[:-1], edges[1:]
    # a block is asked for when more than its beginning is
    from_s = first_times(run.time_s, reach, from_m + SAME_M)
    rear = run.position_m - length_m
    to_s = np.minimum(first_times(run.time_s, rear, to_m), run.time_s[-1]) + age_s
    held = to_s - from_s
    # the rear passes the last length before a stop after it
    stop = np.searchsorted(stops_m[:-1] + np.maximum(overlap_m, 0.0), to_m, side="left")
    at_stop = to_m > np.append(stops_m[:-1], np.inf)[stop] - length_m
    worst = int(np.argmax(held))
    places = []
    for k, section in enumerate(sections):
        for kind, chosen in (("section", (stop == k) & ~at_stop), ("station", (stop == k) & at_stop)):
            if not chosen.any():
                continue
            i = int(np.flatnonzero(chosen)[np.argmax(held[chosen])])
            name = section.name if kind == "section" else section.destination.name
            speed = float(np.interp(from_s[i], run.time_s, run.speed_mps))
            times = float(from_s[i]), float(to_s[i])
            block = float(from_m[i]), float(to_m[i])
            places.append(PlaceHeadway(kind, name, float(held[i]), *block, *times, speed, i == worst))
    return BlockingTimes(run, from_m, to_m, from_s, to_s, tuple(places))


def blocking_figure(found: BlockingTimes, length_m: float, title: str, below: str) -> Figure:
    """Two trains at the least headway with the times for which they block each place.

    From the stop before the place that binds to the stop after it.

    Args:
        found: Blocking times.
        length_m: Length of a train.
        title: Headline.
        below: Line under it.
    """
    from metropilot.evaluate import GREY, add_headline, house_style, new_panels

    run, least = found.run, found.bottleneck
    stops_m = np.append(run.from_m, run.position_m[-1])
    left_m = stops_m[stops_m < least.to_m - length_m][-1] - length_m
    right_m = np.append(stops_m[stops_m > least.from_m + length_m], stops_m[-1])[0] + 2.0 * length_m
    with house_style():
        figure, (axes,) = new_panels(WIDTH_IN, HEIGHT_IN, (1.0,))
        for turn in (0, 1):
            _draw_train(axes, found, length_m, turn)
        for stop_m in stops_m:
            axes.axvline(stop_m / 1000.0, color=GREY, linewidth=0.8, linestyle=":")
        axes.plot([], [], color=GREY, linewidth=0.8, linestyle=":", label="stop")
        axes.set_xlim(left_m / 1000.0, right_m / 1000.0)
        seen = (run.position_m >= left_m) & (run.position_m <= right_m)
        first_s, last_s = run.time_s[seen][[0, -1]]
        # time runs down the page, as in blocking time diagrams
        axes.set_ylim(last_s + found.headway_s, max(first_s - 20.0, 0.0))
        axes.set_xlabel("position, km")
        axes.set_ylabel("time, s")
        axes.legend(loc="lower left")
        add_headline(axes, title, below)
        return figure


def _draw_train(axes: Axes, found: BlockingTimes, length_m: float, turn: int) -> None:
    from metropilot.evaluate import BLUE, VERMILION

    colour, later_s = (BLUE, VERMILION)[turn], turn * found.headway_s
    edges_m = np.append(found.from_m, found.to_m[-1]) / 1000.0
    low, high = (np.append(each, each[-1]) + later_s for each in (found.from_s, found.to_s))
    step = None if (found.to_m == found.from_m).all() else "post"
    axes.fill_between(edges_m, low, high, step=step, color=colour, alpha=0.22, linewidth=0)
    run = found.run
    for behind_m, width, name in ((0.0, 1.1, ("first train", "second train")[turn]), (length_m, 0.4, None)):
        axes.plot(
            (run.position_m - behind_m) / 1000.0,
            run.time_s + later_s,
            color=colour,
            linewidth=width,
            label=name,
        )

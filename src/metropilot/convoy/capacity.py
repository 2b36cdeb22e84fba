"""Capacity of a line: trainsets an hour in convoys, under the separation that the supervisor itself asks for.

All convoys make the same journey, one headway apart. The least headway is the one at which no head is ever
nearer to the last trainset ahead than its supervisor lets its command pass: on the way, and behind a convoy
that stands at a platform and has to clear it.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy import ndarray

from metropilot._io import fill_folder, write_json
from metropilot._provenance import provenance
from metropilot._schema import FieldSpec, Range, check_fields, declare
from metropilot.convoy.analysis import FAR_M, Ahead, spare_m
from metropilot.convoy.blocking import (
    BlockingTimes,
    PlaceHeadway,
    ServiceRun,
    blocking_figure,
    blocking_times,
    command_of,
    reach_m,
    sample_run,
    trainset_behind,
)
from metropilot.convoy.model import (
    GAP_M,
    Convoy,
    ConvoyGuard,
    Member,
    convoy_members,
)
from metropilot.errors import Infeasible, InputError
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import Plan, PlanOptions, couple_trainsets, fastest_time, plan_arrays
from metropilot.railway import Section, Trainset

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AGE_S = 2.4
"""Age of what a train knows of the one ahead, by radio through a control centre."""
HEADWAY_S = 0.1
"""Resolution of a headway."""
LONGEST_S = 7200.0
LATE_W = 500.0
NEAR_S, NEAR_MPS2, NEAR_M = 5.0, 0.4, 30.0
"""Beyond what this reaction, this brake and this distance need no supervisor asks for more room."""
COUNTS = FieldSpec("Trainsets of a convoy; 1: no convoys.", range=Range(1, 16))
BETWEEN: tuple[ConvoyGuard, ...] = ("moving_block", "independent")
"""What protection may rely on between two convoys, which are not coupled."""
RUNNING_IN, RUNNING = "running in to", "on the way to"


@dataclass(frozen=True, kw_only=True)
class ServiceOptions:
    """Service whose capacity is asked for.

    Attributes:
        dwell_s: Time at every platform.
        platform_m: Length of the platforms. A longer convoy stops as often as it takes, and draws up between;
            None: every platform is as long as the convoy.
        gap_m: Desired gap inside a convoy. Where protection needs more, it is that.
        reserve: Running time over the minimum running time, less 1.
        age_s: Age of what protection knows of the convoy ahead: by radio through a control centre about
            2.4 s, from train to train about 0.36 s.
        blocks: Fixed blocks of each section, all of one length; None: none.
        block_m: Longest fixed block, in place of their number; None: as ``blocks`` says.
    """

    dwell_s: float = declare(30.0, "Time at every platform.", unit="s", low=0.0, high=600.0)
    platform_m: float | None = declare(
        None, "Length of the platforms; as long as the convoy if not given.", unit="m", low=10.0, high=5000.0
    )
    gap_m: float = declare(GAP_M, "Desired gap inside a convoy.", unit="m", low=0.5, high=2000.0)
    reserve: float = declare(0.05, "Running time over the minimum running time, less 1.", low=0.0, high=2.0)
    age_s: float = declare(
        AGE_S, "Age of what a train knows of the one ahead.", unit="s", low=0.0, high=60.0, option="age"
    )
    blocks: int | None = declare(None, "Fixed blocks of each section, beside the others.", low=1, high=1000)
    block_m: float | None = declare(
        None,
        "Longest fixed block, in place of their number.",
        unit="m",
        low=10.0,
        high=1e5,
        option="block-length",
    )

    def __post_init__(self) -> None:
        check_fields(self)
        if self.blocks is not None and self.block_m is not None:
            raise InputError(
                "a number of blocks and a length of them",
                field="block_m",
                value=self.block_m,
                unit="m",
                allowed="one of both",
            )

    @property
    def has_blocks(self) -> bool:
        """True if there are fixed blocks."""
        return self.blocks is not None or self.block_m is not None

    def blocks_m(self, sections: Sequence[Section]) -> list[float]:
        """Longest fixed block of each section."""
        return [self.block_m or section.length_m / (self.blocks or 1) for section in sections]


@dataclass(frozen=True)
class Capacity:
    """Capacity of a line in convoys of one size.

    Attributes:
        count: Trainsets of a convoy; 1: no convoys.
        guard: What protection relies on between convoys: ``moving_block``, ``fixed_block``, ``independent``.
        platform_m: Length of the platforms; None: as long as the convoy.
        convoy_m: Length of a convoy.
        gap_m: Gap inside it.
        stops_at_platform: Stops of a convoy at each platform.
        journey_s: Time of the journey, dwells included.
        headway_s: Least time between two convoys.
        bottleneck: Where they are nearest: a section, with what the convoy behind does there.
        plain_headway_s: Least time between two at the highest speed, without stops.
        blocking: Blocking times; None where protection relies on brakes, not on places.
    """

    count: int
    guard: str
    platform_m: float | None
    convoy_m: float
    gap_m: float
    stops_at_platform: int
    journey_s: float
    headway_s: float
    bottleneck: str
    plain_headway_s: float
    blocking: BlockingTimes | None

    @property
    def trainsets_per_h(self) -> float:
        """Trainsets an hour, stops included."""
        return 3600.0 * self.count / self.headway_s

    @property
    def plain_per_h(self) -> float:
        """Trainsets an hour past a point of plain line."""
        return 3600.0 * self.count / self.plain_headway_s

    @property
    def platform(self) -> str:
        """The platform in words."""
        return (
            "platform as long as the convoy" if self.platform_m is None else f"platform {self.platform_m:g} m"
        )

    def as_dict(self) -> dict[str, Any]:
        """Values for JSON."""
        told = asdict(replace(self, blocking=None))
        del told["blocking"]
        rates = {"trainsets_per_h": self.trainsets_per_h, "plain_per_h": self.plain_per_h}
        places = () if self.blocking is None else self.blocking.places
        return told | rates | {"places": [each._asdict() for each in places]}


def line_capacity(
    sections: Sequence[Section],
    trainset: Trainset,
    counts: Sequence[int] = (1, 2, 4, 8),
    guards: Sequence[ConvoyGuard] = BETWEEN,
    options: ServiceOptions | None = None,
) -> tuple[Capacity, ...]:
    """Capacity of a line for convoys of several sizes, one row for each size and guard.

    Convoys drive their joint plans and brake at controlled rates, trainsets by themselves with all their
    brakes. Where the first and the last station turn the trainsets round is left out.

    Args:
        sections: Sections in the order of the journey; convoys stop between them.
        trainset: Trainset with its load.
        counts: Trainsets of a convoy; 1: no convoys.
        guards: What protection relies on between convoys: ``moving_block`` or ``independent``.
        options: Dwell, platforms, gap and reserve.

    Raises:
        InputError: Fewer than two sections, a count or a guard that is none, or a platform that no trainset
            fits on.
        Infeasible: A convoy is so long that it fills the line.
    """
    options = options or ServiceOptions()
    _check(sections, trainset, counts, guards, options)
    heads = {guard: [trainset_behind(section, trainset, guard) for section in sections] for guard in guards}
    controlled = [convoy_members(_convoy(section, trainset, 2, options.gap_m))[0] for section in sections]
    rows: list[Capacity] = []
    for count in counts:
        gap_m = options.gap_m if count == 1 else _inside_gap_m(sections, trainset, count, options.gap_m)
        pitch_m = trainset.length_m + gap_m
        convoy_m = count * pitch_m - gap_m
        platform_m = convoy_m if options.platform_m is None else options.platform_m
        fits = min(int((platform_m + gap_m + 1e-6) // pitch_m), count)
        stops = -(-count // fits)
        journey = _journey(sections, trainset, count, gap_m, stops, fits * pitch_m, options)
        for guard in (*guards, *(("fixed_block",) if options.has_blocks else ())):
            members = heads["moving_block" if guard == "fixed_block" else guard]
            if count > 1:
                members = [
                    own._replace(bounds=alone.bounds._replace(held_mps2=own.bounds.held_mps2))
                    for own, alone in zip(controlled, members, strict=True)
                ]
            at, x, v, _ = journey.state(int(np.argmax(journey.speed_mps)))
            plain_m, blocking = convoy_m + _steady_gap_m(members[at], x, v, options.age_s), None
            if guard == "independent":
                pursuit = _Pursuit(journey, members, convoy_m, options.age_s)
                headway_s, bottleneck = pursuit.least_headway_s(), pursuit.bottleneck(sections)
            else:
                blocks_m = options.blocks_m(sections) if guard == "fixed_block" else None
                reach = reach_m(journey, members)
                blocking = blocking_times(journey, reach, sections, convoy_m, options.age_s, blocks_m)
                least = blocking.bottleneck
                headway_s, where = least.headway_s, RUNNING_IN if least.kind == "station" else RUNNING
                bottleneck = f"{where} {least.name}"
                plain_m += 0.0 if blocks_m is None else max(blocks_m)
            rows.append(
                Capacity(
                    count=count,
                    guard=guard,
                    platform_m=options.platform_m,
                    convoy_m=convoy_m,
                    gap_m=gap_m,
                    stops_at_platform=stops,
                    journey_s=float(journey.time_s[-1]),
                    headway_s=headway_s,
                    bottleneck=bottleneck,
                    plain_headway_s=plain_m / v,
                    blocking=blocking,
                )
            )
    return tuple(rows)


def _check(
    sections: Sequence[Section],
    trainset: Trainset,
    counts: Sequence[int],
    guards: Sequence[ConvoyGuard],
    options: ServiceOptions,
) -> None:
    if len(sections) < 2:
        raise InputError(
            "no stop on the way", field="destination", value=len(sections), allowed="two sections or more"
        )
    for count in counts:
        COUNTS.check("counts", count)
    for guard in guards:
        if guard not in BETWEEN:
            raise InputError("not between convoys", field="guard", value=guard, allowed=", ".join(BETWEEN))
    if options.platform_m is not None and options.platform_m < trainset.length_m:
        allowed = f"at least {trainset.length_m:g} m, one trainset"
        raise InputError(
            "shorter than a trainset", field="platform_m", value=options.platform_m, unit="m", allowed=allowed
        )


def _convoy(section: Section, trainset: Trainset, count: int, gap_m: float) -> Convoy:
    return Convoy(section=section, trainsets=(trainset,) * count, gap_m=gap_m)


def _inside_gap_m(sections: Sequence[Section], trainset: Trainset, count: int, gap_m: float) -> float:
    """Gap inside a convoy: the desired one, or what protection needs at the highest steady speed."""
    section = max(sections, key=lambda each: each.length_m)
    own = convoy_members(_convoy(section, trainset, count, gap_m))[-1]
    track = own.track
    speed = min(float(trainset.max_speed_mps), float(track.limit_mps[np.isfinite(track.limit_from_m)].max()))
    return max(gap_m, _steady_gap_m(own, 0.4 * section.length_m, speed))


def _steady_gap_m(own: Member, position_m: float, speed_mps: float, age_s: float = 0.0) -> float:
    """Gap that protection needs at a common steady speed."""
    share = command_of(own, position_m, speed_mps, 0.0)
    seen_m = FAR_M - age_s * speed_mps
    return FAR_M - spare_m(own, position_m, speed_mps, Ahead(seen_m, speed_mps, age_s=age_s), share=share)


def _journey(
    sections: Sequence[Section],
    trainset: Trainset,
    count: int,
    gap_m: float,
    stops: int,
    draw_up_m: float,
    options: ServiceOptions,
) -> ServiceRun:
    """The journey of a convoy: joint plans, dwells, and drawing up where it takes several stops."""
    clock, parts = 0.0, list[tuple[ndarray, ndarray, ndarray, ndarray, ndarray]]()
    from_m = [0.0, *accumulate(section.length_m for section in sections[:-1])]
    marks_m = [[j * draw_up_m for j in range(stops if k else 1)] for k in range(len(sections))]
    if any(marks[-1] >= s.length_m - trainset.length_m for marks, s in zip(marks_m, sections, strict=True)):
        raise Infeasible(
            f"a convoy of {count} draws up beyond the next stop",
            field="platform_m",
            value=options.platform_m,
            unit="m",
            allowed="longer platforms, or fewer trainsets",
        )
    for k, (section, origin_m, marks) in enumerate(zip(sections, from_m, marks_m, strict=True)):
        for j, mark in enumerate(marks):
            if k:
                dwell = np.array([clock, clock + options.dwell_s])
                at = np.full(2, origin_m + mark)
                parts.append((dwell, at, np.zeros(2), np.zeros(2), np.full(2, k)))
                clock += options.dwell_s
            end_m = marks[j + 1] if j + 1 < len(marks) else section.length_m
            plan = _leg(replace(section, length_m=end_m), trainset, count, gap_m, mark, options)
            rate = np.diff(plan.speed_mps**2) / (2 * np.diff(plan.position_m))
            time, speed = clock + plan.time_s, plan.speed_mps
            parts.append(
                (time, origin_m + plan.position_m, speed, np.append(rate, 0.0), np.full(time.size, k))
            )
            clock = float(time[-1])
    return sample_run(parts, np.array(from_m))


def _leg(
    section: Section, trainset: Trainset, count: int, gap_m: float, start_m: float, options: ServiceOptions
) -> Plan:
    """The plan from a standstill to the end of a section."""
    coupled, head = (), trainset
    if count > 1:
        convoy = _convoy(section, trainset, count, gap_m)
        section, head = convoy.leader()
        at = [-start for start in convoy.starts_m]
        coupled = couple_trainsets(section, [head, *convoy.trainsets[1:]], at, limits_extended=True)
    jerk = trainset.actuation.jerk_limit_mps3
    vehicle, track = vehicle_arrays(head), track_arrays(section, head)
    drive = PlanOptions(
        start_m=start_m, coupled=coupled, late_w=LATE_W, jerk_mps3=jerk if np.isfinite(jerk) else None
    )
    return plan_arrays(vehicle, track, (1.0 + options.reserve) * fastest_time(vehicle, track, drive), drive)


class _Pursuit:
    """A convoy behind another one with the same journey, each relying on the brakes of the other."""

    def __init__(self, service: ServiceRun, members: Sequence[Member], convoy_m: float, age_s: float) -> None:
        self.service, self.members, self.convoy_m, self.age_s = service, members, convoy_m, age_s
        self.nearest = 0
        v = service.speed_mps
        self.near_m = NEAR_M + v * (NEAR_S + age_s + v / (2.0 * NEAR_MPS2))

    def least_headway_s(self) -> float:
        """Least headway at which every command of the convoy behind passes."""
        low, high = 0.0, 60.0
        while not self._is_clear(high):
            low, high = high, 2.0 * high
            if high > LONGEST_S:
                raise Infeasible("a convoy never clears the way of the next", field="counts")
        while high - low > HEADWAY_S:
            middle = 0.5 * (low + high)
            low, high = (low, middle) if self._is_clear(middle) else (middle, high)
        return high

    def _is_clear(self, headway_s: float) -> bool:
        """True if no command of the convoy behind is overruled on account of the one ahead."""
        j = self.service
        then = j.time_s + headway_s - self.age_s
        there = then <= j.time_s[-1]
        rear = np.interp(then, j.time_s, j.position_m) - self.convoy_m
        room = np.where(there, rear - j.position_m, np.inf)
        speed = np.interp(then, j.time_s, j.speed_mps)
        if (room < 0).any():
            self.nearest = int(np.argmin(room))
            return False
        near = np.flatnonzero(room < self.near_m)
        # the moment that was too near at the last headway is most likely too near again
        for k in sorted(near, key=lambda k: abs(int(k) - self.nearest)):
            ahead = max(int(np.searchsorted(j.time_s, then[k], side="right")) - 1, 0)
            if self._spare_m(int(k), float(room[k]), float(speed[k]), float(j.acceleration_mps2[ahead])) < 0:
                self.nearest = int(k)
                return False
        return True

    def _spare_m(self, k: int, room_m: float, ahead_mps: float, ahead_mps2: float) -> float:
        at, x, v, a = self.service.state(k)
        own = self.members[at]
        ahead = Ahead(room_m, ahead_mps, ahead_mps2, self.age_s)
        return spare_m(own, x, v, ahead, share=command_of(own, x, v, a), acceleration_mps2=a)

    def bottleneck(self, sections: Sequence[Section]) -> str:
        """Place at which the convoy behind is nearest at the least headway."""
        section = sections[int(self.service.section[self.nearest])]
        braking = self.service.acceleration_mps2[self.nearest] < 0
        return f"{RUNNING_IN if braking else RUNNING} {section.destination.name}"


WIDTH_IN, HEIGHT_IN = 8.4, 4.6


def capacity_figure(rows: Sequence[Capacity], title: str, below: str) -> Figure:
    """Trainsets an hour over the trainsets of a convoy: with stops, by platform and guard, and on plain line.

    Args:
        rows: Rows of one line and trainset; several platforms and guards.
        title: Headline.
        below: Line under it.
    """
    from metropilot.evaluate import GREY, SERIES_STYLES, add_headline, house_style, new_panels

    with house_style():
        figure, (axes,) = new_panels(WIDTH_IN, HEIGHT_IN, (1.0,))
        counts = sorted({row.count for row in rows})
        series: dict[str, list[Capacity]] = {}
        for row in rows:
            series.setdefault(f"{row.platform}, {row.guard.replace('_', ' ')}", []).append(row)
        add_headline(axes, title, below)
        for k, (name, each) in enumerate(series.items()):
            colour, dashes = SERIES_STYLES[k % len(SERIES_STYLES)]
            look = {"color": colour, "linestyle": dashes, "marker": "o", "markersize": 3.5}
            at = [counts.index(row.count) for row in each]
            axes.plot(at, [row.trainsets_per_h for row in each], label=name, **look)
        plain = [row for row in rows if row.guard == rows[0].guard and row.platform == rows[0].platform]
        at = [counts.index(row.count) for row in plain]
        words = f"plain line, {rows[0].guard.replace('_', ' ')}"
        axes.plot(at, [row.plain_per_h for row in plain], color=GREY, linewidth=0.8, label=words)
        axes.set_xticks(range(len(counts)), [str(count) for count in counts])
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("trainsets of a convoy")
        axes.set_ylabel("trainsets an hour")
        axes.legend(loc="upper left")
        return figure


def write_capacity(folder: Path, rows: Sequence[Capacity], title: str, below: str) -> tuple[str, ...]:
    """Write the rows as `capacity.json`, the headways of all sections and stations, and pictures.

    The pictures, each as SVG and PNG, are `capacity`, and the blocking times of the shortest convoy in a
    moving block (`moving_block`) and in fixed ones (`fixed_block`). `headways.csv` has a line for each
    section and station.

    Args:
        folder: Folder; created if missing.
        rows: The rows.
        title: Headline of the pictures.
        below: Line under it.

    Returns:
        Names of the files.

    Raises:
        InputError: The folder cannot be made or written.
    """
    from metropilot.evaluate import save_figure

    figures = {"capacity": capacity_figure(rows, title, below)}
    for row in sorted(rows, key=lambda each: -each.count):
        if row.blocking is not None:
            block, least = row.guard.replace("_", " "), row.blocking.bottleneck
            under = f"{block}: {row.headway_s:.1f} s at {least.kind} {least.name}; {below}"
            figures[row.guard] = blocking_figure(row.blocking, row.convoy_m, title, under)
    with fill_folder(folder) as scratch:
        told = {"service": title, "details": below, "made_with": provenance()}
        write_json(scratch / "capacity.json", told | {"rows": [row.as_dict() for row in rows]})
        with (scratch / "headways.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(("count", "platform_m", "guard", *PlaceHeadway._fields))
            writer.writerows(
                (row.count, row.platform_m, row.guard, *place)
                for row in rows
                if row.blocking is not None
                for place in row.blocking.places
            )
        for name, figure in figures.items():
            save_figure(figure, scratch / name)
    pictures = (f"{name}.{kind}" for name in figures for kind in ("svg", "png"))
    return "capacity.json", "headways.csv", *pictures

"""A day of 1,332 journeys on a replica of Shanghai line 8, and the cost of a day as it grows.

python -m benchmarks.shanghai --write docs/line.md
"""

from __future__ import annotations

import argparse
import time
import tracemalloc
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.beside_optimum import table
from benchmarks.report import circumstances, write_section
from metropilot.evaluate import BLUE, VERMILION, add_headline, house_style, label_panel, new_panels
from metropilot.operation import (
    DayTimetable,
    LineDay,
    LineOperation,
    OperationOptions,
    PeriodicPart,
    Profiles,
    day_floor_j,
    lay_out_day,
    link_trains,
    plain_days,
    repeat_timetables,
    solve_network,
)
from metropilot.railway import (
    Line,
    Period,
    ServiceDay,
    Station,
    Steps,
    load_feeding,
    load_line,
    load_trainset,
)
from metropilot.units import J_PER_KWH, KMH_PER_MPS

TRAINSET, LOAD = "dkz32", "AW2"
OPTIONS = OperationOptions(
    zones=12, time_window_s=0, efficiency_traction=0.9, efficiency_braking=0.76, turnround_s=120
)
LENGTH_M, LIMIT_KMH = 37_400.0, 80.0
"""Published length of the line, and the highest speed of its trains, here everywhere."""
PLACES = """
SGL Shiguang Road 121.532045 31.322441
NJL Nenjiang Road 121.532088 31.314850
XYL Xiangyin Road 121.532011 31.304952
HXGY Huangxing Park 121.533218 31.295867
YJZL Middle Yanji Road 121.534948 31.288657
HXL Huangxing Road 121.527937 31.278692
JPL Jiangpu Road 121.518256 31.275100
ASXC Anshan Xincun 121.509518 31.273205
SPL Siping Road 121.501601 31.275148
QYL Quyang Road 121.490473 31.276488
HKZQC Hongkou Football Stadium 121.479263 31.270898
XZBL North Xizang Road 121.468741 31.263498
ZXL Zhongxing Road 121.468893 31.253130
QFL Qufu Road 121.471485 31.242395
RMGC People's Square 121.474496 31.232892
DSJ Dashijie 121.479306 31.227381
LXM Laoximen 121.482910 31.218929
LJBL Lujiabang Road 121.486141 31.211668
XZNL South Xizang Road 121.489533 31.202029
ZHYSG China Art Museum 121.494176 31.185702
YHL Yaohua Road 121.494558 31.178449
CSL Chengshan Road 121.496164 31.170842
YS Yangsi 121.493726 31.161075
DFTYZX Oriental Sports Center 121.480468 31.153615
LZXC Lingzhao Xincun 121.489706 31.141059
LHL Luheng Road 121.497775 31.119260
PJZ Pujiang Town 121.506290 31.096560
JYL Jiangyue Road 121.508562 31.084263
LHGL Lianhang Road 121.510570 31.073933
SDGL Shendu Highway 121.512253 31.061341
"""
"""Code, name, longitude and latitude of each station, from public map data."""
DRIVINGS = "coast", "optimal"
MOVES = 1500
JOURNEYS = (24, 72, 216, 648, 1332, 2664)
DENSITY_S = 240
RADIUS_M = 6_371_000.0


def replica() -> Line:
    """Line 8 with straight lines between its stations, stretched to the published length, flat."""
    rows = [line.split() for line in PLACES.split("\n") if line]
    longitude, latitude = (np.radians([float(row[k]) for row in rows]) for k in (-2, -1))
    half = np.sin(np.diff(latitude) / 2) ** 2
    half += np.cos(latitude[:-1]) * np.cos(latitude[1:]) * np.sin(np.diff(longitude) / 2) ** 2
    straight_m = np.append(0.0, np.cumsum(2 * RADIUS_M * np.arcsin(np.sqrt(half))))
    place_m = np.round(straight_m * LENGTH_M / straight_m[-1])
    stations = tuple(
        Station(row[0], " ".join(row[1:-2]), float(at)) for row, at in zip(rows, place_m, strict=True)
    )
    zero = np.array([0.0])
    return Line(
        id="shanghai-8-replica",
        name="Shanghai line 8, replica",
        stations=stations,
        limit_mps=Steps(zero, np.array([LIMIT_KMH / KMH_PER_MPS])),
        gradient_permil=Steps(zero, zero.copy()),
    )


def working_day() -> ServiceDay:
    """18 h with 666 journeys each way."""
    hours = 3600
    parts = ((5.5, 7, 100), (7, 9, 90), (9, 17, 100), (17, 19, 90), (19, 23.5 + 300 / hours, 100))
    periods = tuple(
        Period(name=f"{a:g} h", from_s=round(a * hours), to_s=round(b * hours), headway_s=headway_s)
        for a, b, headway_s in parts
    )
    return ServiceDay(id="replica", name="18 h", line_id="shanghai-8-replica", periods=periods)


ABOUT = """\
Das Gupta, Tobin and Pavel (2016) report 19.3 to 21.6 % less energy on line 8 of Shanghai, Das Gupta et
al. (2023) 20.9 to 28.7 %, with trains that drive fixed profiles (full traction, coast, brake), against
a start timetable. Neither their table of lengths and limits nor that timetable could be had. This
**replica** has the places of the 30 stations from public map data, straight lines between them
stretched to the published {km:g} km, {kmh:g} km/h everywhere, and no gradients, which are unknown.
Running times are 10 % above the minimum; trains are `dkz32` AW2; efficiencies are 0.9 and 0.76,
the transfer loss is 10 %, and {zones} feeding zones are assumed. The percentages say what driving and
timetable are worth on such a line, not what theirs were.

{journeys:,} journeys in 18 h over {sections} sections, {fleet} trains, every 90 s in four hours and
every 100 s in the others. The timetable of each headway is searched with {moves} moves from three
starts (dwells, offset of the directions, seed 0), at planned running times. Start timetable: even
dwells, mean over two offsets."""
GROWTH = """\
Time and memory as a day grows: `yizhuang`, a journey each way every {headway} s, optimal driving; power
minute by minute in four zones, the network every second. From 648 to 2,664 journeys time grows with the
power {time} of the journeys (power, network), memory with {memory}."""
Growth = tuple[int, float, float, float, float]
"""Journeys, processor seconds of power and of network, most memory of both, MB."""


class Clock:
    """Processor and wall time of the steps of a computation, by name."""

    def __init__(self) -> None:
        self.rows: list[list[str]] = []
        self._last = time.process_time(), time.perf_counter()
        self._first = self._last

    def step(self, name: str) -> None:
        """End a step."""
        now = time.process_time(), time.perf_counter()
        self.rows.append([name, *(f"{a - b:.1f}" for a, b in zip(now, self._last, strict=True))])
        self._last = now

    def total(self) -> list[str]:
        """Row of the sum."""
        now = time.process_time(), time.perf_counter()
        return ["all", *(f"{a - b:.1f}" for a, b in zip(now, self._first, strict=True))]


def kwh(operation: LineOperation, timetable: DayTimetable, plans: list[Profiles]) -> float:
    """Energy of a day."""
    return LineDay(operation, timetable, plans).energy().supplied_kwh


def measure_replica() -> tuple[list[list[str]], Clock, dict[str, float]]:
    """Rows of energy, times of the steps, and what describes the day."""
    clock = Clock()
    operation, day = LineOperation(replica(), load_trainset(TRAINSET, LOAD), OPTIONS), working_day()
    plans = {driving: [operation.profiles(driving)] for driving in DRIVINGS}
    own_w = operation.trainset.auxiliary_w
    plans["optimal"] += [operation.profiles(received_w=share * own_w) for share in (1.0, 4.0)]
    clock.step("line and plans")
    starts = plain_days(operation, day, [plans[name][0] for name in DRIVINGS], phases=2)
    plain = {
        name: float(np.mean([kwh(operation, each, plans[name]) for each in starts])) for name in DRIVINGS
    }
    clock.step("energy of the start timetables")
    best = {name: lay_out_day(operation, day, plans[name], searched=True, moves=MOVES) for name in DRIVINGS}
    clock.step("timetables, least headway checked")
    found = {name: kwh(operation, best[name], plans[name]) for name in DRIVINGS}
    clock.step("energy of the timetables found")
    floor = day_floor_j(operation, best["optimal"], plans["optimal"][0]) / J_PER_KWH
    links = link_trains(best["optimal"], OPTIONS.turnround_s, 900)
    clock.step("floor and trains")
    start = plain["coast"]
    named = {
        "start: full traction, coast, brake; mean offset": start,
        "the same driving, timetable found": found["coast"],
        "optimal driving, start timetable": plain["optimal"],
        "optimal driving, timetable found": found["optimal"],
        "floor, all received": floor,
    }
    rows = [
        [name, f"{each:.0f}", f"{100.0 * (1.0 - each / start):.1f}", f"{100.0 * (each / floor - 1.0):.1f}"]
        for name, each in named.items()
    ]
    of = {"journeys": best["optimal"].journeys, "fleet": links.fleet, "sections": operation.count}
    return rows, clock, of


def measure_growth() -> list[Growth]:
    """Cost of days of more and more journeys on Yizhuang."""
    line, trainset, feeding = load_line("yizhuang"), load_trainset(TRAINSET, LOAD), load_feeding("yizhuang")
    operation = LineOperation(line, trainset, replace(OPTIONS, zones=4, headway_s=DENSITY_S))
    plans = [operation.profiles()]
    timetable, plan = operation.plain_timetable(60.0), np.zeros(len(operation.trips), dtype=int)
    found = []
    for journeys in JOURNEYS:
        to_s = DENSITY_S * journeys // 2
        day = LineDay(
            operation, repeat_timetables([PeriodicPart(0, to_s, DENSITY_S, timetable, plan)]), plans
        )
        assert day.timetable.journeys == journeys
        seconds = []
        for work in (day.power, lambda day=day: solve_network(feeding, *day.loads())):
            begin = time.process_time()
            work()
            seconds.append(time.process_time() - begin)
        memory = []
        for work in (day.power, day.loads):
            tracemalloc.start()
            work()
            memory.append(tracemalloc.get_traced_memory()[1] / 1e6)
            tracemalloc.stop()
        found.append((journeys, *seconds, *memory))
    return found


def draw_growth(path: Path, found: list[Growth]) -> None:
    """Write the picture of time and memory over journeys."""
    journeys, power_s, network_s, power_mb, network_mb = np.array(found).T
    with house_style():
        figure, (seconds, memory) = new_panels(7.2, 5.6, (1.0, 1.0))
        shown = ((seconds, power_s, network_s), (memory, power_mb, network_mb))
        for axes, power, network in shown:
            axes.plot(journeys, power, "o-", color=BLUE, label="power and energy")
            axes.plot(journeys, network, "s-", color=VERMILION, label="DC network (memory: its loads)")
            axes.set_ylim(bottom=0.0)
        seconds.set_ylabel("processor s")
        memory.set_ylabel("MB")
        memory.set_xlabel("journeys")
        label_panel(memory, "most memory")
        seconds.legend(loc="upper left")
        add_headline(
            seconds, "Cost of a day over its journeys", f"yizhuang, a journey each way every {DENSITY_S} s"
        )
        figure.savefig(path, dpi=110)


def slope(found: list[Growth], column: int) -> float:
    """Exponent of the growth over the largest half of the days."""
    tail = np.log(np.array([[row[0], row[column]] for row in found[-3:]]))
    return float(np.polyfit(tail[:, 0], tail[:, 1], 1)[0])


def describe(
    rows: list[list[str]],
    clock: Clock,
    of: Mapping[str, float],
    found: list[Growth],
) -> str:
    """Part of the page."""
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items())
    cells = [[f"{n}", f"{a:.2f}", f"{b:.2f}", f"{c:.0f}", f"{d:.0f}"] for n, a, b, c, d in found]
    columns = ("journeys", "power, processor s", "network, processor s", "power, MB", "loads, MB")
    growth = [f"{slope(found, column):.2f}" for column in range(1, 5)]
    return "\n\n".join(
        [
            "## A day of Shanghai line 8, replica",
            ABOUT.format(
                km=LENGTH_M / 1000,
                kmh=LIMIT_KMH,
                trainset=TRAINSET,
                load=LOAD,
                zones=OPTIONS.zones,
                moves=MOVES,
                **of,
            ),
            table(("driving and timetable", "kWh a day", "saved %", "above the floor %"), rows),
            table(("step", "processor s", "wall s"), [*clock.rows, clock.total()]),
            GROWTH.format(headway=DENSITY_S, time=" and ".join(growth[:2]), memory=" and ".join(growth[2:])),
            table(columns, cells),
            "![Processor time and memory over the journeys of a day.](images/line-cost.png)",
            f"`python -m benchmarks.shanghai --write docs/line.md`; {about}.",
        ]
    )


def main() -> None:
    """Compute everything; print the part of the page or write it, with its picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    page = parser.parse_args().write
    found = measure_growth()
    text = describe(*measure_replica(), found)
    write_section(page, "shanghai", text)
    if page is not None:
        draw_growth(page.parent / "images" / "line-cost.png", found)


if __name__ == "__main__":
    main()

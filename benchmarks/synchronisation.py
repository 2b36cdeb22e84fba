"""Worth of synchronisation: driving alone, timetable alone, both; with a driver and departures that scatter.

python -m benchmarks.synchronisation --write docs/line.md
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.beside_optimum import table
from benchmarks.report import circumstances, write_section
from metropilot._io import load_or_compute
from metropilot.evaluate import SERIES_STYLES, add_headline, house_style, new_panels
from metropilot.operation import (
    DayTimetable,
    LineDay,
    LineOperation,
    OperationOptions,
    PowerProfile,
    Profiles,
    drive_trips,
    feed_day,
    lay_out_day,
    plain_days,
)
from metropilot.railway import Feeding, Period, ServiceDay, load_feeding, load_line, load_trainset
from metropilot.units import J_PER_KWH

LINE, TRAINSET, LOAD, DRIVER = "yizhuang", "dkz32", "AW2", "manual"
HEADWAYS_S, ZONES = (120, 300), (4, 13)
NETWORK_S = 180
OPTIONS = OperationOptions(time_window_s=0, efficiency_traction=0.9, efficiency_braking=0.76)
RUNS, PHASES, MOVES, SAMPLES = 2, 3, 800, 4
SCATTER_S = (3.0, 10.0)
HOUR_S, LASTS_S = 3600, 2 * 3600
DRIVINGS = "cruise", "optimal", DRIVER


ABOUT = """\
`yizhuang`, `dkz32` AW2, planned running times, dwells of 30 s, efficiencies 0.9 and 0.76,
transfer loss 10 %; kWh a round trip in the second of two hours. Plain: even dwells, mean over {phases}
offsets between the directions. Found: dwells and offset, searched with {moves} moves from
three starts in zones, seed 0, for cruise and brake by itself, for the others with optimal driving.
`manual` is driven {runs} times a trip under protection, and each trip of each train draws one of
these runs; it is a surrogate of a human driver, not a measured one. ± s: every departure moves by up to
so many seconds, evenly drawn, and dwells take it up: mean and standard deviation of {samples} hours."""


@dataclass(frozen=True)
class Row:
    """Energies of a headway and feeding, kWh a round trip.

    Attributes:
        headway_s: Headway.
        feeding: Its name.
        plain: By driving, with even dwells, mean over the offset.
        best: By driving, with the timetable found for cruise and brake, or for optimal driving.
        scattered: Mean and standard deviation of optimal driving with the timetable found, by scatter.
    """

    headway_s: int
    feeding: str
    plain: dict[str, float]
    best: dict[str, float]
    scattered: dict[str, tuple[float, float]]


class Line:
    """The line with all ways of driving it.

    Args:
        folder: Folder that keeps what is finished; None: everything is computed.
    """

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self.operation = LineOperation(load_line(LINE), load_trainset(TRAINSET, LOAD), OPTIONS)
        own_w = self.operation.trainset.auxiliary_w
        received_w = (float("inf"), own_w, 4.0 * own_w)
        self.plans: dict[str, list[Profiles]] = {
            "cruise": [self.operation.profiles("cruise")],
            "optimal": [self.operation.profiles(received_w=each) for each in received_w],
            DRIVER: [self.driven(seed) for seed in range(RUNS)],
        }
        self.random = np.random.default_rng(0)

    def kept(self, name: str, compute: Callable[[], Any]) -> Any:  # noqa: ANN401 (whatever JSON holds)
        """Value from the folder, or computed and kept there."""
        if self.folder is None:
            return compute()
        identity = {"options": repr(OPTIONS), "search": [RUNS, PHASES, MOVES, SAMPLES]}
        return load_or_compute(self.folder / f"{name}.json", identity, compute)

    def driven(self, seed: int) -> Profiles:
        """Powers of all trips as the driver drives them."""

        def drive() -> list[dict[str, Any]]:
            (profiles,) = drive_trips(self.operation, DRIVER, seeds=(seed,))
            return [
                {k: v.tolist() if isinstance(v, np.ndarray) else None for k, v in vars(each).items()}
                for of in profiles
                for each in of.values()
            ]

        rows = self.kept(f"driven-{seed}", drive)
        arrays = [{k: -np.inf if v is None else np.array(v) for k, v in row.items()} for row in rows]
        return [
            {trip.planned_s: PowerProfile(**each)}
            for trip, each in zip(self.operation.trips, arrays, strict=True)
        ]

    def at(self, headway_s: int, zones: int) -> tuple[LineOperation, ServiceDay]:
        """The line with other zones, and hours at a headway."""
        options = replace(OPTIONS, headway_s=headway_s, zones=zones)
        operation = LineOperation(self.operation.line, load_trainset(TRAINSET, LOAD), options)
        operation.members = self.operation.members
        period = Period(name="all", from_s=0, to_s=LASTS_S, headway_s=headway_s)
        return operation, ServiceDay(id="hours", name="hours", line_id=LINE, periods=(period,))

    def kwh(
        self, operation: LineOperation, timetable: DayTimetable, driving: str, feeding: Feeding | None
    ) -> float:
        """Energy of the second hour for one train each way."""
        plans = self.plans[driving]
        if driving == DRIVER:
            timetable = timetable.with_plans(len(plans), self.random)
        day = LineDay(operation, timetable, plans)
        share = operation.options.headway_s / HOUR_S
        if feeding is None:
            power = day.power()
            return float(power.hourly_kwh[1 - power.first_s // HOUR_S]) * share
        flow = feed_day(day, feeding).flow
        first_s = HOUR_S - int(np.floor(day.timetable.span_s[0]))
        net_w = (flow.rectifier_w - flow.inverter_w).sum(axis=1)[first_s : first_s + HOUR_S]
        return float(net_w.sum()) / J_PER_KWH * share

    def row(self, headway_s: int, zones: int, feeding: Feeding | None = None) -> Row:
        """Energies of a headway and feeding."""
        name = f"{headway_s}-{zones if feeding is None else feeding.id}"
        self.random = np.random.default_rng([headway_s, zones])
        return Row(**self.kept(name, lambda: vars(self.compute_row(headway_s, zones, feeding))))

    def compute_row(self, headway_s: int, zones: int, feeding: Feeding | None) -> Row:
        """Energies of a headway and feeding, computed."""
        operation, day = self.at(headway_s, zones)
        starts = plain_days(operation, day, PHASES)
        even = {
            name: float(np.mean([self.kwh(operation, each, name, feeding) for each in starts]))
            for name in DRIVINGS
        }
        found = {
            name: lay_out_day(operation, day, self.plans[name], searched=True, moves=MOVES)
            for name in ("cruise", "optimal")
        }
        best = {
            name: self.kwh(operation, found["cruise" if name == "cruise" else "optimal"], name, feeding)
            for name in DRIVINGS
        }
        scattered = {}
        for seconds in SCATTER_S:
            samples = [
                self.kwh(operation, found["optimal"].scatter(seconds, self.random), "optimal", feeding)
                for _ in range(SAMPLES)
            ]
            scattered[f"{seconds:g}"] = float(np.mean(samples)), float(np.std(samples, ddof=1))
        name = f"{zones} zones" if feeding is None else f"DC network `{feeding.id}`"
        return Row(headway_s, name, even, best, scattered)


def measure(folder: Path | None) -> list[Row]:
    """Rows of all headways and feedings."""
    line = Line(folder)
    rows = [line.row(headway_s, zones) for zones, headway_s in product(ZONES, HEADWAYS_S)]
    return [*rows, line.row(NETWORK_S, 4, load_feeding(LINE))]


def draw(path: Path, rows: list[Row]) -> None:
    """Write the picture: what driving, timetable and both save, by feeding and headway."""
    series = {
        "driving": [row.plain["optimal"] / row.plain["cruise"] for row in rows],
        "timetable": [row.best["cruise"] / row.plain["cruise"] for row in rows],
        "both": [row.best["optimal"] / row.plain["cruise"] for row in rows],
        "both, ±10 s": [row.scattered["10"][0] / row.plain["cruise"] for row in rows],
        "timetable, manual driver": [row.best[DRIVER] / row.plain[DRIVER] for row in rows],
    }
    with house_style():
        figure, (axes,) = new_panels(9.4, 4.4, (1.0,))
        for k, (name, shares) in enumerate(series.items()):
            colour, _ = SERIES_STYLES[k]
            at = np.arange(len(rows)) + 0.16 * (k - 2)
            axes.bar(at, 100.0 * (1.0 - np.array(shares)), width=0.15, color=colour, label=name)
        names = [f"{row.feeding.replace('`', '')}\n{row.headway_s} s" for row in rows]
        axes.set_xticks(np.arange(len(rows)), names)
        axes.set_ylabel("saved, %")
        below = "against cruise and brake with even dwells, mean offset; manual driver against itself"
        add_headline(axes, "Worth of driving and of the timetable", below)
        figure.savefig(path, dpi=110)


def describe(rows: list[Row]) -> str:
    """Part of the page."""
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items())
    cells = []
    for row in rows:
        even, best = row.plain, row.best
        saved = [
            100.0 * (1.0 - kwh / even["cruise"]) for kwh in (even["optimal"], best["cruise"], best["optimal"])
        ]
        by_timetable = [100.0 * (1.0 - best[name] / even[name]) for name in ("optimal", DRIVER)]
        scattered = [f"{mean:.1f} ± {spread:.1f}" for mean, spread in row.scattered.values()]
        cells.append(
            [
                row.feeding,
                f"{row.headway_s}",
                *(f"{even[name]:.1f}" for name in DRIVINGS),
                *(f"{best[name]:.1f}" for name in DRIVINGS),
                *(f"{each:.1f}" for each in (*saved, *by_timetable)),
                *scattered,
            ]
        )
    columns = (
        "feeding",
        "headway s",
        "cruise, plain kWh",
        "optimal, plain kWh",
        f"`{DRIVER}`, plain kWh",
        "cruise, found kWh",
        "optimal, found kWh",
        f"`{DRIVER}`, found kWh",
        "driving alone %",
        "timetable alone %",
        "both %",
        "timetable, optimal driving %",
        f"timetable, `{DRIVER}` %",
        *(f"optimal, found, ±{seconds:g} s kWh" for seconds in SCATTER_S),
    )
    about_runs = ABOUT.format(
        line=LINE,
        trainset=TRAINSET,
        load=LOAD,
        driver=DRIVER,
        phases=PHASES,
        moves=MOVES,
        runs=RUNS,
        samples=SAMPLES,
    )
    picture = "![Saved by driving, by the timetable and by both, by headway.](images/synchronisation.png)"
    command = f"`python -m benchmarks.synchronisation --write docs/line.md`; {about}."
    return "\n\n".join(["## Worth of synchronisation", about_runs, table(columns, cells), picture, command])


def main() -> None:
    """Compute everything; print the part of the page or write it, with its picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep finished rows there")
    options = parser.parse_args()
    page, rows = options.write, measure(options.keep)
    write_section(page, "synchronisation", describe(rows))
    if page is not None:
        draw(page.parent / "images" / "synchronisation.png", rows)


if __name__ == "__main__":
    main()

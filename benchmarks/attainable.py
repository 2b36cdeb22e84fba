"""Optimum, attainable optimum and drives of every section: the table in the docs on planning.

python -m benchmarks.attainable --trainset dkz32 --trainset dkz32@0.6,0.4 --write docs/planning.md
"""

from __future__ import annotations

import argparse
import re
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.beside_optimum import table
from benchmarks.report import circumstances
from metropilot.drivers import DRIVERS
from metropilot.evaluate import Kpis, attainable_of, driving_limits, kpis_of, optimum_of
from metropilot.planning import minimum_running_time
from metropilot.railway import Section, Trainset, load_line, load_trainset
from metropilot.sim import Run, drive

LINE, DRIVERS_SHOWN = "yizhuang", ("optimal", "generalist")
WRITTEN = """\
Written by `{command}`: {runs} runs, all sections of `{line}` both ways in their planned times, load AW0, no
disturbance, nothing random (no seed); {about}."""
SECTIONS = """\
Section by section, kWh at the wheel. Optimum, bound and attainable are for the running time that `{driver}`
achieved; each driver's gaps are for its own."""
START, END = "<!-- benchmarks.attainable -->", "<!-- end of benchmarks.attainable -->"


@dataclass(frozen=True)
class Driven:
    """One drive with its figures, and what the attainable figure took.

    Attributes:
        section: Origin and destination.
        kpis: Key figures.
        ideal_s: Processor time of the ideal optimum.
        attainable_s: Processor time of attainable plan and bound.
    """

    section: str
    kpis: Kpis
    ideal_s: float
    attainable_s: float


def measure(section: Section, trainset: Trainset, driver: str) -> Driven:
    """Drive one section in its planned time and compare it."""
    time_s = float(section.planned_time_s or 1.1 * minimum_running_time(section, trainset))
    driven = drive(Run(section, trainset, time_s), DRIVERS.make(driver))
    began = time.process_time()
    optimum = optimum_of(driven)
    whole_s = time.process_time() - began
    if optimum is None:
        raise RuntimeError(f"{section.name} has no optimum")
    limits = driving_limits(driven.run, driven.section)
    began = time.process_time()
    attainable_of(driven.section, driven.trainset, driven.running_time_s, limits, optimum.plan)
    spent_s = time.process_time() - began
    name = f"{section.origin.code}-{section.destination.code}"
    return Driven(name, kpis_of(driven, optimum), whole_s - spent_s, spent_s)


def spread(values: list[float], digits: int = 2) -> str:
    """Median and worst."""
    return f"{np.median(values):.{digits}f} / {max(values):.{digits}f}" if values else "–"


def summary(trainset: str, found: dict[str, list[Driven]]) -> list[list[str]]:
    """One line for each driver."""
    lines = []
    for driver, rows in found.items():
        kpis = [row.kpis for row in rows]
        sound = [k for k in kpis if k.driver_gap_percent is not None]
        below = sum(k.energy_wheel_kwh < (k.attainable_bound_kwh or 0.0) for k in sound)
        slack = [
            100.0 * (float(k.attainable_energy_kwh or 0.0) / float(k.attainable_bound_kwh or 1.0) - 1.0)
            for k in sound
        ]
        lines.append(
            [
                f"`{trainset}`",
                f"`{driver}`",
                f"{sum(k.on_time for k in kpis)} of {len(kpis)}",
                str(sum(k.interventions for k in kpis)),
                spread([float(k.optimality_gap_percent or 0.0) for k in sound]),
                spread([float(k.trainset_gap_percent or 0.0) for k in sound]),
                spread([float(k.driver_gap_percent or 0.0) for k in sound]),
                spread(slack),
                str(below),
                f"{1e3 * np.median([r.ideal_s for r in rows]):.0f}",
                f"{1e3 * np.median([r.attainable_s for r in rows]):.0f}",
            ]
        )
    return lines


def sections_table(found: dict[str, dict[str, list[Driven]]]) -> str:
    """Energies of ``optimal`` and gaps of both drivers, section by section."""
    heads = ["section", "trainset", "optimum", "bound", "attainable", *(f"`{d}`" for d in DRIVERS_SHOWN)]
    heads += [f"`{d}`: trainset + driver %" for d in DRIVERS_SHOWN]
    lines = []
    for k in range(len(next(iter(found.values()))[DRIVERS_SHOWN[0]])):
        for trainset, drives in found.items():
            own = [drives[d][k].kpis for d in DRIVERS_SHOWN]
            first = own[0]
            energies = (first.optimal_energy_kwh, first.attainable_bound_kwh, first.attainable_energy_kwh)
            cells = ["–" if e is None else f"{e:.2f}" for e in energies]
            cells += [f"{k.energy_wheel_kwh:.2f}" for k in own]
            cells += [
                "–"
                if k.driver_gap_percent is None
                else f"{k.trainset_gap_percent:.2f} + {k.driver_gap_percent:.2f}"
                for k in own
            ]
            lines.append([drives[DRIVERS_SHOWN[0]][k].section, f"`{trainset}`", *cells])
    return table(tuple(heads), lines, words=2)


def text(found: dict[str, dict[str, list[Driven]]], command: str) -> str:
    """The part of the page."""
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items())
    heads = ("trainset", "driver", "on time", "interventions", "above the optimum %", "trainset %")
    heads = (*heads, "driver %", "attainable above its bound %", "drives below the bound")
    heads = (*heads, "ideal optimum ms", "attainable and bound ms")
    lines = [line for trainset, drives in found.items() for line in summary(trainset, drives)]
    runs = sum(len(rows) for drives in found.values() for rows in drives.values())
    return "\n".join(
        [
            START,
            WRITTEN.format(command=command, runs=runs, line=LINE, about=about),
            "",
            "Median / worst over the sections; times are processor times of one call, medians.",
            "",
            table(heads, lines, words=2),
            "",
            SECTIONS.format(driver=DRIVERS_SHOWN[0]),
            "",
            sections_table(found),
            END,
        ]
    )


def main() -> None:
    """Drive everything; print the part of the page or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trainset", action="append", help="id or file, once for each")
    parser.add_argument("--write", type=Path, metavar="PAGE")
    options = parser.parse_args()
    line, names = load_line(LINE), options.trainset or ["dkz32"]
    found: dict[str, dict[str, list[Driven]]] = {}
    for name in names:
        trainset = load_trainset(name)
        both = (*line.sections(), *line.sections(backward=True))
        drives = {driver: [measure(s, trainset, driver) for s in both] for driver in DRIVERS_SHOWN}
        found[trainset.id] = drives
    words = "python -m benchmarks.attainable " + " ".join(f"--trainset {name}" for name in names)
    if options.write is None:
        print(text(found, words))
        return
    page = options.write.read_text()
    part = text(found, f"{words} --write {options.write}")
    if START not in page:
        raise SystemExit(f"{options.write} has no part between {START} and {END}")
    options.write.write_text(re.sub(f"{START}.*{END}", lambda _: part, page, flags=re.DOTALL))


if __name__ == "__main__":
    main()

"""Plans compared with the optima of other solvers, as the page `docs/validation.md`.

python -m benchmarks.validation --write docs/validation.md
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.planning import published

from benchmarks.report import circumstances, write_section
from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import import_file, load_line, load_trainset

HEADINGS = "| case | reference | ours | difference | agreement required | certificate gap |"


@dataclass(frozen=True)
class Case:
    """One number of theirs beside ours.

    Attributes:
        table: Which table it belongs to.
        name: What was computed.
        unit: Its unit.
        reference: Their number.
        ours: Our number.
        asked: Agreement asked for, in words.
        gap: Certificate gap of the plan, or None where there is none.
    """

    table: str
    name: str
    unit: str
    reference: float
    ours: float
    asked: str
    gap: float | None = None

    def row(self) -> str:
        """As a row of the page."""
        small = self.gap is not None and abs(self.gap) < 1e-6
        gap = "" if self.gap is None else "< 1e-4 %" if small else f"{100 * self.gap:.4f} %"
        apart = f"{100 * (self.ours / self.reference - 1):+.2f} %"
        numbers = f"{self.reference:.2f} {self.unit} | {self.ours:.2f} {self.unit}"
        return f"| {self.name} | {numbers} | {apart} | {self.asked} | {gap} |"


def contest() -> Iterator[Case]:
    """The contest's section A6 to A7 and five more, by a nonlinear programme."""
    table, line, trainset = (
        "Contest line, nonlinear programme",
        load_line("yizhuang"),
        load_trainset("dkz32-contest"),
    )
    section = line.section("RC", "RJ")
    fastest = minimum_running_time(section, trainset)
    yield Case(table, "RC to RJ, minimum running time", "s", 85.42, fastest, "0.2 %")
    for time_s, (reference, ends) in published.CONTEST.items():
        plan = optimal_plan(section, trainset, time_s, PlanOptions(start_mps=ends, end_mps=ends))
        ours = plan.energy_j / 1e6
        yield Case(table, f"RC to RJ in {time_s:g} s, wheel", "MJ", reference, ours, "0.3 %", plan.gap)
    options = PlanOptions(start_mps=0.02, end_mps=0.02)
    for (origin, end), (time_s, least, reference) in published.SECTIONS.items():
        section, name = line.section(origin, end), f"{origin} to {end}"
        found = minimum_running_time(section, trainset, start_mps=0.02, end_mps=0.02)
        yield Case(table, f"{name}, minimum running time", "s", least, found, "0.2 %")
        plan = optimal_plan(section, trainset, time_s, options)
        ours = plan.energy_j / 1e6
        yield Case(table, f"{name} in {time_s:g} s, wheel", "MJ", reference, ours, "0.3 %", plan.gap)


def ttobench() -> Iterator[Case]:
    """The benchmark's own line with its own trainset, by ms-eetc."""
    table, line, trainset = "TTOBench, ms-eetc", published.ttobench_line(), load_trainset("cn_beijing_subway")
    options = PlanOptions(objective="line", start_mps=1.0, end_mps=1.0)
    for stops, (_, least, energies) in published.TTOBENCH.items():
        section = line.section(*(line.stations[k] for k in stops))
        name = f"Yizhuang stops {stops[0]} to {stops[1]}"
        found = minimum_running_time(section, trainset, start_mps=1.0, end_mps=1.0)
        yield Case(table, f"{name}, minimum running time", "s", least, found, "0.4 %")
        for time, reference in energies.items():
            seconds = time * least if time < 2 else time
            plan = optimal_plan(section, trainset, seconds, options)
            yield Case(
                table, f"{name} in {seconds:.1f} s, line", "kWh", reference, plan.energy_kwh, "1 %", plan.gap
            )
    if published.TTOBENCH_FILES.is_dir():
        yield from _wil(table, options)


def _wil(table: str, options: PlanOptions) -> Iterator[Case]:
    line = published.roeckl_in_gradients(
        import_file(published.TTOBENCH_FILES / "tracks/CH_StGallen_Wil.json")
    )
    train = import_file(published.TTOBENCH_FILES / "trains/CH_Stadler_FLIRT_TPF.json")
    train, section = dataclasses.replace(train, length_m=0.0), line.section(*line.stations)
    found = minimum_running_time(section, train, start_mps=1.0, end_mps=1.0)
    least = published.WIL_MINIMUM_S
    yield Case(table, "St. Gallen to Wil, minimum running time", "s", least, found, "0.4 %")
    for time, reference in published.WIL.items():
        seconds = time * least if time < 2 else time
        plan = optimal_plan(section, train, seconds, options)
        name = f"St. Gallen to Wil in {seconds:.0f} s, line"
        yield Case(table, name, "kWh", reference, plan.energy_kwh, "1 %", plan.gap)


def whole_line() -> Iterator[Case]:
    """The contest line at its planned times, by a dynamic programme."""
    table, line, trainset = (
        "Contest line, dynamic programme",
        load_line("yizhuang"),
        load_trainset("dkz32-contest"),
    )
    for curves, totals in published.YIZHUANG_TOTAL.items():
        for backward, reference in enumerate(totals):
            energy, worst = 0.0, 0.0
            for section in line.sections(backward=bool(backward)):
                here = section if curves else dataclasses.replace(section, curves=())
                seconds = 103.0 if section.name == "RJ-WYJ" else float(section.planned_time_s or 0.0)
                plan = optimal_plan(here, trainset, seconds)
                energy, worst = energy + plan.energy_kwh, max(worst, plan.gap)
            way, bends = "up" if backward else "down", "with" if curves else "without"
            name = f"thirteen runs {way}, {bends} curves, wheel"
            yield Case(table, name, "kWh", reference, energy, "0 to 1.2 % below", worst)


def page() -> str:
    """The tables."""
    lines, last = [], ""
    for case in (*contest(), *ttobench(), *whole_line()):
        if case.table != last:
            lines += ["", f"## {case.table}", "", HEADINGS, "|---|---:|---:|---:|---:|---:|"]
            last = case.table
        lines.append(case.row())
    about = circumstances(("metropilot", "clarabel", "numpy"))
    return "\n".join([*lines, "", "Computed with " + "; ".join(f"{k}: {v}" for k, v in about.items()) + "."])


def main() -> None:
    """Print the tables, or replace them in a page."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.validation", description="Plans compared with other solvers."
    )
    parser.add_argument("--write", type=Path, metavar="PAGE", help="replace the tables of a page")
    options = parser.parse_args()
    text = page()
    write_section(options.write, "validation", text)


if __name__ == "__main__":
    main()

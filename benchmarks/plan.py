"""Plan time per section and for the whole journey, against the same problem in CasADi/IPOPT in the same run.

python -m benchmarks.plan
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy import ndarray

from benchmarks.nlp import Found, Problem, solve_nlp
from benchmarks.report import Benchmark, Row, run
from benchmarks.shooting import solve_shooting
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import (
    PlanOptions,
    build_mesh,
    fastest_profile,
    minimum_running_time,
    optimal_plan,
    plan_journey,
    specific,
    timetable_waypoints,
)
from metropilot.railway import Line, Section, Trainset, load_line, load_trainset

RATIO = 1.1
REPEATS = 3
SPACING_M = 12.5
ENDS_MPS = 0.5


def problem(section: Section, trainset: Trainset, stops_m: ndarray, times_s: ndarray) -> Problem:
    """The programme of a plan as numbers: mesh, trainset, where it stands, and when it must have arrived."""
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    mesh, table = build_mesh(vehicle, track, stops_m, SPACING_M), specific(vehicle)
    cap = mesh.cap_mps.copy()
    cap[mesh.stop] = 0.0
    mesh = mesh._replace(cap_mps=cap)
    return Problem(mesh, table, fastest_profile(table, mesh), times_s)


def median_s(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median wall time of a few calls."""
    found = []
    for _ in range(repeats):
        began = time.perf_counter()
        work()
        found.append(time.perf_counter() - began)
    return statistics.median(found)


@dataclass
class Transcription:
    """Results of one way of writing the problem for IPOPT, over the sections."""

    name: str
    solve: Callable[[Problem], Found]
    found: list[Found] = field(default_factory=list)
    apart: list[float] = field(default_factory=list)

    def race(self, given: Problem, energy_j: float) -> None:
        """Solve one section; ``energy_j`` is our optimum."""
        found = self.solve(given)
        self.found.append(found)
        if found.solved:
            self.apart.append(100 * abs(found.energy_j / energy_j - 1))

    def rows(self, ours_s: float, target: str = "") -> list[Row]:
        """Times over all sections that were solved."""
        solved = [f for f in self.found if f.solved]
        rows = [Row(f"{self.name}: solved", len(solved), f"of {len(self.found)}")]
        if solved:
            alone = statistics.median(f.solve_s for f in solved)
            whole = statistics.median(f.solve_s + f.build_s for f in solved)
            rows += [
                Row(f"{self.name}: solving alone", 1e3 * alone, "ms", alone / ours_s, target),
                Row(f"{self.name}: building and solving", 1e3 * whole, "ms", whole / ours_s, target),
                Row(f"{self.name}: largest difference in energy", max(self.apart), "%"),
            ]
        return rows


def transcriptions() -> tuple[Transcription, Transcription]:
    """Multiple shooting, the usual form, and a transcription with the structure of the convex plan."""
    return (
        Transcription("IPOPT, multiple shooting", lambda p: solve_shooting(p, ENDS_MPS)),
        Transcription("IPOPT, our transcription", solve_nlp),
    )


def measure_sections(line: Line, trainset: Trainset) -> list[Row]:
    """All 26 sections at 1.1 of the minimum running time, the solvers one after the other."""
    usual, plain = transcriptions()
    ours = []
    rolling = PlanOptions(start_mps=ENDS_MPS, end_mps=ENDS_MPS)
    for section in (*line.sections(), *line.sections(backward=True)):
        seconds = RATIO * minimum_running_time(section, trainset)
        ours.append(median_s(lambda s=section, t=seconds: optimal_plan(s, trainset, t)))
        given = problem(section, trainset, np.array([0.0, section.length_m]), np.array([seconds]))
        usual.race(given, optimal_plan(section, trainset, seconds, rolling).energy_j)
        plain.race(given, optimal_plan(section, trainset, seconds).energy_j)
    middle = statistics.median(ours)
    return [
        Row("convex plan of a section, all of it", 1e3 * middle, "ms", 1.0, "50 ms"),
        Row("convex plan, slowest section", 1e3 * max(ours), "ms", max(ours) / middle),
        *usual.rows(middle, ">= 20 x"),
        *plain.rows(middle),
    ]


def measure_journey(line: Line, trainset: Trainset) -> list[Row]:
    """The whole line with its timetable: thirteen runs, one programme."""
    points = timetable_waypoints(line)
    ours = median_s(lambda: plan_journey(line, trainset, points))
    energy = plan_journey(line, trainset, points).plan.energy_j
    rows = [Row("convex plan of the 22.7 km journey", ours, "s", 1.0, "2 s")]
    section = line.section(line.stations[0], line.stations[-1])
    stops = np.array([p.position_m for p in points])
    given = problem(section, trainset, stops, np.array(line.planned_forward_s))
    for transcription, target in zip(transcriptions(), (">= 20 x", ""), strict=True):
        found = transcription.solve(given)
        what = transcription.name if found.solved else f"{transcription.name}: gave up after"
        rows.append(Row(f"{what}, journey", found.solve_s, "s", found.solve_s / ours, target))
        if found.solved:
            apart = 100 * abs(found.energy_j / energy - 1)
            rows.append(Row(f"{transcription.name}, journey: difference in energy", apart, "%"))
    return rows


def measure() -> list[Row]:
    """Sections, then the journey."""
    line, trainset = load_line("yizhuang"), load_trainset("dkz32-contest")
    return [*measure_sections(line, trainset), *measure_journey(line, trainset)]


BENCHMARK = Benchmark(
    name="plan",
    title="Plan time",
    packages=("metropilot", "clarabel", "casadi", "numpy", "scipy"),
    measure=measure,
    note=(
        f"Wall time, medians. Yizhuang line, trainset `dkz32-contest`, {RATIO} of the minimum running time; "
        "the journey keeps the timetable. The time of the convex plan is that of the whole call: arrays, "
        "mesh, flat-out run, all passes. Both IPOPT transcriptions get the same mesh, limits, resistance and "
        "effort curves (as splines) in CasADi with exact derivatives, MUMPS and IPOPT's default options, "
        "vectorised. *Multiple shooting* is how such problems are usually written (ms-eetc: states time and "
        "speed squared, Runge-Kutta over a segment, guess 60 km/h, 0.5 m/s at stops, which saves 1.5 % on the"
        " journey). *Our transcription* uses the structure of the convex plan (nodes on every break, speeds "
        "as the only states, times in closed form) and starts from the flat-out run limited in speed: most of"
        " the speed-up comes from there, but without a certificate. Each ratio is to the convex plan of the "
        "same case."
    ),
)

if __name__ == "__main__":
    run([BENCHMARK])

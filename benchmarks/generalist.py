"""The generalist on lines it never saw, against the optimum: the page of the docs.

python -m benchmarks.generalist --write docs/generalist.md

``METROPILOT_TTOBENCH`` names a folder of TTOBench tracks to drive besides; they are not part of the project.
"""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.beside_optimum import Result, beside_optimum, table, worst
from benchmarks.report import circumstances, hand_out, page_options
from metropilot.errors import MetropilotError
from metropilot.planning import minimum_running_time
from metropilot.policy import load_driving_policy, shipped_policy
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Disturbance, Run

DRIVER, BESIDE = "generalist", "optimal"
LINE, TRAINSET, LOADS = "yizhuang", "dkz32", ("AW0", "AW2", "AW3")
RATIOS = (0.0, 1.05, 1.1, 1.2, 1.4)
"""Scheduled time over the minimum of section and load; 0: the time planned by the line."""
IDEAL, LIMITED = "ideal actuation", "jerk limit"
SCENARIOS = {IDEAL: Disturbance(ideal=True), LIMITED: Disturbance()}
TARGETS = {IDEAL: (0.7, 2.5, 5.0), LIMITED: (2.5, 5.0, 8.0)}
"""Gap to the optimum, per cent: median, 95th percentile, worst."""
ON_TIME_S, IN_PLACE_M = 1.0, 0.3
LONGEST_M = 10_000.0
SHOWN = 8

PAGE = """# One driver for every line

`generalist` is one small network for every line, trained without any real line. The training data are random
sections of 0.5 to 8 km with random trainsets of 80 to 500 t (the task `worlds`, domain randomisation).
It learns in two steps: imitation of the optimal plan from {states:,} states on and near the plan, and then
closed-loop driving, in which the gradient of energy and arrival time reaches the policy through the drive.
It observes distances, limits, gradients, effort and resistance of the trainset, the time left, the time to go
flat out, at a steady speed and coasting, and the mean speed that the time left requires; nothing identifies a
place. Station-stop braking and the reduction of traction below the ceiling are [assists](task.md#assists);
protection supervises every run. The tables below give its gap to the optimum on lines outside its training.

```sh
metropilot drive yizhuang RJ WYJ --time 110 --driver generalist
```

`metropilot learn generalist --budget paper` trains it again.

Every run below is driven by the host loop (`metropilot drive`) and compared with the optimal plan for the
running time it achieved (wheel traction energy). That optimum includes neither the jerk limit nor protection.
Written by `python -m benchmarks.generalist --write docs/generalist.md`: {about}.

## Zero shot: all sections of the Yizhuang line, both ways, {loads}

Scheduled times: as planned by the line, and {ratios} of the minimum of section and load; a planned time below
1.05 of the minimum is left out.

{summary}

Targets: median {medians}, 95th percentile {tails}, worst {worsts} % (ideal actuation / jerk limit); arrival
within 1 s and 0.3 m in every run, no intervention. {verdict}

{by_time}

The last column is `optimal`, which drives the plan made with the jerk limit: the gap that this limit and
protection require.

### The runs farthest above the optimum

{farthest}

{elsewhere}
## Training

{training}
"""


@dataclass(frozen=True)
class Case:
    """One run to drive; ``ratio`` 0 is the planned time."""

    line: str
    origin: str
    destination: str
    trainset: str
    load: str
    ratio: float
    scenario: str
    driver: str = DRIVER


def drive_case(case: Case) -> Result | None:
    """Drive one case and compare it with the optimum for the running time it achieved; None: left out."""
    line = load_line(case.line)
    section = line.section(case.origin, case.destination)
    trainset = load_trainset(case.trainset, case.load or None)
    shortest = minimum_running_time(section, trainset)
    planned = section.planned_time_s or 0.0
    scheduled_s = case.ratio * shortest if case.ratio else planned
    if scheduled_s < min(RATIOS[1:]) * shortest - 1e-6:
        return None
    return beside_optimum(case, Run(section, trainset, scheduled_s, SCENARIOS[case.scenario]), case.driver)


def cases() -> list[Case]:
    """Scenarios x sections x loads x scheduled times, under the jerk limit also of the driver beside it."""
    line = load_line(LINE)
    sections = (*line.sections(), *line.sections(backward=True))
    return [
        Case(LINE, section.origin.code, section.destination.code, TRAINSET, load, ratio, name, driver)
        for name, driver in (*((name, DRIVER) for name in SCENARIOS), (LIMITED, BESIDE))
        for section in sections
        for load in LOADS
        for ratio in RATIOS
    ]


def others(folder: Path) -> list[Case]:
    """Every section of the TTOBench tracks in a folder that is no longer than ``LONGEST_M``."""
    found = []
    for path in sorted(folder.glob("tracks/*.json")):
        try:
            sections = load_line(str(path)).sections()
        except MetropilotError:
            continue
        for section in sections:
            if section.length_m <= LONGEST_M:
                ends = section.origin.code, section.destination.code
                found += [Case(str(path), *ends, TRAINSET, "AW2", ratio, LIMITED) for ratio in (1.1, 1.3)]
    return found


def line_of(name: str, some: list[Result]) -> list[str]:
    """The figures of a few runs."""
    gaps = np.array([r.gap for r in some])
    return [
        name,
        f"{len(some)}",
        f"{sum(is_success(r) for r in some)}",
        f"{worst([r.time_error_s for r in some]):+.2f}",
        f"{worst([r.stop_error_m for r in some]):+.3f}",
        f"{max(r.overspeed_mps for r in some):.3f}",
        f"{sum(r.interventions for r in some)}",
        f"{np.median(gaps):.2f}",
        f"{np.percentile(gaps, 95):.2f}",
        f"{gaps.max():.2f}",
        f"{np.median([r.decision_us for r in some]):.0f}",
    ]


HEADS = ("runs", "within 1 s and 0.3 m", "worst time error s", "worst stop error m", "overspeed m/s")
HEADS = (*HEADS, "interventions", "gap median %", "95th %", "worst %", "decision us")


def is_success(r: Result) -> bool:
    """True for a run that arrived in place and on time."""
    return r.outcome == "arrived" and abs(r.time_error_s) <= ON_TIME_S and abs(r.stop_error_m) <= IN_PLACE_M


def verdict(results: list[Result]) -> str:
    """Which targets are met, in words."""
    missed = []
    for name, most in TARGETS.items():
        some = [r for r in results if r.case.scenario == name]
        gaps = np.array([r.gap for r in some])
        found = float(np.median(gaps)), float(np.percentile(gaps, 95)), float(gaps.max())
        for word, value, target in zip(("median", "95th percentile", "worst"), found, most, strict=True):
            if value > target:
                missed.append(f"{name}, {word}: {value:.2f} % instead of {target:g} %")
        late = sum(not is_success(r) for r in some)
        if late:
            missed.append(f"{name}: {late} of {len(some)} runs not within 1 s and 0.3 m")
        count = sum(r.interventions > 0 for r in some)
        if count:
            missed.append(f"{name}: interventions in {count} of {len(some)} runs")
    return "Missed: " + "; ".join(missed) + "." if missed else "All are met."


def by_time(results: list[Result], beside: list[Result]) -> str:
    """Gap by scheduled time, ideal / jerk limit, and the driver beside it."""
    columns = {name: [r for r in results if r.case.scenario == name] for name in SCENARIOS}
    columns[f"`{BESIDE}`, {LIMITED}"] = beside
    lines = []
    for ratios, words in [*(((ratio,), f"{ratio:g} of the minimum") for ratio in RATIOS), (RATIOS, "all")]:
        gaps = [[r.gap for r in some if r.case.ratio in ratios] for some in columns.values()]
        cells = (f"{np.median(g):.2f} / {np.percentile(g, 95):.2f} / {max(g):.2f}" for g in gaps)
        lines.append([words if ratios != (0.0,) else "as planned", *cells])
    heads = ("scheduled time", *(f"{name}: median / 95th / worst %" for name in columns))
    return table(heads, lines)


def farthest(results: list[Result]) -> str:
    """The runs farthest above the optimum."""
    lines = []
    for r in sorted(results, key=lambda r: -r.gap)[:SHOWN]:
        c = r.case
        lines.append(
            [
                f"{c.origin} to {c.destination}, {c.load}, {c.scenario}",
                f"{r.scheduled_s:.1f}",
                f"{r.time_error_s:+.2f}",
                f"{r.gap:.2f}",
            ]
        )
    return table(("run", "scheduled s", "time error s", "gap %"), lines)


def elsewhere(results: list[Result]) -> str:
    """The section on other lines."""
    if not results:
        return ""
    known = sorted({r.case.line for r in results})
    lines = [line_of(Path(name).stem, [r for r in results if r.case.line == name]) for name in known]
    words = (
        "Every section up to 10 km of the tracks of TTOBench (a public benchmark), with `dkz32` at AW2 under "
        "its jerk limit, 1.1 and 1.3 of the minimum."
    )
    return f"## Other lines\n\n{words}\n\n{table(('track', *HEADS), lines)}\n\n"


def training_table() -> str:
    """Table of the training, from the policy file."""
    about: Any = load_driving_policy(shipped_policy(DRIVER)).about
    told, came = about["config"], about["provenance"]
    lines = [
        ["command", f"`{came['command']}`"],
        [
            "demonstrations",
            f"{told['worlds']:,} random sections, {told['plans']} plans each, {told['states']} states a plan",
        ],
        ["imitation", f"{told['batches']:,} gradient steps of {told['batch_size']:,} states"],
        ["closed loop", f"{came['steps']:,} decisions, {told['decisions']:,} in a gradient step"],
        ["network", " x ".join(map(str, told["hidden"])) + f", {told['activation']}"],
        ["seed", f"{about['seed']}"],
        ["training without demonstrations", f"{came['seconds']:.0f} s"],
        ["machine, date, commit", f"{came['machine']}; {came['date']}; {came['commit'][:9]}"],
    ]
    return table(("what", "value"), lines, words=2)


def page(results: list[Result], beside: list[Result], elsewhere_too: list[Result]) -> str:
    """The page of the docs."""
    about = circumstances(("metropilot", "clarabel", "numpy", "scipy"))
    told: Any = load_driving_policy(shipped_policy(DRIVER)).about["config"]
    targets = list(zip(*TARGETS.values(), strict=True))
    medians, tails, worsts = (" / ".join(f"{value:g}" for value in pair) for pair in targets)
    lines = [line_of(name, [r for r in results if r.case.scenario == name]) for name in SCENARIOS]
    return PAGE.format(
        states=told["worlds"] * told["plans"] * told["states"],
        about="; ".join(f"{k} {v}" for k, v in about.items()),
        loads=", ".join(LOADS),
        ratios=", ".join(f"{ratio:g}" for ratio in RATIOS[1:]),
        summary=table(("scenario", *HEADS), lines),
        medians=medians,
        tails=tails,
        worsts=worsts,
        verdict=verdict(results),
        by_time=by_time(results, beside),
        farthest=farthest(results),
        elsewhere=elsewhere(elsewhere_too),
        training=training_table(),
    )


def main() -> None:
    """Drive everything on all cores; print the page or write it, and the rows beside it as JSON."""
    options = page_options(__doc__)
    folder = os.environ.get("METROPILOT_TTOBENCH")
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), context) as pool:
        results = [r for r in pool.map(drive_case, cases(), chunksize=4) if r]
        more = others(Path(folder)) if folder else []
        elsewhere_too = [r for r in pool.map(drive_case, more, chunksize=4) if r]
    ours = [r for r in results if r.case.driver == DRIVER]
    beside = [r for r in results if r.case.driver == BESIDE]
    hand_out(options, page(ours, beside, elsewhere_too), [*results, *elsewhere_too])


if __name__ == "__main__":
    main()

"""The learned drivers on the section they learned, against the optimum: the table of the docs.

python -m benchmarks.learned_driver --write docs/learned-driver.md
"""

from __future__ import annotations

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.beside_optimum import Result, beside_optimum, table, worst
from benchmarks.report import circumstances, hand_out, page_options
from metropilot.planning import minimum_running_time
from metropilot.policy import load_driving_policy, shipped_policy
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Disturbance, Run

LINE, ORIGIN, DESTINATION = "yizhuang", "RJ", "WYJ"
TRAINSET, LOADS = "dkz32", ("AW0", "AW2", "AW3")
LEARNED = ("ppo_scaled", "ppo")
SHORTEST, LONGEST_S = 1.08, 130.0
SHARES = (0.0, 0.06, 0.12, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0)
"""Scheduled times between the shortest, 1.08 of the load's minimum, and 130 s."""
SCENARIOS = {"ideal actuation": Disturbance(ideal=True), "jerk limit": Disturbance()}
TARGETS = {"ideal actuation": (3.0, 6.0), "jerk limit": (5.0, None)}
"""Gap to the optimum, per cent: median and worst."""

PAGE = """# Drivers learned by PPO

This page compares two drivers learned by PPO with the optimum. Each is one policy for Rongjing to Wanyuan
Street, for every load and every scheduled time from {shortest} of the load's minimum to {longest:g} s,
with and without the jerk limit of the trainset.
`ppo_scaled` divides its rewards by the running deviation of the return (Chen23a eq. 23), `ppo` does not.

The policies learn when to power, hold and coast, and how early to slow down. Station-stop braking and the
reduction of traction below the ceiling are [assists](task.md#assists). Protection supervises every run with
nodes every metre; training used nodes every 4 m and a decision every 0.5 s, while the plant here has a period
of 0.2 s.

```sh
metropilot drive yizhuang RJ WYJ --time 110 --driver ppo_scaled
```

Every run is compared with the optimal plan for the running time it achieved, under the same limits (wheel
traction energy). That optimum includes neither the jerk limit nor protection; the last columns are the
optimum of the same problem with the jerk limit but without protection: the cost of the jerk limit alone.
Written by `python -m benchmarks.learned_driver --write`: {about}.

## The grid: {times} scheduled times, {loads}

{summary}

Targets: arrival within 1 s and 0.3 m, no intervention; with ideal actuation a median gap of at most 3 % and
none above 6 %, with the jerk limit a median of at most 5 %. {verdict}

## Training

{learned}

Seconds are training time on one core, with evaluations, without compilation;
`metropilot show DRIVER` prints the whole configuration.

## Gap to the optimum, run by run

Per cent, ideal actuation / with the jerk limit; scheduled times from the shortest (column 0) to {longest:g} s
(column 1).

{grid}
"""


@dataclass(frozen=True)
class Case:
    """One run to drive: a driver, a load, a scheduled time and a scenario."""

    driver: str
    load: str
    share: float
    scenario: str


def drive_case(case: Case) -> Result:
    """Drive one case and compare it with the optimum for the running time it achieved."""
    section, trainset = load_line(LINE).section(ORIGIN, DESTINATION), load_trainset(TRAINSET, case.load)
    shortest = SHORTEST * minimum_running_time(section, trainset)
    scheduled_s = shortest + case.share * (LONGEST_S - shortest)
    run = Run(section, trainset, scheduled_s, SCENARIOS[case.scenario])
    return beside_optimum(case, run, case.driver, floor=case.scenario == "jerk limit")


def cases() -> list[Case]:
    """Drivers x scenarios x loads x scheduled times."""
    return [Case(d, load, s, name) for d in LEARNED for name in SCENARIOS for load in LOADS for s in SHARES]


def summary(results: list[Result]) -> str:
    """One line a driver and scenario."""
    heads = ("driver", "scenario", "runs", "arrived", "worst time error s", "worst stop error m")
    heads = (*heads, "overspeed m/s", "interventions", "gap median %", "95th %", "worst %")
    heads = (*heads, "jerk-limited optimum: median %", "worst %", "decision us")
    lines = []
    for driver in LEARNED:
        for name in SCENARIOS:
            some = of(results, driver, name)
            gaps, floors = np.array([r.gap for r in some]), np.array([r.floor for r in some])
            known = name == "jerk limit"
            lines.append(
                [
                    f"`{driver}`",
                    name,
                    f"{len(some)}",
                    f"{sum(r.outcome == 'arrived' for r in some)}",
                    f"{worst([r.time_error_s for r in some]):+.2f}",
                    f"{worst([r.stop_error_m for r in some]):+.3f}",
                    f"{max(r.overspeed_mps for r in some):.3f}",
                    f"{sum(r.interventions for r in some)}",
                    f"{np.median(gaps):.2f}",
                    f"{np.percentile(gaps, 95):.2f}",
                    f"{gaps.max():.2f}",
                    f"{np.median(floors):.2f}" if known else "",
                    f"{floors.max():.2f}" if known else "",
                    f"{np.median([r.decision_us for r in some]):.0f}",
                ]
            )
    return table(heads, lines, words=2)


def of(results: list[Result], driver: str, scenario: str) -> list[Result]:
    """The results of a driver in a scenario."""
    return [r for r in results if (r.case.driver, r.case.scenario) == (driver, scenario)]


def verdict(results: list[Result]) -> str:
    """Which targets each driver met, in words."""
    sentences = []
    for driver in LEARNED:
        missed = []
        for name, (median, most) in TARGETS.items():
            some = of(results, driver, name)
            gaps = np.array([r.gap for r in some])
            if any(r.outcome != "arrived" or abs(r.time_error_s) > 1.0 or r.interventions for r in some):
                missed.append(f"{name}: arrival or intervention")
            if np.median(gaps) > median:
                missed.append(f"{name}: median {np.median(gaps):.2f} %")
            if most is not None and gaps.max() > most:
                missed.append(f"{name}: worst {gaps.max():.2f} %")
        sentences.append(f"`{driver}` " + (f"misses {'; '.join(missed)}." if missed else "meets them all."))
    return " ".join(sentences)


def learning_rows() -> str:
    """Record of learning in each policy's file."""
    heads = ("driver", "environment steps", "seconds", "seed", "machine", "date", "commit", "command")
    lines = []
    for driver in LEARNED:
        about: Any = load_driving_policy(shipped_policy(driver)).about
        from_ = about["provenance"]
        lines.append(
            [
                f"`{driver}`",
                f"{from_['steps']:,}",
                f"{from_['seconds']:.0f}",
                f"{about['seed']}",
                from_["machine"],
                from_["date"],
                from_["commit"][:9],
                f"`{from_['command']}`",
            ]
        )
    return table(heads, lines)


def grid(results: list[Result]) -> str:
    """Gap of every run: ideal / jerk limit."""
    found = {(r.case.driver, r.case.load, r.case.share, r.case.scenario): r for r in results}
    columns = [f"{share:g}" for share in SHARES]
    lines = []
    for driver in LEARNED:
        for load in LOADS:
            pairs = [[found[driver, load, share, name].gap for name in SCENARIOS] for share in SHARES]
            ends = found[driver, load, SHARES[0], "jerk limit"].scheduled_s
            lines.append([f"`{driver}`", load, f"{ends:.1f}", *(f"{a:.1f} / {b:.1f}" for a, b in pairs)])
    return table(("driver", "load", "shortest s", *columns), lines, words=2)


def page(results: list[Result]) -> str:
    """The page of the docs."""
    about = circumstances(("metropilot", "clarabel", "numpy", "scipy"))
    return PAGE.format(
        shortest=SHORTEST,
        longest=LONGEST_S,
        times=len(SHARES),
        loads=", ".join(LOADS),
        about="; ".join(f"{k} {v}" for k, v in about.items()),
        summary=summary(results),
        verdict=verdict(results),
        learned=learning_rows(),
        grid=grid(results),
    )


def main() -> None:
    """Drive everything on all cores; print the page or write it, and the rows beside it as JSON."""
    options = page_options(__doc__)
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(os.cpu_count(), context) as pool:
        results = list(pool.map(drive_case, cases(), chunksize=4))
    hand_out(options, page(results), results)


if __name__ == "__main__":
    main()

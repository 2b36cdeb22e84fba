"""The generalist on lines and trainsets it never saw, against the optimum: the page of the docs.

python -m benchmarks.generalist --write docs/generalist.md
python -m benchmarks.generalist --sample 60 --rows rows.jsonl --tried RUN --trainset mine.toml

``--ttobench`` names a folder of TTOBench tracks to drive besides; they are not part of the project.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.beside_optimum import Result, beside_optimum, table, worst
from benchmarks.report import circumstances, find_section
from metropilot.errors import MetropilotError
from metropilot.planning import minimum_running_time
from metropilot.policy import load_driving_policy, shipped_policy
from metropilot.railway import load_line, load_trainset, parse_trainset
from metropilot.sim import Disturbance, Run

DRIVER, BESIDE = "generalist", "optimal"
LINE, TRAINSET, LOADS = "yizhuang", "dkz32", ("AW0", "AW2", "AW3")
RATIOS = (0.0, 1.05, 1.1, 1.2, 1.4)
"""Scheduled time over the minimum of section and load; 0: the time planned by the line."""
IDEAL, LIMITED = "ideal actuation", "jerk limit"
SCENARIOS = {IDEAL: Disturbance(ideal=True), LIMITED: Disturbance()}
TARGETS = {IDEAL: (0.35, 1.5, 3.0), LIMITED: (0.5, 1.5, 3.0)}
"""Energy above the optimum (ideal) or above the attainable one, per cent: median, 95th percentile, worst."""
TARGET_TIME_S, TARGET_STOP_M = 0.5, 0.1
ON_TIME_S, IN_PLACE_M = 1.0, 0.3
LONGEST_M = 10_000.0
SHOWN = 8
WIDE_LINES = ("yizhuang", "yizhuang-ttobench", "lu2023", "zurich-stadelhofen")
WIDE_TRAINSETS = (
    "cn_beijing_subway",
    "ch_stadler_flirt_tpf",
    "ch_stadler_kiss_sbb",
    "nl_intercity_virm6",
    "de_traxx_ic2",
    "de_desiro_classic",
    *(f"drawn-18-{k}" for k in range(12)),
)
LATE = {None: "their own", (0.0, 0.0): "none", (0.6, 0.4): "0.6 s, 0.4 s", (1.0, 0.6): "1 s, 0.6 s"}
"""Dead time and lag that a trainset declares, s, in words; None: its own."""
WIDE_RATIOS = (1.15, 1.35)
SEEDS = "generalist seeds"
"""Section of the page that :mod:`benchmarks.generalist_seeds` writes."""
WIDE_RUNS = 2
"""Sections drawn for each trainset; it drives them with every dead time and lag."""

PAGE = """# One driver for every line

`generalist` is one small network for every line, trained without any real line. The training data are random
{worlds} (the task `worlds`, domain randomisation).
It learns in two steps: imitation of the optimal plan from {states:,} states on and near the plan, and then
closed-loop driving, in which the gradient of energy and arrival time reaches the policy through the drive.
It observes distances, limits, gradients, effort and resistance of the trainset, the time left, the time to go
flat out, at a steady speed and coasting, and the mean speed that the time left requires; nothing identifies a
place. Its traction is capped at what coasting then needs to arrive on time, holds speed where coasting would
be slightly late, and is full where flat out is only just on time
([why](decisions/0024-needed-traction.md)). Station-stop braking and the reduction of traction below the
ceiling are [assists](task.md#assists); protection supervises every run. With a declared dead time it sees
the state in which its command begins to act. The tables below
give its energy above the optimum on lines and trainsets outside its training.

```sh
metropilot drive yizhuang RJ WYJ --time 110 --driver generalist
```

`{command}` trains it again.

Every run below is driven by the host loop (`metropilot drive`) and compared, for the running time it
achieved, with the optimal plan (*gap*: wheel traction energy above the bound of an ideal trainset, which
knows neither jerk limit nor protection) and with the
[attainable optimum](planning.md#the-attainable-optimum) (*above attainable*), which knows jerk limit, dead
time, lag and permitted speed.
Written by `{written}`{sampled}: {about}.

## Zero shot: all sections of the Yizhuang line, both ways, {loads}

Scheduled times: as planned by the line, and {ratios} of the minimum of section and load; a planned time below
1.05 of the minimum is left out.

{summary}

Targets: {targets}; within {time:g} s and {stop:g} m in every run, no intervention. {verdict}

{by_time}

### The runs farthest above the optimum

{farthest}

## Other trainsets

{wide}

{elsewhere}{other}## Training

{training}
"""


@dataclass(frozen=True)
class Case:
    """One run to drive; ``ratio`` 0 is the planned time, ``policy`` another one than the driver's own."""

    line: str
    origin: str
    destination: str
    trainset: str
    load: str
    ratio: float
    scenario: str
    driver: str = DRIVER
    policy: str = ""


def drive_case(case: Case) -> Result | None:
    """Drive one case and compare it with the optimum for the running time it achieved; None: left out."""
    section = load_line(case.line).section(case.origin, case.destination)
    trainset = load_trainset(case.trainset, case.load or None)
    shortest = minimum_running_time(section, trainset)
    planned = section.planned_time_s or 0.0
    scheduled_s = case.ratio * shortest if case.ratio else planned
    if scheduled_s < min(RATIOS[1:]) * shortest - 1e-6:
        return None
    run = Run(section, trainset, scheduled_s, SCENARIOS[case.scenario])
    return beside_optimum(case, run, case.driver, policy=case.policy)


def cases(sample: int) -> list[Case]:
    """Scenarios x sections x loads x scheduled times, under the jerk limit also of the driver beside it."""
    line = load_line(LINE)
    sections = (*line.sections(), *line.sections(backward=True))
    every = [(section, load, ratio) for section in sections for load in LOADS for ratio in RATIOS]
    if sample:
        picked = np.random.default_rng(0).permutation(len(every))[:sample]
        every = [every[k] for k in sorted(picked)]
    return [
        Case(LINE, section.origin.code, section.destination.code, TRAINSET, load, ratio, name, driver)
        for name, driver in (*((name, DRIVER) for name in SCENARIOS), (LIMITED, BESIDE))
        for section, load, ratio in every
    ]


def wide_cases(files: list[str]) -> list[Case]:
    """Every other trainset on a few sections, the same ones with every declared dead time and lag."""
    lines = [load_line(name) for name in WIDE_LINES]
    sections = [(line, section) for line in lines for section in line.sections()]
    found = []
    for number, name in enumerate((*WIDE_TRAINSETS, *files)):
        random = np.random.default_rng(number)
        loads, key = list(load_trainset(name).loads), parse_trainset(name)
        for k in random.permutation(len(sections))[:WIDE_RUNS]:
            line, section = sections[k]
            ends = section.origin.code, section.destination.code
            load, ratio = str(random.choice(loads)), float(random.choice(WIDE_RATIOS))
            found += [
                Case(line.id, *ends, str(key._replace(actuation=late)), load, ratio, LIMITED) for late in LATE
            ]
    return found


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


def drive_all(wanted: list[Case], processes: int, rows: Path | None) -> dict[Case, Result]:
    """Drive every case that is not in the rows yet, and add it to them."""
    known: dict[Case, Result | None] = {}
    for text in rows.read_text().splitlines() if rows and rows.exists() else ():
        case, values = json.loads(text)
        known[Case(**case)] = Result(case=Case(**case), **values) if values else None
    missing = [case for case in dict.fromkeys(wanted) if case not in known]
    for case, result in zip(missing, _drive_missing(missing, processes), strict=True):
        known[case] = result
        if rows:
            values = {k: v for k, v in asdict(result).items() if k != "case"} if result else None
            with rows.open("a") as file:
                file.write(json.dumps([asdict(case), values]) + "\n")
    return {case: result for case in wanted if (result := known[case])}


def _drive_missing(missing: list[Case], processes: int) -> Iterator[Result | None]:
    if processes == 1:
        yield from map(drive_case, missing)
        return
    with ProcessPoolExecutor(processes, multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(drive_case, missing, chunksize=4)


def spread(values: list[float]) -> str:
    """Median, 95th percentile and largest of the numbers there are."""
    sound = np.array([value for value in values if np.isfinite(value)])
    return (
        f"{np.median(sound):.2f} / {np.percentile(sound, 95):.2f} / {sound.max():.2f}" if sound.size else "–"
    )


def line_of(name: str, some: list[Result]) -> list[str]:
    """The figures of a few runs; energy of those that arrived."""
    arrived = [r for r in some if r.outcome == "arrived"]
    return [
        name,
        f"{len(some)}",
        f"{sum(is_success(r) for r in some)}",
        f"{worst([r.time_error_s for r in some]):+.2f}",
        f"{worst([r.stop_error_m for r in some]):+.3f}",
        f"{max(r.overspeed_mps for r in some):.3f}",
        f"{sum(r.interventions for r in some)}",
        spread([r.gap for r in arrived]),
        spread([r.excess for r in arrived]),
        f"{np.median([r.decision_us for r in some]):.0f}",
    ]


HEADS = ("runs", "within 1 s and 0.3 m", "worst time error s", "worst stop error m", "overspeed m/s")
HEADS = (*HEADS, "interventions", "gap: median / 95th / worst %")
HEADS = (*HEADS, "above attainable: median / 95th / worst %", "decision us")


def is_success(r: Result) -> bool:
    """True for a run that arrived in place and on time."""
    return r.outcome == "arrived" and abs(r.time_error_s) <= ON_TIME_S and abs(r.stop_error_m) <= IN_PLACE_M


def target_gap(r: Result) -> float:
    """Energy above what the targets are about: the optimum with ideal actuation, else the attainable one."""
    return r.gap if r.case.scenario == IDEAL else r.excess


def verdict(results: list[Result]) -> str:
    """Which targets are met, in words."""
    missed = []
    for name, most in TARGETS.items():
        some = [r for r in results if r.case.scenario == name]
        gaps = np.array([target_gap(r) for r in some])
        gaps = gaps[np.isfinite(gaps)]
        found = float(np.median(gaps)), float(np.percentile(gaps, 95)), float(gaps.max())
        for word, value, target in zip(("median", "95th percentile", "worst"), found, most, strict=True):
            if value > target:
                missed.append(f"{name}, {word}: {value:.2f} % instead of {target:g} %")
        late = sum(
            not is_success(r) or abs(r.time_error_s) > TARGET_TIME_S or abs(r.stop_error_m) > TARGET_STOP_M
            for r in some
        )
        if late:
            missed.append(
                f"{name}: {late} of {len(some)} runs not within {TARGET_TIME_S:g} s and {TARGET_STOP_M:g} m"
            )
        count = sum(r.interventions > 0 for r in some)
        if count:
            missed.append(f"{name}: interventions in {count} of {len(some)} runs")
    return "Missed: " + "; ".join(missed) + "." if missed else "All are met."


def by_time(results: list[Result], beside: list[Result]) -> str:
    """Energy above what the targets are about by scheduled time, and the driver beside it."""
    columns = {name: [r for r in results if r.case.scenario == name] for name in SCENARIOS}
    columns[f"`{BESIDE}`, {LIMITED}"] = beside
    lines = []
    for ratios, words in [*(((ratio,), f"{ratio:g} of the minimum") for ratio in RATIOS), (RATIOS, "all")]:
        cells = (spread([target_gap(r) for r in some if r.case.ratio in ratios]) for some in columns.values())
        lines.append([words if ratios != (0.0,) else "as planned", *cells])
    above = {IDEAL: "gap", LIMITED: "above attainable", f"`{BESIDE}`, {LIMITED}": "above attainable"}
    heads = ("scheduled time", *(f"{name}, {above[name]}: median / 95th / worst %" for name in columns))
    return table(heads, lines)


def farthest(results: list[Result]) -> str:
    """The runs farthest above the optimum, under the jerk limit the attainable one."""
    lines = []
    for r in sorted(results, key=lambda r: -np.nan_to_num(target_gap(r)))[:SHOWN]:
        c = r.case
        lines.append(
            [
                f"{c.origin} to {c.destination}, {c.load}, {c.scenario}",
                f"{r.scheduled_s:.1f}",
                f"{r.time_error_s:+.2f}",
                f"{target_gap(r):.2f}",
            ]
        )
    return table(("run", "scheduled s", "time error s", "above %"), lines)


def wide(results: list[Result]) -> str:
    """The section on other trainsets: by declared dead time and lag, and by trainset."""
    keys = {r.case: parse_trainset(r.case.trainset) for r in results}
    names = list(dict.fromkeys(key.id for key in keys.values()))
    first = [line_of(words, [r for r in results if keys[r.case].actuation == k]) for k, words in LATE.items()]
    second = [
        line_of(f"`{Path(name).name}`", [r for r in results if keys[r.case].id == name]) for name in names
    ]
    lines, ratios = ", ".join(f"`{line}`" for line in WIDE_LINES), " or ".join(map(str, WIDE_RATIOS))
    words = (
        f"{len(names)} trainsets, real and random ones (`drawn-18-NUMBER`: none that the training drew), "
        f"each on {WIDE_RUNS} sections of {lines}, in {ratios} of the minimum, with every dead time and lag "
        "declared."
    )
    return "\n\n".join([words, table(("dead time, lag", *HEADS), first), table(("trainset", *HEADS), second)])


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


def beside_policy(pairs: list[tuple[Result, Result]], tried: str) -> str:
    """The section on another policy in the same runs.

    Args:
        pairs: Results of the shipped policy and of the other one.
        tried: File or run of the other one.
    """
    if not pairs:
        return ""
    about: Any = load_driving_policy(Path(tried)).about
    line = [p for p in pairs if p[0].case.trainset == TRAINSET]
    wider = [p for p in pairs if p[0].case.trainset != TRAINSET]
    groups = {name: [p for p in line if p[0].case.scenario == name] for name in SCENARIOS}
    for late, words in LATE.items():
        name = f"other trainsets, dead time and lag {words}"
        groups[name] = [p for p in wider if parse_trainset(p[0].case.trainset).actuation == late]
    lines = [
        [f"{name}, {words}", *line_of("", [p[k] for p in some])[1:-1]]
        for name, some in groups.items()
        if some
        for k, words in enumerate(("shipped", "other"))
    ]
    words = (
        f"The same runs by the policy of `{about['provenance']['command']}` (commit "
        f"{about['provenance']['commit'][:9]}, {about['provenance']['date']}). Another policy is shipped if "
        "it is better with other trainsets and no worse on the line."
    )
    return f"## Another policy beside it\n\n{words}\n\n{table(('runs, policy', *HEADS[:-1]), lines)}\n\n"


def training_table(about: Any) -> str:  # noqa: ANN401 (what the policy's file says)
    """Table of the training, from the policy file."""
    told, came = about["config"], about["provenance"]
    share = told.get("wide_share", 0.0)
    lines = [
        ["command", f"`{came['command']}`"],
        [
            "demonstrations",
            f"{told['worlds']:,} random sections, {told['plans']} plans each, {told['states']} states a plan",
        ],
        ["sections and trainsets drawn wider", f"{100.0 * share:g} %"],
        ["imitation", f"{told['batches']:,} gradient steps of {told['batch_size']:,} states"],
        ["closed loop", f"{came['steps']:,} decisions, {told['decisions']:,} in a gradient step"],
        ["network", " x ".join(map(str, told["hidden"])) + f", {told['activation']}"],
        ["seed", f"{about['seed']}"],
        ["training without demonstrations", f"{came['seconds']:.0f} s"],
        ["machine, date, commit", f"{came['machine']}; {came['date']}; {came['commit'][:9]}"],
    ]
    return table(("what", "value"), lines, words=2)


ORDINARY = "sections of 0.5 to 8 km with random trainsets of 80 to 500 t"
WIDER = """{ordinary}, and in {share:g} % of
the draws of 0.2 to 20 km with trainsets of 80 to 600 t, 60 to 160 km/h, 0.4 to 1.4 m/s², dead time to 1 s,
lag to 0.6 s, with and without limits of acceleration and jerk, every brake blend"""


def page(found: list[list[Result]], pairs: list[tuple[Result, Result]], options: argparse.Namespace) -> str:
    """The page of the docs.

    Args:
        found: Results on the line, of other trainsets, and on other lines.
        pairs: Results of the shipped policy and of another one in the same runs.
        options: The command's options.
    """
    about: Any = load_driving_policy(shipped_policy(DRIVER)).about
    results = [r for r in found[0] if r.case.driver == DRIVER]
    beside = [r for r in found[0] if r.case.driver == BESIDE]
    told = about["config"]
    share = 100.0 * told.get("wide_share", 0.0)
    worlds = WIDER.format(ordinary=ORDINARY, share=share) if share else ORDINARY
    above = {IDEAL: "gap", LIMITED: "above attainable"}
    targets = "; ".join(
        f"{name}, {above[name]}: median {median:g}, 95th percentile {tail:g}, worst {most:g} %"
        for name, (median, tail, most) in TARGETS.items()
    )
    sample = f" --sample {options.sample}" if options.sample else ""
    sample += " --tried RUN" if options.tried else ""
    sample += f" --ttobench {options.ttobench}" if options.ttobench else ""
    machine = circumstances(("metropilot", "clarabel", "numpy", "scipy"))
    return PAGE.format(
        worlds=worlds,
        command=about["provenance"]["command"],
        states=told["worlds"] * told["plans"] * told["states"],
        written=f"python -m benchmarks.generalist{sample} --write docs/generalist.md",
        sampled=f" ({options.sample} runs drawn for each line of the first table)" if options.sample else "",
        about="; ".join(f"{k} {v}" for k, v in machine.items()),
        loads=", ".join(LOADS),
        ratios=", ".join(f"{ratio:g}" for ratio in RATIOS[1:]),
        summary=table(
            ("scenario", *HEADS),
            [line_of(name, [r for r in results if r.case.scenario == name]) for name in SCENARIOS],
        ),
        targets=targets,
        time=TARGET_TIME_S,
        stop=TARGET_STOP_M,
        verdict=verdict(results),
        by_time=by_time(results, beside),
        farthest=farthest(results),
        wide=wide(found[1]),
        elsewhere=elsewhere(found[2]),
        other=beside_policy(pairs, options.tried),
        training=training_table(about),
    )


def main() -> None:
    """Drive everything; print the page or write it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    parser.add_argument("--rows", type=Path, metavar="JSONL", help="runs that are in it are not driven again")
    parser.add_argument("--sample", type=int, default=0, metavar="N", help="so many runs on the line; 0: all")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--tried", default="", metavar="RUN", help="file or run of a policy to drive besides")
    parser.add_argument("--trainset", action="append", default=[], help="a further trainset, once for each")
    parser.add_argument("--ttobench", type=Path, metavar="FOLDER", help="the tracks of TTOBench, too")
    options = parser.parse_args()
    tracks = others(options.ttobench) if options.ttobench else []
    if options.ttobench and not tracks:
        parser.error(
            f"--ttobench {options.ttobench}: no track that can be read (allowed: a folder with tracks/)"
        )
    parts = [cases(options.sample), wide_cases(options.trainset), tracks]
    ours = [case for part in parts[:2] for case in part if case.driver == DRIVER]
    tried = {case: replace(case, policy=options.tried) for case in ours if options.tried}
    wanted = [*(case for part in parts for case in part), *tried.values()]
    done = drive_all(wanted, options.processes, options.rows)
    found = [[done[case] for case in part if case in done] for part in parts]
    pairs = [(done[case], done[other]) for case, other in tried.items() if case in done and other in done]
    text = page(found, pairs, options)
    if options.write:
        # What another command has written stays.
        seeds = find_section(options.write.read_text() if options.write.exists() else "", SEEDS)
        options.write.write_text(text.rstrip() + (f"\n\n{seeds}\n" if seeds else "\n"))
    else:
        print(text)


if __name__ == "__main__":
    main()

"""Convoys against their targets: stops, jerk, interventions, gaps, energy; over trainsets, links, counts.

python -m benchmarks.convoy --rows rows.jsonl                      drive what is not in the file yet
python -m benchmarks.convoy --rows rows.jsonl --write docs/convoy.md   and write the table
"""

from __future__ import annotations

import argparse
import json
import statistics
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.report import circumstances, write_section
from metropilot.convoy import (
    ConvoyDrive,
    ConvoyKpis,
    ConvoyRequest,
    Link,
    convoy_kpis,
    drive_convoy,
    joint_attainable,
)
from metropilot.evaluate import RunSpec
from metropilot.planning import joint_minimum_running_time
from metropilot.railway import Trainset, load_line, load_trainset
from metropilot.sim import Disturbance
from metropilot.units import J_PER_KWH

LINE, PERIOD_S, RATIO = "yizhuang", 0.1, 1.15
TRAINSETS = {
    "dkz32": (0.0, 0.0),
    "cheng2023": (0.0, 0.0),
    "dkz32, dead time 0.5 s": (0.5, 0.0),
    "dkz32, dead time 0.6 s, lag 0.4 s": (0.6, 0.4),
}
"""Dead time and lag of each, in s."""
LINKS = {"0.1 s": Link(0.1), "0.3 s, 10 % lost": Link(0.3, 0.0, 0.1)}
COUNTS = (2, 4, 8)
MASSES = (0.9, 1.2, 0.8, 1.1, 1.0, 1.2, 0.8, 0.9)
"""True over nominal mass of each trainset."""
LEVEL_M = 0.02
"""A planned gap this near to the desired one is the desired one."""


@dataclass(frozen=True)
class Case:
    """One convoy and its figures, the worst over its trainsets."""

    trainset: str
    link: str
    count: int
    section: str
    success: bool
    interventions: int
    jerk_share: float
    stop_m: float
    late_s: float
    gap_error_m: float
    held_gap_error_m: float
    above_joint_percent: float | None
    rules_percent: float | None
    contacts: int


def trainset_of(name: str) -> Trainset:
    """A trainset of the catalogue with the dead time and lag of its row."""
    known, (delay_s, lag_s) = load_trainset(name.partition(",")[0]), TRAINSETS[name]
    return replace(known, actuation=replace(known.actuation, delay_s=delay_s, lag_s=lag_s))


def drive_case(name: str, link: str, count: int, origin: str, destination: str) -> Case:
    """Drive one convoy in 1.15 of its minimum running time."""
    head = RunSpec(LINE, origin, destination, time_s=1000.0, trainset=name.partition(",")[0], dt_s=PERIOD_S)
    disturbances = tuple(Disturbance(mass_factor=factor) for factor in MASSES[:count])
    request = ConvoyRequest(head, count=count, link=LINKS[link], disturbances=disturbances)
    convoy = replace(request.convoy(), trainsets=(trainset_of(name),) * count)
    trainset, behind = convoy.leader()[1], convoy.coupled_trainsets()
    trainsets, offsets_m = zip((trainset, 0.0), *behind, strict=True)
    fastest_s = joint_minimum_running_time(convoy.leader()[0], trainsets, offsets_m, limits_extended=True)
    request = replace(request, head=replace(head, time_s=float(np.ceil(RATIO * fastest_s))))
    drive = drive_convoy(convoy, request.driven_head(convoy), request.make_follower(), request.head.seed)
    kpis = convoy_kpis(drive, request.scheduled_time_s(convoy))
    errors = np.abs(drive.gap_m - drive.planned_gap_m)
    held = np.abs(drive.planned_gap_m - convoy.gap_m) <= LEVEL_M
    limits = [(m.max_jerk_mps3, m.jerk_limit_mps3) for m in kpis.trainsets]
    return Case(
        trainset=name,
        link=link,
        count=count,
        section=f"{origin}-{destination}",
        success=kpis.success,
        interventions=sum(drive.interventions),
        jerk_share=max((jerk / limit for jerk, limit in limits if limit is not None), default=0.0),
        stop_m=max(abs(m.stopping_error_m) for m in kpis.trainsets),
        late_s=max(abs(m.time_error_s) for m in kpis.trainsets),
        gap_error_m=float(errors.max()),
        held_gap_error_m=float(np.where(held, errors, 0.0).max()),
        above_joint_percent=kpis.joint_gap_percent,
        rules_percent=rules_percent(drive, kpis),
        contacts=drive.contacts,
    )


def rules_percent(drive: ConvoyDrive, kpis: ConvoyKpis) -> float | None:
    """Least cost of the convoy's service limits and its jerk limit, in % of the joint optimum."""
    if kpis.joint_optimal_energy_kwh is None:
        return None
    plan = joint_attainable(drive.convoy, max(member.running_time_s for member in kpis.trainsets))
    return None if plan is None else 100.0 * (plan.energy_j / J_PER_KWH / kpis.joint_optimal_energy_kwh - 1.0)


def cases(sections: int) -> Iterator[tuple[str, str, int, str, str]]:
    """Every case, by so many sections of the line."""
    found = load_line(LINE).sections()[1 : 2 * sections : 2]
    for (name, link, count), section in product(product(TRAINSETS, LINKS, COUNTS), found):
        yield name, link, count, section.origin.code, section.destination.code


def table(rows: Sequence[Case]) -> str:
    """The table of the targets: one row for each trainset, link and number of trainsets."""
    head = (
        "| trainset | link | trainsets | met all | interventions | jerk over limit | stop (m) "
        "| time error (s) | gap error, 5.92 m planned (m) | gap error (m) "
        "| above joint optimum | of it rules |"
    )
    lines = [head, "|---|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|"]
    for name, link, count in product(TRAINSETS, LINKS, COUNTS):
        found = [row for row in rows if (row.trainset, row.link, row.count) == (name, link, count)]
        if not found:
            continue
        above = [row.above_joint_percent for row in found if row.above_joint_percent is not None]
        rules = [row.rules_percent for row in found if row.rules_percent is not None]
        jerk = max(row.jerk_share for row in found)
        lines.append(
            f"| {name} | {link} | {count} | {sum(row.success for row in found)} of {len(found)} "
            f"| {sum(row.interventions for row in found)} | {'no limit' if jerk == 0.0 else f'{jerk:.2f}'} "
            f"| {max(row.stop_m for row in found):.3f} | {max(row.late_s for row in found):.1f} "
            f"| {max(row.held_gap_error_m for row in found):.2f} "
            f"| {max(row.gap_error_m for row in found):.2f} "
            f"| {f'{statistics.median(above):.1f} %' if above else '–'} "
            f"| {f'{statistics.median(rules):.1f} %' if rules else '–'} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Drive the cases that are not in the file, then write or print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=Path, required=True, metavar="JSONL", help="one line for each convoy")
    parser.add_argument("--sections", type=int, default=5, help="how many sections of the line")
    parser.add_argument("--trainset", choices=TRAINSETS, help="only this one")
    parser.add_argument("--write", type=Path, metavar="PAGE")
    options = parser.parse_args()
    lines = options.rows.read_text().splitlines() if options.rows.exists() else []
    rows = [Case(**json.loads(line)) for line in lines]
    done = {(row.trainset, row.link, row.count, row.section) for row in rows}
    for name, link, count, origin, destination in cases(options.sections):
        wanted = options.trainset in (None, name) and not options.write
        if wanted and (name, link, count, f"{origin}-{destination}") not in done:
            rows.append(drive_case(name, link, count, origin, destination))
            with options.rows.open("a") as file:
                file.write(json.dumps(asdict(rows[-1])) + "\n")
    if not rows:
        parser.error(f"{options.rows} has no rows: drive them first, without --write")
    about = circumstances(("metropilot", "numpy"))
    text = "\n".join(
        [
            table(rows),
            "",
            f"`python -m benchmarks.convoy`: {len({row.section for row in rows})} sections of the Yizhuang "
            f"line in {RATIO} of the convoy's minimum running time, `follow_plan` behind `optimal`, guard "
            f"`coupled`, period {PERIOD_S} s, seed 0, masses {', '.join(map(str, MASSES))} of nominal; the "
            "worst of all sections and trainsets, energy the median over sections. "
            + "; ".join(f"{k}: {v}" for k, v in about.items())
            + ".",
        ]
    )
    write_section(options.write, "convoy", text)


if __name__ == "__main__":
    main()

"""The convoy of the paper, its published numbers, its head, and drives with the rows of figures 7 to 9."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial

import numpy as np

from metropilot import convoy
from metropilot.planning import ReferenceShape, reference_for_time
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Disturbance, Outcome
from metropilot.studies.report import ReportRow, make_row

CITATION = (
    "Chen, B.; Zhang, L.; Cheng, G.; Liu, Y.; Chen, J. *A Novel Approach for Train Tracking in Virtual "
    "Coupling Based on Soft Actor-Critic*. Actuators 2023, 12(12), 447, doi 10.3390/act12120447."
)
PUBLISHED = {"gap_min_m": 5.88, "gap_max_m": 5.98, "speed_difference_max_mps": 0.15}
"""Chen23b section 4: figs. 8 and 9."""


HEAD_CASE = "2 trainsets, YZQ–WHY"
LINE, ORIGIN, DESTINATION, TRAINSET, TIME_S = "yizhuang", "YZQ", "WHY", "cheng2023", 100.0
SHAPE = ReferenceShape(0.65, 0.65, 0.5)
"""Head's S-curve: acceleration, deceleration, jerk. The paper's profile is not printed."""
SIMPLE = ("follow_pid", "follow_gap", "follow_mpc")
ROUGH = convoy.Link(delay_s=0.3, loss=0.1)
MASSES = (1.0, 1.2, 0.8, 1.2, 0.8, 1.2, 0.8, 1.2)


def pair(count: int = 2, *, rough: bool = False, guard: convoy.ConvoyGuard = "coupled") -> convoy.Convoy:
    """The paper's convoy or a longer one; ``rough``: masses ±20 %, messages 0.3 s late, 10 % lost."""
    section = load_line(LINE).section(ORIGIN, DESTINATION)
    masses = tuple(Disturbance(mass_factor=factor) for factor in MASSES[:count]) if rough else ()
    link = ROUGH if rough else convoy.Link()
    return convoy.Convoy(
        section, (load_trainset(TRAINSET),) * count, guard=guard, link=link, disturbances=masses
    )


@lru_cache
def head_run(count: int = 2) -> convoy.HeadRun:
    """Run of the head on its S-curve; slower where the speed limit of a long convoy requires it."""
    made = pair(count)
    section, trainset = made.leader()
    fastest = min(float(section.limit_mps.at(400.0)) - 0.8, 20.0)
    time_s = max(TIME_S, SHAPE.time_s(section.length_m, fastest) + 0.5)
    reference = reference_for_time(section.length_m, time_s, SHAPE, fastest)
    commands = convoy.record_leader(
        section, trainset, convoy.reference_speeds(reference, made.dt), made.dt
    ).command
    return convoy.HeadRun("S-curve", commands, Outcome.ARRIVED)


FIGURES = "Figs. 7 to 9"


def drive_pair(
    follower: convoy.AbstractFollower, guard: convoy.ConvoyGuard = "coupled"
) -> convoy.ConvoyDrive:
    """Drive the paper's convoy behind its head."""
    return convoy.drive_convoy(pair(guard=guard), head_run(), follower)


def drive_rows(name: str, drives: Sequence[convoy.ConvoyDrive], case: str = HEAD_CASE) -> list[ReportRow]:
    """Rows of figures 8 and 9."""
    row = partial(make_row, FIGURES, case, name)
    said = PUBLISHED if name == "sac_pid" else {}
    apart = [np.abs(drive.speed_difference_mps).max() for drive in drives]
    overruled = [float(sum(drive.interventions)) for drive in drives]
    return [
        row("smallest gap", "m", [drive.gap_m.min() for drive in drives], said.get("gap_min_m")),
        row("largest gap", "m", [drive.gap_m.max() for drive in drives], said.get("gap_max_m")),
        row("largest speed difference", "m/s", apart, said.get("speed_difference_max_mps")),
        row("interventions of protection", "", overruled),
    ]

"""What the paper leaves open: longer convoys, bad links, string stability, collisions, capacity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from metropilot.drivers.followers import AbstractFollower
from metropilot.evaluate.convoy_campaign import Campaign, attack
from metropilot.evaluate.convoy_drive import drive_convoy
from metropilot.evaluate.convoy_headway import Service, needed_gap_m
from metropilot.evaluate.convoy_stability import speed_gains
from metropilot.studies.chen2023b.setting import head_run, pair
from metropilot.studies.report import Row
from metropilot.task.convoy_members import GAP_M

TABLE = "Beyond the paper: "
PERIODS_S = (4.0, 6.0, 10.0, 16.0, 25.0, 40.0)
CAMPAIGNS = {
    "quick": ((2, "coupled", 2_000),),
    "paper": ((2, "coupled", 60_000), (4, "coupled", 30_000), (8, "coupled", 10_000), (2, "none", 4_000)),
}
SPEED_MPS = 60.0 / 3.6


def rough_rows(followers: Mapping[str, AbstractFollower], counts: Sequence[int]) -> list[Row]:
    """The same policy in longer convoys, with other masses and a bad link."""
    rows = []
    for count in counts:
        for name, follower in followers.items():
            if name == "follow_mpc" and count > 2:
                continue
            drive = drive_convoy(pair(count, rough=True), head_run(count), follower)
            case = f"{count} trainsets, masses ±20 %, delay 0.3 s, loss 10 %"
            table = TABLE + "the same policy, disturbed"
            rows += [
                Row(table, case, name, "contacts", "").measured([float(drive.contacts)]),
                Row(table, case, name, "smallest gap", "m").measured([drive.gap_m.min()]),
                Row(table, case, name, "largest gap", "m").measured([drive.gap_m.max()]),
                Row(table, case, name, "interventions", "").measured([float(sum(drive.interventions))]),
            ]
    return rows


def stability(
    followers: Mapping[str, AbstractFollower], count: int
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Gains of speed over the head's for each period; (P,) and (P, N)."""
    convoy = pair(count, guard="none")
    times = np.array(PERIODS_S)
    quick = {name: each for name, each in followers.items() if name != "follow_mpc"}
    return {name: (times, speed_gains(convoy, each, PERIODS_S)) for name, each in quick.items()}


def campaign_rows(budget: str) -> list[Row]:
    """Emergency brakes of the head at any moment, followers that mean harm."""
    rows = []
    for count, guard, cases in CAMPAIGNS[budget]:
        found = attack(Campaign(count=count, guard=guard), cases, 1_000)
        case = f"{count} trainsets, {found.gap_min_m.size:,} emergency brakes of the head"
        table, who = TABLE + "trying to make them collide", f"protection {guard}"
        rows += [
            Row(table, case, who, "cases with a contact", "").measured([float(found.contacts)]),
            Row(table, case, who, "smallest gap", "m").measured([float(found.gap_min_m.min())]),
        ]
    return rows


def capacity_rows() -> list[Row]:
    """Trainsets an hour: moving block, and coupled convoys behind each other under it."""
    rows = []
    single = pair(2)
    apart = needed_gap_m(single, "moving_block", SPEED_MPS)
    for guard in ("moving_block", "independent", "coupled"):
        gap = needed_gap_m(single, guard, SPEED_MPS)
        case, who = "steady 60 km/h, level link", f"protection {guard}"
        rows.append(Row(TABLE + "gap that protection needs", case, who, "gap", "m").measured([gap]))
    for count in (1, 2, 4, 8):
        convoy = pair(max(count, 2))
        inside = max(GAP_M, needed_gap_m(convoy, "coupled", SPEED_MPS))
        service = Service(count, convoy.trainsets[0].length_m, inside, apart, SPEED_MPS)
        who, table = "moving block" if count == 1 else f"convoys of {count}", TABLE + "trainsets an hour"
        for case, value in (
            ("plain line, 60 km/h", service.line_per_h),
            ("platform as long as a convoy, 30 s dwell", service.platform_per_h),
        ):
            rows.append(Row(table, case, who, "trainsets", "1/h").measured([value]))
    return rows

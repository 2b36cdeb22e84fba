"""Questions beyond the paper: longer convoys, bad links, string stability, collisions, needed gaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from hashlib import sha256
from pathlib import Path

import numpy as np

from metropilot import convoy
from metropilot._io import load_or_compute
from metropilot.studies.chen2023b.drivers import AbstractGainFollower
from metropilot.studies.chen2023b.setting import head_run, pair
from metropilot.studies.report import ReportRow, make_row
from metropilot.units import KMH_PER_MPS

TABLE = "Beyond the paper: "
SWINGS = {"quick": (3, (6.0, 16.0)), "paper": (5, (4.0, 6.0, 10.0, 16.0, 25.0, 40.0))}
"""Number of trainsets and periods of the head's speed oscillation, s."""
SITTING, BATCH = 2_000, 1_000
CONTACTS = "cases with a contact"
CAMPAIGNS = {
    "quick": ((2, "coupled", 2_000),),
    "paper": ((2, "coupled", 60_000), (4, "coupled", 30_000), (8, "coupled", 10_000), (2, "none", 4_000)),
}
SPEED_MPS = 60.0 / KMH_PER_MPS
PARTS = "parts"
"""Subfolder of results that take minutes; an interrupted study resumes from it."""


def _identity(follower: convoy.AbstractFollower) -> str:
    """Id of a follower, with a digest of its policy's weights if it has one."""
    if not isinstance(follower, AbstractGainFollower):
        return follower.id
    digest = sha256()
    for key, values in sorted(follower.policy.params.items()):
        digest.update(key.encode() + np.asarray(values).tobytes())
    return f"{follower.id} {digest.hexdigest()[:16]}"


def rough_rows(
    followers: Mapping[str, convoy.AbstractFollower], counts: Sequence[int], folder: Path
) -> list[ReportRow]:
    """Rows of longer convoys with other masses and a bad link; every run is stored on its own."""
    rows = []
    for count in counts:
        for name, follower in followers.items():
            if name == "follow_mpc" and count > 2:
                continue
            about = {"follower": _identity(follower), "count": count}
            path = folder / PARTS / f"disturbed-{name}-{count}.json"
            values = load_or_compute(path, about, partial(_drive_disturbed, follower, count))
            case = f"{count} trainsets, masses ±20 %, delay 0.3 s, loss 10 %"
            kpis = ("contacts", ""), ("smallest gap", "m"), ("largest gap", "m"), ("interventions", "")
            row = partial(make_row, TABLE + "the same policy, disturbed", case, name)
            rows += [row(*kpi, [value]) for kpi, value in zip(kpis, values, strict=True)]
    return rows


def _drive_disturbed(follower: convoy.AbstractFollower, count: int) -> list[float]:
    """Contacts, smallest and largest gap, interventions of one disturbed run."""
    drive = convoy.drive_convoy(pair(count, rough=True), head_run(count), follower)
    gap = drive.gap_m
    return [float(drive.contacts), float(gap.min()), float(gap.max()), float(sum(drive.interventions))]


def stability(
    followers: Mapping[str, convoy.AbstractFollower], budget: str, folder: Path
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Compute speed gains over the head for each period, (P,) and (P, N); stored for each follower."""
    count, periods = SWINGS[budget]
    found = {}
    for name, follower in followers.items():
        if name == "follow_mpc":
            continue
        about = {"follower": _identity(follower), "count": count, "periods": periods}
        path = folder / PARTS / f"stability-{name}.json"
        values = load_or_compute(path, about, partial(_gains, follower, count, periods))
        found[name] = (np.array(periods), np.array(values))
    return found


def _gains(follower: convoy.AbstractFollower, count: int, periods: Sequence[float]) -> list[list[float]]:
    return convoy.string_gains(pair(count, guard="none"), follower, periods).speed.tolist()


def stability_rows(gains: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> list[ReportRow]:
    """Rows of the largest gain between neighbours over all periods."""
    rows, kpi = [], "largest gain of speed from one trainset to the next"
    for name, (times, values) in gains.items():
        case = f"{values.shape[1]} trainsets, no protection, swings of {times[0]:g} to {times[-1]:g} s"
        gain = float((values[:, 1:] / values[:, :-1]).max())
        rows.append(make_row(TABLE + "string stability", case, name, kpi, "", [gain]))
    return rows


def campaign_rows(budget: str, folder: Path) -> list[ReportRow]:
    """Rows of the campaign: emergency brakes of the head, adversarial followers; stored in parts."""
    rows = []
    for count, guard, cases in CAMPAIGNS[budget]:
        found = _attack(convoy.AttackCampaign(count=count, guard=guard), cases, folder)
        case = f"{count} trainsets, {cases:,} emergency brakes of the head"
        row = partial(make_row, TABLE + "trying to make them collide", case, f"protection {guard}")
        rows.append(row(CONTACTS, "", [float(sum(each[0] for each in found))]))
        rows.append(row("smallest gap", "m", [min(each[1] for each in found)]))
    return rows


def _attack(campaign: convoy.AttackCampaign, cases: int, folder: Path) -> list[list[float]]:
    """Contacts and smallest gap of every part of a campaign."""
    arena: list[convoy.AttackArena] = []
    sitting = min(SITTING, cases)

    def attack(k: int) -> list[float]:
        if not arena:
            arena.append(convoy.AttackArena(campaign))
        tally = arena[0].run(sitting, BATCH, first=k * sitting // BATCH)
        return [float(tally.contacts), float(tally.gap_min_m.min())]

    found = []
    for k in range(cases // sitting):
        about = {"campaign": asdict(campaign), "sitting": k, "cases": sitting, "batch": BATCH}
        path = folder / PARTS / f"campaign-{campaign.guard}-{campaign.count}-{k}.json"
        found.append(load_or_compute(path, about, partial(attack, k)))
    return found


def needed_gap_rows() -> list[ReportRow]:
    """Rows of the gap that protection needs; `metropilot capacity` says what it is worth on a line."""
    rows = []
    single = pair(2)
    for guard in ("moving_block", "independent", "coupled"):
        gap = convoy.needed_gap_m(single, guard, SPEED_MPS)
        case, who = "steady 60 km/h, level link", f"protection {guard}"
        rows.append(make_row(TABLE + "gap that protection needs", case, who, "gap", "m", [gap]))
    return rows

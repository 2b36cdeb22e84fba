"""Hostile convoys: contacts and the smallest gap over trainsets, mixtures, disturbances and numbers.

python -m benchmarks.attack --folder attack                          what is not in the folder yet
python -m benchmarks.attack --folder attack --write docs/convoy.md   the same, and write the table
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.report import circumstances, write_section
from metropilot._io import load_or_compute
from metropilot.convoy import EVERY_DISTURBANCE, AttackArena, AttackCampaign
from metropilot.railway import load_trainset

SITTING, BATCH = 2_000, 500
"""Cases of one file, and of one batch."""


@dataclass(frozen=True)
class Kind:
    """One row of the table.

    Attributes:
        trainsets: Trainsets in words.
        disturbed: What the plants differ by, in words.
        cases: Cases when all are asked for.
        campaign: The campaign.
    """

    trainsets: str
    disturbed: str
    cases: int
    campaign: AttackCampaign


@dataclass(frozen=True)
class Part:
    """Outcome of one sitting."""

    cases: int
    contacts: int
    least_m: float
    emergencies: int


def kinds() -> list[Kind]:
    """Every kind of convoy that is attacked."""
    known = load_trainset("dkz32")
    late = replace(known, actuation=replace(known.actuation, delay_s=0.5))
    mixed = ("cheng2023", late, "dkz32")
    alike, mixture = "`cheng2023`", "`cheng2023`, `dkz32` with a dead time of 0.5 s, `dkz32` by turns"
    few, every = "mass, resistance", "all of them"
    all_of_them = AttackCampaign(disturbances=EVERY_DISTURBANCE)
    return [
        Kind(alike, few, 60_000, AttackCampaign(seed=2)),
        Kind(alike, few, 30_000, AttackCampaign(seed=4, count=4)),
        Kind(alike, few, 10_000, AttackCampaign(seed=8, count=8)),
        Kind(alike, every, 20_000, replace(all_of_them, seed=12)),
        Kind("`dkz32`", every, 20_000, replace(all_of_them, seed=22, trainsets=("dkz32",))),
        Kind(mixture, few, 30_000, AttackCampaign(seed=33, count=3, trainsets=mixed)),
        Kind(mixture, every, 20_000, replace(all_of_them, seed=43, count=3, trainsets=mixed)),
        Kind(mixture, every, 10_000, replace(all_of_them, seed=48, count=8, trainsets=mixed)),
        Kind(alike, few, 2_000, AttackCampaign(seed=2, guard="none")),
    ]


def attack(kind: Kind, cases: int, folder: Path) -> list[Part]:
    """Every sitting of a kind; one that its file has is not run again."""
    arena: list[AttackArena] = []

    def sit(k: int) -> dict[str, float]:
        if not arena:
            arena.append(AttackArena(kind.campaign))
        tally = arena[0].run(SITTING, BATCH, first=k * SITTING // BATCH)
        braked = int(tally.emergencies.sum())
        return asdict(Part(SITTING, tally.contacts, float(tally.gap_min_m.min()), braked))

    campaign, found = kind.campaign, []
    plain = json.dumps(asdict(campaign), default=np.ndarray.tolist)
    for k in range(-(-cases // SITTING)):
        about = {"campaign": plain, "sitting": k, "cases": SITTING, "batch": BATCH}
        path = folder / f"{campaign.guard}-{campaign.seed}-{k}.json"
        found.append(Part(**load_or_compute(path, about, partial(sit, k))))
    return found


def table(found: Sequence[tuple[Kind, list[Part]]]) -> str:
    """The table: one row for each kind."""
    heading = "number", "trainsets", "drawn disturbances", "protection", "emergency brakes of the head"
    heading += "contacts", "smallest gap", "emergency brakes of followers"
    lines = ["| " + " | ".join(heading) + " |", "|---:|---|---|---|---:|---:|---:|---:|"]
    for kind, parts in found:
        campaign, least_m = kind.campaign, min(part.least_m for part in parts)
        lines.append(
            f"| {campaign.count} | {kind.trainsets} | {kind.disturbed} | `{campaign.guard}` "
            f"| {sum(part.cases for part in parts):,} | {sum(part.contacts for part in parts):,} "
            f"| {f'{least_m:.3f} m' if least_m >= 0.0 else '–'} "
            f"| {sum(part.emergencies for part in parts):,} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Attack, then write or print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, required=True, help="results, one file for each sitting")
    parser.add_argument("--share", type=float, default=1.0, help="share of the cases of each kind")
    parser.add_argument("--write", type=Path, metavar="PAGE")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    found = []
    for kind in kinds():
        found.append((kind, attack(kind, round(options.share * kind.cases), options.folder)))
        print(table(found[-1:]).splitlines()[-1], flush=True)
    guarded = [part for kind, parts in found if kind.campaign.guard != "none" for part in parts]
    total, contacts = sum(part.cases for part in guarded), sum(part.contacts for part in guarded)
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "jax", "numpy")).items())
    seeds = ", ".join(str(kind.campaign.seed) for kind in kinds())
    text = (
        f"Written by `python -m benchmarks.attack --write docs/convoy.md`: {total:,} cases under protection, "
        f"{contacts:,} with a contact; section YZQ–WHY, period {AttackCampaign().dt} s, single precision, "
        f"seeds {seeds}; {about}.\n\n{table(found)}"
    )
    write_section(options.write, "attack", text)


if __name__ == "__main__":
    main()

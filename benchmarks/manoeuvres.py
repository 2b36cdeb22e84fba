"""Coupling and uncoupling on the move: time, energy and gaps, as table and picture of the page on convoys.

python -m benchmarks.manoeuvres --write docs/convoy.md
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from benchmarks.beside_optimum import table
from benchmarks.report import circumstances, write_section
from metropilot.convoy import ConvoyDrive, ConvoyKpis, ConvoyRequest, convoy_figure, convoy_kpis
from metropilot.errors import Infeasible
from metropilot.evaluate import RunSpec
from metropilot.units import J_PER_KWH

LINE = "yizhuang"


@dataclass(frozen=True)
class Case:
    """A convoy that couples, uncouples or does both.

    Attributes:
        section: Codes of origin and destination.
        time_s: Running time of the head.
        trainsets: Head first.
        start_gap_m: Gap at the departure; None: that of the convoy.
        uncouple_at_m: Place by which the gaps are opened; None: never.
        follower: Id of the followers' driver.
    """

    section: tuple[str, str]
    time_s: float
    trainsets: tuple[str, ...]
    start_gap_m: float | None = None
    uncouple_at_m: float | None = None
    follower: str = "follow_plan"

    def request(self) -> ConvoyRequest:
        """The convoy as the command line asks for it."""
        head = RunSpec(LINE, *self.section, time_s=self.time_s, trainset=self.trainsets[0], dt_s=0.1)
        values = {
            "count": len(self.trainsets),
            "behind": self.trainsets[1:],
            "follower": self.follower,
            "start_gap_m": self.start_gap_m,
            "uncouple_at_m": self.uncouple_at_m,
        }
        return ConvoyRequest.from_values(values, head)


MIXED = ("dkz32", "cheng2023", "dkz32")
PICTURE = Case(("SJZ", "XC"), 215.0, MIXED, start_gap_m=100.0)
CASES = (
    Case(("RJ", "WYJ"), 130.0, ("dkz32",) * 2, start_gap_m=200.0),
    Case(("RJ", "WYJ"), 130.0, ("dkz32",) * 2, start_gap_m=200.0, follower="follow_gap"),
    Case(("RJ", "WYJ"), 130.0, ("dkz32",) * 2, uncouple_at_m=900.0),
    Case(("SJZ", "XC"), 215.0, ("dkz32", "cheng2023"), start_gap_m=200.0),
    Case(("SJZ", "XC"), 215.0, ("dkz32",) * 4, start_gap_m=70.0),
    Case(("SJZ", "XC"), 215.0, MIXED, start_gap_m=200.0),
    PICTURE,
    Case(("SJZ", "XC"), 215.0, MIXED, uncouple_at_m=1800.0),
    Case(("SJZ", "XC"), 240.0, MIXED, start_gap_m=50.0, uncouple_at_m=2100.0),
)
HEADS = (
    "section",
    "trainsets",
    "driver",
    "manoeuvre",
    "follower",
    "gap from to m",
    "begun at m",
    "done at m",
    "by m",
    "took s",
    "smallest gap m",
    "speed difference m/s",
    "jerk m/s³",
    "energy kWh",
    "at its gap kWh",
    "convoy kWh",
    "as asked",
)


def lines_of(case: Case, drive: ConvoyDrive, kpis: ConvoyKpis) -> list[list[str]]:
    """One line for each manoeuvre."""
    total_kwh = sum(float(each.energy_wheel_j[-1]) for each in drive.trajectories) / J_PER_KWH
    lines = []
    for one in kpis.manoeuvres:
        done_s = "–" if one.done_s is None else f"{one.done_s - one.begun_s:.0f}"
        lines.append(
            [
                f"{'–'.join(case.section)}, {case.time_s:g} s",
                ", ".join(f"`{name}`" for name in case.trainsets),
                f"`{case.follower}`",
                one.kind,
                f"{one.trainset - 1}",
                f"{one.gap_from_m:.1f} → {one.gap_to_m:.1f}",
                f"{one.begun_m:.0f}",
                "–" if one.done_m is None else f"{one.done_m:.0f}",
                "–" if one.place_m is None else f"{one.place_m:.0f}",
                done_s,
                f"{one.gap_min_m:.2f}",
                f"{one.speed_difference_max_mps:.2f}",
                f"{one.max_jerk_mps3:.2f}",
                f"{one.energy_kwh:.2f}",
                f"{one.apart_energy_kwh:.2f}",
                f"{total_kwh:.1f}",
                "yes" if one.in_time and kpis.success else kpis.verdict,
            ]
        )
    return lines


def main() -> None:
    """Drive every case; print the part of the page or write it with its picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    page = parser.parse_args().write
    lines: list[list[str]] = []
    refused: list[str] = []
    for case in CASES:
        try:
            drive = case.request().drive()
        except Infeasible as error:
            if case == PICTURE:
                raise
            refused.append(f"{'–'.join(case.section)}, {case.time_s:g} s, `{case.follower}`: {error}")
            continue
        kpis = convoy_kpis(drive, case.time_s)
        lines += lines_of(case, drive, kpis)
        if page is not None and case == PICTURE:
            convoy_figure(drive, kpis).savefig(page.parent / "images" / "manoeuvres.png", dpi=110)
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "numpy")).items())
    written = (
        "Written by `python -m benchmarks.manoeuvres --write docs/convoy.md`: "
        f"line `{LINE}`, `optimal` at the head, guard `coupled`, link 0.1 s, period 0.1 s; {about}. "
        "*At its gap*: energy that it would have needed in the same time at the gap of the beginning."
    )
    text = [written, "", table(HEADS, lines, words=4)]
    text += [f"\nRefused: {'; '.join(refused)}."] * bool(refused)
    write_section(page, "manoeuvres", "\n".join(text))


if __name__ == "__main__":
    main()

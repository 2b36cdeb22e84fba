"""Drives of the paper's convoy, and the rows of its figures 7 to 9."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metropilot.convoy import AbstractFollower, ConvoyDrive, ConvoyGuard, drive_convoy
from metropilot.studies.chen2023b.setting import PUBLISHED, head_run, pair
from metropilot.studies.chen2023b.words import HEAD_CASE
from metropilot.studies.report import ReportRow

FIGURES = "Figs. 7 to 9"
WORDS = {
    "gap_min_m": ("smallest gap", "m"),
    "gap_max_m": ("largest gap", "m"),
    "speed_difference_max_mps": ("largest speed difference", "m/s"),
}


def drive_pair(follower: AbstractFollower, guard: ConvoyGuard = "coupled") -> ConvoyDrive:
    """Drive the paper's convoy behind its head."""
    return drive_convoy(pair(guard=guard), head_run(), follower)


def drive_rows(name: str, drives: Sequence[ConvoyDrive]) -> list[ReportRow]:
    """Rows of figures 8 and 9."""
    values = {
        "gap_min_m": [drive.gap_m.min() for drive in drives],
        "gap_max_m": [drive.gap_m.max() for drive in drives],
        "speed_difference_max_mps": [np.abs(drive.speed_difference_mps).max() for drive in drives],
    }
    rows = []
    for key, measured in values.items():
        published = PUBLISHED[key] if name == "sac_pid" else None
        rows.append(
            ReportRow(FIGURES, HEAD_CASE, name, *WORDS[key], published=published).with_values(measured)
        )
    overruled = [float(sum(drive.interventions)) for drive in drives]
    return [
        *rows,
        ReportRow(FIGURES, HEAD_CASE, name, "interventions of protection", "").with_values(overruled),
    ]

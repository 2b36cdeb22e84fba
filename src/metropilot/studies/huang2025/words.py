"""Where the study departs from the paper, and what a reader must know of its results."""

from __future__ import annotations

from collections.abc import Sequence

from metropilot.studies.report import Row

DEVIATIONS = ()


def remarks(rows: Sequence[Row], *, budget: str) -> list[str]:
    return []

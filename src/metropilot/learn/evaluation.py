"""The early evaluation's KPIs, read from a history."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

EVALUATION = "evaluation."
"""How the names of an evaluation's columns begin."""


def kpis_kept(history: Mapping[str, np.ndarray], keep: str) -> dict[str, float]:
    """KPIs of the policy kept, from the history of its learning; those that are not finite left out.

    Args:
        history: One array a column, as :func:`metropilot.learn.session.learn_in_chunks` gives it.
        keep: ``best`` or ``last``.
    """
    score = history[f"{EVALUATION}score"]
    row = int(np.argmax(score)) if keep == "best" else score.size - 1
    return kpis_of_row({name: float(column[row]) for name, column in history.items()})


def kpis_of_row(row: Mapping[str, float]) -> dict[str, float]:
    """The evaluation's KPIs in a row of the history."""
    found = {name.removeprefix(EVALUATION): row[name] for name in row if name.startswith(EVALUATION)}
    return {name: value for name, value in found.items() if np.isfinite(value) and name != "score"}

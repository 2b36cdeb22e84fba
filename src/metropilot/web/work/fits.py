"""Fits of a trainset to uploaded logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from metropilot import fit
from metropilot.errors import InputError
from metropilot.railway import Section, Trainset, load_line, load_trainset
from metropilot.web.store import JobStore
from metropilot.web.work.drives import folder_of
from metropilot.web.work.plans import numbers

TRAINSET = "trainset.toml"
"""File of the fitted trainset in the job's folder."""
POINTS = 4000
"""Samples that are drawn at most."""


@dataclass(frozen=True)
class FitRequest:
    """A fit, its names resolved.

    Attributes:
        logs: File and name of each log.
        trainset: Trainset to begin from.
        load: Load aboard; None: the trainset's.
        section: Line, origin and destination of every log; None: level, or a gradient column.
        source: Input of the model; None: the command where every log has one.
        keep: Parameters that are not estimated.
        resistance: Form of the resistance.
    """

    logs: Sequence[tuple[str, str]]
    trainset: str
    load: str | None
    section: tuple[str, str, str] | None
    source: fit.Source | None
    keep: Sequence[fit.Group]
    resistance: fit.Resistance

    def read(self) -> tuple[Trainset, list[Section]]:
        """Read trainset and section.

        Raises:
            InputError: A name is unknown.
        """
        trainset = load_trainset(self.trainset, self.load)
        if self.section is None:
            return trainset, []
        line = load_line(self.section[0])
        origin, destination = (line.station(name) for name in self.section[1:])
        return trainset, [line.section(origin, destination)]

    def read_logs(self) -> list[fit.Log]:
        """Read the logs, which keep the names that they were sent with.

        Raises:
            InputError: A log cannot be used.
        """
        found = []
        for path, name in self.logs:
            try:
                found.append(replace(fit.read_log(path), name=name))
            except InputError as error:
                raise error.at(file=name) from None
        return found


def fit_job(root: str, job: str, request: FitRequest) -> dict[str, Any]:
    """Fit a trainset and write its files into the job's folder."""
    store = JobStore(Path(root))
    store.begin(job, "reading the logs", 0.05)
    trainset, sections = request.read()
    logs = request.read_logs()
    store.update(job, progress=0.2, words="fitting")
    found = fit.fit_trainset(
        logs,
        trainset,
        sections=sections,
        source=request.source,
        keep=request.keep,
        resistance=request.resistance,
    )
    store.update(job, progress=0.8, words="drawing")
    folder = folder_of(root, job)
    fit.write_fit(found, folder).rename(folder / TRAINSET)
    return fit_out(found)


def fit_out(found: fit.Calibration) -> dict[str, Any]:
    """Convert a fit to plain values."""
    told = fit.fit_json(found)
    del told["correlation"], told["provenance"]
    return told | {"residuals": _residuals(found)}


def _residuals(found: fit.Calibration) -> dict[str, list[float | None]]:
    """Curves of the residuals; of many samples every so many."""
    runs = found.runs
    step = -(-runs.row_s.size // POINTS)
    curves = {
        "time_s": (runs.row_s, 2),
        "measured_mps": (runs.row_mps, 3),
        "simulated_mps": (found.simulated_mps, 3),
        "residual_mps": (found.residual_mps, 5),
    }
    drawn: dict[str, list[float | None]] = {name: [] for name in curves}
    for run in range(runs.starts.size):
        here = np.flatnonzero(runs.row_run == run)[::step]
        for name, (values, digits) in curves.items():
            drawn[name] += [*numbers(values[here], digits), None]
    lags, correlation = fit.residual_correlation(found)
    return {**drawn, "lag_s": numbers(lags, 3), "correlation": numbers(correlation, 4)}

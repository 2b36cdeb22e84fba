"""Report of a fit: trainset file with its provenance, residual plots, JSON."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from metropilot._io import fill_folder, write_json
from metropilot._provenance import commit, provenance
from metropilot.evaluate import (
    BLUE,
    GREY,
    VERMILION,
    add_headline,
    house_style,
    label_panel,
    new_panels,
    save_figure,
)
from metropilot.fit.calibration import NORMAL_95, Calibration, FittedParameter
from metropilot.railway import Trainset, write_trainset
from metropilot.units import KMH_PER_MPS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALIKE = 0.9
"""Correlation of two estimates from which logs count as hardly telling them apart."""
WANTED: Mapping[str, float] = {
    "mass_factor": 0.02,
    "brake_factor": 0.02,
    "resistance_factor": 0.03,
    "delay_s": 0.05,
    "lag_s": 0.05,
}
"""Half width of an interval beyond which a remark is made, as documented in the benchmark of fits."""
MOST_NAMED = 6
"""Most logs that a source names."""
MOST_LAG_S = 10.0
"""Longest time over which the correlation of the residuals is drawn."""
BLOCKS: Mapping[str, tuple[str, ...]] = {
    "mass": ("mass_factor",),
    "resistance": ("davis_a_n", "davis_b_n_per_mps", "davis_c_n_per_mps2", "resistance_factor"),
    "limits": ("brake_factor",),
    "actuation": ("delay_s", "lag_s"),
}
"""Block of a trainset file to the parameters that a fit changes in it."""


def interval_words(parameter: FittedParameter) -> str:
    """Value with its 95 % interval, in words."""
    unit = f" {parameter.unit}" if parameter.unit else ""
    if not parameter.estimated:
        return f"{parameter.value:.4g}{unit}, kept"
    return f"{parameter.value:.4g}{unit} (95 %: {parameter.low:.4g} to {parameter.high:.4g})"


def count_words(found: Calibration) -> str:
    """Number of logs, runs and samples, in words."""
    counts = ((len(found.logs), "log"), (found.run_count, "run"), (found.samples, "sample"))
    return ", ".join(f"{count} {word}{'s' * (count != 1)}" for count, word in counts)


def ambiguities(found: Calibration) -> list[str]:
    """Remarks on estimates that the logs tell apart poorly or not at all, one a line."""
    mass, remarks = found["mass_factor"], []
    if mass.estimated and found.source == "command":
        remarks.append(
            f"The mass is that with the trainset's traction curve; a traction of {1 / mass.value:.3f} of the "
            "curve at the nominal mass accelerates alike, and commands cannot tell them apart."
        )
    known = {p.id: p for p in found.parameters if p.estimated and p.id in WANTED}
    order = list(found.estimated)
    for name, parameter in known.items():
        half = max(parameter.high - parameter.value, parameter.value - parameter.low)
        if half <= WANTED[name]:
            continue
        row = found.correlation[order.index(name)]
        alike = [each for each in known if each != name and abs(row[order.index(each)]) >= ALIKE]
        others = " and ".join(known[each].label.partition(" /")[0] for each in alike)
        scale, unit = (1.0, f" {parameter.unit}") if parameter.unit else (100.0, " %")
        words = f"The {parameter.label.partition(' /')[0]} is known to ±{scale * half:.2g}{unit} only"
        remarks.append(words + (f": the logs hardly tell it from {others}." if others else "."))
    return remarks


def fitted_trainset(found: Calibration, name: str) -> Trainset:
    """Trainset with the estimates, and where they come from in its sources and notes.

    Args:
        found: The fit.
        name: Id of the new trainset.
    """
    old = found.nominal
    logs = ", ".join(found.logs[:MOST_NAMED])
    if len(found.logs) > MOST_NAMED:
        logs += f" and {len(found.logs) - MOST_NAMED} more"
    known = commit()
    origin = f"{count_words(found)} ({logs}), {datetime.now(UTC).date().isoformat()}" + (
        f", metropilot {known[:9]}" if known else ""
    )
    source = dict(old.source)
    for block, ids in BLOCKS.items():
        told = [p for p in found.parameters if p.id in ids and p.estimated]
        if told:
            values = "; ".join(f"{p.label} {interval_words(p)}" for p in told)
            before = f"; before: {source[block]}" if block in source else ""
            source[block] = f"fitted to {origin}: {values}{before}"
    notes = [
        f"Fitted to logs by metropilot fit from {old.id} with load {old.load}: {origin}.",
        f"Standard deviation of the residuals {found.noise_mps:.3f} m/s; input: {found.source}.",
        f"Only the mass of load {old.load} is fitted; other loads, effort curves, jerk limit: as {old.id}.",
        *found.notes,
    ]
    return replace(
        found.trainset(),
        id=name,
        name=f"{old.name}, fitted to logs",
        source=source,
        notes=(*old.notes, *notes),
    )


def fit_json(found: Calibration) -> dict[str, Any]:
    """Fit as plain values: parameters with intervals, resistance, correlations, residuals in numbers."""
    return {
        "trainset": found.nominal.id,
        "load": found.nominal.load,
        "input": found.source,
        "logs": list(found.logs),
        "runs": found.run_count,
        "samples": found.samples,
        "residual_mps": found.noise_mps,
        "mass_kg": found.nominal.mass_kg * found["mass_factor"].value,
        "parameters": [asdict(p) for p in found.parameters],
        "resistance": [asdict(p) for p in found.resistance],
        "correlation": {"order": list(found.estimated), "rows": found.correlation.tolist()},
        "notes": list(found.notes),
        "ambiguities": ambiguities(found),
        "provenance": provenance(),
    }


def residual_figure(found: Calibration) -> Figure:
    """Draw measured and simulated speed and the residuals over time, and the correlation of the residuals."""
    runs = found.runs
    with house_style():
        figure, panels = new_panels(7.2, 6.4, (1.3, 1.0, 1.0))
        speed, residual, correlation = panels
        for axes in (speed, residual):
            axes.set_xlim(0, float(runs.row_s.max()))
        for run in range(runs.starts.size):
            here = runs.row_run == run
            time = runs.row_s[here]
            first = run == 0
            speed.plot(
                time,
                KMH_PER_MPS * runs.row_mps[here],
                ".",
                ms=1.5,
                color=GREY,
                label="measured" if first else None,
            )
            speed.plot(
                time,
                KMH_PER_MPS * found.simulated_mps[here],
                color=BLUE,
                lw=0.8,
                label="simulated" if first else None,
            )
            residual.plot(time, found.residual_mps[here], ".", ms=1.5, color=BLUE, alpha=0.5)
        speed.set_ylabel("speed (km/h)")
        label_panel(residual, "measured minus simulated (m/s) over time (s), with ±1.96 standard deviations")
        for side in (-1, 1):
            residual.axhline(side * NORMAL_95 * found.noise_mps, color=VERMILION, lw=0.8, ls=(0, (6, 2)))
        reach = 5.0 * found.noise_mps
        residual.set_ylim(-reach, reach)
        lags, values = residual_correlation(found)
        # its time axis is a difference of times, and shorter than that of the panels above
        place = correlation.get_position()
        correlation.remove()
        correlation = figure.add_axes(place.bounds)
        residual.tick_params(labelbottom=True)
        correlation.bar(lags, values, width=0.8 * float(lags[0]), color=BLUE)
        correlation.set_ylim(-0.5, 1.0)
        label_panel(correlation, "correlation of residuals so many seconds apart")
        correlation.set_xlabel("s")
        below = f"{count_words(found)}; residuals {found.noise_mps:.3f} m/s"
        add_headline(speed, f"{found.nominal.name}: fit to logs", below)
    return figure


def residual_correlation(found: Calibration) -> tuple[np.ndarray, np.ndarray]:
    """Correlation of the residuals within the runs: time apart in s, correlation."""
    runs = found.runs
    usual = np.clip(found.residual_mps, -4.0 * found.noise_mps, 4.0 * found.noise_mps)
    parts = [usual[runs.row_run == run] for run in range(runs.starts.size)]
    spacing = max(
        float(np.median(np.concatenate([np.diff(runs.row_s[runs.row_run == 0]), [runs.step_s]]))), 1e-3
    )
    most = max(min(round(MOST_LAG_S / spacing), max(part.size for part in parts) - 2), 1)
    power = sum(float(part @ part) for part in parts)
    values = [
        sum(float(part[:-k] @ part[k:]) for part in parts if part.size > k) / power
        for k in range(1, most + 1)
    ]
    return spacing * np.arange(1, most + 1), np.array(values)


def write_fit(found: Calibration, folder: Path) -> Path:
    """Write trainset, `fit.json` and residual plots into a folder; returns the trainset's file.

    Raises:
        InputError: The folder cannot be written.
    """
    # an id may name a delay and a lag (dkz32@0.4,0.2), which is no name for a file
    name = re.sub(r"[^\w-]+", "-", f"{found.nominal.id}-fitted")
    with fill_folder(folder) as scratch:
        write_trainset(fitted_trainset(found, name), scratch / f"{name}.toml")
        write_json(scratch / "fit.json", fit_json(found))
        save_figure(residual_figure(found), scratch / "residuals")
    return folder / f"{name}.toml"

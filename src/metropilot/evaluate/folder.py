"""Folders of results: a run, a comparison."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from metropilot._io import fill_folder, write_json
from metropilot._provenance import provenance
from metropilot.evaluate.comparison import Entry
from metropilot.evaluate.explanation import Explanation, explain_drive
from metropilot.evaluate.kpis import Kpis
from metropilot.evaluate.optimum import Optimum
from metropilot.evaluate.run_spec import FILES, POLICY, RunSpec
from metropilot.policy import policy_path
from metropilot.railway import copy_input
from metropilot.sim import Drive


def write_run(
    folder: Path,
    request: RunSpec,
    drive: Drive,
    kpis: Kpis,
    optimum: Optimum | None,
    explanation: Explanation | None = None,
) -> None:
    """Write `trajectory.csv`, `kpis.json`, `explanation.json`, `profile.svg`, `profile.png` and `run.toml`.

    Args:
        folder: Folder; created if missing.
        request: Request of the run.
        drive: The run.
        kpis: Its KPIs.
        optimum: The plan it is compared with.
        explanation: Its reasons; None: computed here.

    Raises:
        InputError: The folder cannot be made or written.
    """
    from metropilot.evaluate.figures import profile_figure
    from metropilot.evaluate.style import save_figure

    if explanation is None:
        told = {"driver": request.make_driver(), "objective": request.objective}
        explanation = explain_drive(drive, optimum, **told)
    with fill_folder(folder) as scratch:
        drive.trajectory.write(scratch / "trajectory.csv")
        write_json(scratch / "kpis.json", kpis.as_dict())
        write_json(scratch / "explanation.json", explanation.as_dict())
        save_figure(profile_figure(drive, kpis, optimum), scratch / "profile")
        write_run_toml(scratch, request)


def write_comparison(folder: Path, request: RunSpec, entries: Sequence[Entry]) -> None:
    """Write `comparison.json`, `comparison.svg`, `comparison.png` and `run.toml` of the first driver.

    Args:
        folder: Folder; created if missing.
        request: Request of the run.
        entries: Entries of the comparison.

    Raises:
        InputError: The folder cannot be made or written.
    """
    from metropilot.evaluate.figures import comparison_figure
    from metropilot.evaluate.style import save_figure

    with fill_folder(folder) as scratch:
        write_json(scratch / "comparison.json", comparison_json(request, entries))
        save_figure(comparison_figure(entries), scratch / "comparison")
        write_run_toml(scratch, request, [entry.driver for entry in entries])


def comparison_json(request: RunSpec, entries: Sequence[Entry]) -> dict[str, Any]:
    """A comparison as plain values: per driver the KPIs of every seed, and mean and interval of each."""
    first = entries[0].kpis[0].as_dict()
    names = [
        key
        for key, value in first.items()
        if isinstance(value, int | float | None) and not isinstance(value, bool)
    ]
    drivers = []
    for entry in entries:
        spread = {name: found._asdict() if (found := entry.interval(name)) else None for name in names}
        runs = [{"seed": d.run.seed, **k.as_dict()} for d, k in zip(entry.drives, entry.kpis, strict=True)]
        drivers.append({"driver": entry.driver, "successes": entry.successes, "kpis": spread, "runs": runs})
    return {"run": request.resolve().values(), "drivers": drivers}


def write_run_toml(folder: Path, request: RunSpec, compared: Sequence[str] = ()) -> None:
    """Write `run.toml` and copies of the line, trainset and policy files it names.

    Args:
        folder: Folder.
        request: Request of the run.
        compared: Drivers of a comparison, of which the run has the first.
    """
    import tomli_w

    table = {"run": copy_inputs(folder, request.resolve()).values(), "made_with": provenance()}
    head = "# Drive it again: metropilot drive --from run.toml\n"
    if len(compared) > 1:
        head += f"# It is the run of the first driver compared; the others: {', '.join(compared[1:])}.\n"
    (folder / "run.toml").write_text(f"{head}\n{tomli_w.dumps(table)}", encoding="utf-8")


def copy_inputs(folder: Path, request: RunSpec) -> RunSpec:
    """Copy line, trainset and policy files into a folder; returns the request with their new names."""
    request = replace(request, **{kind: copy_input(folder, getattr(request, kind), kind) for kind in FILES})
    if request.options.get(POLICY):
        source = policy_path(request.options[POLICY])
        shutil.copyfile(source, folder / source.name)
        request = replace(request, options={**request.options, POLICY: source.name})
    return request

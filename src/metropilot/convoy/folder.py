"""Folder of results of a convoy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from metropilot._io import fill_folder, write_json
from metropilot._provenance import provenance
from metropilot.convoy.kpis import ConvoyKpis
from metropilot.convoy.request import ConvoyRequest
from metropilot.convoy.rollout import ConvoyDrive
from metropilot.evaluate import copy_inputs
from metropilot.units import KMH_PER_MPS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 8.4, 7.0


def write_convoy(folder: Path, request: ConvoyRequest, drive: ConvoyDrive, kpis: ConvoyKpis) -> None:
    """Write `trajectory-N.csv` of each trainset, `kpis.json`, `run.json`, `convoy.svg` and `convoy.png`.

    Also copies the line, trainset and policy files that `run.json` names.

    Args:
        folder: Folder; created if missing.
        request: Request of the run.
        drive: The run.
        kpis: Its KPIs.

    Raises:
        InputError: The folder cannot be made or written.
    """
    from metropilot.evaluate import save_figure

    with fill_folder(folder) as scratch:
        for k, trajectory in enumerate(drive.trajectories, 1):
            trajectory.write(scratch / f"trajectory-{k}.csv")
        write_json(scratch / "kpis.json", kpis.as_dict())
        head = copy_inputs(scratch, request.head.resolved()).values()
        write_json(
            scratch / "run.json", {"run": {**request.table(), "head": head}, "made_with": provenance()}
        )
        save_figure(convoy_figure(drive, kpis), scratch / "convoy")


def convoy_figure(drive: ConvoyDrive, kpis: ConvoyKpis) -> Figure:
    """Speeds, gaps and speed differences over time, one above the other.

    Args:
        drive: The run.
        kpis: Its KPIs, for the line under the title.
    """
    from metropilot.evaluate import (
        BLACK,
        GREY,
        SERIES_STYLES,
        add_headline,
        house_style,
        label_panel,
        new_panels,
    )

    with house_style():
        figure, (speed, gap, apart) = new_panels(WIDTH_IN, HEIGHT_IN, (5.0, 4.0, 3.0))
        for k, t in enumerate(drive.trajectories):
            colour, dashes = (BLACK, "-") if k == 0 else SERIES_STYLES[(k - 1) % len(SERIES_STYLES)]
            name = f"head ({drive.head})" if k == 0 else f"{k + 1}"
            speed.plot(t.time_s, KMH_PER_MPS * t.speed_mps, color=colour, linestyle=dashes, label=name)
            if k:
                gap.plot(drive.time_s, drive.gap_m[:, k - 1], color=colour, linestyle=dashes)
                apart.plot(drive.time_s, drive.speed_difference_mps[:, k - 1], color=colour, linestyle=dashes)
        gap.axhline(drive.convoy.gap_m, color=GREY, linewidth=0.8, zorder=1)
        gap.axhline(0.0, color="#B00020", linewidth=0.8, zorder=1)
        speed.set_ylabel("speed (km/h)")
        label_panel(gap, f"gap to the trainset ahead (m); grey: wanted {drive.convoy.gap_m:g} m")
        label_panel(apart, "speed ahead less own speed (m/s)")
        apart.set_xlabel("time since departure (s)")
        section = drive.convoy.section
        title = f"{section.origin.name} – {section.destination.name}, {len(drive.trajectories)} trainsets"
        below = (
            f"{drive.follower}, {drive.convoy.guard}: gap {kpis.gap_min_m:.2f} to {kpis.gap_max_m:.2f} m, "
            f"speed difference at most {kpis.speed_difference_max_mps:.2f} m/s, {kpis.contacts} contacts"
        )
        add_headline(speed, title, below)
        return figure

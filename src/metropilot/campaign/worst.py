"""The worst runs of a campaign, driven again by the host loop for the report."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from metropilot._io import check_writable
from metropilot.campaign.declared import Campaign
from metropilot.campaign.rows import request_of_row
from metropilot.errors import MetropilotError
from metropilot.evaluate import Optimum, kpis_of, optimum_of, write_run, write_run_toml
from metropilot.sim import Drive, drive

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WORST = "worst"
DASH = "–"
NAMES = ("driver", "from", "to", "trainset", "load", "actuation", "time", "disturbance", "outcome")
NUMBERS = {"time error s": "time_error_s", "stop m": "stopping_error_m", "gap %": "optimality_gap_percent"}
WIDTH_IN, HEIGHT_IN = 5.6, 2.5


class Again(NamedTuple):
    """One of the worst runs, driven again.

    Attributes:
        folder: Its folder, relative to that of the campaign; empty if the run has no scheduled time.
        picture: Speed over distance as SVG; empty if the driver failed.
    """

    folder: str
    picture: str


def drive_worst(folder: Path, campaign: Campaign, worst: Sequence[Mapping[str, Any]]) -> list[Again]:
    """Drive the worst runs again and write the folder of a run for each: trajectory, KPIs, picture, request.

    Args:
        folder: The campaign's folder.
        campaign: The campaign.
        worst: Their rows, the worst first.

    Raises:
        InputError: The folder cannot be written.
    """
    found = []
    for place, row in enumerate(worst, 1):
        if row["scheduled_time_s"] is None:
            found.append(Again("", ""))
            continue
        request = request_of_row(campaign, row)
        target = folder / WORST / f"{place:02d}"
        check_writable(target)
        picture = ""
        try:
            driven = drive(request.run(), request.make_driver())
            optimum = optimum_of(driven, campaign.objective)
            write_run(target, request, driven, kpis_of(driven, optimum, campaign.objective), optimum)
            picture = speed_svg(driven, optimum)
        except (MetropilotError, ArithmeticError, ValueError, TypeError, LookupError):
            write_run_toml(target, request)
        found.append(Again(f"{WORST}/{place:02d}", picture))
    return found


def speed_svg(driven: Drive, optimum: Optimum | None) -> str:
    """The speed of a run over distance, as SVG for a page."""
    from metropilot.evaluate import house_style

    with house_style():
        text = io.StringIO()
        speed_figure(driven, optimum).savefig(text, format="svg", metadata={"Date": None})
    return "".join(text.getvalue().partition("<svg")[1:])


def speed_figure(driven: Drive, optimum: Optimum | None) -> Figure:
    """Speed over distance with limit, permitted speed, optimum and interventions of protection."""
    from matplotlib.figure import Figure

    from metropilot.evaluate import draw_speed, set_distance

    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
    axes = figure.subplots()
    draw_speed(axes, driven, optimum)
    set_distance(axes, driven.section, float(driven.trajectory.position_m[-1]))
    return figure


def worst_table(worst: Sequence[Mapping[str, Any]], again: Sequence[Again]) -> str:
    """HTML table of the worst runs, then a picture of each."""
    if not worst:
        return "<p>None.</p>"
    heads = "".join(f"<th class='text'>{name}</th>" for name in ("", *NAMES, *NUMBERS, "drive it again"))
    lines, pictures = [], []
    for place, (row, found) in enumerate(zip(worst, again, strict=True), 1):
        keys = ("driver", "origin", "destination", "trainset", "load", "actuation", "time")
        words = [str(place), *(str(row[key] or DASH) for key in (*keys, "disturbance", "outcome"))]
        if row["error"]:
            words[-1] = f"{words[-1]}: {row['error']}"
        numbers = [row[name] for name in NUMBERS.values()]
        cells = [escape(word) for word in words] + [DASH if n is None else f"{n:+.2f}" for n in numbers]
        link = f"{found.folder}/run.toml"
        cells.append(
            f"<code>metropilot drive --from <a href='{link}'>{link}</a></code>" if found.folder else DASH
        )
        lines.append("<tr>" + "".join(f"<td class='text'>{cell}</td>" for cell in cells) + "</tr>")
        if found.picture:
            said = f"{place}. {row['driver']}, {row['origin']}–{row['destination']}, {row['load']}, "
            said += f"{row['disturbance']}: {row['outcome']}, {numbers[0]:+.2f} s, {numbers[1]:+.2f} m"
            pictures.append(f"<figure>{found.picture}<figcaption>{escape(said)}</figcaption></figure>")
    said = "<p>Failed, unsafe and late runs first, then by the gap.</p>"
    table = f"<div class='wide'><table><tr>{heads}</tr>{''.join(lines)}</table></div>"
    return f"{said}{table}<div class='runs'>{''.join(pictures)}</div>"

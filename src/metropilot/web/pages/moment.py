"""A moment of a finished run: the slider that chooses it, and the values that the browser shows of it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from nicegui import ui

from metropilot.protection import LEVELS
from metropilot.web.pages.frame import prop_of
from metropilot.web.words.language import _

COLUMNS = (
    "time_s",
    "position_m",
    "speed_mps",
    "permitted_mps",
    "command",
    "energy_wheel_j",
    "energy_line_j",
)
"""Columns of a trajectory that a moment shows."""


class MomentSlider:
    """Slider over the moments of a run that is over; hidden while there are none.

    Args:
        root: Card of the run.
        plot: Its picture; with the class ``mp-along`` a plot over distance has the cursor, too.
    """

    def __init__(self, root: ui.element, plot: ui.element) -> None:
        self.root, self.plot = root, plot
        with ui.element("div").classes("mp-moment").props('hidden data-mp="moments"'):
            ui.label(_("Moment"))
            slider = ui.element("input").props('type=range min=0 max=0 step=1 data-mp="moment"')
            slider.props(prop_of("aria-label", _("Moment")))  # a value here would be set anew at every update
            ui.label("").props('data-mp="place"')

    def offer(self, driven: dict[str, Any], length_m: float) -> None:
        """Offer the moments of a drive.

        Args:
            driven: Values of :class:`metropilot.web.schemas.responses.DriveOut`.
            length_m: Length of its section.
        """
        scene = json.dumps(moments_of(driven) | {"length_m": length_m}, separators=(",", ":"))
        ui.run_javascript(f"metropilot.past('c{self.root.id}', {self.plot.id}, {scene})")

    def close(self) -> None:
        """Hide the slider and remove the cursors: the picture is not that of a finished run any more."""
        ui.run_javascript("metropilot.forget()")


def moments_of(driven: dict[str, Any]) -> dict[str, Any]:
    """Rows of a drive as those of a live run: with the level of protection and the energy of the plan.

    Args:
        driven: Values of :class:`metropilot.web.schemas.responses.DriveOut`.
    """
    columns, plan = driven["columns"], driven["plan"]
    hits = (driven.get("explanation") or {}).get("interventions", [])
    levels = list(dict.fromkeys([*LEVELS, *(hit["guard"] for hit in hits)]))
    time_s = np.asarray(columns["time_s"])
    level = np.zeros(time_s.size, np.int64)
    for hit in hits:
        level[(time_s >= hit["from_s"]) & (time_s < hit["to_s"])] = levels.index(hit["guard"])
    best: list[float | None] = [None] * time_s.size
    if plan is not None:
        at = np.interp(columns["position_m"], plan["position_m"], plan["energy_wheel_so_far_j"])
        best = at.round(1).tolist()
    values = [*(columns[name] for name in COLUMNS), level.tolist(), best]
    return {
        "columns": [*COLUMNS, "level", "plan_energy_wheel_j"],
        "rows": [list(row) for row in zip(*values, strict=True)],
        "levels": levels,
        "scheduled_time_s": driven["kpis"]["scheduled_time_s"],
    }

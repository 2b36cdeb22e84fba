"""A convoy stepped in real time, with link faults and emergency braking of its head on request."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from metropilot.convoy import ConvoyRequest, ConvoyRollout, Link, convoy_kpis, write_convoy
from metropilot.errors import InputError
from metropilot.protection import LEVELS
from metropilot.web.live.engine import Event, LeverlessEngine
from metropilot.web.work.plans import numbers, station, window

SILENT = float("inf")


class ConvoyEngine(LeverlessEngine):
    """A live convoy, with the methods of :class:`metropilot.web.live.engine.Engine`.

    Args:
        request: The convoy.
    """

    def __init__(self, request: ConvoyRequest) -> None:
        self.request = request
        convoy = request.convoy()
        follower = request.make_follower()
        self.scheduled_s = request.scheduled_time_s(convoy)
        self.rollout = ConvoyRollout(convoy, request.driven_head(convoy), follower, request.head.seed)
        self.steps = 0
        self.link = request.link
        self.head_brakes = False

    @property
    def time_s(self) -> float:
        """Time since departure."""
        return self.rollout.time_s

    @property
    def dt_s(self) -> float:
        """Control period."""
        return self.rollout.dt

    @property
    def over(self) -> bool:
        """True when all trainsets stand still."""
        return self.rollout.over

    @property
    def position_m(self) -> float:
        """Position of the head of the first trainset."""
        return float(self.rollout.states[0].plant.position_m)

    def advance(self) -> list[Any]:
        """Simulate one control period; return its row."""
        time_s, gaps, apart = self.rollout.advance()
        self.steps += 1
        states = self.rollout.states
        return [
            round(time_s, 4),
            [round(float(s.plant.position_m), 3) for s in states],
            [round(float(s.plant.speed_mps), 4) for s in states],
            [round(x, 4) for x in gaps],
            [round(x, 5) for x in apart],
            [0 if s.watched is None else int(s.watched.level) for s in states],
            [round(max(time_s - float(s.channel.heard.stamp_s), 0.0), 2) for s in states[1:]],
            self.steps,
        ]

    def apply(self, event: Event) -> str:
        """Change the link or apply the emergency brake of the head; return a description.

        Raises:
            InputError: The event is none of a convoy.
        """
        if event["kind"] == "emergency":
            self.head_brakes = True
            self.rollout.brake_head()
            return "the head makes an emergency brake"
        if event["kind"] != "link":
            raise InputError("unknown event of a convoy", field="kind", value=event["kind"])
        since = 0.0 if event["silent"] else SILENT
        self.link = Link(event["delay_s"], event["jitter_s"], event["loss"], since)
        self.rollout.relink(self.link)
        if event["silent"]:
            return "the link is silent"
        lost = f"{100 * event['loss']:g} % lost"
        return f"link: {event['delay_s']:g} s late, {event['jitter_s']:g} s uneven, {lost}"

    def scene(self) -> dict[str, Any]:
        """Values that are constant between events."""
        convoy = self.rollout.convoy
        section = convoy.section
        return {
            "columns": ["time_s", "position_m", "speed_mps", "gap_m", "apart_mps", "level", "age_s", "step"],
            "levels": list(LEVELS),
            "name": section.name,
            "line": section.line_id,
            "origin": station(section.origin, 0.0),
            "destination": station(section.destination, section.length_m),
            "length_m": section.length_m,
            "trainset_length_m": convoy.trainsets[0].length_m,
            "starts_m": list(convoy.starts_m),
            "gap_m": convoy.gap_m,
            "scheduled_time_s": self.scheduled_s,
            "follower": self.request.follower,
            "limit_mps": window(section, "limit_mps"),
            "dt_s": self.dt_s,
            "link": {
                "delay_s": self.link.delay_s,
                "jitter_s": self.link.jitter_s,
                "loss": self.link.loss,
                "silent": self.link.silent_from_s != SILENT,
            },
            "head_brakes": self.head_brakes,
        }

    def report(self, folder: Path) -> tuple[dict[str, Any], dict[str, Any], str]:
        """Write the files of the run; return the result in short and in full, and the outcome."""
        driven = self.rollout.result()
        kpis = convoy_kpis(driven, self.scheduled_s)
        write_convoy(folder, self.request, driven, kpis)
        checks = [check._asdict() | {"passed": bool(check.passed)} for check in kpis.checks]
        short = {"success": kpis.success, "kpis": kpis.as_dict(), "checks": checks}
        full = {
            **short,
            "time_s": numbers(driven.time_s, 3),
            "gap_m": driven.gap_m.round(4).tolist(),
            "speed_difference_mps": driven.speed_difference_mps.round(5).tolist(),
            "speeds": [
                {"time_s": numbers(t.time_s, 3), "speed_mps": numbers(t.speed_mps, 4)}
                for t in driven.trajectories
            ],
        }
        return short, full, kpis.outcome

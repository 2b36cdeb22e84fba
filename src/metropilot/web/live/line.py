"""A line in operation stepped in real time or faster, with delays that are injected."""

from __future__ import annotations

import csv
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from metropilot import operation
from metropilot._io import fill_folder
from metropilot.errors import InputError
from metropilot.web.live.engine import Event, LeverlessEngine
from metropilot.web.work.plans import LineRequest, numbers, station

ROW_S = 5.0
"""Time between two rows; the line itself is looked at every second."""
DELAYS = "delays.csv"
GRAPH = ("time_s", "position_m", "delay_s", "energy_kwh", "floor_kwh")
"""Columns of the train graph that is kept: a row has a value of each, or a list with one for each train."""
WINDOW_S = 1800.0
"""Time of the train graph that is shown, and kept with the result."""


@dataclass(frozen=True, kw_only=True)
class RunningRequest(LineRequest):
    """A line that runs.

    Attributes:
        lasts_s: Time after which it ends.
    """

    lasts_s: float


class LineEngine(LeverlessEngine):
    """A running line, with the methods of :class:`metropilot.web.live.engine.Engine`.

    Args:
        request: The line.
    """

    def __init__(self, request: RunningRequest) -> None:
        self.request = request
        self.running = operation.RunningLine(operation.operation_energy(request.operation()))
        self.steps = 0
        self.rows: list[tuple[float, list[float]]] = []
        self.shown: deque[tuple[Any, ...]] = deque(maxlen=round(WINDOW_S / ROW_S) + 1)

    @property
    def time_s(self) -> float:
        """Time since the beginning."""
        return self.running.time_s

    @property
    def dt_s(self) -> float:
        """Time between two rows."""
        return ROW_S

    @property
    def over(self) -> bool:
        """True when the time that was asked for is over."""
        return self.time_s >= self.request.lasts_s

    @property
    def position_m(self) -> float:
        """Position of the first train."""
        return self.running.positions_m[0]

    def advance(self) -> list[Any]:
        """Let the time of a row pass; return it in the order of the scene's ``columns``."""
        until_s = self.time_s + ROW_S
        while self.time_s < until_s:
            self.running.advance()
        self.steps += 1
        running = self.running
        self.rows.append((self.time_s, running.delays_s))
        told = running.as_dict()
        counts = (told["energy_kwh"], told["floor_kwh"], told["waits"], told["stops"])
        places, delays = numbers(running.positions_m, 0), numbers(running.delays_s, 0)
        energy, floor, *counted = numbers(counts, 2)
        gap = told["gap_percent"]
        gap = None if gap is None else round(gap, 2)
        row = [round(self.time_s, 1), places, delays, energy, floor, gap, *counted]
        self.shown.append(tuple(row[: len(GRAPH)]))
        return [*row, self.steps]

    def pop_updates(self) -> list[str]:
        """Descriptions of what happened since the last call."""
        return [words for _, words in self.running.pop_news()]

    def apply(self, event: Event) -> str:
        """Hold a train or slow a section; return a description.

        Raises:
            InputError: The event is not possible, or none of a line.
        """
        kind, values = event["kind"], {name: value for name, value in event.items() if name != "kind"}
        if kind == "hold":
            return self.running.hold(operation.TrainHold(**values))
        if kind == "slow":
            return self.running.slow(operation.SlowSection(**values))
        raise InputError("unknown event of a line", field="kind", value=kind)

    def scene(self) -> dict[str, Any]:
        """Values that are constant."""
        line, options = self.running.operation.line, self.request.options
        return {
            "columns": [
                "time_s",
                "position_m",
                "delay_s",
                "energy_kwh",
                "floor_kwh",
                "gap_percent",
                "waits",
                "stops",
                "step",
            ],
            "line": line.id,
            "stops": [station(stop) for stop in line.stations],
            "trains": self.running.fleet,
            "headway_s": options.headway_s,
            "scheduled_time_s": self.request.lasts_s,
            "dt_s": ROW_S,
        }

    def report(self, folder: Path) -> tuple[dict[str, Any], dict[str, Any], str]:
        """Write the delays of all trains; return the result in short and with its graph, and the outcome."""
        told = self.running.as_dict()
        with fill_folder(folder) as scratch, (scratch / DELAYS).open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["time_s", *(f"delay_{train.number}_s" for train in self.running.trains)])
            writer.writerows([time_s, *numbers(delays, 1)] for time_s, delays in self.rows)
        recovered = told["disturbed_s"] is None or told["recovered_s"] is not None
        outcome = "every train is on time" if recovered else f"{told['delay_s']:.0f} s late in all"
        graph: dict[str, Any] = dict(zip(GRAPH, map(list, zip(*self.shown, strict=True)), strict=True))
        stops = [{"code": s.code, "position_m": s.position_m} for s in self.running.operation.line.stations]
        return told, told | {"outcome": outcome, "graph": graph | {"stops": stops}}, outcome

"""The process of one live run: it keeps the clock, and the server at the other end of the pipe forwards."""

from __future__ import annotations

import json
from multiprocessing.connection import Connection
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from metropilot.errors import MetropilotError
from metropilot.web.refused import detail_of
from metropilot.web.work.setup import begin

if TYPE_CHECKING:
    from metropilot.web.live.convoy import ConvoyEngine
    from metropilot.web.live.engine import Engine

    AnyEngine = Engine | ConvoyEngine

FLUSH_S = 0.1
MOST_STEPS = 40
GIVEN_UP_S = 0.5
"""Further behind than this the clock is set back: a run never races to catch up."""


def main(pipe: Connection, worker_bytes: int) -> None:
    """Wait for an order, then drive it; ends with the pipe."""
    begin(worker_bytes, 0)
    import metropilot.web.live.convoy
    import metropilot.web.live.engine  # noqa: F401 (warm before the order comes)

    try:
        order = pipe.recv()
        Driving(pipe, order).to_the_end()
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return


class Driving:
    """A live run and its clock.

    Args:
        pipe: To the server.
        order: ``request``, ``pace``, ``root``, ``job``, ``journal``, ``step`` (replayed up to here).
    """

    def __init__(self, pipe: Connection, order: dict[str, Any]) -> None:
        self.pipe = pipe
        self.order = order
        self.pace = float(order["pace"])
        self.stopped = False
        self.flushed = 0.0

    def to_the_end(self) -> None:
        """Begin, replay, drive, report."""
        try:
            engine = self._engine()
            self._replay(engine)
            self._clock(engine)
            while not engine.over and not self.stopped:
                self._listen(engine)
                self._drive(engine)
            if not self.stopped:
                self._report(engine)
        except MetropilotError as error:
            self._say("error", {"error": detail_of(error)})
        self._say("end", {"stopped": self.stopped})

    def _engine(self) -> AnyEngine:
        from metropilot.web.live.convoy import ConvoyEngine
        from metropilot.web.live.engine import Engine

        return (ConvoyEngine if self.order["convoy"] else Engine)(self.order["request"])

    def _say(self, kind: str, value: dict[str, Any]) -> None:
        self.pipe.send((kind, encoded(value), {}))

    def _rows(self, engine: AnyEngine, rows: list[list[Any]]) -> None:
        self.flushed = monotonic()
        behind = round(max(self._wanted_s() - engine.time_s, 0.0), 3)
        known = {"time_s": engine.time_s, "position_m": engine.position_m}
        known |= {"step": engine.steps, "pace": self.pace, "behind_s": behind}
        self.pipe.send(("rows", encoded({"rows": rows, "behind_s": behind, "pace": self.pace}), known))

    def _replay(self, engine: AnyEngine) -> None:
        """Do again what was done before the server went away."""
        journal = list(self.order["journal"])
        end = max([self.order["step"], *(step for step, _ in journal)])
        self._say("scene", engine.scene())
        rows = []
        while not engine.over:
            while journal and journal[0][0] <= engine.steps:
                engine.apply(journal.pop(0)[1])
            if engine.steps >= end:
                break
            rows.append(engine.advance())
        let_go = {"kind": "lever", "share": None}
        if not engine.holds(let_go):
            engine.apply(let_go)
        if rows:
            self._clock(engine)
            self._rows(engine, rows)
            self._say("scene", engine.scene())

    def _clock(self, engine: AnyEngine) -> None:
        """From now on the run's clock goes at the pace."""
        self.began, self.began_s = monotonic(), engine.time_s

    def _wanted_s(self) -> float:
        return self.began_s + self.pace * (monotonic() - self.began)

    def _listen(self, engine: AnyEngine) -> None:
        """Take orders until the next control period is due."""
        until = monotonic() + self._due_s(engine)
        while not self.stopped:
            if not self.pipe.poll(max(until - monotonic(), 0.0)):
                return
            number, event = self.pipe.recv()
            until = min(until, monotonic() + self._due_s(engine))
            try:
                self._take(engine, number, event)
            except MetropilotError as error:
                self.pipe.send(("answer", b"", {"number": number, "error": error}))

    def _due_s(self, engine: AnyEngine) -> float:
        """Until rows are due: a control period, but not more often than viewers need."""
        if self.pace <= 0:
            return FLUSH_S
        due = (engine.time_s + engine.dt_s - self._wanted_s()) / self.pace
        return max(due, self.flushed + FLUSH_S - monotonic(), 0.0)

    def _take(self, engine: AnyEngine, number: int, event: dict[str, Any]) -> None:
        if event["kind"] == "stop":
            self.stopped = True
        elif event["kind"] == "pace":
            self.pace = float(event["pace"])
            self._clock(engine)
        else:
            self._apply(engine, event)
        self.pipe.send(("answer", b"", {"number": number, "time_s": engine.time_s}))
        if event["kind"] == "pace":
            self._rows(engine, [])

    def _apply(self, engine: AnyEngine, event: dict[str, Any]) -> None:
        if engine.holds(event):
            return
        words = engine.apply(event)
        self.pipe.send(("journal", b"", {"step": engine.steps, "event": event}))
        if words:
            self._say("event", {"time_s": engine.time_s, "kind": event["kind"], "words": words})
            self._say("scene", engine.scene())

    def _drive(self, engine: AnyEngine) -> None:
        """The control periods that are due, at most so many before orders are heard again."""
        if self.pace <= 0:
            return
        if engine.forgotten():
            self._apply(engine, {"kind": "lever", "share": None})
        dt, rows, began = engine.dt_s, [], monotonic()
        while engine.time_s + dt <= self._wanted_s() + 1e-6 and not engine.over:
            rows.append(engine.advance())
            if len(rows) >= MOST_STEPS or monotonic() - began > FLUSH_S:
                break
        if rows:
            self._rows(engine, rows)
        if self._wanted_s() - engine.time_s > GIVEN_UP_S * max(self.pace, 1.0):
            self._clock(engine)

    def _report(self, engine: AnyEngine) -> None:
        from metropilot.web.work.drives import folder_of

        folder: Path = folder_of(self.order["root"], self.order["job"])
        short, full, outcome = engine.report(folder)
        self._say("result", short)
        self.pipe.send(("kept", b"", {"result": full, "outcome": outcome}))


def encoded(value: object) -> bytes:
    """One line of JSON."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()

"""Process of one live run: steps it in real time and sends its messages to the server."""

from __future__ import annotations

import json
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from time import monotonic
from traceback import print_exception
from typing import TYPE_CHECKING, Any

from metropilot.errors import MetropilotError
from metropilot.web.errors import detail_of
from metropilot.web.pools import explain
from metropilot.web.work.plans import begin

if TYPE_CHECKING:
    from metropilot.web.live.convoy import ConvoyEngine
    from metropilot.web.live.engine import Engine
    from metropilot.web.live.line import LineEngine

    AnyEngine = Engine | ConvoyEngine | LineEngine

FLUSH_S = 0.1
"""Shortest interval between two messages with rows; viewers see no difference below it."""
MOST_STEPS = 40
"""Control periods simulated at most before events are read again, so that a high pace stays responsive."""
GIVEN_UP_S = 0.5
"""Lag behind the clock above which the clock is set back, so that a run does not race to catch up."""
ROUNDING_S = 1e-6
"""Rounding of a run's clock, a sum of periods, which must not put a period off to the next round."""
STEP_S = 1.0
"""Time of the run that a step simulates; at least one control period."""
GIVE_BACK = {"kind": "lever", "share": None, "take_over": True}
"""The event that returns the lever to the driver, whatever its holder."""
SERVER_GONE = (EOFError, BrokenPipeError, ConnectionResetError)
"""Errors of a pipe whose other end is closed."""


def main(pipe: Connection, worker_bytes: int) -> None:
    """Wait for an order, then drive it; end with the pipe."""
    begin(worker_bytes, 0)
    import metropilot.web.live.convoy
    import metropilot.web.live.engine
    import metropilot.web.live.line  # noqa: F401 (warm before the order comes)

    try:
        order = pipe.recv()
        Driving(pipe, order).to_the_end()
    except SERVER_GONE:
        return


class Driving:
    """A live run and its clock.

    Args:
        pipe: Connection to the server.
        order: ``request``, ``drives`` (run, convoy, line), ``pace``, ``root``, ``job``, ``journal``, ``step``
            (replayed up to here).
    """

    def __init__(self, pipe: Connection, order: dict[str, Any]) -> None:
        self.pipe = pipe
        self.order = order
        self.pace = float(order["pace"])
        self.stopped = False
        self.flushed = 0.0

    def to_the_end(self) -> None:
        """Begin, replay, drive and report; any error is sent before the end of the run is."""
        steps, failure = self.order["step"], None
        try:
            engine = self._engine()
            self._replay(engine)
            self._clock(engine)
            while not engine.over and not self.stopped:
                self._listen(engine)
                self._drive(engine)
            steps = engine.steps
            if not self.stopped:
                self._report(engine)
        except Exception as error:  # noqa: BLE001 (any error ends the run and is sent to its viewers)
            failure = error
            detail = detail_of(explain(error, 0.0))
            # Where the server is gone, this raises as well: the process ends in silence.
            self._say("error", {"error": detail}, {"error": detail})
        status = "failed" if failure else "stopped" if self.stopped else "done"
        self._say("end", {"status": status}, {"status": status, "step": steps})
        if failure is not None and not isinstance(failure, MetropilotError):
            print_exception(failure)

    def _engine(self) -> AnyEngine:
        from metropilot.web.live.convoy import ConvoyEngine
        from metropilot.web.live.engine import Engine
        from metropilot.web.live.line import LineEngine

        engines: dict[str, Any] = {"convoy": ConvoyEngine, "line": LineEngine, "run": Engine}
        return engines[self.order["drives"]](self.order["request"])

    def _say(self, kind: str, value: dict[str, Any], known: dict[str, Any] | None = None) -> None:
        self.pipe.send((kind, encode(value), known or {}))

    def _say_scene(self, engine: AnyEngine) -> None:
        scene = engine.scene()
        known = {"scheduled_time_s": scene["scheduled_time_s"], "lever": engine.lever()}
        self._say("scene", scene, known)

    def _rows(self, engine: AnyEngine, rows: list[list[Any]]) -> None:
        self.flushed = monotonic()
        behind = round(max(self._clock_s() - engine.time_s, 0.0), 3)
        known = {"time_s": engine.time_s, "position_m": engine.position_m}
        known |= {"step": engine.steps, "pace": self.pace, "behind_s": behind}
        self.pipe.send(("rows", encode({"rows": rows, "behind_s": behind, "pace": self.pace}), known))

    def _replay(self, engine: AnyEngine) -> None:
        """Repeat the steps and events of an earlier process."""
        journal = list(self.order["journal"])
        end = max([self.order["step"], *(step for step, _ in journal)])
        self._say_scene(engine)
        rows, told = [], False
        while not engine.over:
            while journal and journal[0][0] <= engine.steps:
                event = journal.pop(0)[1]
                told = self._tell(engine, event["kind"], engine.apply(event)) or told
            if engine.steps >= end:
                break
            rows.append(engine.advance())
            self._send_updates(engine)
        if rows:
            self._clock(engine)
            self._rows(engine, rows)
        if rows or told:
            self._say_scene(engine)
        self._apply(engine, GIVE_BACK)

    def _clock(self, engine: AnyEngine) -> None:
        """Restart the run's clock at the present pace."""
        self.began, self.began_s = monotonic(), engine.time_s

    def _clock_s(self) -> float:
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
        due = (engine.time_s + engine.dt_s - self._clock_s()) / self.pace
        return max(due, self.flushed + FLUSH_S - monotonic(), 0.0)

    def _take(self, engine: AnyEngine, number: int, event: dict[str, Any]) -> None:
        if event["kind"] == "stop":
            self.stopped = True
        elif event["kind"] == "pace":
            self.pace = float(event["pace"])
            self._clock(engine)
        elif event["kind"] == "step":
            self._step(engine)
        else:
            self._apply(engine, event)
        known = {"number": number, "time_s": engine.time_s, "lever": engine.lever()}
        self.pipe.send(("answer", b"", known))
        if event["kind"] == "pace":
            self._rows(engine, [])

    def _apply(self, engine: AnyEngine, event: dict[str, Any]) -> None:
        if engine.holds(event):
            return
        words = engine.apply(event)
        self.pipe.send(("journal", b"", {"step": engine.steps, "event": event}))
        if self._tell(engine, event["kind"], words):
            self._say_scene(engine)

    def _tell(self, engine: AnyEngine, kind: str, words: str) -> bool:
        """Send a description of an event; return True if it is not empty."""
        if words:
            said = {"time_s": engine.time_s, "kind": kind, "words": words}
            self._say("event", said, {"lever": engine.lever()})
        return bool(words)

    def _send_updates(self, engine: AnyEngine) -> bool:
        """Send the timetable updates of the request; return True if there were any."""
        updates = engine.pop_updates()
        for words in updates:
            self._tell(engine, "news", words)
        return bool(updates)

    def _drive(self, engine: AnyEngine) -> None:
        """Simulate the control periods that are due, at most ``MOST_STEPS`` between two looks at the pipe."""
        if engine.lever_expired():
            self._apply(engine, GIVE_BACK)
        if self.pace <= 0:
            return
        self._simulate(engine, self._clock_s)
        if self._clock_s() - engine.time_s > GIVEN_UP_S * max(self.pace, 1.0):
            self._clock(engine)

    def _step(self, engine: AnyEngine) -> None:
        """Pause the run and simulate a second of it."""
        self.pace = 0.0
        until_s = engine.time_s + max(STEP_S, engine.dt_s)
        self._clock(engine)
        while engine.time_s + engine.dt_s <= until_s + ROUNDING_S and not engine.over:
            self._simulate(engine, lambda: until_s)
        self._clock(engine)

    def _simulate(self, engine: AnyEngine, until_s: Callable[[], float]) -> None:
        """Simulate the control periods up to a time, at most ``MOST_STEPS``, and send their rows."""
        rows, began = [], monotonic()
        while engine.time_s + engine.dt_s <= until_s() + ROUNDING_S and not engine.over:
            rows.append(engine.advance())
            if len(rows) >= MOST_STEPS or monotonic() - began > FLUSH_S:
                break
        if rows:
            self._rows(engine, rows)
        if self._send_updates(engine):
            self._say_scene(engine)

    def _report(self, engine: AnyEngine) -> None:
        from metropilot.web.work.drives import folder_of

        folder: Path = folder_of(self.order["root"], self.order["job"])
        short, full, outcome = engine.report(folder)
        self._say("result", short)
        self.pipe.send(("store", b"", {"result": full, "outcome": outcome}))


def encode(value: object) -> bytes:
    """One line of JSON."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False).encode()

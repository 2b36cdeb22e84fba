"""The process of one live run: it keeps the clock, and the server at the other end of the pipe forwards."""

from __future__ import annotations

from multiprocessing.connection import Connection
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from metropilot.errors import MetropilotError
from metropilot.web.refused import detail_of
from metropilot.web.work.setup import begin

if TYPE_CHECKING:
    from metropilot.web.live.engine import Engine

FLUSH_S = 0.1
MOST_STEPS = 40
GIVEN_UP_S = 0.5
"""Further behind than this the clock is set back: a run never races to catch up."""


def main(pipe: Connection, worker_bytes: int) -> None:
    """Wait for an order, then drive it; ends with the pipe."""
    begin(worker_bytes, 0)
    import metropilot.web.live.engine
    import metropilot.web.work.drives  # noqa: F401 (warm before the order comes)

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
        from metropilot.web.live.engine import Engine

        try:
            engine = Engine(self.order["request"])
            self._replay(engine)
            self._clock(engine)
            while engine.rollout.outcome is None and not self.stopped:
                self._listen(engine)
                self._drive(engine)
            if not self.stopped:
                self._report(engine)
        except MetropilotError as error:
            self._say("error", {"error": detail_of(error)})
        self._say("end", {"stopped": self.stopped})

    def _say(self, kind: str, value: dict[str, Any]) -> None:
        from metropilot.web.live.engine import encoded

        self.pipe.send((kind, encoded(value), {}))

    def _rows(self, engine: Engine, rows: list[list[Any]]) -> None:
        from metropilot.web.live.engine import encoded

        self.flushed = monotonic()
        behind = round(max(self._wanted_s() - engine.time_s, 0.0), 3)
        known = {"time_s": engine.time_s, "position_m": float(engine.rollout.state.position_m)}
        known |= {"step": engine.steps, "pace": self.pace, "behind_s": behind}
        self.pipe.send(("rows", encoded({"rows": rows, "behind_s": behind, "pace": self.pace}), known))

    def _replay(self, engine: Engine) -> None:
        """Do again what was done before the server went away."""
        journal = list(self.order["journal"])
        self._say("scene", engine.scene())
        rows = []
        while engine.steps < self.order["step"] and engine.rollout.outcome is None:
            while journal and journal[0][0] <= engine.steps:
                engine.apply(journal.pop(0)[1])
            rows.append(engine.advance())
        engine.apply({"kind": "lever", "share": None})
        if rows:
            self._clock(engine)
            self._rows(engine, rows)
            self._say("scene", engine.scene())

    def _clock(self, engine: Engine) -> None:
        """From now on the run's clock goes at the pace."""
        self.began, self.began_s = monotonic(), engine.time_s

    def _wanted_s(self) -> float:
        return self.began_s + self.pace * (monotonic() - self.began)

    def _listen(self, engine: Engine) -> None:
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

    def _due_s(self, engine: Engine) -> float:
        """Until rows are due: a control period, but not more often than viewers need."""
        if self.pace <= 0:
            return FLUSH_S
        due = (engine.time_s + engine.rollout.run.dt - self._wanted_s()) / self.pace
        return max(due, self.flushed + FLUSH_S - monotonic(), 0.0)

    def _take(self, engine: Engine, number: int, event: dict[str, Any]) -> None:
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

    def _apply(self, engine: Engine, event: dict[str, Any]) -> None:
        if event["kind"] == "lever" and engine.holds(event["share"]):
            return
        words = engine.apply(event)
        self.pipe.send(("journal", b"", {"step": engine.steps, "event": event}))
        if words:
            self._say("event", {"time_s": engine.time_s, "kind": event["kind"], "words": words})
            self._say("scene", engine.scene())

    def _drive(self, engine: Engine) -> None:
        """The control periods that are due, at most so many before orders are heard again."""
        if self.pace <= 0:
            return
        if engine.forgotten():
            self._apply(engine, {"kind": "lever", "share": None})
        dt, rows, began = engine.rollout.run.dt, [], monotonic()
        while engine.time_s + dt <= self._wanted_s() + 1e-6 and engine.rollout.outcome is None:
            rows.append(engine.advance())
            if len(rows) >= MOST_STEPS or monotonic() - began > FLUSH_S:
                break
        if rows:
            self._rows(engine, rows)
        if self._wanted_s() - engine.time_s > GIVEN_UP_S * max(self.pace, 1.0):
            self._clock(engine)

    def _report(self, engine: Engine) -> None:
        from metropilot.evaluate import kpis_of, optimum_of, write_run
        from metropilot.web.work.drives import drive_out, folder_of

        driven = engine.rollout.drive()
        optimum = optimum_of(driven, engine.request.objective)
        kpis = kpis_of(driven, optimum, engine.request.objective)
        out = drive_out(driven, kpis, optimum)
        short = {name: out[name] for name in ("driver", "success", "kpis", "checks")}
        self._say("result", short)
        folder: Path = folder_of(self.order["root"], self.order["job"])
        write_run(folder, engine.request, driven, kpis, optimum)
        self.pipe.send(("kept", b"", {"result": out, "outcome": kpis.outcome}))

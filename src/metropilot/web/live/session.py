"""Live run on the side of the server: its process, its messages so far, its viewers."""

from __future__ import annotations

import asyncio
import itertools
import json
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from dataclasses import dataclass, field, fields
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from threading import Thread
from time import monotonic
from traceback import print_exception
from typing import Any, cast

from metropilot.web.errors import FIELDS, Refused, detail_of
from metropilot.web.live.worker import main
from metropilot.web.pools import explain
from metropilot.web.users import check_may_change

ANSWER_S = 10.0
"""Longest wait for the process of a run: for its start, an answer, its end."""
KEEP_ALIVE_S = 15.0
"""Interval of comments in a quiet stream; proxies close connections that are silent for 30 to 60 s."""
SHOWN = ("scene", "rows", "event", "result", "error")
GOING = ("queued", "running")
"""Status of a run that is not over: it waits for its place, or it drives."""
DIED = "the process of the run ended before the run did, most likely of too little memory"


@dataclass
class Spare:
    """A process that waits for a run."""

    process: BaseProcess
    pipe: Connection


def place_words(place: int | None) -> str:
    """Place in the queue, in words."""
    return f"place {place} in the queue"


def start_spare(worker_bytes: int) -> Spare:
    """Start a process, which imports its modules while it waits."""
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=main, args=(theirs, worker_bytes), daemon=True)
    process.start()
    theirs.close()
    return Spare(process, cast("Connection", ours))


@dataclass
class Known:
    """Latest state of a live run."""

    time_s: float = 0.0
    position_m: float = 0.0
    step: int = 0
    pace: float = 1.0
    behind_s: float = 0.0
    outcome: str | None = None
    scheduled_time_s: float | None = None
    lever: dict[str, Any] | None = None
    error: dict[str, Any] | None = None
    status: str = "queued"
    place: int | None = None


KNOWN = tuple(f.name for f in fields(Known) if f.name not in {"status", "error", "place"})


@dataclass
class Session:
    """One live run: it waits for its place among those that the server drives at once, then drives.

    Attributes:
        id: Id of the job.
        request: The body of the request.
        user: Name of who began it, None on a server that names no users.
        order: What its process is to drive; see :class:`metropilot.web.live.worker.Driving`.
        keep: Called in the reader's thread with each message to be stored.
        over_now: Called in the loop when it is over.
        spare: Its process; None while it waits.
        known: Latest state; ``place`` is that in the queue, from 1, while it waits.
        sent: All events of the stream so far.
        viewers: Number of viewers.
        summary: KPIs and requirements, once it has stopped.
        seen_at: Monotonic time at which it was last watched or requested.
    """

    id: str
    request: dict[str, Any]
    order: dict[str, Any]
    keep: Callable[[Session, str, dict[str, Any]], None]
    over_now: Callable[[], None]
    user: str | None = None
    spare: Spare | None = None
    known: Known = field(default_factory=Known)
    sent: list[bytes] = field(default_factory=list)
    viewers: int = 0
    summary: dict[str, Any] | None = None
    seen_at: float = field(default_factory=monotonic)

    def __post_init__(self) -> None:
        self.loop = asyncio.get_running_loop()
        self.more = asyncio.Event()
        self.numbers = itertools.count()
        self.answers: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self.ready, self.ended = asyncio.Event(), asyncio.Event()
        self.given_up = False
        self.known.pace = float(self.request["pace"])

    @property
    def over(self) -> bool:
        """True when the run has ended."""
        return self.known.status not in GOING

    @property
    def waiting(self) -> bool:
        """True while the run waits for its place."""
        return self.known.status == "queued"

    @property
    def unwatched_s(self) -> float:
        """Time without viewers or requests."""
        return 0.0 if self.viewers else monotonic() - self.seen_at

    def say_place(self, place: int) -> None:
        """Tell the viewers the place in the queue, where it has changed."""
        if place != self.known.place:
            self.known.place = place
            self._say("place", json.dumps({"place": place}).encode())

    def start(self, spare: Spare) -> None:
        """Send a process its order and read its messages in a thread."""
        self.spare, self.known.status, self.known.place = spare, "running", None
        self.seen_at = monotonic()
        with suppress(OSError):  # the process has died; the reader finds the pipe closed and ends the run
            spare.pipe.send(self.order)
        Thread(target=self._listen, args=(spare,), daemon=True, name=self.id).start()

    async def wait_ready(self) -> None:
        """Wait until the run is ready to depart, at most ``ANSWER_S``.

        Raises:
            Refused: It cannot depart; the message gives the reason.
        """
        with suppress(TimeoutError):
            await asyncio.wait_for(self.ready.wait(), ANSWER_S)
        if self.known.status == "failed":
            raise self.failure()

    def failure(self) -> Refused:
        """Error of a failed run."""
        told = self.known.error or {"message": DIED}
        shown = {name: told.get(name) for name in ("field", "value", "allowed")}
        return Refused(told["message"], 422, **shown)

    async def ask(self, event: dict[str, Any]) -> float:
        """Send the run an event; return the time since departure at which it takes effect.

        Raises:
            Refused: A viewer sends it (403), or the run is over, or does not answer (409).
            InputError: The event is not possible; the message names the allowed values.
        """
        check_may_change()
        if self.over:
            raise Refused("the run is over", 409, field="id", value=self.id)
        if self.spare is None:
            raise Refused(f"the run waits, {place_words(self.known.place)}", 409, field="id", value=self.id)
        self.seen_at = monotonic()
        if not self.ready.is_set():
            with suppress(TimeoutError):
                await asyncio.wait_for(self.ready.wait(), ANSWER_S)
        if not self.ready.is_set():
            raise Refused("the run is still being planned; try again", 409, field="id", value=self.id)
        number = next(self.numbers)
        future = self.answers[number] = self.loop.create_future()
        try:
            self.spare.pipe.send((number, event))
            answer = await asyncio.wait_for(future, ANSWER_S)
        except (OSError, TimeoutError):
            raise Refused("the run does not answer", 409, field="id", value=self.id) from None
        finally:
            self.answers.pop(number, None)
        if "error" in answer:
            raise answer["error"]
        return float(answer["time_s"])

    async def stop(self) -> float:
        """Stop the run, so that it can be resumed; return the time since departure.

        One that waits leaves the queue.

        Raises:
            Refused: A viewer stops it (403), or the run is over, or does not answer (409).
        """
        check_may_change()
        if self.waiting:
            self.keep(self, "end", {"status": "stopped", "error": None})
            self._end("stopped", None)
            return 0.0
        if not self.ready.is_set() and not self.over:
            # it plans, for many seconds maybe, and listens to nobody: nothing of it is lost with its process
            self.given_up = True
            self.kill()
            with suppress(TimeoutError):
                await asyncio.wait_for(self.ended.wait(), ANSWER_S)
            return 0.0
        at = await self.ask({"kind": "stop"})
        with suppress(TimeoutError):
            await asyncio.wait_for(self.ended.wait(), ANSWER_S)
        return at

    async def listen(self, after: int = -1) -> AsyncIterator[bytes]:
        """Yield the events of the stream after number ``after`` until the run is over."""
        self.viewers += 1
        at = after + 1
        try:
            while True:
                if at < len(self.sent):
                    chunk, at = b"".join(self.sent[at:]), len(self.sent)
                    yield chunk
                    continue
                if self.over:
                    return
                waits = self.more
                try:
                    await asyncio.wait_for(waits.wait(), KEEP_ALIVE_S)
                except TimeoutError:
                    yield b": still here\n\n"
        finally:
            self.viewers -= 1
            self.seen_at = monotonic()

    def kill(self) -> None:
        """End the process at once."""
        if self.spare is not None:
            self.spare.process.kill()

    def _listen(self, spare: Spare) -> None:
        """Forward the messages of the process until it ends; runs in a thread of its own.

        Whatever fails here ends the run as failed: a reader that died alone would leave viewers waiting.
        """
        last: dict[str, Any] = {"status": "failed"}
        error: dict[str, Any] | None = None
        try:
            while True:
                kind, text, known = spare.pipe.recv()
                if kind == "end":
                    last = known
                    break
                error = known["error"] if kind == "error" else error
                if kind in {"journal", "store", "rows"}:
                    self.keep(self, kind, known)
                self._in_loop(self._receive, kind, text, known)
        except (EOFError, OSError):
            if self.given_up:
                last = {"status": "stopped"}
            error = None if self.given_up else {"message": DIED, **dict.fromkeys(FIELDS)}
        except Exception as raised:  # noqa: BLE001 (a message that cannot be read or stored)
            error = detail_of(explain(raised, 0.0))
            self.kill()
            print_exception(raised)
        spare.process.join(ANSWER_S)
        self.kill()
        try:
            self.keep(self, "end", {**last, "error": error})
        except Exception as raised:  # noqa: BLE001 (viewers are told even where the store is not)
            last, error = {"status": "failed"}, error or detail_of(explain(raised, 0.0))
            print_exception(raised)
        self._in_loop(self._end, last["status"], error)

    def _in_loop(self, call: Callable[..., None], *values: object) -> None:
        try:
            self.loop.call_soon_threadsafe(call, *values)
        except RuntimeError:
            return  # the server is gone

    def _receive(self, kind: str, text: bytes, known: dict[str, Any]) -> None:
        for name, value in known.items():
            if name in KNOWN:
                setattr(self.known, name, value)
        if kind == "answer":
            future = self.answers.get(known["number"])
            if future is not None and not future.done():
                future.set_result(known)
        elif kind in SHOWN:
            if kind == "result":
                self.summary = json.loads(text)
            elif kind == "scene":
                self.ready.set()
            self._say(kind, text)

    def _end(self, status: str, error: dict[str, Any] | None) -> None:
        self.known.status, self.known.error, self.known.lever = status, error, None
        self.known.place = None
        self.ready.set()
        self.ended.set()
        for future in self.answers.values():
            if not future.done():
                future.set_result({"error": Refused("the run is over", 409, field="id", value=self.id)})
        said = {"status": status} | ({} if error is None else {"message": error["message"]})
        self._say("end", json.dumps(said).encode())
        self.over_now()

    def _say(self, kind: str, text: bytes) -> None:
        self.sent.append(b"id: %d\nevent: %s\ndata: %s\n\n" % (len(self.sent), kind.encode(), text))
        self.more.set()
        self.more = asyncio.Event()

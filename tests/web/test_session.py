"""Live runs that fail: each ends as failed, and its reason is sent to every viewer."""

import asyncio
import json
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.process import BaseProcess
from threading import Thread

import pytest

from metropilot.web.errors import Refused
from metropilot.web.live.session import DIED, Session, Spare
from metropilot.web.live.worker import Driving

ORDER = {"pace": 20.0, "journal": [], "step": 0}
LIMIT_S = 20.0
STEPS = 5


class FailingEngine:
    """An engine that departs and fails after some steps."""

    dt_s, over, position_m = 0.2, False, 0.0

    def __init__(self, error):
        self.error, self.steps = error, 0

    @property
    def time_s(self):
        return self.steps * self.dt_s

    def advance(self):
        self.steps += 1
        if self.steps > STEPS and self.error is not None:
            raise self.error
        return [self.time_s, self.steps]

    def scene(self):
        return {"scheduled_time_s": 100.0}

    def lever(self):
        return None

    def holds(self, event):
        return True

    def pop_updates(self):
        return []

    def lever_expired(self):
        return False


class Worker(BaseProcess):
    """A thread in the place of a run's process."""

    def __init__(self, pipe, engine):
        self.pipe, self.engine = pipe, engine
        self.thread = Thread(target=self.work, daemon=True)
        self.thread.start()

    def work(self):
        try:
            order = self.pipe.recv()
            if self.engine is None:
                return
            driving = Driving(self.pipe, order)
            driving._engine = lambda: self.engine
            driving.to_the_end()
        except (OSError, EOFError):
            return
        finally:
            self.pipe.close()

    def join(self, timeout=None):
        self.thread.join(timeout)

    def kill(self):
        """Close the pipe, as the end of a process does."""
        self.pipe.close()


def events_of(engine, kept):
    """Events and session of a live run of an engine; fails where the run does not end."""

    async def story():
        ours, theirs = Pipe()
        ended = []
        session = Session("live-1", {"pace": ORDER["pace"]}, ORDER, kept, lambda: ended.append(session.over))
        session.start(Spare(Worker(theirs, engine), ours))
        seen = []

        async def watch():
            async for chunk in session.listen():
                for event in chunk.decode().split("\n\n")[:-1]:
                    _, kind, data = (line.partition(": ")[2] for line in event.split("\n"))
                    seen.append((kind, json.loads(data)))

        await asyncio.wait_for(watch(), LIMIT_S)
        assert ended == [True], "the queue is told once, when the run is over"
        return seen, session

    return asyncio.run(story())


@pytest.mark.parametrize(
    "error", [TypeError("boom"), EOFError("boom"), BrokenPipeError("boom")], ids=lambda e: type(e).__name__
)
def test_an_internal_error_ends_the_run_and_reaches_its_viewers(error):
    kept = []
    seen, session = events_of(FailingEngine(error), lambda _, kind, known: kept.append((kind, known)))
    words = f"internal error: {type(error).__name__}: boom"
    assert seen[-1] == ("end", {"status": "failed", "message": words})
    assert ("error", words) in [(kind, data["error"]["message"]) for kind, data in seen if kind == "error"]
    kind, known = kept[-1]
    assert (kind, known["status"], known["error"]["message"]) == ("end", "failed", words)
    assert (session.over, session.known.error["message"]) == (True, words)
    with pytest.raises(Refused, match="boom"):
        raise session.failure()


def test_a_dead_process_ends_the_run():
    seen, _ = events_of(None, lambda *_: None)
    assert seen == [("end", {"status": "failed", "message": DIED})]


@pytest.mark.parametrize("broken", ["rows", "end"])
def test_a_store_that_fails_ends_the_run(broken):
    def keep(_, kind, known):
        if kind == broken:
            raise RuntimeError("disk full")

    seen, session = events_of(FailingEngine(None if broken == "rows" else TypeError("boom")), keep)
    words = "RuntimeError: disk full" if broken == "rows" else "TypeError: boom"
    assert seen[-1] == ("end", {"status": "failed", "message": f"internal error: {words}"})
    assert session.over


class Planner(BaseProcess):
    """A process that plans and listens to nobody."""

    def __init__(self, pipe):
        self.pipe = pipe

    def join(self, timeout=None):
        """Return at once: it has ended."""

    def kill(self):
        """Close the pipe, as the end of a process does; it may be closed already."""
        with suppress(OSError):
            self.pipe.close()


def test_a_run_that_plans_is_stopped_at_once():
    async def story():
        ours, theirs = Pipe()
        kept = []
        session = Session("live-1", {"pace": 1.0}, ORDER, lambda *told: kept.append(told[1:]), lambda: None)
        session.start(Spare(Planner(theirs), ours))
        await asyncio.sleep(0.05)
        assert await asyncio.wait_for(session.stop(), LIMIT_S) == 0.0
        return session.known, kept

    known, kept = asyncio.run(story())
    assert (known.status, known.error) == ("stopped", None)
    assert kept == [("end", {"status": "stopped", "error": None})]

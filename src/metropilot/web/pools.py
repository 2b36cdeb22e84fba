"""Worker processes: one for direct answers, some for drives, one for learning.

All are separate from the process of the event loop, and each is killed when it takes too long.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import CancelledError, Future
from concurrent.futures import TimeoutError as Late
from multiprocessing import get_context
from typing import Any

from pebble import ProcessExpired, ProcessPool

from metropilot.errors import MetropilotError
from metropilot.web.errors import Refused
from metropilot.web.settings import Settings
from metropilot.web.work.plans import begin

BUSY = 16
"""Direct answers that may wait for the one worker; more are refused (429)."""
BEHIND = 4
"""Niceness of jobs, so that direct answers and live runs get the processor first."""


def warm() -> None:
    """Import the modules of answers."""
    import metropilot.web.work.plans  # noqa: F401


class Pools:
    """The workers of a server.

    Args:
        settings: Bounds.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        bound, context = settings.worker_bytes, get_context("spawn")
        made: dict[str, Any] = {"initializer": begin, "context": context}
        self.answers = ProcessPool(1, initargs=[bound, 0], **made)
        self.jobs = ProcessPool(settings.parallel_jobs, initargs=[bound, BEHIND], **made)
        self.learning = ProcessPool(1, initargs=[None, BEHIND], max_tasks=1, **made)
        self.asking = 0

    def start(self) -> None:
        """Start the worker of answers before the first request."""
        self.answers.schedule(warm)

    async def answer(self, function: Callable[..., Any], *values: object) -> Any:  # noqa: ANN401
        """Call a function in a worker; return its result.

        Raises:
            MetropilotError: Any error of the function.
            Refused: It took too long or too much memory, or too many wait.
        """
        if self.asking >= BUSY:
            raise Refused("too many requests at once", 429)
        self.asking += 1
        try:
            future = self.answers.schedule(function, args=list(values), timeout=self.settings.answer_s)
            return await asyncio.wrap_future(future)
        except Exception as error:  # noqa: BLE001 (whatever a worker died of is an answer)
            raise explain(error, self.settings.answer_s) from None
        finally:
            self.asking -= 1

    def submit(self, function: Callable[..., Any], *values: object, long: bool) -> Future[Any]:
        """Queue a job; the future is cancelled to stop it.

        Args:
            function: What the worker computes.
            values: Its values.
            long: True if it takes hours: it waits for a worker of such jobs, without a bound on its memory.
        """
        if long:
            return self.learning.schedule(function, args=list(values), timeout=self.settings.learn_s)
        return self.jobs.schedule(function, args=list(values), timeout=self.settings.job_s)

    def stop(self) -> None:
        """End every worker."""
        for pool in (self.answers, self.jobs, self.learning):
            pool.stop()
            pool.join()


def explain(error: BaseException, bound_s: float) -> MetropilotError:
    """Turn a worker's exception into an error for the user."""
    if isinstance(error, MetropilotError):
        return error
    if isinstance(error, Late):
        return Refused(f"took longer than {bound_s:g} s; use a smaller request", 422)
    if isinstance(error, MemoryError):
        return Refused("needs too much memory; use a smaller request", 422)
    if isinstance(error, ProcessExpired):
        return Refused("the worker died, most likely of too little memory", 422)
    if isinstance(error, CancelledError):
        return Refused("stopped", 409)
    return Refused(f"internal error: {type(error).__name__}: {error}", 500)

"""Set-up of a worker process: one thread, bounded memory, lower priority than the server."""

from __future__ import annotations

import os
import signal
from multiprocessing import parent_process
from multiprocessing.connection import wait
from threading import Thread

from metropilot._processes import ONE_THREAD


def begin(worker_bytes: int | None, nice: int) -> None:
    """Set up this process; call it before anything numerical is imported.

    Args:
        worker_bytes: Bound on the address space; None leaves it (JAX maps far more than it uses).
        nice: Increment of the niceness over the server's.
    """
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_outlive_nobody, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(nice)
    if worker_bytes is not None:
        try:
            import resource
        except ImportError:
            return
        resource.setrlimit(resource.RLIMIT_AS, (worker_bytes, worker_bytes))


def _outlive_nobody() -> None:
    """End this process when the server ends, so that no worker outlives it."""
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)

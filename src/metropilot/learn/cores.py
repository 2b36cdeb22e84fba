"""A core of its own for each learning process.

XLA passes a compiled program to and fro between threads of one process, single-threaded though the work is.
On one core that is a switch; across cores each pass waits for the other thread to wake up.
"""

from __future__ import annotations

import os
from contextlib import suppress
from functools import cache
from pathlib import Path

from metropilot._dirs import cache_folder


@cache
def own_core() -> int | None:
    """Keep this process and its threads, for good, to one core that no other process of the user's has so.

    Returns:
        The core; None where it cannot be chosen (not Linux) or all are taken: nothing is changed then.
    """
    if not hasattr(os, "sched_setaffinity"):
        return None
    import fcntl

    folder = cache_folder() / "cores"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for core in sorted(os.sched_getaffinity(0)):
            held = os.open(folder / str(core), os.O_RDWR | os.O_CREAT)
            try:
                fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)  # until the process ends, however it ends
            except OSError:
                os.close(held)
                continue
            _keep_to(core)
            return core
    except OSError:
        return None
    return None


def _keep_to(core: int) -> None:
    """Every thread that runs already; later ones inherit it."""
    for thread in Path("/proc/self/task").iterdir():
        with suppress(ProcessLookupError):
            os.sched_setaffinity(int(thread.name), {core})

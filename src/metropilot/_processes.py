"""Worker processes: one thread and, for learning, one core each.

Small networks and single drives get slower on two threads. XLA also passes a compiled program to and fro
between threads of one process, single-threaded though the work is: on one core that is a switch, across cores
each pass waits for the other thread to wake up.

Imports nothing numerical: these variables are read when NumPy and JAX are first imported.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from metropilot._dirs import cache_folder

ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false",
}


@contextmanager
def environment(values: Mapping[str, str]) -> Iterator[None]:
    """Environment variables for the processes begun inside."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


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

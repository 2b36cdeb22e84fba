"""Whether somebody is at work on a folder: a lock on the folder itself, which ends with its process.

However the process ends (Ctrl-C, kill -9, a power cut), the lock is gone with it; nothing is left behind.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from metropilot.errors import InputError

TRIES = 20
PAUSE_S = 0.05
"""Somebody who only looks whether the lock is held, holds it for a moment."""


@contextmanager
def at_work(folder: Path) -> Iterator[None]:
    """Hold a folder's lock.

    Raises:
        InputError: Another process holds it.
    """
    for _ in range(TRIES):
        descriptor = _locked(folder)
        if descriptor is not None:
            break
        time.sleep(PAUSE_S)
    else:
        raise InputError("another process is learning in this folder", file=folder, field="resume")
    try:
        yield
    finally:
        if descriptor >= 0:
            os.close(descriptor)


def is_at_work(folder: Path) -> bool:
    """Whether a process holds a folder's lock; where folders cannot be locked, yes."""
    if os.name != "posix":
        return True
    try:
        descriptor = _locked(folder)
    except OSError:
        return False
    if descriptor is None or descriptor < 0:
        return True
    os.close(descriptor)
    return False


def _locked(folder: Path) -> int | None:
    """A descriptor that holds the lock; None where another does, -1 where there are no such locks."""
    if os.name != "posix":
        return -1
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return None
    except OSError:
        os.close(descriptor)
        return -1
    return descriptor

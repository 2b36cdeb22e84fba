"""Writing a file so that it is whole or not there, and never half of one."""

from __future__ import annotations

import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from metropilot.errors import InputError


def atomic_write(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file beside its place, force it to the disk, and move it there.

    Whatever happens meanwhile (Ctrl-C, kill -9, a power cut), ``path`` is the old file or the new one.

    Args:
        path: Where to; its folder is made.
        write: Writes the file it is given.

    Raises:
        InputError: The file cannot be written.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(partial)
        _sync(partial)
        partial.replace(path)
        if os.name == "posix":
            _sync(path.parent)
    except OSError as error:
        raise InputError("cannot write the file", file=path, value=error.strerror) from None
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    """Force what was written to the disk (a folder: its entries)."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

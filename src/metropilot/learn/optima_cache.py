"""Optimal energies of a task's cases, kept in the user's cache folder: solving them takes seconds."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from metropilot._dirs import cache_folder
from metropilot._io import atomic_write
from metropilot.env.optima import Optima, optima_of
from metropilot.errors import InputError
from metropilot.railway import Section, Trainset

VERSION = 1
"""Goes up when the planner's answers change."""
SHARES = (0.0, 0.04, 0.1, 0.18, 0.28, 0.4, 0.55, 0.75, 1.0)
LEAST_RATIO, BEYOND = 1.01, 1.08


def kept_optima(cases: Sequence[tuple[Section, Trainset]], reach: float) -> Optima:
    """The optimum over running time of every case, from the cache where it is there.

    Args:
        cases: Sections with trainsets.
        reach: Longest running time of interest over the minimum.
    """
    ratios = [LEAST_RATIO + (BEYOND * max(reach, LEAST_RATIO) - LEAST_RATIO) * share for share in SHARES]
    path = cache_folder() / "optima" / f"{_digest([VERSION, ratios, cases])}.npz"
    try:
        with np.load(path, allow_pickle=False) as found:
            return Optima(found["time_s"], found["energy_j"])
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        pass
    optima = optima_of(cases, ratios)

    def write(partial: Path) -> None:
        with partial.open("wb") as file:
            np.savez(file, time_s=optima.time_s, energy_j=optima.energy_j)

    with suppress(InputError):
        atomic_write(path, write)
    return optima


def _digest(value: Any) -> str:
    """A name for plain values, arrays and dataclasses of them."""
    digest = hashlib.sha256()
    _take(digest, value)
    return digest.hexdigest()[:24]


def _take(digest: Any, value: Any) -> None:
    if isinstance(value, np.ndarray):
        digest.update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
    elif is_dataclass(value):
        for field in fields(value):
            digest.update(field.name.encode())
            _take(digest, getattr(value, field.name))
    elif isinstance(value, dict):
        _take(digest, [part for item in value.items() for part in item])
    elif isinstance(value, list | tuple):
        digest.update(f"[{len(value)}".encode())
        for item in value:
            _take(digest, item)
    else:
        digest.update(f"{type(value).__name__}:{value!r};".encode())

"""Optimal energy over running time, tabulated for every case of a task and kept in the cache folder."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass

import numpy as np
from numpy import ndarray
from scipy.interpolate import PchipInterpolator

from metropilot._dirs import cache_folder
from metropilot._tensors import read_tensors, write_tensors
from metropilot._typing import Float, Int
from metropilot.errors import InputError
from metropilot.planning.optimal import minimum_running_time, time_energy_front
from metropilot.railway import Section, Trainset

VERSION = 1
"""Version of the cached tables; raise it when the planner's results change."""
MAX_BYTES = 1 << 24
"""Largest table read from the cache."""
SHARES = (0.0, 0.04, 0.1, 0.18, 0.28, 0.4, 0.55, 0.75, 1.0)
"""Running times of a cached table within their range, dense near the minimum, where energy curves most."""
LEAST_RATIO, BEYOND = 1.01, 1.08
"""Range over the minimum running time: the least ratio, and a factor on the longest time of interest."""
RATIOS = (1.01, 1.03, 1.06, 1.1, 1.15, 1.2, 1.3, 1.4, 1.6)


@dataclass(frozen=True)
class Optima:
    """Optimal traction energy at the wheel of every case.

    Attributes:
        time_s: Running times, increasing.
        energy_j: Optimal energy at each.
    """

    time_s: Float[ndarray, "cases points"]
    energy_j: Float[ndarray, "cases points"]

    def at(
        self, case: Int[ndarray, " drives"], time_s: Float[ndarray, " drives"]
    ) -> Float[ndarray, " drives"]:
        """Optimal energy of drives by case and running time, J; NaN outside the tabulated times.

        Args:
            case: Row of each drive.
            time_s: Running time of each drive.
        """
        found = np.full(np.shape(time_s), np.nan)
        for row in np.unique(case):
            mine = case == row
            curve = PchipInterpolator(self.time_s[row], self.energy_j[row], extrapolate=False)
            found[mine] = curve(np.asarray(time_s, float)[mine])
        return found


def optima_of(cases: Sequence[tuple[Section, Trainset]], ratios: Sequence[float] = RATIOS) -> Optima:
    """Solve every case at several running times (half a second a case).

    Args:
        cases: A task's ``config.cases``.
        ratios: Running times over the minimum of the case, increasing.
    """
    fronts = []
    for section, trainset in cases:
        minimum = minimum_running_time(section, trainset)
        fronts.append(time_energy_front(section, trainset, [minimum * ratio for ratio in ratios]))
    return Optima(
        time_s=np.stack([front.time_s for front in fronts]),
        energy_j=np.stack([np.minimum.accumulate(front.energy_j) for front in fronts]),
    )


def cached_optima(cases: Sequence[tuple[Section, Trainset]], reach: float) -> Optima:
    """Load the optima of cases from the cache folder, or solve them (seconds) and keep them there.

    Args:
        cases: Sections with trainsets.
        reach: Longest running time of interest over the minimum.
    """
    ratios = [LEAST_RATIO + (BEYOND * max(reach, LEAST_RATIO) - LEAST_RATIO) * share for share in SHARES]
    path = cache_folder() / "optima" / f"{_digest([VERSION, ratios, cases])}.safetensors"
    with suppress(InputError, KeyError):
        found, _ = read_tensors(path, MAX_BYTES)
        return Optima(found["time_s"], found["energy_j"])
    optima = optima_of(cases, ratios)
    with suppress(InputError):
        write_tensors(path, {"time_s": optima.time_s, "energy_j": optima.energy_j}, {})
    return optima


def _digest(value: object) -> str:
    """Hexadecimal digest of plain values, arrays and dataclasses of them."""
    digest = hashlib.sha256()
    _feed(digest.update, value)
    return digest.hexdigest()[:24]


def _feed(update: Callable[[bytes], object], value: object) -> None:
    if isinstance(value, np.ndarray):
        update(f"{value.dtype}{value.shape}".encode() + value.tobytes())
    elif is_dataclass(value):
        for field in fields(value):
            update(field.name.encode())
            _feed(update, getattr(value, field.name))
    elif isinstance(value, dict):
        _feed(update, [part for item in value.items() for part in item])
    elif isinstance(value, list | tuple):
        update(f"[{len(value)}".encode())
        for item in value:
            _feed(update, item)
    else:
        update(f"{type(value).__name__}:{value!r};".encode())

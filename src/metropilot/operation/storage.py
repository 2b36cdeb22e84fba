"""Energy in storages from second to second, and what of their power it allows."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.railway import Storage

BISECTIONS = 40


def stored_j(
    storage: Storage, power_w: Float[ndarray, " seconds"], begins_j: float
) -> Float[ndarray, " instants"]:
    """Energy before each second and after the last, of power at the terminals, positive charging.

    What is too much or too little for the storage is left out. Shape (T+1,).
    """
    gain = np.where(power_w > 0.0, power_w * storage.efficiency, power_w / storage.efficiency)
    energy, capacity_j = begins_j, storage.capacity_j
    found = [energy]
    for each in gain.tolist():
        energy = min(max(energy + each, 0.0), capacity_j)
        found.append(energy)
    return np.array(found)


def periodic_start_j(storage: Storage, power_w: Float[ndarray, " seconds"]) -> float:
    """Energy at the beginning of a period that is there again at its end."""
    low, high = 0.0, storage.capacity_j
    ends_j = [float(stored_j(storage, power_w, begins_j)[-1]) for begins_j in (low, high)]
    if ends_j[0] == ends_j[1]:
        # full or empty at some time, after which the beginning no longer counts
        return ends_j[0]
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        # the end rises with the beginning, but never by more
        ends_j = stored_j(storage, power_w, middle)[-1]
        low, high = (middle, high) if ends_j > middle else (low, middle)
    return 0.5 * (low + high)


def allowed_w(
    storage: Storage, before_j: Float[ndarray, " seconds"]
) -> tuple[Float[ndarray, " seconds"], Float[ndarray, " seconds"]]:
    """Most power of charging and of discharging in seconds that begin with an energy."""
    charging = np.clip((storage.capacity_j - before_j) / storage.efficiency, 0.0, storage.power_w)
    return charging, np.clip(before_j * storage.efficiency, 0.0, storage.power_w)

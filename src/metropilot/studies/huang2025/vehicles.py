"""The same efforts on six vehicles joined by couplers (Huang25 eq. 3), beside the one body that is driven."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from metropilot.physics import bodies_at, consist, multibody_step, substeps, track_arrays
from metropilot.sim import Drive
from metropilot.studies.huang2025.published import BEYOND
from metropilot.studies.report import ReportRow


class Apart(NamedTuple):
    """How far six vehicles are from one body under the same efforts.

    Attributes:
        speed_mps: Largest difference of the head's speed while it moves.
        place_m: Difference of the head's place when the one body stands.
        coupler_n: Largest force in a coupler while it moves.
    """

    speed_mps: float
    place_m: float
    coupler_n: float


def apart(found: Drive) -> Apart:
    """Give a drive's efforts to the vehicles, open loop."""
    t, trainset = found.trajectory, found.trainset
    cars, track = consist(trainset), track_arrays(found.section, trainset)
    effort = t.traction_n - t.electric_brake_n - t.friction_brake_n
    count, bodies = substeps(cars, found.run.dt), bodies_at(cars)
    speed, force = 0.0, 0.0
    for k, seconds in enumerate(t.duration_s[:-1]):
        if seconds <= 0.0 or (t.speed_mps[k] <= 0.0 and effort[k] <= 0.0):
            continue
        bodies = multibody_step(cars, track, bodies, effort[k], float(seconds), count)
        speed = max(speed, abs(float(bodies.speed_mps[0]) - float(t.speed_mps[k + 1])))
        if t.speed_mps[k + 1] > 0.0:
            force = max(force, float(np.abs(bodies.coupler_n).max()))
    return Apart(speed, float(bodies.position_m) - float(t.position_m[-1]), force)


def vehicle_rows(found: Drive, case: str) -> Iterator[ReportRow]:
    """The differences as rows."""
    one = apart(found)
    place = (f"{BEYOND}: the same efforts on six vehicles with couplers (eq. 3)", case, found.driver)
    yield ReportRow(*place, "largest difference of speed", "m/s").measured([one.speed_mps])
    yield ReportRow(*place, "difference of the place at the stop", "m").measured([abs(one.place_m)])
    yield ReportRow(*place, "largest coupler force", "kN").measured([one.coupler_n / 1e3])

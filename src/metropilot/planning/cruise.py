"""Cruise and brake: full traction to one speed, held until the braking for the stop."""

from __future__ import annotations

import numpy as np
from numpy import ndarray
from scipy.optimize import root_scalar

from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning.effort_table import specific
from metropilot.planning.fastest import check_running_time, fastest_profile, times
from metropilot.planning.mesh import build_mesh
from metropilot.planning.optimal import Plan, PlanOptions, evaluate_profile
from metropilot.railway import Section, Trainset

SPEED_TOLERANCE_MPS = 1e-9


def cruise_plan(
    section: Section, trainset: Trainset, time_s: float, options: PlanOptions | None = None
) -> Plan:
    """Drive with full traction, one cruising speed and full service braking within a running time.

    Where a limit is lower the limit is held; where traction does not hold the speed on a climb the trainset
    slows down. The plan has no bound.

    Args:
        section: Section.
        trainset: Trainset with its load.
        time_s: Running time.
        options: Objective and spacing; see :class:`PlanOptions`.

    Raises:
        Infeasible: The running time is below the minimum.
    """
    options = options or PlanOptions()
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    table = specific(vehicle)
    mesh = build_mesh(vehicle, track, np.array([0.0, section.length_m]), options.spacing_m)

    def drive(speed_mps: float) -> ndarray:
        return fastest_profile(table, mesh._replace(cap_mps=np.minimum(mesh.cap_mps, speed_mps)))

    def late_s(speed_mps: float) -> float:
        return float(times(mesh, drive(speed_mps)).sum()) - time_s

    low, high = section.length_m / time_s, float(mesh.cap_mps.max())
    early_s = -late_s(high)
    check_running_time(time_s, time_s - early_s)
    if early_s > 0:
        high = root_scalar(late_s, bracket=(low, high), method="brentq", xtol=SPEED_TOLERANCE_MPS).root
    return evaluate_profile(vehicle, table, mesh, drive(high), options)

"""Plans without optimization: full traction to one speed, which is held or coasted from, and full braking."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy import ndarray
from scipy.optimize import root_scalar

from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning.effort_table import Specific, specific
from metropilot.planning.fastest import check_running_time, fastest_profile, times
from metropilot.planning.mesh import Mesh, build_mesh
from metropilot.planning.optimal import Plan, PlanOptions, evaluate_profile, fastest_time
from metropilot.railway import Section, Trainset

TOLERANCE = 1e-9
FIRST_M = 1e-3
HELD_SHARE = 0.5
"""Share of the speed that it coasts from below which a coasting trainset is kept from falling."""


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
    fastest_mps = float(section.limit_mps.value.max())
    return _plan_by(_hold, section.length_m / time_s, fastest_mps, section, trainset, time_s, options)


def coast_plan(
    section: Section, trainset: Trainset, time_s: float, options: PlanOptions | None = None
) -> Plan:
    """Drive with full traction under the limits to one place, coast, and brake fully within a running time.

    Where a limit is lower the trainset brakes to it and coasts on. Downhill the brake holds the speed that it
    had there; below half of it traction does. The plan has no bound.

    Args:
        section: Section.
        trainset: Trainset with its load.
        time_s: Running time.
        options: Objective and spacing; see :class:`PlanOptions`.

    Raises:
        Infeasible: The running time is below the minimum.
    """
    return _plan_by(_coast, FIRST_M, section.length_m, section, trainset, time_s, options)


Rule = Callable[[Specific, Mesh, ndarray, float], ndarray]
"""Kinetic energy per kg by trainset, mesh, that of the flat-out run, and a number that shortens the time."""


def _plan_by(
    rule: Rule,
    low: float,
    high: float,
    section: Section,
    trainset: Trainset,
    time_s: float,
    options: PlanOptions | None,
) -> Plan:
    """Plan by a rule whose number between ``low`` and ``high`` gives the running time."""
    options = options or PlanOptions()
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    table = specific(vehicle)
    mesh = build_mesh(vehicle, track, np.array([0.0, section.length_m]), options.spacing_m)
    fastest = fastest_profile(table, mesh)

    def late_s(number: float) -> float:
        return float(times(mesh, rule(table, mesh, fastest, number)).sum()) - time_s

    fastest_s = least_s = float(times(mesh, fastest).sum())
    if time_s < fastest_s:
        # the minimum on this mesh is longer by a hair: the flat-out run is the drive then
        least_s = min(fastest_s, fastest_time(vehicle, track, options))
    check_running_time(time_s, least_s)
    energy = fastest
    if time_s > fastest_s:
        number = root_scalar(late_s, bracket=(low, high), method="brentq", xtol=TOLERANCE).root
        energy = rule(table, mesh, fastest, number)
    return evaluate_profile(vehicle, table, mesh, energy, options)


def _hold(table: Specific, mesh: Mesh, fastest: ndarray, speed_mps: float) -> ndarray:
    if speed_mps >= mesh.cap_mps.max():
        return fastest
    return fastest_profile(table, mesh._replace(cap_mps=np.minimum(mesh.cap_mps, speed_mps)))


def _coast(table: Specific, mesh: Mesh, fastest: ndarray, from_m: float) -> ndarray:
    first = min(int(np.searchsorted(mesh.node_m, from_m, side="right")), fastest.size - 1)
    # the rest of the segment on which coasting begins is coasted too
    share = (mesh.node_m[first] - from_m) / mesh.length_m[first - 1]
    top = fastest[first] + share * (fastest[first - 1] - fastest[first])
    energy, least, at = fastest.copy(), HELD_SHARE**2 * top, top
    constant, linear, quadratic = table.davis
    for k in range(first - 1, energy.size - 1):
        ahead = at
        for _ in range(2):
            middle = 0.5 * (at + ahead)
            square = (quadratic + mesh.tunnel_n[k] / table.mass_kg) * 2.0 * middle
            rate = constant + linear * np.sqrt(2.0 * middle) + square + mesh.slope_mps2[k]
            ahead = max(at - share * rate * mesh.length_m[k], least)
        at = energy[k + 1] = min(fastest[k + 1], ahead, top)
        share = 1.0
    return energy

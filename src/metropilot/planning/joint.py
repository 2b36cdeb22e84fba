"""The plan of a convoy as one: trainsets at constant distances, which have one speed at one time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from metropilot.errors import InputError
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning.effort_table import specific
from metropilot.planning.mesh import Coupled, mean_slopes_at, shift_track
from metropilot.planning.optimal import Plan, PlanOptions, fastest_time, optimal_plan
from metropilot.railway import Section, Trainset


def couple_trainsets(
    section: Section,
    trainsets: Sequence[Trainset],
    offsets_m: Sequence[float],
    *,
    limits_extended: bool = False,
) -> tuple[Coupled, ...]:
    """Trainsets coupled behind the head, as ``PlanOptions.coupled`` takes them.

    Args:
        section: Section.
        trainsets: Trainsets with their loads, the head first.
        offsets_m: Distance of the front of each from that of the head: 0 of the head itself, then increasing.
        limits_extended: True if the section's limits hold for the head until the last has cleared them: then
            those behind add only their design speeds.

    Raises:
        InputError: No trainset, or the distances do not fit.
    """
    if not trainsets or len(offsets_m) != len(trainsets) or offsets_m[0] != 0:
        allowed = f"0 for the head, then one for each of {max(len(trainsets) - 1, 0)} trainsets"
        raise InputError("distances do not fit the trainsets", field="offsets_m", allowed=allowed)
    if any(not behind > ahead for ahead, behind in pairwise(offsets_m)):
        raise InputError("each trainset is behind the one ahead", field="offsets_m", allowed="increasing")
    found: list[Coupled] = []
    for k, (trainset, offset_m) in enumerate(zip(trainsets, offsets_m, strict=True)):
        if k == 0:
            continue
        if trainset is trainsets[k - 1] and found:
            vehicle, table = found[-1].vehicle, found[-1].table
        else:
            vehicle = vehicle_arrays(trainset)
            table = specific(vehicle)
        track = track_arrays(section, trainset)
        if limits_extended:
            top = np.full_like(track.limit_mps, trainset.max_speed_mps)
            track = track._replace(
                limit_from_m=np.where(track.limit_from_m < np.inf, -np.inf, np.inf), limit_mps=top
            )
        found.append(Coupled(vehicle, table, shift_track(track, offset_m)))
    return tuple(found)


def coupled_acceleration(coupled: Sequence[Coupled], position_m: float, speed_mps: float) -> float:
    """Largest acceleration that every coupled trainset has at a position and a speed of the head, m/s^2."""
    least = np.inf
    for each in coupled:
        table, vehicle = each.table, each.vehicle
        gradient, curve, tunnel = mean_slopes_at(vehicle, each.track, np.array([position_m]))[0]
        slope = vehicle.mass_kg / vehicle.effective_mass_kg * (vehicle.gravity_mps2 * gradient + curve)
        a, b, c = table.davis
        drag = a + speed_mps * (b + speed_mps * (c + tunnel / table.mass_kg)) + slope
        traction = np.interp(speed_mps, table.speed_mps, table.traction)
        least = min(least, table.acceleration, float(traction - drag))
    return float(least)


def joint_plan(
    section: Section,
    trainsets: Sequence[Trainset],
    offsets_m: Sequence[float],
    time_s: float,
    options: PlanOptions | None = None,
) -> Plan:
    """The plan of least energy of a convoy whose trainsets keep their distances.

    Each trainset meets gradient, curves, tunnels and speed limits at its own place and has its own forces
    within its own limits. Positions, speeds and times of the plan are those of the head; energies, bound and
    price of a second are sums over all.

    Args:
        section: Section; the head stops at its end.
        trainsets: Trainsets with their loads, the head first.
        offsets_m: Distance of the front of each from that of the head: 0 of the head itself, then increasing.
        time_s: Running time.
        options: See :class:`PlanOptions`.

    Raises:
        Infeasible: The running time is below the minimum of the convoy, which the message names.
        InputError: No trainset, or the distances do not fit.
    """
    coupled = couple_trainsets(section, trainsets, offsets_m)
    return optimal_plan(section, trainsets[0], time_s, replace(options or PlanOptions(), coupled=coupled))


def joint_minimum_running_time(
    section: Section,
    trainsets: Sequence[Trainset],
    offsets_m: Sequence[float],
    *,
    limits_extended: bool = False,
) -> float:
    """Running time of the flat-out run of a convoy whose trainsets keep their distances, s.

    Args:
        section: Section.
        trainsets: Trainsets with their loads, the head first.
        offsets_m: As for :func:`joint_plan`.
        limits_extended: As for :func:`couple_trainsets`.

    Raises:
        InputError: No trainset, or the distances do not fit.
    """
    coupled = couple_trainsets(section, trainsets, offsets_m, limits_extended=limits_extended)
    options = PlanOptions(coupled=coupled)
    return fastest_time(vehicle_arrays(trainsets[0]), track_arrays(section, trainsets[0]), options)

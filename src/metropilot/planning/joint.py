"""The plan of a convoy as one: trainsets at constant distances, which have one speed at one time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from metropilot.errors import InputError
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning.effort_table import specific
from metropilot.planning.mesh import Coupled, shift_track
from metropilot.planning.optimal import Plan, PlanOptions, fastest_time, optimal_plan
from metropilot.railway import Section, Trainset


def couple_trainsets(
    section: Section, trainsets: Sequence[Trainset], offsets_m: Sequence[float]
) -> tuple[Coupled, ...]:
    """Trainsets coupled behind the head, as ``PlanOptions.coupled`` takes them.

    Args:
        section: Section.
        trainsets: Trainsets with their loads, the head first.
        offsets_m: Distance of the front of each from that of the head: 0 of the head itself, then increasing.

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
        found.append(Coupled(vehicle, table, shift_track(track_arrays(section, trainset), offset_m)))
    return tuple(found)


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
    section: Section, trainsets: Sequence[Trainset], offsets_m: Sequence[float]
) -> float:
    """Running time of the flat-out run of a convoy whose trainsets keep their distances, s.

    Args:
        section: Section.
        trainsets: Trainsets with their loads, the head first.
        offsets_m: As for :func:`joint_plan`.

    Raises:
        InputError: No trainset, or the distances do not fit.
    """
    options = PlanOptions(coupled=couple_trainsets(section, trainsets, offsets_m))
    return fastest_time(vehicle_arrays(trainsets[0]), track_arrays(section, trainsets[0]), options)

"""Plans of the trips of a timetable that know when the other trains of their zone draw and return.

A plan that counts on all that it returns being received brakes where nobody draws, too. When a timetable is
found, the power of all others is known at the moment at which a trip passes each place. So each trip in turn
gets the plan of least energy beside the others as they are, which passes places at other times: it is kept
where the zone, integrated exactly, takes less with it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.errors import SolverError
from metropilot.operation.headway import LongestDwells
from metropilot.operation.line_service import LineOperation, Profiles, Timetable
from metropilot.operation.power import SAME_S, PowerProfile, profile_of_plan
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import ReceivedEnergy, is_mapped

ROUNDS = 4
SETTLED = 3e-5
"""Share of the energy that a round has to save for another one to follow."""
SMOOTHED_S = 0.0, 4.0
"""The power of others is their mean over this longer before and after a place is passed: each is tried."""
EARLY_S = 0.05
"""A plan that arrives earlier by more than this leaves time unused, in which it would draw for itself."""


def adapt_plans(operation: LineOperation, timetable: Timetable, profiles: Profiles) -> Profiles:
    """Adapt the plan of each trip to the others of its zone, one after the other, while that saves energy.

    Args:
        operation: Line in operation. Where an efficiency depends on speed or effort, nothing is changed.
        timetable: Timetable, which stays as it is.
        profiles: Its trips.

    Returns:
        Profiles at the running times of the timetable, with which no train disturbs the next one.
    """
    vehicle = vehicle_arrays(operation.silent)
    driven = [{int(s): of[int(s)]} for of, s in zip(profiles, timetable.running_time_s, strict=True)]
    if is_mapped(vehicle):
        return driven
    energies = [
        ReceivedEnergy(vehicle, track_arrays(trip.section, operation.silent), float(s))
        for trip, s in zip(operation.trips, timetable.running_time_s, strict=True)
    ]
    zones_j = [each.positive_j for each in operation.zone_power(timetable, driven)]
    for _ in range(ROUNDS):
        before_j = sum(zones_j)
        for k, (trip, energy) in enumerate(zip(operation.trips, energies, strict=True)):
            for smoothed_s in SMOOTHED_S:
                found = _plan_beside(operation, timetable, driven, k, energy, smoothed_s)
                if found is None:
                    continue
                tried = [*driven[:k], found, *driven[k + 1 :]]
                zone_j = operation.power_in(trip.zone, timetable, tried).positive_j
                if zone_j < zones_j[trip.zone] and _keeps_headway(operation, timetable, tried, k):
                    driven, zones_j[trip.zone] = tried, zone_j
        if before_j - sum(zones_j) < SETTLED * before_j:
            break
    return driven


def _plan_beside(
    operation: LineOperation,
    timetable: Timetable,
    driven: list[dict[int, PowerProfile]],
    trip: int,
    energy: ReceivedEnergy,
    smoothed_s: float,
) -> dict[int, PowerProfile] | None:
    """Plan of a trip beside the others as they are; None if there is none that uses its time."""
    ((time_s, now),) = driven[trip].items()
    nodes_m = energy.programme.mesh.node_m
    passed_s = np.interp(nodes_m, now.position_m, now.time_s)
    others_w = _others_w(operation, timetable, driven, trip, passed_s, smoothed_s)
    try:
        plan = energy.plan_beside(others_w, np.interp(nodes_m, now.position_m, now.speed_mps))
    except SolverError:
        return None
    found = profile_of_plan(plan, operation.silent)
    return {time_s: found} if abs(found.running_time_s - time_s) < EARLY_S else None


def _others_w(
    operation: LineOperation,
    timetable: Timetable,
    driven: Sequence[dict[int, PowerProfile]],
    trip: int,
    passed_s: Float[ndarray, " nodes"],
    smoothed_s: float,
) -> Float[ndarray, " segments"]:
    """Mean power of the others in the zone while a trip passes each segment, and its own auxiliaries."""
    ((time_s, now),) = driven[trip].items()
    whole = operation.power_in(operation.trips[trip].zone, timetable, driven)
    own_w, loss = operation.trainset.auxiliary_w, operation.options.transfer_loss
    stays_s = time_s + operation.dwells_s(timetable)[trip]
    first_s, last_s = passed_s[:-1] - smoothed_s, passed_s[1:] + smoothed_s

    def others_j(at_s: ndarray) -> ndarray:
        # the next trains of its own trip are others
        own_j = now.net_until_j(loss, at_s) + own_w * np.clip(at_s, 0.0, stays_s)
        return whole.until_j(at_s + timetable.departure_s[trip]) - own_j

    return own_w + (others_j(last_s) - others_j(first_s)) / np.maximum(last_s - first_s, SAME_S)


def _keeps_headway(operation: LineOperation, timetable: Timetable, driven: Profiles, trip: int) -> bool:
    """True if the next train is not disturbed by a trip, and by the one before it."""
    longest, dwell_s = LongestDwells(operation, [driven]), operation.dwells_s(timetable)
    return all(
        dwell_s[k] <= longest(k, int(timetable.running_time_s[k]), 0) for k in (trip - 1, trip) if k >= 0
    )

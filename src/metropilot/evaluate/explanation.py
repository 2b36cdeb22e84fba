"""Reasons of a drive over distance: regimes, what bound each moment, interventions, loss by regime."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Bool, Float, Shaped
from metropilot.evaluate.attribution import FeatureMoment, attribute_decisions
from metropilot.evaluate.optimum import Optimum
from metropilot.evaluate.time_prices import TimePrice, time_prices
from metropilot.physics import electric_available_n, traction_available_n, vehicle_arrays
from metropilot.planning import Objective, Plan
from metropilot.protection import LEVELS
from metropilot.sim import BRAKE, STANDSTILL, AbstractDriver, Drive, Outcome, Trajectory

NEAR_MPS = 0.5
"""Distance from the permitted speed within which it counts as binding: drivers keep some 0.2 m/s below it."""
FULL = 0.98
"""Share of the effort available, of the jerk limit or of the acceleration limit that counts as all of it."""
FLAT_MPS = 0.05
"""Change of the permitted speed that counts as none."""
GRID_M = 5.0
"""Distance between the positions of the loss."""
MOMENTS = 20
"""Moments of a drive that have a price of time and a learned driver's features."""
PROTECTION, LIMIT, PERMITTED = "protection", "speed limit", "permitted speed"
EFFORT, COMFORT, STOP, TIME = "effort", "comfort", "stop", "time"
BOUNDS = (PROTECTION, LIMIT, PERMITTED, EFFORT, COMFORT, STOP, TIME)
"""What can bind a moment of a drive, the first that holds. ``stop``: the last braking. ``time``: nothing
else, so that the driver chose the command for the scheduled time and the energy."""


class RegimeSpan(NamedTuple):
    """A part of a drive in one regime.

    Attributes:
        regime: ``power``, ``cruise``, ``coast``, ``brake`` or ``stand``.
        from_m: Its begin.
        to_m: Its end.
        from_s: Time since departure at its begin.
        to_s: At its end.
        bound: What bound most of its time, one of ``BOUNDS``.
        energy_wheel_j: Traction energy at the wheel in it.
        trainset_loss_j: Loss there to jerk limit, dead time, lag and protection; None where it is not known.
        driver_loss_j: Loss there to the driver; None likewise.
    """

    regime: str
    from_m: float
    to_m: float
    from_s: float
    to_s: float
    bound: str
    energy_wheel_j: float
    trainset_loss_j: float | None
    driver_loss_j: float | None


class BoundSpan(NamedTuple):
    """A part of a drive that one thing bound.

    Attributes:
        bound: One of ``BOUNDS``.
        from_m: Its begin.
        to_m: Its end.
        from_s: Time since departure at its begin.
        to_s: At its end.
    """

    bound: str
    from_m: float
    to_m: float
    from_s: float
    to_s: float


class InterventionSpan(NamedTuple):
    """An intervention of protection.

    Attributes:
        guard: The strongest that acted: a name of :data:`metropilot.protection.LEVELS`, or ``not a command``
            where the driver's command was not a finite number.
        from_m: Where it began.
        to_m: Where it ended.
        from_s: Time since departure at its begin.
        to_s: At its end.
        speed_mps: Speed at its begin.
        permitted_mps: Permitted speed there.
        ahead_m: Position up to which the permitted speed falls from there: of the limit, restriction or stop
            that protection watched.
    """

    guard: str
    from_m: float
    to_m: float
    from_s: float
    to_s: float
    speed_mps: float
    permitted_mps: float
    ahead_m: float


@dataclass(frozen=True, eq=False)
class Explanation:
    """Reasons of a drive.

    The loss at a position is what was dissipated up to there beyond the plan: traction energy at the wheel
    less kinetic energy, of the drive less that of the attainable plan (driver), of that less the ideal one
    (trainset). At the stop their sum is the energy above the optimum.

    Attributes:
        regimes: Regimes in the order of the drive.
        bounds: What bound it, in the same order.
        interventions: Interventions of protection.
        position_m: Positions of the losses; empty where the drive did not arrive or has no attainable plan.
        trainset_loss_j: Loss so far to jerk limit, dead time, lag and protection.
        driver_loss_j: Loss so far to the driver.
        prices: Worth of a second at moments of the drive.
        decisions: Decisions of a learned driver at these moments, by the features that they rest on.
    """

    regimes: tuple[RegimeSpan, ...]
    bounds: tuple[BoundSpan, ...]
    interventions: tuple[InterventionSpan, ...]
    position_m: Float[ndarray, " points"]
    trainset_loss_j: Float[ndarray, " points"]
    driver_loss_j: Float[ndarray, " points"]
    prices: tuple[TimePrice, ...] = ()
    decisions: tuple[FeatureMoment, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, words and None, ready for JSON."""
        found = asdict(self)
        for name in ("regimes", "bounds", "interventions", "prices", "decisions"):
            found[name] = [span._asdict() for span in getattr(self, name)]
        for each in found["decisions"]:
            each["shares"] = [share._asdict() for share in each["shares"]]
        for name in ("position_m", "trainset_loss_j", "driver_loss_j"):
            found[name] = getattr(self, name).round(3).tolist()
        return found


def explain_drive(
    drive: Drive,
    optimum: Optimum | None,
    *,
    driver: AbstractDriver | None = None,
    objective: Objective = "wheel",
    moments: int = MOMENTS,
) -> Explanation:
    """Explain a drive.

    Args:
        drive: The drive.
        optimum: Result of :func:`metropilot.evaluate.optimum_of`; None: no loss and no price is given.
        driver: The driver that drove, made anew; a learned one's decisions are attributed to its features.
        objective: Energy that the price of a second is in.
        moments: Number of moments with a price, evenly spaced in time; 0: none.
    """
    t, bound = drive.trajectory, binding(drive)
    at_m, trainset_j, driver_j = _losses(drive, optimum)

    def loss(values: Float[ndarray, " points"], from_m: float, to_m: float) -> float | None:
        return (
            None if at_m.size == 0 else float(np.interp(to_m, at_m, values) - np.interp(from_m, at_m, values))
        )

    regimes = []
    for first, last in _spans(t.phase):
        place = _place(t, first, last)
        times = t.duration_s[first:last]
        words, which = np.unique(bound[first:last], return_inverse=True)
        regimes.append(
            RegimeSpan(
                str(t.phase[first]),
                *place,
                str(words[np.bincount(which, weights=times).argmax()]),
                float(t.energy_wheel_j[last] - t.energy_wheel_j[first]),
                loss(trainset_j, *place[:2]),
                loss(driver_j, *place[:2]),
            )
        )
    bounds = tuple(BoundSpan(str(bound[first]), *_place(t, first, last)) for first, last in _spans(bound))
    times_s = np.linspace(0.0, float(t.time_s[-1]), moments, endpoint=False)
    return Explanation(
        tuple(regimes),
        bounds,
        tuple(_interventions(drive)),
        at_m,
        trainset_j,
        driver_j,
        () if optimum is None else time_prices(drive, times_s, objective),
        () if driver is None else attribute_decisions(drive, driver, times_s),
    )


def binding(drive: Drive) -> Shaped[ndarray, " rows"]:
    """Binding reason of each row of a drive: one of ``BOUNDS``, the first that holds.

    Args:
        drive: The drive.
    """
    t, vehicle = drive.trajectory, vehicle_arrays(drive.trainset)
    overruled = np.append(drive.overruled, False)[: len(t)]
    near = t.speed_mps >= t.permitted_mps - NEAR_MPS
    curve = t.permitted_mps < t.limit_mps - NEAR_MPS
    available_n = np.array([traction_available_n(vehicle, v) for v in t.speed_mps.tolist()])
    electric_n = np.array([electric_available_n(vehicle, v) for v in t.speed_mps.tolist()])
    full = (t.traction_n > 0) & (t.traction_n >= FULL * available_n)
    full |= (t.electric_brake_n > 0) & (t.electric_brake_n >= FULL * electric_n)
    limits, rate = drive.trainset, t.acceleration_mps2
    jerky = np.abs(t.jerk_mps3) >= FULL * limits.actuation.jerk_limit_mps3
    jerky |= rate >= FULL * limits.max_acceleration_mps2
    jerky |= -rate >= FULL * min(limits.service_deceleration_mps2, limits.max_deceleration_mps2)
    braking = np.isin(t.phase, (BRAKE, STANDSTILL))
    stopping = np.flip(np.logical_and.accumulate(np.flip(braking))) & (t.position_m > t.position_m[0])
    conditions = [overruled, near & ~curve, near & curve, full, jerky, stopping]
    return np.select(conditions, list(BOUNDS[:-1]), default=TIME)


def _spans(labels: Shaped[ndarray, " rows"]) -> Iterator[tuple[int, int]]:
    """First row of each run of equal labels and the first after it; the last row only ends the last run."""
    steps = labels[:-1]
    edges = [0, *(np.flatnonzero(steps[1:] != steps[:-1]) + 1).tolist(), steps.size]
    yield from pairwise(edges)


def _place(t: Trajectory, first: int, last: int) -> tuple[float, float, float, float]:
    return tuple(float(values[k]) for values in (t.position_m, t.time_s) for k in (first, last))  # pyright: ignore[reportReturnType]


def _interventions(drive: Drive) -> Iterator[InterventionSpan]:
    t, overruled = drive.trajectory, drive.overruled
    levels = drive.levels if drive.levels.size else np.zeros(overruled.size, np.int64)
    padded: Bool[ndarray, " steps"] = np.append(overruled, False)
    for first, last in _spans(np.append(padded, False)):
        if not padded[first]:
            continue
        level, end = int(levels[first:last].max()), min(last, len(t) - 1)
        rising = np.flatnonzero(np.diff(t.permitted_mps[first:]) > FLAT_MPS)
        falling = t.permitted_mps[first : first + int(rising[0] if rising.size else len(t) - 1 - first) + 1]
        ahead = first + int(np.flatnonzero(falling <= falling.min() + FLAT_MPS)[0])
        yield InterventionSpan(
            LEVELS[level] if level else "not a command" if drive.levels.size else PROTECTION,
            *_place(t, first, end),
            float(t.speed_mps[first]),
            float(t.permitted_mps[first]),
            float(t.position_m[ahead]),
        )


def _losses(
    drive: Drive, optimum: Optimum | None
) -> tuple[Float[ndarray, " points"], Float[ndarray, " points"], Float[ndarray, " points"]]:
    nothing = np.zeros(0)
    if optimum is None or optimum.attainable is None or drive.outcome is not Outcome.ARRIVED:
        return nothing, nothing, nothing
    t, mass_kg = drive.trajectory, drive.trainset.effective_mass_kg
    end_m = drive.section.length_m
    at_m = np.linspace(0.0, end_m, max(int(np.ceil(end_m / GRID_M)), 1) + 1)

    def find_loss(
        position_m: Float[ndarray, " n"], energy_j: Float[ndarray, " n"], speed_mps: Float[ndarray, " n"]
    ) -> Float[ndarray, " points"]:
        return np.interp(at_m, position_m, energy_j - 0.5 * mass_kg * speed_mps**2)

    ideal, attainable = (
        find_loss(plan.position_m, traction_work_j(plan), plan.speed_mps)
        for plan in (optimum.plan, optimum.attainable.plan)
    )
    driven = find_loss(t.position_m, t.energy_wheel_j, t.speed_mps)
    return at_m, attainable - ideal, driven - attainable


def traction_work_j(plan: Plan) -> Float[ndarray, " nodes"]:
    """Traction energy at the wheel used so far, at each node of a plan."""
    return np.concatenate([[0.0], np.cumsum(plan.traction_n * np.diff(plan.position_m))])

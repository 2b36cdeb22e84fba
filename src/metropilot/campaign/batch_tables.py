"""Look-up tables of the runs of a batch, and energy curves of their plants, kept by a worker.

Tables are padded to a few sizes so that one program serves many batches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from metropilot.env import PROTECTION_CURVES, PolicyInterface, SectionTables, build_tables
from metropilot.evaluate import (
    OPTIMUM_SPACING_M,
    OPTIMUM_TOLERANCE,
    DrivingLimits,
    Optimum,
    attainable_of,
)
from metropilot.physics import Track, delay_steps, padded_size, stack, track_arrays, vehicle_arrays
from metropilot.planning import (
    Attainable,
    Objective,
    Plan,
    PlanOptions,
    minimum_running_time,
    optimal_plan,
)
from metropilot.protection import Bounds, protect
from metropilot.railway import Restriction, Section, Trainset, load_trainset
from metropilot.sim import Run, declared_bounds

CASES = (8, 32, 128, 512)
GUARD_NODES = (4096, 8192, 16384, 32768, 65536, 131072)
SEEN_NODES = (1024, 4096, 16384, 65536)
TRACK_NODES = (64, 256, 1024)
SPEEDS = (64, 128, 256, 512)
"""Sizes that tables are padded to: each combination of them is compiled once; padding is never read."""
KEPT = 128
"""Tables a worker keeps; a section's take about 0.1 MB."""


class Place(NamedTuple):
    """Section, trainset and bounds of a table; runs with the same place share it.

    Attributes:
        section: Line, origin, destination, and restrictions in force.
        trainset: Trainset, load, and whether its actuation is ideal.
        bounds: Deviations from the nominal plant that protection allows for.
    """

    section: tuple[str, str, str, tuple[Restriction, ...]]
    trainset: tuple[str, str | None, bool]
    bounds: Bounds


Made = TypeVar("Made")


class RecentCache(Generic[Made]):
    """Cache of the latest results of a worker.

    Args:
        most: Number of results kept; the oldest is dropped.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self.known: dict[Hashable, Made] = {}

    def get(self, key: Hashable, make: Callable[[], Made]) -> Made:
        """The result of a key, made on first use."""
        if key not in self.known:
            while len(self.known) >= self.most:
                del self.known[next(iter(self.known))]
            self.known[key] = make()
        return self.known[key]


def guard_tables(section: Section, run: Run) -> SectionTables:
    """Protection of a section on the grid of the host loop, and its track; no leading axis."""
    nominal = run.disturbance.nominal(run.trainset)
    guard = protect(section, nominal, declared_bounds(run))
    curves = [getattr(guard, name) for name in PROTECTION_CURVES]
    none = np.float64(0.0)
    return SectionTables(
        vehicle=vehicle_arrays(nominal),
        track=_track(section, nominal),
        protection=guard._replace(**dict.fromkeys(PROTECTION_CURVES, none)),
        node_curves=np.stack([*curves, np.zeros_like(curves[0])], axis=1),
        to_go=np.zeros((2, 2)),
        minimum_s=none,
        length_m=np.float64(section.length_m),
        load=none,
        stop_mps2=none,
        braking_curves=np.zeros((1, 2)),
    )


def feature_tables(interface: PolicyInterface, section: Section, run: Run) -> SectionTables:
    """Tables of a policy, as the driver makes them in the host loop; no leading axis."""
    import jax

    nominal = run.disturbance.nominal(run.trainset)
    case = (section, nominal, declared_bounds(run))
    tables: SectionTables = jax.tree.map(
        lambda a: a[0],
        build_tables([case], interface.spacing_m, np.float64, fading=interface.action.fading),
    )
    guard = tables.protection._replace(ahead=np.zeros(1, np.int32), slots=np.zeros(1))
    load = np.float64(nominal.mass_kg / interface.mean_mass_kg)
    return tables._replace(load=load, protection=guard, track=_track(section, nominal))


def _track(section: Section, trainset: Trainset) -> Track:
    """The track under the trainset, padded to one of ``TRACK_NODES``."""
    track = track_arrays(section, trainset)
    return track_arrays(section, trainset, size=padded_size(track.node_m.size, TRACK_NODES))


@lru_cache(maxsize=8)
def table_cache(interface: PolicyInterface | None) -> RecentCache[SectionTables]:  # noqa: ARG001 (its key)
    """This worker's cache of the tables of a policy interface, or (None) of protection."""
    return RecentCache(KEPT)


def stack_tables(tables: Sequence[SectionTables], nodes: Sequence[int], slots: int) -> SectionTables:
    """Stack tables along a leading axis, padded so that every shape is one of a few.

    Args:
        tables: Tables without a leading axis.
        nodes: Sizes that the number of position nodes may have.
        slots: Largest number of commands in the dead time of any run.
    """
    import jax

    rows = [*tables, *[tables[0]] * (padded_size(len(tables), CASES) - len(tables))]
    size = padded_size(max(t.node_curves.shape[0] for t in tables) + 4, nodes)
    columns = padded_size(max(t.to_go.shape[1] for t in tables), SPEEDS)
    ahead = np.arange(max(t.protection.ahead.size for t in tables), dtype=np.int32)
    count = len(rows)
    guards = [t.protection._replace(vehicle=(), ahead=np.int32(0), slots=0.0) for t in rows]
    guard = jax.tree.map(lambda *values: np.stack([np.asarray(v) for v in values]), *guards)
    return SectionTables(
        vehicle=stack([t.vehicle for t in rows]),
        track=stack([t.track for t in rows]),
        protection=guard._replace(
            vehicle=stack([t.protection.vehicle for t in rows]),
            ahead=np.repeat(ahead[None], count, axis=0),
            slots=np.zeros((count, slots)),
        ),
        node_curves=np.stack([_pad_curves(t.node_curves, size) for t in rows]),
        to_go=np.stack([np.pad(t.to_go, ((0, 0), (0, columns - t.to_go.shape[1])), "edge") for t in rows]),
        braking_curves=np.stack([_pad_curves(t.braking_curves, size) for t in rows]),
        **{
            name: np.array([getattr(t, name) for t in rows])
            for name in ("minimum_s", "length_m", "load", "stop_mps2")
        },
    )


def _pad_curves(curves: np.ndarray, size: int) -> np.ndarray:
    """Pad curves to a size; the tables of protection have one row in place of the braking curves."""
    return np.pad(curves, ((0, size - len(curves) if len(curves) > 1 else 0), (0, 0)), "edge")


def most_slots(trainsets: Sequence[tuple[str, str]], dt: float) -> int:
    """The largest number of commands in the dead time of any run of a campaign."""
    delays = [load_trainset(name, load).actuation.delay_s for name, load in trainsets]
    return delay_steps(max(delays), dt) + 1


STEP = 0.02
"""Distance between two knots, as a share of the minimum running time."""


class EnergyCurve:
    """Least energy of one trainset on one section, over running time, ideal and attainable.

    Args:
        section: The section with every restriction of the run.
        trainset: True plant.
        objective: Energy minimised.
        limits: Permitted speed and control period.

    Raises:
        Infeasible: The trainset cannot cover the section.
    """

    def __init__(
        self, section: Section, trainset: Trainset, objective: Objective, limits: DrivingLimits
    ) -> None:
        self.section, self.trainset, self.limits = section, trainset, limits
        self.options = PlanOptions(objective=objective, spacing_m=OPTIMUM_SPACING_M)
        self.fastest_s = minimum_running_time(section, trainset)
        self.knots: dict[int, Optimum] = {}

    def at(self, time_s: float) -> Optimum:
        """The optimum for a running time; within one step of the minimum it is solved directly.

        Raises:
            Infeasible: There is no plan.
        """
        time_s = max(time_s, self.fastest_s * (1.0 + OPTIMUM_TOLERANCE))
        share = (time_s / self.fastest_s - 1.0) / STEP
        k = math.floor(share)
        if k < 1:
            return self._solve(time_s)
        low, high = self._knot(k), self._knot(k + 1)
        if low.attainable is None or high.attainable is None:
            return self._solve(time_s)
        step_s = self.fastest_s * STEP
        attainable = _between(share - k, step_s, low.attainable.plan, high.attainable.plan)
        bound = _bound_between(attainable.energy_j, low.attainable, high.attainable)
        return Optimum(
            plan=replace(_between(share - k, step_s, low.plan, high.plan), running_time_s=time_s),
            minimum_time_s=self.fastest_s,
            attainable=low.attainable._replace(plan=attainable, bound_j=bound),
        )

    def _knot(self, k: int) -> Optimum:
        if k not in self.knots:
            self.knots[k] = self._solve(self.fastest_s * (1.0 + STEP * k))
        return self.knots[k]

    def _solve(self, time_s: float) -> Optimum:
        plan = optimal_plan(self.section, self.trainset, time_s, self.options)
        found = attainable_of(self.section, self.trainset, time_s, self.limits, plan, self.options.objective)
        return Optimum(plan, self.fastest_s, found)


def _between(share: float, step_s: float, low: Plan, high: Plan) -> Plan:
    """The lower of two plans with energy and bound of the running time between them.

    Cubic Hermite interpolation of their energies and marginal energies.

    Args:
        share: Share of the way to the other plan.
        step_s: Running time between the two.
        low: Plan with the shorter running time.
        high: Plan with the longer one.
    """
    a, b = low.energy_j, high.energy_j
    da, db = -low.second_w * step_s, -high.second_w * step_s
    t = share
    ends = a * (1.0 + 2.0 * t) * (1.0 - t) ** 2 + b * t * t * (3.0 - 2.0 * t)
    energy = ends + da * t * (1.0 - t) ** 2 - db * t * t * (1.0 - t)
    return replace(low, energy_j=energy, bound_j=_bound_between(energy, low, high))


def _bound_between(energy_j: float, *ends: Plan | Attainable) -> float:
    """Bound of an energy between two, as far below it as the farther of theirs; any of them may be zero."""
    if min(each.energy_j for each in ends) > 0.0:
        return energy_j * min(each.bound_j / each.energy_j for each in ends)
    return energy_j - max(each.energy_j - each.bound_j for each in ends)

"""Demonstrations of the optimal plan, for states on its way and beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy import ndarray
from numpy.random import Generator

from metropilot import env
from metropilot._tensors import read_tensors, write_tensors
from metropilot._typing import Float, Int
from metropilot.errors import InputError, MetropilotError
from metropilot.physics import effort_at
from metropilot.planning import Plan, PlanOptions, plan_arrays
from metropilot.sim import Run, declared_bounds

FEATURE_NAMES = env.OBSERVERS[env.DOMAIN_OBSERVER]
SPACING_M = 4.0
WINDOW_M = 10.0
LATE_W = 500.0
BELOW_PERMITTED_MPS = 0.06
ALMOST, FULL = 0.9, 0.98
"""Between these shares of the largest effort at hand the command goes over to 1."""
TIME_RATIO = (1.03, 1.6)
SPREAD_MPS, SPREAD_SHARE, SPREAD_S = 1.8, 0.045, 1.5
"""Scatter of states about the plan: speed, time left as a share, and time left besides."""
SLOWEST_MPS = 0.3
SAFE_SHARE = 0.97
"""Share of the station-stop deceleration from which a disturbed state may still have to stop."""


class Demonstrations(NamedTuple):
    """Demonstrations of the optimal plan on one or more sampled lines.

    Attributes:
        observations: States as the policy sees them. Shape (N, O), float32.
        commands: Commands of the optimal plan there. Shape (N,), float32.
        begins: From where to drive in closed loop, and what the plan makes of it: position, speed, time,
            scheduled time, arrival, energy and price of the last second, per kilogram. Shape (K, 7).
    """

    observations: Float[ndarray, "states features"]
    commands: Float[ndarray, " states"]
    begins: Float[ndarray, "begins 7"]


class DemonstrationGenerator:
    """Observations and optimal plans on one random section.

    Args:
        sample: Section and trainset.
        scheduled_ratio: Scheduled time over the minimum.
    """

    def __init__(self, sample: env.DomainSample, scheduled_ratio: float) -> None:
        run = Run(sample.section, sample.trainset, scheduled_time_s=1.0)
        tables = env.build_tables(
            [(sample.section, sample.trainset, declared_bounds(run))], SPACING_M, np.float64
        )
        self.rows = env.SectionRows(tables, jax=False)
        self.case = self.rows.case(0)
        self.length_m = float(self.case.length_m)
        self.scheduled_s = scheduled_ratio * float(self.case.minimum_s)
        self._at = np.arange(0.0, self.length_m + SPACING_M, SPACING_M)
        cap = self.rows.curve_at(env.PERMITTED_COLUMN, 0, self._at) - BELOW_PERMITTED_MPS
        self._cap = np.maximum(cap, 0.5)

    def most_mps(self, position_m: float) -> float:
        """Largest permitted speed at a position from which the station-stop braking still stops."""
        permitted = float(self.rows.curve_at(env.PERMITTED_COLUMN, 0, np.array(position_m)))
        work, _ = self.rows.stop_at(0, np.array(position_m))
        stops = float(np.sqrt(2.0 * SAFE_SHARE * env.DOMAIN_ASSISTS.stop_use * max(float(work), 0.0)))
        return max(min(permitted - BELOW_PERMITTED_MPS - 0.05, stops), SLOWEST_MPS)

    def plan(self, left_s: float, start_m: float = 0.0, start_mps: float = 0.0) -> Plan:
        """The optimal plan from a state, below what protection permits; late if it must.

        Raises:
            MetropilotError: No plan from there.
        """
        jerk = float(self.case.vehicle.jerk_mps3)
        options = PlanOptions(
            start_m=start_m,
            start_mps=start_mps,
            jerk_mps3=jerk if np.isfinite(jerk) else None,
            late_w=LATE_W,
            cap_m=self._at,
            cap_mps=self._cap,
            deceleration_mps2=env.DOMAIN_ASSISTS.stop_use * float(self.case.vehicle.max_deceleration_mps2),
        )
        return plan_arrays(self.case.vehicle, self.case.track, left_s, options)

    def observe(
        self,
        time_s: Float[ndarray, " states"],
        position_m: Float[ndarray, " states"],
        speed_mps: Float[ndarray, " states"],
    ) -> Float[ndarray, "states features"]:
        """Features of the policy in these states, single precision."""
        context = self._context(time_s, position_m, speed_mps)
        values = [
            np.broadcast_to(v, position_m.shape)
            for name in FEATURE_NAMES
            for v in env.FEATURES.get(name)(context)
        ]
        return np.stack(values, axis=1).astype(np.float32)

    def column_names(self) -> list[str]:
        """Feature that each number of an observation belongs to."""
        start = np.zeros(1)
        context = self._context(start, start, start)
        return [name for name in FEATURE_NAMES for _ in env.FEATURES.get(name)(context)]

    def _context(
        self,
        time_s: Float[ndarray, " states"],
        position_m: Float[ndarray, " states"],
        speed_mps: Float[ndarray, " states"],
    ) -> env.FeatureContext:
        case, nothing = self.case, np.zeros_like(position_m)
        return env.FeatureContext(
            rows=self.rows,
            case=0,
            vehicle=case.vehicle,
            track=case.track,
            length_m=case.length_m,
            load=case.load,
            stop_mps2=env.DOMAIN_ASSISTS.planned_mps2(self.rows, 0, case.stop_mps2, position_m),
            rates=case.protection.rates,
            time_s=time_s,
            position_m=position_m,
            speed_mps=speed_mps,
            acceleration_mps2=nothing,
            scheduled_s=np.full_like(position_m, self.scheduled_s),
            command=nothing,
            assists=env.DOMAIN_ASSISTS,
        )

    def commands(self, plan: Plan, position_m: Float[ndarray, " states"]) -> Float[ndarray, " states"]:
        """The command that does what a plan does over the next metres, in [-1, 1].

        Work over distance: smoother than the command here and now, and it keeps time. Where the plan pulls
        as hard as the trainset's limits let it, the command is 1: the trainset sees to its limits.
        """
        vehicle, ds = self.case.vehicle, np.diff(plan.position_m)
        mass = float(vehicle.effective_mass_kg)
        kinetic = 0.5 * plan.speed_mps**2
        able = effort_at(vehicle, np.sqrt(kinetic[1:] + kinetic[:-1]))
        effort = (plan.traction_n - plan.brake_n) / mass
        drag = effort - np.diff(kinetic) / ds
        pull, brake = able.traction_n / mass, able.brake_n / mass
        limited = np.minimum(pull, float(vehicle.max_acceleration_mps2) + drag)
        window = np.minimum(WINDOW_M, np.maximum(self.length_m - position_m, 1.0))

        def mean(values: ndarray) -> ndarray:
            total = np.concatenate([[0.0], np.cumsum(values * ds)])
            far, near = (np.interp(position_m + d, plan.position_m, total) for d in (window, 0.0 * window))
            return (far - near) / window

        wanted = mean(effort)
        share = wanted / np.maximum(np.where(wanted >= 0, mean(pull), mean(brake)), 1e-3)
        hard = np.clip((wanted / np.maximum(mean(limited), 1e-3) - ALMOST) / (FULL - ALMOST), 0.0, 1.0)
        return np.clip(share + (1.0 - share) * hard, -1.0, 1.0)

    def along(self, plan: Plan, begun_s: float, random: Generator, states: int) -> Demonstrations:
        """Demonstrations at random times of a plan that begins at a time since departure."""
        at = random.uniform(0.0, 0.995 * plan.running_time_s, states)
        x = np.interp(at, plan.time_s, plan.position_m)
        v = np.sqrt(np.maximum(np.interp(x, plan.position_m, plan.speed_mps**2), 0.0))
        mass = float(self.case.vehicle.effective_mass_kg)
        begin = (
            float(plan.position_m[0]),
            float(plan.speed_mps[0]),
            begun_s,
            self.scheduled_s,
            begun_s + plan.running_time_s,
            plan.energy_wheel_j / mass,
            plan.second_w / mass,
        )
        commands = self.commands(plan, x).astype(np.float32)
        return Demonstrations(self.observe(begun_s + at, x, v), commands, np.array([begin]))


def collect_demonstrations(
    sample: env.DomainSample, random: Generator, plans: int, states: int
) -> Demonstrations:
    """Collect demonstrations along the optimal plan of a section, and along plans from states beside it.

    Args:
        sample: Section and trainset.
        random: Source of the scheduled time and the disturbances.
        plans: Number of plans.
        states: States along each.

    Raises:
        MetropilotError: The section cannot be driven.
    """
    low, high = TIME_RATIO
    room = DemonstrationGenerator(sample, low + (high - low) * float(random.beta(1.1, 2.0)))
    first = room.plan(room.scheduled_s)
    found = [room.along(first, 0.0, random, states)]
    for _ in range(plans - 1):
        with suppress(MetropilotError):  # no plan from there: too fast to stop, or stalled
            found.append(_beside(room, first, random, states))
    return concatenate_demonstrations(found)


def _beside(room: DemonstrationGenerator, plan: Plan, random: Generator, states: int) -> Demonstrations:
    """Demonstrations along the plan from a state beside another plan."""
    moment = float(random.uniform(0.0, 0.92 * plan.running_time_s))
    x = float(np.interp(moment, plan.time_s, plan.position_m))
    v = float(np.sqrt(np.interp(x, plan.position_m, plan.speed_mps**2)))
    v = float(np.clip(v + random.normal(0.0, SPREAD_MPS), SLOWEST_MPS, room.most_mps(x)))
    left = (room.scheduled_s - moment) * (1.0 + random.normal(0.0, SPREAD_SHARE))
    left = max(left + random.normal(0.0, SPREAD_S), 1.0)
    return room.along(room.plan(left, x, v), room.scheduled_s - left, random, states)


def concatenate_demonstrations(demonstrations: Sequence[Demonstrations]) -> Demonstrations:
    """All of them as one; states that are not finite are left out."""
    whole = Demonstrations(*(np.concatenate(part) for part in zip(*demonstrations, strict=True)))
    fit = np.isfinite(whole.observations).all(axis=1) & np.isfinite(whole.commands)
    return Demonstrations(whole.observations[fit], whole.commands[fit], whole.begins)


SHARD = 50
"""Random sections in one file."""
MAX_BYTES = 1 << 30
ATTEMPT = 1 << 32
"""Offset of a section's number in the seed of its demonstrations: apart from the section's own numbers."""


@dataclass(frozen=True)
class DemonstrationSet:
    """Specification of a set of demonstrations.

    Attributes:
        seed: Of everything random.
        worlds: Number of sampled lines with their trainsets.
        plans: Plans of each.
        states: States along each plan.
        folder: Folder of the files.
        wide_share: Share of the lines that are drawn wider.
    """

    seed: int
    worlds: int
    plans: int
    states: int
    folder: Path
    wide_share: float = 0.0

    @property
    def shards(self) -> int:
        """Number of files."""
        return -(-self.worlds // SHARD)

    def path(self, shard: int) -> Path:
        """File of one shard; its name holds the whole specification, so that no other is taken for it."""
        key = f"{self.seed}-{self.worlds}-{self.plans}-{self.states}-{self.wide_share:g}"
        return self.folder / f"lessons-{key}-{shard:03}.safetensors"


def collect_missing(dataset: DemonstrationSet, on_shard: Callable[[int], object]) -> None:
    """Collect missing demonstrations on all cores.

    Args:
        dataset: Specification of the demonstrations.
        on_shard: Called with the number of files there are, whenever there is one more.

    Raises:
        InputError: A file cannot be written.
    """
    from joblib import Parallel, cpu_count, delayed

    missing = [k for k in range(dataset.shards) if not dataset.path(k).exists()]
    there = dataset.shards - len(missing)
    jobs = (delayed(collect_shard)(dataset, shard) for shard in missing)
    pool = Parallel(n_jobs=min(cpu_count(), max(len(missing), 1)), return_as="generator_unordered")
    for _ in pool(jobs) if missing else ():
        there += 1
        on_shard(there)


def collect_shard(dataset: DemonstrationSet, shard: int) -> None:
    """Collect the demonstrations of one file and write it."""
    found, numbers = [], []
    for number in range(shard * SHARD, min((shard + 1) * SHARD, dataset.worlds)):
        random = np.random.default_rng([dataset.seed, number + ATTEMPT])
        try:
            sample = env.domain_sample(dataset.seed, number, dataset.wide_share)
            demonstrations = collect_demonstrations(sample, random, dataset.plans, dataset.states)
        except MetropilotError:
            continue  # a section that cannot be driven: too steep for its trainset
        found.append(demonstrations)
        numbers.append(np.full(demonstrations.begins.shape[0], number))
    whole, path = concatenate_demonstrations(found), dataset.path(shard)

    write_tensors(path, whole._asdict() | {"numbers": np.concatenate(numbers)}, {})


def load_demonstrations(dataset: DemonstrationSet) -> tuple[Demonstrations, Int[np.ndarray, " drives"]]:
    """Load all demonstrations, and the number of the section in which each drive begins.

    Raises:
        InputError: A file is missing or damaged.
    """
    parts = list(_read(dataset))
    whole = Demonstrations(
        *(np.concatenate(part) for part in zip(*(demonstrations for demonstrations, _ in parts), strict=True))
    )
    return whole, np.concatenate([numbers for _, numbers in parts])


def _read(dataset: DemonstrationSet) -> Iterator[tuple[Demonstrations, Int[np.ndarray, " drives"]]]:
    for shard in range(dataset.shards):
        path = dataset.path(shard)
        try:
            found, _ = read_tensors(path, MAX_BYTES)
            yield Demonstrations(*(found[name] for name in Demonstrations._fields)), found["numbers"]
        except (InputError, KeyError):
            raise InputError("demonstrations are missing or damaged; remove the file", file=path) from None

"""Declaration of a campaign: a matrix with numbered rows, and the request of each row.

A row does not depend on the order, the machine or the number of workers: its seed and all random draws derive
from its identity. The driver is no part of that identity, so that every driver meets the same plant and the
same noise.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cache, lru_cache
from hashlib import sha256
from itertools import product
from math import prod
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NamedTuple

import numpy as np

from metropilot._schema import field_specs
from metropilot.campaign.matrix import DRIVES, AbstractCampaign, CellRow, content_key, count_axes, digest_of
from metropilot.drivers import DRIVERS, AbstractPolicyDriver, builds_up_slowly
from metropilot.evaluate import POLICY, RunSpec, parse_driver
from metropilot.planning import Objective
from metropilot.policy import policy_path
from metropilot.protection import Bounds, guarantees_less
from metropilot.railway import Restriction, load_trainset, parse_trainset
from metropilot.sim import CONTROL_PERIOD_S, Disturbance, TimetableUpdate
from metropilot.units import KMH_PER_MPS

if TYPE_CHECKING:
    from pathlib import Path

    from duckdb import DuckDBPyConnection

PLANNED = "planned"
SHARDS = 20
LARGEST_SHARD = 50
BATCH = 256
"""Runs of a compiled shard: the batch size of the program; a smaller shard is padded to it."""
Engine = Literal["host", "compiled"]
OWN = "own"
"""Actuation that a trainset declares itself."""
ActuationPair = tuple[float, float]
DRAWN = tuple(name for name, spec in field_specs(Disturbance).items() if spec.range is not None)
"""Fields of a run's disturbance that a campaign may set or draw."""
MEASURED = ("speed_noise_mps",)
"""Those of them that leave the plant nominal."""


@dataclass(frozen=True)
class DisturbanceCase:
    """Disturbances, relative to section and scheduled time so that they apply to every section.

    Attributes:
        name: Name in the results.
        ideal: Ideal actuation: no delay, lag or jerk limit.
        ranges: From a field of :data:`DRAWN` to the interval it is drawn from, evenly.
        restriction: A temporary speed restriction: from and to as shares of the section, limit in km/h, and
            when it is announced as a share of the scheduled time (None: before departure).
        arrival: A new running time over the scheduled one, and when it is announced as a share of that.
        actuation: Dead time and lag that the trainset declares instead of its own, s: no disturbance to the
            driver, who knows them.
    """

    name: str
    ideal: bool = False
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    restriction: tuple[float, float, float, float | None] | None = None
    arrival: tuple[float, float] | None = None
    actuation: ActuationPair | None = None

    @property
    def plant_is_nominal(self) -> bool:
        """True if the true plant is the nominal one; measurements and the timetable may still differ."""
        return not set(self.ranges) - set(MEASURED)


class CampaignCase(NamedTuple):
    """One row: the cell of the matrix.

    Attributes:
        row: Number of the row.
        driver: Driver id, options included.
        line: Line, with ``origin`` and ``destination``.
        origin: Station code.
        destination: Station code.
        trainset: Trainset, with the actuation it declares instead of its own, if any (``ID@DELAY,LAG``).
        load: Load aboard.
        time: ``planned``, or the scheduled time over the minimum running time.
        disturbance: Disturbance of the run.
        number: Number of the seed.
        period_s: Control period.
    """

    row: int
    driver: str
    line: str
    origin: str
    destination: str
    trainset: str
    load: str
    time: float | str
    disturbance: DisturbanceCase
    number: int
    period_s: float


AXES = ("sections", "trainsets and loads", "times", "control periods", "disturbances", "seeds", "actuations")
"""Axes of a matrix after the drivers, in words."""


def declare_actuation(trainset: str, actuation: ActuationPair | None) -> str:
    """Key of a trainset that declares another dead time and lag than its own; None: its own."""
    if actuation is None:
        return trainset
    return str(parse_trainset(trainset)._replace(actuation=actuation))


@dataclass(frozen=True)
class Campaign(AbstractCampaign):
    """A matrix of runs: cells, each driven by every driver.

    Attributes:
        name: Of the campaign.
        drivers: Driver ids, each with options if any (``ID:NAME=VALUE``).
        sections: Line, origin and destination of each.
        trainsets: Trainset and load of each.
        times: ``planned``, or ratios to the minimum running time.
        disturbances: Disturbances.
        seeds: Number of seeds of each cell.
        first_seed: Base of all seeds.
        objective: Energy the optimum minimises.
        dt_s: Control period.
        actuations: Dead times and lags, s, that each trainset declares instead of its own; None: its own.
        periods: Control periods, each driven; empty: ``dt_s`` alone.
        sample: Number of combinations of section, trainset, time, period, disturbance and seed drawn from the
            matrix, each with every driver and every actuation; None: all of them.
        engine: ``host`` drives each run by itself, exactly as ``metropilot drive``; ``compiled`` drives
            those of learned policies on the nominal plant in batches.
    """

    kind: ClassVar[str] = DRIVES
    group_column: ClassVar[str] = "driver"
    most_rows: ClassVar[int] = 5_000_000
    name: str
    drivers: tuple[str, ...]
    sections: tuple[tuple[str, str, str], ...]
    trainsets: tuple[tuple[str, str], ...]
    times: tuple[float | str, ...] = (PLANNED,)
    disturbances: tuple[DisturbanceCase, ...] = (DisturbanceCase("nominal"),)
    seeds: int = 1
    first_seed: int = 0
    objective: Objective = "wheel"
    dt_s: float = CONTROL_PERIOD_S
    engine: Engine = "host"
    actuations: tuple[ActuationPair | None, ...] = (None,)
    periods: tuple[float, ...] = ()
    sample: int | None = None

    @property
    def periods_s(self) -> tuple[float, ...]:
        """Control periods."""
        return self.periods or (self.dt_s,)

    @property
    def axes(self) -> tuple[int, ...]:
        """Numbers of drivers and of each axis of :data:`AXES`; the last vary fastest."""
        lists = (self.drivers, self.sections, self.trainsets, self.times, self.periods_s, self.disturbances)
        return (*(len(axis) for axis in lists), self.seeds, len(self.actuations))

    @property
    def combinations(self) -> int:
        """Number of combinations driven, each with every driver and every actuation."""
        whole = prod(self.axes[1:-1])
        return whole if self.sample is None else min(self.sample, whole)

    @property
    def cells(self) -> int:
        """Number of runs of one driver."""
        return self.combinations * len(self.actuations)

    @property
    def groups(self) -> tuple[str, ...]:
        """Drivers."""
        return self.drivers

    @property
    def trainset_keys(self) -> tuple[tuple[str, str], ...]:
        """Trainset and load of each, with every actuation that it declares in this campaign."""
        told = (*self.actuations, *(item.actuation for item in self.disturbances))
        pairs = product(self.trainsets, dict.fromkeys(told))
        return tuple((declare_actuation(name, late), load) for (name, load), late in pairs)

    def is_compiled(self, driver: str, disturbance: DisturbanceCase, trainset: tuple[str, str]) -> bool:
        """True if runs of a driver are driven as compiled batches.

        Runs with dead time or lag are not: there the driver predicts from its observations. Nor are those of
        a trainset that is guaranteed a weaker brake than its service brake: there it asks protection first.

        Args:
            driver: Driver id, options included.
            disturbance: Disturbance of the run.
            trainset: Trainset and load.
        """
        kind = DRIVERS.get(parse_driver(driver)[0])
        if (
            self.engine != "compiled"
            or self.periods
            or not issubclass(kind, AbstractPolicyDriver)
            or not disturbance.plant_is_nominal
        ):
            return False
        late, weak = _declares(*trainset)
        return not weak and (disturbance.ideal or not late)

    def shard_rows(self, group: str) -> int:
        """Number of rows in a shard of a driver; depends on driver and matrix only."""
        pairs = product(self.disturbances, self.trainset_keys)
        if any(self.is_compiled(group, disturbance, trainset) for disturbance, trainset in pairs):
            return BATCH
        return min(max(-(-self.cells // SHARDS), 1), LARGEST_SHARD)

    def case(self, row: int) -> CampaignCase:
        """The cell of a row."""
        driver, cell = divmod(row, self.cells)
        combination, actuation = divmod(cell, len(self.actuations))
        if self.combinations < prod(self.axes[1:-1]):
            lines = tuple(line for line, _, _ in self.sections)
            drawn = sample_combinations(lines, self.axes[1:-1], self.combinations, self.first_seed)
            index = drawn[combination]
        else:
            index = np.unravel_index(combination, self.axes[1:-1])
        section, trainset, time, period, disturbance, number = (int(k) for k in index)
        (name, load), told = self.trainsets[trainset], self.disturbances[disturbance]
        late = self.actuations[actuation] if told.actuation is None else told.actuation
        return CampaignCase(
            row,
            self.drivers[driver],
            *self.sections[section],
            declare_actuation(name, late),
            load,
            self.times[time],
            told,
            number,
            self.periods_s[period],
        )

    @property
    def text(self) -> str:
        """The whole campaign as JSON, keys sorted; fields of later versions only where they say something."""
        values = asdict(self)
        for name, default in {"actuations": (None,), "periods": (), "sample": None}.items():
            if values[name] == default:
                del values[name]
        for disturbance in values["disturbances"]:
            if disturbance["actuation"] is None:
                del disturbance["actuation"]
        return json.dumps(values, sort_keys=True)

    @property
    def identity(self) -> str:
        """The text without drivers, and with the content of files instead of their paths."""
        sections = tuple((content_key(line), start, end) for line, start, end in self.sections)
        trainsets = tuple((content_key(name), load) for name, load in self.trainsets)
        return replace(self, drivers=(), sections=sections, trainsets=trainsets).text

    @property
    def group_files(self) -> Mapping[str, str]:
        """Drivers with a policy file."""
        policies = {name: parse_driver(name)[1].get(POLICY) for name in self.drivers}
        paths = {name: policy_path(policy) for name, policy in policies.items() if isinstance(policy, str)}
        return {name: digest_of(path) for name, path in paths.items() if path.is_file()}

    @property
    def columns(self) -> Mapping[str, str]:
        """Columns of the results."""
        from metropilot.campaign.rows import RESULTS

        return RESULTS

    @property
    def timing_columns(self) -> Mapping[str, str]:
        """Columns of measured times."""
        from metropilot.campaign.rows import TIMINGS

        return TIMINGS

    @property
    def matrix_words(self) -> str:
        """Axes with their sizes, and the sample if there is one."""
        words = count_axes(list(zip(("drivers", *AXES), self.axes, strict=True)))
        if self.cells < prod(self.axes[1:]):
            words += f", a sample of {self.combinations} combinations with every driver and actuation"
        return words

    def compute_rows(self, rows: range) -> list[CellRow]:
        """Results and timings of the runs of a shard."""
        from metropilot.campaign.rows import drive_rows

        return drive_rows(self, rows)

    def statistics(self, database: DuckDBPyConnection | None) -> dict[str, Any]:
        """``drivers`` (one row a driver), ``cells`` (one per driver and disturbance), ``worst``."""
        from metropilot.campaign.page import drive_statistics

        return drive_statistics(database)

    def succeeds(self, summary: Mapping[str, Any]) -> bool:
        """True if every run was safe, and on time where that was possible."""
        drivers = summary["drivers"]
        return all(row["successes"] == row["possible"] and row["safe"] == row["driven"] for row in drivers)

    def report_parts(self, folder: Path, summary: Mapping[str, Any]) -> list[str]:
        """Tables, energy against time, and the worst runs, of which each gets a folder."""
        from metropilot.campaign.page import report_drives

        return report_drives(self, folder, summary)

    def page_parts(self, folder: Path, summary: Mapping[str, Any], written: str) -> list[str]:
        """The leaderboard."""
        from metropilot.campaign.leaderboard import leaderboard

        return leaderboard(self, folder, summary, written)


@lru_cache(maxsize=8)
def sample_combinations(
    lines: tuple[str, ...], axes: tuple[int, ...], count: int, seed: int
) -> tuple[tuple[int, ...], ...]:
    """Combinations of a sample as indices into section, trainset, time, period, disturbance and seed.

    Each value of an axis comes equally often, as far as the numbers allow: sections line by line.

    Args:
        lines: Line of each section.
        axes: Size of each axis.
        count: Number of combinations, all different; less than there are.
        seed: Seed of the sample.
    """
    random = np.random.default_rng([seed, count])
    by_line = [np.flatnonzero(np.array(lines) == line) for line in dict.fromkeys(lines)]
    columns = [_in_turn([random.permutation(group) for group in by_line], count)]
    columns += [_in_turn([random.permutation(size)], count) for size in axes[1:]]
    shuffled = np.stack([random.permutation(column) for column in columns], axis=1)
    found = dict.fromkeys(tuple(row) for row in shuffled.tolist())
    while len(found) < count:
        found.setdefault(tuple(int(random.integers(size)) for size in axes))
    return tuple(found)


def _in_turn(groups: list[np.ndarray], count: int) -> np.ndarray:
    """Values from each group in turn, each group from its beginning again."""
    chosen = (groups[k % len(groups)] for k in range(count))
    return np.array([group[k // len(groups) % group.size] for k, group in enumerate(chosen)])


def seed_of(campaign: Campaign, case: CampaignCase) -> int:
    """The seed of a row, from everything that identifies it but driver, declared actuation and period."""
    name = content_key(str(parse_trainset(case.trainset)._replace(actuation=None)))
    told = DisturbanceCase(case.disturbance.name)
    named = {"line": content_key(case.line), "trainset": name, "disturbance": told}
    cell = case._replace(row=0, driver="", **named)._asdict()
    del cell["period_s"]
    text = json.dumps([campaign.first_seed, cell], sort_keys=True, default=lambda d: d.name)
    return int.from_bytes(sha256(text.encode()).digest()[:8], "big") >> 1


def draw_disturbance(disturbance: DisturbanceCase, seed: int) -> dict[str, float]:
    """Draw the fields of a request's disturbance from the random stream of the row."""
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(7,)))
    found = {}
    for name in DRAWN:
        share = float(random.random())
        if name in disturbance.ranges:
            low, high = disturbance.ranges[name]
            found[name] = low if low == high else low + (high - low) * share
    return found


def case_request(campaign: Campaign, case: CampaignCase, scheduled_s: float, length_m: float) -> RunSpec:
    """The request of a row.

    Args:
        campaign: The campaign.
        case: The row's cell.
        scheduled_s: Its scheduled time.
        length_m: Length of its section.
    """
    seed, told = seed_of(campaign, case), case.disturbance
    driver, options = parse_driver(case.driver)
    known, updates = [], []
    if told.restriction is not None:
        start, end, kmh, announced = told.restriction
        place = round(start * length_m, 1), round(end * length_m, 1)
        restriction = Restriction(*place, kmh / KMH_PER_MPS)
        if announced is None:
            known.append(restriction)
        else:
            updates.append(TimetableUpdate(round(announced * scheduled_s, 1), restriction=restriction))
    if told.arrival is not None:
        factor, announced = told.arrival
        at_s, new_s = round(announced * scheduled_s, 1), round(factor * scheduled_s, 2)
        updates.append(TimetableUpdate(at_s, scheduled_time_s=new_s))
    return RunSpec(
        line=case.line,
        origin=case.origin,
        destination=case.destination,
        time_s=scheduled_s,
        trainset=case.trainset,
        load=case.load,
        driver=driver,
        options=options,
        disturbance=Disturbance(ideal=told.ideal, updates=tuple(updates), **draw_disturbance(told, seed)),
        restrictions=tuple(known),
        objective=campaign.objective,
        dt_s=case.period_s,
        seed=seed,
    )


@cache
def _declares(trainset: str, load: str) -> tuple[bool, bool]:
    """True if a trainset brakes late, by what it declares; true if with less than its service brake."""
    declared = load_trainset(trainset, load)
    actuation = declared.actuation
    late = actuation.delay_s > 0.0 or actuation.lag_s > 0.0 or builds_up_slowly(declared)
    return late, guarantees_less(declared, Bounds.of(declared, CONTROL_PERIOD_S))

"""Comparison of several drivers on one run over seeds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.evaluate.kpis import Kpis, kpis_of
from metropilot.evaluate.optimum import Optimum, optimum_of
from metropilot.evaluate.run_spec import RunSpec
from metropilot.sim import Drive, drive

CONFIDENCE = 0.95
RESAMPLES = 2000
ERRORS = ("time_error_s", "stopping_error_m")
"""KPIs that are best when they are zero; of the others the lowest is best."""


class Interval(NamedTuple):
    """A mean over seeds with its confidence interval.

    Attributes:
        mean: Mean.
        low: Lower end of the 95 % interval.
        high: Upper end.
    """

    mean: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Entry:
    """One driver of a comparison.

    Attributes:
        driver: Its id.
        drives: One per seed.
        kpis: One per seed.
        optimum: Optimum of the first drive.
    """

    driver: str
    drives: tuple[Drive, ...]
    kpis: tuple[Kpis, ...]
    optimum: Optimum | None

    def interval(self, name: str) -> Interval | None:
        """Mean and bootstrap interval of one KPI over the seeds; None unless every seed has the number."""
        values = [getattr(k, name) for k in self.kpis]
        if any(v is None for v in values):
            return None
        return bootstrap(np.array(values, dtype=np.float64))

    @property
    def successes(self) -> int:
        """Seeds that met every requirement."""
        return sum(k.success for k in self.kpis)


class Job(NamedTuple):
    """One drive of a comparison: a driver and a seed."""

    driver: str
    seed: int


def jobs(drivers: Sequence[str], first_seed: int, seeds: int) -> list[Job]:
    """Every driver with every seed."""
    return [Job(name, first_seed + k) for name in dict.fromkeys(drivers) for k in range(seeds)]


def compare(request: RunSpec, todo: Iterable[Job]) -> tuple[Entry, ...]:
    """Drive the same run with several drivers and seeds.

    At the same seed every driver has the same plant and the same noise.

    Args:
        request: The run; its driver and seed are replaced.
        todo: Drives to run, see :func:`jobs`.

    Raises:
        InputError: Something in the request, or a driver, cannot be used.
    """
    run = request.run()
    found: dict[str, list[tuple[Drive, Kpis, Optimum | None]]] = {}
    for job in todo:
        driven = drive(replace(run, seed=job.seed), replace(request, driver=job.driver).make_driver())
        optimum = optimum_of(driven, request.objective)
        kpis = kpis_of(driven, optimum, request.objective)
        found.setdefault(job.driver, []).append((driven, kpis, optimum))
    return tuple(
        Entry(name, tuple(d for d, _, _ in rows), tuple(k for _, k, _ in rows), rows[0][2])
        for name, rows in found.items()
    )


def bootstrap(
    values: Float[ndarray, " seeds"], statistic: Callable[..., Any] = np.mean, seed: int = 0
) -> Interval:
    """Mean, or another statistic, with its 95 % percentile-bootstrap interval; of no width for equal values.

    Source: Efron and Tibshirani, An Introduction to the Bootstrap (1993), chapter 13; here from SciPy, with a
    fixed seed so that a table repeats itself.

    Args:
        values: One per seed.
        statistic: NumPy function of them.
        seed: Seed of the resampling.
    """
    mean = float(statistic(values))
    if values.size < 2 or np.ptp(values) == 0:
        return Interval(mean, mean, mean)
    from scipy.stats import bootstrap as resample

    found: Any = resample(
        (values,),
        statistic,
        confidence_level=CONFIDENCE,
        n_resamples=RESAMPLES,
        method="percentile",
        rng=np.random.default_rng(seed),
    )
    return Interval(mean, float(found.confidence_interval.low), float(found.confidence_interval.high))


def best(entries: Sequence[Entry], name: str) -> str | None:
    """The best driver in a KPI among those that always met every requirement."""
    means = {e.driver: i.mean for e in entries if e.successes == len(e.kpis) and (i := e.interval(name))}
    return best_of(means, name)


def best_of(means: Mapping[str, float], name: str) -> str | None:
    """The driver with the lowest mean of a KPI, of an error with the smallest; None if there is one alone.

    Args:
        means: Mean of each driver.
        name: The KPI.
    """
    lowest = abs if name in ERRORS else float
    return min(means, key=lambda driver: lowest(means[driver])) if len(means) > 1 else None

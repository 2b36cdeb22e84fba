"""Distribution of an episode's case, running time, start and disturbance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from metropilot._typing import Array
from metropilot.errors import InputError
from metropilot.protection import Bounds
from metropilot.railway import Restriction, Section, Trainset
from metropilot.sim import Disturbance, Run, declared_bounds
from metropilot.units import KMH_PER_MPS

Interval = tuple[float, float]
NOMINAL: Mapping[str, Interval] = MappingProxyType(
    {
        field.name: (field.default, field.default)
        for field in fields(Disturbance)
        if isinstance(field.default, float)
    }
)
"""Quantities drawn for an episode, each with the interval of no disturbance."""
DRAWN = tuple(NOMINAL)
DRAWN_PLANT = tuple(name for name in DRAWN if name != "speed_noise_mps")
RESTRICTIONS = 4
"""Number of temporary speed restrictions drawn for a case; its tables are built with each of them."""


class StartDistribution(NamedTuple):
    """Start and disturbance drawn for one episode. All 0-d.

    Attributes:
        case: Row of the task's cases.
        scheduled_s: Scheduled running time.
        position_m: Position at the start.
        speed_mps: Speed at the start.
        time_s: Time since departure at the start.
        mass_factor: True over nominal mass.
        resistance_factor: True over nominal Davis resistance.
        delay_s: Dead time in addition to the trainset's.
        lag_s: Lag in addition to the trainset's.
        speed_noise_mps: Standard deviation of the measured speed.
        headwind_mps: Wind from ahead.
        adhesion: Adhesion of the driven wheels (infinite: dry rail).
        brake_factor: True over nominal service braking force.
        news_at_s: When a new scheduled time is announced (infinite: never).
        news_s: The new scheduled time.
        restricted: Row of the tables with a temporary speed restriction.
        restricted_at_s: When that is announced (infinite: never).
    """

    case: Array
    scheduled_s: Array
    position_m: Array
    speed_mps: Array
    time_s: Array
    mass_factor: Array
    resistance_factor: Array
    delay_s: Array
    lag_s: Array
    speed_noise_mps: Array
    headwind_mps: Array
    adhesion: Array
    brake_factor: Array
    news_at_s: Array
    news_s: Array
    restricted: Array
    restricted_at_s: Array


@dataclass(frozen=True)
class DisturbanceDistribution:
    """Distribution of an episode; each quantity is uniform over its interval.

    Attributes:
        time_ratio: Scheduled time over the minimum of the case.
        longest_s: Longest scheduled time instead of the upper ratio.
        time_s: Scheduled time itself instead of ratios.
        mass_factor: True over nominal mass.
        resistance_factor: True over nominal Davis resistance.
        delay_s: Dead time in addition to the trainset's.
        lag_s: Lag in addition to the trainset's.
        speed_noise_mps: Standard deviation of the measured speed (cut at three deviations).
        headwind_mps: Wind from ahead.
        adhesion: Adhesion of the driven wheels (infinite: dry rail).
        brake_factor: True over nominal service braking force.
        news: Probability that the scheduled time changes on the way.
        news_at: Time of that announcement, as a share of the scheduled time.
        news_shift_s: Change of the scheduled time; at least 0.9 of the time left remains.
        restriction: Probability that a temporary speed restriction is announced on the way; it is one of
            ``RESTRICTIONS`` that are drawn for each case once.
        restriction_at: Time of that announcement, as a share of the scheduled time.
        on_the_way: Probability that an episode begins between the stops, at a speed that can still stop,
            with a time left drawn like the scheduled time. Evaluate with 0.
        left_ratio: Time left of such an episode over the flat-out time to go, instead.
    """

    time_ratio: Interval = (1.05, 1.5)
    longest_s: float | None = None
    time_s: Interval | None = None
    mass_factor: Interval = (1.0, 1.0)
    resistance_factor: Interval = (1.0, 1.0)
    delay_s: Interval = (0.0, 0.0)
    lag_s: Interval = (0.0, 0.0)
    speed_noise_mps: Interval = (0.0, 0.0)
    headwind_mps: Interval = NOMINAL["headwind_mps"]
    adhesion: Interval = NOMINAL["adhesion"]
    brake_factor: Interval = NOMINAL["brake_factor"]
    news: float = 0.0
    news_at: Interval = (0.2, 0.6)
    news_shift_s: Interval = (-5.0, 15.0)
    restriction: float = 0.0
    restriction_at: Interval = (0.0, 0.15)
    on_the_way: float = 0.0
    left_ratio: Interval | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, tuple) and not value[0] <= value[1]:
                raise InputError("empty interval", field=field.name, value=str(value), allowed="low <= high")
        for name in ("news", "restriction", "on_the_way"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError("no probability", field=name, value=getattr(self, name), allowed="0 to 1")
        for end in (0, 1):
            self.extreme(end)

    def extreme(self, end: int) -> Disturbance:
        """Disturbance at the low (0) or high (1) end of every interval."""
        return Disturbance(**{name: getattr(self, name)[end] for name in DRAWN})

    def times_s(self, minimum_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shortest and longest scheduled time of each case, s."""
        if self.time_s is not None:
            low, high = (np.full_like(minimum_s, t) for t in self.time_s)
        else:
            low, high = (minimum_s * ratio for ratio in self.time_ratio)
            if self.longest_s is not None:
                high = np.full_like(minimum_s, self.longest_s)
        return low, np.maximum(low, high)

    def bounds(self, section: Section, trainset: Trainset, dt: float) -> Bounds:
        """Bounds declared to protection: the widest that the host would declare for any disturbance."""
        ends = [declared_bounds(Run(section, trainset, 1.0, self.extreme(k), dt)) for k in (0, 1)]
        return replace(
            ends[1],
            mass=_hull([end.mass for end in ends]),
            resistance=_hull([end.resistance for end in ends]),
            service_share=min(end.service_share for end in ends),
        )

    def restricted(self, section: Section) -> tuple[Section, ...]:
        """Sections with each of the restrictions that may be announced; empty without restrictions."""
        if self.restriction <= 0:
            return ()
        random = np.random.default_rng(0)
        found = []
        for _ in range(RESTRICTIONS):
            first = section.length_m * random.uniform(0.3, 0.75)
            last = min(first + random.uniform(80.0, 300.0), 0.95 * section.length_m)
            limit = float(section.limit_mps.value.max()) * random.uniform(0.4, 0.8)
            found.append(section.restricted(Restriction(first, last, max(limit, 20.0 / KMH_PER_MPS))))
        return tuple(found)


def _hull(intervals: Sequence[Interval]) -> Interval:
    return min(low for low, _ in intervals), max(high for _, high in intervals)


def draw(scenarios: DisturbanceDistribution, key: Array, times_s: Array) -> StartDistribution:
    """Draw one episode from standstill (JAX).

    All random numbers that the distribution needs are drawn at once, and no others: a learner resets a few of
    its many environments in every step, but computes the reset of all.

    Args:
        scenarios: The distribution.
        key: Random key.
        times_s: Shortest and longest scheduled time of each case. Shape (2, C).
    """
    import jax
    import jax.numpy as jnp

    given = (getattr(scenarios, name) for name in DRAWN)
    wide = [low < high for low, high in given]
    cases = times_s.shape[1]
    count = int(cases > 1) + 1 + sum(wide) + 3 * (scenarios.news > 0) + 3 * (scenarios.restriction > 0)
    shares = iter(jax.random.uniform(key, (count,)))

    def within(interval: Interval) -> Array:
        low, high = interval
        return low + (high - low) * next(shares) if low < high else jnp.float32(low)

    case = jnp.zeros((), jnp.int32)
    if cases > 1:
        case = jnp.minimum((next(shares) * cases).astype(jnp.int32), cases - 1)
    low, high = times_s[0, case], times_s[1, case]
    scheduled = low + (high - low) * next(shares)
    zero = jnp.zeros((), jnp.float32)
    drawn = {name: within(getattr(scenarios, name)) for name in DRAWN}
    news_at, news = jnp.full((), jnp.inf, jnp.float32), scheduled
    if scenarios.news > 0:
        told, at, shift = next(shares), next(shares), next(shares)
        at = scheduled * (scenarios.news_at[0] + (scenarios.news_at[1] - scenarios.news_at[0]) * at)
        low, high = scenarios.news_shift_s
        news = jnp.maximum(scheduled + low + (high - low) * shift, at + 0.9 * (scheduled - at))
        news_at = jnp.where(told < scenarios.news, at, jnp.inf)
    restricted, restricted_at = case, jnp.full((), jnp.inf, jnp.float32)
    if scenarios.restriction > 0:
        drawn_at, which, at = next(shares), next(shares), next(shares)
        number = jnp.minimum((which * RESTRICTIONS).astype(jnp.int32), RESTRICTIONS - 1)
        restricted = cases + case * RESTRICTIONS + number
        low, high = scenarios.restriction_at
        announced = scheduled * (low + (high - low) * at)
        restricted_at = jnp.where(drawn_at < scenarios.restriction, announced, jnp.inf)
    return StartDistribution(
        case=case,
        scheduled_s=scheduled,
        position_m=zero,
        speed_mps=zero,
        time_s=zero,
        news_at_s=news_at,
        news_s=news,
        restricted=restricted,
        restricted_at_s=restricted_at,
        **drawn,
    )

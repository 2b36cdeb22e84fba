"""Domain randomisation: start and disturbance of an episode, random sections with random trainsets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from metropilot._schema import check_fields, check_number, declare
from metropilot._typing import Array, Float, Index, Key, Scalar
from metropilot.errors import InputError
from metropilot.protection import Bounds
from metropilot.railway import (
    Actuation,
    Davis,
    EffortCurve,
    Restriction,
    SafeBraking,
    Section,
    Station,
    Steps,
    Trainset,
    drawn_trainset,
)
from metropilot.sim import Disturbance, Run, declared_bounds
from metropilot.units import KMH_PER_MPS, STANDARD_GRAVITY_MPS2

STEEPEST_PERMIL = (6.0, 14.0, 28.0, 40.0)
PLATFORM_KMH = (45.0, 50.0, 55.0, 60.0)
WIDE = 1
"""Tag of the random numbers that decide on the wider samples; those of such a sample follow it."""
WIDE_LENGTH_M, WIDE_USUAL_M = (200.0, 20_000.0), (200.0, 3200.0)
LIMIT_SHARES, SLOWEST_KMH = (1.0, 1.0, 1.0, 0.85, 0.7, 0.55), 30.0
WIDE_LIMIT_SHARES, WIDE_SLOWEST_KMH = (1.0, 1.0, 1.0, 0.85, 0.7, 0.5, 0.35, 0.2), 15.0
"""Shares of a section's highest limit that its pieces have, and the lowest limit."""
CLIMB_SHARE = 0.5
"""Share of a trainset's starting effort that a gradient drawn for it takes at most."""
UNNAMED_SEED = 10**9
"""Above the seeds of ``drawn-SEED-NUMBER``, which have nine digits."""
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
PROBABILITIES = ("news", "restriction", "on_the_way")
NUMBERS = (*PROBABILITIES, "longest_s")
"""Fields of a distribution that are no intervals."""
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

    case: Index
    scheduled_s: Scalar
    position_m: Scalar
    speed_mps: Scalar
    time_s: Scalar
    mass_factor: Scalar
    resistance_factor: Scalar
    delay_s: Scalar
    lag_s: Scalar
    speed_noise_mps: Scalar
    headwind_mps: Scalar
    adhesion: Scalar
    brake_factor: Scalar
    news_at_s: Scalar
    news_s: Scalar
    restricted: Index
    restricted_at_s: Scalar


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

    time_ratio: Interval = declare((1.05, 1.5), low=0.0, above=True)
    longest_s: float | None = declare(None, unit="s", low=0.0, above=True)
    time_s: Interval | None = declare(None, unit="s", low=0.0, above=True)
    mass_factor: Interval = (1.0, 1.0)
    resistance_factor: Interval = (1.0, 1.0)
    delay_s: Interval = (0.0, 0.0)
    lag_s: Interval = (0.0, 0.0)
    speed_noise_mps: Interval = (0.0, 0.0)
    headwind_mps: Interval = NOMINAL["headwind_mps"]
    adhesion: Interval = NOMINAL["adhesion"]
    brake_factor: Interval = NOMINAL["brake_factor"]
    news: float = 0.0
    news_at: Interval = declare((0.2, 0.6), low=0.0)
    news_shift_s: Interval = (-5.0, 15.0)
    restriction: float = 0.0
    restriction_at: Interval = declare((0.0, 0.15), low=0.0)
    on_the_way: float = 0.0
    left_ratio: Interval | None = declare(None, low=0.0, above=True)

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self) if field.name not in NUMBERS):
            value = getattr(self, name)
            if value is not None:
                _check_interval(name, value)
        for name in PROBABILITIES:
            check_number(name, value := getattr(self, name))
            if not 0.0 <= value <= 1.0:
                raise InputError("no probability", field=name, value=value, allowed="0 to 1")
        check_fields(self)
        for end in (0, 1):
            self.extreme(end)

    @property
    def quantities_drawn(self) -> int:
        """Number of quantities of the disturbance that are no constant."""
        return sum(low < high for low, high in (getattr(self, name) for name in DRAWN))

    @property
    def mismatches(self) -> tuple[str, ...]:
        """Quantities of the plant that may differ from nominal."""
        return tuple(name for name in DRAWN_PLANT if getattr(self, name) != NOMINAL[name])

    def extreme(self, end: int) -> Disturbance:
        """Disturbance at the low (0) or high (1) end of every interval."""
        return Disturbance(**{name: getattr(self, name)[end] for name in DRAWN})

    def times_s(
        self, minimum_s: Float[np.ndarray, " cases"]
    ) -> tuple[Float[np.ndarray, " cases"], Float[np.ndarray, " cases"]]:
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
        low, high = (declared_bounds(Run(section, trainset, 1.0, self.extreme(k), dt)) for k in (0, 1))
        return low.hull(high)

    def restricted_sections(self, section: Section) -> tuple[Section, ...]:
        """Sections with each of the restrictions that may be announced; empty without restrictions."""
        if self.restriction <= 0:
            return ()
        random = np.random.default_rng(0)
        found = []
        for _ in range(RESTRICTIONS):
            first = section.length_m * random.uniform(0.3, 0.75)
            last = min(first + random.uniform(80.0, 300.0), 0.95 * section.length_m)
            limit = float(section.limit_mps.value.max()) * random.uniform(0.4, 0.8)
            found.append(section.with_restriction(Restriction(first, last, max(limit, 20.0 / KMH_PER_MPS))))
        return tuple(found)


def _check_interval(name: str, value: object) -> None:
    """Refuse what is no interval, and an empty one."""
    if not isinstance(value, tuple) or len(value) != 2:
        raise InputError("not an interval", field=name, value=str(value), allowed="(low, high)")
    for end in value:
        check_number(name, end)
    if not value[0] <= value[1]:
        raise InputError("empty interval", field=name, value=str(value), allowed="low <= high")


def draw_disturbance(distribution: DisturbanceDistribution, shares: Iterator[Scalar]) -> dict[str, Scalar]:
    """Draw every quantity of a disturbance; one random number in [0, 1) for each that is no constant.

    Args:
        distribution: The distribution.
        shares: Random numbers, of any one shape.
    """
    return {name: _within(getattr(distribution, name), shares) for name in DRAWN}


def _within(interval: Interval, shares: Iterator[Scalar]) -> Scalar:
    low, high = interval
    return low + (high - low) * next(shares) if low < high else np.float32(low)


def draw(
    scenarios: DisturbanceDistribution,
    key: Key,
    times_s: Float[Array, "2 cases"],
    wanted_case: Index | None = None,
) -> StartDistribution:
    """Draw one episode from standstill (JAX).

    All random numbers that the distribution needs are drawn at once, and no others: a learner resets a few of
    its many environments in every step, but computes the reset of all.

    Args:
        scenarios: The distribution.
        key: Random key.
        times_s: Shortest and longest scheduled time of each case.
        wanted_case: Case instead of the one drawn.
    """
    import jax
    import jax.numpy as jnp

    cases = times_s.shape[1]
    count = (
        int(cases > 1)
        + 1
        + scenarios.quantities_drawn
        + 3 * (scenarios.news > 0)
        + 3 * (scenarios.restriction > 0)
    )
    shares = iter(jax.random.uniform(key, (count,)))

    case = jnp.zeros((), jnp.int32)
    if cases > 1:
        case = jnp.minimum((next(shares) * cases).astype(jnp.int32), cases - 1)
    case = case if wanted_case is None else jnp.asarray(wanted_case, jnp.int32)
    low, high = times_s[0, case], times_s[1, case]
    scheduled = low + (high - low) * next(shares)
    zero = jnp.zeros((), jnp.float32)
    drawn = {name: jnp.asarray(value) for name, value in draw_disturbance(scenarios, shares).items()}
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


@dataclass(frozen=True)
class DomainSample:
    """Random section with a random trainset.

    Attributes:
        section: Section.
        trainset: Trainset.
    """

    section: Section
    trainset: Trainset


def domain_sample(seed: int, number: int, wide_share: float = 0.0) -> DomainSample:
    """Random section with a random trainset, always the same of a seed, a number and a share.

    The ranges include those of metros in service: 0.5 to 8 km, 30 to 120 km/h, gradients to 40 permil, 80 to
    500 t. They are assumed and not taken from a line of the catalogue. A share of the samples is wider, as
    :func:`draw_wide_sample` draws them; the others do not depend on it.
    """
    if np.random.default_rng([seed, number, WIDE]).random() < wide_share:
        return draw_wide_sample(seed, number)
    random = np.random.default_rng([seed, number])
    section = draw_section(random)
    fastest = float(section.limit_mps.value.max())
    return DomainSample(section, draw_trainset(random, max(fastest, 60.0 / KMH_PER_MPS)))


def draw_section(random: Generator) -> Section:
    """Draw a section of 0.5 to 8 km with limits of 30 to 120 km/h and gradients to 40 permil."""
    usual = random.random() < 0.5
    low, high = (700.0, 3200.0) if usual else (500.0, 8000.0)
    length = float(np.exp(random.uniform(np.log(low), np.log(high))))
    gradients = _gradients(random, length)
    top = random.uniform(45.0, 120.0) if length > 2500.0 else random.uniform(40.0, 95.0)
    return _section(length, gradients, _limits(random, length, top))


def draw_wide_sample(seed: int, number: int) -> DomainSample:
    """Draw a section of 0.2 to 20 km for a trainset as widely drawn as :func:`drawn_trainset` draws them.

    Limits reach from 15 km/h to the trainset's largest speed; gradients are those on which it still gains
    speed. Its seed is none that a name ``drawn-SEED-NUMBER`` can have: campaigns drive trainsets that nobody
    learned from.
    """
    random = np.random.default_rng([seed, number, WIDE + 1])
    drawn = drawn_trainset(UNNAMED_SEED + seed, number)
    trainset = drawn.with_load(str(random.choice(list(drawn.loads))))
    low, high = WIDE_LENGTH_M if random.random() < 0.5 else WIDE_USUAL_M
    length = float(np.exp(random.uniform(np.log(low), np.log(high))))
    start_mps2 = float(trainset.traction.at(0.0)) / trainset.effective_mass_kg
    gradients = _gradients(random, length, 1e3 * CLIMB_SHARE * start_mps2 / STANDARD_GRAVITY_MPS2)
    top = random.uniform(40.0, trainset.max_speed_mps * KMH_PER_MPS)
    limits = _limits(random, length, top, WIDE_LIMIT_SHARES, WIDE_SLOWEST_KMH)
    return DomainSample(_section(length, gradients, limits), trainset)


def _section(
    length: float, gradients: tuple[np.ndarray, np.ndarray], limits: tuple[np.ndarray, np.ndarray]
) -> Section:
    (at, permil), (limit_at, limit_mps) = gradients, limits
    ends = Station("O", "Origin", 0.0), Station("D", "Destination", length)
    return Section("random", *ends, length, Steps(limit_at, limit_mps), Steps(at, permil))


def _breaks(random: Generator, start: float, end: float, low: float, high: float) -> np.ndarray:
    """Positions from a start to an end, apart by a uniform distance."""
    lengths = random.uniform(low, high, int((end - start) / low) + 1)
    at = start + np.concatenate([[0.0], np.cumsum(lengths)])
    return at[at < end]


def _gradients(
    random: Generator, length: float, most_permil: float = STEEPEST_PERMIL[-1]
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and values of gradients; many sections have level stretches, some lie on a slope."""
    steepest = min(float(random.choice(STEEPEST_PERMIL, p=[0.25, 0.3, 0.3, 0.15])), most_permil)
    at = _breaks(random, -400.0, length + 400.0, 100.0, 800.0)
    permil = np.clip(random.normal(0.0, steepest / 1.6, at.size), -steepest, steepest)
    if random.random() < 0.3:
        permil[random.random(at.size) < 0.4] = 0.0
    if random.random() < 0.25:
        permil = np.clip(permil + random.uniform(-0.6, 0.6) * steepest, -steepest, steepest)
    if random.random() < 0.5:
        k, pieces = int(random.integers(at.size)), int(random.integers(1, 5))
        permil[k : k + pieces] = random.choice([-1.0, 1.0]) * random.uniform(0.6, 1.0) * steepest
    return at, permil


def _limits(
    random: Generator,
    length: float,
    top_kmh: float,
    shares: Sequence[float] = LIMIT_SHARES,
    slowest_kmh: float = SLOWEST_KMH,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions and values of limits; half of the sections have a slower zone at a platform."""
    at = _breaks(random, -200.0, length + 200.0, 150.0, 1500.0)
    share = random.choice(shares, size=at.size)
    kmh = np.maximum(np.round(top_kmh * share), slowest_kmh)
    pieces = dict(zip(at.tolist(), kmh.tolist(), strict=True))
    if random.random() < 0.5:
        zone = length - random.uniform(60.0, 180.0)
        pieces = {x: v for x, v in pieces.items() if x < zone - 30.0}
        pieces[zone] = float(random.choice(PLATFORM_KMH))
    if random.random() < 0.4:
        zone = random.uniform(5.0, 150.0)
        after = kmh[0]
        pieces = {x: v for x, v in pieces.items() if x > zone + 30.0}
        pieces |= {-500.0: float(random.choice(PLATFORM_KMH)), zone: float(max(after, 60.0))}
    order = sorted(pieces)
    return np.array(order), np.array([pieces[x] for x in order]) / KMH_PER_MPS


def draw_trainset(random: Generator, max_speed_mps: float) -> Trainset:
    """Draw a trainset of 80 to 500 t; half of them have a jerk limit."""
    mass = float(np.exp(random.uniform(np.log(80e3), np.log(500e3))))
    knee, power = random.uniform(8.0, 17.0), random.uniform(0.9, 1.9)
    speed = np.linspace(0.0, 36.0, 37)
    falling = np.where(speed <= knee, 1.0, (np.maximum(speed, knee) / knee) ** -power)
    braking = random.uniform(0.75, 1.2)
    weight_kn = mass * STANDARD_GRAVITY_MPS2 * 1e-3
    davis = Davis(
        weight_kn * random.uniform(1.0, 3.0),
        weight_kn * 0.0622 * KMH_PER_MPS * random.uniform(0.0, 1.4),
        weight_kn * 0.0018 * KMH_PER_MPS**2 * random.uniform(0.4, 1.6),
    )
    jerk = float(random.uniform(0.5, 1.5)) if random.random() < 0.5 else float("inf")
    return Trainset(
        "random",
        "Random trainset",
        {"aboard": mass},
        "aboard",
        davis=davis,
        traction=EffortCurve.table(speed, mass * random.uniform(0.6, 1.3) * falling),
        electric_brake=EffortCurve.constant(mass * braking * random.uniform(0.7, 1.0)),
        length_m=float(random.choice([0.0, random.uniform(40.0, 190.0)])),
        rotating_fraction=float(random.choice([0.0, 0.06, 0.1])),
        friction_brake_n=0.6 * mass * braking,
        service_deceleration_mps2=braking,
        max_acceleration_mps2=float(random.choice([1.0, 1.3])),
        max_deceleration_mps2=max(braking, 1.0),
        max_speed_mps=max_speed_mps,
        actuation=Actuation(jerk_limit_mps3=jerk),
        safe_braking=SafeBraking(1.25, braking, reaction_s=0.3, buildup_s=0.6),
    )

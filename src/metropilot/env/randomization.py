"""What a learner meets: which case, in what time, and what is not as the data says."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from metropilot.errors import InputError
from metropilot.protection import Bounds
from metropilot.railway import Section, Trainset
from metropilot.sim.bounds import declared_bounds
from metropilot.sim.disturbance import Disturbance
from metropilot.sim.run import Run

Array = Any
DRAWN = ("mass_factor", "resistance_factor", "delay_s", "lag_s", "speed_noise_mps")
Interval = tuple[float, float]


class StartDistribution(NamedTuple):
    """How one episode begins, and everything about it that is not the same every time. All 0-d.

    Attributes:
        case: Row of the task's cases.
        scheduled_s: Scheduled running time.
        position_m: Where it begins.
        speed_mps: How fast.
        time_s: Time already used.
        mass_factor: True over believed mass.
        resistance_factor: True over believed Davis resistance.
        delay_s: Dead time on top of the trainset's.
        lag_s: Lag on top of the trainset's.
        speed_noise_mps: Standard deviation of the measured speed.
        news_at_s: When a new scheduled time is announced (infinite: never).
        news_s: The new scheduled time.
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
    news_at_s: Array
    news_s: Array


@dataclass(frozen=True)
class DisturbanceDistribution:
    """The distribution an episode is drawn from, each quantity even over its interval.

    Attributes:
        time_ratio: Scheduled time over the minimum of the case.
        longest_s: Longest scheduled time instead of the upper ratio.
        time_s: Scheduled time itself instead of ratios.
        mass_factor: True over believed mass.
        resistance_factor: True over believed Davis resistance.
        delay_s: Dead time on top of the trainset's.
        lag_s: Lag on top of the trainset's.
        speed_noise_mps: Standard deviation of the measured speed (cut at three deviations).
        news: Probability that the scheduled time changes on the way.
        news_at: When that is announced, as a share of the scheduled time.
        news_shift_s: By how much it changes (never below what is left of it times 0.9).
        on_the_way: Probability that an episode begins somewhere on the way, at a speed that can still stop,
            with a time left drawn like the scheduled time. Evaluate with 0.
        left_ratio: Such an episode's time left over the flat-out time to go, instead.
    """

    time_ratio: Interval = (1.05, 1.5)
    longest_s: float | None = None
    time_s: Interval | None = None
    mass_factor: Interval = (1.0, 1.0)
    resistance_factor: Interval = (1.0, 1.0)
    delay_s: Interval = (0.0, 0.0)
    lag_s: Interval = (0.0, 0.0)
    speed_noise_mps: Interval = (0.0, 0.0)
    news: float = 0.0
    news_at: Interval = (0.2, 0.6)
    news_shift_s: Interval = (-5.0, 15.0)
    on_the_way: float = 0.0
    left_ratio: Interval | None = None

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, tuple) and not value[0] <= value[1]:
                raise InputError("empty interval", field=field.name, value=str(value), allowed="low <= high")
        for name in ("news", "on_the_way"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError("no probability", field=name, value=getattr(self, name), allowed="0 to 1")
        for end in (0, 1):
            self.extreme(end)

    def extreme(self, end: int) -> Disturbance:
        """The scenario at the low (0) or high (1) end of every interval."""
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
        """What protection is told to expect: the widest the host would declare for any scenario."""
        low, high = (declared_bounds(Run(section, trainset, 1.0, self.extreme(k), dt)) for k in (0, 1))
        return replace(
            high,
            mass=(min(low.mass[0], high.mass[0]), max(low.mass[1], high.mass[1])),
            resistance=(min(low.resistance[0], high.resistance[0]), high.resistance[1]),
        )


def draw(scenarios: DisturbanceDistribution, key: Array, times_s: Array) -> StartDistribution:
    """One episode (JAX), not yet placed on the way.

    As many random numbers are made as the distribution needs, all at once: a learner resets a few of its many
    environments in every step, and pays for all of them.

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
    shares = iter(jax.random.uniform(key, (int(cases > 1) + 1 + sum(wide) + 3 * (scenarios.news > 0),)))

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
    return StartDistribution(
        case=case,
        scheduled_s=scheduled,
        position_m=zero,
        speed_mps=zero,
        time_s=zero,
        news_at_s=news_at,
        news_s=news,
        **drawn,
    )

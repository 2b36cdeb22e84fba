"""Domain randomisation: random sections with random trainsets, for policies that drive on any line.

The ranges include those of metros in service: 0.5 to 8 km, 30 to 120 km/h, gradients to 40 permil, 80 to
500 t. They are assumed and not taken from a line of the catalogue.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from metropilot.env.assists import Assists
from metropilot.env.config import DrivingConfig
from metropilot.railway import Actuation, Davis, EffortCurve, SafeBraking, Section, Station, Steps, Trainset
from metropilot.units import KMH_PER_MPS

DOMAIN_OBSERVER = "line"
DOMAIN_ASSISTS = Assists(margin_mps=0.05, stop_use=0.99, release=0.95, late=True)
"""Assists closer to the limits than the defaults, as the optimum uses the limits fully."""
GRAVITY_MPS2 = 9.81
STEEPEST_PERMIL = (6.0, 14.0, 28.0, 40.0)
PLATFORM_KMH = (45.0, 50.0, 55.0, 60.0)


@dataclass(frozen=True)
class DomainSample:
    """Random section with a random trainset.

    Attributes:
        section: Section.
        trainset: Trainset.
    """

    section: Section
    trainset: Trainset


@dataclass(frozen=True)
class DomainRandomization(DrivingConfig):
    """Driving task of random domains: the sections and trainsets form pairs in the order of their lists."""

    @property
    def cases(self) -> tuple[tuple[Section, Trainset], ...]:
        """Each section with its trainset."""
        return tuple(zip(self.sections, self.trainsets, strict=True))


def domain_sample(seed: int, number: int) -> DomainSample:
    """Sample of a seed and a number, always the same."""
    return draw_world(np.random.default_rng([seed, number]))


def draw_world(random: Generator) -> DomainSample:
    """A section and a trainset that could be somewhere."""
    section = draw_section(random)
    fastest = float(section.limit_mps.value.max())
    return DomainSample(section, draw_trainset(random, max(fastest, 60.0 / KMH_PER_MPS)))


def draw_section(random: Generator) -> Section:
    """Draw a section of 0.5 to 8 km with limits of 30 to 120 km/h and gradients to 40 permil."""
    usual = random.random() < 0.5
    low, high = (700.0, 3200.0) if usual else (500.0, 8000.0)
    length = float(np.exp(random.uniform(np.log(low), np.log(high))))
    at, permil = _gradients(random, length)
    limit_at, limit_mps = _limits(random, length)
    ends = Station("O", "Origin", 0.0), Station("D", "Destination", length)
    return Section("random", *ends, length, Steps(limit_at, limit_mps), Steps(at, permil))


def _breaks(random: Generator, start: float, end: float, low: float, high: float) -> np.ndarray:
    """Positions from a start to an end, apart by a uniform distance."""
    lengths = random.uniform(low, high, int((end - start) / low) + 1)
    at = start + np.concatenate([[0.0], np.cumsum(lengths)])
    return at[at < end]


def _gradients(random: Generator, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions and values of gradients; many sections have level stretches, some lie on a slope."""
    steepest = random.choice(STEEPEST_PERMIL, p=[0.25, 0.3, 0.3, 0.15])
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


def _limits(random: Generator, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Positions and values of limits; half of the sections have a slower zone at a platform."""
    top = random.uniform(45.0, 120.0) if length > 2500.0 else random.uniform(40.0, 95.0)
    at = _breaks(random, -200.0, length + 200.0, 150.0, 1500.0)
    share = random.choice([1.0, 1.0, 1.0, 0.85, 0.7, 0.55], size=at.size)
    kmh = np.clip(np.round(top * share), 30.0, 120.0)
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
    weight_kn = mass * GRAVITY_MPS2 * 1e-3
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

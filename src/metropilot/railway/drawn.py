"""Trainsets drawn at random, as widely as real ones differ, each by a name that says how it was drawn.

``drawn-SEED-NUMBER`` names one of them wherever a trainset is expected: the same name is the same trainset on
every machine. They are for campaigns and tests; episodes of a learner have a distribution of their own.
"""

from __future__ import annotations

import math
import re
from functools import lru_cache

import numpy as np
from numpy.random import Generator

from metropilot.railway.effort import Efficiency, EffortCurve
from metropilot.railway.trainset import Actuation, Couplers, Davis, SafeBraking, Trainset
from metropilot.units import KMH_PER_MPS, STANDARD_GRAVITY_MPS2

NAME = re.compile(r"drawn-(\d{1,9})-(\d{1,9})")
LEAST, MOST = "least", "most"
"""Loads of a drawn trainset."""
MASS_KG = (80e3, 600e3)
SPEED_KMH = (60, 160)
ACCELERATION_MPS2 = (0.4, 1.4)
DELAY_S, LAG_S = (0.0, 1.0), (0.0, 0.6)
BLENDS = ("friction", "blended", "electric first", "electric")
"""Brakes: friction alone, electric with friction, electric that suffices at low speed, electric alone."""
BLOCKS = ("mass", "body", "resistance", "traction", "electric_brake", "friction_brake", "limits", "energy")
SPEEDS = 25
"""Points of an effort curve."""


@lru_cache(maxsize=1024)
def drawn_trainset(seed: int, number: int) -> Trainset:
    """Draw a trainset, with its lightest load aboard.

    Mass 80 to 600 t, top speed 60 to 160 km/h, acceleration 0.4 to 1.4 m/s2 with either load, dead time to
    1 s and lag to 0.6 s (each is none in one of eight); every brake blend; bounds on acceleration and jerk in
    half of them.

    Args:
        seed: Seed of a family.
        number: Number in the family.
    """
    random = np.random.default_rng([seed, number])
    heavy = _log_uniform(random, 1.35 * MASS_KG[0], MASS_KG[1])
    light = max(heavy * random.uniform(0.6, 0.8), MASS_KG[0])
    light, heavy = round(light, -2), round(heavy, -2)
    rotating = float(random.choice([0.0, 0.06, 0.1]))
    top_mps = float(random.integers(SPEED_KMH[0] // 10, SPEED_KMH[1] // 10 + 1)) * 10.0 / KMH_PER_MPS
    full_kg = heavy * (1.0 + rotating)
    slowest, fastest = ACCELERATION_MPS2
    starting_mps2 = random.uniform(slowest, fastest * light / heavy) if light < heavy else slowest
    traction = _fading(random, round(full_kg * starting_mps2, -2), top_mps, (0.3, 0.7))
    service = round(float(random.uniform(0.6, 1.2)), 2)
    electric, friction_n = _brakes(random, full_kg * service, top_mps)
    weakest = min((float(electric.at(top_mps)) + friction_n) / full_kg, service)
    bounded = random.random() < 0.5
    jerk = round(float(random.uniform(0.5, 1.5)), 2) if random.random() < 0.5 else math.inf
    delay, lag = (
        0.0 if random.random() < 0.125 else round(float(random.uniform(*s)), 2) for s in (DELAY_S, LAG_S)
    )
    weight_kn = heavy * STANDARD_GRAVITY_MPS2 / 1e3
    davis = Davis(
        weight_kn * random.uniform(1.0, 3.0),
        weight_kn * 0.0622 * KMH_PER_MPS * random.uniform(0.0, 1.4),
        weight_kn * 0.0018 * KMH_PER_MPS**2 * random.uniform(0.4, 1.6) * min(1.0, (22.2 / top_mps) ** 2),
    )
    name = f"drawn-{seed}-{number}"
    return Trainset(
        name,
        f"Random trainset {number} of seed {seed}",
        {LEAST: light, MOST: heavy},
        LEAST,
        davis=davis,
        traction=traction,
        electric_brake=electric,
        length_m=float(random.choice([0.0, round(random.uniform(40.0, 200.0), 1)])),
        rotating_fraction=rotating,
        curve_formula="600/r",
        friction_brake_n=friction_n,
        service_deceleration_mps2=service,
        max_acceleration_mps2=round(float(random.uniform(0.8, 1.0) * fastest), 2) if bounded else math.inf,
        max_deceleration_mps2=round(service * float(random.uniform(1.0, 1.3)), 2) if bounded else math.inf,
        max_speed_mps=top_mps,
        efficiency_traction=Efficiency.constant(round(float(random.uniform(0.8, 0.95)), 2)),
        efficiency_braking=Efficiency.constant(round(float(random.uniform(0.7, 0.9)), 2)),
        receptivity=round(float(random.uniform(0.0, 1.0)), 2),
        auxiliary_w=round(heavy * 0.3, -3),
        actuation=Actuation(delay, lag, jerk),
        safe_braking=SafeBraking(round(max(1.0, service) + 0.2, 2), weakest, reaction_s=0.3, buildup_s=0.6),
        couplers=Couplers(),
        source=dict.fromkeys(BLOCKS, f"drawn at random by metropilot, seed {seed}, number {number}"),
        notes=("Drawn at random: no real trainset.",),
    )


def _log_uniform(random: Generator, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def _fading(random: Generator, force_n: float, top_mps: float, knee: tuple[float, float]) -> EffortCurve:
    """Effort that is even up to a knee (its share of the top speed) and falls by a power of the speed."""
    knee_mps, power = top_mps * random.uniform(*knee), random.uniform(0.9, 1.8)
    speed = np.linspace(0.0, 1.1 * top_mps, SPEEDS)
    return EffortCurve.table(
        speed, force_n * np.where(speed <= knee_mps, 1.0, (np.maximum(speed, knee_mps) / knee_mps) ** -power)
    )


def _brakes(random: Generator, full_n: float, top_mps: float) -> tuple[EffortCurve, float]:
    """Electric brake and friction force of one of the blends; together they give full braking, N."""
    blend, share = str(random.choice(BLENDS)), random.uniform(0.3, 0.8)
    enough_n = round(1.3 * full_n, -2)
    if blend == "friction":
        return EffortCurve.constant(0.0), enough_n
    if blend == "electric":
        return EffortCurve.constant(round(1.05 * full_n, -2)), 0.0
    strongest = full_n * (share if blend == "blended" else 1.05)
    return _fading(random, round(strongest, -2), top_mps, (0.5, 0.9)), enough_n

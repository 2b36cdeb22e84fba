"""One attacker against one supervisor, in NumPy: a scenario made for each guard."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from metropilot import physics
from metropilot.physics import Command
from metropilot.protection import Bounds, at_start, permitted_speed, protect, supervise
from metropilot.railway import Actuation, Restriction, SafeBraking, load_line, load_trainset

DT = 0.2
STARTS = 8
STEPS = 260


@dataclass(frozen=True)
class Scenario:
    """A plant at one corner of its bounds, and a driver who goes for the limit there.

    Attributes:
        delay_s: Dead time, declared and true.
        lag_s: Lag, declared and true.
        jerk_mps3: Jerk limit in service, declared and true.
        reaction_s: Dead time of the emergency brake, declared and true.
        emergency_jerk_mps3: Its build-up, declared and true.
        mass: True mass factor, the declared range reaching to it.
        resistance: True Davis factor, the declared range reaching to it.
        service: True share of the service brake, the declared range reaching to it.
        speed_bias_mps: The measured speed is too low by this, the declared error.
        position_bias_m: The measured position is behind by this, the declared error.
        limits: Restrictions as start, length and speed.
        zone: Where runs begin, from and to, m.
        pace: Speed at the start over the permitted one.
        policy: ``full`` traction for ever, or ``late``: full traction, and braking while overruled.
        friction: Whether there is a friction brake beside the electric one.
        length_m: Length of the trainset.
        section: Origin and destination.
    """

    delay_s: float = 0.0
    lag_s: float = 0.0
    jerk_mps3: float = float("inf")
    reaction_s: float = 0.0
    emergency_jerk_mps3: float = float("inf")
    mass: float = 1.0
    resistance: float = 1.0
    service: float = 1.0
    speed_bias_mps: float = 0.0
    position_bias_m: float = 0.0
    limits: tuple[tuple[float, float, float], ...] = ()
    zone: tuple[float, float] = (200.0, 260.0)
    pace: float = 1.0
    policy: str = "full"
    friction: bool = True
    length_m: float | None = None
    section: tuple[str, str] = ("RJ", "WYJ")

    def trainset(self):
        known = load_trainset("dkz32")
        return replace(
            known,
            friction_brake_n=known.friction_brake_n if self.friction else 0.0,
            length_m=known.length_m if self.length_m is None else self.length_m,
            actuation=Actuation(self.delay_s, self.lag_s, self.jerk_mps3),
            safe_braking=SafeBraking(1.2, 1.0, self.reaction_s, 0.0, self.emergency_jerk_mps3),
        )

    def bounds(self) -> Bounds:
        nominal = Bounds.of(self.trainset(), DT)
        return replace(
            nominal,
            mass=(min(1.0, self.mass), max(1.0, self.mass)),
            resistance=(min(1.0, self.resistance), max(1.0, self.resistance)),
            service_share=self.service,
            speed_error_mps=self.speed_bias_mps,
            position_error_m=self.position_bias_m,
        )

    def ground(self):
        section = line().section(*self.section)
        for start, length, speed in self.limits:
            section = section.with_restriction(Restriction(start, start + length, speed))
        return section

    def vehicle(self):
        known = physics.vehicle_arrays(self.trainset())
        return known._replace(
            mass_kg=known.mass_kg * self.mass,
            effective_mass_kg=known.effective_mass_kg * self.mass,
            emergency_n=known.emergency_n * self.mass,
            service_n=known.service_n * self.mass * self.service,
            davis_n=known.davis_n * self.resistance,
            brake=known.brake * self.service,
            friction_n=known.friction_n * self.service,
        )


@cache
def line():
    return load_line("yizhuang")


def limit_over(track, before, after) -> float:
    """Largest speed over the limit in one step, by the exact motion."""
    x0, x1, v0, v1 = before.position_m, after.position_m, before.speed_mps, after.speed_mps
    k = np.flatnonzero((track.limit_from_m > x0) & (track.limit_from_m <= x1))
    worst = v1 - track.limit_mps[np.searchsorted(track.limit_from_m, x1, side="right") - 1]
    for i in k:
        there = np.sqrt(v0 * v0 + (v1 * v1 - v0 * v0) * (track.limit_from_m[i] - x0) / (x1 - x0))
        worst = max(worst, there - min(track.limit_mps[i], track.limit_mps[max(i - 1, 0)]))
    return float(worst)


def same(value):
    return value


def duel(scenario: Scenario, mutate=same, believed=None, ground=same, **options) -> float:
    """Largest overspeed the driver reaches from several starts; the service curve is out of the way.

    Args:
        scenario: The attack.
        mutate: What to do to the protection (to remove a guard).
        believed: Scenario whose bounds and trainset protection is built with, if not the true one.
        ground: What protection makes of the section.
        options: Passed to :func:`protect`.
    """
    believed = believed or scenario
    section, vehicle = scenario.ground(), scenario.vehicle()
    protection = protect(ground(believed.ground()), believed.trainset(), believed.bounds(), **options)
    honest = protect(section, scenario.trainset(), scenario.bounds(), **options)
    protection = mutate(protection._replace(service=np.full_like(protection.service, 1e6)))
    track = physics.track_arrays(section, scenario.trainset())
    slots = physics.delay_steps(scenario.delay_s, DT)
    worst = -np.inf
    for start in np.linspace(*scenario.zone, STARTS):
        speed = scenario.pace * float(permitted_speed(honest, start))
        state = physics.at_rest(vehicle, delay_steps=slots, position_m=start, speed_mps=speed)
        memory = at_start(protection)
        for _ in range(STEPS):
            share = -1.0 if scenario.policy == "late" and memory.level > 0 else 1.0
            seen = (
                state.position_m - scenario.position_bias_m,
                max(state.speed_mps - scenario.speed_bias_mps, 0.0),
            )
            command, memory, _ = supervise(protection, memory, *seen, Command(np.float64(share), False))
            after = physics.step(vehicle, track, state, command, DT)
            worst = max(worst, limit_over(track, state, after))
            state = after
            if state.speed_mps <= 0:
                break
    return worst

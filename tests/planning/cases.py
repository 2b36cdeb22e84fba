"""Trainsets, sections and simulated drives for the tests of planning."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from scipy.optimize import brentq

from metropilot import physics
from metropilot.planning import Plan, build_mesh, fastest_profile, specific
from metropilot.railway import (
    Davis,
    EffortCurve,
    Section,
    Station,
    Steps,
    Trainset,
    load_line,
    load_trainset,
)


@cache
def contest(load="AW0"):
    """The reference trainset of the contest."""
    return load_trainset("dkz32-contest", load)


@cache
def yizhuang():
    return load_line("yizhuang")


def reference_section():
    """A6 to A7, the section with the published optima: 1354 m."""
    return yizhuang().section("RC", "RJ")


def simple_trainset(**changes):
    """200 t, 1 m/s2 of traction and of brakes at any speed, resistance 4 kN: closed forms exist."""
    given = {
        "id": "simple",
        "name": "simple",
        "loads": {"base": 200e3},
        "load": "base",
        "davis": Davis(4000.0, 0.0, 0.0),
        "traction": EffortCurve.constant(200e3),
        "electric_brake": EffortCurve.constant(200e3),
        "max_acceleration_mps2": float("inf"),
        "max_deceleration_mps2": float("inf"),
        "max_speed_mps": 30.0,
    }
    return Trainset(**{**given, **changes})


def simple_section(length_m=1500.0, limits=((0.0, 25.0),), gradients=((0.0, 0.0),), curves=()):
    """A section from pairs (position m, m/s) and (position m, permil)."""
    at, value = np.array(limits, dtype=float).T
    slope_at, slope = np.array(gradients, dtype=float).T
    return Section(
        line_id="made-up",
        origin=Station("A", "Alpha", 0.0),
        destination=Station("B", "Beta", length_m),
        length_m=length_m,
        limit_mps=Steps(at, value),
        gradient_permil=Steps(slope_at, slope),
        curves=curves,
    )


def random_section(rng):
    """600 to 3200 m, limits 12 to 25 m/s in zones of at least 150 m, gradients to 25 permil."""
    length = float(rng.uniform(600, 3200))
    zones = np.sort(rng.uniform(150, length - 150, rng.integers(0, 4)))
    zones = zones[np.append(True, np.diff(zones) > 150)] if zones.size else zones
    pieces = np.arange(0.0, length, float(rng.uniform(120, 500)))
    limits = [(p, rng.uniform(12, 25)) for p in (0.0, *zones)]
    return simple_section(length, limits, [(p, rng.uniform(-25, 25)) for p in pieces])


def random_trainset(rng):
    """120 to 400 t, a force and power hyperbola, brakes that may end before 1 m/s2, scattered Davis."""
    mass = float(rng.uniform(120e3, 400e3))
    force = mass * float(rng.uniform(0.75, 1.25))
    brake = mass * float(rng.uniform(0.7, 1.2))
    davis = Davis(mass * rng.uniform(0.01, 0.03), mass * rng.uniform(0, 1e-3), mass * rng.uniform(1e-4, 4e-4))
    return simple_trainset(
        loads={"base": mass, "heavy": 1.3 * mass},
        length_m=float(rng.choice([0.0, 60.0, 118.0])),
        rotating_fraction=float(rng.choice([0.0, 0.08])),
        davis=davis,
        traction=EffortCurve.force_power(force, force * rng.uniform(8, 15)),
        electric_brake=EffortCurve.force_power(brake, brake * rng.uniform(12, 25)),
        max_acceleration_mps2=1.0,
        max_deceleration_mps2=1.0,
        max_speed_mps=25.0,
    )


def lengthened(section, length_m):
    """The same track with its stop elsewhere."""
    return dataclasses.replace(section, length_m=length_m)


def limit_between_nodes(plan: Plan, trainset, section):
    """Largest excess of the plan's speed over the limit at 20 points inside every segment, m/s.

    Constant force on a segment makes v^2 linear in position.
    """
    track = physics.track_arrays(section, trainset)
    part = np.linspace(0.0, 1.0, 20, endpoint=False)[:, None] + 1e-9
    x = plan.position_m[:-1] + part * np.diff(plan.position_m)
    v = np.sqrt(plan.speed_mps[:-1] ** 2 + part * np.diff(plan.speed_mps**2))
    index = np.maximum(np.searchsorted(track.limit_from_m, x, side="right") - 1, 0)
    return float((v - track.limit_mps[index]).max())


def flat_out_speed(section, trainset):
    """The braking curve into the destination under the limits: speed over position."""
    vehicle, track = physics.vehicle_arrays(trainset), physics.track_arrays(section, trainset)
    mesh = build_mesh(vehicle, track, np.array([0.0, float(track.length_m)]), 5.0)
    table = specific(vehicle)
    energy = fastest_profile(
        table._replace(traction=np.full_like(table.traction, 1e3), acceleration=1e3), mesh
    )
    return mesh.node_m, np.sqrt(2 * energy)


def drive(section, trainset, cruise_mps, coast_from_m, dt=0.1):
    """Accelerate flat out, hold a speed, coast from a place, brake along the braking curve: with the plant.

    Returns:
        Time s, traction energy at the wheel J, where it stands m; None where it never arrives.
    """
    vehicle, track = physics.vehicle_arrays(trainset), physics.track_arrays(section, trainset)
    nodes, curve = flat_out_speed(section, trainset)
    energy = 0.5 * curve**2
    mass = float(vehicle.effective_mass_kg)
    most = float(vehicle.max_acceleration_mps2) * mass
    state = physics.at_rest(vehicle)
    for _ in range(int(600 / dt)):
        x, v = float(state.position_m), float(state.speed_mps)
        resistance, gradient = physics.resistance_and_gradient(vehicle, track, x, v)
        drag = float(resistance + gradient)
        ahead = x + v * dt
        allowed = float(np.sqrt(2 * np.interp(ahead, nodes, energy)))
        if ahead >= section.length_m - 0.3:
            allowed = 0.0
        hold = min(cruise_mps, allowed) if x < coast_from_m else allowed
        wanted = (hold - v) / dt * mass + drag
        if x >= coast_from_m:
            wanted = min(wanted, 0.0)
        force = float(np.clip(wanted, -1e9, min(most + drag, 1e9)))
        share = physics.command_for_force(vehicle, v, force)
        state = physics.step(vehicle, track, state, physics.Command(share), dt)
        if x > 1.0 and float(state.speed_mps) == 0.0:
            arrived = abs(float(state.position_m) - section.length_m) < 5.0
            at = (float(state.time_s), float(state.traction_j), float(state.position_m))
            return at if arrived else None
    return None


def coasting_optimum(length_m, time_s, mass_kg=200e3, traction=1.0, brake=1.0, drag=0.02):
    """Closed form on level track with constant forces per kg: accelerate, coast, brake; energy in J.

    With v the peak and w the speed at which braking begins, ``v^2/2a + (v^2 - w^2)/2r + w^2/2d`` is the
    way and ``v/a + (v - w)/r + w/d`` the time; eliminate w from the first, solve the second for v.
    """
    a, r, d = traction - drag, drag, brake + drag

    def braking_speed(v):
        return np.sqrt(max((v * v * (1 / a + 1 / r) - 2 * length_m) / (1 / r - 1 / d), 0.0))

    def lateness(v):
        w = braking_speed(v)
        return v / a + (v - w) / r + w / d - time_s

    lowest = np.sqrt(2 * length_m / (1 / a + 1 / r))
    highest = np.sqrt(2 * length_m / (1 / a + 1 / d))
    v = brentq(lateness, lowest, highest)
    return mass_kg * traction * v * v / (2 * a)


def fastest_without_limit(length_m, traction=1.0, brake=1.0, drag=0.02):
    """Closed form: accelerate to the middle and brake; minimum running time in s."""
    a, d = traction - drag, brake + drag
    return np.sqrt(2 * length_m * (1 / a + 1 / d))

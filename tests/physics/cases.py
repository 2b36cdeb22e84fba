"""Random sections and trainsets, and short ways to drive the plant, for the tests of physics."""

from __future__ import annotations

import numpy as np

from metropilot import physics
from metropilot.railway import (
    Actuation,
    Curve,
    Davis,
    Efficiency,
    EffortCurve,
    EffortPiece,
    Section,
    Station,
    Steps,
    Trainset,
    Tunnel,
)

FLAT = Steps(np.array([-1000.0]), np.array([0.0]))
OPEN = Steps(np.array([-1000.0]), np.array([30.0]))


def section(gradient=FLAT, limit=OPEN, length_m=2000.0, curves=(), tunnels=()):
    """A section from A to B."""
    ends = Station("A", "A", 0.0), Station("B", "B", length_m)
    return Section("test", *ends, length_m, limit, gradient, tuple(curves), tuple(tunnels))


def trainset(**changes):
    """200 t, 200 kN both ways, no resistance, no length, ideal actuation: closed forms hold."""
    plain = {
        "id": "test",
        "name": "test",
        "loads": {"full": 200e3},
        "load": "full",
        "davis": Davis(0.0, 0.0, 0.0),
        "traction": EffortCurve.constant(200e3),
        "electric_brake": EffortCurve.constant(200e3),
        "max_speed_mps": 40.0,
    }
    return Trainset(**{**plain, **changes})


def random_steps(rng, low, high, pieces=8, length_m=2000.0):
    """A profile with random breaks and values."""
    breaks = np.sort(rng.uniform(-200.0, length_m + 300.0, pieces))
    return Steps(np.concatenate([[-400.0], breaks]), rng.uniform(low, high, pieces + 1))


def random_section(rng, *, clothoids=False, gradient_permil=30.0):
    """Gradients, limits, curves and tunnels at random."""
    starts = np.sort(rng.uniform(-300.0, 2000.0, 6))
    ends = rng.uniform(-1 / 300.0, 1 / 300.0, 7)
    curves = [
        Curve(float(at), float(ends[k]), float(ends[k + 1] if clothoids else ends[k]))
        for k, at in enumerate(starts)
    ]
    tunnels = [Tunnel(200.0, float(rng.uniform(50, 400)), 22.0), Tunnel(900.0, 700.0, 40.0)]
    slopes = random_steps(rng, -gradient_permil, gradient_permil)
    return section(slopes, random_steps(rng, 10.0, 25.0), curves=curves, tunnels=tunnels)


def random_trainset(rng, *, actuation=None):
    """Anything a trainset can have, at random."""
    base = float(rng.uniform(0.05, 0.25))
    table = EffortCurve.table(np.array([0.0, 8.0, 16.0, 30.0]), np.array([1.0, 0.9, 0.5, 0.2]) * 250e3)
    hyperbola = EffortCurve.force_power(220e3, 220e3 * rng.uniform(8, 14))
    brake = EffortCurve(
        (EffortPiece(0.0, (0.0, 90e3, 0.0, 0.0), cap_n=180e3), EffortPiece(12.0, (1.8e5, -2e3, 0.0, 0.0)))
    )
    efficiency = Efficiency(
        np.array([0.0, 8.0, 20.0]), np.array([0.0, 0.5, 1.0]), rng.uniform(0.6, 0.95, (3, 3))
    )
    delay, lag, jerk = rng.uniform(0.0, 0.7), rng.uniform(0.0, 0.5), rng.uniform(0.4, 1.5)
    return trainset(
        loads={"full": float(rng.uniform(120e3, 350e3))},
        length_m=float(rng.choice([0.0, 60.0, 118.0, 180.0])),
        rotating_fraction=float(rng.uniform(0.0, 0.1)),
        davis=Davis(0.02 * base, 0.002 * base, 0.002 * base, per_mass=True),
        curve_formula=str(rng.choice(["none", "600/r", "6.3/(r-55)"])),
        tunnel_n_per_mps2=((20.0, 9.0), (30.0, 5.0)) if rng.random() < 0.5 else (),
        traction=table if rng.random() < 0.5 else hyperbola,
        electric_brake=brake,
        friction_brake_n=float(rng.uniform(0.0, 150e3)),
        service_deceleration_mps2=float(rng.choice([0.9, np.inf])),
        adhesion=float(rng.choice([0.08, np.inf])),
        efficiency_traction=efficiency,
        efficiency_braking=Efficiency.constant(0.85),
        receptivity=0.7,
        auxiliary_w=1e5,
        actuation=actuation or Actuation(float(delay), float(lag), float(jerk)),
    )


def random_commands(rng, count=600, hold=12):
    """Commands that change every ``hold`` steps and end in braking to a stand."""
    share = np.repeat(rng.uniform(-1.0, 1.0, -(-count // hold)), hold)[:count]
    share[: count // 3] = np.abs(share[: count // 3])
    share[-count // 5 :] = -0.8
    return share


def drive(vehicle, track, shares, dt, state=None, integrator="held", delay_steps=0):
    """States of the NumPy plant, the first before the first command."""
    states = [physics.at_rest(vehicle, delay_steps=delay_steps) if state is None else state]
    for share in shares:
        command = physics.Command(share, False)
        states.append(physics.step(vehicle, track, states[-1], command, dt, integrator))
    return states


def plant(section, trainset, dtype=np.float64, **sizes):
    """Vehicle and track of a section and a trainset."""
    return physics.vehicle_arrays(trainset, dtype), physics.track_arrays(section, trainset, dtype, **sizes)

"""Closed forms of motion: stopping distance, terminal speed, holding, work and energy."""

import numpy as np
import pytest
from scipy.optimize import brentq
from tests.physics import cases

from metropilot import physics
from metropilot.railway import Davis, EffortCurve, Steps


@pytest.mark.parametrize("integrator", sorted(set(physics.INTEGRATORS) - {"euler"}))  # Euler is not exact
@pytest.mark.parametrize("dt", [0.05, 0.1, 0.3, 1.0, 7.0])
def test_stops_exactly_inside_a_step(dt, integrator):
    vehicle, track = cases.plant(cases.section(), cases.trainset())
    start = physics.at_rest(vehicle, position_m=100.0, speed_mps=17.0)
    # 200 kN on 200 t: b = 1 m/s2, so v^2/2b = 144.5 m and v/b = 17 s
    states = cases.drive(vehicle, track, np.full(int(17.0 / dt) + 1, -1.0), dt, start, integrator)
    stop = next(s for s in states if s.speed_mps == 0)
    assert stop.position_m - 100.0 == pytest.approx(144.5, rel=1e-12)
    assert stop.time_s == pytest.approx(17.0, rel=1e-12)
    assert stop.electric_brake_j == pytest.approx(0.5 * 200e3 * 17.0**2)


@pytest.mark.parametrize("load_kg", [150e3, 250e3])
def test_terminal_speed_is_where_traction_equals_resistance(load_kg):
    trainset = cases.trainset(
        loads={"full": load_kg},
        davis=Davis(0.02, 0.002, 0.0004, per_mass=True),
        traction=EffortCurve.force_power(200e3, 1.2e6),
        curve_formula="600/r",
        length_m=100.0,
    )
    slope = Steps(np.array([-1000.0]), np.array([5.0]))
    vehicle, track = cases.plant(cases.section(slope), trainset)
    start = physics.at_rest(vehicle, position_m=200.0, speed_mps=15.0)
    end = cases.drive(vehicle, track, np.full(1500, 1.0), 1.0, start)[-1]
    expected = brentq(
        lambda v: 1.2e6 / v - load_kg * (0.02 + 0.002 * v + 0.0004 * v**2 + 9.81 * 0.005), 5.0, 40.0
    )
    assert end.speed_mps == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_work_is_kinetic_plus_potential_energy_plus_losses(seed):
    rng = np.random.default_rng(100 + seed)
    section, trainset = cases.random_section(rng), cases.random_trainset(rng)
    vehicle, track = cases.plant(section, trainset)
    states = cases.drive(vehicle, track, cases.random_commands(rng), 0.2, delay_steps=8)
    moved = np.diff([s.position_m for s in states])
    force = {name: np.array([getattr(s.forces, name) for s in states[1:]]) for name in physics.Forces._fields}
    speed = np.array([s.speed_mps for s in states])
    kinetic = 0.5 * trainset.effective_mass_kg * np.diff(speed**2)
    work = {name: values * moved for name, values in force.items()}
    balance = work["traction_n"] - sum(work[name] for name in physics.Forces._fields[1:]) - kinetic
    assert np.abs(balance).max() < 1e-6 * work["traction_n"].max()
    assert states[-1].traction_j == pytest.approx(work["traction_n"].sum())
    assert states[-1].electric_brake_j == pytest.approx(work["electric_brake_n"].sum())


def test_climbing_costs_the_weight_times_the_height():
    # 10 permil for 1000 m, the point mass starts and ends on the level: potential energy m g 10 m
    slope = Steps(np.array([-1000.0, 300.0, 1300.0]), np.array([0.0, 10.0, 0.0]))
    trainset = cases.trainset(length_m=120.0)
    vehicle, track = cases.plant(cases.section(slope), trainset)
    start = physics.at_rest(vehicle, position_m=250.0, speed_mps=20.0)
    end = cases.drive(vehicle, track, np.full(600, 0.5), 0.1, start, "rk4")[-1]
    assert end.position_m > 1450.0
    kinetic = 0.5 * trainset.effective_mass_kg * (end.speed_mps**2 - 20.0**2)
    assert end.traction_j - kinetic == pytest.approx(200e3 * 9.81 * 10.0, rel=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_effective_mass_times_acceleration_is_the_balance_of_forces(seed):
    rng = np.random.default_rng(200 + seed)
    section, trainset = cases.random_section(rng), cases.random_trainset(rng)
    vehicle, track = cases.plant(section, trainset)
    for s in cases.drive(vehicle, track, cases.random_commands(rng), 0.2, delay_steps=8)[1:]:
        f = s.forces
        balance = f.traction_n - f.electric_brake_n - f.friction_brake_n - f.resistance_n - f.gradient_n
        assert trainset.effective_mass_kg * s.acceleration_mps2 == pytest.approx(balance, abs=1e-6)


@pytest.mark.parametrize("permil", [40.0, -40.0])
@pytest.mark.parametrize("share", [0.0, -0.3, -1.0])
def test_a_standing_trainset_stands_on_any_gradient(permil, share):
    slope = Steps(np.array([-1000.0]), np.array([permil]))
    trainset = cases.trainset(length_m=120.0, davis=Davis(3e3, 0.0, 0.0))
    vehicle, track = cases.plant(cases.section(slope), trainset)
    end = cases.drive(vehicle, track, np.full(50, share), 0.2)[-1]
    assert (end.position_m, end.speed_mps, end.acceleration_mps2) == (0.0, 0.0, 0.0)
    assert end.time_s == pytest.approx(10.0)
    # what holds it is the weight on the slope: 200 t * 9.81 * 0.04 = 78.48 kN
    assert end.forces.friction_brake_n == pytest.approx(-np.sign(permil) * 78.48e3)


def test_on_a_rising_gradient_it_starts_once_traction_beats_weight_and_resistance():
    slope = Steps(np.array([-1000.0]), np.array([40.0]))
    vehicle, track = cases.plant(cases.section(slope), cases.trainset(davis=Davis(3e3, 0.0, 0.0)))
    needed = (78.48e3 + 3e3) / 200e3
    assert cases.drive(vehicle, track, [needed - 1e-3], 0.2)[-1].speed_mps == 0.0
    assert cases.drive(vehicle, track, [needed + 1e-3], 0.2)[-1].speed_mps > 0.0


def test_a_coasting_trainset_on_the_level_slows_by_resistance_alone():
    vehicle, track = cases.plant(cases.section(), cases.trainset(davis=Davis(4e3, 0.0, 0.0)))
    start = physics.at_rest(vehicle, speed_mps=10.0)
    end = cases.drive(vehicle, track, np.zeros(100), 0.1, start)[-1]
    assert end.speed_mps == pytest.approx(10.0 - 4e3 / 200e3 * 10.0)
    assert end.line_j == 0.0

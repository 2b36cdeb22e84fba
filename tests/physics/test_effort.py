"""Effort curves, adhesion, blending of the brakes, efficiency maps and energies."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from tests.physics import cases

from metropilot import physics
from metropilot.physics import map_value
from metropilot.railway import Efficiency, EffortCurve, EffortPiece, load_trainset

SPEEDS = np.linspace(0.0, 25.0, 301)
CURVES = {
    "constant": EffortCurve.constant(150e3),
    "hyperbola": EffortCurve.force_power(200e3, 1.8e6),
    "table": EffortCurve.table(np.array([0.0, 5.0, 15.0, 20.0]), np.array([200e3, 190e3, 90e3, 0.0])),
    "contest": load_trainset("dkz32").traction,
    "contest brake": load_trainset("dkz32").electric_brake,
    "falls to zero": EffortCurve((EffortPiece(0.0, (1e5, -1e4, 0.0, 0.0)),)),
}


@pytest.mark.parametrize("name", CURVES)
def test_curves_are_the_railway_layers_own(name):
    curve = CURVES[name]
    vehicle = physics.vehicle_arrays(cases.trainset(traction=curve, electric_brake=curve))
    expected = curve.at(SPEEDS)
    traction = [physics.traction_available_n(vehicle, v) for v in SPEEDS]
    electric = [physics.electric_available_n(vehicle, v) for v in SPEEDS]
    np.testing.assert_allclose(traction, expected, rtol=1e-12)
    np.testing.assert_allclose(electric, expected, rtol=1e-12)


def test_a_compiled_supervisor_reads_a_curve_of_many_pieces():
    """An export ended with an internal error: a constant was indexed by what is only traced."""
    curve = EffortCurve.table(np.linspace(0.0, 20.0, 7), np.linspace(2e5, 5e4, 7))
    vehicle = physics.vehicle_arrays(cases.trainset(traction=curve))
    with physics.double_precision():
        compiled = jax.jit(lambda speed: physics.traction_available_n(vehicle, speed))
        found = [float(compiled(jnp.float64(v))) for v in SPEEDS[::20]]
    np.testing.assert_allclose(found, curve.at(SPEEDS[::20]), rtol=1e-12)


def test_a_piece_begins_exactly_at_its_speed():
    curve = EffortCurve((EffortPiece(0.0, (2e5, 0.0, 0.0, 0.0)), EffortPiece(10.0, (1e5, 0.0, 0.0, 0.0))))
    vehicle = physics.vehicle_arrays(cases.trainset(traction=curve))
    at = [float(physics.traction_available_n(vehicle, v)) for v in (np.nextafter(10.0, 0.0), 10.0)]
    assert at == [2e5, 1e5]


def test_adhesion_caps_every_wheel_force():
    # 0.05 * 200 t * 9.81 = 98.1 kN
    trainset = cases.trainset(adhesion=0.05, friction_brake_n=300e3)
    vehicle = physics.vehicle_arrays(trainset)
    for force in (physics.traction_available_n, physics.electric_available_n, physics.brake_available_n):
        assert force(vehicle, 5.0) == pytest.approx(98.1e3)


def test_full_brake_is_the_service_rate_where_blending_can_give_it():
    trainset = cases.trainset(rotating_fraction=0.1, friction_brake_n=100e3, service_deceleration_mps2=1.0)
    vehicle = physics.vehicle_arrays(trainset)
    assert physics.brake_available_n(vehicle, 10.0) == pytest.approx(220e3)  # of 300 kN: 1 m/s2 on 220 t


@pytest.mark.parametrize("speed", [0.0, 4.0, 19.0])
@pytest.mark.parametrize("share", [-1.0, -0.4, 0.0, 0.7, 1.0])
def test_command_and_force_are_inverse(speed, share):
    vehicle = physics.vehicle_arrays(load_trainset("dkz32"))
    force = physics.effort_at(vehicle, speed).force_n(share)
    assert physics.command_for_force(vehicle, speed, force) == pytest.approx(share)
    assert physics.command_for_force(vehicle, speed, 1e9) == 1.0
    assert physics.command_for_force(vehicle, speed, -1e9) == -1.0


def test_braking_is_electric_first_and_friction_the_rest():
    trainset = cases.trainset(electric_brake=EffortCurve.constant(80e3), friction_brake_n=120e3)
    vehicle, track = cases.plant(cases.section(), trainset)
    start = physics.at_rest(vehicle, speed_mps=15.0)
    for share, electric, friction in ((-0.3, 60e3, 0.0), (-0.4, 80e3, 0.0), (-1.0, 80e3, 120e3)):
        forces = cases.drive(vehicle, track, [share], 0.1, start)[-1].forces
        assert forces.electric_brake_n == pytest.approx(electric)
        assert forces.friction_brake_n == pytest.approx(friction, abs=1e-6)


MAP = Efficiency(
    np.array([0.0, 5.0, 12.0, 22.0]),
    np.array([0.0, 0.4, 1.0]),
    np.array([[0.5, 0.6, 0.55], [0.7, 0.8, 0.78], [0.75, 0.9, 0.88], [0.7, 0.86, 0.9]]),
)


@pytest.mark.parametrize(("speed", "share"), [(0.0, 0.0), (5.0, 0.4), (7.3, 0.61), (30.0, 1.4), (21.9, 0.99)])
def test_efficiency_maps_are_bilinear_and_held_outside(speed, share):
    vehicle = physics.vehicle_arrays(cases.trainset(efficiency_traction=MAP))
    table = RegularGridInterpolator((MAP.speed_mps, MAP.effort_share), MAP.value)
    expected = table([min(speed, 22.0), min(share, 1.0)])[0]
    assert map_value(vehicle, vehicle.efficiency_traction, speed, share) == pytest.approx(expected)


def test_line_energy_is_traction_over_efficiency_plus_auxiliaries_less_what_the_line_takes():
    trainset = cases.trainset(
        efficiency_traction=Efficiency.constant(0.8),
        efficiency_braking=Efficiency.constant(0.9),
        receptivity=0.5,
        auxiliary_w=60e3,
    )
    vehicle, track = cases.plant(cases.section(), trainset)
    # 10 s at 1 m/s2 up to 10 m/s over 50 m, then down again: 10 MJ at the wheel each way
    end = cases.drive(vehicle, track, np.repeat([1.0, -1.0], 100), 0.1)[-1]
    assert end.traction_j == pytest.approx(10e6)
    assert end.electric_brake_j == pytest.approx(10e6)
    assert end.recovered_j == pytest.approx(10e6 * 0.9 * 0.5)
    assert end.line_j == pytest.approx(10e6 / 0.8 + 60e3 * 20.0 - 4.5e6)


def test_a_map_costs_what_its_efficiency_at_the_mean_speed_and_share_says():
    trainset = cases.trainset(efficiency_traction=MAP)
    vehicle, track = cases.plant(cases.section(), trainset)
    start = physics.at_rest(vehicle, speed_mps=9.0)
    end = cases.drive(vehicle, track, [0.5], 0.2, start)[-1]
    mean = 0.5 * (9.0 + end.speed_mps)
    expected = RegularGridInterpolator((MAP.speed_mps, MAP.effort_share), MAP.value)([mean, 0.5])[0]
    assert end.traction_j / end.line_j == pytest.approx(expected)

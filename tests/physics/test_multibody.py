"""The multi-body trainset: conservation, closed forms, and the single mass as its limit."""

import numpy as np
import pytest
from tests.physics import cases

from metropilot import physics
from metropilot.errors import InputError
from metropilot.physics.multibody import solve_tridiagonal
from metropilot.railway import Couplers, Davis, Steps

FORCE_N = 200e3


def multibody(couplers, motors=None, gradient=cases.FLAT, **changes):
    trainset = cases.trainset(length_m=120.0, couplers=couplers, **changes)
    vehicles = physics.consist(trainset, motors=motors)
    return vehicles, physics.track_arrays(cases.section(gradient), trainset), physics.bodies_at(vehicles)


def advance(vehicles, track, bodies, force_n, dt, steps, count=None):
    count = count or physics.substeps(vehicles, dt)
    rows = [bodies]
    for _ in range(steps):
        rows.append(physics.multibody_step(vehicles, track, rows[-1], force_n, dt, count))
    return rows


def shaken(vehicles, bodies):
    rng = np.random.default_rng(0)
    return bodies._replace(
        speed_mps=rng.uniform(4.0, 6.0, bodies.speed_mps.shape),
        extension_m=rng.uniform(-0.03, 0.03, bodies.extension_m.shape),
    )


def momentum(vehicles, bodies):
    return float(np.sum(vehicles.vehicles.effective_mass_kg * bodies.speed_mps))


def energy(vehicles, bodies):
    kinetic = 0.5 * np.sum(vehicles.vehicles.effective_mass_kg * bodies.speed_mps**2)
    return float(kinetic + 0.5 * np.sum(vehicles.stiffness_n_per_m * bodies.extension_m**2))


@pytest.mark.parametrize("count", [1, 7])
def test_momentum_and_energy_are_conserved_without_damping_and_outer_forces(count):
    vehicles, track, bodies = multibody(Couplers(6, 5e6, 0.0))
    rows = advance(vehicles, track, shaken(vehicles, bodies), 0.0, 0.1, 200, count)
    for quantity in (momentum, energy):
        values = np.array([quantity(vehicles, row) for row in rows])
        np.testing.assert_allclose(values, values[0], rtol=1e-11)
    assert np.ptp([row.extension_m[0] for row in rows]) > 0.01  # it does swing


def test_damping_takes_energy_and_keeps_momentum():
    vehicles, track, bodies = multibody(Couplers(6, 5e6, 2e5))
    rows = advance(vehicles, track, shaken(vehicles, bodies), 0.0, 0.1, 200)
    energies = np.array([energy(vehicles, row) for row in rows])
    assert (np.diff(energies) <= 1e-6).all()
    assert momentum(vehicles, rows[-1]) == pytest.approx(momentum(vehicles, rows[0]))
    np.testing.assert_allclose(rows[-1].speed_mps, rows[-1].speed_mps.mean(), atol=1e-3)


@pytest.mark.parametrize("motors", [[0], [5], [0, 2, 4], None])
def test_coupler_forces_of_a_uniformly_accelerated_trainset(motors):
    vehicles, track, bodies = multibody(Couplers(6, 5e6, 5e5), motors)
    end = advance(vehicles, track, bodies, FORCE_N, 0.2, 100)[-1]
    # the coupler behind vehicle j pulls what the vehicles after it need beyond their own traction:
    # T_j = sum over i > j of (m_i / M - lambda_i) F
    share = np.full(6, 1 / 6) - vehicles.traction_share
    expected = FORCE_N * np.cumsum(share[::-1])[::-1][1:]
    np.testing.assert_allclose(end.coupler_n, expected, atol=0.002 * FORCE_N)
    assert end.speed_mps.mean() == pytest.approx(20.0 * FORCE_N / 200e3)


def test_braking_on_every_vehicle_leaves_the_couplers_slack():
    vehicles, track, bodies = multibody(Couplers(6, 5e6, 5e5), motors=[0])
    moving = bodies._replace(speed_mps=np.full(6, 20.0))
    end = advance(vehicles, track, moving, -FORCE_N, 0.2, 50)[-1]
    np.testing.assert_allclose(end.coupler_n, 0.0, atol=1.0)
    assert end.speed_mps.mean() == pytest.approx(10.0)


SLOPES = Steps(np.array([-1000.0, 60.0, 150.0, 320.0]), np.array([0.0, 20.0, -15.0, 5.0]))
DAVIS = Davis(0.02, 0.001, 0.0003, per_mass=True)


def force_at(step):
    return FORCE_N if step < 100 else (0.0 if step < 150 else -0.8 * FORCE_N)


def departure_from_single_mass(stiffness):
    """Largest distance between the centre of mass and the plant's single mass, start to near the stop, m."""
    many, track, bodies = multibody(Couplers(6, stiffness, 0.1 * stiffness), [0, 3], SLOPES, davis=DAVIS)
    one, _, single = multibody(Couplers(1), None, SLOPES, davis=DAVIS)
    count, worst = physics.substeps(many, 0.1), 0.0
    for step in range(230):
        bodies = physics.multibody_step(many, track, bodies, force_at(step), 0.1, count)
        single = physics.multibody_step(one, track, single, force_at(step), 0.1, count)
        worst = max(worst, abs(float(physics.centre_of_mass_m(many, bodies) - single.position_m)))
    assert single.position_m > 120.0
    return worst


def test_it_becomes_the_single_mass_as_the_couplers_stiffen():
    worst = [departure_from_single_mass(stiffness) for stiffness in (1e5, 1e6, 1e7)]
    assert worst[0] > 2 * worst[1] > 4 * worst[2], worst
    assert worst[2] < 3e-3


@pytest.mark.parametrize("dt", [0.05, 0.2, 0.5])
def test_its_single_mass_is_the_plant(dt):
    """One vehicle, one substep: the plant's own step with its force held."""
    trainset = cases.trainset(length_m=120.0, davis=DAVIS)
    vehicle, track = cases.plant(cases.section(SLOPES), trainset)
    share = [1.0] * round(10.0 / dt) + [0.0] * round(5.0 / dt) + [-1.0] * round(6.0 / dt)
    plant = cases.drive(vehicle, track, share, dt)[-1]
    one = physics.consist(trainset)
    bodies = physics.bodies_at(one)
    for u in share:
        bodies = physics.multibody_step(one, track, bodies, u * FORCE_N, dt, 1)
    assert bodies.position_m == pytest.approx(float(plant.position_m), rel=1e-9)
    assert bodies.speed_mps[0] == pytest.approx(float(plant.speed_mps), rel=1e-9)


@pytest.mark.parametrize("stiffness", [1e7, 1e10, 1e13])
def test_any_stiffness_is_stable_with_any_number_of_substeps(stiffness):
    vehicles, track, bodies = multibody(Couplers(8, stiffness, 0.0), motors=[0])
    for count in (1, 3):
        rows = advance(vehicles, track, bodies, FORCE_N, 0.5, 200, count)
        assert momentum(vehicles, rows[-1]) == pytest.approx(FORCE_N * 100.0)
        assert max(np.ptp(row.speed_mps) for row in rows) < 10.0


def test_the_substep_rule_resolves_the_fastest_coupler_mode():
    vehicles, _, _ = multibody(Couplers(6, 5e6, 1e5))
    mass = 200e3 / 6
    laplacian = 2 * np.eye(6) - np.eye(6, k=1) - np.eye(6, k=-1)
    laplacian[0, 0] = laplacian[-1, -1] = 1.0
    fastest = np.sqrt(5e6 / mass * np.linalg.eigvalsh(laplacian).max())
    assert fastest * 0.2 / physics.substeps(vehicles, 0.2) <= 1.0


def test_brakes_stop_every_vehicle_and_push_none_back():
    steep = Steps(np.array([-1000.0]), np.array([-30.0]))
    vehicles, track, bodies = multibody(Couplers(6, 5e6, 5e5), [0], steep)
    moving = bodies._replace(speed_mps=np.full(6, 5.0))
    rows = advance(vehicles, track, moving, -FORCE_N, 0.1, 200)
    speeds = np.array([row.speed_mps for row in rows])
    assert speeds.min() > -0.01
    np.testing.assert_allclose(speeds[-1], 0.0, atol=1e-9)
    assert rows[-1].position_m == pytest.approx(rows[-50].position_m, abs=1e-9)


def test_each_vehicle_meets_the_slope_of_its_own_place():
    # the head is on the slope, the tail is not: a free trainset is stretched where the slope begins
    half = Steps(np.array([-1000.0, -60.0]), np.array([0.0, -20.0]))
    vehicles, track, bodies = multibody(Couplers(6, 5e6, 5e5), None, half)
    end = advance(vehicles, track, bodies, 0.0, 0.05, 40)[-1]
    # half of the mass is pulled by its weight on 20 permil: the middle coupler carries m/2 * (g i - g i / 2)
    assert end.coupler_n[2] == pytest.approx(100e3 * 9.81 * 0.02 / 2, rel=0.15)
    assert (end.coupler_n > 0).all()


def test_heads_are_a_vehicle_length_apart():
    vehicles, _, bodies = multibody(Couplers(6, 5e6, 5e5))
    stretched = bodies._replace(position_m=np.float64(100.0), extension_m=np.full(5, 0.01))
    np.testing.assert_allclose(np.diff(physics.heads_m(vehicles, stretched)), -20.01)
    assert physics.centre_of_mass_m(vehicles, stretched) == pytest.approx(100.0 - 0.01 * 2.5)


def test_numpy_and_jax_agree():
    import jax

    vehicles, track, bodies = multibody(Couplers(6, 5e6, 5e5), [0, 3], SLOPES, davis=DAVIS)
    count = physics.substeps(vehicles, 0.2)
    ours = advance(vehicles, track, bodies, FORCE_N, 0.2, 20, count)[-1]
    with physics.double_precision():
        constants = physics.to_jax((vehicles, track))
        step = jax.jit(lambda b, f: physics.multibody_step(*constants, b, f, 0.2, count))
        theirs = physics.to_jax(bodies)
        for _ in range(20):
            theirs = step(theirs, FORCE_N)
        for mine, other in zip(ours, theirs, strict=True):
            np.testing.assert_allclose(np.asarray(other), mine, rtol=1e-9, atol=1e-9)


def test_tridiagonal_systems_are_solved():
    rng = np.random.default_rng(2)
    beside, diagonal, right = rng.uniform(-1, 1, 6), rng.uniform(3, 4, 7), rng.uniform(-1, 1, 7)
    matrix = np.diag(diagonal) + np.diag(beside, 1) + np.diag(beside, -1)
    np.testing.assert_allclose(solve_tridiagonal(beside, diagonal, right), np.linalg.solve(matrix, right))


def test_a_motor_car_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="no such vehicle"):
        physics.consist(cases.trainset(couplers=Couplers(3)), motors=[3])

"""The precise stop: closed forms of its curve, then batches of stops on plants known and unknown."""

import math
from dataclasses import replace

import numpy as np
import pytest

from metropilot.control import (
    Model,
    StopCurve,
    braking_distance,
    comfortable_deceleration,
    curve_for,
    initial_estimate,
    look_ahead,
    record_command,
    release,
    required_deceleration,
    required_with_build_up,
    stop_command,
    update_estimate,
    weakest_gradient,
)
from metropilot.physics import Command, at_rest, delay_steps, step, track_arrays, vehicle_arrays
from metropilot.railway import Actuation, Section, Station, Steps, load_trainset
from metropilot.railway import Curve as Bend
from metropilot.sim import Disturbance

DT = 0.2
LENGTH_M = 900.0
IDEAL = Actuation()


def rolled_out(speed, curve, final, dt=1e-4):
    """Distance to come down from a speed, by integrating the curve in small steps from its end backward."""
    v, a, x = final, curve.end_mps2, 0.0
    while v < speed:
        x += v * dt + 0.5 * a * dt * dt
        v += a * dt
        a = min(a + curve.release_jerk_mps3 * dt, curve.deceleration_mps2)
    return x


@pytest.mark.parametrize("final", [0.0, 6.0])
@pytest.mark.parametrize("speed", [6.5, 9.0, 20.0])
def test_braking_distance_is_the_integral_of_its_curve(speed, final):
    curve = StopCurve(0.8, math.inf, 0.5, 0.05)
    assert braking_distance(speed, curve, final) == pytest.approx(rolled_out(speed, curve, final), rel=1e-3)


def test_without_jerk_limit_it_is_the_square_law():
    curve = StopCurve(1.0, math.inf, math.inf, 1.0)
    assert braking_distance(20.0, curve) == 200.0
    assert required_deceleration(20.0, 250.0, curve) == (0.8, 0.0)


@pytest.mark.parametrize("final", [0.0, 6.0])
@pytest.mark.parametrize("deceleration", [0.3, 0.7, 1.0])
def test_required_deceleration_inverts_braking_distance(deceleration, final):
    curve = StopCurve(deceleration, math.inf, 0.5, 0.05)
    distance = braking_distance(20.0, curve, final)
    assert required_deceleration(20.0, distance, curve, final)[0] == pytest.approx(deceleration, abs=1e-5)


@pytest.mark.parametrize("acceleration", [-0.3, 0.0, 0.4])
@pytest.mark.parametrize(("speed", "distance"), [(1.1, 1.5), (1.1, 0.6), (0.5, 0.3), (15.0, 120.0)])
def test_the_build_up_takes_no_less_than_braking_at_once_would(speed, distance, acceleration):
    # 1.5 m before the mark at 1.1 m/s the fixed point ended at next to nothing
    curve = StopCurve(0.9, 0.5, 0.25, 0.1)
    at_once, _ = required_deceleration(speed, distance, curve)
    required, _ = required_with_build_up(speed, acceleration, distance, curve)
    assert at_once <= required <= 3.0


def test_release_ends_with_what_it_should():
    # v = (a + e) T / 2 and S = T^2 (a/6 + e/3) from a = 0.7, e = 0.1, T = 2.
    now, left = release(0.8, 4 * (0.7 / 6 + 0.1 / 3), 0.1)
    assert (now, left) == (pytest.approx(0.7), pytest.approx(2.0))


def section_of(rng):
    """A section that is straight, with gradients up to 24 permil that change before the stop."""
    at = np.concatenate([[0.0], np.sort(rng.uniform(LENGTH_M - 400.0, LENGTH_M, rng.integers(1, 4)))])
    gradient = Steps(at, rng.uniform(-24.0, 24.0, at.size))
    ends = Station("A", "A", 0.0), Station("B", "B", LENGTH_M)
    return Section(
        "test", *ends, LENGTH_M, Steps(np.zeros(1), np.array([23.0])), gradient, (Bend(-300.0, 0.0, 0.0),)
    )


def drive_to_stop(trainset, scenario, seed):
    """Hold a random speed, then stop: the error, and the largest jerk from the onset to the stand."""
    rng = np.random.default_rng(seed)
    section, speed = section_of(rng), rng.uniform(5.0, 22.0)
    actual = scenario.true_plant(trainset)
    model = Model(vehicle_arrays(trainset), track_arrays(section, trainset), DT)
    # The worst brake does not weigh its load: 100 % is what it is for the nominal mass.
    vehicle = vehicle_arrays(actual)._replace(service_n=model.vehicle.service_n)
    start = LENGTH_M - speed * speed / 0.9 - 4.0 * speed - 30.0
    state = at_rest(
        vehicle, delay_steps=delay_steps(float(vehicle.delay_s), DT), position_m=start, speed_mps=speed
    )
    estimate, gradient = initial_estimate(model, start, speed), weakest_gradient(model, LENGTH_M)
    track = track_arrays(section, actual)
    held, rows = 0.0, [0.0]
    while state.speed_mps > 0:
        noise = scenario.speed_noise_mps * np.clip(rng.standard_normal(), -3, 3)
        seen = (
            float(state.position_m),
            max(float(state.speed_mps + noise), 0.0),
            float(state.acceleration_mps2),
        )
        estimate = update_estimate(model, estimate, *seen)
        comfortable = held or comfortable_deceleration(model, estimate, gradient)
        ahead = look_ahead(model, estimate)
        stop = stop_command(model, ahead, LENGTH_M, curve_for(model.vehicle, DT, comfortable))
        if held or stop.required_mps2 >= comfortable:
            held, share = comfortable, stop.share
        else:
            share = ahead.share_for(float(np.clip(0.5 * (speed - ahead.speed_mps), -0.5, 0.9)))
        estimate = record_command(estimate, share)
        state = step(vehicle, track, state, Command(np.float64(share), False), DT)
        if held:
            rows.append(float(state.acceleration_mps2))
    change = np.abs(np.diff([*rows[1:], 0.0]))
    return float(state.position_m) - LENGTH_M, float(change.max()) / DT


@pytest.fixture(scope="module")
def dkz32():
    return load_trainset("dkz32")


def test_ideal_actuation_stops_on_the_point(dkz32):
    errors = [drive_to_stop(dkz32.ideal(), Disturbance(), seed)[0] for seed in range(8)]
    assert np.abs(errors).max() < 0.002


@pytest.mark.parametrize("jerk", [1.0, 0.75])
def test_jerk_limit_holds_to_the_last_step(dkz32, jerk):
    trainset = replace(dkz32, actuation=Actuation(jerk_limit_mps3=jerk))
    errors, jerks = np.array([drive_to_stop(trainset, Disturbance(), seed) for seed in range(6)]).T
    assert np.abs(errors).max() < 0.01
    assert jerks.max() <= jerk + 1e-9


@pytest.mark.parametrize(
    "actuation", [IDEAL, Actuation(jerk_limit_mps3=1.0)], ids=["no jerk limit", "jerk 1.0"]
)
def test_unknown_plant_stops_within_tolerance(dkz32, actuation):
    errors = []
    for seed in range(18):
        rng = np.random.default_rng(1000 + seed)
        mass, resistance = rng.choice([-1.0, 1.0], 2) if seed % 2 else rng.uniform(-1.0, 1.0, 2)
        truth = Disturbance(
            mass_factor=1 + 0.2 * mass,
            resistance_factor=1 + 0.5 * resistance,
            delay_s=0.6 if seed % 3 else rng.uniform(0.0, 0.6),
            lag_s=0.4 if seed % 3 else rng.uniform(0.0, 0.4),
            speed_noise_mps=0.05,
        )
        errors.append(drive_to_stop(replace(dkz32, actuation=actuation), truth, seed)[0])
    assert np.median(np.abs(errors)) < 0.05
    assert np.abs(errors).max() < 0.2

"""Dead time, lag and jerk limit between a command and the wheel."""

import math
from itertools import pairwise

import numpy as np
import pytest
from tests.physics import cases

from metropilot import physics
from metropilot.railway import Actuation, SafeBraking

DT = 0.2


def shares_after(actuation, commands, dt=DT):
    trainset = cases.trainset(actuation=actuation)
    vehicle, track = cases.plant(cases.section(), trainset)
    slots = physics.delay_steps(actuation.delay_s, dt)
    start = physics.at_rest(vehicle, delay_steps=slots, speed_mps=10.0)
    return np.array([float(s.share) for s in cases.drive(vehicle, track, commands, dt, start)[1:]])


@pytest.mark.parametrize(("delay_s", "slots"), [(0.0, 0), (0.2, 1), (0.6, 3), (0.65, 4), (0.05, 1)])
def test_a_pipeline_has_the_slots_it_needs(delay_s, slots):
    assert physics.delay_steps(delay_s, DT) == slots


@pytest.mark.parametrize("periods", [0, 1, 3])
def test_a_whole_number_of_periods_is_exact(periods):
    commands = np.random.default_rng(0).uniform(-1.0, 1.0, 30)
    got = shares_after(Actuation(delay_s=periods * DT), commands)
    np.testing.assert_allclose(got, np.concatenate([np.zeros(periods), commands])[:30], atol=1e-12)


@pytest.mark.parametrize("delay_s", [0.05, 0.13, 0.5])
def test_a_fraction_of_a_period_is_the_mean_of_the_delayed_command_over_the_step(delay_s):
    commands = np.random.default_rng(1).uniform(-1.0, 1.0, 30)
    got = shares_after(Actuation(delay_s=delay_s), commands)
    fine = np.repeat(commands, 1000)
    late = round(delay_s / DT * 1000)
    expected = np.concatenate([np.zeros(late), fine])[: fine.size].reshape(30, 1000).mean(axis=1)
    np.testing.assert_allclose(got, expected, atol=1e-12)


def test_the_lag_is_exponential_for_any_period():
    for dt in (0.05, 0.2, 0.5):
        got = shares_after(Actuation(lag_s=0.8), np.ones(20), dt)
        np.testing.assert_allclose(got, 1.0 - np.exp(-dt * np.arange(1, 21) / 0.8), rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_acceleration_changes_no_faster_than_the_jerk_limit_while_moving(seed):
    rng = np.random.default_rng(300 + seed)
    actuation = Actuation(
        float(rng.uniform(0, 0.5)), float(rng.uniform(0, 0.3)), float(rng.uniform(0.3, 1.2))
    )
    trainset = cases.random_trainset(rng, actuation=actuation)
    # no cap but the jerk limit: on gentle slopes the force to follow it is always there
    section = cases.section(cases.random_steps(rng, -3.0, 3.0))
    vehicle, track = cases.plant(section, trainset)
    states = cases.drive(vehicle, track, cases.random_commands(rng), DT, delay_steps=3)[1:]
    pairs = [(a, b) for a, b in pairwise(states) if b.speed_mps > 0 and available(b, vehicle)]
    change = [abs(float(b.acceleration_mps2 - a.acceleration_mps2)) for a, b in pairs]
    assert len(change) > 300
    assert max(change) <= actuation.jerk_limit_mps3 * DT * (1 + 1e-9)
    assert max(change) > 0.99 * actuation.jerk_limit_mps3 * DT


def available(state, vehicle):
    """True if the wheel force was strictly inside its limits, so that only the jerk limit shaped it."""
    f = state.forces
    force = f.traction_n - f.electric_brake_n - f.friction_brake_n
    earlier = state.speed_mps - state.acceleration_mps2 * DT
    effort = physics.traction_available_n(vehicle, earlier), physics.brake_available_n(vehicle, earlier)
    return -0.999 * effort[1] < force < 0.999 * effort[0]


def test_a_command_out_of_range_counts_as_full():
    commands = np.array([5.0, -7.0, 0.5])
    np.testing.assert_array_equal(shares_after(Actuation(), commands), [1.0, -1.0, 0.5])


@pytest.mark.parametrize(("guaranteed_mps2", "expected_mps2"), [(0.3, 1.0), (1.2, 1.2)])
def test_an_emergency_takes_nothing_back_from_a_stronger_service_brake(guaranteed_mps2, expected_mps2):
    """Of 200 kN service brake on 200 t (1 m/s2) and the emergency brake the stronger one acts."""
    safe = SafeBraking(emergency_deceleration_mps2=guaranteed_mps2, reaction_s=0.4, buildup_s=0.6)
    vehicle, track = cases.plant(cases.section(), cases.trainset(safe_braking=safe))
    state = physics.at_rest(vehicle, speed_mps=20.0)
    for _ in range(10):
        state = physics.step(vehicle, track, state, physics.Command(-1.0, True), DT)
        assert -state.acceleration_mps2 >= 1.0 - 1e-9
    assert -state.acceleration_mps2 == pytest.approx(expected_mps2)


def test_brakes_are_controlled_to_a_rate_behind_dead_time_and_lag():
    """A command that leads the lag passes, and no command exceeds the rate; before, a lead was cut at it."""
    trainset = cases.trainset(actuation=Actuation(0.4, 0.6, 100.0))
    vehicle, track = cases.plant(
        cases.section(cases.random_steps(np.random.default_rng(4), -20.0, 20.0)), trainset
    )

    def decelerations(commands, most_mps2):
        state, found = physics.at_rest(vehicle, delay_steps=2, speed_mps=20.0), []
        for share in commands:
            own, most_n = physics.control_brakes(vehicle, track, state, most_mps2)
            state = physics.step(own, track, state, physics.Command(share), DT, most_brake_n=most_n)
            found.append(-float(state.acceleration_mps2))
        return np.array(found)

    leads = [-1.0, -1.0, *[-0.4] * 18]
    rate = 1.01 * decelerations(leads, np.inf).max()
    np.testing.assert_allclose(decelerations(leads, rate), decelerations(leads, np.inf), rtol=1e-12)
    full = decelerations([-1.0] * 20, rate)
    assert full.max() == pytest.approx(rate, abs=1e-3)
    assert full.max() < 0.9 * decelerations([-1.0] * 20, np.inf).max()


@pytest.mark.parametrize(("service", "jerk"), [(1.1, 0.3), (0.9, 0.3), (1.1, math.inf)])
def test_the_service_brake_never_delays_the_emergency_brake(service, jerk):
    """A service brake that asks for more, but builds up slowly, leaves the emergency brake as guaranteed."""
    safe = SafeBraking(0.8, service, emergency_jerk_mps3=2.0)
    trainset = cases.trainset(
        actuation=Actuation(jerk_limit_mps3=jerk), safe_braking=safe, service_deceleration_mps2=service
    )
    vehicle, track = cases.plant(cases.section(), trainset)
    state = physics.at_rest(vehicle, speed_mps=20.0)
    for _ in range(10):
        state = physics.step(vehicle, track, state, physics.Command(1.0), DT)
    before = float(state.acceleration_mps2)
    for k in range(1, 5):
        state = physics.step(vehicle, track, state, physics.Command(-1.0, emergency=True), DT)
        assert state.acceleration_mps2 <= max(before - 2.0 * DT * k, -0.8) + 1e-9

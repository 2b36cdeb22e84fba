"""The observer learns a plant it was not told about from a drive of half a minute."""

from dataclasses import replace

import numpy as np
import pytest

from metropilot.control import (
    Model,
    initial_estimate,
    look_ahead,
    look_along,
    record_command,
    update_estimate,
)
from metropilot.physics import Command, at_rest, delay_steps, step, track_arrays, vehicle_arrays
from metropilot.protection import Bounds, at_start, periods_in_effect, protect
from metropilot.railway import Actuation, Steps, load_line, load_trainset
from metropilot.sim import Disturbance

DT = 0.2


def driven(scenario, commands):
    """Beliefs and states of a trainset under given commands."""
    trainset, section = load_trainset("dkz32"), load_line("yizhuang").section("RC", "RJ")
    model = Model(vehicle_arrays(trainset), track_arrays(section, trainset), DT)
    actual = scenario.true_plant(trainset)
    vehicle, track = vehicle_arrays(actual), track_arrays(section, actual)
    state = at_rest(vehicle, delay_steps=delay_steps(float(vehicle.delay_s), DT))
    estimate, rng, rows = initial_estimate(model), np.random.default_rng(7), []
    for command in commands:
        noise = scenario.speed_noise_mps * np.clip(rng.standard_normal(), -3, 3)
        speed = max(float(state.speed_mps + noise), 0.0)
        estimate = update_estimate(
            model, estimate, float(state.position_m), speed, float(state.acceleration_mps2)
        )
        estimate = record_command(estimate, command)
        rows.append((estimate, state))
        state = step(vehicle, track, state, Command(np.float64(command), False), DT)
    return model, rows


COMMANDS = np.repeat([1.0, 0.0, 0.6, 0.0, -0.5, -0.7], 25)


@pytest.mark.parametrize("mass", [0.8, 1.0, 1.2])
def test_gains_delay_and_resistance_are_learned(mass):
    scenario = Disturbance(
        mass_factor=mass, resistance_factor=1.5, delay_s=0.6, lag_s=0.4, speed_noise_mps=0.05
    )
    _, rows = driven(scenario, COMMANDS)
    estimate = rows[-1][0]
    assert estimate.traction_gain == pytest.approx(1 / mass, rel=0.01)
    # The brake weighs its load: 100 % is the service rate whatever the mass.
    assert estimate.brake_gain == pytest.approx(1.0, rel=0.01)
    assert estimate.resistance_factor == pytest.approx(1.5 / mass, rel=0.05)
    plant = estimate.plant(DT)
    # One full step of the command says more of dead time and lag together than of each.
    assert plant.delay_s.value == pytest.approx(0.6, abs=0.08)
    assert plant.lag_s.value == pytest.approx(0.4, abs=0.08)
    assert plant.delay_s.value + plant.lag_s.value == pytest.approx(1.0, abs=0.05)


GENTLE = np.repeat([0.5, 1.0, 0.8, 0.0, 0.3, 0.0, -0.2, 0.1, -0.5], 15)


@pytest.mark.parametrize(("delay_s", "lag_s"), [(0.0, 0.3), (0.13, 0.0), (0.37, 0.22), (0.9, 0.5)])
def test_intervals_of_dead_time_and_lag_between_the_periods_cover_the_truth(delay_s, lag_s):
    scenario = Disturbance(
        mass_factor=1.1, resistance_factor=0.8, delay_s=delay_s, lag_s=lag_s, speed_noise_mps=0.03
    )
    _, rows = driven(scenario, GENTLE)
    plant = rows[-1][0].plant(DT)
    truth = {"mass_factor": 1.1, "resistance_factor": 0.8, "delay_s": delay_s, "lag_s": lag_s}
    for name, true in truth.items():
        found = getattr(plant, name)
        assert found.low <= true <= found.high, name
    assert plant.delay_s.value == pytest.approx(delay_s, abs=0.05)
    assert plant.lag_s.value == pytest.approx(lag_s, abs=0.05)
    assert plant.mass_factor.value == pytest.approx(1.1, rel=0.005)
    assert plant.mass_factor.sigma < 0.015
    assert plant.resistance_factor.value == pytest.approx(0.8, rel=0.05)


def test_the_interval_is_wide_before_departure_and_narrow_after_braking():
    _, rows = driven(Disturbance(mass_factor=1.1, delay_s=0.4), COMMANDS)
    before, after = rows[0][0].plant(DT), rows[-1][0].plant(DT)
    for name in before._fields:
        assert getattr(after, name).sigma < 0.5 * getattr(before, name).sigma, name
    # Before departure the nominal actuation is believed, but not for certain.
    assert before.delay_s.value == 0.0
    assert before.delay_s.high > 0.2


@pytest.mark.parametrize("noise_mps", [0.0, 0.05])
def test_noise_alone_never_contradicts_the_nominal_actuation(noise_mps):
    _, rows = driven(Disturbance(speed_noise_mps=noise_mps), np.concatenate([COMMANDS, GENTLE]))
    assert all(estimate.best == 0 for estimate, _ in rows)
    plant = rows[-1][0].plant(DT)
    assert plant.mass_factor.value == pytest.approx(1.0, abs=0.003)
    assert plant.delay_s.value == plant.lag_s.value == 0.0


@pytest.mark.parametrize(("intervention", "until_mps"), [(2, 8.0), (3, 0.05)])
def test_what_protection_brakes_is_not_learned_as_an_answer_to_the_driver(intervention, until_mps):
    """Under a lag full braking acts on after protection has let go; the driver had asked for traction."""
    trainset, section = load_trainset("cn_beijing_subway@0.6,0.4"), load_line("yizhuang").section("RC", "RJ")
    model = Model(vehicle_arrays(trainset), track_arrays(section, trainset), DT)
    state = at_rest(model.vehicle, delay_steps=delay_steps(0.6, DT))
    estimate, level, braked, after = initial_estimate(model), 0, False, 0
    while after < 40:
        x, v, a = float(state.position_m), float(state.speed_mps), float(state.acceleration_mps2)
        estimate = record_command(update_estimate(model, estimate, x, v, a, intervention=level), 0.8)
        braked |= v > 12.0
        level = intervention if braked and after == 0 and v > until_mps else 0
        after += int(braked and level == 0)
        command = Command(np.float64(-1.0 if level else 0.8), np.bool_(level == 3))
        state = step(model.vehicle, model.track, state, command, DT)
    assert float(state.speed_mps) > until_mps
    assert estimate.best == 0
    assert estimate.brake_gain == pytest.approx(1.0, abs=0.01)
    assert estimate.traction_gain == pytest.approx(1.0, abs=0.01)


def test_speed_is_filtered_tenfold():
    _, rows = driven(Disturbance(speed_noise_mps=0.05), COMMANDS)
    errors = [estimate.speed_mps - float(state.speed_mps) for estimate, state in rows[20:]]
    assert np.std(errors) < 0.01
    assert np.abs(errors).max() < 0.02


def test_look_ahead_predicts_the_state_the_command_will_meet():
    scenario = Disturbance(mass_factor=1.2, delay_s=0.6, lag_s=0.4)
    model, rows = driven(scenario, COMMANDS)
    # The estimate kept in a row has the command just given; look at the moment before.
    (estimate, _), (_, later) = rows[100], rows[103]
    ahead = look_ahead(model, estimate._replace(commands=np.append(estimate.commands[1:], 0.0)))
    assert ahead.seconds == pytest.approx(0.6)
    assert ahead.position_m == pytest.approx(float(later.position_m), abs=0.02)
    assert ahead.speed_mps == pytest.approx(float(later.speed_mps), abs=0.02)


@pytest.mark.parametrize("delay_s", [0.05, 0.1, 0.3, 0.35, 0.5])
@pytest.mark.parametrize("lag_s", [0.0, 0.3])
def test_look_ahead_reaches_the_end_of_a_dead_time_between_the_periods(delay_s, lag_s):
    trainset = load_trainset("dkz32")
    late = replace(trainset, actuation=replace(trainset.actuation, delay_s=delay_s, lag_s=lag_s))
    section = load_line("yizhuang").section("RC", "RJ")
    model = Model(vehicle_arrays(late), track_arrays(section, late), DT)
    state = at_rest(model.vehicle, delay_steps=delay_steps(delay_s, DT))
    estimate, path, ahead = initial_estimate(model), [], []
    for command in COMMANDS[:100]:
        seen = float(state.position_m), float(state.speed_mps), float(state.acceleration_mps2)
        estimate = update_estimate(model, estimate, *seen)
        path.append(seen[:2])
        ahead.append(look_ahead(model, estimate))
        estimate = record_command(estimate, command)
        state = step(model.vehicle, model.track, state, Command(np.float64(command), False), DT)
    assert ahead[-1].seconds == pytest.approx(delay_s)
    places, speeds = np.transpose(path)
    times = np.arange(len(path)) * DT
    for k in range(40, 90):
        then = times[k] + delay_s
        # a command that changes acts in a part of the last period: by at most so much
        changes = np.abs(np.diff(COMMANDS[k - 4 : k + 3])).max()
        assert ahead[k].speed_mps == pytest.approx(np.interp(then, times, speeds), abs=0.01 + 0.1 * changes)
        assert ahead[k].position_m == pytest.approx(np.interp(then, times, places), abs=0.03)


def test_look_along_predicts_the_path_of_the_commands_on_their_way():
    late = replace(load_trainset("dkz32"), actuation=replace(load_trainset("dkz32").actuation, delay_s=0.6))
    expected, driven = look_and_drive(late, load_line("yizhuang").section("RC", "RJ"))
    assert expected.shape == (2, 4)
    assert expected[0] == pytest.approx(driven[0], abs=0.02)
    assert expected[1] == pytest.approx(driven[1], abs=0.01)


def test_look_along_sees_the_gradient_ahead_not_that_underneath():
    """A point mass passes a step of the gradient at once, in the midst of the dead time."""
    late = replace(load_trainset("cn_beijing_subway"), actuation=Actuation(0.9, 0.0, 1.0))
    section, places = load_line("yizhuang").section("RC", "RJ"), np.arange(-500.0, 3000.0, 12.0)
    steep = replace(section, gradient_permil=Steps(places, np.resize([27.0, -27.0], places.size)))
    expected, driven = look_and_drive(late, steep)
    assert expected.shape == (2, 6)
    assert expected[0] == pytest.approx(driven[0], abs=0.05)
    assert expected[1] == pytest.approx(driven[1], abs=0.08)


@pytest.mark.parametrize("trainset", [load_trainset("dkz32"), load_trainset("dkz32").ideal()])
def test_look_along_ends_with_the_period_where_commands_act_at_once(trainset):
    expected, driven = look_and_drive(trainset, load_line("yizhuang").section("RC", "RJ"))
    assert expected.shape == (2, 1)
    assert expected == pytest.approx(driven, abs=0.01)


def look_and_drive(trainset, section):
    """Positions and speeds expected after some commands, and those of the drive. Shape (2, periods) each."""
    guard = protect(section, trainset, Bounds.of(trainset, DT))
    model, memory = Model(vehicle_arrays(trainset), track_arrays(section, trainset), DT), at_start(guard)
    state = at_rest(model.vehicle, delay_steps=delay_steps(trainset.actuation.delay_s, DT))
    estimate, look, commands = initial_estimate(model), None, [*COMMANDS[:40], 0.2, -0.4, 0.7]
    for command in commands:
        seen = float(state.position_m), float(state.speed_mps), float(state.acceleration_mps2)
        estimate = update_estimate(model, estimate, *seen)
        look = look_along(model, estimate, periods_in_effect(guard, memory))
        estimate = record_command(estimate, command)
        state = step(model.vehicle, model.track, state, Command(np.float64(command), False), DT)
    expected, driven = look(commands[-1]), []
    for _ in expected.T:
        driven.append((float(state.position_m), float(state.speed_mps)))
        state = step(model.vehicle, model.track, state, Command(np.float64(-1.0), False), DT)
    return expected, np.transpose(driven)


def test_a_command_is_in_effect_for_its_dead_time_and_as_a_lag_lets_go_of_it():
    section = load_line("yizhuang").section("RC", "RJ")

    def periods(trainset):
        guard = protect(section, trainset, Bounds.of(trainset, DT))
        return periods_in_effect(guard, at_start(guard))

    at_once = load_trainset("dkz32")
    assert periods(at_once) == periods(at_once.ideal()) == 1
    assert periods(replace(at_once, actuation=replace(at_once.actuation, delay_s=0.6))) == 4
    # after 0.65 s there is still a third of what a lag of 0.6 s had, after a second less than a fifth
    assert periods(replace(at_once, actuation=replace(at_once.actuation, lag_s=0.6))) == 6


def test_share_for_gives_the_acceleration_asked_for():
    model, rows = driven(Disturbance(ideal=False), COMMANDS)
    estimate, state = rows[60]
    ahead = look_ahead(model, estimate)
    share = ahead.share_for(0.3)
    after = step(model.vehicle, model.track, state, Command(np.float64(share), False), DT)
    # Within what the jerk limit lets change in one period.
    limit = float(model.vehicle.jerk_mps3) * DT
    wanted = np.clip(0.3, state.acceleration_mps2 - limit, state.acceleration_mps2 + limit)
    assert float(after.acceleration_mps2) == pytest.approx(float(wanted), abs=0.01)

"""The plant behind a log is found again, with honest intervals, or what is missing is said."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks import fit as accuracy
from tests.fit.conftest import TRUTH

from metropilot.errors import InputError
from metropilot.fit import (
    Log,
    PlantParameters,
    ambiguities,
    cut_runs,
    fit_trainset,
    read_log,
    simulate_speeds,
)
from metropilot.physics import track_arrays, vehicle_arrays


@pytest.fixture(scope="module")
def log(trajectory_file):
    return read_log(trajectory_file)


def true_parameters(vehicle, step):
    one = np.ones(1)
    davis = TRUTH["resistance_factor"] * np.asarray(vehicle.davis_n)
    keep = np.exp(-step / TRUTH["lag_s"])
    gains = (TRUTH["mass_factor"] * one, TRUTH["brake_factor"] * one)
    return PlantParameters(*gains, *(x * one for x in davis), TRUTH["delay_s"] * one, keep * one)


@pytest.mark.parametrize("source", ["command", "effort"])
@pytest.mark.parametrize("placed", [True, False])
def test_the_model_is_the_plant(log, nominal, section, source, placed):
    vehicle = vehicle_arrays(nominal)
    track = track_arrays(section, nominal) if placed else None
    runs = cut_runs([log], source, vehicle, [track])
    speeds = simulate_speeds(
        vehicle,
        runs,
        true_parameters(vehicle, runs.step_s),
        runs.speed_mps[None],
        effort=source == "effort",
    )
    assert runs.row_mps.size > 600
    assert np.abs(speeds[0] - runs.row_mps).max() < 1e-3


@pytest.fixture(scope="module")
def exact(log, nominal, section):
    return fit_trainset([log], nominal, sections=[section])


def test_a_log_without_noise_gives_the_truth(exact):
    assert exact["mass_factor"].value == pytest.approx(1.1, rel=1e-3)
    assert exact["brake_factor"].value == pytest.approx(0.9, rel=1e-3)
    assert exact["delay_s"].value == pytest.approx(0.43, abs=2e-3)
    assert exact["lag_s"].value == pytest.approx(0.3, abs=2e-3)
    for row in exact.resistance:
        assert row.value == pytest.approx(1.2 * row.nominal, rel=5e-3)


def test_what_a_log_tells_well_is_not_remarked_on(exact):
    (only,) = ambiguities(exact)
    assert only.startswith("The mass is that with the trainset's traction curve; a traction of 0.909")


def test_what_noise_leaves_open_is_remarked_on(log, nominal, section):
    noise = np.random.default_rng(1).normal(0.0, 0.05, log.speed_mps.size)
    noisy = replace(log, speed_mps=np.maximum(log.speed_mps + noise, 0.0))
    found = fit_trainset([noisy], nominal, sections=[section])
    remarks = ambiguities(found)[1:]
    half = found["lag_s"].high - found["lag_s"].value
    assert half > 0.05
    assert any(f"The lag is known to ±{half:.2g} s only: the logs hardly tell it from" in r for r in remarks)
    assert not any("brake" in remark for remark in remarks)


def test_the_trainset_holds_the_estimates(exact, nominal):
    fitted = exact.trainset()
    assert fitted.mass_kg == pytest.approx(1.1 * nominal.mass_kg, rel=1e-3)
    assert fitted.loads["AW2"] == nominal.loads["AW2"]
    assert fitted.service_deceleration_mps2 == pytest.approx(0.9, rel=1e-3)
    assert fitted.safe_braking.service_deceleration_mps2 <= fitted.service_deceleration_mps2
    assert fitted.actuation.jerk_limit_mps3 == nominal.actuation.jerk_limit_mps3
    assert fitted.davis.per_mass == nominal.davis.per_mass


def test_effort_tells_mass_and_resistance(log, nominal, section):
    found = fit_trainset([log], nominal, sections=[section], source="effort")
    assert found["mass_factor"].value == pytest.approx(1.1, rel=1e-3)
    assert not found["delay_s"].estimated
    assert found["delay_s"].value == nominal.actuation.delay_s


def test_what_is_kept_stays(log, nominal, section):
    truth = replace(nominal, actuation=replace(nominal.actuation, delay_s=0.43, lag_s=0.3))
    found = fit_trainset([log], truth, sections=[section], keep=("delay", "lag"), resistance="factor")
    assert (found["delay_s"].value, found["lag_s"].value) == (0.43, 0.3)
    assert found["resistance_factor"].value == pytest.approx(1.2, rel=5e-3)


def test_noisy_quantised_logs_with_gaps_meet_the_wanted_accuracy(nominal):
    errors = accuracy.errors_of(1, nominal, 20)
    for name in ("resistance_20kmh_n", "resistance_40kmh_n", "resistance_60kmh_n", "mass_factor"):
        assert errors[name][0] < 0.02, name
    assert errors["delay_s"][0] < 0.05
    assert errors["lag_s"][0] < 0.05
    assert np.mean([inside for _, inside in errors.values()]) > 0.5


def part(log, rows):
    columns = ("time_s", "speed_mps", "command", "effort_n", "position_m", "gradient_permil")
    return replace(log, **{name: getattr(log, name)[rows] for name in columns})


def test_a_log_without_braking_says_so(log, nominal):
    braking = int(np.flatnonzero(log.command < -0.05)[0])
    with pytest.raises(
        InputError, match=r"brake factor cannot be estimated: the logs have .*no braking"
    ) as found:
        fit_trainset([part(log, slice(0, braking))], nominal)
    assert "keep: brake" in found.value.line()


def test_a_log_without_braking_tells_the_rest(log, nominal):
    braking = int(np.flatnonzero(log.command < -0.05)[0])
    found = fit_trainset([part(log, slice(0, braking))], nominal, keep=("brake",))
    assert found["mass_factor"].value == pytest.approx(1.1, rel=1e-2)


def test_a_constant_speed_says_what_cannot_be_told_apart(nominal):
    time = 0.2 * np.arange(500)
    log = Log("cruise.csv", time, np.full(500, 15.0), np.full(500, 0.2))
    with pytest.raises(InputError, match="speed is constant: mass, brake, resistance, delay and lag cannot"):
        fit_trainset([log], nominal)


def test_coasting_alone_tells_mass_and_resistance_not_apart(nominal):
    vehicle, speeds = vehicle_arrays(nominal), [20.0]
    for _ in range(400):
        slowing = np.polyval(vehicle.davis_n[::-1], speeds[-1]) / vehicle.effective_mass_kg
        speeds.append(speeds[-1] - 0.2 * slowing)
    log = Log("coasting.csv", 0.2 * np.arange(401), np.array(speeds), np.zeros(401))
    with pytest.raises(InputError, match=r"mass.* cannot be told apart.*no traction.*no braking"):
        fit_trainset([log], nominal)


@pytest.mark.parametrize("row", [70, 200])
def test_a_row_without_a_command_is_a_gap(log, nominal, row):
    command = log.command.copy()
    command[row] = np.nan
    found = fit_trainset([replace(log, command=command)], nominal, resistance="factor")
    assert found["mass_factor"].value == pytest.approx(1.1, rel=1e-2)
    assert found.runs.row_mps.size < log.time_s.size - 1


@pytest.mark.parametrize("offset", [12065.0, -60.0])
def test_positions_outside_the_section_are_refused(log, nominal, section, offset):
    moved = replace(log, position_m=log.position_m + offset)
    with pytest.raises(InputError, match=r"position: outside the section: .*0 to 1280 m, from"):
        fit_trainset([moved], nominal, sections=[section])


def test_a_log_without_input_is_refused(log, nominal):
    with pytest.raises(InputError, match="command: column missing"):
        fit_trainset([replace(log, command=None)], nominal, source="command")
    with pytest.raises(InputError, match="column missing"):
        fit_trainset([replace(log, command=None, effort_n=None)], nominal)

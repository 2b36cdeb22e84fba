"""Wind and wheel slip: what they do to the plant, what protection is told, and that drives stay safe."""

from dataclasses import replace

import pytest

from metropilot.drivers import DRIVERS
from metropilot.errors import InputError
from metropilot.evaluate import RunSpec, run_from_toml
from metropilot.evaluate.folder import write_run_toml
from metropilot.physics import (
    brake_available_n,
    electric_available_n,
    traction_available_n,
    vehicle_arrays,
)
from metropilot.planning import minimum_running_time
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Disturbance, Outcome, Run, declared_bounds, drive

WIND_MPS = 12.0


def run_of(ratio=1.15, **scenario):
    section, trainset = load_line("yizhuang").section("CQN", "CQ"), load_trainset("dkz32", "AW2")
    return Run(section, trainset, minimum_running_time(section, trainset) * ratio, Disturbance(**scenario))


@pytest.mark.parametrize("wind_mps", [WIND_MPS, -WIND_MPS])
def test_the_air_meets_the_trainset_at_the_sum_of_the_speeds(wind_mps):
    known = load_trainset("dkz32", "AW2")
    a, b, c = known.davis.newtons(known.mass_kg)
    windy = Disturbance(headwind_mps=wind_mps).true_plant(known).davis.newtons(known.mass_kg)
    for v in (13.0, 17.0, 22.0):
        assert windy[0] + windy[1] * v + windy[2] * v * v == pytest.approx(
            a + b * v + c * (v + wind_mps) ** 2
        )


def test_no_more_than_the_adhesion_is_put_on_the_rail_by_driven_wheels():
    known = load_trainset("dkz32", "AW2")
    slippery, dry = vehicle_arrays(Disturbance(adhesion=0.05).true_plant(known)), vehicle_arrays(known)
    most = 0.05 * known.mass_kg * known.gravity_mps2
    assert traction_available_n(slippery, 10.0) == electric_available_n(slippery, 10.0) == pytest.approx(most)
    assert traction_available_n(slippery, 22.0) == traction_available_n(dry, 22.0) < most
    assert brake_available_n(slippery, 10.0) == brake_available_n(dry, 10.0)
    assert slippery.emergency_n == dry.emergency_n


def test_protection_is_told_how_far_wind_and_slip_go():
    calm = declared_bounds(run_of())
    assert declared_bounds(run_of(headwind_mps=-25.0)).resistance[0] < calm.resistance[0]
    assert declared_bounds(run_of(headwind_mps=WIND_MPS)).resistance[1] > calm.resistance[1]
    assert declared_bounds(run_of(adhesion=0.5)) == calm
    weak = replace(
        run_of(adhesion=0.05), trainset=replace(load_trainset("dkz32", "AW2"), friction_brake_n=20e3)
    )
    told = brake_available_n(vehicle_arrays(weak.trainset), 5.0)
    most = 0.05 * weak.trainset.mass_kg * weak.trainset.gravity_mps2 + 20e3
    assert declared_bounds(weak).service_share == pytest.approx(
        min(most / told, calm.service_share), rel=0.05
    )


@pytest.mark.parametrize("driver", ["mpc", "optimal"])
def test_drives_stay_safe_and_punctual_on_a_slippery_rail_in_the_wind(driver):
    run = run_of(ratio=1.3, headwind_mps=WIND_MPS, adhesion=0.05)
    done = drive(run, DRIVERS.make(driver))
    assert done.outcome is Outcome.ARRIVED
    assert done.max_overspeed_mps == 0.0
    assert abs(done.running_time_s - run.scheduled_time_s) <= 3.0
    weight_n = run.trainset.mass_kg * run.trainset.gravity_mps2
    assert done.trajectory.traction_n.max() == pytest.approx(0.05 * weight_n, rel=1e-9)


@pytest.mark.parametrize(
    ("field", "value"), [("headwind_mps", 30.0), ("adhesion", 0.01), ("adhesion", float("nan"))]
)
def test_out_of_range_is_refused(field, value):
    with pytest.raises(InputError, match=field):
        Disturbance(**{field: value})


def test_a_request_carries_them_through_its_file(tmp_path):
    weather = Disturbance(headwind_mps=-4.0, adhesion=0.1)
    asked = RunSpec("yizhuang", "RJ", "WYJ", time_s=110.0, disturbance=weather).resolve()
    write_run_toml(tmp_path, asked)
    assert run_from_toml(tmp_path / "run.toml") == asked
    plain = RunSpec("yizhuang", "RJ", "WYJ", time_s=110.0).resolve()
    write_run_toml(tmp_path, plain)
    assert run_from_toml(tmp_path / "run.toml") == plain

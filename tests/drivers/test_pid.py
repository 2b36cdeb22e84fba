"""The incremental PID, and what every tracking driver does on a real line."""

import numpy as np
import pytest

from metropilot.control import Errors, Gains, incremental_pid
from metropilot.drivers import DRIVERS
from metropilot.drivers.pid import Pid, PidOptions
from metropilot.errors import InputError
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import (
    ReferenceShape,
    ReferenceTrack,
    reference_for_time,
    reference_under_for_time,
    sample_reference,
)
from metropilot.railway import Restriction, load_line, load_trainset
from metropilot.sim import Disturbance, Outcome, Run, TimetableUpdate, drive

UNKNOWN = {"resistance_factor": 1.5, "delay_s": 0.6, "lag_s": 0.4, "speed_noise_mps": 0.05}
TRACKERS = ["pid", "fuzzy_pid", "neural_pid", "ddpg_pid"]


def section(name):
    return load_line("yizhuang").section(*name.split("-"))


def test_the_law_is_cheng2023_eqs_15_and_16():
    # 0.1 + 3.4 (0.2 - 0.1) + 0.3 * 0.2 + 0.2 (0.2 - 2 * 0.1 - 0.05) = 0.1 + 0.34 + 0.06 - 0.01
    command, errors = incremental_pid(0.1, Gains(3.4, 0.3, 0.2), 0.2, Errors(0.1, -0.05))
    assert command == pytest.approx(0.49)
    assert errors == Errors(0.2, 0.1)
    assert incremental_pid(0.9, Gains(5.0, 1.5, 1.5), 1.0, Errors(0.0, 0.0))[0] == 1.0


def test_the_law_in_jax_is_the_same():
    import jax.numpy as jnp

    given = 0.1, (3.4, 0.3, 0.2), 0.2, (0.1, -0.05)
    jax_given = jnp.float32(0.1), Gains(*map(jnp.float32, given[1])), jnp.float32(0.2)
    found, _ = incremental_pid(*jax_given, Errors(jnp.float32(0.1), jnp.float32(-0.05)))
    assert float(found) == pytest.approx(0.49, abs=1e-6)


@pytest.mark.parametrize("driver", TRACKERS)
@pytest.mark.parametrize("name", ["JHL-CQN", "XHM-JG", "RJ-WYJ"])
@pytest.mark.parametrize("scenario", [{}, UNKNOWN], ids=["known", "unknown"])
def test_a_tracker_arrives_on_time_and_undisturbed(driver, name, scenario):
    line = section(name)
    run = Run(line, load_trainset("dkz32"), line.planned_time_s, Disturbance(**scenario), seed=1)
    done = drive(run, DRIVERS.make(driver))
    assert done.outcome is Outcome.ARRIVED
    assert (done.interventions, done.max_overspeed_mps) == (0, 0.0)
    assert abs(float(done.trajectory.position_m[-1]) - line.length_m) < 0.1
    assert abs(done.running_time_s - run.scheduled_time_s) < 2.0


@pytest.mark.parametrize("kind", ["trapezoid", "optimal"])
def test_other_references_are_followed_too(kind):
    line = section("RJ-WYJ")
    done = drive(Run(line, load_trainset("dkz32"), 101.0), Pid(PidOptions(reference=kind)))
    assert done.outcome is Outcome.ARRIVED
    assert abs(done.running_time_s - 101.0) < 2.0
    with pytest.raises(InputError, match="trapezoid, s_curve, optimal"):
        PidOptions(reference="none")


def test_a_tracker_hears_news():
    news = (
        TimetableUpdate(20.0, scheduled_time_s=128.0),
        TimetableUpdate(30.0, restriction=Restriction(700.0, 900.0, 10.0)),
    )
    run = Run(section("RJ-WYJ"), load_trainset("dkz32"), 101.0, Disturbance(updates=news))
    done = drive(run, Pid())
    assert done.outcome is Outcome.ARRIVED
    assert done.interventions == 0
    inside = (done.trajectory.position_m > 700.0) & (done.trajectory.position_m < 900.0)
    assert 8.0 < done.trajectory.speed_mps[inside].max() <= 10.0
    assert abs(done.running_time_s - 128.0) < 2.0


def test_a_reference_keeps_to_time_jerk_limits_and_effort():
    trainset = load_trainset("dkz32")
    line = section("XC-SJZ")
    constraints = ReferenceTrack(vehicle_arrays(trainset), track_arrays(line, trainset))
    shape = ReferenceShape(0.9, 0.8, 0.5)
    found = reference_under_for_time(constraints, shape, 190.0)
    assert found.duration_s == pytest.approx(190.0, abs=0.01)
    assert found.position_m[-1] == pytest.approx(line.length_m)
    assert np.abs(np.diff(found.acceleration_mps2)).max() <= 0.5 * found.period_s + 1e-9
    assert (found.speed_mps <= line.limit_mps.at(found.position_m) + 1e-9).all()
    np.testing.assert_allclose(np.diff(found.position_m), found.speed_mps[1:] * found.period_s, atol=2e-3)


def test_where_nothing_binds_it_is_the_trapezoid_drawn_by_hand():
    trainset = load_trainset("cheng2023").ideal()
    line = section("RJ-WYJ")
    constraints = ReferenceTrack(vehicle_arrays(trainset), track_arrays(line, trainset))
    shape = ReferenceShape(0.5, 0.5)
    found = reference_under_for_time(constraints, shape, 130.0, 0.2)
    by_hand = sample_reference(reference_for_time(line.length_m, 130.0, shape, 20.0), 0.2)
    assert np.abs(found.speed_mps - by_hand.speed_mps).max() < 0.01
    assert np.abs(found.position_m - by_hand.position_m).max() < 0.2

"""Low jerk limits, brakes that barely suffice and long periods on lines whose limits rise and fall."""

from dataclasses import replace

import numpy as np
import pytest
from tests.sections import section_of

from metropilot.evaluate import make_driver
from metropilot.planning import minimum_running_time
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Outcome, Run, drive

LIMITS_KMH = (80.0, 45.0, 65.0, 30.0, 70.0, 80.0, 45.0, 65.0, 30.0, 70.0, 80.0, 45.0, 65.0, 30.0, 70.0)
PERMIL = (0.0, 12.0, -9.0, 20.0, -15.0)


def section():
    """A section of 3 km with a limit every 200 m and a gradient every 150 m, the last a fall."""
    at = np.arange(0.0, 3000.0, 150.0)
    limits = dict(zip(200.0 * np.arange(len(LIMITS_KMH)), LIMITS_KMH, strict=True))
    return section_of(3000.0, limits, dict(zip(at, np.resize(PERMIL, at.size), strict=True)))


def slowly(key, jerk_mps3, service_mps2=None):
    """A trainset that answers at once, but builds its efforts up slowly."""
    trainset = load_trainset(key)
    actuation = replace(trainset.actuation, jerk_limit_mps3=jerk_mps3, delay_s=0.0, lag_s=0.0)
    if service_mps2 is None:
        return replace(trainset, actuation=actuation)
    braking = replace(
        trainset.safe_braking, service_deceleration_mps2=service_mps2, emergency_deceleration_mps2=0.9
    )
    weak = {"service_deceleration_mps2": service_mps2, "max_deceleration_mps2": service_mps2}
    return replace(trainset, actuation=actuation, safe_braking=braking, **weak)


@pytest.mark.parametrize("dt", [0.2, 0.5])
@pytest.mark.parametrize(
    ("key", "jerk_mps3", "service_mps2"), [("dkz32", 0.4, None), ("dkz32", 0.7, 0.7), ("lu2023", 0.4, None)]
)
@pytest.mark.parametrize("name", ["optimal", "generalist", "eitoe", "eitop", "flat_out"])
def test_nobody_is_overruled_or_stands_beyond_the_mark(name, key, jerk_mps3, service_mps2, dt):
    """`flat_out` and `eitop` stood 2 to 3 m beyond it; they, `eitoe` and `generalist` were overruled."""
    rough, trainset = section(), slowly(key, jerk_mps3, service_mps2)
    run = Run(rough, trainset, 1.1 * minimum_running_time(rough, trainset), dt=dt)
    driven = drive(run, make_driver(name))
    assert driven.outcome is Outcome.ARRIVED
    assert driven.interventions == 0
    assert abs(float(driven.trajectory.position_m[-1]) - rough.length_m) < 0.1


@pytest.mark.parametrize(
    ("key", "jerk_mps3", "service_mps2", "dt"), [("dkz32", 0.7, 0.7, 0.5), ("lu2023", 0.4, None, 0.2)]
)
def test_a_human_with_a_weak_brake_stands_at_the_mark(key, jerk_mps3, service_mps2, dt):
    """It stood 4.7 and 4.9 m beyond, as traction goes on while the hand reacts and the brake builds up."""
    rough, trainset = section(), slowly(key, jerk_mps3, service_mps2)
    done = drive(
        Run(rough, trainset, 1.1 * minimum_running_time(rough, trainset), dt=dt), make_driver("manual")
    )
    assert done.outcome is Outcome.ARRIVED
    assert abs(float(done.trajectory.position_m[-1]) - rough.length_m) < 0.3


def test_a_human_on_a_long_fall_counts_the_whole_of_it():
    """It stood 7 m beyond: a brake of 0.35 m/s^2 begins 1 km before the stop, where the fall is."""
    line, trainset = load_line("zurich-stadelhofen"), load_trainset("de_traxx_ic2")
    run = Run(line.section("ZHDB", "ZAS"), trainset, 148.8, dt=1.0)
    done = drive(run, make_driver("manual"))
    assert done.outcome is Outcome.ARRIVED
    assert abs(float(done.trajectory.position_m[-1]) - run.section.length_m) < 0.3

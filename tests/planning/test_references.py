"""References have closed forms: distance, duration, peak and jerk are worked out by hand."""

import math

import numpy as np
import pytest

from metropilot.errors import Infeasible, InputError
from metropilot.planning import ReferenceShape, peak_speed, reference, reference_for_time

CHENG = ReferenceShape(acceleration_mps2=0.9, deceleration_mps2=0.8, jerk_mps3=0.5)
CASES = [
    pytest.param(1280.0, 18.3, CHENG, id="cheng2023"),
    pytest.param(1280.0, 18.3, ReferenceShape(0.9, 0.8), id="trapezoid"),
    pytest.param(200.0, 18.3, CHENG, id="no cruising"),
    pytest.param(1.0, 18.3, CHENG, id="acceleration not reached"),
    pytest.param(200.0, 18.3, ReferenceShape(0.9, 0.8), id="triangle"),
    pytest.param(5000.0, 1.0, CHENG, id="slow and long"),
]


@pytest.mark.parametrize(("distance", "cruise", "shape"), CASES)
def test_distance_is_exact_and_bounds_hold(distance, cruise, shape):
    drawn = reference(distance, cruise, shape)
    time = np.linspace(0.0, drawn.duration_s, 20001)
    position, speed, acceleration = drawn.at(time)
    assert drawn.distance_m == distance
    assert abs(position[-1] - distance) < 1e-9
    assert abs(speed[-1]) < 1e-9
    assert speed.max() <= cruise + 1e-12
    assert acceleration.max() <= shape.acceleration_mps2 + 1e-12
    assert acceleration.min() >= -shape.deceleration_mps2 - 1e-12
    assert np.abs(np.diff(acceleration[:-1])).max() <= shape.jerk_mps3 * time[1] + 1e-9
    # Position is the integral of speed, speed that of acceleration: the trapezoidal rule is exact to O(dt^2).
    assert np.allclose(
        np.cumsum(0.5 * (speed[1:] + speed[:-1])) * time[1], position[1:], atol=1e-3 + time[1] ** 2
    )
    # No phase begins with a jump of what the phase before ends with.
    before, after = drawn.at(drawn.time_s[1:-1] - 1e-9), drawn.at(drawn.time_s[1:-1] + 1e-9)
    assert np.allclose(before[0], after[0], atol=1e-6)
    assert np.allclose(before[1], after[1], atol=1e-6)


def test_cheng2023_takes_what_the_closed_form_says():
    # 1280/18.3 + (18.3/0.9 + 0.9/0.5 + 18.3/0.8 + 0.8/0.5)/2 = 69.9454 + 23.3042 s
    drawn = reference(1280.0, 18.3, CHENG)
    assert drawn.cruise_mps == 18.3
    assert drawn.duration_s == pytest.approx(93.2495, abs=1e-4)
    # Speeding up takes 22.1333 s and half the speed times that of way.
    assert drawn.at(22.1333)[0] == pytest.approx(0.5 * 18.3 * 22.1333, abs=1e-3)


def test_short_distances_peak_where_the_closed_form_says():
    # Triangle: v^2/2 (1/A + 1/B) = D.
    assert peak_speed(200.0, ReferenceShape(0.9, 0.8)) == pytest.approx(math.sqrt(400 / (1 / 0.9 + 1 / 0.8)))
    # Neither limit reached: four equal jerk phases, 2 v sqrt(v/J) = D.
    assert peak_speed(1.0, CHENG) == pytest.approx((0.5 * math.sqrt(0.5)) ** (2 / 3))


@pytest.mark.parametrize("time_s", [95.0, 110.0, 200.0, 2000.0])
@pytest.mark.parametrize("shape", [CHENG, ReferenceShape(0.9, 0.8)])
def test_cruising_speed_is_solved_from_the_time(shape, time_s):
    drawn = reference_for_time(1280.0, time_s, shape, 20.0)
    assert drawn.duration_s == pytest.approx(time_s, abs=1e-6)
    assert drawn.distance_m == 1280.0


def test_time_at_a_position_inverts_position_at_a_time():
    drawn = reference(1280.0, 18.3, CHENG)
    time = np.linspace(0.5, drawn.duration_s - 0.5, 101)
    position, speed, acceleration = drawn.at(time)
    assert np.allclose(drawn.time_at(position), time, atol=1e-6)
    found = drawn.at(drawn.time_at(position))
    assert np.allclose(found[1], speed, atol=1e-6)
    assert np.allclose(found[2], acceleration, atol=1e-6)


def test_what_cannot_be_is_said_in_one_line():
    with pytest.raises(
        Infeasible, match=r"time: the reference cannot be this fast: 60\.0 s \(allowed: >= "
    ) as told:
        reference_for_time(1280.0, 60.0, CHENG, 22.0)
    assert "\n" not in str(told.value)
    with pytest.raises(Infeasible, match="distance: must be positive: 0"):
        reference(0.0, 18.3, CHENG)
    with pytest.raises(InputError, match="deceleration_mps2: out of range: -1"):
        ReferenceShape(0.9, -1.0)

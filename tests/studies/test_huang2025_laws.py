"""The expert of Huang25: coasting forecast against a closed form, window, rules, and in plain numbers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from metropilot.errors import InputError
from metropilot.physics import scalars
from metropilot.studies.huang2025.env import ExpertChoiceAction
from metropilot.studies.huang2025.laws import (
    SEGMENTS,
    ExpertRules,
    ExpertStretch,
    ExpertWindow,
    coasting_time,
    constant_rate_change,
    expert_safe_speed,
    expert_window,
    next_expert_rate,
)

FLAT = [0.0] * (SEGMENTS + 1)
HIGH = [1e4] * (SEGMENTS + 1)


def stretch(left_m, end_mps=0.0, climb=FLAT, cap=HIGH):
    return ExpertStretch(left_m, climb, cap, end_mps)


def window(mean, low=14.0, middle=15.0, high=16.0):
    return ExpertWindow(mean, low, middle, high, 0.0)


def test_coasting_against_the_closed_form():
    # resistance 0.1 m/s2 from 20 m/s over 1000 m, brake 0.9: they meet where 200 - 0.1 s = 0.9 (1000 - s),
    # s = 875 m, at v = sqrt(400 - 175) = 15 m/s: (20 - 15) / 0.1 + 15 / 0.9 = 50 + 16.67 s
    found = coasting_time(scalars, (0.1, 0.0, 0.0), 0.9, 20.0, stretch(1000.0))
    assert found == pytest.approx(50.0 + 15.0 / 0.9, abs=0.02)
    # to 5 m/s at the end instead: 200 - 0.1 s = 12.5 + 0.9 (1000 - s), s = 890.6 m
    meets = math.sqrt(400.0 - 2 * 0.1 * 890.625)
    found = coasting_time(scalars, (0.1, 0.0, 0.0), 0.9, 20.0, stretch(1000.0, 5.0))
    assert found == pytest.approx((20.0 - meets) / 0.1 + (meets - 5.0) / 0.9, abs=0.02)


def test_coasting_uphill_counts_the_climb_and_standing_still_is_far_too_late():
    # a gradient that takes 0.05 m/s2 is resistance
    climb = [50.0 * k / SEGMENTS for k in range(SEGMENTS + 1)]
    up = coasting_time(scalars, (0.05, 0.0, 0.0), 0.9, 20.0, stretch(1000.0, climb=climb))
    assert up == pytest.approx(coasting_time(scalars, (0.1, 0.0, 0.0), 0.9, 20.0, stretch(1000.0)))
    assert coasting_time(scalars, (0.3, 0.0, 0.0), 0.9, 10.0, stretch(1000.0)) > 500.0


def test_window():
    # 1000 m in 50 s, 3 s either way, all of the time: 1000/53, 1000/50, 1000/47
    found = expert_window(scalars, ExpertRules(), 1000.0, 62.5, 50.0)
    assert found[:4] == pytest.approx((16.0, 1000 / 53, 20.0, 1000 / 47))
    assert found.late_s == pytest.approx(12.5)
    # an interval that takes half of the least time gets half of the time left (Algorithm 1)
    assert expert_window(scalars, ExpertRules(), 1000.0, 62.5, 100.0, 0.5).middle_mps == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("mean", "rate", "sign"),
    [(13.0, 0.0, 1), (17.0, 0.6, -1), (14.5, 0.6, 1), (14.5, 0.0, -1), (15.5, 0.6, -1)],
)
def test_constant_change(mean, rate, sign):
    assert constant_rate_change(scalars, ExpertRules(), window(mean), rate) == pytest.approx(sign * 0.3)


@pytest.mark.parametrize(
    ("mean", "rate", "change", "after"),
    [
        (13.0, 0.0, 0.3, 0.3),  # eq. 15
        (13.0, 0.5, 0.3, 0.6),  # no more than the top
        (17.0, 0.6, -0.3, 0.3),  # eq. 16
        (17.0, 0.1, -0.3, 0.0),  # to coasting, not to braking (rule 1)
        (17.0, 0.0, -0.3, -0.3),  # early even when coasting: gently
        (17.0, -0.4, -0.3, -0.5),
        (15.5, -0.4, 0.3, -0.46),  # until on time again
        (14.5, -0.4, 0.3, -0.1),
        (13.0, 0.2, -0.3, 0.26),  # the window has the last word on a policy
        (17.0, 0.5, 0.3, 0.2),  # early under traction: it ends as quickly as it may
    ],
)
def test_next_rate(mean, rate, change, after):
    assert next_expert_rate(scalars, 0.3, window(mean), rate, change, 0.6) == pytest.approx(after)


def test_safe_speed():
    # eq. 17 at 50 m before 10 m/s with 1 m/s2: 0.95 sqrt(100 + 100); eq. 18: never above the limit
    assert expert_safe_speed(scalars, ExpertRules(), 1.0, 10.0, 50.0, 20.0) == pytest.approx(
        0.95 * math.sqrt(200.0)
    )
    assert expert_safe_speed(scalars, ExpertRules(), 1.0, 10.0, 500.0, 20.0) == 20.0


@given(st.floats(0.0, 25.0), st.floats(20.0, 2500.0), st.floats(0.0, 16.0), st.floats(-8.0, 8.0))
def test_plain_numbers_and_arrays_agree(speed, left, end, slope):
    climb = np.linspace(0.0, 0.01 * slope * left, SEGMENTS + 1)
    cap = np.full(SEGMENTS + 1, 0.5 * 22.0**2)
    arguments = ((0.02, 0.002, 0.0002), 0.9, speed)
    plain = coasting_time(scalars, *arguments, ExpertStretch(left, climb.tolist(), cap.tolist(), end))
    arrays = coasting_time(np, *arguments, ExpertStretch(np.float64(left), climb, cap, np.float64(end)))
    assert plain == pytest.approx(float(arrays), rel=1e-9)


def test_a_choice_stands_for_a_change():
    assert [ExpertChoiceAction().change(k) for k in range(3)] == [-1.0, 0.0, 1.0]
    assert ExpertChoiceAction().space.count == 3


@pytest.mark.parametrize("field", ["start_mps2", "tolerance_s", "safe_share"])
def test_rules_out_of_range(field):
    with pytest.raises(InputError, match=field):
        ExpertRules(**{field: 0.0})

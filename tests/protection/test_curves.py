"""The curves against closed forms, and what they promise about the ground they stand on."""

from dataclasses import replace

import numpy as np
import pytest

from metropilot.errors import InputError
from metropilot.physics import davis_n, effort_at, restrictive_profile, track_arrays, vehicle_arrays
from metropilot.protection import (
    Bounds,
    approach_margin,
    at_start,
    permitted_braking,
    permitted_speed,
    protect,
)
from metropilot.protection.predict import fastest, stays_under
from metropilot.protection.supervisor import CommandCheck
from metropilot.railway import (
    EffortCurve,
    MovementAuthority,
    Restriction,
    SafeBraking,
    Steps,
    load_line,
    load_trainset,
)

LINE = load_line("yizhuang")
DKZ32 = load_trainset("dkz32")
IDEAL = DKZ32.ideal()
DT = 0.2


def level(limit_mps=20.0, slope_permil=0.0, length_m=2000.0):
    section = LINE.section("RJ", "WYJ")
    return replace(
        section,
        length_m=length_m,
        limit_mps=Steps(np.array([-500.0]), np.array([limit_mps])),
        gradient_permil=Steps(np.array([-500.0]), np.array([slope_permil])),
        curves=(),
    )


def speed(protection, values, at):
    node = round((at - float(protection.start_m)) / float(protection.spacing_m))
    return float(np.sqrt(2.0 * values[node]))


@pytest.mark.parametrize("slope_permil", [0.0, -24.0, 24.0])
def test_emergency_curve_is_the_braking_parabola(slope_permil):
    section = level(slope_permil=slope_permil).with_restriction(Restriction(1000.0, 1300.0, 10.0))
    protection = protect(section, IDEAL, Bounds.of(IDEAL, DT))
    rate = 1.2 + 9.81 * slope_permil / 1000.0
    for back in (10.0, 50.0, 100.0):
        assert speed(protection, protection.emergency, 1000.0 - back) == pytest.approx(
            np.sqrt(10.0**2 + 2.0 * rate * back), abs=1e-6
        )
    # Until the tail has cleared, the restriction holds.
    assert speed(protection, protection.emergency, 1300.0 + DKZ32.length_m) == pytest.approx(10.0, abs=1e-6)
    assert speed(protection, protection.emergency, 1301.0 + DKZ32.length_m) == pytest.approx(20.0, abs=1e-6)


def test_the_curves_keep_their_order_under_the_limit_everywhere():
    for trainset in (DKZ32, IDEAL):
        for section in LINE.sections():
            protection = protect(replace(section, authority=None), trainset, Bounds.of(trainset, DT))
            at = np.arange(0.0, section.length_m, 0.37)
            starts, speeds = restrictive_profile(section, trainset.length_m, trainset.max_speed_mps)
            limit = speeds[np.searchsorted(starts, at, side="right") - 1]
            node = np.floor(at - float(protection.start_m)).astype(int)
            share = at - float(protection.start_m) - node
            emergency = protection.emergency[node] * (1 - share) + protection.emergency[node + 1] * share
            assert (np.sqrt(2.0 * emergency) <= limit + 1e-9).all()
            assert (permitted_speed(protection, at) <= np.sqrt(2.0 * emergency)).all()


@pytest.mark.parametrize(
    ("trainset", "dt", "most_mps"),
    [(IDEAL, 0.1, 0.05), (IDEAL, 0.2, 0.1), (DKZ32, 0.1, 0.35), (DKZ32, 0.2, 0.45)],
)
def test_little_speed_is_lost_where_the_limit_is_level(trainset, dt, most_mps):
    for section in LINE.sections() + LINE.sections(backward=True):
        protection = protect(section, trainset, Bounds.of(trainset, dt))
        at = np.arange(-3.0, section.length_m + 300.0)
        track = track_arrays(section, trainset)
        around = track.limit_mps[np.searchsorted(track.limit_from_m, at, side="right") - 1]
        limit = around[3:-300]
        loss = limit - permitted_speed(protection, at[3:-300])
        # Level from 3 m before to 300 m ahead.
        cruising = np.lib.stride_tricks.sliding_window_view(around, 304).min(axis=1)[: limit.size] >= limit
        assert (loss[cruising] <= most_mps).all(), (section.name, loss[cruising].max())


def test_wider_bounds_never_permit_more():
    section = LINE.section("XHM", "JG")
    nominal = Bounds.of(DKZ32, DT)
    at = np.arange(0.0, section.length_m)
    before = permitted_speed(protect(section, DKZ32, nominal), at)
    for wider in (
        {"mass": (0.7, 1.3)},
        {"resistance": (0.2, 1.8)},
        {"emergency_reaction_s": 1.0},
        {"emergency_jerk_mps3": 0.8},
        {"emergency_mps2": 1.0},
        {"speed_error_mps": 0.2},
        {"position_error_m": 5.0},
        {"dt_s": 0.4},
    ):
        after = permitted_speed(protect(section, DKZ32, replace(nominal, **wider)), at)
        assert (after <= before + 0.01).all(), wider
        assert after.mean() < before.mean(), wider


def test_a_braking_driver_may_be_a_little_faster():
    section = level().with_restriction(Restriction(1000.0, 1300.0, 10.0))
    protection = protect(section, DKZ32, Bounds.of(DKZ32, DT))
    at = np.arange(900.0, 1000.0)
    braking = permitted_braking(protection, track_arrays(section, DKZ32), at, 0.9)
    assert (braking >= permitted_speed(protection, at) - 0.05).all()
    assert (braking > permitted_speed(protection, at) + 0.1).any()


def test_margin_of_an_acceleration():
    protection = protect(level(), DKZ32, Bounds.of(DKZ32, DT))
    margin = approach_margin(protection, np.array([-1.0, 0.0, 0.5, 1.0]))
    assert margin[0] == margin[1] == 0.0
    # 1.0 m/s^2 may be 1.5 in the lightest trainset: 0.6 s of it, then 1.5 m/s^3 to undo it.
    assert margin[3] == pytest.approx(1.5 * 0.6 + 1.5**2 / (2 * 1.5))


def test_bounds_come_from_the_catalogue():
    bounds = Bounds.of(DKZ32, 0.2, extra_delay_s=0.6)
    assert (bounds.delay_s, bounds.lag_s, bounds.jerk_mps3) == (0.6, 0.0, 1.0)
    assert bounds.reaction_s == pytest.approx(0.6)  # one period, and 0.3 s in whole periods
    slow = replace(DKZ32, safe_braking=SafeBraking(buildup_s=2.0, emergency_jerk_mps3=1.5))
    assert Bounds.of(slow, 0.2).emergency_jerk_mps3 == pytest.approx(0.6)
    assert Bounds.of(IDEAL, 0.2).reaction_s == pytest.approx(0.2)


@pytest.mark.parametrize(
    "wrong", [{"dt_s": 0.0}, {"mass": (1.1, 1.2)}, {"delay_s": -1.0}, {"lag_s": np.nan}, {"delay_s": np.inf}]
)
def test_bounds_out_of_range(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        replace(Bounds(dt_s=0.2), **wrong)


def test_a_section_too_long_for_its_spacing():
    with pytest.raises(InputError, match="too long"):
        protect(level(length_m=200_000.0), IDEAL, Bounds.of(IDEAL, DT))


def at_node(protection, values, where_m):
    return float(values[round((where_m - float(protection.start_m)) / float(protection.spacing_m))])


SPEEDS_MPS = np.linspace(0.0, 30.0, 31)
FADES = replace(
    DKZ32,
    electric_brake=EffortCurve.table(SPEEDS_MPS, DKZ32.mass_kg * (1.0 - 0.02 * SPEEDS_MPS)),
    friction_brake_n=0.0,
)
"""Its service brake gets weaker with speed, as its traction does."""


@pytest.mark.parametrize("trainset", [DKZ32, FADES], ids=["steady", "fades"])
def test_forces_are_the_worst_that_any_speed_and_plant_within_reach_can_have(trainset):
    vehicle = vehicle_arrays(trainset)
    rates = protect(level(), trainset, replace(Bounds.of(trainset, DT), speed_error_mps=0.3)).rates
    for v in np.linspace(2.0, 23.0, 22):
        push, hold, coast = fastest(vehicle, rates, np.float64(v), np.float64(0.1))
        for speed in np.linspace(max(v - 1.3, 0.0), v + 0.3, 9):
            effort = effort_at(vehicle, speed)
            for mass in (0.8, 1.0, 1.2):
                heavy = mass * vehicle.effective_mass_kg
                assert push >= effort.traction_n / heavy
                assert hold <= 0.8 * effort.brake_n / heavy
                assert coast >= 0.1 - 0.5 * davis_n(vehicle, speed) / heavy


def fall(start_m, length_m, trainset=IDEAL, bounds=None):
    """Protection where the track falls by 30 permil on one stretch and is level elsewhere."""
    edges = np.array([-500.0, start_m, start_m + length_m])
    section = replace(level(), gradient_permil=Steps(edges, np.array([0.0, -30.0, 0.0])))
    return protect(section, trainset, bounds or Bounds.of(trainset, DT))


def test_a_fall_counts_from_afar_and_for_a_while_after_it():
    point = replace(IDEAL, length_m=0.0)
    protection = fall(1000.0, 100.0, point)
    pull = 9.81 * 0.03
    # Within 0.2 s at 20 m/s and more the emergency brake acts: what begins 3 m ahead counts.
    for where in (997.0, 1000.0, 1050.0, 1099.0, 1102.0):
        assert at_node(protection, protection.pull_mps2, where) == pytest.approx(pull, rel=0.01)
    assert at_node(protection, protection.pull_mps2, 900.0) <= 0.0
    assert at_node(protection, protection.pull_mps2, 1150.0) <= 0.0


def test_a_fall_between_two_nodes_counts():
    protection = fall(1000.2, 0.5, replace(IDEAL, length_m=0.0))
    assert at_node(protection, protection.pull_mps2, 1000.0) == pytest.approx(9.81 * 0.03, rel=0.01)


def test_the_next_node_counts_too():
    protection = fall(1000.0, 100.0, replace(IDEAL, length_m=0.0))
    first = round(950.5 - float(protection.start_m) - 0.5)
    steep = np.where(np.arange(protection.pull_mps2.size) == first + 1, 0.3, -0.1)
    check = CommandCheck(
        protection._replace(pull_mps2=steep), at_start(protection), np.float64(950.5), np.float64(5.0)
    )
    assert check.worst.pull_mps2 == 0.3


def test_a_limit_between_two_nodes_counts():
    point = replace(IDEAL, length_m=0.0)
    section = level().with_restriction(Restriction(1000.2, 1000.7, 5.0))
    protection = protect(section, point, Bounds.of(point, DT))
    for where in (1000.0, 1001.0):
        assert speed(protection, protection.emergency, where) <= 5.0


def test_at_a_change_of_limit_the_lower_one_counts():
    point = replace(IDEAL, length_m=0.0)
    section = level().with_restriction(Restriction(1000.0, 1300.0, 10.0))
    protection = protect(section, point, Bounds.of(point, DT))
    for where in (1000.0, 1300.0):
        assert speed(protection, protection.emergency, where) <= 10.0


def test_the_curves_lead_to_the_release_speed_at_the_end_of_the_authority():
    section = replace(level(length_m=800.0), authority=MovementAuthority(5.0, 4.0))
    protection = protect(section, IDEAL, Bounds.of(IDEAL, DT))
    endless = protect(replace(section, authority=None), IDEAL, Bounds.of(IDEAL, DT))
    assert protection.authority_m == 805.0
    assert speed(protection, protection.emergency, 805.5) <= 4.0
    assert speed(protection, protection.emergency, 795.0) == pytest.approx(
        np.sqrt(16.0 + 2.4 * 10.0), abs=0.2
    )
    assert speed(protection, protection.emergency, 820.0) == 0.0
    assert speed(endless, endless.emergency, 820.0) > 10.0
    np.testing.assert_array_equal(protection.permitted_mps, endless.permitted_mps)


def test_the_map_ends_in_a_stop():
    section = replace(level(length_m=800.0), authority=None)
    protection = protect(section, IDEAL, Bounds.of(IDEAL, DT))
    assert speed(protection, protection.emergency, 1300.0) == 0.0
    assert speed(protection, protection.emergency, 1290.0) == pytest.approx(np.sqrt(2 * 1.2 * 10.0), abs=1e-6)


def test_curves_keep_clear_of_their_number_types_rounding():
    for dtype in (np.float32, np.float64):
        protection = protect(level(), IDEAL, Bounds.of(IDEAL, DT), dtype=dtype)
        below = 0.5 * 20.0**2 - at_node(protection, protection.emergency, 500.0)
        assert below > 8.0 * np.finfo(dtype).eps * 2000.0


def test_a_prediction_that_leaves_the_window_is_refused():
    rates = protect(level(), DKZ32, Bounds.of(DKZ32, DT)).rates
    distance, high = np.arange(16.0), np.full(16, 1e4)
    slow, quick = np.float64(5.0), np.float64(40.0)
    assert stays_under(rates, high, distance, slow, np.float64(0.0), np.float64(0.0))
    assert not stays_under(rates, high, distance, quick, np.float64(0.0), np.float64(0.0))


def test_the_look_ahead_grows_with_the_trainset():
    """A long build-up at speed: 7.2 s at 160 km/h need more metres than any metro does."""
    safe = SafeBraking(1.2, 1.0, reaction_s=2.0, buildup_s=5.2)
    quick = replace(DKZ32, safe_braking=safe, max_speed_mps=160 / 3.6, traction=EffortCurve.constant(2e5))
    section = level(limit_mps=160 / 3.6, length_m=9000.0)
    protection = protect(section, quick, Bounds.of(quick, 1.0))
    assert protection.ahead.size > 512
    assert float(permitted_speed(protection, 2000.0)) > 140 / 3.6

"""Track as felt over the length of a trainset; padding changes nothing."""

import numpy as np
import pytest
from tests.physics import cases

from metropilot import physics
from metropilot.errors import InputError
from metropilot.physics.build import PIECES, SIZES
from metropilot.railway import Curve, Steps, Tunnel

WEIGHT_N = 200e3 * 9.81


def gradient_n(section, trainset, at_m):
    vehicle, track = cases.plant(section, trainset)
    return np.array([float(physics.resistance_and_gradient(vehicle, track, x, 10.0)[1]) for x in at_m])


def test_a_step_in_the_gradient_is_felt_as_a_ramp_as_long_as_the_trainset():
    section = cases.section(Steps(np.array([-1000.0, 500.0]), np.array([0.0, 20.0])))
    at = np.array([400.0, 500.0, 530.0, 560.0, 620.0, 900.0])
    share = np.array([0.0, 0.0, 0.25, 0.5, 1.0, 1.0])  # of a 120 m trainset already on the slope
    np.testing.assert_allclose(
        gradient_n(section, cases.trainset(length_m=120.0), at), WEIGHT_N * 0.02 * share
    )


def test_length_zero_is_the_point_mass():
    profile = Steps(np.array([-1000.0, 500.0, 900.0]), np.array([0.0, 20.0, -5.0]))
    at = np.array([499.9, 500.0, 899.9, 900.0])
    felt = gradient_n(cases.section(profile), cases.trainset(), at)
    np.testing.assert_allclose(felt, WEIGHT_N * profile.at(at) / 1000.0)
    short = gradient_n(cases.section(profile), cases.trainset(length_m=0.01), at + 0.02)
    np.testing.assert_allclose(short, WEIGHT_N * profile.at(at + 0.02) / 1000.0, rtol=1e-6)


def test_a_hump_shorter_than_the_trainset_is_averaged():
    # up 30 permil for 50 m and down again: under a 200 m trainset that covers both it cancels
    section = cases.section(
        Steps(np.array([-1000.0, 500.0, 550.0, 600.0]), np.array([0.0, 30.0, -30.0, 0.0]))
    )
    felt = gradient_n(section, cases.trainset(length_m=200.0), [550.0, 600.0, 700.0, 750.0])
    np.testing.assert_allclose(felt, WEIGHT_N * 0.03 * np.array([0.25, 0.0, 0.0, -0.25]), atol=1e-6)


def test_curves_and_tunnels_count_by_the_share_of_the_trainset_inside():
    section = cases.section(
        curves=[Curve(400.0, 1 / 300.0, 1 / 300.0), Curve(700.0, 0.0, 0.0)],
        tunnels=[Tunnel(1000.0, 300.0, 25.0)],
    )
    trainset = cases.trainset(
        length_m=100.0, curve_formula="600/r", tunnel_n_per_mps2=((20.0, 9.0), (30.0, 5.0))
    )
    vehicle, track = cases.plant(section, trainset)
    felt = [
        physics.resistance_and_gradient(vehicle, track, x, 10.0)[0]
        for x in (300.0, 450.0, 600.0, 1025.0, 1200.0)
    ]
    curve, tunnel = 200e3 * 9.81 * 0.6 / 300.0, 7.0 * 10.0**2
    np.testing.assert_allclose(felt, [0.0, curve / 2, curve, tunnel / 4, tunnel], atol=1e-6)


@pytest.mark.parametrize(
    ("formula", "expected"), [("none", 0.0), ("600/r", 0.6 * 9.81 / 300), ("6.3/(r-55)", 6.3 / 245)]
)
def test_curve_formulas(formula, expected):
    section = cases.section(curves=[Curve(-500.0, -1 / 300.0, -1 / 300.0)])
    vehicle, track = cases.plant(section, cases.trainset(curve_formula=formula))
    assert physics.resistance_and_gradient(vehicle, track, 100.0, 0.0)[0] == pytest.approx(200e3 * expected)


def test_a_curve_too_tight_for_its_formula_is_named():
    section = cases.section(curves=[Curve(100.0, 1 / 50.0, 1 / 50.0)])
    with pytest.raises(InputError, match=r"6\.3/\(r-55\)"):
        cases.plant(section, cases.trainset(curve_formula="6.3/(r-55)"))


@pytest.mark.parametrize("length_m", [0.0, 60.0, 150.0, 400.0])
def test_the_limit_is_the_lowest_anywhere_under_the_trainset(length_m):
    # zones of 20 to 300 m, some shorter than the trainset
    breaks = np.array([-1000.0, 100.0, 150.0, 170.0, 400.0, 500.0, 520.0, 820.0, 1200.0])
    limit = Steps(breaks, np.array([20.0, 15.0, 8.0, 22.0, 12.0, 25.0, 9.0, 18.0, 30.0]))
    section = cases.section(limit=limit)
    starts, speeds = physics.restrictive_profile(section, length_m, 24.0)
    head = np.arange(0.25, 2000.0, 0.5)
    under = head[:, None] - np.linspace(0.0, 1.0, 1601) * length_m
    expected = np.minimum(limit.at(under).min(axis=1), 24.0)
    got = speeds[np.searchsorted(starts, head, side="right") - 1]
    np.testing.assert_array_equal(got, expected)
    assert (np.diff(speeds) != 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_padding_changes_no_result(seed):
    rng = np.random.default_rng(400 + seed)
    section, trainset = cases.random_section(rng), cases.random_trainset(rng)
    shares = cases.random_commands(rng, 200)
    tight = cases.drive(*cases.plant(section, trainset), shares, 0.2, delay_steps=8)
    wide = (
        physics.vehicle_arrays(trainset, pieces=PIECES[-1]),
        physics.track_arrays(section, trainset, size=SIZES[-1]),
    )
    padded = cases.drive(*wide, shares, 0.2, delay_steps=8)
    assert [s.position_m for s in tight] == [s.position_m for s in padded]
    assert [s.line_j for s in tight] == [s.line_j for s in padded]


def test_padded_sizes_have_no_end():
    assert [physics.padded_size(count) for count in (1, 16, 17, 1024, 1025, 5000)] == [
        16,
        16,
        32,
        1024,
        2048,
        8192,
    ]

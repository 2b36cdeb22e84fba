from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jaxtyping import TypeCheckError

from metropilot.errors import InputError
from metropilot.railway import (
    Curve,
    Efficiency,
    EffortCurve,
    EffortPiece,
    Journey,
    Line,
    Restriction,
    Station,
    Steps,
    TimingPoint,
    Tunnel,
    load_line,
    load_trainset,
    planned_journey,
)


def steps(*pairs):
    return Steps(np.array([float(a) for a, _ in pairs]), np.array([float(v) for _, v in pairs]))


def toy(**changes):
    fields = {
        "id": "toy",
        "name": "Toy",
        "stations": (
            Station("A", "Alpha", 100.0),
            Station("B", "Beta", 900.0),
            Station("C", "Gamma", 2000.0),
        ),
        "limit_mps": steps((0, 10), (300, 20), (1500, 15)),
        "gradient_permil": steps((0, 0), (500, 10), (1200, -4)),
        "curves": (Curve(200.0, 0.0, 0.002), Curve(250.0, 0.002, 0.002), Curve(600.0, 0.0, 0.0)),
        "tunnels": (Tunnel(950.0, 100.0, 24.0),),
        "planned_forward_s": (70.0, 90.0),
        "planned_backward_s": (72.0, 91.0),
        "dwell_s": (30.0,),
    }
    return Line(**(fields | changes))


@st.composite
def profiles(draw):
    count = draw(st.integers(1, 8))
    gaps = draw(st.lists(st.floats(1.0, 500.0), min_size=count, max_size=count))
    values = draw(st.lists(st.floats(-30.0, 30.0), min_size=count, max_size=count))
    return Steps(np.cumsum(np.array(gaps)), np.array(values))


class TestSteps:
    def test_holds_from_its_break_and_outside(self):
        profile = steps((0, 1), (10, 2))
        np.testing.assert_array_equal(profile.at(np.array([-5.0, 0.0, 9.9, 10.0, 99.0])), [1, 1, 1, 2, 2])

    @given(profile=profiles(), at=st.floats(-100, 5000), origin=st.floats(0, 4000))
    def test_mirrored_is_the_profile_seen_from_the_other_side(self, profile, at, origin):
        if np.abs(profile.from_m - at).min() < 1e-6:
            return
        assert profile.mirror(origin, -1.0).at(origin - at) == -profile.at(at)

    @given(profile=profiles(), origin=st.floats(0, 4000))
    def test_mirroring_twice_gives_the_profile_back(self, profile, origin):
        twice = profile.mirror(origin).mirror(origin)
        middle = (profile.from_m[:-1] + profile.from_m[1:]) / 2
        np.testing.assert_array_equal(twice.at(middle), profile.at(middle))

    @given(profile=profiles(), a=st.floats(-100, 3000), b=st.floats(-100, 3000))
    def test_integral_is_the_sum_over_the_pieces(self, profile, a, b):
        grid = np.sort(np.append(profile.from_m, [a, b]))
        grid = grid[(grid >= min(a, b)) & (grid <= max(a, b))]
        expected = float(np.sum(np.diff(grid) * profile.at(grid[:-1]))) * (1 if b >= a else -1)
        assert float(profile.integral(b) - profile.integral(a)) == pytest.approx(expected, abs=1e-6)

    def test_lowered_keeps_what_is_lower_already(self):
        lowered = steps((0, 10), (100, 20)).lower(50.0, 150.0, 15.0)
        np.testing.assert_array_equal(lowered.at(np.array([0.0, 50, 100, 149, 150])), [10, 10, 15, 15, 20])

    @pytest.mark.parametrize(
        ("from_m", "value", "words"),
        [
            ([0, 0], [1, 2], "must increase"),
            ([5, 1], [1, 2], "must increase"),
            ([0, 1], [1, np.nan], "not finite"),
            ([], [], "one position for each value"),
        ],
    )
    def test_refuses_what_is_no_profile(self, from_m, value, words):
        with pytest.raises(InputError, match=words):
            Steps(np.array(from_m, float), np.array(value, float))


class TestSections:
    def test_forward_is_the_line_moved_to_the_origin(self):
        section = toy().section("B", "C")
        assert (section.length_m, section.planned_time_s, section.name) == (1100.0, 90.0, "B-C")
        np.testing.assert_array_equal(section.limit_mps.at(np.array([0.0, 599, 600])), [20, 20, 15])
        np.testing.assert_array_equal(section.gradient_permil.at(np.array([0.0, 299, 300])), [10, 10, -4])
        assert section.tunnels == (Tunnel(50.0, 100.0, 24.0),)

    def test_backward_mirrors_limits_and_turns_gradients_round(self):
        section = toy().section("C", "B")
        assert (section.length_m, section.planned_time_s) == (1100.0, 91.0)
        np.testing.assert_array_equal(section.limit_mps.at(np.array([0.0, 499, 501])), [15, 15, 20])
        np.testing.assert_array_equal(section.gradient_permil.at(np.array([0.0, 799, 801])), [4, 4, -10])
        assert section.tunnels == (Tunnel(950.0, 100.0, 24.0),)

    def test_backward_reads_a_transition_from_its_other_end(self):
        curves = toy().section("B", "A").curves
        by_start = {round(c.from_m): (c.curvature_start_per_m, c.curvature_end_per_m) for c in curves}
        assert by_start[900 - 600] == (-0.002, -0.002)
        assert by_start[900 - 250] == (-0.002, 0.0)
        assert by_start[900 - 200] == (0.0, 0.0)
        assert [c.from_m for c in curves] == sorted(c.from_m for c in curves)

    def test_a_run_over_several_stations_has_no_planned_time(self):
        assert toy().section("A", "C").planned_time_s is None

    def test_sections_meet_the_stations_in_driving_order(self):
        assert [s.name for s in toy().sections()] == ["A-B", "B-C"]
        assert [s.name for s in toy().sections(backward=True)] == ["C-B", "B-A"]

    @pytest.mark.parametrize("line_id", ["yizhuang", "yizhuang-ttobench"])
    def test_both_directions_climb_the_same_height(self, line_id):
        line = load_line(line_id)
        for there, back in zip(line.sections(), line.sections(backward=True)[::-1], strict=True):
            up = there.gradient_permil.integral(there.length_m) - there.gradient_permil.integral(0.0)
            down = back.gradient_permil.integral(back.length_m) - back.gradient_permil.integral(0.0)
            assert float(up) == pytest.approx(-float(down), abs=1e-6)
            middle = np.linspace(0.5, there.length_m - 0.5, 777)
            np.testing.assert_array_equal(
                there.limit_mps.at(middle), back.limit_mps.at(there.length_m - middle)
            )

    def test_a_section_needs_two_stations(self):
        with pytest.raises(InputError, match="same station"):
            toy().section("A", "alpha")

    def test_a_restriction_lowers_the_limit_and_is_remembered(self):
        section = toy().section("A", "B").with_restriction(Restriction(100.0, 300.0, 5.0))
        np.testing.assert_array_equal(section.limit_mps.at(np.array([99.0, 100, 299, 300])), [10, 5, 5, 20])
        assert len(section.restrictions) == 1

    @pytest.mark.parametrize(
        ("args", "said"),
        [
            ((5, 5, 10), "restriction"),
            ((5, 9, 0), "limit_mps: out of range: 0.0 km/h"),
            ((0, np.inf, 3), "to_m: out of range: inf m"),
            ((0, 5, np.nan), "limit_mps: out of range: nan km/h"),
            ((5, 9, 1.3), "limit_mps: out of range: 4.68 km/h"),
            ((5, 9, 112), "limit_mps: out of range: 403.2 km/h"),
        ],
    )
    def test_a_restriction_must_make_sense(self, args, said):
        with pytest.raises(InputError, match=said):
            Restriction(*(float(a) for a in args))


class TestStations:
    @pytest.mark.parametrize(
        ("key", "code"),
        [
            ("RJ", "RJ"),
            ("rj", "RJ"),
            ("Rongjing", "RJ"),
            ("rongjing east street", "RJ"),
            ("RongjingDongjie", "RJ"),
            ("荣京东街", "RJ"),
            ("Wanyuanjie", "WYJ"),
            ("wanyuan street", "WYJ"),
            ("ciqu", "CQ"),
            ("Ciqu S", "CQN"),
            ("xiaoh", "XHM"),
        ],
    )
    def test_found_by_code_name_or_beginning(self, key, code):
        assert load_line("yizhuang").station(key).code == code

    @pytest.mark.parametrize(
        ("key", "words"),
        [
            ("Yizhuang", "ambiguous.*YZQ.*WHY.*YZHC"),
            ("Xiao", "ambiguous.*XC.*XHM"),
            ("Atlantis", "unknown station.*SJZ.*YZHC"),
            ("", "unknown station"),
            ("--", "unknown station"),
        ],
    )
    def test_otherwise_the_candidates_are_listed(self, key, words):
        with pytest.raises(InputError, match=words) as caught:
            load_line("yizhuang").station(key)
        assert "\n" not in caught.value.line()


class TestLine:
    @pytest.mark.parametrize(
        ("changes", "words"),
        [
            ({"stations": (Station("A", "Alpha", 0.0),)}, "needs stations.*at least 2"),
            (
                {"stations": (Station("A", "Alpha", 5.0), Station("B", "Beta", 5.0))},
                r"stations\[1\].position",
            ),
            ({"stations": (Station("A", "Alpha", 0.0), Station("a", "Beta", 5.0))}, "code used twice"),
            ({"planned_forward_s": (1.0,)}, "wrong length.*1.*allowed: 2"),
            ({"planned_backward_s": (1.0, 2.0, 3.0)}, "wrong length.*3.*allowed: 2"),
            ({"dwell_s": (1.0, 2.0)}, "wrong length.*2.*allowed: 1"),
            ({"limit_mps": steps((0, 10), (5, 0))}, "speed limit out of range"),
        ],
    )
    def test_refuses_parts_that_do_not_fit(self, changes, words):
        with pytest.raises(InputError, match=words):
            toy(**changes)


class TestEffort:
    def test_a_piece_is_hyperbola_plus_polynomial_capped_and_never_negative(self):
        curve = EffortCurve((EffortPiece(0.0, (100.0, -10.0, 0.0, 0.0), power_w=50.0, cap_n=80.0),))
        np.testing.assert_allclose(curve.at(np.array([1.0, 5.0, 20.0])), [80.0, 60.0, 0.0])

    def test_a_table_is_linear_between_and_constant_after(self):
        curve = EffortCurve.table(np.array([0.0, 10.0, 20.0]), np.array([100.0, 100.0, 40.0]))
        np.testing.assert_allclose(
            curve.at(np.array([0.0, 5.0, 10.0, 15.0, 20.0, 99.0])), [100, 100, 100, 70, 40, 40]
        )

    def test_force_and_power(self):
        curve = EffortCurve.force_power(200e3, 2e6)
        np.testing.assert_allclose(curve.at(np.array([0.0, 10.0, 20.0])), [200e3, 200e3, 100e3])

    @pytest.mark.parametrize("shape", [(), (4,), (2, 3)])
    def test_keeps_the_shape_of_the_speeds(self, shape):
        assert EffortCurve.constant(5.0).scale(2.0).at(np.ones(shape)).shape == shape

    @pytest.mark.parametrize("starts", [[], [1.0], [0.0, 5.0, 5.0]])
    def test_pieces_begin_at_standstill_and_increase(self, starts):
        with pytest.raises(InputError):
            EffortCurve(tuple(EffortPiece(s) for s in starts))


class TestEfficiency:
    def test_compares_by_value(self):
        assert Efficiency.constant(0.9) == Efficiency.constant(0.9)
        assert hash(Efficiency.constant(0.9)) == hash(Efficiency.constant(0.9))
        assert Efficiency.constant(0.9) != Efficiency.constant(0.8)

    @pytest.mark.parametrize("value", [0.0, 1.1, np.nan, -1.0])
    def test_lies_between_0_and_1(self, value):
        with pytest.raises(InputError, match="efficiency out of range"):
            Efficiency.constant(float(value))

    def test_needs_a_full_map(self):
        # Under pytest the checked shapes of the annotations complain first; without them the class does.
        with pytest.raises((InputError, TypeCheckError)):
            Efficiency(np.zeros(2), np.zeros(1), np.ones((1, 1)))


class TestTrainset:
    def test_loads(self):
        full = load_trainset("dkz32").with_load("AW3")
        assert (full.mass_kg, full.effective_mass_kg) == (307095.0, 307095.0)
        with pytest.raises(InputError, match=r"unknown load.*AW5.*AW0, AW2, AW3"):
            full.with_load("AW5")

    def test_ideal_keeps_the_rates_and_drops_the_delays(self):
        ideal = load_trainset("dkz32").ideal()
        assert ideal.actuation.jerk_limit_mps3 == np.inf
        assert ideal.safe_braking.buildup_s == 0.0
        assert ideal.safe_braking.emergency_deceleration_mps2 == 1.2

    @pytest.mark.parametrize(
        ("key", "value", "allowed"),
        [
            ("delay_s", -0.1, "0 to 10 s"),
            ("lag_s", 30.0, "0 to 10 s"),
            ("jerk_limit_mps3", 0.001, "0.05 to 100 m/s\\^3, or inf"),
            ("jerk_limit_mps3", np.nan, "0.05 to 100"),
        ],
    )
    def test_an_actuation_that_no_drive_ends_with_is_refused(self, key, value, allowed):
        known = load_trainset("dkz32")
        with pytest.raises(InputError, match=rf"dkz32: actuation.{key}: out of range.*{allowed}"):
            replace(known, actuation=replace(known.actuation, **{key: value}))

    @pytest.mark.parametrize(
        ("old", "new", "allowed"),
        [
            ("delay = 0", "delay = 6", "0 to 5 s"),
            ("lag = 0", "lag = 30", "0 to 5 s"),
            ("jerk_limit = 1.0", "jerk_limit = 0.001", "0.05 to 100 m/s\\^3, or inf"),
        ],
    )
    def test_so_is_one_of_a_file(self, tmp_path, old, new, allowed):
        text = (files("metropilot.railway") / "catalogue/trainsets/dkz32.toml").read_text(encoding="utf-8")
        (tmp_path / "slow.toml").write_text(text.replace(f"\n{old}\n", f"\n{new}\n"))
        with pytest.raises(InputError, match=rf"actuation.{old.split()[0]}: out of range.*{allowed}"):
            load_trainset(tmp_path / "slow.toml")

    @pytest.mark.parametrize(
        ("field", "value"),
        [
            ("length_m", -1.0),
            ("max_speed_mps", 0.0),
            ("max_acceleration_mps2", float("nan")),
            ("loads", {"AW0": -5.0}),
            ("rotating_fraction", float("inf")),
        ],
    )
    def test_refuses_numbers_out_of_range(self, field, value):
        with pytest.raises(InputError, match="out of range"):
            replace(load_trainset("dkz32"), **{field: value})


class TestJourney:
    def test_the_planned_journey_is_the_timetable(self):
        there = planned_journey(load_line("yizhuang"))
        assert len(there.points) == 2 + 2 * 12
        assert there.points[-1].earliest_s == 1662 + 385
        back = planned_journey(load_line("yizhuang"), backward=True, tolerance_s=5.0)
        assert back.points[0].position_m == 22728.0
        assert back.points[-1].latest_s == 1662 - 2 + 385 + 5
        assert all(p.is_stop for p in back.points)

    def test_a_line_without_times_has_no_planned_journey(self):
        with pytest.raises(InputError, match="no planned running times"):
            planned_journey(toy(planned_forward_s=(), planned_backward_s=()))

    @pytest.mark.parametrize(
        ("points", "words"),
        [
            ((TimingPoint(0.0),), "at least 2"),
            (
                (TimingPoint(0.0), TimingPoint(9.0), TimingPoint(5.0), TimingPoint(20.0)),
                "positions turn back",
            ),
            ((TimingPoint(0.0, 5.0, 1.0), TimingPoint(9.0)), r"\[0\].latest: window ends before it begins"),
            ((TimingPoint(0.0), TimingPoint(9.0, None, None, 5.0, 1.0)), r"\[1\].fastest"),
            ((TimingPoint(0.0, 100.0), TimingPoint(9.0, None, 50.0)), r"\[1\].latest: earlier"),
            ((TimingPoint(0.0), TimingPoint(float("nan"))), "must be finite"),
        ],
    )
    def test_refuses_what_nothing_could_drive(self, points, words):
        with pytest.raises(InputError, match=words):
            Journey("j", "toy", points)

"""The catalogue against the published facts it was typed in from, worked out by hand or formula."""

import numpy as np
import pytest

from metropilot.errors import InputError
from metropilot.railway import (
    list_lines,
    list_trainsets,
    load_journey,
    load_line,
    load_trainset,
    planned_journey,
)

POSITIONS = [0, 2631, 3906, 6272, 8254, 9247, 10785, 12065, 13419, 15757, 18022, 20108, 21394, 22728]
KMH = 1 / 3.6
YIZHUANG = ("yizhuang", "yizhuang-ttobench")


def test_what_is_in_it():
    assert set(YIZHUANG) <= set(list_lines())
    assert {"dkz32", "cheng2023", "cn_beijing_subway"} <= set(list_trainsets())


@pytest.mark.parametrize("key", list_lines())
def test_every_block_of_a_line_names_its_source(key):
    line = load_line(key)
    optional = {"curves": line.curves, "tunnels": line.tunnels, "timetable": line.planned_forward_s}
    given = {block for block, data in optional.items() if data}
    assert set(line.source) == {"stations", "speed_limits", "gradients"} | given
    assert line.id == key


@pytest.mark.parametrize("key", list_trainsets())
def test_every_block_of_a_trainset_names_its_source(key):
    trainset = load_trainset(key)
    assert {"mass", "body", "resistance", "traction", "electric_brake", "limits"} <= set(trainset.source)
    assert trainset.id == key
    assert trainset.notes


@pytest.mark.parametrize("key", YIZHUANG)
class TestYizhuang:
    def test_stations(self, key):
        line = load_line(key)
        assert [s.position_m for s in line.stations] == POSITIONS
        assert (
            " ".join(s.code for s in line.stations) == "SJZ XC XHM JG YZQ WHY WYJ RJ RC TJN JHL CQN CQ YZHC"
        )

    def test_planned_times(self, key):
        line = load_line(key)
        assert sum(line.planned_forward_s) == 1662
        assert line.section("SJZ", "XC").planned_time_s == 190
        # Huang25 drives Rongjing to Wanyuan in 101 s; forward it is 103 s.
        assert line.section("RJ", "WYJ").planned_time_s == 101
        assert line.section("WYJ", "RJ").planned_time_s == 103
        assert len(line.dwell_s) == 12

    def test_no_platform_is_passed_in_a_section_without_a_limit(self, key):
        line = load_line(key)
        for section in (*line.sections(), *line.sections(backward=True)):
            limit = section.limit_mps.at(np.linspace(0, section.length_m, 500))
            assert 40 * KMH - 1e-9 <= limit.min() <= limit.max() <= 84 * KMH + 1e-9


def test_yizhuang_limits_and_gradients_of_the_contest():
    line = load_line("yizhuang")
    # 55 km/h on the Songjiazhuang side of each stop: before it forward, after departure backward.
    assert float(line.limit_mps.at(2600.0)) == 55 / 3.6
    assert float(line.limit_mps.at(2700.0)) == 80 / 3.6
    assert float(line.limit_mps.at(22750.0)) == 40 / 3.6
    assert float(line.gradient_permil.at(4500.0)) == -24.0
    assert float(line.gradient_permil.at(18500.0)) == 24.0
    assert min(1 / c.curvature_start_per_m for c in line.curves if c.curvature_start_per_m) == pytest.approx(
        350
    )


def test_yizhuang_ttobench_is_corrected_and_says_so():
    line = load_line("yizhuang-ttobench")
    assert line.section("YZQ", "WHY").length_m == 993.0
    assert line.section("WHY", "WYJ").length_m == 1538.0
    assert "9274" in line.notes[0]
    # Huang25: 60 km/h for 0 to 132 m, 84 to 1268 m, 60 to 1280 m, driven backward.
    limit = line.section("RJ", "WYJ").limit_mps
    np.testing.assert_allclose(
        limit.at(np.array([0.0, 131.9, 132.1, 1267.9, 1268.1])) * 3.6, [60, 60, 84, 84, 60]
    )


class TestDkz32:
    @pytest.mark.parametrize(("load", "mass_t"), [("AW0", 194.295), ("AW2", 284.055), ("AW3", 307.095)])
    def test_loads(self, load, mass_t):
        assert load_trainset("dkz32", load).mass_kg == pytest.approx(mass_t * 1000)
        assert load_trainset(f"dkz32:{load}").load == load

    @pytest.mark.parametrize(("kmh", "kn"), [(0, 203), (51, 203), (60, 150.4), (70, 111.6), (80, 86.1)])
    def test_traction(self, kmh, kn):
        assert float(load_trainset("dkz32").traction.at(kmh * KMH)) / 1e3 == pytest.approx(kn, abs=0.05)

    @pytest.mark.parametrize(("kmh", "kn"), [(0, 166), (76.9, 166), (80, 153.9)])
    def test_braking(self, kmh, kn):
        assert float(load_trainset("dkz32").electric_brake.at(kmh * KMH)) / 1e3 == pytest.approx(kn, abs=0.05)

    @pytest.mark.parametrize(("kmh", "n_per_kn"), [(0, 2.03), (40, 7.41), (60, 12.27), (80, 18.57)])
    def test_davis(self, kmh, n_per_kn):
        trainset = load_trainset("dkz32")
        a, b, c = trainset.davis.newtons(trainset.mass_kg)
        v = kmh * KMH
        weight_kn = trainset.mass_kg * 9.81 / 1000
        assert (a + b * v + c * v * v) / weight_kn == pytest.approx(n_per_kn, abs=0.006)

    def test_davis_grows_with_the_load(self):
        empty, full = load_trainset("dkz32:AW0"), load_trainset("dkz32:AW3")
        ratio = full.davis.newtons(full.mass_kg)[0] / empty.davis.newtons(empty.mass_kg)[0]
        assert ratio == pytest.approx(307.095 / 194.295)

    def test_friction_brake_reaches_the_emergency_rate_at_the_heaviest_load(self):
        trainset = load_trainset("dkz32:AW3")
        force = trainset.friction_brake_n + float(trainset.electric_brake.at(80 * KMH))
        assert force / trainset.mass_kg > trainset.safe_braking.emergency_deceleration_mps2

    def test_notches_are_the_twelve_of_lu2023(self):
        levels = load_trainset("dkz32").notches["lu2023"]
        assert [round(f / 1000) for f in levels] == [-149, -132, -99, -66, -33, 0, 34, 68, 102, 136, 170, 180]

    def test_limits(self):
        trainset = load_trainset("dkz32")
        assert (trainset.max_acceleration_mps2, trainset.max_deceleration_mps2) == (1.0, 1.0)
        assert trainset.actuation.jerk_limit_mps3 == 1.0
        assert (trainset.length_m, trainset.couplers.vehicles) == (118.0, 6)
        assert trainset.rotating_fraction == 0.0


class TestCheng2023:
    @pytest.mark.parametrize(
        ("kmh", "traction", "brake"),
        [(0, 345.19, 342.2), (39, 345.19, 342.2), (60, 180, 220), (80, 100, 117)],
    )
    def test_effort(self, kmh, traction, brake):
        trainset = load_trainset("cheng2023")
        assert float(trainset.traction.at(kmh * KMH)) / 1e3 == pytest.approx(traction, abs=0.5)
        assert float(trainset.electric_brake.at(kmh * KMH)) / 1e3 == pytest.approx(brake, abs=0.5)

    def test_no_force_above_the_plateau_that_the_rounded_cubics_would_give(self):
        trainset = load_trainset("cheng2023")
        speed = np.linspace(0, 80 * KMH, 2000)
        assert trainset.traction.at(speed).max() == 345190.0
        assert trainset.electric_brake.at(speed).max() == 342200.0
        assert (np.diff(trainset.traction.at(speed)) <= 1e-9).all()

    def test_resistance_is_n_per_kn(self):
        trainset = load_trainset("cheng2023")
        a, _, _ = trainset.davis.newtons(trainset.mass_kg)
        assert a == pytest.approx(0.6841 * 300 * 9.81)


@pytest.mark.parametrize(("key", "zone"), [("lu2023", 80), ("lu2023-restricted", 55)])
def test_lu2023_section(key, zone):
    # Lu23 Table 2, and section 4.2 for the restriction; the column headed % is permil
    section = load_line(key).section("WHY", "WYJ")
    assert section.length_m == 1538.0
    at = np.array([0.0, 119.0, 121.0, 179.0, 181.0, 566.0, 568.0, 601.0, 891.0, 893.0, 929.0, 931.0, 1381.0])
    gradient = [0, 0, -2, -2, -2, -2, 5, 5, 5, 3, 3, 3, 0]
    limit = [55, 55, 55, 55, 80, 80, 80, zone, zone, zone, zone, 80, 55]
    np.testing.assert_allclose(section.gradient_permil.at(at), gradient)
    np.testing.assert_allclose(section.limit_mps.at(at) * 3.6, limit)
    np.testing.assert_allclose(section.limit_mps.at(np.array([1369.0, 1371.0])) * 3.6, [80, 55])


def test_lu2023_trainset_is_a_point_mass_with_the_strongest_notches():
    trainset = load_trainset("lu2023")
    assert (trainset.mass_kg, trainset.length_m, trainset.rotating_fraction) == (194300.0, 0.0, 0.0)
    levels = trainset.notches["lu2023"]
    assert (levels[0], levels[-1], len(levels)) == (-149e3, 180e3, 12)
    assert float(trainset.traction.at(0.0)) == levels[-1]
    assert float(trainset.electric_brake.at(80 * KMH)) == -levels[0]


def test_beijing_subway_of_ttobench():
    trainset = load_trainset("cn_beijing_subway")
    assert trainset.mass_kg == 278000
    np.testing.assert_allclose(trainset.traction.at(np.array([0.0, 10.0, 20.0])), [310e3, 310e3, 155e3])
    assert trainset.davis.newtons(1.0)[2] == pytest.approx(0.0022294 * 1000 * 3.6**2)
    assert float(trainset.efficiency_traction.value[0, 0]) == 0.7
    assert (trainset.max_acceleration_mps2, trainset.friction_brake_n) == (np.inf, 0.0)


def test_journeys_of_the_catalogue_are_the_planned_ones():
    assert load_journey("yizhuang-backward") == planned_journey(load_line("yizhuang"), backward=True)


@pytest.mark.parametrize(
    ("load", "key", "words"),
    [
        (load_line, "yizuang", "unknown line, did you mean 'yizhuang'.*yizhuang-ttobench"),
        (load_line, "", "unknown line"),
        (load_trainset, "dkz", "unknown trainset, did you mean 'dkz32'.*cheng2023"),
        (load_trainset, "dkz32:AW9", "unknown load.*AW9.*AW0, AW2, AW3"),
        (load_trainset, "../dkz32", "unknown trainset"),
        (load_journey, "yizhuang", "unknown journey.*yizhuang-forward"),
    ],
)
def test_an_unknown_id_lists_the_catalogue(load, key, words):
    with pytest.raises(InputError, match=words):
        load(key)

"""Coupling and uncoupling on the move: when, where and for what energy; convoys without room are refused."""

from dataclasses import replace

import numpy as np
import pytest
from tests import commands

from metropilot.convoy import (
    ConvoyDrive,
    ConvoyKpis,
    ConvoyRequest,
    convoy_figure,
    convoy_kpis,
    find_manoeuvres,
)
from metropilot.convoy.manoeuvre import keeping_energy_j
from metropilot.errors import Infeasible, InputError
from metropilot.evaluate import RunSpec
from metropilot.units import J_PER_KWH

HEAD = RunSpec("yizhuang", "RJ", "WYJ", time_s=130.0, trainset="cheng2023", dt_s=0.1)
REQUEST = ConvoyRequest(HEAD, start_gap_m=24.0, uncouple_at_m=980.0, apart_m=50.0)


@pytest.fixture(scope="module")
def drive() -> ConvoyDrive:
    return REQUEST.drive()


@pytest.fixture(scope="module")
def kpis(drive: ConvoyDrive) -> ConvoyKpis:
    return convoy_kpis(drive, 130.0)


def test_a_convoy_couples_and_parts_before_its_place(drive: ConvoyDrive, kpis: ConvoyKpis):
    assert kpis.success, kpis.verdict
    coupling, parting = kpis.manoeuvres
    assert (coupling.kind, parting.kind) == ("coupling", "uncoupling")
    assert (coupling.trainset, coupling.gap_to_m, parting.gap_to_m) == (2, 5.92, 50.0)
    assert coupling.done_s is not None
    assert parting.done_m is not None
    assert coupling.begun_s < coupling.done_s <= parting.begun_s
    assert parting.begun_m < parting.done_m <= 980.0
    gap = np.interp([coupling.begun_s, coupling.done_s], drive.time_s, drive.gap_m[:, 0])
    assert gap == pytest.approx([24.0, 5.92], abs=0.6)
    assert kpis.as_dict()["manoeuvres"][0]["kind"] == "coupling"


def test_an_uncoupling_begins_where_the_gap_opens_for_it():
    """It began at departure, 118 m before the origin, where protection had opened the gap from 6 to 36 m."""
    drive = replace(REQUEST, start_gap_m=None).drive()
    for opened_m in (6.0, 36.0):
        time_s = drive.time_s
        gap_m = np.interp(
            time_s, [0.0, 20.0, 40.0, 60.0, 70.0, 90.0], [5.92, opened_m, opened_m, 12.0, 12.0, 50.0]
        )
        parting = find_manoeuvres(replace(drive, gap_m=gap_m[:, None]))[0]
        assert parting.begun_s == pytest.approx(70.2, abs=0.25)
        assert parting.gap_from_m == pytest.approx(12.0, abs=0.6)


def test_closing_and_opening_a_gap_take_more_energy_than_keeping_it(kpis: ConvoyKpis):
    for each in kpis.manoeuvres:
        assert each.energy_kwh > each.apart_energy_kwh > 0.0


def test_the_energy_of_keeping_a_gap_is_that_of_the_plant(drive: ConvoyDrive):
    head = drive.trajectories[0]
    own_kwh = head.energy_wheel_j[-1] / J_PER_KWH
    assert keeping_energy_j(drive, 0, 0.0, head.time_s[-1]) / J_PER_KWH == pytest.approx(own_kwh, rel=2e-3)


def test_a_gap_that_closes_after_the_head_stands_is_not_coupled_in_time(drive: ConvoyDrive):
    late = replace(drive, gap_m=drive.gap_m.copy())
    moves = drive.time_s < 128.0
    late.gap_m[moves] = 40.0 - 0.2 * drive.time_s[moves, None]
    found = find_manoeuvres(late)
    assert [each.done_s for each in found] == [None, None]
    judged = convoy_kpis(late, 130.0)
    assert not judged.success
    assert "coupling of trainset 2 not done in time" in judged.verdict
    assert "couples and parts in time" in judged.as_dict()["failed"]


def test_an_open_gap_that_protection_widens_for_a_while_stays_open(drive: ConvoyDrive):
    """Its speed difference counted, too, and called late what had long been open. But it stays open."""
    _, parting = find_manoeuvres(drive)
    assert parting.done_s is not None
    later_s = drive.time_s - parting.done_s
    swell = np.interp(later_s, [0.0, 8.0, 24.0], [0.0, 8.0, 0.0])[:, None]
    opening = np.gradient(swell[:, 0], drive.time_s)[:, None]
    wide = replace(
        drive, gap_m=drive.gap_m + swell, speed_difference_mps=drive.speed_difference_mps + opening
    )
    assert find_manoeuvres(wide)[1].done_s == parting.done_s
    shut = replace(drive, gap_m=np.where((later_s > 1.0)[:, None] & (drive.gap_m > 45.0), 45.0, drive.gap_m))
    assert find_manoeuvres(shut)[1].done_s is None
    again = (later_s < -10.0) & (later_s > -14.0)
    early = replace(drive, gap_m=np.where(again[:, None], 50.0, drive.gap_m))
    assert find_manoeuvres(early)[1].done_s == parting.done_s


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"start_gap_m": 800.0}, "there are 1280 m"),
        ({"start_gap_m": 200.0, "uncouple_at_m": 900.0}, "before it uncouples"),
        ({"uncouple_at_m": 150.0}, "cannot be open there"),
    ],
)
def test_a_convoy_without_room_is_refused_and_told_what_it_takes(wrong: dict[str, float], words: str):
    request = ConvoyRequest(HEAD, **wrong)  # pyright: ignore[reportArgumentType]
    with pytest.raises(Infeasible, match=words) as refused:
        request.drive()
    assert "about" in str(refused.value)


def test_a_gap_that_closes_only_at_the_stop_is_refused():
    """It was driven, and failed: the gap was not held for 3 s before the stop."""
    head = RunSpec("yizhuang", "RJ", "WYJ", time_s=150.0, trainset="cheng2023", dt_s=0.1)
    with pytest.raises(Infeasible, match="about 1300 m of way, there are 1280 m"):
        ConvoyRequest(head, start_gap_m=400.0).drive()


def test_a_mixed_convoy_closes_what_it_can_drive():
    """It was refused from 95 m on, and 97 to 105 m arrive coupled and on time."""
    head = RunSpec("yizhuang", "SJZ", "XC", time_s=215.0, trainset="dkz32", dt_s=0.1)
    request = ConvoyRequest(head, count=3, behind=("cheng2023", "dkz32"), start_gap_m=200.0)
    with pytest.raises(Infeasible, match="there are 2631 m") as refused:
        request.drive()
    assert refused.value.allowed == "up to about 109 m here"


def test_a_place_beyond_the_stop_is_refused():
    with pytest.raises(InputError, match="below 1280 m"):
        ConvoyRequest(HEAD, uncouple_at_m=1300.0).convoy()


def test_a_gap_no_wider_than_that_of_the_coupled_is_refused():
    """It was driven: trainsets uncoupled to a gap of 3 m."""
    with pytest.raises(InputError, match=r"apart_m: .*3.0 m \(allowed: above 5.92 m\)"):
        ConvoyRequest(HEAD, uncouple_at_m=900.0, apart_m=3.0).convoy()
    assert ConvoyRequest(HEAD, apart_m=3.0).convoy().apart_m == 3.0


def test_the_picture_has_the_planned_gap(drive: ConvoyDrive, kpis: ConvoyKpis):
    """It stated the gap of the coupled alone, on an axis that began before the departure."""
    _, gap, _ = convoy_figure(drive, kpis).axes
    heights = [np.asarray(line.get_ydata()) for line in gap.lines]
    assert any(np.array_equal(drive.planned_gap_m[:, 0], each) for each in heights)
    assert gap.get_xlim() == (0.0, drive.time_s[-1])
    assert "(wanted 5.92 m, 50 m from 980 m on)" in gap.get_title(loc="left")


def test_the_command_line_names_the_option_and_the_room(tmp_path):
    words = "convoy yizhuang RJ WYJ --time 130 --start-gap 800 --trainset cheng2023"
    told = commands.run(*words.split(), cwd=tmp_path)
    assert told.code == 2
    assert told.err.startswith("metropilot: --start-gap: the gap cannot be closed before the stop")
    assert told.err.count("\n") == 1


def test_followers_may_be_of_other_trainsets():
    asked = ConvoyRequest.from_values(
        {"head": HEAD.values(), "count": 4, "behind": ["dkz32:AW2", "cheng2023"]}
    )
    names = [each.id for each in asked.convoy().trainsets]
    assert names == ["cheng2023", "dkz32", "cheng2023", "cheng2023"]
    assert ConvoyRequest.from_values(asked.values()) == asked
    with pytest.raises(InputError, match="at most 1"):
        replace(asked, count=2)
    with pytest.raises(InputError, match="behind"):
        replace(asked, behind=("dkz33",)).convoy()

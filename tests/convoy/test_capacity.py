"""Capacity: headways grow with dwell, length and caution, and short platforms take the gain of a convoy."""

from dataclasses import replace
from functools import cache

import pytest

from metropilot.convoy import Convoy, ServiceOptions, line_capacity, needed_gap_m
from metropilot.errors import InputError
from metropilot.planning import minimum_running_time
from metropilot.railway import load_line, load_trainset

TRAINSET = load_trainset("cheng2023")


def sections():
    line = load_line("yizhuang")
    return line.section("WYJ", "RJ"), line.section("RJ", "RC")


@cache
def capacities(counts=(1, 2), **given):
    rows = line_capacity(sections(), TRAINSET, counts, options=ServiceOptions(**given))
    return {(row.count, row.guard): row for row in rows}


def test_a_longer_dwell_is_a_longer_headway():
    short, long = capacities(), capacities(dwell_s=50.0)
    for key, row in short.items():
        assert long[key].headway_s - row.headway_s == pytest.approx(20.0, abs=0.6)
        assert long[key].journey_s - row.journey_s == pytest.approx(20.0, abs=1.1)


def test_declared_brakes_are_nearer_than_a_moving_block_and_convoys_take_more():
    found = capacities()
    for count in (1, 2):
        assert found[count, "independent"].headway_s < found[count, "moving_block"].headway_s
        assert found[count, "independent"].plain_headway_s < found[count, "moving_block"].plain_headway_s
    for guard in ("moving_block", "independent"):
        one, two = found[1, guard], found[2, guard]
        assert 1.2 * one.trainsets_per_h < two.trainsets_per_h < 2.0 * one.trainsets_per_h
        assert two.convoy_m == pytest.approx(2 * TRAINSET.length_m + two.gap_m)
        assert one.plain_per_h > 2.0 * one.trainsets_per_h


def test_a_headway_holds_dwell_clearing_the_platform_and_running_in():
    # the next head stands at its mark only after the rear before it, and brakes from its own distance
    row = capacities()[1, "moving_block"]
    clear_s = (2.0 * TRAINSET.length_m / TRAINSET.max_acceleration_mps2) ** 0.5
    top_mps = 20.0
    assert row.headway_s > 30.0 + clear_s
    assert row.headway_s < 30.0 + 2.0 * clear_s + 2.0 * top_mps / 0.8
    section = max(sections(), key=lambda each: each.length_m)
    pair = Convoy(section=section, trainsets=(TRAINSET,) * 2)
    needed = needed_gap_m(pair, "moving_block", 60.0 / 3.6)
    assert row.plain_headway_s > (TRAINSET.length_m + needed) / top_mps


def test_a_short_platform_takes_a_second_stop():
    long, short = capacities((4,)), capacities((4,), platform_m=200.0)
    for guard in ("moving_block", "independent"):
        assert (long[4, guard].stops_at_platform, short[4, guard].stops_at_platform) == (1, 2)
        assert short[4, guard].headway_s > long[4, guard].headway_s + 30.0
    assert (
        capacities((4,), platform_m=400.0)[4, "moving_block"].headway_s == long[4, "moving_block"].headway_s
    )


def test_the_journey_is_as_long_as_running_times_and_dwells():
    row = capacities(reserve=0.2)[1, "moving_block"]
    running = sum(1.2 * minimum_running_time(each, TRAINSET) for each in sections())
    assert row.journey_s == pytest.approx(running + 30.0, abs=1.0)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"counts": (0,)}, "counts"),
        ({"counts": (17,)}, "counts"),
        ({"guards": ("coupled",)}, "guard"),
        ({"options": ServiceOptions(platform_m=50.0)}, "platform_m"),
        ({"sections": sections()[:1]}, "destination"),
    ],
)
def test_bad_input_is_refused(change, field):
    given = {"sections": sections(), "trainset": TRAINSET, "counts": (1,)} | change
    with pytest.raises(InputError) as said:
        line_capacity(**given)
    assert said.value.field == field


def test_options_have_ranges():
    with pytest.raises(InputError, match="dwell_s"):
        replace(ServiceOptions(), dwell_s=-1.0)

"""The benchmarks' page and numbers; what they measure is measured by `make bench`."""

import math
from dataclasses import replace

import numpy as np
import pytest
from benchmarks import generalist
from benchmarks.beside_optimum import Result
from benchmarks.feeding import day_starts, variants
from benchmarks.generalist import (
    IDEAL,
    LATE,
    LIMITED,
    Case,
    beside_policy,
    drive_all,
    spread,
    verdict,
    wide_cases,
)
from benchmarks.report import Benchmark, Row, cells, circumstances, format_page, number, replace_section
from benchmarks.shanghai import replica, working_day

from metropilot.policy import load_driving_policy, shipped_policy
from metropilot.railway import load_feeding


@pytest.mark.parametrize(
    ("value", "text"), [(12_345_678, "12,300,000"), (3.14159, "3.14"), (0.01234, "0.0123")]
)
def test_numbers_have_three_digits(value, text):
    assert number(value) == text


def test_a_section_of_the_page_is_replaced_and_the_rest_kept():
    page = replace_section(replace_section("# Benchmarks\n", "plant", "old"), "plan", "other")
    again = replace_section(page, "plant", "new")
    assert "old" not in again
    assert again == page.replace("old", "new")
    assert again.index("new") < again.index("other")


def test_a_table_says_where_and_when_it_was_measured():
    about = circumstances(("numpy",))
    assert set(about) == {"machine", "date", "commit", "versions"}
    assert "numpy" in about["versions"]
    rows = [Row("baseline", 10.0, "steps/s", 1.0), Row("ours", 1000.0, "steps/s", 100.0, "more")]
    text = format_page(Benchmark("x", "A title", (), lambda: rows, "A note."), rows, about)
    assert "| " + " | ".join(cells(rows[1])) + " |" in text
    assert about["commit"] in text


def test_a_day_of_the_feeding_benchmark_has_324_journeys():
    forward, backward = day_starts(1.0)
    assert len(forward) + len(backward) == 324
    assert max(forward) < 18 * 3600
    assert set(np.diff(forward).tolist()) == {240, 496}


def test_the_replica_of_shanghai_has_the_published_length_and_stations():
    line, day = replica(), working_day()
    assert len(line.stations) == 30
    assert line.stations[-1].position_m == 37_400.0
    lengths_m = np.diff([each.position_m for each in line.stations])
    assert 700.0 < lengths_m.min() < lengths_m.max() < 3000.0
    assert [each.headway_s for each in day.periods] == [100, 90, 100, 90, 100]
    assert 1331 <= 2 * sum((p.to_s - p.from_s) / p.headway_s for p in day.periods) <= 1336


def test_each_variant_of_the_feeding_changes_one_number():
    usual, *changed = (feeding for _, feeding in variants(load_feeding("yizhuang")))
    assert usual == load_feeding("yizhuang")
    assert all(each != usual for each in changed)


CASE = Case("yizhuang", "RJ", "WYJ", "dkz32", "AW0", 1.1, LIMITED)
GOOD = Result(CASE, "arrived", 110.0, 0.2, 0.01, 2.0, 0.4, math.nan, 0.0, 0, 900.0)


def test_runs_in_the_rows_are_not_driven_again(tmp_path, monkeypatch):
    driven, path = [], tmp_path / "rows.jsonl"
    left_out = replace(CASE, ratio=0.0)

    def drive_case(case):
        driven.append(case)
        return None if case == left_out else replace(GOOD, case=case)

    monkeypatch.setattr(generalist, "drive_case", drive_case)
    assert list(drive_all([CASE, left_out], 1, path)) == [CASE]
    other = replace(CASE, policy="mine")
    found = drive_all([CASE, left_out, other], 1, path)
    assert driven == [CASE, left_out, other]
    assert list(found) == [CASE, other]
    assert found[CASE].excess == GOOD.excess
    assert math.isnan(found[CASE].floor)


def test_other_trainsets_drive_the_same_runs_with_every_dead_time():
    cases = wide_cases([])
    assert {case.trainset for case in cases} >= {"drawn-18-3", "drawn-18-3@0,0", "drawn-18-3@1,0.6"}
    runs = [(c.line, c.origin, c.destination, c.load, c.ratio) for c in cases]
    size = len(LATE)
    assert all(len(set(runs[k : k + size])) == 1 for k in range(0, len(runs), size))


def test_the_verdict_judges_ideal_runs_by_the_optimum_and_others_by_the_attainable_one():
    ideal = replace(GOOD, case=replace(CASE, scenario=IDEAL), gap=0.3, excess=9.0)
    assert verdict([GOOD, ideal]) == "All are met."
    assert (
        verdict([replace(GOOD, excess=0.6), ideal]) == "Missed: jerk limit, median: 0.60 % instead of 0.5 %."
    )
    assert "jerk limit: 1 of 1 runs not within 0.5 s and 0.1 m" in verdict(
        [replace(GOOD, time_error_s=0.7), ideal]
    )
    assert "interventions in 1 of 1" in verdict([replace(GOOD, interventions=2), ideal])


def test_what_has_no_attainable_optimum_is_left_out_of_the_spread():
    assert spread([1.0, math.nan, 2.0, 3.0]) == "2.00 / 2.90 / 3.00"
    assert spread([math.nan]) == "–"


def test_another_policy_stands_beside_the_shipped_one_in_the_same_runs():
    path = str(shipped_policy("ppo"))
    other = replace(GOOD, case=replace(CASE, policy=path), excess=3.0)
    far, near = (replace(r, case=replace(r.case, trainset="drawn-18-1@0,0")) for r in (GOOD, other))
    text = beside_policy([(GOOD, other), (far, near)], path)
    assert load_driving_policy(path).about["provenance"]["command"] in text
    assert (
        "| jerk limit, other | 1 | 1 | +0.20 | +0.010 | 0.000 | 0 | 2.00 / 2.00 / 2.00 | 3.00 / 3.00 / 3.00 |"
        in text
    )
    assert "| other trainsets, dead time and lag none, shipped | 1 |" in text
    assert beside_policy([], "") == ""

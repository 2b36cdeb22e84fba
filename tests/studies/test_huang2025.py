"""Study huang2025: cases as runs, published numbers, the optimum it compares with, repeated stops, words."""

import numpy as np
import pytest

from metropilot.evaluate import make_driver
from metropilot.planning import optimal_plan
from metropilot.sim import drive
from metropilot.studies.huang2025.drives import (
    ABOVE,
    ABOVE_ATTAINABLE,
    LEFT,
    EvaluatedRun,
    LeastIndex,
    make_drivers,
    rows_of,
)
from metropilot.studies.huang2025.learning import job
from metropilot.studies.huang2025.setting import (
    BY_ID,
    CASES,
    EQUAL_EITOE,
    IE,
    LEARNED,
    RELATIVE,
    comfortable,
    run_of,
    trainset,
)
from metropilot.studies.huang2025.study import DEVIATIONS, remarks
from metropilot.studies.report import ReportRow
from metropilot.studies.study import STUDIES


def test_cases_are_runs():
    for case in CASES:
        run = run_of(case)
        assert run.section.origin.code == case.origin
        assert run.scheduled_time_s == case.scheduled_s
        assert len(run.disturbance.updates) == (case.told_s is not None)
    assert run_of(BY_ID["later"]).disturbance.updates[0].scheduled_time_s == 116.0
    assert run_of(BY_ID["restricted"]).disturbance.updates[0].restriction.limit_mps == pytest.approx(40 / 3.6)


def test_published_percentages_are_those_of_the_text():
    # EITOP saves another 4.3 % of what EITOE has left: 0.651 * 0.957 = 0.623
    assert BY_ID["101"].published_value("eitop", "Ie against manual") == pytest.approx(
        100 * (0.651 * 0.957 - 1), abs=0.05
    )
    assert BY_ID["101"].published_value("manual", IE) is None


def test_comfort_limits():
    plant = trainset()
    assert [comfortable(d, plant).max_acceleration_mps2 for d in ("eitoe", "eitop", "manual")] == [
        0.6,
        0.8,
        1.0,
    ]


def test_rows_of_a_drive():
    case = BY_ID["101"]
    found = drive(run_of(case), make_driver("eitoe"))
    least = LeastIndex([found], "eitoe")
    plan = optimal_plan(found.section, comfortable("eitoe", trainset()), found.running_time_s)
    assert least.at(found.running_time_s) == pytest.approx(plan.energy_wheel_j, rel=2e-3)
    rows = {row.kpi: row for row in rows_of(EvaluatedRun(case, "eitoe", [found]), None)}
    assert rows[IE].published == 380.0
    assert rows["It, on time"].ours == 1.0
    # a plan that knows the actuation needs more
    assert 0.0 < rows[ABOVE_ATTAINABLE].ours < rows[ABOVE].ours < 5.0
    words = remarks([*rows.values()], budget="quick")
    assert any("EITOE drives case 1 with 380" in line for line in words)
    assert all(np.isfinite(row.ours) for row in rows.values())


def test_what_learning_could_gain_at_most_is_what_the_expert_leaves():
    name = BY_ID["101"].name
    numbers = [("eitop", IE, 345.0), (EQUAL_EITOE, IE, 340.0), (EQUAL_EITOE, ABOVE_ATTAINABLE, 1.4)]
    rows = [ReportRow("", name, driver, kpi, "").with_values([value]) for driver, kpi, value in numbers]
    words = remarks(rows, budget="quick")[0]
    assert "+1.5 % (RJ to WYJ, 101 s); less in 0 of 1 cases" in words
    assert "More than 1.4 % in the mean" in words


def test_the_order_of_the_drivers_is_told_beside_the_published_one():
    name = BY_ID["101"].name
    energies = {"itor": 400.0, "manual": 390.0, "ston": 380.2, "stod": 380.1, "eitoe": 360.0, "eitop": 350.0}
    relative = {"itor": 1.7, "ston": -11.7, "eitoe": -34.9, "eitop": -37.7}
    rows = [ReportRow("", name, driver, IE, "").with_values([value]) for driver, value in energies.items()]
    rows += [
        ReportRow("", name, driver, RELATIVE, "%", published=value) for driver, value in relative.items()
    ]
    words = "`ston` 380.2, about as `stod` 380.1, over `eitoe` 360.0, over `eitop` 350.0 J/kg: the same."
    assert any(words in line for line in remarks(rows, budget="quick"))
    rows[0] = ReportRow("", name, "itor", IE, "").with_values([385.0])
    assert any("J/kg: another." in line for line in remarks(rows, budget="quick"))


@pytest.mark.parametrize(("case", "kpi", "wanted"), [("95", ABOVE_ATTAINABLE, 2.0), ("later", LEFT, 5.0)])
def test_cases_that_need_more_than_wanted_are_named(case, kpi, wanted):
    name = BY_ID[case].name

    def said(value: float) -> str:
        words = remarks([ReportRow("", name, "eitop", kpi, "%").with_values([value])], budget="quick")
        return next(line for line in words if f"Wanted: at most {wanted:g} %" in line)

    assert name not in said(wanted - 0.1).partition("missed: ")[2]
    assert name in said(wanted + 0.1).partition("missed: ")[2]


def test_seeds_of_the_drivers():
    assert len(make_drivers("manual", {}, range(10))) == 10
    assert len(make_drivers("eitoe", {}, range(10))) == 1


def test_every_learner_has_a_job_of_both_budgets():
    for driver in LEARNED:
        quick, paper = (job(driver, 3, budget) for budget in ("quick", "paper"))
        assert quick.config.steps < paper.config.steps
        assert quick.name != paper.name


def test_the_study_is_registered():
    study = STUDIES.get("huang2025")
    assert "0323478" in study.citation
    assert len(DEVIATIONS) == 11

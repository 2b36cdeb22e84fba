"""Plans against optima that other people's solvers computed; `published` says where each comes from."""

import dataclasses

import pytest
from tests.planning import cases
from tests.planning.published import (
    CONTEST,
    SECTIONS,
    TTOBENCH,
    TTOBENCH_FILES,
    WIL,
    WIL_MINIMUM_S,
    YIZHUANG,
    YIZHUANG_TOTAL,
    roeckl_in_gradients,
    ttobench_line,
)

from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import import_file, load_trainset

BESIDE = pytest.mark.skipif(not TTOBENCH_FILES.is_dir(), reason="TTOBench is not beside the checkout")
FROM_1_MPS = PlanOptions(objective="line", start_mps=1.0, end_mps=1.0)


@pytest.mark.parametrize("time_s", CONTEST)
def test_contest_section(time_s):
    megajoules, ends = CONTEST[time_s]
    options = PlanOptions(start_mps=ends, end_mps=ends)
    plan = optimal_plan(cases.reference_section(), cases.contest(), time_s, options)
    assert plan.energy_j / 1e6 == pytest.approx(megajoules, rel=3e-3)
    assert plan.gap < 1e-3


def test_contest_section_minimum_running_time():
    found = minimum_running_time(cases.reference_section(), cases.contest())
    assert found == pytest.approx(85.42, rel=2e-3)


def test_a_published_dynamic_programme_is_seven_percent_above():
    # 36.639 MJ at 111.083 s after 1315.5 s of CPU: github
    # IGNORANCEzzZ/Train_Speed_Profile_Opimization_Based_on_DynamicProgramming
    plan = optimal_plan(cases.reference_section(), cases.contest(), 111.083)
    assert 36.639e6 / plan.bound_j - 1 == pytest.approx(0.072, abs=0.003)


@pytest.mark.parametrize("stops", SECTIONS)
def test_five_more_sections(stops):
    planned, minimum, megajoules = SECTIONS[stops]
    section = cases.yizhuang().section(*stops)
    plan = optimal_plan(section, cases.contest(), planned, PlanOptions(start_mps=0.02, end_mps=0.02))
    found = minimum_running_time(section, cases.contest(), start_mps=0.02, end_mps=0.02)
    assert found == pytest.approx(minimum, rel=2e-3)
    assert plan.energy_j / 1e6 == pytest.approx(megajoules, rel=3e-3)


@pytest.mark.parametrize("stops", TTOBENCH)
def test_ttobench(stops):
    rest, minimum, energies = TTOBENCH[stops]
    line, trainset = ttobench_line(), load_trainset("cn_beijing_subway")
    section = line.section(*(line.stations[k] for k in stops))
    assert minimum_running_time(section, trainset) == pytest.approx(rest, rel=5e-4)
    found = minimum_running_time(section, trainset, start_mps=1.0, end_mps=1.0)
    assert found == pytest.approx(minimum, rel=4e-3)
    for time, kwh in energies.items():
        plan = optimal_plan(section, trainset, time * minimum if time < 2 else time, FROM_1_MPS)
        assert plan.energy_kwh == pytest.approx(kwh, rel=1e-2)
        assert plan.gap < 1e-3


@BESIDE
def test_ttobench_wil():
    shipped = import_file(TTOBENCH_FILES / "tracks/CH_StGallen_Wil.json")
    straight = dataclasses.replace(shipped.section(*shipped.stations), curves=())
    line = roeckl_in_gradients(shipped)
    section = line.section(*line.stations)
    train = import_file(TTOBENCH_FILES / "trains/CH_Stadler_FLIRT_TPF.json")
    train = dataclasses.replace(train, length_m=0.0)  # ms-eetc: a point mass
    found = minimum_running_time(section, train, start_mps=1.0, end_mps=1.0)
    assert found == pytest.approx(WIL_MINIMUM_S, rel=2e-3)
    options = dataclasses.replace(FROM_1_MPS, spacing_m=50.0)  # 12.5 m changes the energy by 0.003 %
    for time, kwh in WIL.items():
        seconds = time * WIL_MINIMUM_S if time < 2 else time
        plan = optimal_plan(section, train, seconds, options)
        assert plan.energy_kwh == pytest.approx(kwh, rel=2e-3)
        assert plan.gap < 1e-3
        assert kwh - optimal_plan(straight, train, seconds, options).energy_kwh == pytest.approx(
            4.25, abs=0.1
        )


@pytest.mark.parametrize("curves", [False, True])
def test_whole_line_at_planned_times(curves):
    line, trainset = cases.yizhuang(), cases.contest()
    totals = []
    for backward in (False, True):
        energies = []
        for section in line.sections(backward=backward):
            here = section if curves else dataclasses.replace(section, curves=())
            name = section.name if section.name in YIZHUANG else "-".join(section.name.split("-")[::-1])
            published = YIZHUANG[name][backward + 2 * curves]
            # RJ-WYJ is planned at 101 s in our catalogue; the table took 103 s both ways
            seconds = 103.0 if section.name == "RJ-WYJ" else section.planned_time_s
            plan = optimal_plan(here, trainset, seconds)
            energies.append(plan.energy_kwh)
            assert 0.97 * published - 0.05 < plan.energy_kwh < published + 0.05, section.name
            fastest = YIZHUANG[name][4]  # printed to 1 s, late for the same reason (156: 154.16 by SECTIONS)
            assert fastest - 2.0 < minimum_running_time(here, trainset) < fastest + 0.5
        totals.append(sum(energies))
    published = YIZHUANG_TOTAL[curves]
    assert totals == pytest.approx(published, rel=0.012)
    assert all(ours < theirs for ours, theirs in zip(totals, published, strict=True))

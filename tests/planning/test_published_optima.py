"""Plans against optima that other people's solvers computed: energies, minimum running times.

Provenance, each table:

* ``CONTEST``: a nonlinear programme in CasADi/IPOPT on a 2 m mesh (checked at 110 s: 34.891, 34.900 and
  34.901 MJ at 4, 2 and 1 m) for the modelling contest's section A6 to A7, and a separate
  accelerate-coast-brake integration (34.93 MJ at 109.98 s). Energy within 0.3 %: its mesh error and the
  printed digits; running time within 0.2 %. Where it started and ended at 0.5 m/s, so does the plan.
* ``SECTIONS``: the same programme, five more sections, 0.02 m/s at the ends.
* ``TTOBENCH``: ms-eetc (direct multiple shooting, CasADi/IPOPT, 200 intervals; github dkouzoup/ms-eetc)
  on the benchmark's own line with the stop at 9274 m as shipped, from and to 1 m/s, net energy at the
  line, constant efficiencies. It holds the force over an interval and bounds it at both ends, so it is up
  to 0.4 % slow and a little dear: energy within 1 %.
* ``WIL``: the same solver on the benchmark's 29.6 km St. Gallen to Wil. Its default curve resistance
  (Röckl: 0.5/(r - 30) of the weight from 300 m, 0.65/(r - 55) below) is in these energies, though they
  were noted as "curvature ignored": without curves ours is 4.25 kWh below at *every* running time, and
  that is what the formula takes over the line; with it ours is within 0.1 %.
* ``YIZHUANG``: a dynamic programme (5 m cells, 700 speed nodes, price on time) for the whole contest line
  at planned times; its own author states an error of 1 to 2 % and prints 0.1 kWh. A grid of speeds errs
  upwards only, so ours must lie below, by at most 1.2 % on the whole line and 3 % on a section. (A6 to A7
  backward shows who is right: it says 11.3 kWh, ours 11.03, and ``CONTEST``, the better programme, has
  that section within 0.06 % of ours.)
"""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from tests.planning import cases

from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import Steps, import_file, load_line, load_trainset

CONTEST = {  # running time s: MJ, speed at both ends m/s
    100.0: (42.57, 0.5),
    105.0: (37.90, 0.5),
    110.0: (34.90, 0.0),
    110.1: (34.83, 0.0),
    110.8: (34.35, 0.0),
    111.083: (34.16, 0.0),
    111.2: (34.08, 0.0),
    120.0: (28.57, 0.5),
    130.0: (24.54, 0.5),
}
SECTIONS = {  # from, to: planned s, minimum s, MJ
    ("YZHC", "CQ"): (105.0, 85.28, 46.30),
    ("CQN", "JHL"): (140.0, 118.30, 34.52),
    ("WYJ", "WHY"): (114.0, 93.39, 42.05),
    ("YZQ", "JG"): (135.0, 113.50, 61.55),
    ("XC", "SJZ"): (190.0, 154.16, 61.91),
}
TTOBENCH = {  # stops: minimum from rest s, minimum from 1 m/s s, {running time or its ratio: kWh at the line}
    (0, 1): (151.30, 149.49, {1.05: 24.69, 1.10: 21.96, 1.20: 18.67, 190.0: 17.14}),
    (1, 2): (82.38, 80.56, {1.05: 15.48, 1.10: 13.80, 1.20: 11.52, 108.0: 9.56}),
    (6, 7): (80.91, 79.06, {1.05: 15.21, 1.10: 13.14, 1.20: 10.47, 103.0: 8.71}),
    (11, 12): (80.66, 78.82, {1.05: 14.27, 1.10: 12.27, 1.20: 9.63, 102.0: 8.02}),
}
WIL_MINIMUM_S, WIL = 995.78, {1.05: 98.64, 1.10: 88.33, 1.20: 72.30, 1242.0: 66.32}
YIZHUANG = {  # section: kWh down and up without curves, down and up with curves, minimum s
    "SJZ-XC": (19.1, 16.7, 19.7, 17.3, 156.0),
    "XC-XHM": (9.7, 7.5, 10.2, 7.8, 82.0),
    "XHM-JG": (8.2, 28.8, 8.7, 29.2, 132.0),
    "JG-YZQ": (17.0, 16.9, 17.6, 17.2, 114.0),
    "YZQ-WHY": (8.0, 7.3, 8.2, 7.3, 70.0),
    "WHY-WYJ": (13.6, 11.5, 14.1, 11.8, 94.0),
    "WYJ-RJ": (10.3, 10.4, 10.3, 10.4, 83.0),
    "RJ-RC": (12.2, 11.3, 12.2, 11.3, 86.0),
    "RC-TJN": (18.0, 16.3, 18.5, 16.7, 135.0),
    "TJN-JHL": (18.4, 18.8, 18.5, 18.8, 127.0),
    "JHL-CQN": (30.6, 9.7, 30.8, 9.9, 120.0),
    "CQN-CQ": (9.8, 10.2, 9.8, 10.2, 83.0),
    "CQ-YZHC": (11.5, 13.0, 11.5, 13.0, 86.0),
}
TTOBENCH_FILES = Path(__file__).resolve().parents[3] / "shared" / "ttobench"
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


def ttobench_line():
    """The benchmark's line as shipped: our catalogue corrects its stop at 9274 m."""
    line = load_line("yizhuang-ttobench")
    moved = (dataclasses.replace(s, position_m=9274.0) if s.position_m == 9247 else s for s in line.stations)
    return dataclasses.replace(line, stations=tuple(moved))


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


def roeckl_in_gradients(line):
    """The line without curves, their resistance by Röckl's formula added to its gradients.

    Each clothoid at its mean curvature, as ms-eetc takes it.
    """
    at = np.array([c.from_m for c in line.curves])
    bend = np.abs([(c.curvature_start_per_m + c.curvature_end_per_m) / 2 for c in line.curves])
    permil = 1e3 * np.where(bend <= 1 / 300, 0.5 * bend / (1 - 30 * bend), 0.65 * bend / (1 - 55 * bend))
    nodes = np.unique(np.concatenate([line.gradient_permil.from_m, at]))
    index = np.searchsorted(at, nodes, side="right") - 1
    felt = line.gradient_permil.at(nodes) + np.where(index >= 0, permil[np.maximum(index, 0)], 0.0)
    return dataclasses.replace(line, gradient_permil=Steps(nodes, felt), curves=())


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
    published = (189.9, 180.8) if curves else (186.4, 178.1)
    assert totals == pytest.approx(published, rel=0.012)
    assert all(ours < theirs for ours, theirs in zip(totals, published, strict=True))

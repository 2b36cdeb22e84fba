"""KPIs of whole drives: the contract of `kpis.json`, the optimum, the verdict."""

import json
import math
from dataclasses import replace

import pytest

from metropilot._io import to_json
from metropilot.evaluate import checks, kpi_rows, kpis_of, optimum_of, verdict
from metropilot.sim import Outcome, drive

DESIGN = (
    "outcome",
    "mass_kg",
    "effective_mass_kg",
    "running_time_s",
    "scheduled_time_s",
    "time_error_s",
    "stopping_error_m",
    "energy_wheel_kwh",
    "energy_regenerated_kwh",
    "energy_line_kwh",
    "optimal_energy_kwh",
    "optimality_gap_percent",
    "attainable_energy_kwh",
    "attainable_bound_kwh",
    "trainset_gap_percent",
    "driver_gap_percent",
    "max_overspeed_mps",
    "interventions",
    "max_acceleration_mps2",
    "max_jerk_mps3",
    "comfort_huang2025",
    "jerk_cheng2023_mps3",
    "regime_switches",
    "decision_time_us_median",
)


@pytest.fixture(scope="module")
def driven():
    from metropilot.evaluate import RunSpec

    request = RunSpec("yizhuang", "RJ", "WYJ", 101.0, driver="flat_out")
    return drive(request.run(), request.make_driver())


def test_contract(driven):
    kpis = kpis_of(driven, optimum_of(driven)).as_dict()
    assert set(DESIGN) <= set(kpis)
    assert all(kpis[name] is not None for name in DESIGN)
    assert json.loads(to_json(kpis)) == kpis


def test_values_agree_with_the_trajectory(driven):
    kpis, t = kpis_of(driven, optimum_of(driven)), driven.trajectory
    assert kpis.mass_kg == 194_295
    assert kpis.energy_wheel_kwh == pytest.approx(t.energy_wheel_j[-1] / 3.6e6)
    assert kpis.time_error_s == pytest.approx(t.time_s[-1] - 101)
    assert kpis.stopping_error_m == pytest.approx(t.position_m[-1] - 1280)
    assert kpis.energy_effort_kwh > kpis.energy_wheel_kwh > kpis.optimal_energy_kwh
    assert kpis.minimum_running_time_s <= kpis.running_time_s
    # Flat out the highest speed is the only peak but for the platform zone's short hold.
    assert kpis.energy_huang2025_jpkg == pytest.approx(kpis.max_speed_mps**2, rel=0.02)


@pytest.mark.parametrize("objective", ["wheel", "line"])
def test_the_optimum_is_below_the_drive_and_certified(driven, objective):
    optimum = optimum_of(driven, objective)
    kpis = kpis_of(driven, optimum, objective)
    assert kpis.energy_objective == objective
    assert kpis.optimality_gap_percent > 5
    assert kpis.bound_energy_kwh <= kpis.optimal_energy_kwh * (1 + 1e-6)
    assert abs(kpis.certificate_gap_percent) < 0.1
    assert optimum.plan.running_time_s == pytest.approx(kpis.running_time_s, abs=1e-2)


def test_early_is_arrived_but_no_success(driven):
    kpis = kpis_of(driven, optimum_of(driven))
    assert (kpis.outcome, kpis.safe, kpis.punctual, kpis.success) == ("arrived", True, False, False)
    failed = [check.name for check in checks(kpis) if not check.passed]
    assert failed == ["on time"]


def judge(driven, **changes):
    """A drive on time that met every requirement, but for some of its figures."""
    good = {"time_error_s": 0.0, "punctual": True, "interventions": 0, "max_jerk_mps3": 1.0}
    return replace(kpis_of(driven, None), **good | changes)


@pytest.mark.parametrize(
    ("changes", "said", "failed"),
    [
        ({}, "arrived safely and on time", []),
        ({"interventions": 1}, "arrived on time, but 1 intervention", ["no intervention"]),
        (
            {"interventions": 2, "max_jerk_mps3": 6.13},
            "arrived on time, but 2 interventions, jerk 6.13 m/s³",
            ["no intervention", "jerk"],
        ),
        ({"max_jerk_mps3": 1.0004}, "arrived on time, but jerk 1.0004 m/s³", ["jerk"]),
        (
            {"time_error_s": 8.24, "punctual": False, "max_jerk_mps3": 2.0},
            "arrived 8.2 s late, jerk 2.00 m/s³",
            ["on time", "jerk"],
        ),
        (
            {"outcome": "out_of_time", "stopping_error_m": -80.0, "interventions": 3},
            "out of time, 3 interventions",
            ["stops at the mark", "on time", "no intervention"],
        ),
    ],
)
def test_headline_verdict_and_json_name_every_requirement_that_failed(driven, changes, said, failed):
    kpis = judge(driven, **changes)
    assert verdict(kpis) == said
    assert kpis.success == (not failed)
    told = kpis.as_dict()
    assert (told["success"], told["failed"]) == (not failed, failed)


def test_campaigns_count_as_before_what_arrived_safely_and_on_time(driven):
    kpis = judge(driven, interventions=2, max_jerk_mps3=6.0)
    assert kpis.on_time
    assert not kpis.success


def test_what_did_not_arrive_has_no_optimum(driven):
    lost = replace(driven, outcome=Outcome.OUT_OF_TIME)
    kpis = kpis_of(lost, optimum_of(lost))
    assert kpis.optimal_energy_kwh is None
    assert kpis.optimality_gap_percent is None
    assert {c.name: c.passed for c in checks(kpis)}["stops at the mark"] is False


def test_overspeed_is_unsafe(driven):
    kpis = kpis_of(replace(driven, outcome=Outcome.OVERSPEED, max_overspeed_mps=1.0), None)
    assert not kpis.safe
    assert not kpis.success
    assert {c.name: c.passed for c in checks(kpis)}["no overspeed"] is False


def test_json_has_no_infinities():
    assert json.loads(to_json({"a": math.inf, "b": [math.nan, 1.0], "c": {"d": -math.inf}})) == {
        "a": None,
        "b": [None, 1.0],
        "c": {"d": None},
    }


def test_rows_of_the_main_kpis_say_what_there_is(driven):
    kpis = kpis_of(driven, optimum_of(driven))
    rows = {row.name: row for row in kpi_rows(kpis.as_dict())}
    assert rows["running time"].value == f"{kpis.running_time_s:.1f} s"
    assert rows["running time"].remark.startswith(f"scheduled {kpis.scheduled_time_s:g} s, minimum ")
    assert f"at least {kpis.attainable_bound_kwh:.2f} kWh" in rows["attainable"].remark
    older = {name: value for name, value in kpis.as_dict().items() if "attainable" not in name}
    older |= {"minimum_running_time_s": None, "optimality_gap_percent": None}
    rows = {row.name: row for row in kpi_rows(older)}
    assert "attainable" not in rows
    assert rows["running time"].remark == f"scheduled {kpis.scheduled_time_s:g} s"
    assert rows["above the optimum"].value == "–"

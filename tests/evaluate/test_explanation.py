"""Reasons of a drive: spans that cover it, what bound it, which guard acted, losses that sum up."""

import json
from itertools import pairwise

import numpy as np
import pytest

from metropilot.evaluate import BOUNDS, RunSpec, explain_drive, kpis_of, optimum_of, time_prices
from metropilot.railway import Restriction
from metropilot.sim import Rollout, drive
from metropilot.units import J_PER_KWH

SECTION = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ"}


@pytest.fixture(scope="module")
def example():
    """A flat-out drive: its KPIs and its explanation."""
    spec = RunSpec(**SECTION, time_s=95.0, driver="flat_out", load="AW2")
    driven = drive(spec.run(), spec.make_driver())
    optimum = optimum_of(driven)
    return driven, kpis_of(driven, optimum), explain_drive(driven, optimum)


def test_the_losses_at_the_stop_are_those_of_the_kpis(example):
    _, kpis, found = example
    trainset, driver = found.trainset_loss_j[-1] / J_PER_KWH, found.driver_loss_j[-1] / J_PER_KWH
    assert trainset == pytest.approx(kpis.attainable_energy_kwh - kpis.optimal_energy_kwh, abs=1e-6)
    assert driver == pytest.approx(kpis.energy_wheel_kwh - kpis.attainable_energy_kwh, abs=1e-4)
    assert sum(span.driver_loss_j for span in found.regimes) / J_PER_KWH == pytest.approx(driver, abs=1e-3)
    assert found.driver_loss_j[0] == 0.0


def test_spans_cover_the_drive_in_its_order(example):
    driven, kpis, found = example
    t = driven.trajectory
    for spans in (found.regimes, found.bounds):
        assert (spans[0].from_s, spans[-1].to_s) == (t.time_s[0], t.time_s[-1])
        assert all(a.to_s == b.from_s and a.to_m == b.from_m for a, b in pairwise(spans))
    assert all(a.regime != b.regime for a, b in pairwise(found.regimes))
    assert {span.bound for span in found.bounds} <= set(BOUNDS)
    energy = sum(span.energy_wheel_j for span in found.regimes)
    assert energy / J_PER_KWH == pytest.approx(kpis.energy_wheel_kwh)
    assert json.loads(json.dumps(found.as_dict()))["regimes"][0]["regime"] == found.regimes[0].regime


def test_flat_out_is_bound_by_effort_then_limit_then_stop(example):
    order = [span.bound for span in example[2].bounds if span.to_s - span.from_s > 3.0]
    assert order[0] in {"effort", "comfort"}
    assert "speed limit" in order
    assert "time" not in order[:-1]
    assert example[2].interventions == ()


def test_the_optimal_driver_coasts_for_the_time():
    spec = RunSpec(**SECTION, time_s=101.0, driver="optimal")
    found = explain_drive(drive(spec.run(), spec.make_driver()), None)
    coast = max(found.regimes, key=lambda span: span.to_s - span.from_s)
    assert (coast.regime, coast.bound, coast.driver_loss_j) == ("coast", "time", None)
    assert found.position_m.size == 0


def test_a_lever_at_full_power_meets_the_guards_ahead_of_a_restriction():
    spec = RunSpec(**SECTION, time_s=110.0, restrictions=(Restriction(700.0, 800.0, 10.0),))
    rollout = Rollout(spec.run(), spec.make_driver())
    rollout.take(1.0)
    while rollout.outcome is None:
        rollout.advance()
    driven = rollout.drive()
    found = explain_drive(driven, None)
    assert len(found.interventions) == driven.interventions > 0
    assert {span.guard for span in found.interventions} <= {
        "traction cut-off",
        "service brake",
        "emergency brake",
    }
    protected = [span for span in found.bounds if span.bound == "protection"]
    assert sum(span.to_s - span.from_s for span in protected) == pytest.approx(
        float((driven.overruled * driven.trajectory.duration_s[:-1]).sum())
    )
    before = [span for span in found.interventions if span.from_m < 700.0 <= span.ahead_m + 10.0]
    assert before, found.interventions
    assert before[0].ahead_m == pytest.approx(700.0, abs=10.0)
    for span in found.interventions:
        row = int(np.searchsorted(driven.trajectory.time_s, span.from_s))
        assert driven.trajectory.speed_mps[row] == span.speed_mps


def test_a_second_is_worth_least_more_and_most_less(example):
    driven, _, found = example
    assert len(found.prices) > 15
    for price in found.prices:
        slack = 2e-3 * price.second_w + 5e3
        assert price.later_j <= price.second_w + slack
        assert price.sooner_j is None or price.second_w <= price.sooner_j + slack
    # the dual at departure is the slope of the optimal plans' energies
    first = found.prices[0]
    slope = (first.later_j + first.sooner_j) / 2.0
    assert first.second_w == pytest.approx(slope, rel=0.05)
    assert first.second_w == pytest.approx(optimum_of(driven).plan.second_w, rel=0.01)


def test_on_an_optimal_plan_the_price_stays_until_it_coasts():
    spec = RunSpec(**SECTION, time_s=101.0, driver="optimal")
    driven = drive(spec.run(), spec.make_driver())
    prices = time_prices(driven, np.arange(0.0, 100.0, 10.0))
    powered = [price.second_w for price in prices if price.position_m < 250.0]
    coasting = [price for price in prices if 450.0 < price.position_m < 1000.0]
    assert len(powered) >= 3
    assert max(powered) < 1.05 * min(powered)
    for price in coasting:
        assert price.later_j < 1e3
        assert price.sooner_j > 1e5


def test_what_cannot_arrive_any_more_has_no_price():
    spec = RunSpec(**SECTION, time_s=110.0, driver="pid")
    rollout = Rollout(spec.run(), spec.make_driver())
    rollout.take(0.0)
    while rollout.outcome is None:
        rollout.advance()
    driven = rollout.drive()
    prices = explain_drive(driven, optimum_of(driven)).prices
    assert prices == () or max(price.time_s for price in prices) < 110.0 - 80.0

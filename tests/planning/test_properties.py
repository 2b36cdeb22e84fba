"""Properties that hold for any section and trainset."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from tests.planning import cases

from metropilot.errors import Infeasible
from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan
from metropilot.railway import Curve, Steps

SEEDS = st.integers(0, 2**32 - 1)
MANY = settings(max_examples=25, deadline=None)


def made_up(seed):
    """A random section and trainset, or a rejected example where the trainset stalls."""
    rng = np.random.default_rng(seed)
    section, trainset = cases.random_section(rng), cases.random_trainset(rng)
    try:
        return section, trainset, minimum_running_time(section, trainset)
    except Infeasible:
        assume(False)
        raise


@MANY
@given(SEEDS, st.floats(1.01, 1.7))
@example(seed=484, ratio=1.5)  # downhill: more time saves next to nothing
@example(seed=8464160, ratio=1.5)  # downhill: nothing to save at all
def test_a_plan_is_on_time_within_limits_certified_and_tight(seed, ratio):
    section, trainset, fastest = made_up(seed)
    assume(np.isfinite(fastest))
    plan = optimal_plan(section, trainset, ratio * fastest)
    assert plan.running_time_s == pytest.approx(ratio * fastest, abs=2e-2)
    assert plan.time_s[-1] == pytest.approx(plan.running_time_s)
    assert abs(plan.gap) < 1e-3 or abs(plan.energy_j - plan.bound_j) < 1e3
    assert plan.tightness < 1e-3
    assert abs(plan.effort_excess) < 5e-3
    assert cases.limit_between_nodes(plan, trainset, section) < 1e-3
    assert plan.speed_mps[0] == plan.speed_mps[-1] == 0.0
    assert plan.position_m[-1] == section.length_m


@MANY
@given(SEEDS, st.lists(st.floats(1.01, 2.0), min_size=2, max_size=3))
def test_more_running_time_never_costs_more(seed, ratios):
    section, trainset, fastest = made_up(seed)
    assume(np.isfinite(fastest))
    energies = [optimal_plan(section, trainset, r * fastest).energy_j for r in sorted(ratios)]
    assert all(later <= earlier * (1 + 1e-4) for earlier, later in itertools.pairwise(energies))


@MANY
@given(SEEDS)
def test_heavier_is_never_faster_on_level_or_rising_track(seed):
    # downhill it may be: gravity pulls a heavier train as fast while its effort curve grows no weaker
    rng = np.random.default_rng(seed)
    section, trainset = cases.random_section(rng), cases.random_trainset(rng)
    slope = section.gradient_permil
    rising = dataclasses.replace(section, gradient_permil=Steps(slope.from_m, np.abs(slope.value)))
    light = minimum_running_time(rising, trainset)
    heavy = minimum_running_time(rising, trainset.with_load("heavy"))
    assert heavy >= light - 1e-6 or not np.isfinite(heavy)


@MANY
@given(SEEDS)
def test_a_tighter_limit_is_never_faster(seed):
    section, trainset, fastest = made_up(seed)
    limit = dataclasses.replace(section.limit_mps, value=section.limit_mps.value * 0.9)
    assert minimum_running_time(dataclasses.replace(section, limit_mps=limit), trainset) >= fastest - 1e-9


@MANY
@given(SEEDS, st.floats(1.02, 1.5))
def test_one_more_constraint_never_saves_energy(seed, ratio):
    section, trainset, fastest = made_up(seed)
    assume(np.isfinite(fastest))
    free = optimal_plan(section, trainset, 1.3 * ratio * fastest)
    gentle = optimal_plan(
        section, trainset, 1.3 * ratio * fastest, PlanOptions(acceleration_mps2=0.8, deceleration_mps2=0.8)
    )
    assert gentle.energy_j >= free.bound_j * (1 - 1e-4)


@pytest.mark.parametrize("ratio", [1.05, 1.4])
def test_level_symmetric_section_is_the_same_both_ways(ratio):
    section = cases.simple_section(
        1600.0,
        limits=((0.0, 15.0), (300.0, 22.0), (1300.0, 15.0)),
        curves=(Curve(0.0, 0.0, 0.0), Curve(600.0, 0.002, 0.002), Curve(1000.0, 0.0, 0.0)),
    )
    backward = dataclasses.replace(
        section,
        limit_mps=section.limit_mps.mirror(1600.0),
        gradient_permil=section.gradient_permil.mirror(1600.0, -1.0),
        curves=(Curve(0.0, 0.0, 0.0), Curve(600.0, -0.002, -0.002), Curve(1000.0, 0.0, 0.0)),
    )
    trainset = cases.contest()
    time_s = ratio * minimum_running_time(section, trainset)
    forth, back = (optimal_plan(s, trainset, time_s) for s in (section, backward))
    assert back.energy_j == pytest.approx(forth.energy_j, rel=1e-6)


def test_opposite_directions_differ_by_the_altitude_where_nothing_is_braked():
    # a long gentle slope, so slow that hardly anything is braked: m g h more one way, m g h less the other
    section = cases.simple_section(2000.0, limits=((0.0, 25.0),), gradients=((0.0, 1.0),))
    down = dataclasses.replace(section, gradient_permil=section.gradient_permil.mirror(2000.0, -1.0))
    trainset = cases.contest()
    forth, back = (optimal_plan(s, trainset, 400.0) for s in (section, down))
    height = trainset.mass_kg * 9.81 * 2.0
    assert forth.energy_j - back.energy_j == pytest.approx(2 * height, rel=0.06)

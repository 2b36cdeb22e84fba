"""The time-energy front and its slope, the worth of a second."""

import numpy as np
import pytest
from tests.planning import cases

from metropilot.errors import Infeasible
from metropilot.planning import PlanOptions, minimum_running_time, optimal_plan, time_energy_front


@pytest.fixture(scope="module")
def front():
    return time_energy_front(cases.reference_section(), cases.contest())


def test_front_falls_and_flattens(front):
    assert front.time_s[0] == pytest.approx(1.02 * front.minimum_s)
    assert np.all(np.diff(front.energy_j) < 0)
    slope = np.diff(front.energy_j) / np.diff(front.time_s)
    assert np.all(np.diff(slope) > 0)
    assert np.all(np.diff(front.second_w) < 0)
    # the mean slope between two points lies between the marginal prices at them
    assert np.all((-slope < front.second_w[:-1]) & (-slope > front.second_w[1:]))


@pytest.mark.parametrize("stops", [("RJ", "WYJ"), ("XHM", "JG"), ("JHL", "CQN")])
@pytest.mark.parametrize("ratio", [1.05, 1.2, 1.5])
@pytest.mark.parametrize("objective", ["wheel", "line"])
def test_price_of_a_second_is_the_slope(stops, ratio, objective):
    section = cases.yizhuang().section(*stops)
    trainset = cases.load_trainset("dkz32")
    options = PlanOptions(objective=objective)
    time_s = ratio * minimum_running_time(section, trainset)
    below, here, above = (optimal_plan(section, trainset, time_s + d, options) for d in (-0.2, 0.0, 0.2))
    slope = -(above.energy_j - below.energy_j) / 0.4
    # the price of the clock is net of what a second of auxiliaries costs
    assert here.second_w == pytest.approx(slope, rel=0.02, abs=1e3)


def test_asked_times_come_back_in_order():
    front = time_energy_front(cases.reference_section(), cases.contest(), [130.0, 100.0, 110.0])
    assert list(front.time_s) == [100.0, 110.0, 130.0]
    assert front.plans[1].energy_j / 1e6 == pytest.approx(34.90, rel=3e-3)


def test_a_time_below_the_minimum_is_refused():
    with pytest.raises(Infeasible, match="minimum running time is"):
        time_energy_front(cases.reference_section(), cases.contest(), [80.0, 100.0])

"""The columns of Cheng23's tables from a record made by hand, and the search that tunes."""

import numpy as np
import pytest

from metropilot.errors import InputError
from metropilot.studies.cheng2023 import course as cheng2023_course
from metropilot.studies.cheng2023.tracking import TrackRecord, tracking_kpis, tracking_score
from metropilot.studies.cheng2023.tuning import TUNABLE, tune_driver


@pytest.fixture(scope="module")
def course():
    return cheng2023_course()


def test_columns_by_hand(course):
    count = 30
    accel = np.zeros(count)
    accel[10:] = 0.9  # at once
    record = TrackRecord(
        time_s=0.2 * np.arange(count),
        reference_mps=np.zeros(count),
        speed_mps=np.zeros(count),
        position_m=np.full(count, 1279.5),
        error_mps=np.where(np.arange(count) % 2, 0.1, -0.2),
        distance_m=np.where(np.arange(count) < 4, -0.5, 0.0),
        command=np.zeros(count),
        acceleration_mps2=accel,
        traction_j=np.linspace(0.0, 3.6e7, count),
        counted=np.arange(count) < 20,
    )
    kpis = tracking_kpis(course, record)
    assert kpis.speed_total_mps == pytest.approx(10 * 0.2 + 10 * 0.1)
    assert kpis.speed_max_mps == pytest.approx(0.2)
    assert kpis.position_total_m == pytest.approx(2.0)
    assert kpis.parking_m == pytest.approx(0.5)
    assert kpis.energy_kwh == pytest.approx(10.0)
    assert kpis.jerk_mps3 == pytest.approx(0.45)  # 0.9 m/s2 within 2 s
    assert kpis.periods == 20
    # 3 + 2/5 + 5 * 0.2 + 20 * 0.5 + 2 * 0.45
    assert tracking_score(kpis) == pytest.approx(-(3 + 2 / 5 + 1 + 10 + 0.9))


def test_a_short_search_beats_the_gains_by_hand_and_repeats(course):
    found = tune_driver("pid", course, seed=1, generations=3)
    assert found.evaluations == 160
    assert found.score > -20.0  # by hand: about -48
    assert found.values["ki"] > 1.0
    assert tune_driver("pid", course, seed=1, generations=3) == found
    with pytest.raises(InputError, match="fuzzy_pid"):
        tune_driver("ddpg_pid", course)


@pytest.mark.parametrize("driver", TUNABLE)
def test_boxes_lie_within_the_papers_limits(driver):
    one = TUNABLE[driver]
    low, high = one.values(np.zeros(len(one.names))), one.values(np.ones(len(one.names)))
    np.testing.assert_allclose(low, one.low)
    np.testing.assert_allclose(high, one.high)
    assert tuple(high[:3]) == (5.0, 1.5, 1.5)

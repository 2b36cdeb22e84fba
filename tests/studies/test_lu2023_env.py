"""The notches of Lu23 with their filter, and its reward terms against numbers worked out by hand."""

import numpy as np
import pytest

from metropilot.env import FeatureContext, PeriodChange, RegimeAction, SectionRows, task_config
from metropilot.errors import InputError
from metropilot.physics import effort_at
from metropilot.studies.lu2023.env import (
    AccelerationComfort,
    EffortEnergy,
    Moving,
    NotchForceAction,
    RegimeSwitch,
    StopWindow,
)

F = np.float64
MOVING = PeriodChange(
    **dict.fromkeys(PeriodChange._fields, F(0.0))
    | {"wheel_j": F(7.2e6), "braked_j": F(0.8e6), "speed_mps": F(12.0), "error_m": F(-600.0)}
    | {
        "acceleration_mps2": F(0.5),
        "before_mps2": F(0.2),
        "ended": np.bool_(False),
        "arrived": np.bool_(False),
    }
)
ARRIVED = MOVING._replace(ended=np.bool_(True), arrived=np.bool_(True), error_m=F(0.1))
FAILED = MOVING._replace(ended=np.bool_(True), error_m=F(-100.0))


@pytest.mark.parametrize(
    ("term", "moving", "arrived", "failed"),
    [
        (EffortEnergy(), -80.0, -80.0, -80.0),  # 1e-5 of 7.2 + 0.8 MJ
        (StopWindow(), 0.0, 1000.0, -1000.0),
        (AccelerationComfort(), 0.5, 0.5, 0.5),  # 1 - 0.5
        (Moving(), 0.01, 0.01, 0.01),
    ],
)
def test_term(term, moving, arrived, failed):
    found = [float(term.value(change)) for change in (MOVING, ARRIVED, FAILED)]
    assert found == pytest.approx([moving, arrived, failed])


def test_lu2023_eq_18_at_its_borders():
    comfort = AccelerationComfort()

    def at(now, before):
        change = MOVING._replace(acceleration_mps2=F(now), before_mps2=F(before))
        return float(comfort.value(change))

    assert at(-0.8, -0.8) == pytest.approx(0.2)
    assert at(0.81, 0.6) == -1.0
    assert at(0.5, 0.05) == -10.0  # a jump up of more than 0.4
    assert at(-0.5, 0.5) == pytest.approx(0.5)  # down is not charged, as printed
    assert float(Moving().value(MOVING._replace(speed_mps=F(0.0)))) == 0.0
    short = ARRIVED._replace(error_m=F(-0.31))
    assert float(StopWindow().value(short)) == -1000.0


def lu2023_sight(**changes):
    rows = SectionRows(task_config("lu2023").tables(np.float64), jax=False)
    case = rows.case(0)
    seen = {"case": 0, "command": F(0.0), "speed_mps": F(15.0), "position_m": F(600.0), "time_s": F(50.0)}
    seen |= {"rows": rows, "vehicle": case.vehicle, "track": case.track, "rates": case.protection.rates}
    seen |= {"length_m": case.length_m, "scheduled_s": F(130.0)}
    return FeatureContext(**dict.fromkeys(FeatureContext._fields) | seen | changes)


def test_minimum_arrival_time_filter():
    # Lu23 section 3.3.4: a choice after which even flat out is too late is chosen again
    action, period = NotchForceAction(margin=0.0), 2.0
    seen = lu2023_sight()
    assert action.action_mask(seen, period).all()
    to_go = float(seen.to_go_s)
    tight = [lu2023_sight(scheduled_s=F(50.0 + to_go + spare)) for spare in (-1.0, 0.3, 1.0, 3.0)]
    allowed = [int(action.action_mask(s, period).sum()) for s in tight]
    assert allowed[0] == 1  # late already: flat out is what is left
    assert action.action_mask(tight[0], period)[-1]
    assert allowed == sorted(allowed)
    assert 1 < allowed[2] < allowed[3] == 12
    # whatever is allowed, stronger is allowed
    assert all(np.diff(action.action_mask(s, period).astype(int)).min() >= 0 for s in tight)
    assert int(NotchForceAction(margin=0.1).action_mask(tight[3], period).sum()) < 12
    assert NotchForceAction(in_time=False).action_mask(seen, period) is None


def test_assists_are_met_by_notches():
    action, seen = NotchForceAction(), lu2023_sight()
    brake, pull = 149e3, float(effort_at(seen.vehicle, F(15.0)).traction_n)
    for wanted_n, notch_n in ((-100e3, -132e3), (-99e3, -99e3), (-1e3, -33e3), (60e3, 34e3), (30e3, 0.0)):
        share = wanted_n / (pull if wanted_n > 0 else brake)
        met = float(action.round(seen, F(share)))
        assert met * (pull if met > 0 else brake) == pytest.approx(notch_n, abs=1.0)
    with pytest.raises(InputError, match="no table of notches"):
        NotchForceAction((-1.0, 1.0))
    for field in ("margin", "most_mps2", "below_mps"):
        with pytest.raises(InputError, match=field):
            NotchForceAction(**{field: -0.1})


def test_a_notch_is_held_as_a_force():
    action = NotchForceAction()
    slow, fast = lu2023_sight(speed_mps=F(16.0)), lu2023_sight(speed_mps=F(18.0))
    share = action.command(slow, np.array(6), 3.0)
    later = float(action.hold(fast, np.array(6), share))
    assert later > float(share)
    assert later * float(effort_at(fast.vehicle, F(18.0)).traction_n) == pytest.approx(34e3, abs=1.0)
    assert float(action.round(fast, F(later))) == pytest.approx(later)
    # a command stays what was decided
    assert RegimeAction().hold(fast, np.array([1.0]), F(0.3)) == 0.3


def test_notches_within_the_largest_acceleration():
    action = NotchForceAction(in_time=False, most_mps2=0.8)
    slow, fast = (lu2023_sight(speed_mps=F(v), position_m=F(50.0)) for v in (2.0, 14.0))
    masks = [action.action_mask(seen, 3.0) for seen in (slow, fast)]
    # 194.3 t, level: 149 kN brake with 0.77 m/s2 and resistance; a pull that is too strong is weakened
    assert masks[0].all()
    assert masks[1].tolist() == [False] + [True] * 11
    # a notch that was gentle where it was chosen is exchanged for a weaker one where it is not
    force = float(action.hold(slow, np.array(11), F(1.0))) * float(effort_at(slow.vehicle, F(2.0)).traction_n)
    assert force == pytest.approx(136e3, abs=1.0)
    force = float(action.hold(fast, np.array(0), F(-1.0))) * float(effort_at(fast.vehicle, F(14.0)).brake_n)
    assert force == pytest.approx(-132e3, abs=1.0)


def test_notches_that_stay_below_the_permitted_speed():
    action = NotchForceAction(in_time=False, below_mps=0.1)
    permitted = float(lu2023_sight().permitted_mps)
    free, near, above = (
        action.action_mask(lu2023_sight(speed_mps=F(permitted - less)), 3.0) for less in (6.0, 0.2, -1.0)
    )
    assert free.all()
    assert near.all()  # what pulls is held as far as it stays below: see the next test
    assert above[0]  # the strongest brake can always be chosen
    assert not above[6:].any()
    waiting = lu2023_sight(speed_mps=F(0.0), position_m=F(0.0), time_s=F(0.0))
    assert action.action_mask(waiting, 3.0).tolist() == [False] * 6 + [True] * 6
    # too near to protection at a crawl: no pull is allowed, so braking is, though it ends in a standstill
    crawl = lu2023_sight(position_m=F(1400.0), speed_mps=F(0.5))
    assert NotchForceAction(in_time=False, below_mps=5.0).action_mask(crawl, 90.0).any()
    # in time or not, nothing that comes too near is allowed
    late = lu2023_sight(speed_mps=F(permitted - 0.2), scheduled_s=F(51.0))
    mask = NotchForceAction(below_mps=0.1).action_mask(late, 3.0)
    assert mask.sum() == 1
    assert near[np.argmax(mask)]


def test_a_notch_is_weakened_at_the_permitted_speed():
    action = NotchForceAction(in_time=False, below_mps=0.1)
    permitted = float(lu2023_sight().permitted_mps)

    def force_n(less_mps, in_force_n):
        seen = lu2023_sight(speed_mps=F(permitted - less_mps))
        most_n = float(effort_at(seen.vehicle, F(permitted - less_mps)).traction_n)
        held = action.hold(seen._replace(command=F(in_force_n / most_n)), np.array(10), F(1.0))
        return round(float(held) * most_n, -3)

    far, near = force_n(6.0, 0.0), force_n(0.3, 170e3)
    assert far > near > 0.0
    assert force_n(0.02, 170e3) == 0.0  # even the weakest one would come nearer than 0.1 m/s
    assert force_n(0.3, near) == near  # one that is in force stays
    assert force_n(0.3, 0.0) < near  # after coasting it must last


def test_a_stop_by_notches_does_not_hunt():
    # at 40 m from the stop, level: 132 kN and resistance brake with 0.71 m/s2, 99 kN with 0.54
    action = NotchForceAction(late_brake=True)
    length = float(lu2023_sight().length_m)

    def brake_n(needed_mps2, in_force_n, left_m=40.0):
        v = np.sqrt(2.0 * needed_mps2 * left_m)
        seen = lu2023_sight(position_m=F(length - left_m), speed_mps=F(v), stop_mps2=F(0.72))
        share = F(in_force_n / float(effort_at(seen.vehicle, F(v)).brake_n))
        wanted = F(-needed_mps2 * 194.3e3 / 149e3)
        found = float(action.round(seen._replace(command=share), wanted))
        return round(found * float(effort_at(seen.vehicle, F(v)).brake_n), -3)

    assert brake_n(0.65, -99e3) == -99e3  # the next one is too strong yet
    assert brake_n(0.73, -99e3) == -132e3
    assert brake_n(0.71, -132e3) == -132e3  # and stays
    assert brake_n(0.66, -132e3) == -99e3  # until the next one nearly suffices
    assert brake_n(0.60, -99e3, left_m=2.0) == -132e3  # the last metres: what suffices


def test_regime_switches_have_a_price():
    price = RegimeSwitch(3.0)
    change = MOVING._replace(command=F(0.2), command_before=F(0.9))
    assert float(price.value(change)) == 0.0
    assert float(price.value(change._replace(command=F(0.0)))) == -3.0
    assert float(price.value(change._replace(command_before=F(-0.5)))) == -3.0

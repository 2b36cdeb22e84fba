"""Features of time on any line: paces against integration, coasting from a higher speed."""

import numpy as np
import pytest

from metropilot.env import DOMAIN_ASSISTS, RegimeAction, domain_sample, needed_traction, urgency
from metropilot.env.actions import EARLY_S, FAR_S
from metropilot.env.features import FASTER_MPS, FEATURES, OBSERVERS, SPEED_MPS, FeatureContext
from metropilot.env.tables import CLIMB_COLUMN, PACES_MPS, PERMITTED_COLUMN
from metropilot.learn import DemonstrationGenerator
from metropilot.physics import davis_n


@pytest.fixture(scope="module", params=[2, 9])
def room(request):
    return DemonstrationGenerator(domain_sample(5, request.param), 1.25)


def context(room, position_m, speed_mps, left_s):
    at, v = np.float64(position_m), np.float64(speed_mps)
    planned = DOMAIN_ASSISTS.planned_mps2(room.rows, 0, room.case.stop_mps2, at)
    case = room.case
    rest = {
        "acceleration_mps2": np.float64(0.0),
        "scheduled_s": np.float64(left_s),
        "command": np.float64(0.0),
        "assists": DOMAIN_ASSISTS,
    }
    return FeatureContext(
        rows=room.rows,
        case=0,
        vehicle=case.vehicle,
        track=case.track,
        length_m=case.length_m,
        load=case.load,
        stop_mps2=planned,
        rates=case.protection.rates,
        time_s=np.float64(0.0),
        position_m=at,
        speed_mps=v,
        **rest,
    )


def kept_s(room, pace_mps, position_m):
    """Time to the stop at a pace, or as fast as the limits and the last braking let it, by small steps."""
    x = np.linspace(position_m, room.length_m, 40001)
    work, _ = room.rows.stop_at(0, x)
    stops = np.sqrt(2.0 * np.maximum(work, 0.0))
    v = np.minimum(np.minimum(pace_mps, room.rows.follow_at(0, x)), stops)
    return float(np.sum(2.0 * np.diff(x) / (v[1:] + v[:-1])))


def test_tabled_paces_are_what_integration_gives(room):
    for share in (0.0, 0.37, 0.8):
        x = share * room.length_m
        for pace, found in zip(PACES_MPS, room.rows.pace_times_s(0, np.float64(x)), strict=True):
            assert float(found) == pytest.approx(kept_s(room, pace, x), rel=0.01, abs=0.2)


def test_the_pace_takes_the_time_that_is_left(room):
    at = 0.3 * room.length_m
    fastest, slowest = kept_s(room, PACES_MPS[-1], at), kept_s(room, PACES_MPS[0], at)
    for share in (0.05, 0.2, 0.5):
        left_s = fastest + share * (slowest - fastest)
        wanted = float(FEATURES.get("pace")(context(room, at, 12.0, left_s))[0]) * SPEED_MPS
        assert kept_s(room, wanted, at) == pytest.approx(left_s, rel=0.01)


def test_a_pace_that_must_be_reached_first_is_higher(room):
    seen = context(room, 0.0, 0.0, 1.3 * kept_s(room, PACES_MPS[-1], 0.0))
    wanted, after, above, *_ = FEATURES.get("pace")(seen)
    assert after > wanted
    assert above > 0.0


def test_coasting_from_a_higher_speed_takes_less_time(room):
    seen = context(room, 0.8 * room.length_m, 9.0, 0.2 * room.length_m / 9.0)
    plain, faster = FEATURES.get("coasting")(seen), FEATURES.get("coasting_faster")(seen)
    assert len(faster) == 3 * len(FASTER_MPS)
    assert np.tanh(float(plain[0]) * 50.0 / 20.0) < faster[0]
    assert plain[-1] <= faster[2]


def test_coasting_takes_what_integration_gives(room):
    seen = context(room, 0.75 * room.length_m, 14.0, 200.0)
    vehicle, length = seen.vehicle, float(seen.left_m)
    way = np.linspace(0.0, length, 8001)
    climb = room.rows.curve_at(CLIMB_COLUMN, 0, seen.position_m + way)
    climb = (climb - climb[0]) * float(vehicle.mass_kg / vehicle.effective_mass_kg)
    energy = np.full(way.size, 0.5 * 14.0**2)
    for k in range(way.size - 1):
        drag = float(davis_n(vehicle, np.sqrt(2.0 * energy[k])) / vehicle.effective_mass_kg)
        energy[k + 1] = max(energy[k] - (climb[k + 1] - climb[k]) - drag * way[1], 0.5)
    stop_mps = np.sqrt(2.0 * float(seen.stop_mps2) * (length - way) + 1e-6)
    top = np.minimum(room.rows.curve_at(PERMITTED_COLUMN, 0, seen.position_m + way), stop_mps)
    speed = np.minimum(np.sqrt(2.0 * energy), top)
    taken = float(np.sum(2.0 * way[1] / (speed[1:] + speed[:-1] + 0.1)))
    spare = float(FEATURES.get("coasting")(seen)[0]) * 50.0
    assert energy.min() > 5.0, "it coasts to the end"
    assert 200.0 - spare == pytest.approx(taken, rel=0.03)


def test_no_more_traction_than_coasting_needs(room):
    """None where coasting arrives in time, all far from that, and between them what is still missing."""
    at, period_s = 0.6 * room.length_m, 0.4
    seen = context(room, at, 12.0, 0.0)
    taken, faster = (float(value) for value in seen.braked_coasting_s)
    released_s = 0.5 * float(seen.stop_mps2 / seen.vehicle.jerk_mps3)
    early = taken + released_s + EARLY_S
    found = [
        float(needed_traction(context(room, at, 12.0, early + more), period_s)) for more in (1.0, 0.0, -60.0)
    ]
    assert found == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
    gained = 0.1 * float(seen.effort_limits.traction_mps2) * period_s
    left_s = early - gained * (taken - faster) / FASTER_MPS[0]
    if taken - faster > 0.1:
        assert float(needed_traction(context(room, at, 12.0, left_s), period_s)) == pytest.approx(0.1)
    action = RegimeAction(needed=True)
    late, soon = (context(room, at, 12.0, early + more) for more in (-60.0, 1.0))
    for asked, given in ((-1.0, -1.0), (-0.1, 0.0), (0.5, 0.5), (1.0, 1.0)):
        wanted = 1.0 if float(urgency(late)) > 0.0 else given
        assert float(action.command(late, np.array([asked]), period_s)) == pytest.approx(wanted)
        assert float(action.command(soon, np.array([asked]), period_s)) == pytest.approx(min(given, 0.0))


def test_full_traction_where_flat_out_is_only_just_in_time(room):
    """Full traction against every action, far from the stop: near it no drive has much to spare."""
    at, period_s, action = 0.02 * room.length_m, 0.4, RegimeAction(needed=True)
    to_go_s = float(context(room, at, 8.0, 100.0).to_go_s)
    assert to_go_s > FAR_S
    late, soon = (context(room, at, 8.0, share * to_go_s) for share in (1.01, 1.2))
    assert float(urgency(late)) == 1.0
    assert float(urgency(soon)) == 0.0
    for asked in (-1.0, 0.0, 0.5, 1.0):
        assert float(action.command(late, np.array([asked]), period_s)) == 1.0
    assert float(action.command(soon, np.array([-0.5]), period_s)) == pytest.approx(-0.5)
    near = context(room, 0.9 * room.length_m, 8.0, 1.0)
    assert float(near.to_go_s) < FAR_S
    assert float(urgency(near)) == 0.0


def test_the_observer_for_any_line_has_them():
    assert {"pace", "coasting", "coasting_faster", "steady"} <= set(OBSERVERS["line"])

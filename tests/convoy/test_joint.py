"""The head drives the plan of the whole convoy, and no convoy needs less than the joint bound."""

from itertools import pairwise

import numpy as np
import pytest

from metropilot.convoy import Convoy, ConvoyRequest, convoy_kpis, joint_attainable, joint_optimum
from metropilot.drivers import DRIVERS
from metropilot.physics import effort_at, resistance_and_gradient, track_arrays, vehicle_arrays
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Disturbance, Outcome, Run, drive
from metropilot.units import J_PER_KWH


def request(stops, time_s, name, masses=(), **options):
    origin, destination = stops
    head = {"line": "yizhuang", "origin": origin, "destination": destination, "time_s": time_s}
    head |= {"trainset": name, "driver": "optimal", "dt_s": 0.1, "options": options}
    values = {"head": head, "count": max(len(masses), 3), "follower": "follow_gap"}
    return ConvoyRequest.from_values(values | {"disturbances": [{"mass_factor": m} for m in masses]})


def driven(asked):
    """Energy of the whole convoy and its joint bound for the time it took, kWh."""
    run = asked.drive()
    kpis = convoy_kpis(run, asked.head.time_s)
    assert kpis.outcome == "arrived"
    assert kpis.contacts == 0
    optimum = joint_optimum(run.convoy, max(each.running_time_s for each in kpis.trainsets))
    assert optimum is not None
    assert len(optimum.trainset_energy_j) == len(kpis.trainsets)
    return sum(each.energy_wheel_kwh for each in kpis.trainsets), optimum.bound_j / J_PER_KWH


@pytest.mark.parametrize(
    ("stops", "time_s", "name", "masses"),
    [(("YZQ", "WHY"), 110.0, "cheng2023", (1.0, 1.2, 0.8)), (("RJ", "WYJ"), 125.0, "dkz32", ())],
)
def test_the_joint_plan_saves_energy_and_no_convoy_beats_its_bound(stops, time_s, name, masses):
    alone, bound = driven(request(stops, time_s, name, masses, joint=False))
    assert alone > bound
    joint, bound = driven(request(stops, time_s, name, masses))
    assert joint > bound
    assert joint < 0.985 * alone
    assert joint < 1.08 * bound


def test_the_head_accelerates_no_harder_than_the_weakest_behind_it():
    section = load_line("yizhuang").section("RJ", "WYJ")
    head = load_trainset("dkz32")
    heavy = Disturbance(mass_factor=1.6).true_plant(head)
    coupled = ((head, 124.0), (heavy, 248.0))
    found = drive(Run(section, head, 115.0, dt=0.1, coupled=coupled), DRIVERS.make("optimal"))
    assert found.outcome is Outcome.ARRIVED
    assert found.running_time_s == pytest.approx(115.0, abs=1.0)
    t = found.trajectory
    vehicle, track = vehicle_arrays(heavy), track_arrays(section, heavy)
    moving = np.flatnonzero((t.speed_mps[:-1] > 0.5) & (t.position_m[:-1] < section.length_m - 60.0))
    spare = []
    for k in moving:
        v = float(t.speed_mps[k])
        drag = sum(resistance_and_gradient(vehicle, track, float(t.position_m[k]) - 248.0, v))
        most = (float(effort_at(vehicle, v).traction_n) - drag) / vehicle.effective_mass_kg
        spare.append(most - float(t.acceleration_mps2[k]))
    assert min(spare) > -0.02
    # the head by itself would leave it behind
    free = drive(Run(section, head, 115.0, dt=0.1), DRIVERS.make("optimal")).trajectory
    assert free.acceleration_mps2.max() > t.acceleration_mps2.max() + 0.1


def test_the_plan_keeps_the_lowest_jerk_limit_behind():
    section = load_line("yizhuang").section("RJ", "WYJ")
    quick, gentle = load_trainset("cheng2023"), load_trainset("dkz32")
    assert gentle.actuation.jerk_limit_mps3 < quick.actuation.jerk_limit_mps3
    found = drive(Run(section, quick, 115.0, dt=0.1, coupled=((gentle, 130.0),)), DRIVERS.make("optimal"))
    assert found.outcome is Outcome.ARRIVED
    rate = found.trajectory.acceleration_mps2
    on_the_way = found.trajectory.position_m < section.length_m - 60.0
    seen = np.abs(np.diff(rate))[on_the_way[1:]] / 0.1
    assert np.quantile(seen, 0.99) < 1.6 * gentle.actuation.jerk_limit_mps3


def test_the_minimum_time_is_that_of_the_weakest_and_the_optimum_sums_all():
    section = load_line("yizhuang").section("RJ", "WYJ")
    trainset = load_trainset("dkz32")
    plans = []
    for masses in ((1.0, 1.0), (1.0, 1.2), (1.2, 1.2)):
        disturbances = tuple(Disturbance(mass_factor=m) for m in masses)
        convoy = Convoy(section=section, trainsets=(trainset, trainset), disturbances=disturbances)
        plans.append(joint_optimum(convoy, 110.0))
    assert all(a.bound_j < b.bound_j for a, b in pairwise(plans))
    assert plans[1].trainset_energy_j[1] > 1.05 * plans[1].trainset_energy_j[0]
    assert joint_optimum(convoy, 1.0).running_time_s > 80.0
    assert joint_optimum(Convoy(section=section, trainsets=(trainset,) * 2, start_gap_m=50.0), 110.0) is None


@pytest.mark.parametrize("guard", ["coupled", "none"])
def test_the_attainable_energy_lies_above_the_optimum_by_what_the_rules_cost(guard):
    section = load_line("yizhuang").section("RJ", "WYJ")
    convoy = Convoy(section=section, trainsets=(load_trainset("dkz32"),) * 3, guard=guard)
    costs = []
    for time_s in (102.0, 125.0):
        optimum, attainable = joint_optimum(convoy, time_s), joint_attainable(convoy, time_s)
        assert attainable.running_time_s == pytest.approx(time_s, abs=0.5)
        costs.append(attainable.energy_j / optimum.bound_j - 1.0)
    assert costs[0] > costs[1] > 0.005
    assert (costs[0] > 0.04) == (guard == "coupled")
    assert joint_attainable(convoy, 60.0) is None

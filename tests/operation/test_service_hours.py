"""Hours at a headway: the energy of one headway, a driver and departures that scatter around it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from tests.operation.lines import TRAINSET, short_line

from metropilot.errors import Infeasible
from metropilot.operation import (
    LineOperation,
    OperationOptions,
    ScatteredEnergy,
    ServiceHours,
    ServiceScatter,
    TripDrives,
    feed_line,
    operation_energy,
)
from metropilot.railway import Storage, load_feeding


def operation(**given):
    return LineOperation(
        short_line(3), TRAINSET, OperationOptions(**({"zones": 1, "headway_s": 200} | given))
    )


@cache
def plans():
    line = operation()
    return {"optimal": [line.profiles()], "cruise": [line.profiles("cruise")]}


@cache
def network():
    feeding = load_feeding("yizhuang")
    return replace(feeding, substations=feeding.substations[:3])


@cache
def drives():
    return TripDrives(operation(), "manual", (0, 1))


@pytest.mark.parametrize("zones", [1, 2])
def test_an_hour_is_its_headways(zones):
    line = operation(zones=zones)
    hours, timetable, profiles = ServiceHours(line), line.plain_timetable(37.0), plans()["cruise"][0]
    assert hours.energy_kwh(hours.repeat(timetable), [profiles]) == pytest.approx(
        line.energy(timetable, profiles).supplied_kwh, rel=1e-9
    )


def test_an_hour_of_a_network_is_its_headways():
    line = operation()
    hours, timetable, profiles = (
        ServiceHours(line, network()),
        line.plain_timetable(37.0),
        plans()["cruise"][0],
    )
    assert hours.energy_kwh(hours.repeat(timetable), [profiles]) == pytest.approx(
        feed_line(line, timetable, profiles, network()).energy_kwh, rel=1e-9
    )


def test_an_hour_with_storages_aboard_is_its_headways():
    line, aboard = operation(), Storage(capacity_j=36e6, charge_above_v=855.0, discharge_below_v=845.0)
    feeding = replace(network(), onboard=aboard)
    hours, timetable, profiles = ServiceHours(line, feeding), line.plain_timetable(37.0), plans()["cruise"][0]
    periodic = feed_line(line, timetable, profiles, feeding)
    assert periodic.flow.onboard_w.max() > 1e5
    assert hours.energy_kwh(hours.repeat(timetable), [profiles]) == pytest.approx(
        periodic.energy_kwh, rel=1e-3
    )


def test_the_last_train_may_need_more_than_an_hour_to_the_end():
    line = operation(headway_s=1800, dwell_s=600)
    hours, timetable = ServiceHours(line), line.plain_timetable(0.0)
    long = replace(timetable, departure_s=timetable.departure_s.copy())
    assert hours.repeat(long).span_s[1] > 3600.0 + line.journey_s(backward=False)
    profiles = plans()["optimal"][0]
    assert hours.energy_kwh(hours.repeat(long), [profiles]) == pytest.approx(
        line.energy(long, profiles).supplied_kwh, rel=1e-9
    )


def test_a_driver_and_departures_that_scatter_beside_a_headway():
    found = operation_energy(
        operation(), plans=plans(), scatter=ServiceScatter(drives(), (0.001, 10.0), seed=1)
    )
    none, ten = found.scattered
    assert none.energy_kwh == pytest.approx(found.energy_kwh, rel=1e-4)
    assert found.energy_kwh < ten.energy_kwh < found.cruise_kwh
    assert 10.0 * none.deviation_kwh < ten.deviation_kwh
    assert found.driven is not None
    assert found.energy_kwh < found.driven.energy_kwh < 1.3 * found.cruise_kwh
    told = found.as_dict()
    assert told["driver"]["driver"] == "manual"
    assert [each["seconds"] for each in told["scattered"]] == [0.001, 10.0]
    # driven once: other headways take the same runs
    again = operation_energy(operation(), plans=plans(), scatter=ServiceScatter(drives()))
    assert again.driven == found.driven


def test_with_a_network_all_energies_are_its_own():
    scatter = ServiceScatter(None, (3.0,))
    found = operation_energy(operation(), plans=plans(), feeding=network(), scatter=scatter)
    fed = feed_line(operation(), found.timetable, found.profiles, network())
    told = found.as_dict(fed)["feeding"]["network"]
    assert told["energy_kwh"] < told["driving_only_kwh"] < told["cruise_kwh"]
    assert told["energy_kwh"] < told["timetable_only_kwh"]
    assert found.scattered[0].energy_kwh == pytest.approx(told["energy_kwh"], rel=0.02)
    weak = replace(network(), substations=(replace(network().substations[0], resistance_ohm=0.12),))
    named = operation_energy(operation(), plans=plans(), feeding=weak, scatter=scatter)
    assert named.network_kwh["cruise_kwh"] is None
    assert named.scattered == (ScatteredEnergy(3.0, None, None),)
    with pytest.raises(Infeasible, match="train"):
        feed_line(operation(), named.timetable, named.profiles, weak)


def test_draws_are_those_of_the_seed():
    line = operation()
    hours, profiles = ServiceHours(line), plans()["optimal"][0]
    kwh = [
        hours.scatter(line.plain_timetable(), profiles, ServiceScatter(None, (10.0,), seed))["scattered"][0]
        for seed in (0, 0, 1)
    ]
    assert kwh[0] == kwh[1] != kwh[2]
    assert np.isfinite(kwh[2].deviation_kwh)

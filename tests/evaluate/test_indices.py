"""The five indices of Huang25, each against a number worked out by hand."""

import dataclasses

import numpy as np
import pytest

from metropilot.drivers import DRIVERS
from metropilot.evaluate.kpis import (
    comfort_index,
    indices_of,
    parking_index,
    punctuality_index,
    safety_index,
)
from metropilot.evaluate.measures import motion_energy_jpkg
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Run, Trajectory, drive


def test_comfort_counts_every_change():
    # 0 -> 0.6 -> 0 -> -1 -> 0: 0.6 + 0.6 + 1 + 1
    assert comfort_index(np.array([0.6, 0.6, 0.0, -1.0])) == pytest.approx(3.2)
    # 0 -> 0.3 -> 0.6 -> 0 -> -1 -> 0, only changes above 0.3 count: 0.6 + 1 + 1
    assert comfort_index(np.array([0.3, 0.6, 0.0, -1.0]), 0.3) == pytest.approx(2.6)
    assert comfort_index(np.zeros(5)) == 0.0


def test_energy_of_one_peak_is_its_speed_squared():
    # 0.6 m/s2 to 19.49 m/s and -1 m/s2 to a stand: |a| s is v^2/2 each, 379.9 together (the paper prints 380)
    peak = 19.49
    columns = {field.name: np.zeros(3) for field in dataclasses.fields(Trajectory)}
    columns["acceleration_mps2"] = np.array([0.6, -1.0, 0.0])
    columns["position_m"] = np.array([0.0, peak**2 / 1.2, peak**2 / 1.2 + peak**2 / 2.0])
    assert motion_energy_jpkg(Trajectory(**columns)) == pytest.approx(379.86, abs=0.01)


@pytest.mark.parametrize(("took", "index"), [(101.0, 1), (104.0, 1), (97.9, 0), (104.1, 0)])
def test_punctuality(took, index):
    assert punctuality_index(took, 101.0) == index


def test_safety_and_parking():
    assert (safety_index(0.0), safety_index(0.01)) == (1, 0)
    assert [parking_index(x, 1280.0) for x in (1279.75, 1280.25, 1280.31)] == [1, 1, 0]


def test_on_a_drive():
    run = Run(load_line("yizhuang-ttobench").section("RJ", "WYJ"), load_trainset("dkz32"), 101.0)
    found = drive(run, DRIVERS.make("flat_out"))
    indices = indices_of(found)
    # flat out takes 86 s: safe and in place, but 15 s early
    assert (indices.safe, indices.on_time, indices.parked, indices.met) == (1, 0, 1, False)
    # a run from stand to stand covers its kinetic energy at least twice
    assert indices.energy_jpkg >= found.trajectory.speed_mps.max() ** 2 * 0.999
    assert indices.comfort_mps2 >= 2.0 * (indices.energy_jpkg / run.section.length_m)

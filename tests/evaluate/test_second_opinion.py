"""Any run's `trajectory.csv`, integrated again by nothing but Newton: the same run, the same KPIs."""

import csv
import os
import subprocess
import sys

import numpy as np
import pytest
from tests.reference.replay import read_rows, replay

from metropilot.drivers import DRIVERS
from metropilot.evaluate import RunSpec, kpis_of
from metropilot.railway import load_line
from metropilot.sim import Disturbance, drive

KWH = 3.6e6
SECTIONS = [*load_line("yizhuang").sections(), *load_line("yizhuang").sections(backward=True)]
LOADS = ("AW0", "AW2", "AW3")
NAMES = [name for name in DRIVERS.ids() if name != "learned"]


def request_of(name):
    """Another section and load for every driver, a quarter more than the shortest times planned."""
    k = NAMES.index(name)
    cut = SECTIONS[(7 * k) % len(SECTIONS)]
    time_s = 1.1 * cut.planned_time_s
    stations = (cut.origin.code, cut.destination.code)
    return RunSpec(
        "yizhuang",
        *stations,
        time_s,
        load=LOADS[k % 3],
        driver=name,
        disturbance=Disturbance(mass_factor=1.0 + 0.02 * (k % 4)),
    )


@pytest.mark.parametrize("name", NAMES)
def test_a_run_of_every_driver_replays_from_its_file(tmp_path, name):
    done = drive((request := request_of(name)).run(), request.make_driver())
    kpis = kpis_of(done, None)
    path = tmp_path / "trajectory.csv"
    done.trajectory.write(path)
    rows = read_rows(path)
    again = replay(rows, kpis.effective_mass_kg)
    seen = {key: np.array([float(row[key]) for row in rows]) for key in rows[0] if key != "phase"}
    np.testing.assert_allclose(again.position_m, seen["position_m"], atol=1e-6)
    np.testing.assert_allclose(again.speed_mps, seen["speed_mps"], atol=1e-8)
    np.testing.assert_allclose(again.energy_wheel_j, seen["energy_wheel_j"], rtol=1e-9, atol=1.0)
    # Traction's work is kinetic energy, height and what resistance and brakes have taken: nothing is lost.
    moved = np.diff(seen["position_m"])
    against = ("electric_brake_n", "friction_brake_n", "resistance_n", "gradient_n")
    taken = sum(float((seen[key][:-1] * moved).sum()) for key in against)
    kinetic = 0.5 * kpis.effective_mass_kg * (seen["speed_mps"][-1] ** 2 - seen["speed_mps"][0] ** 2)
    assert taken + kinetic == pytest.approx(again.energy_wheel_j[-1], rel=1e-9, abs=10.0)
    assert kpis.energy_wheel_kwh * KWH == pytest.approx(again.energy_wheel_j[-1], rel=1e-9)
    assert kpis.running_time_s == pytest.approx(again.time_s[-1], abs=1e-9)
    over = np.maximum(seen["speed_mps"] - seen["limit_mps"], 0.0).max()
    assert kpis.max_overspeed_mps == pytest.approx(over, abs=1e-9)
    assert again.energy_wheel_j[-1] > 1e6


PROGRAM = """
import sys
from pathlib import Path
from metropilot.evaluate import RunSpec
from metropilot.sim import Disturbance, drive
noisy = Disturbance(speed_noise_mps=0.1)
request = RunSpec("yizhuang", "RJ", "WYJ", 110.0, driver="ppo", disturbance=noisy, seed=5)
drive(request.run(), request.make_driver()).trajectory.write(Path(sys.argv[1]))
"""


def test_neither_time_zone_nor_language_changes_a_bit(tmp_path):
    written = []
    for zone, language in (("UTC", "C"), ("Pacific/Kiritimati", "de_DE.UTF-8")):
        told = {"TZ": zone, "LC_ALL": language, "LANG": language, "PYTHONHASHSEED": str(len(written))}
        path = tmp_path / f"{len(written)}.csv"
        subprocess.run([sys.executable, "-c", PROGRAM, str(path)], env={**os.environ, **told}, check=True)
        written.append(path.read_bytes())
    assert written[0] == written[1]
    assert len(list(csv.reader(written[0].decode().splitlines()))) > 400

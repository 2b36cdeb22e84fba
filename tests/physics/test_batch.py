"""Padded batches: one compilation, the same results as one by one, either number type, either namespace."""

import os
import subprocess
import sys

import numpy as np
import pytest
from tests.physics import cases

from metropilot import physics
from metropilot.railway import load_line, load_trainset

DT = 0.2


def catalogue():
    """All Yizhuang sections both ways, and trainsets that differ in curves, loads and efficiency maps."""
    line = load_line("yizhuang")
    sections = [*line.sections(), *line.sections(backward=True)]
    dkz32 = load_trainset("dkz32")
    return sections, [*(dkz32.with_load(load) for load in dkz32.loads), load_trainset("cheng2023")]


def test_all_sections_trainsets_and_loads_share_one_compilation():
    sections, trainsets = catalogue()
    traces = []

    def speed_of(state):
        traces.append(1)  # runs when JAX traces, not when it computes
        return state.speed_mps

    vehicles, tracks = physics.grid(sections, trainsets)
    count = physics.batch_size(vehicles)
    assert count == len(sections) * len(trainsets) == 104
    shares = np.random.default_rng(0).uniform(0.2, 1.0, (4, 100)).astype(np.float32)
    at_rest = physics.at_rest(physics.vehicle_arrays(trainsets[0], np.float32))
    for first in range(0, count, 4):
        part = [type(tree)(*(field[first : first + 4] for field in tree)) for tree in (vehicles, tracks)]
        batch = physics.to_jax((*part, physics.stack([at_rest] * 4)))
        end, speeds = physics.rollout_batch(*batch, shares, DT, record=speed_of)
        assert np.isfinite(np.asarray(speeds)).all()
        assert (np.asarray(end.position_m) > 50.0).all()
    # the scan traces its body once to find its types and once for the program
    assert len(traces) <= 2
    before = len(traces)
    physics.rollout_batch(*batch, shares, DT, record=speed_of)
    assert len(traces) == before


def keep(state):
    return state


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-9), (np.float32, 1e-4)])
def test_a_batch_is_its_members_one_by_one_in_numpy(dtype, tolerance):
    sections, trainsets = catalogue()
    sections, trainsets = sections[::9], trainsets[1:]
    vehicles, tracks = physics.grid(sections, trainsets, dtype)
    count = physics.batch_size(vehicles)
    rng = np.random.default_rng(5)
    shares = np.stack([cases.random_commands(rng, 250) for _ in range(count)])
    at_rest = physics.at_rest(physics.vehicle_arrays(trainsets[0], dtype))

    def run():
        batch = physics.to_jax((vehicles, tracks, physics.stack([at_rest] * count)))
        return physics.rollout_batch(*batch, shares.astype(dtype), DT)[0]

    if dtype is np.float64:
        with physics.double_precision():
            end = run()
    else:
        end = run()
    pairs = [(section, trainset) for section in sections for trainset in trainsets]
    alone = [cases.drive(*cases.plant(*pair), row, DT)[-1] for pair, row in zip(pairs, shares, strict=True)]
    for name in ("position_m", "time_s", "traction_j", "line_j"):
        expected = np.array([float(getattr(state, name)) for state in alone])
        np.testing.assert_allclose(np.asarray(getattr(end, name)), expected, rtol=tolerance)


def test_a_whole_row_of_states_steps_at_once_in_numpy():
    """The same formulas over NumPy arrays: one trainset, one section, many states."""
    rng = np.random.default_rng(6)
    section, trainset = cases.random_section(rng), cases.random_trainset(rng)
    vehicle, track = cases.plant(section, trainset)
    position, speed = rng.uniform(0.0, 1900.0, 50), rng.uniform(0.0, 20.0, 50)
    share = rng.uniform(-1.0, 1.0, 50)
    alone = [
        cases.drive(vehicle, track, [u], DT, physics.at_rest(vehicle, position_m=x, speed_mps=v))[-1]
        for x, v, u in zip(position, speed, share, strict=True)
    ]
    rows = physics.stack([physics.at_rest(vehicle)] * 50)._replace(
        position_m=position, speed_mps=speed, pipeline=np.zeros((1, 50))
    )
    released = np.zeros(50, bool)
    after = physics.step(vehicle, track, rows, physics.Command(share, released), DT)
    np.testing.assert_allclose(after.position_m, [s.position_m for s in alone])
    np.testing.assert_allclose(after.line_j, [s.line_j for s in alone])


def test_stacking_pads_every_list_to_the_longest():
    rng = np.random.default_rng(8)
    plants = [
        cases.plant(cases.random_section(rng), t) for t in (cases.random_trainset(rng), cases.trainset())
    ]
    vehicles = physics.stack([vehicle for vehicle, _ in plants])
    assert vehicles.efficiency_traction.shape == (2, 3, 3)
    assert np.isinf(vehicles.efficiency_speed_mps[1, 1:]).all()
    assert vehicles.mass_kg.shape == (2,)
    states = physics.stack(
        [physics.at_rest(v, delay_steps=d) for (v, _), d in zip(plants, (0, 3), strict=True)]
    )
    assert states.pipeline.shape == (2, 4)
    assert states.forces.traction_n.shape == (2,)


TWO_DEVICES = """
import jax, numpy as np
from metropilot import physics
from tests.physics import cases
vehicle, track = cases.plant(cases.section(), cases.trainset(), np.float32)
trees = [physics.stack([tree] * 8) for tree in (vehicle, track, physics.at_rest(vehicle))]
shares = np.ones((8, 50), np.float32)
plain, _ = physics.rollout_batch(*physics.to_jax(tuple(trees)), shares, 0.2)
shared, _ = physics.rollout_batch(*physics.spread(tuple(trees)), physics.spread(shares), 0.2)
assert len(shared.position_m.sharding.device_set) == 2, shared.position_m.sharding
np.testing.assert_array_equal(np.asarray(plain.position_m), np.asarray(shared.position_m))
"""


def test_a_batch_spreads_over_two_devices():
    environment = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    done = subprocess.run(
        [sys.executable, "-c", TWO_DEVICES], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr

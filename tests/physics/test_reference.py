"""The plant against the slow reference simulator: NumPy float64, JAX float64, JAX float32."""

import numpy as np
import pytest
from tests.physics import cases
from tests.reference.replay import FORCES as REPLAYED
from tests.reference.replay import read_rows, replay
from tests.reference.simulator import ReferenceSimulator

from metropilot import physics
from metropilot.railway import load_line, load_trainset

FIELDS = ("time_s", "position_m", "speed_mps", "acceleration_mps2", "share")
ENERGIES = ("traction_j", "electric_brake_j", "line_j", "recovered_j")
FORCES = physics.Forces._fields
DT = 0.2


def reference(section, trainset, shares):
    simulator = ReferenceSimulator(section, trainset)
    return [simulator.step(float(share), DT) for share in shares]


def worst(ours, theirs):
    """Largest difference of each field over the trajectory, relative to the field's largest value."""
    out = {}
    for name in (*FIELDS, *ENERGIES, *FORCES):
        mine = np.array([getattr(s.forces if name in FORCES else s, name) for s in ours], float)
        other = np.array([getattr(s, name) for s in theirs])
        out[name] = float(np.abs(mine - other).max() / max(np.abs(other).max(), 1.0))
    return out


def delays(trainset):
    return physics.delay_steps(trainset.actuation.delay_s, DT)


@pytest.mark.parametrize("seed", range(12))
def test_numpy_float64_is_the_reference(seed):
    rng = np.random.default_rng(seed)
    section, trainset = cases.random_section(rng), cases.random_trainset(rng)
    shares = cases.random_commands(rng)
    states = cases.drive(*cases.plant(section, trainset), shares, DT, delay_steps=delays(trainset))
    differences = worst(states[1:], reference(section, trainset, shares))
    assert states[-1].position_m > 50.0
    assert max(differences.values()) < 1e-9, differences


@pytest.mark.parametrize("load", ["AW0", "AW3"])
def test_catalogue_sections_are_the_reference(load):
    rng = np.random.default_rng(1)
    trainset = load_trainset("dkz32").with_load(load)
    for section in load_line("yizhuang").sections(backward=True)[::4]:
        shares = cases.random_commands(rng, 300)
        states = cases.drive(*cases.plant(section, trainset), shares, DT)
        differences = worst(states[1:], reference(section, trainset, shares))
        assert max(differences.values()) < 1e-9, (section.name, differences)


def test_clothoids_are_the_reference_within_their_ten_metre_pieces():
    rng = np.random.default_rng(3)
    section = cases.random_section(rng, clothoids=True)
    for formula in ("600/r", "6.3/(r-55)"):
        trainset = cases.trainset(length_m=120.0, curve_formula=formula)
        simulator = ReferenceSimulator(section, trainset)
        vehicle, track = cases.plant(section, trainset)
        at = np.linspace(0.0, 1990.0, 400)
        ours = [physics.resistance_and_gradient(vehicle, track, x, 0.0)[0] for x in at]
        theirs = [simulator.curve_n(float(x)) for x in at]
        np.testing.assert_allclose(ours, theirs, atol=0.01 * max(theirs))


@pytest.fixture(scope="module")
def many():
    """Eight random cases as one batch, with the reference's trajectories."""
    rng = np.random.default_rng(7)
    pairs = [(cases.random_section(rng), cases.random_trainset(rng)) for _ in range(8)]
    shares = np.stack([cases.random_commands(rng) for _ in pairs])
    return pairs, shares, [reference(*pair, row) for pair, row in zip(pairs, shares, strict=True)]


def keep(state):
    return state


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-9), (np.float32, 3e-4)])
def test_jax_batch_is_the_reference(many, dtype, tolerance):
    import jax

    pairs, shares, theirs = many
    plants = [cases.plant(section, trainset, dtype) for section, trainset in pairs]
    vehicles = physics.stack([vehicle for vehicle, _ in plants])
    tracks = physics.stack([track for _, track in plants])
    slots = max(delays(trainset) for _, trainset in pairs)
    states = physics.stack([physics.at_rest(vehicle, delay_steps=slots) for vehicle, _ in plants])
    with jax.enable_x64(dtype is np.float64):
        batch = physics.to_jax((vehicles, tracks, states))
        _, rows = physics.rollout_batch(*batch, shares.astype(dtype), DT, record=keep)
        rows = jax.tree.map(np.asarray, rows)
    assert rows.position_m.dtype == dtype
    for k, other in enumerate(theirs):
        for name in ("position_m", "speed_mps", "traction_j", "line_j"):
            mine = getattr(rows, name)[k]
            expected = np.array([getattr(s, name) for s in other])
            np.testing.assert_allclose(mine, expected, atol=tolerance * max(np.abs(expected).max(), 1.0))


def test_a_recorded_trajectory_replays_from_its_forces(tmp_path):
    """One row a step with the forces held from it on, as `trajectory.csv` has them."""
    rng = np.random.default_rng(11)
    section, trainset = cases.random_section(rng), cases.random_trainset(rng)
    vehicle, track = cases.plant(section, trainset)
    states = cases.drive(vehicle, track, cases.random_commands(rng), DT, delay_steps=delays(trainset))
    lines = [",".join(("time_s", "position_m", "speed_mps", *REPLAYED))]
    for state, after in zip(states, [*states[1:], states[-1]], strict=True):
        held = (getattr(after.forces, name) for name in REPLAYED)
        row = (state.time_s, state.position_m, state.speed_mps, *held)
        lines.append(",".join(repr(float(value)) for value in row))
    (tmp_path / "trajectory.csv").write_text("\n".join(lines))
    again = replay(read_rows(tmp_path / "trajectory.csv"), trainset.effective_mass_kg)
    np.testing.assert_allclose(again.position_m, [s.position_m for s in states], atol=1e-6)
    np.testing.assert_allclose(again.speed_mps, [s.speed_mps for s in states], atol=1e-9)
    np.testing.assert_allclose(again.energy_wheel_j, [s.traction_j for s in states], rtol=1e-9)
    np.testing.assert_allclose(
        again.energy_electric_j, [s.electric_brake_j for s in states], rtol=1e-9, atol=1e-6
    )

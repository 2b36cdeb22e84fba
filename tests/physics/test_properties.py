"""Properties that hold for any trainset on any section (Hypothesis)."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.physics import cases

from metropilot.railway import Actuation

SEEDS = st.integers(0, 2**32 - 1)


@settings(max_examples=25)
@given(SEEDS, st.sampled_from([0.1, 0.25, 1.0]))
def test_speed_is_never_negative_and_position_never_falls(seed, dt):
    rng = np.random.default_rng(seed)
    section = cases.random_section(rng, gradient_permil=40.0)
    vehicle, track = cases.plant(section, cases.random_trainset(rng))
    states = cases.drive(vehicle, track, cases.random_commands(rng, 150), dt, delay_steps=8)
    values = np.array([[s.time_s, s.position_m, s.speed_mps, s.traction_j, s.recovered_j] for s in states])
    assert np.isfinite(values).all()
    assert (values[:, 2] >= 0).all()
    steps = np.diff(values[:, [0, 1, 3, 4]], axis=0)
    assert (steps >= 0).all()
    assert (steps[:, 0] <= dt * (1 + 1e-12)).all()


@settings(max_examples=20)
@given(SEEDS, st.floats(1.02, 1.8))
def test_a_heavier_trainset_is_never_faster_flat_out(seed, factor):
    """On any track that never falls: downhill more weight may be faster."""
    rng = np.random.default_rng(seed)
    section = cases.section(cases.random_steps(rng, 0.0, 25.0))
    light = replace(cases.random_trainset(rng, actuation=Actuation()), adhesion=np.inf)
    heavy = replace(light, loads={"full": light.mass_kg * factor})
    shares = np.ones(300)
    first = cases.drive(*cases.plant(section, light), shares, 0.25)
    second = cases.drive(*cases.plant(section, heavy), shares, 0.25)
    at = np.linspace(5.0, max(float(second[-1].position_m), 6.0), 40)
    speed = [
        np.interp(at, [s.position_m for s in run], [s.speed_mps for s in run]) for run in (first, second)
    ]
    assert (speed[1] <= speed[0] + 0.02).all()  # chords between the steps of two runs are compared
    assert second[-1].position_m <= first[-1].position_m + 1e-9

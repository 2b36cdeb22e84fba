"""A million supervised steps against commands that mean harm, and not one above the limit."""

import numpy as np
import pytest
from tests.protection import hostile

# Rounding of a float32 state at 22 m/s and some kilometres; the curves already keep clear of it.
FLOAT32_MPS = 1e-4


@pytest.mark.parametrize(
    "campaign",
    [
        pytest.param(hostile.real(steps=1200), id="late, noisy, far from nominal"),
        pytest.param(hostile.ideal(steps=800), id="ideal"),
        pytest.param(hostile.real(steps=300, mutate=hostile.bare, seed=2), id="without the service curve"),
    ],
)
def test_never_above_the_limit(campaign):
    tally = hostile.fight(campaign)
    assert tally.finite
    assert tally.over_mps <= 0.0, tally
    assert tally.over_steps == 0
    # The attacks were attacks: the supervisor had to act thousands of times, in every way it can.
    assert tally.interventions > 500
    assert tally.emergencies > 100
    assert tally.invalid > 1000
    # And it did not win by standing still: somebody came within a hand's breadth of the limit.
    assert tally.over_mps > -0.3


def test_the_campaign_has_a_million_steps():
    sections = len(hostile.line_sections())
    assert sections == 26
    assert sections * hostile.real().lanes * (1200 + 800 + 300) > 1_000_000


def test_float32_within_its_rounding():
    tally = hostile.fight(hostile.real(steps=300, dtype=np.float32, seed=3))
    assert tally.finite
    assert tally.over_mps <= FLOAT32_MPS, tally
    assert tally.interventions > 1000


def test_without_the_supervisor_they_speed():
    tally = hostile.fight(hostile.real(steps=100, supervised=False))
    assert tally.over_mps > 5.0
    assert tally.over_steps > 1000

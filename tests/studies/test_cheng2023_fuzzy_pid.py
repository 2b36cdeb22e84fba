"""The fuzzy rules against a slow second opinion and numbers worked out by hand."""

import numpy as np
import pytest

from metropilot.control import CHENG2023_GAINS, CHENG2023_UPPER
from metropilot.errors import InputError
from metropilot.studies.cheng2023.fuzzy_pid import (
    ASSUMED_UNIVERSES,
    DERIVATIVE,
    GRID,
    INTEGRAL,
    NB,
    PB,
    PROPORTIONAL,
    TABLES,
    TUNED_FUZZY_PID,
    FuzzyPid,
    FuzzyPidOptions,
    fuzzy_gains,
    infer,
    memberships,
)


def slow_membership(name, x):
    """One set by its definition, x within [-3, 3]."""
    if name in (NB, PB):
        y = x if name == PB else -x
        if y <= 1:
            return 0.0
        return 2 * ((y - 1) / 2) ** 2 if y < 2 else 1 - 2 * ((y - 3) / 2) ** 2
    centre = name - 3
    left, right = max(centre - 2, -3), min(centre + 2, 3)
    return max(0.0, (x - left) / (centre - left) if x <= centre else (right - x) / (right - centre))


def slow_inference(error, change, table):
    """Mamdani by the book: every rule clips its consequent, the largest counts, the centroid answers."""
    heights = np.zeros(GRID.size)
    for row in range(7):
        for column in range(7):
            fires = min(slow_membership(row, error), slow_membership(column, change))
            clipped = [min(fires, slow_membership(table[row][column], y)) for y in GRID]
            heights = np.maximum(heights, clipped)
    return float((GRID * heights).sum() / heights.sum())


def test_memberships_by_hand():
    # 0.4: NS has (1 - 0.4)/2, ZO (2 - 0.4)/2, PS (0.4 + 1)/2, PM 0.4/2
    np.testing.assert_allclose(memberships(0.4), [0, 0, 0.3, 0.8, 0.7, 0.2, 0], atol=1e-12)
    assert memberships(3.0)[PB] == memberships(-3.0)[NB] == 1.0
    assert memberships(9.0)[PB] == 1.0  # outside the universe its end holds


@pytest.mark.parametrize(
    "point", [(0.0, 0.0), (0.4, -0.3), (-2.2, 1.7), (3.0, 3.0), (1.5, -2.9), (-0.1, 0.05)]
)
def test_inference_agrees_with_the_slow_one(point):
    expected = [slow_inference(*point, table) for table in (PROPORTIONAL, INTEGRAL, DERIVATIVE)]
    np.testing.assert_allclose(infer(*point), expected, atol=1e-9)


def test_a_single_rule_answers_with_the_centroid_of_its_set():
    # Both wholly big: kp by NB, ki by PB, kd by PB. The centroid of the S-shaped end is 2 + 5/12 by
    # integration; 61 points with the last one whole give 0.03 more.
    np.testing.assert_allclose(infer(3.0, 3.0), [-2.445, 2.445, 2.445], atol=2e-3)


def test_the_rules_are_the_textbooks():
    # kp falls and ki rises from the first corner to the last; every table knows all seven rows and columns.
    assert (PROPORTIONAL[0][0], PROPORTIONAL[6][6]) == (PB, NB)
    assert (INTEGRAL[0][0], INTEGRAL[6][6]) == (NB, PB)
    assert all(len(table) == 7 and {len(row) for row in table} == {7} for table in TABLES)
    assert all(PROPORTIONAL[i][j] >= PROPORTIONAL[i][j + 1] for i in range(7) for j in range(6))


def test_gains_stay_within_their_limits_and_start_from_the_base():
    big = ASSUMED_UNIVERSES._replace(proportional=50.0, integral=50.0, derivative=50.0)
    for error in np.linspace(-1, 1, 9):
        gains = fuzzy_gains(error, 0.1 * error, big)
        assert all(0 <= g <= u for g, u in zip(gains, CHENG2023_UPPER, strict=True))
    still = ASSUMED_UNIVERSES._replace(proportional=0.0, integral=0.0, derivative=0.0)
    assert fuzzy_gains(0.3, 0.1, still) == pytest.approx(CHENG2023_GAINS)


def test_compiled_it_infers_the_same():
    import jax
    import jax.numpy as jnp

    points = np.random.default_rng(0).uniform(-3, 3, (50, 2))
    found = jax.jit(jax.vmap(infer))(*jnp.asarray(points, jnp.float32).T)
    np.testing.assert_allclose(found, [infer(*p) for p in points], atol=1e-4)


def test_options():
    assert FuzzyPid(FuzzyPidOptions(tuned=True)).base.proportional == TUNED_FUZZY_PID["kp"]
    with pytest.raises(InputError, match="error_mps"):
        FuzzyPidOptions(error_mps=0.0)

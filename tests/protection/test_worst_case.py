"""A small search for the worst case: close but never through, and through where a guard is missing.

The large one is ``python -m benchmarks.worst_case --steps 1e8``; its table is in ``docs/safety.md``.
"""

import numpy as np
import pytest
from tests.protection import hostile
from tests.protection.convoy_search import Convoys
from tests.protection.optimiser import hunt, scatter, share
from tests.protection.search import Field, places

from metropilot.convoy import EVERY_DISTURBANCE, MASS_AND_RESISTANCE, AttackCampaign

PLACES, POPULATION, GENERATIONS = 9, 16, 12


def test_a_share_reaches_both_ends_and_folds():
    at = np.linspace(-4.0, 4.0, 801)
    assert share(at).min() == 0.0
    assert share(at).max() == 1.0
    np.testing.assert_allclose(share(at), share(at + 2.0), atol=1e-12)
    assert np.abs(np.diff(share(at))).max() < 0.02


def test_the_optimiser_finds_what_random_search_does_not():
    def fly(attacks):
        return -np.abs(attacks - np.linspace(0.4, 0.8, attacks.shape[2])).sum(axis=2)

    found = hunt(fly, np.full((2, 12), 0.5), population=16, generations=40, seed=1)
    beside = scatter(fly, 2, 12, population=16, generations=40, seed=1)
    assert found.evaluations == beside.evaluations == 2 * 16 * 40
    assert (found.value > -0.2).all()
    assert (beside.value < -1.0).all()
    np.testing.assert_allclose(fly(found.attack[:, None])[:, 0], found.value)


@pytest.fixture(scope="module")
def field():
    return Field(hostile.ideal(mutate=hostile.bare, seed=4))


def test_no_attack_gets_over_the_limit(field):
    found = field.search(places(field.campaign, PLACES, False), POPULATION, GENERATIONS, seed=4)
    assert found.value.max() <= 0.0
    assert found.value.max() > -0.05
    assert found.history[-1].mean() > found.history[0].mean()


def test_no_attack_gets_beyond_the_end_of_the_authority(field):
    found = field.search(places(field.campaign, PLACES, True), POPULATION, GENERATIONS, seed=4)
    assert found.value.max() <= 0.0
    assert found.value.max() > -0.5


def test_the_optimiser_finds_a_guard_that_is_missing(field):
    def without_the_control_period(protection):
        rates = protection.rates._replace(reaction_s=np.float64(0.0))
        return hostile.bare(protection)._replace(rates=rates)

    campaign = hostile.ideal(mutate=without_the_control_period, seed=4)
    found = field.search(places(campaign, PLACES, False), POPULATION, GENERATIONS, seed=4)
    assert found.value.max() > 0.1


@pytest.mark.parametrize("disturbances", [MASS_AND_RESISTANCE, EVERY_DISTURBANCE], ids=["mass", "every"])
def test_no_attack_makes_a_convoy_touch(disturbances):
    convoys = Convoys(AttackCampaign(seed=4, disturbances=disturbances))
    found = convoys.search(np.arange(0, 24, 4), POPULATION, GENERATIONS, seed=4)
    assert found.value.max() < 0.0
    assert found.value.max() > -0.2

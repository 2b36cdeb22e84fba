"""Features behind a learned driver's decisions: shares that sum up, gradients that are JAX's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from metropilot.drivers import LearnedDriver
from metropilot.env import FEATURE_WORDS, FEATURES
from metropilot.evaluate import RunSpec, attribute_decisions, explain_drive
from metropilot.policy import load_driving_policy, network_output, output_gradient, shipped_policy
from metropilot.sim import Disturbance, Rollout, TimetableUpdate, drive

SECTIONS = {
    "ppo": {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 105.0},
    "generalist": {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 105.0},
    "eitop": {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101.0},
    "stod": {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101.0},
    "ston": {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101.0},
    "ddpg_pid": {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 105.0},
    "improved_dqn": {"line": "lu2023", "origin": "WHY", "destination": "WYJ", "time_s": 130.0},
}
WORDS = {**FEATURE_WORDS, "speed_error": "speed error", "position_error": "position error"}
ASKED_UNTIL_S = {"eitop": 84.0, "stod": 84.0, "ston": 84.0, "ddpg_pid": 84.0}
"""Before this time a network inside other rules is still asked: the station stop has laws of its own."""
TIMES_S = np.arange(0.0, 100.0, 10.0)


@pytest.mark.parametrize("name", ["ppo", "generalist", "dqn", "improved_dqn"])
def test_the_gradient_is_that_of_jax(name):
    policy = load_driving_policy(shipped_policy(name)).policy.policy
    random = np.random.default_rng(0)
    seen = random.normal(0.3, 0.3, (5, policy.spec.observation_size))
    weights = random.normal(size=policy.spec.width)
    params = {key: jnp.asarray(value) for key, value in policy.params.items()}

    def output(observation):
        return jnp.asarray(weights) @ network_output(policy.spec, params, observation, jnp)

    wanted = jax.vmap(jax.grad(output))(jnp.asarray(seen, jnp.float32))
    found = output_gradient(policy, seen, weights)
    assert np.abs(found).max() > 1e-3
    assert found == pytest.approx(np.asarray(wanted), rel=1e-2, abs=1e-3 * np.abs(found).max())


@pytest.mark.parametrize("name", list(SECTIONS))
def test_the_shares_sum_up_to_the_decision(name):
    spec = RunSpec(**SECTIONS[name], driver=name)
    driven = drive(spec.run(), spec.make_driver())
    found = attribute_decisions(driven, spec.make_driver(), TIMES_S)
    asked = TIMES_S[ASKED_UNTIL_S.get(name, np.inf) > TIMES_S]
    assert asked.size <= len(found) <= TIMES_S.size
    spread = max(abs(moment.output - moment.usual) for moment in found)
    for moment, time_s in zip(found, TIMES_S, strict=False):
        assert time_s - moment.time_s >= -1e-6
        assert time_s - moment.time_s < 3.1 or time_s > asked[-1]
        sizes = [abs(share.share) for share in moment.shares]
        assert sizes == sorted(sizes, reverse=True)
        total = sum(share.share for share in moment.shares)
        assert total == pytest.approx(moment.output - moment.usual, abs=0.05 * spread)
        assert all(share.words == WORDS[share.feature] for share in moment.shares)


def test_power_at_departure_and_coasting_rest_on_other_features():
    spec = RunSpec(**SECTIONS["generalist"], driver="generalist")
    driven = drive(spec.run(), spec.make_driver())
    found = explain_drive(driven, None, driver=spec.make_driver()).decisions
    first, coasting = found[0], found[len(found) // 2]
    assert first.output > first.usual > coasting.output
    assert coasting.shares[0].share < 0.0
    assert "time to spare when coasting from here" in {share.words for share in coasting.shares[:2]}


def test_a_driver_without_such_a_policy_and_a_hand_have_none():
    told = {**SECTIONS["ppo"]}
    for name in ("pid", "itor"):
        spec = RunSpec(**told, driver=name)
        driven = drive(spec.run(), spec.make_driver())
        assert attribute_decisions(driven, spec.make_driver(), TIMES_S) == ()
    spec = RunSpec(**told, driver="ppo")
    rollout = Rollout(spec.run(), spec.make_driver())
    rollout.take(0.5)
    while rollout.outcome is None:
        rollout.advance()
    assert attribute_decisions(rollout.drive(), spec.make_driver(), TIMES_S) == ()


def test_a_run_with_noise_and_a_new_arrival_is_driven_again_alike():
    later = TimetableUpdate(20.0, scheduled_time_s=120.0)
    plant = Disturbance(mass_factor=1.1, speed_noise_mps=0.05, updates=(later,))
    spec = RunSpec(**SECTIONS["ppo"], driver="ppo", disturbance=plant, seed=3)
    found = attribute_decisions(drive(spec.run(), spec.make_driver()), spec.make_driver(), TIMES_S)
    assert len(found) == TIMES_S.size


def test_every_feature_has_words():
    assert set(FEATURE_WORDS) == set(FEATURES)
    assert len(set(FEATURE_WORDS.values())) == len(FEATURE_WORDS)


@pytest.mark.parametrize("name", list(SECTIONS))
def test_the_features_of_a_view_fill_the_observation(name):
    spec = RunSpec(**SECTIONS[name], driver=name)
    view = spec.make_driver().network_view(spec.run())
    assert sum(span.size for span in view.features) == view.policy.spec.observation_size
    assert 0 <= view.output < view.policy.spec.actions


def test_the_sizes_of_the_features_are_those_of_the_observation():
    loaded = load_driving_policy(shipped_policy("generalist"))
    sizes = LearnedDriver(loaded.policy, loaded.interface).feature_sizes(
        RunSpec(**SECTIONS["generalist"], driver="generalist").run()
    )
    assert sum(sizes.values()) == loaded.policy.policy.spec.observation_size
    assert tuple(sizes) == loaded.interface.features

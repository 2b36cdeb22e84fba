"""Configurations: what is refused, with which words, and that they come back as they went."""

import json

import pytest

from metropilot.errors import InputError
from metropilot.learn import CONFIGS, PPOConfig, Schedule, config_from_mapping, config_to_mapping


@pytest.mark.parametrize("algorithm", sorted(CONFIGS))
def test_defaults_survive_json(algorithm):
    config = CONFIGS[algorithm]()
    mapping = json.loads(json.dumps(config_to_mapping(config)))
    assert config_from_mapping(algorithm, mapping) == config


def test_schedules_and_tuples_are_read():
    config = config_from_mapping(
        "dqn", {"epsilon": {"start": 1, "end": 0.1, "over": 0.5}, "hidden": [128, 256]}
    )
    assert config.epsilon == Schedule(1.0, 0.1, over=0.5)
    assert config.hidden == (128, 256)


@pytest.mark.parametrize(
    ("algorithm", "values", "line"),
    [
        (
            "ppo",
            {"learning_rat": 1e-3},
            "learning_rat: unknown key, did you mean learning_rate? (allowed: st",
        ),
        (
            "pppo",
            {},
            "unknown algorithm: 'pppo' (allowed: ddpg, dqn, naf, ppo, sac, tabular, teacher)",
        ),
        ("ppo", {"steps": "many"}, "a whole number"),
        ("ppo", {"steps": 1.5}, "a whole number"),
        ("ppo", {"steps": True}, "a whole number"),
        ("ppo", {"gamma": float("nan")}, "a number"),
        ("ppo", {"gamma": 1.01}, "gamma: out of range: 1.01 (allowed: 0 to 1)"),
        ("ppo", {"reward_scaling": 1}, "true or false"),
        ("ppo", {"activation": "gelu"}, "one of tanh, relu, silu"),
        ("ppo", {"minibatches": 7}, "a divisor of environments x rollout = 8192"),
        ("ppo", {"hidden": [64, 0]}, "hidden: out of range: 0 (allowed: >= 1)"),
        ("ppo", {"learning_rate": {"start": 1.0}}, "a number or a table with start, end, over, shape"),
        ("ppo", {"clip": {"start": "0.2", "end": 0.0}}, "clip.start: not a number"),
        (
            "ppo",
            {"clip": {"start": 0.2, "end": 0.0}},
            "clip: schedule out of range, 0.2 to 0 (allowed: > 0 and <= 1)",
        ),
        ("ppo", {"initial_std": 0.01}, "initial_std: out of range: 0.01 (allowed: > 0.01)"),
        ("dqn", {"prioritised": True, "buffer_size": 2_000_000}, "1 to 1048576"),
        ("dqn", {"buffer_size": 1_001, "environments": 8}, "a multiple of environments = 8"),
        ("sac", {"tau": 0.0}, "tau: out of range: 0.0 (allowed: > 0 and <= 1)"),
        ("tabular", {"reward_scaling": True}, "a table does not need it"),
        ("tabular", {"low": [1.0], "high": [0.0]}, "empty grid"),
    ],
)
def test_what_cannot_be_used_is_named(algorithm, values, line):
    with pytest.raises(InputError) as error:
        config_from_mapping(algorithm, values, file="learn.toml")
    assert line in str(error.value)
    assert str(error.value).startswith("learn.toml: ")
    assert "\n" not in str(error.value)


def test_schedule_shapes():
    assert float(Schedule(1.0, 0.0, over=0.5).at(0.25)) == pytest.approx(0.5)
    assert float(Schedule(1.0, 0.0, over=0.5).at(0.9)) == 0.0
    assert float(Schedule(1.0, 0.01, shape="exponential").at(0.5)) == pytest.approx(0.1)
    assert float(Schedule(2.0, 0.0, shape="cosine").at(0.5)) == pytest.approx(1.0)
    with pytest.raises(InputError, match="stays above zero"):
        Schedule(1.0, 0.0, shape="exponential")


def test_configurations_are_frozen_and_hashable():
    assert hash(PPOConfig()) == hash(PPOConfig())
    with pytest.raises(AttributeError):
        PPOConfig().gamma = 0.5  # pyright: ignore[reportAttributeAccessIssue]

"""PettingZoo's own checker, seeds, and the same convoy as the task of following."""

from functools import lru_cache

import numpy as np
import pytest

pytest.importorskip("pettingzoo")

from pettingzoo.test import parallel_api_test

from metropilot.convoy.env import ConvoyTaskConfig
from metropilot.convoy.pettingzoo import ConvoyParallelEnv
from metropilot.errors import InputError

FIXED = np.array([1.0, 1.0, -1.0 / 3.0], np.float32)
"""Gains 5, 1.5 and 0.5: those of follow_pid."""


@lru_cache
def config(disturbed=0.0):
    return ConvoyTaskConfig(heads=1, dt=0.2, eta_speed=100.0, eta_gap=200.0, disturbed=disturbed)


def test_pettingzoo_accepts_it():
    env = ConvoyParallelEnv(config(0.5), 3)
    parallel_api_test(env, num_cycles=60)  # raises where a rule of PettingZoo's is broken
    assert len(env.possible_agents) == 2, "everyone but the head"
    assert all(env.observation_space(agent).shape == (6,) for agent in env.possible_agents)
    assert all(env.action_space(agent).shape == (3,) for agent in env.possible_agents)


def test_the_same_seed_gives_the_same_episode():
    env = ConvoyParallelEnv(config(1.0), 3)

    def ran(seed):
        env.reset(seed=seed)
        for _ in range(40):
            found = env.step(dict.fromkeys(env.agents, FIXED))
        return [found[4][agent]["gap_m"] for agent in env.possible_agents]

    assert ran(3) == ran(3) != ran(4)


def test_good_gains_hold_the_gap_and_no_gains_do_not():
    env = ConvoyParallelEnv(config(), 2)

    def ran(action):
        env.reset(seed=0)
        total, worst = 0.0, 0.0
        while env.agents:
            observations, rewards, contact, over, infos = env.step(dict.fromkeys(env.agents, action))
            info = infos["trainset_2"]
            assert rewards["trainset_2"] == pytest.approx(sum(info["terms"].values()))
            total, worst = total + rewards["trainset_2"], max(worst, abs(info["gap_m"] - 5.92))
        assert observations["trainset_2"].shape == (6,)
        return total, worst, contact["trainset_2"], over["trainset_2"]

    total, worst, contact, over = ran(FIXED)
    assert worst < 0.5
    assert (contact, over) == (False, True)
    idle, far, *_ = ran(np.full(3, -1.0, np.float32))
    assert far > 100.0
    assert idle < 0.5 * total


@pytest.mark.parametrize("count", [1, 0, 2.5, 17])
def test_a_number_of_trainsets_that_is_no_convoy_is_refused(count):
    env = object.__new__(ConvoyParallelEnv)
    with pytest.raises(InputError, match=r"^count: "):
        ConvoyParallelEnv.__init__.__wrapped__(env, config(), count)  # the tests' own check of types left out


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("heads", 0),
        ("heads", 1.5),
        ("trainsets", ()),
        ("trainsets", "cheng2023"),
        ("loss", 5.0),
        ("eta_speed", -1.0),
        ("gap_m", -1.0),
        ("dt", 0.0),
        ("on_the_way", float("nan")),
        ("seed", -1),
    ],
)
def test_a_configuration_names_what_a_field_cannot_have(field, value):
    made = object.__new__(ConvoyTaskConfig)
    with pytest.raises(InputError, match=f"^{field}: "):
        ConvoyTaskConfig.__init__.__wrapped__(
            made, **{field: value}
        )  # the tests' own check of types left out


def test_actions_and_seeds_that_cannot_be_taken_are_named():
    env = ConvoyParallelEnv(config(), 3)
    with pytest.raises(InputError, match=r"^seed: "):
        env.reset(seed=-1)
    env.reset(seed=0)
    for wrong in (np.zeros(7), np.full(3, np.nan), np.array(["1", "1", "1"])):
        with pytest.raises(InputError, match=r"^trainset_3: "):
            env.step({"trainset_2": FIXED, "trainset_3": wrong})
    with pytest.raises(InputError, match=r"^trainset_3: an agent without an action"):
        env.step({"trainset_2": FIXED})
    assert env.period == 0
    beyond = env.step(dict.fromkeys(env.agents, np.full(3, 9.0)))[4]
    env.reset(seed=0)
    assert beyond == env.step(dict.fromkeys(env.agents, np.ones(3)))[4], "clipped"

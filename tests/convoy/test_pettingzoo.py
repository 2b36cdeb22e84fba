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


def test_a_convoy_of_one_is_refused():
    with pytest.raises(InputError):
        ConvoyParallelEnv(config(), 1)

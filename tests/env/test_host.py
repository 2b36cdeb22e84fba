"""The same decisions through the compiled task and through the host loop give the same drive."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.scripted import Scripted

from metropilot.drivers import LearnedDriver
from metropilot.env import (
    Assists,
    DrivingConfig,
    DrivingTask,
    PolicyInterface,
    episode_of,
    starts,
    task_config,
)
from metropilot.env.actions import CommandAction
from metropilot.railway import load_line, load_trainset
from metropilot.sim import CODES, Disturbance, Run, drive

STEPS = 500


def config_of(ideal, **fields):
    section = load_line("yizhuang").section("RJ", "WYJ")
    return DrivingConfig((section,), (load_trainset("dkz32", "AW2"),), ideal=ideal, spacing_m=1.0, **fields)


def episode(task, act, time_s):
    """All states of one episode from standstill, and its KPIs; `act(observation, k)` decides."""
    start = jax.tree.map(lambda a: a[0], starts([0], [time_s]))

    def one(carry, k):
        state, seen, over = carry
        after, transition = task.step(jax.random.key(0), state, act(seen, k))
        after = jax.tree.map(lambda new, old: jnp.where(over, old, new), after, state)
        seen = jnp.where(over, seen, transition.observation)
        kept = (after.plant.time_s, after.plant.position_m, after.plant.speed_mps, after.plant.traction_j)
        return (after, seen, over | transition.terminated), kept

    @jax.jit
    def run(start):
        first = (*task.begin(start), jnp.zeros((), bool))
        (state, _, over), rows = jax.lax.scan(one, first, jnp.arange(STEPS))
        return episode_of(task, state), over, rows

    kpis, over, rows = run(start)
    assert bool(over)
    return np.stack(rows, axis=1), jax.tree.map(np.asarray, kpis)


def compare(rows, kpis, drive):
    trajectory = drive.trajectory
    count = trajectory.time_s.size - 1
    np.testing.assert_allclose(rows[:count, 0], trajectory.time_s[1:], atol=2e-3)
    np.testing.assert_allclose(rows[:count, 1], trajectory.position_m[1:], atol=0.02)
    np.testing.assert_allclose(rows[:count, 2], trajectory.speed_mps[1:], atol=2e-3)
    np.testing.assert_allclose(rows[:count, 3], trajectory.energy_wheel_j[1:], rtol=1e-4, atol=100.0)
    assert kpis.interventions == drive.interventions
    assert abs(kpis.running_time_s - drive.running_time_s) < 2e-3


@pytest.mark.parametrize("ideal", [True, False])
def test_same_commands(ideal):
    dt = 0.5
    # Full traction long enough to be overruled, then coast, then brake to a stand somewhere past the stop.
    commands = np.concatenate([np.full(60, 1.0), np.zeros(90), np.full(STEPS, -0.6)]).astype(np.float32)
    task = DrivingTask(config_of(ideal, dt=dt, action=CommandAction(), assists=Assists(False, False)))
    rows, kpis = episode(task, lambda _, k: jnp.asarray(commands)[k][None], 110.0)
    config = task.config
    run = Run(config.sections[0], config.trainsets[0], 110.0, Disturbance(ideal=ideal), dt)
    done = drive(run, Scripted(commands))
    assert done.interventions > 0
    compare(rows, kpis, done)


@pytest.mark.parametrize("observer", ["section", "route"])
def test_same_policy(observer):
    task = DrivingTask(config_of(True, observer=observer))
    weights = np.random.default_rng(0).normal(size=task.observation_size).astype(np.float32)
    weights *= 0.1

    def policy(observation):
        return np.tanh(observation @ weights + 0.8)[None]

    rows, kpis = episode(task, lambda o, _: jnp.tanh(o @ weights + 0.8)[None], 110.0)
    config = task.config
    run = Run(config.sections[0], config.trainsets[0], 110.0, Disturbance(ideal=True), config.dt)
    done = drive(run, LearnedDriver(policy, config.interface))
    assert done.outcome is CODES[int(kpis.outcome)]
    compare(rows, kpis, done)


def test_decisions_are_held_over_shorter_periods():
    config = task_config("drive")
    seen = []

    def policy(observation):
        seen.append(observation)
        return np.ones(1, np.float32)

    run = Run(config.sections[0], config.trainsets[0], 110.0, Disturbance(ideal=True), 0.2)
    done = drive(run, LearnedDriver(policy, config.interface))
    assert done.outcome.value == "arrived"
    assert done.interventions == 0
    assert abs(len(seen) - done.running_time_s / config.interface.period_s) < 2


@pytest.mark.parametrize("name", ["drive", "drive_notches", "drive_increment"])
def test_perception_survives_as_plain_values(name):
    interface = task_config(name).interface
    assert PolicyInterface.from_dict(interface.as_dict()) == interface
    with pytest.raises(Exception, match="feature"):
        PolicyInterface.from_dict(interface.as_dict() | {"features": ["colour"]})
    assert replace(interface, period_s=1.0) != interface


@pytest.mark.parametrize("release", [0.5, 0.95])
@pytest.mark.parametrize("ends", [("YZHC", "CQ"), ("XC", "XHM")])
def test_a_late_stop_is_at_the_point_however_the_brake_is_let_go(release, ends):
    """Full effort all the way, downhill and level: the stop assist alone brakes."""
    section, trainset = load_line("yizhuang").section(*ends), load_trainset("dkz32", "AW0")
    assists = Assists(margin_mps=0.05, stop_use=0.99, release=release, late=True)
    config = config_of(False, action=CommandAction(), assists=assists)
    done = drive(
        Run(section, trainset, 150.0),
        LearnedDriver(lambda _: np.ones(1, np.float32), config.interface),
    )
    assert done.outcome.value == "arrived"
    assert abs(float(done.trajectory.position_m[-1]) - section.length_m) < 0.03
    assert done.interventions == 0


def test_letting_the_brake_go_sooner_takes_longer():
    section, trainset = load_line("yizhuang").section("XC", "XHM"), load_trainset("dkz32", "AW0")

    def taken_s(release):
        assists = Assists(margin_mps=0.05, stop_use=0.99, release=release, late=True)
        config = config_of(False, action=CommandAction(), assists=assists)
        driver = LearnedDriver(lambda _: np.ones(1, np.float32), config.interface)
        return drive(Run(section, trainset, 150.0), driver).running_time_s

    assert 0.2 < taken_s(0.5) - taken_s(0.95) < 0.8

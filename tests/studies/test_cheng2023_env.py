"""The tracking loop and its learning task: Cheng23's equations, and the same run in every form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from metropilot.control import CHENG2023_UPPER, Errors, Gains, incremental_pid
from metropilot.drivers import Pid, PidOptions, TrackingView
from metropilot.sim import Run, drive
from metropilot.studies.cheng2023 import course as cheng2023_course
from metropilot.studies.cheng2023 import setting
from metropilot.studies.cheng2023.env import (
    TrackingConfig,
    TrackingFacts,
    TrackingRewards,
    TrackingTask,
    gains_of,
    reward_terms,
)
from metropilot.studies.cheng2023.tracking import (
    compile_course,
    track_compiled,
    track_course,
    tracking_kpis,
    tracking_observation,
)

GAINS = Gains(3.4, 0.3, 0.2)


@pytest.fixture(scope="module")
def course():
    return cheng2023_course()


def fixed(gains):
    def control(memory, seen):
        return incremental_pid(seen.command, gains, seen.error_mps, memory)

    return control


def test_rewards_are_cheng2023_eqs_17_to_22():
    facts = TrackingFacts(
        error_mps=jnp.float32(0.25),
        distance_m=jnp.float32(-1.0),
        to_target_m=jnp.float32(-0.1),
        jerk_mps3=jnp.float32(3.0),
        work_j=jnp.float32(1.8e6),
        unsafe=jnp.bool_(False),
        over=jnp.bool_(True),
    )
    terms = reward_terms(TrackingRewards(centred=False), facts)
    assert terms["tracking"] == pytest.approx(0.2 * (1 / 1.25 + 1 / 2))
    assert terms["parking"] == pytest.approx(0.2 / 1.1)
    assert terms["comfort"] == pytest.approx(0.2 / 4)
    assert terms["efficiency"] == pytest.approx(-0.2 * 0.5)
    assert terms["safety"] == 0.0
    missed = facts._replace(to_target_m=jnp.float32(2.0), unsafe=jnp.bool_(True))
    terms = reward_terms(TrackingRewards(), missed)
    assert terms["parking"] == pytest.approx(-0.4)
    assert terms["safety"] == pytest.approx(-20.0)
    assert terms["tracking"] == pytest.approx(0.2 * (1 / 1.25 + 1 / 2 - 2))
    under_way = reward_terms(TrackingRewards(), facts._replace(over=jnp.bool_(False)))
    assert under_way["parking"] == 0.0


def test_gains_span_zero_to_their_upper_limits():
    assert gains_of(np.array([-1.0, 0.0, 1.0])) == pytest.approx((0.0, 0.75, 1.5))
    assert gains_of(np.array([1.0, 1.0, 1.0])) == pytest.approx(CHENG2023_UPPER)


def test_constant_gains_fix_the_sum_of_the_errors(course):
    # Eq. 15 telescopes while nothing is clipped: u = kp e + ki sum(e) + kd (e - e1).
    record = track_course(course, fixed(GAINS), Errors(0.0, 0.0))
    free = int(np.argmax(np.abs(record.command) >= 1.0))
    assert free > 60
    error = record.error_mps
    before = np.concatenate([[0.0], error[:-1]])
    expected = 3.4 * error + 0.3 * np.cumsum(error) + 0.2 * (error - before)
    np.testing.assert_allclose(record.command[:free], expected[:free], atol=1e-9)


def test_the_task_the_scan_and_the_host_drive_the_same_run(course):
    record = track_course(course, fixed(GAINS), Errors(0.0, 0.0))
    kpis = tracking_kpis(course, record)
    single = compile_course(course)
    start = Errors(jnp.float32(0.0), jnp.float32(0.0))
    again = jax.jit(lambda: tracking_kpis(single, track_compiled(single, fixed(GAINS), start), jnp))()
    assert again.speed_total_mps == pytest.approx(kpis.speed_total_mps, rel=1e-3)
    assert again.parking_m == pytest.approx(kpis.parking_m, abs=0.02)

    time_s = setting.reference_of("s_curve").duration_s
    done = drive(Run(setting.section(), setting.trainset(), time_s), Pid(PidOptions(station_stop=False)))
    speeds = done.trajectory.speed_mps[: int(course.end) - 5]
    np.testing.assert_allclose(speeds, record.speed_mps[: speeds.size], atol=1e-4)

    task = TrackingTask(TrackingConfig((course,)))
    action = jnp.asarray([2 * g / u - 1 for g, u in zip(GAINS, CHENG2023_UPPER, strict=True)], jnp.float32)

    def one(state, _):
        state, transition = task.step(jax.random.key(0), state, action)
        return state, (state.loop.plant.speed_mps, transition.terminated)

    _, (found, over) = jax.lax.scan(one, task.begin(jnp.int32(0))[0], None, length=course.periods)
    np.testing.assert_allclose(found[:-1], record.speed_mps[1:], atol=2e-3)
    assert not over[: int(course.end) - 1].any()
    assert over[-1]


def test_a_task_is_deterministic_finite_and_one_program(course):
    task = TrackingTask(TrackingConfig((course, course._replace(dt=course.dt)), on_the_way=0.5))
    assert task.observation_size == 4
    assert task.action_space.size == 3
    step, keys = jax.jit(jax.vmap(task.step)), jax.random.split(jax.random.key(0), 64)
    state, observation = jax.jit(jax.vmap(task.reset))(keys)
    assert observation.shape == (64, 4)
    assert np.abs(np.asarray(observation)).max() <= 5.0
    began = np.asarray(state.loop.period)
    assert 16 < (began > 0).sum() < 48
    for k in range(3):
        action = jax.random.uniform(jax.random.key(k), (64, 3), jnp.float32, -1.0, 1.0)
        state, transition = step(keys, state, action)
        assert np.isfinite(transition.reward).all()
        np.testing.assert_allclose(transition.reward, sum(transition.terms.values()), rtol=1e-6)
    assert step._cache_size() == 1


def test_too_fast_ends_the_episode(course):
    task = TrackingTask(TrackingConfig((course,), limit_mps=5.0, on_the_way=0.0))
    state, _ = task.begin(jnp.int32(0))

    def one(state, _):
        state, transition = task.step(jax.random.key(0), state, jnp.zeros(3))
        return state, (transition.terminated, transition.terms["safety"])

    _, (over, safety) = jax.lax.scan(one, state, None, length=100)
    assert over.any()
    assert safety[int(np.argmax(over))] == pytest.approx(-20.0)


def test_observation_is_clipped_and_scaled():
    found = tracking_observation(TrackingView(0.01, -9.0, 10.0, 10.01, 0.5))
    np.testing.assert_allclose(found, [0.5, 0.5, 0.2, -5.0], rtol=1e-6)
    assert found.dtype == np.float32

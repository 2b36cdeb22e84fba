"""The tracking loop and its learning task: Cheng23's equations, and the same run in every form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from metropilot.control import CHENG2023_UPPER, Errors, Gains, incremental_pid
from metropilot.drivers import Pid, PidOptions, TrackingView
from metropilot.policy import load_policy
from metropilot.sim import Run, drive
from metropilot.studies.cheng2023 import course as cheng2023_course
from metropilot.studies.cheng2023 import setting
from metropilot.studies.cheng2023.drives import (
    TUNED_FED_PID,
    fed_pid_control,
    policy_control,
    position_pid_control,
)
from metropilot.studies.cheng2023.env import (
    TrackingConfig,
    TrackingFacts,
    TrackingRewards,
    TrackingTask,
    reward_terms,
)
from metropilot.studies.cheng2023.law import gains_of
from metropilot.studies.cheng2023.residual import CORRECTIONS, placed_gains, residual_law, step_fed_pid
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


def keep_gains(gains):
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
    record = track_course(course, keep_gains(GAINS), Errors(0.0, 0.0))
    free = int(np.argmax(np.abs(record.command) >= 1.0))
    assert free > 60
    error = record.error_mps
    before = np.concatenate([[0.0], error[:-1]])
    expected = 3.4 * error + 0.3 * np.cumsum(error) + 0.2 * (error - before)
    np.testing.assert_allclose(record.command[:free], expected[:free], atol=1e-9)


def test_the_task_the_scan_and_the_host_drive_the_same_run(course):
    record = track_course(course, keep_gains(GAINS), Errors(0.0, 0.0))
    kpis = tracking_kpis(course, record)
    single = compile_course(course)
    start = Errors(jnp.float32(0.0), jnp.float32(0.0))
    again = jax.jit(lambda: tracking_kpis(single, track_compiled(single, keep_gains(GAINS), start), jnp))()
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


def test_the_window_of_the_jerk_is_two_seconds_at_any_period(course):
    record = track_course(course, keep_gains(GAINS), Errors(0.0, 0.0))
    ramp = record._replace(acceleration_mps2=0.01 * np.arange(record.acceleration_mps2.size))
    assert tracking_kpis(course, ramp).jerk_mps3 == pytest.approx(0.01 * 10 / 2.0)
    finer = course._replace(dt=np.float64(0.1))
    assert tracking_kpis(finer, ramp).jerk_mps3 == pytest.approx(0.01 * 20 / 2.0)
    assert tracking_kpis(finer, ramp, dt=0.4).jerk_mps3 == pytest.approx(0.01 * 5 / 2.0)


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


FED = placed_gains(TUNED_FED_PID)
CORRECTED = residual_law(FED)


def correct_by(action):
    return policy_control(CORRECTED, lambda _: np.asarray(action, np.float32))


def test_no_correction_is_the_tuned_pid_beside_feed_forward(course):
    plain = track_course(course, *fed_pid_control(FED))
    nothing = track_course(course, *correct_by(np.zeros(5)))
    np.testing.assert_array_equal(nothing.command, plain.command)
    something = track_course(course, *correct_by([0.0, 0.0, 0.0, 0.0, 1.0]))
    assert not np.array_equal(something.command, plain.command)


def test_feed_forward_leaves_the_nominal_plant_nothing_to_correct(course):
    done = tracking_kpis(course, track_course(course, *fed_pid_control(FED)))
    placed = tracking_kpis(course, track_course(course, *position_pid_control(FED.gains, FED.position_per_s)))
    assert done.speed_max_mps < 0.1 * placed.speed_max_mps
    assert done.jerk_mps3 < placed.jerk_mps3


@pytest.mark.parametrize(("error_mps", "command"), [(0.02, 0.3), (-0.5, 0.3), (0.001, 1.0), (0.001, -1.0)])
def test_far_from_the_reference_and_at_full_effort_nothing_is_correct_by(error_mps, command):
    seen, errors = TrackingView(error_mps, 0.01, 10.0, 10.0, command, 0.0), Errors(0.0, 0.0)
    worst = CORRECTED.step(np.ones(5, np.float32), seen, errors)
    assert worst == step_fed_pid(FED, seen, errors)
    near = TrackingView(0.001, 0.01, 10.0, 10.0, 0.3, 0.0)
    assert CORRECTED.step(np.ones(5, np.float32), near, errors) != step_fed_pid(FED, near, errors)


def test_the_task_corrects_as_the_controller_does_and_noise_reaches_the_law_alone(course):
    action = np.array([0.5, -0.5, 0.2, 0.3, 0.4], np.float32)
    record = track_course(course, *correct_by(action))
    task = TrackingTask(TrackingConfig((course,), CORRECTED, noise_mps=0.01))

    def one(state, key):
        state, transition = task.step(key, state, jnp.asarray(action))
        return state, (state.loop.plant.speed_mps, state.off_mps, transition.observation)

    keys = jax.random.split(jax.random.key(0), course.periods)
    state, first = task.begin(jnp.int32(0))
    assert first.shape == (task.observation_size,) == (6,)
    _, (quiet, off, _) = jax.lax.scan(one, state, keys)
    np.testing.assert_allclose(quiet[:-1], record.speed_mps[1:], atol=2e-3)
    assert not off.any()
    _, (noisy, off, _) = jax.lax.scan(one, state._replace(noise_mps=jnp.float32(0.01)), keys)
    assert float(jnp.std(off)) == pytest.approx(0.01, rel=0.2)
    assert 1e-4 < float(jnp.abs(noisy - quiet).max()) < 0.2


def test_drawn_courses_are_none_of_the_studys_and_the_same_for_a_seed():
    first, again = setting.draw_courses(3, seed=1), setting.draw_courses(3, seed=1)
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.speed_mps, other.speed_mps)
    assert len({float(one.vehicle.davis_n[0]) for one in first}) == 3
    tops = {round(float(one.speed_mps.max()), 3) for one in first}
    assert not tops & {round(float(setting.course(scenario=k).speed_mps.max()), 3) for k in setting.SCENARIOS}


def test_the_kept_corrections_say_where_they_come_from():
    _, about = load_policy(CORRECTIONS)
    assert about["task"]["corrects"] == dict(TUNED_FED_PID)
    assert about["kpis"]["speed_total_mps"] < 0.1
    assert {"command", "commit", "date", "machine"} <= set(about["provenance"])

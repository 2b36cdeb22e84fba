"""The generalist's course: lessons, the lean closed loop beside the real task, going on after a stop."""

import json
from dataclasses import replace
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from metropilot.env import (
    DrivingTask,
    FeatureContext,
    RegimeAction,
    SectionRows,
    domain_sample,
    episode_of,
    starts,
    task_config,
)
from metropilot.errors import InputError
from metropilot.learn import TrainingOptions, config_from_mapping
from metropilot.learn.imitation.closed_loop import WORTH, Begin, ClosedLoop, _Moving, within_worth
from metropilot.learn.imitation.demonstrations import (
    DemonstrationGenerator,
    DemonstrationSet,
    collect_demonstrations,
    collect_shard,
    load_demonstrations,
)
from metropilot.learn.imitation.train_state import (
    apply_gradient,
    hide_features,
    imitation_spec,
    labels,
    new_train_state,
)
from metropilot.learn.imitation.training import train_in_parts
from metropilot.physics import at_rest, to_jax, vehicle_arrays
from metropilot.policy import act
from metropilot.railway import load_trainset
from metropilot.sim import first_state


def test_a_world_is_the_same_whenever_it_is_asked_for():
    first, again, other = domain_sample(3, 5), domain_sample(3, 5), domain_sample(3, 6)
    assert first.section.length_m == again.section.length_m != other.section.length_m
    assert first.trainset.mass_kg == again.trainset.mass_kg != other.trainset.mass_kg


def test_worlds_keep_their_declared_ranges():
    for number in range(60):
        world = domain_sample(1, number)
        assert 500.0 <= world.section.length_m <= 8000.0
        assert (
            30.0 / 3.6
            <= world.section.limit_mps.value.min()
            <= world.section.limit_mps.value.max()
            <= 121 / 3.6
        )
        assert abs(world.section.gradient_permil.value).max() <= 40.0
        assert 80e3 <= world.trainset.mass_kg <= 500e3


def test_wide_worlds_reach_the_ranges_of_real_trainsets():
    wide = [domain_sample(1, number, 1.0) for number in range(300)]
    lengths = np.array([world.section.length_m for world in wide])
    assert 200.0 <= lengths.min() < 260.0
    assert 14e3 < lengths.max() <= 20e3
    masses = np.array([world.trainset.mass_kg for world in wide])
    assert 80e3 <= masses.min() < 100e3
    assert 450e3 < masses.max() <= 600e3
    starts = np.array([float(w.trainset.traction.at(0.0)) / w.trainset.effective_mass_kg for w in wide])
    assert 0.39 < starts.min() < 0.5
    assert 1.2 < starts.max() < 1.41
    steepest = np.array([abs(world.section.gradient_permil.value).max() for world in wide])
    assert (steepest * 9.81e-3 <= 0.5 * starts + 1e-9).all()
    assert 35.0 < steepest.max() <= 40.0
    fastest = np.array([world.trainset.max_speed_mps for world in wide]) * 3.6
    assert fastest.min() == pytest.approx(60.0)
    assert fastest.max() == pytest.approx(160.0)
    for world in wide:
        limits = world.section.limit_mps.value * 3.6
        assert 14.9 < limits.min() <= limits.max() < max(world.trainset.max_speed_mps * 3.6, 60.0) + 0.51
    slowest = np.array([world.section.limit_mps.value.min() for world in wide]) * 3.6
    assert (slowest < 25.0).mean() > 0.1
    late = np.array([(w.trainset.actuation.delay_s, w.trainset.actuation.lag_s) for w in wide])
    assert late.min(axis=0).tolist() == [0.0, 0.0]
    assert (late.max(axis=0) > (0.95, 0.57)).all()
    assert (late.max(axis=0) <= (1.0, 0.6)).all()
    for bound in ("max_acceleration_mps2", "max_deceleration_mps2"):
        assert 0.3 < np.mean([np.isfinite(getattr(w.trainset, bound)) for w in wide]) < 0.7
    assert 0.3 < np.mean([np.isfinite(w.trainset.actuation.jerk_limit_mps3) for w in wide]) < 0.7
    electric = np.array([float(w.trainset.electric_brake.at(1.0)) > 0.0 for w in wide])
    friction = np.array([w.trainset.friction_brake_n > 0.0 for w in wide])
    assert {(True, True), (True, False), (False, True)} == set(zip(electric, friction, strict=True))


def test_a_share_of_wide_worlds_leaves_the_others_as_they_are():
    plain = [domain_sample(4, number) for number in range(100)]
    mixed = [domain_sample(4, number, 0.4) for number in range(100)]
    same = np.array([a.trainset.mass_kg == b.trainset.mass_kg for a, b in zip(plain, mixed, strict=True)])
    assert 0.45 < same.mean() < 0.75
    for k in np.flatnonzero(same):
        assert plain[k].section.length_m == mixed[k].section.length_m
        assert (plain[k].section.limit_mps.value == mixed[k].section.limit_mps.value).all()
    for sample in mixed[:10]:
        with pytest.raises(InputError):  # no campaign can name what was learned from
            load_trainset(sample.trainset.id)


def test_an_ordinary_world_keeps_its_numbers():
    """Draw the worlds that the shipped policy learned from, the same from a seed ever since."""
    world = domain_sample(0, 0)
    assert world.section.length_m == pytest.approx(1056.3931524279415, rel=1e-12)
    assert world.trainset.mass_kg == pytest.approx(121305.41179683615, rel=1e-12)
    assert float(world.section.limit_mps.value.sum()) == pytest.approx(63.611111111111114, rel=1e-12)


def test_lessons_command_what_the_plan_does():
    room = DemonstrationGenerator(domain_sample(1, 2), 1.3)
    plan = room.plan(room.scheduled_s)
    middle = 0.5 * (plan.position_m[1:] + plan.position_m[:-1])
    commands = room.commands(plan, middle)
    mass = float(room.case.vehicle.effective_mass_kg)
    effort = (plan.traction_n - plan.brake_n) / mass
    flat_out = plan.speed_mps[1:] < 5.0
    assert commands[flat_out & (middle < 200.0)].min() > 0.95
    coasts = np.convolve(np.abs(effort) < 1e-3, np.ones(3), "same") == 3
    assert coasts.any()
    assert np.abs(commands[coasts]).max() < 0.1  # ten metres ahead it may brake already
    brakes = (effort < -0.1) & (np.append(effort[1:], 0.0) < -0.1) & (middle < room.length_m - 12.0)
    assert brakes.any()
    assert commands[brakes].max() < 0.0


def test_labels_mean_the_commands_they_stand_for():
    action = RegimeAction()
    commands = np.linspace(-1.0, 1.0, 401)
    wanted = labels(action, commands)
    context = FeatureContext(
        SimpleNamespace(xp=np, namespace=lambda _: np), *[None] * (len(FeatureContext._fields) - 1)
    )
    meant = np.array([action.command(context, np.array([a]), 0.4) for a in wanted])
    held = (np.abs(commands) > 0.02) & (np.abs(commands) < 0.95)
    assert np.abs(meant - commands)[held].max() < 1e-6
    assert np.abs(meant - commands).max() < 0.05
    assert (np.diff(wanted) >= 0.0).all()


def test_what_flows_back_is_kept_within_its_worth():
    plant = to_jax(at_rest(vehicle_arrays(load_trainset("dkz32"), np.float32)))
    state = _Moving(first_state(plant, None), *(jnp.float32(1.0) for _ in range(2)), jnp.bool_(False))
    joule = jnp.float32(0.01)

    def loss(values, scale):
        given = state._replace(energy_j=values["energy_j"], arrival_s=values["arrival_s"])
        rest = {name: values[name] for name in plant._fields if name in values}
        given = given._replace(run=given.run._replace(plant=plant._replace(**rest)))
        kept = within_worth(given, joule)
        parts = kept._asdict() | kept.run.plant._asdict()
        return sum(scale * parts[name].sum() for name in values)

    names = ("time_s", "position_m", "speed_mps", "acceleration_mps2", "energy_j", "arrival_s", "line_j")
    values = dict.fromkeys(names, jnp.float32(1.0))
    small, large = jax.grad(loss)(values, 1e-4), jax.grad(loss)(values, 1e6)
    for name in names[:-1]:
        assert float(small[name]) == pytest.approx(1e-4)
        assert float(large[name]) == pytest.approx(WORTH[name] * 0.01)
    assert float(large["line_j"]) == 0.0, "an account that no later period depends on"


@pytest.fixture(scope="module")
def few_worlds():
    """The task that judges, with four of its worlds: two with a jerk limit, two without.

    Traction is not limited to what is needed, as in the loop.
    """
    config = task_config("worlds")
    jerky = [np.isfinite(t.actuation.jerk_limit_mps3) for t in config.trainsets]
    short = [s.length_m < 2200.0 for s in config.sections]
    rows = [k for k in range(len(jerky)) if short[k]]
    rows = [k for k in rows if jerky[k]][:2] + [k for k in rows if not jerky[k]][:2]
    assert len(rows) == 4
    picked = {name: tuple(getattr(config, name)[k] for k in rows) for name in ("sections", "trainsets")}
    return replace(config, action=RegimeAction(), **picked)


def test_the_lean_loop_costs_what_the_real_task_costs(few_worlds):
    """The same simple policy through both: energy, arrival time."""
    task = DrivingTask(few_worlds)
    rows = SectionRows(few_worlds.tables(), jax=True)
    period_s = few_worlds.dt * few_worlds.periods
    loop = ClosedLoop(rows, few_worlds.features, few_worlds.action, few_worlds.assists, period_s)
    cruise = few_worlds.features.index("speed")  # it comes first: one number, speed / 20

    def decide(params, observation):
        return jnp.clip(jnp.stack([0.2 + params["gain"] * (0.5 - observation[cruise])]), -1.0, 1.0)

    minimum = np.asarray(rows.tables.minimum_s)
    count = minimum.size
    scheduled = jnp.asarray(1.2 * minimum, jnp.float32)
    zero, one = jnp.zeros(count), jnp.ones(count)
    case = jnp.arange(count, dtype=jnp.int32)
    begin = Begin(case, zero, zero, zero, scheduled, scheduled, one, one, one, one)
    gain = {"gain": jnp.float32(2.0)}
    lean = jax.jit(jax.vmap(lambda b: loop.drive(decide, gain, b, 900, jnp.float32(1.0))))(begin)
    assert bool(lean.done.all())

    def real(start):
        state, seen = task.begin(start)

        def go(carry):
            state, seen, _, k = carry
            after, found = task.step(jax.random.key(0), state, decide(gain, seen))
            return after, found.observation, found.terminated, k + 1

        last = jax.lax.while_loop(lambda c: ~c[2] & (c[3] < 900), go, (state, seen, jnp.bool_(False), 0))
        return episode_of(task, last[0])

    drives = jax.jit(jax.vmap(real))(starts(case.tolist(), scheduled.tolist()))
    mass = np.asarray([t.effective_mass_kg for t in few_worlds.trainsets])
    np.testing.assert_allclose(lean.energy_j * mass, drives.wheel_j, rtol=0.01)
    np.testing.assert_allclose(lean.late_s + scheduled, drives.running_time_s, atol=0.8)
    assert int(drives.interventions.sum()) == 0
    assert float(np.abs(drives.stop_error_m).max()) < 0.3


def test_the_gradient_of_a_drive_says_what_a_change_costs(few_worlds):
    """A policy that drives up to the ceiling and slows down early: its gradient against differences."""
    rows = SectionRows(few_worlds.tables(), jax=True)
    period_s = few_worlds.dt * few_worlds.periods
    loop = ClosedLoop(rows, few_worlds.features, few_worlds.action, few_worlds.assists, period_s)
    first = few_worlds.features.index("speed")

    def decide(params, observation):
        wanted = params["speed"] * jnp.tanh(params["early"] * observation[first + 1])
        return jnp.clip(jnp.stack([0.2 + 2.0 * (wanted - observation[first])]), -1.0, 1.0)

    minimum = np.asarray(rows.tables.minimum_s)
    case = jnp.arange(minimum.size, dtype=jnp.int32)
    zero, one = jnp.zeros(minimum.size), jnp.ones(minimum.size)
    scheduled = jnp.asarray(1.2 * minimum, jnp.float32)
    begin = Begin(case, zero, zero, zero, scheduled, scheduled, 300.0 * one, one, one, one)

    def cost(params):
        drive = jax.vmap(lambda b: loop.drive(decide, params, b, 600, jnp.float32(1.0 / 300.0)))(begin)
        return jnp.mean(drive.energy_j / 300.0 + 0.02 * drive.late_s)

    params, evaluate = {"speed": jnp.float32(0.95), "early": jnp.float32(8.0)}, jax.jit(cost)
    more, less = (float(evaluate(params | {"speed": params["speed"] + step})) for step in (0.02, -0.02))
    slope = jax.jit(jax.grad(cost))(params)["speed"]
    assert float(slope) == pytest.approx((more - less) / 0.04, rel=0.1)


def test_lessons_are_gathered_once_and_read_again(tmp_path):
    gathering = DemonstrationSet(7, 2, 2, 5, tmp_path)
    collect_shard(gathering, 0)
    lessons, numbers = load_demonstrations(gathering)
    again = collect_demonstrations(domain_sample(7, 0), np.random.default_rng([7, 1 << 32]), 2, 5)
    mine = lessons.observations[: again.observations.shape[0]]
    assert (mine == again.observations).all()
    assert set(numbers) <= {0, 1}
    assert lessons.begins.shape == (numbers.size, 7)
    gathering.path(0).write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(InputError, match="demonstrations are missing or damaged"):
        load_demonstrations(gathering)


def test_a_gradient_that_is_not_finite_changes_nothing():
    config = config_from_mapping("teacher", {"hidden": [4]})
    pupil = new_train_state(config, 0, np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32))
    slope = {name: jnp.full_like(value, jnp.nan) for name, value in pupil.params.items()}
    after = apply_gradient(pupil, slope, jnp.float32(1e-3), 0.5)
    assert all((after.params[name] == value).all() for name, value in pupil.params.items())
    seen = act(imitation_spec(config, 3), pupil.params, jnp.zeros(3))
    assert seen.shape == (1,)


def test_a_feature_that_is_hidden_changes_nothing():
    room = DemonstrationGenerator(domain_sample(1, 2), 1.3)
    names = room.column_names()
    seen = room.observe(np.array([10.0, 30.0]), np.array([80.0, 400.0]), np.array([9.0, 14.0]))
    assert len(names) == seen.shape[1]
    config = config_from_mapping("teacher", {"hidden": [4], "unseen": ["coasting", "speed"]})
    spec = imitation_spec(config, len(names))
    pupil = hide_features(new_train_state(config, 0, seen), [name in config.unseen for name in names])
    before = act(spec, pupil.params, jnp.asarray(seen[0]))
    for k, name in enumerate(names):
        other = seen[0].copy()
        other[k] += 1.0
        assert (act(spec, pupil.params, jnp.asarray(other)) == before).all() == (name in config.unseen), name


TINY = {
    "worlds": 4,
    "plans": 2,
    "states": 20,
    "batches": 400,
    "batch_size": 64,
    "hidden": [8],
    "decisions": 9600,
    "steps": 19200,
    "evaluations": 2,
}


class Enough(Exception):
    """Stops a course."""


def test_a_course_that_was_stopped_ends_the_same(few_worlds, tmp_path, monkeypatch):
    from metropilot.learn.imitation import closed_loop

    monkeypatch.setattr(closed_loop, "DECISIONS", (600,))  # one length, compiled once
    config, task = config_from_mapping("teacher", TINY), DrivingTask(few_worlds)

    def evaluate(params, key):
        del key
        return {"score": -jnp.abs(params["policy.0.bias"]).sum()}

    whole = train_in_parts(config, task, 1, TrainingOptions(evaluate))

    def stop(progress):
        if progress.chunk == 5:
            raise Enough

    path = tmp_path / "checkpoint.safetensors"
    with pytest.raises(Enough):
        train_in_parts(config, task, 1, TrainingOptions(evaluate, stop, path))
    assert list(tmp_path.glob("lessons/*.safetensors"))
    again = train_in_parts(config, task, 1, TrainingOptions(evaluate, None, path, resume=True))
    for name, value in whole.policy.params.items():
        assert (again.policy.params[name] == value).all(), name
        if value.ndim > 1:
            assert not (value.view(np.uint32) & 0xFFFF).any(), f"{name} takes more than two bytes a weight"
    assert again.history["steps"].tolist() == [0, 0, 0, 0, 9600, 19200]
    assert not list(tmp_path.glob("lessons/*"))
    other = replace(config, batch_size=32)
    with pytest.raises(InputError, match="batch_size"):
        train_in_parts(other, task, 1, TrainingOptions(evaluate, None, path, resume=True))


def test_the_teacher_knows_only_worlds():
    config = config_from_mapping("teacher", TINY)
    blind = replace(config, unseen=("colour",))
    with pytest.raises(InputError, match="unknown feature"):
        train_in_parts(blind, DrivingTask(task_config("worlds")), 0, TrainingOptions())
    with pytest.raises(InputError, match="demonstrations exist only for random sections"):
        train_in_parts(config, DrivingTask(task_config("drive")), 0, TrainingOptions())


def test_what_is_shipped_says_where_it_comes_from():
    from metropilot.policy import load_driving_policy, shipped_policy

    about = load_driving_policy(shipped_policy("generalist")).about
    assert about["task"]["name"] == "worlds"
    assert about["provenance"]["command"].startswith("metropilot learn generalist --budget paper")
    assert about["kpis"]["interventions"] == 0
    json.dumps(about)

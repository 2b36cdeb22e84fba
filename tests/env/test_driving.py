"""Promises of a task: stops, endings, disturbances, and tables that agree with the planner."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from metropilot.env import (
    DisturbanceDistribution,
    DrivingConfig,
    DrivingTask,
    episode_of,
    make_task,
    starts,
    task_config,
)
from metropilot.errors import InputError
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import (
    PlanOptions,
    fastest_time,
    minimum_running_time,
    optima_of,
    optimal_plan,
    tabulate_time_to_go,
)
from metropilot.railway import load_line, load_trainset
from metropilot.sim import CODES, RUNNING, Outcome, OutcomeRule


def drive_all(task, start, command, steps):
    """Drive every start under one constant action to its end; KPIs and flags of the last decision."""
    count = start.case.shape[0]
    action = jnp.full((count, 1), command)

    def one(carry, key):
        state, over, cut = carry
        after, transition = jax.vmap(task.step)(jax.random.split(key, count), state, action)
        done = over | cut
        keep = lambda old, new: jnp.where(done.reshape(done.shape + (1,) * (new.ndim - 1)), old, new)  # noqa: E731
        state = jax.tree.map(keep, state, after)
        return (state, over | (transition.terminated & ~done), cut | (transition.truncated & ~done)), None

    none = jnp.zeros(count, bool)
    keys = jax.random.split(jax.random.key(0), steps)

    @jax.jit
    def run(start):
        state, _ = jax.vmap(task.begin)(start)
        (state, over, cut), _ = jax.lax.scan(one, (state, none, none), keys)
        return jax.vmap(lambda s: episode_of(task, s))(state), over, cut

    return jax.tree.map(np.asarray, run(start))


def yizhuang():
    line = load_line("yizhuang")
    return (*line.sections(), *line.sections(backward=True))


@pytest.mark.parametrize(("ideal", "tolerance_m"), [(True, 0.01), (False, 0.3)])
def test_flat_out_with_assists_is_fast_never_overruled_and_stops_at_the_point(ideal, tolerance_m):
    trainset = load_trainset("dkz32")
    trainsets = (trainset.with_load("AW0"), trainset.with_load("AW3"))
    task = DrivingTask(DrivingConfig(yizhuang()[::6], trainsets, ideal=ideal))
    every = range(task.rows.count)
    kpis, over, _ = drive_all(task, starts(every, (task.minimum_s * 1.2).tolist()), 1.0, 450)
    assert over.all()
    assert (kpis.outcome == CODES.index(Outcome.ARRIVED)).all()
    assert (kpis.interventions == 0).all()
    assert (kpis.max_overspeed_mps == 0).all()
    assert np.abs(kpis.stop_error_m).max() <= tolerance_m
    slower = kpis.running_time_s / task.minimum_s - 1.0
    assert (slower > 0).all()
    assert slower.max() < (0.03 if ideal else 0.05)
    if not ideal:
        assert kpis.max_jerk_mps3.max() < 1.01


def test_without_assists_full_traction_is_overruled_and_overshoots():
    task = DrivingTask(task_config("drive_unassisted"))
    kpis, over, _ = drive_all(task, starts([0, 2], [110.0, 110.0]), 1.0, 250)
    assert over.all()
    assert (kpis.interventions > 0).all()
    assert (kpis.outcome == CODES.index(Outcome.OVERSHOT)).all()
    assert (kpis.max_overspeed_mps < 1e-3).all(), "protection keeps the limit"


def test_standing_still_is_terminated_and_the_end_of_counting_truncated(tasks):
    task = tasks("drive")
    kpis, over, cut = drive_all(task, starts([0], [110.0]), 0.0, 60)
    assert over.all()
    assert not cut.any()
    assert kpis.outcome[0] == CODES.index(Outcome.STALLED)
    short = DrivingTask(replace(task.config, most_decisions=30))
    kpis, over, cut = drive_all(short, starts([0], [110.0]), 1.0, 60)
    assert cut.all()
    assert not over.any()
    assert kpis.decisions[0] == 30
    assert kpis.outcome[0] == RUNNING


def test_out_of_time():
    config = task_config("drive")
    rule = OutcomeRule(late_ratio=0.5, late_s=0.0)
    task = DrivingTask(replace(config, outcomes=rule))
    kpis, over, _ = drive_all(task, starts([0], [110.0]), 1.0, 150)
    assert over.all()
    assert kpis.outcome[0] == CODES.index(Outcome.OUT_OF_TIME)
    assert 55.0 < kpis.running_time_s[0] <= 55.5


def test_disturbances_and_news_reach_the_plant(tasks):
    task = tasks("drive_disturbed")
    fields = {"mass_factor": [1.0, 1.1, 1.0], "delay_s": [0.0, 0.0, 0.6]}
    news = {"news_at_s": [jnp.inf, jnp.inf, 20.0], "news_s": [110.0, 110.0, 118.0]}
    kpis, over, _ = drive_all(task, starts([0] * 3, [110.0] * 3, **fields, **news), 1.0, 300)
    assert over.all()
    assert kpis.running_time_s[1] > kpis.running_time_s[0] + 0.2, "heavier is slower"
    assert abs(kpis.running_time_s[2] - kpis.running_time_s[0]) > 0.02, "commands come late"
    assert kpis.scheduled_s.tolist() == [110.0, 110.0, 118.0]


def test_a_policy_sees_the_estimated_speed_where_the_measured_one_is_noisy():
    config = task_config("drive")
    noise = DisturbanceDistribution(time_ratio=(1.1, 1.3), speed_noise_mps=(0.05, 0.05))
    task = DrivingTask(replace(config, scenarios=noise))
    own = starts([0], [110.0], speed_noise_mps=[0.05])
    state, _ = jax.vmap(task.begin)(own)
    step, seen = jax.jit(jax.vmap(task.step)), jax.jit(jax.vmap(lambda one: task.context(one).speed_mps))
    errors = []
    for key in jax.random.split(jax.random.key(0), 100):
        state, _ = step(key[None], state, jnp.full((1, 1), 0.4))
        true = state.plant.speed_mps[0]
        errors.append([state.run.measured_mps[0] - true, seen(state)[0] - true])
    measured, estimated = np.sqrt(np.mean(np.square(errors), axis=0))
    assert 0.035 < measured < 0.065
    assert estimated < 0.01


def test_starts_on_the_way_can_still_stop():
    config = task_config("drive")
    scenarios = DisturbanceDistribution(time_ratio=(1.1, 1.3), on_the_way=1.0)
    task = DrivingTask(replace(config, scenarios=scenarios))
    start = jax.jit(jax.vmap(task.draw))(jax.random.split(jax.random.key(0), 200))
    assert float(start.position_m.max()) > 800.0
    kpis, _, _ = drive_all(task, start, 0.6, 300)
    assert (kpis.outcome == CODES.index(Outcome.ARRIVED)).all()
    assert (kpis.interventions == 0).all()


@pytest.mark.parametrize("section", [0, 5, 20])
def test_time_to_go_agrees_with_the_planner(section):
    section, trainset = yizhuang()[section], load_trainset("dkz32", "AW2").ideal()
    vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
    table = tabulate_time_to_go(vehicle, track)
    assert table.time_s[-1, 0] == pytest.approx(minimum_running_time(section, trainset), abs=0.06)
    assert (np.diff(table.time_s[:, :20], axis=0) > 0).all(), "further is longer"
    assert (np.diff(table.time_s, axis=1) <= 1e-9).all(), "faster is sooner"
    rows = table.time_s.shape[0]
    for row, wanted in ((rows // 2, 10.0), (rows // 3, 5.0), (3 * rows // 4, 15.0)):
        left = section.length_m * (row / (rows - 1)) ** 2
        speed = min(wanted, np.floor(table.top_mps[row]))
        options = PlanOptions(start_m=section.length_m - left, start_mps=speed)
        found = table.time_s[row, round(speed / 0.5)]
        assert found == pytest.approx(fastest_time(vehicle, track, options), abs=0.1)


def test_optima_are_those_of_the_planner(tasks):
    cases = tasks("drive").config.cases[:1]
    optima = optima_of(cases, (1.05, 1.1, 1.2, 1.3))
    time_s = 1.15 * minimum_running_time(*cases[0])
    exact = optimal_plan(*cases[0], time_s).energy_j
    found = optima.at(np.array([0]), np.array([time_s]))[0]
    assert found == pytest.approx(exact, rel=0.005)
    assert np.isnan(optima.at(np.array([0]), np.array([10.0]))[0])


def test_a_configuration_names_what_is_wrong():
    config = task_config("drive")
    with pytest.raises(InputError, match="colour"):
        replace(config, observer=("speed", "colour"))
    with pytest.raises(InputError, match="twice"):
        replace(config, rewards=config.rewards[:1] * 2)
    with pytest.raises(InputError, match="interval"):
        DisturbanceDistribution(time_ratio=(1.5, 1.1))
    with pytest.raises(InputError, match="probability"):
        DisturbanceDistribution(news=1.5)
    with pytest.raises(InputError, match="unknown task"):
        task_config("fly")
    with pytest.raises(InputError, match="peroids: unknown field, did you mean periods"):
        make_task("drive", peroids=2)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("most_decisions", 0),
        ("periods", 1.5),
        ("dt", 0.0),
        ("spacing_m", 0.0),
        ("spacing_m", -4.0),
        ("observer", ()),
        ("observer", ("speed", "spead")),
        ("action", "command"),
        ("rewards", (1,)),
        ("sections", "RJ"),
        ("sections", ()),
    ],
)
def test_a_field_that_cannot_have_a_value_is_named(field, value):
    made, values = object.__new__(DrivingConfig), vars(task_config("drive")) | {field: value}
    with pytest.raises(InputError, match=f"^{field}: "):
        DrivingConfig.__init__.__wrapped__(made, **values)  # the tests' own check of types left out


def test_random_domains_have_a_trainset_for_each_section():
    with pytest.raises(InputError, match=r"^trainsets: .*: 1 \(allowed: 24\)"):
        make_task("worlds", trainsets=(load_trainset("dkz32"),))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("mass_factor", 1.2),
        ("mass_factor", (1.0,)),
        ("mass_factor", ("a", "b")),
        ("time_s", (-5.0, 0.0)),
        ("time_ratio", (0.0, 1.0)),
        ("longest_s", float("inf")),
        ("left_ratio", (-1.0, 2.0)),
        ("news_at", (-0.1, 0.5)),
        ("on_the_way", "often"),
    ],
)
def test_a_distribution_names_what_is_no_interval_of_it(field, value):
    made = object.__new__(DisturbanceDistribution)
    with pytest.raises(InputError, match=f"^{field}: "):
        DisturbanceDistribution.__init__.__wrapped__(
            made, **{field: value}
        )  # the tests' check of types left out


def test_starts_have_known_fields_and_one_value_a_row():
    with pytest.raises(InputError, match="mass_factr: unknown field, did you mean mass_factor"):
        starts([0], [100.0], mass_factr=[1.3])
    for fields in ({"scheduled_s": [100.0]}, {"mass_factor": [1.0]}, {"mass_factor": []}):
        with pytest.raises(InputError, match=r"not one value a row.*shape \(2,\)"):
            starts([0, 1], **{"scheduled_s": [100.0, 100.0]} | fields)
    assert starts([0], [100.0], mass_factor=[1.25]).mass_factor.tolist() == [1.25]


def test_an_episode_begins_in_a_case_that_there_is(tasks):
    task = tasks("drive")
    start = jax.tree.map(lambda x: x[0], starts([99], [100.0]))
    with pytest.raises(InputError, match=r"case: out of range: 99 \(allowed: 0 to 2\)"):
        task.begin(start)
    _, seen = task.begin(start._replace(case=jnp.int32(2)))
    assert jax.jit(task.begin)(start)[1].shape == seen.shape, "traced, the case is not known"

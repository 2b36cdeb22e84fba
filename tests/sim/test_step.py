"""One control period: the same function in NumPy and JAX, and every disturbance in every engine."""

import importlib.util
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.scripted import Scripted

from metropilot.env import Assists, CommandAction, DrivingConfig, DrivingTask, episode_of, starts
from metropilot.physics import at_rest, double_precision, to_jax, track_arrays, vehicle_arrays
from metropilot.railway import Restriction, load_line, load_trainset
from metropilot.sim import (
    CODES,
    RUNNING,
    Disturbance,
    Outcome,
    OutcomeRule,
    Run,
    TimetableUpdate,
    declared_bounds,
    drive,
    true_vehicle,
)
from metropilot.sim import step as step_module
from metropilot.sim.outcome import outcome_of
from metropilot.sim.step import overspeed_in_period

DISTURBANCES = {
    "mass": Disturbance(mass_factor=1.15),
    "resistance": Disturbance(resistance_factor=1.4),
    "delay": Disturbance(delay_s=0.5),
    "lag": Disturbance(lag_s=0.4),
    "headwind": Disturbance(headwind_mps=8.0),
    "adhesion": Disturbance(adhesion=0.07),
    "weak brake": Disturbance(brake_factor=0.8),
    "all": Disturbance(False, 1.1, 1.3, 0.3, 0.3, 0.0, -5.0, 0.08, 0.9),
}
DRAWN = (
    "mass_factor",
    "resistance_factor",
    "delay_s",
    "lag_s",
    "headwind_mps",
    "adhesion",
    "brake_factor",
)


@pytest.mark.parametrize("name", DISTURBANCES)
@pytest.mark.parametrize("trainset", ["dkz32", "cheng2023"])
def test_the_true_plant_is_the_same_as_a_trainset_and_as_arrays(name, trainset):
    known, disturbance = load_trainset(trainset), DISTURBANCES[name]
    expected = vehicle_arrays(disturbance.true_plant(known))
    found = true_vehicle(vehicle_arrays(known), **{n: getattr(disturbance, n) for n in DRAWN})
    for field, value in expected._asdict().items():
        np.testing.assert_allclose(getattr(found, field), value, rtol=1e-12, err_msg=field)


def test_overspeed_is_the_same_for_one_number_and_compiled():
    trainset = load_trainset("dkz32", "AW2")
    section = load_line("yizhuang").section("RJ", "WYJ").with_restriction(Restriction(400.0, 600.0, 12.0))
    track, state = track_arrays(section, trainset), at_rest(vehicle_arrays(trainset))
    random = np.random.default_rng(3)
    way, speed = random.uniform(0.0, 20.0, (50, 100)), random.uniform(0.0, 22.0, (50, 101))
    position = np.concatenate([np.zeros((50, 1)), np.cumsum(way, axis=1)], axis=1)
    states = [
        [state._replace(position_m=x, speed_mps=v) for x, v in zip(*run, strict=True)]
        for run in zip(position, speed, strict=True)
    ]
    alone = [max(overspeed_in_period(track, *pair) for pair in pairwise(run)) for run in states]
    assert max(alone) > 5.0
    first, speeds = position[:, :-1].ravel(), speed[:, :-1].ravel()
    last, after = position[:, 1:].ravel(), speed[:, 1:].ravel()
    with double_precision():
        one = jax.vmap(
            lambda x, v, y, w: overspeed_in_period(
                to_jax(track),
                to_jax(state)._replace(position_m=x, speed_mps=v),
                to_jax(state)._replace(position_m=y, speed_mps=w),
            )
        )
        batch = one(*(jnp.asarray(a) for a in (first, speeds, last, after)))
    found = np.asarray(batch).reshape(50, 100).max(axis=1)
    np.testing.assert_allclose(found, alone, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, None),
        ({"speed_mps": 0.0, "error_m": 0.29}, Outcome.ARRIVED),
        ({"speed_mps": 0.0, "error_m": -0.31, "time_s": 30.1, "stood_since_s": 10.0}, Outcome.STALLED),
        ({"speed_mps": 0.0, "error_m": -0.31, "time_s": 29.9, "stood_since_s": 10.0}, None),
        ({"speed_mps": 0.0, "error_m": 0.31}, Outcome.OVERSHOT),
        ({"error_m": 100.1}, Outcome.OVERSHOT),
        ({"error_m": 99.9}, None),
        ({"time_s": 320.1}, Outcome.OUT_OF_TIME),
    ],
)
def test_the_outcome_is_the_same_for_one_number_and_compiled(changes, expected):
    facts = {
        "error_m": -500.0,
        "speed_mps": 10.0,
        "time_s": 50.0,
        "stood_since_s": 0.0,
        "scheduled_s": 100.0,
        "overspeed_mps": 0.0,
    } | changes
    code = RUNNING if expected is None else CODES.index(expected)
    assert outcome_of(OutcomeRule(), **{n: np.float64(v) for n, v in facts.items()}) == code
    assert int(jax.jit(lambda f: outcome_of(OutcomeRule(), **f))(facts)) == code


STEPS = 400
COMMANDS = np.concatenate([np.full(50, 1.0), np.zeros(120), np.full(STEPS, -0.6)]).astype(np.float32)


def compiled_episode(task, start):
    def one(carry, k):
        state, over = carry
        after, transition = task.step(jax.random.key(0), state, jnp.asarray(COMMANDS)[k][None])
        kept = jax.tree.map(lambda new, old: jnp.where(over, old, new), after, state)
        return (kept, over | transition.terminated), (kept.plant.position_m, kept.plant.speed_mps)

    @jax.jit
    def whole(start):
        first = task.begin(start)[0], jnp.zeros((), bool)
        (state, _), rows = jax.lax.scan(one, first, jnp.arange(STEPS))
        return episode_of(task, state), rows

    return whole(start)


@pytest.mark.parametrize("name", [*DISTURBANCES, "restriction", "update"])
def test_every_disturbance_is_the_same_in_the_compiled_task_and_on_the_host(name):
    section, trainset = load_line("yizhuang").section("RJ", "WYJ"), load_trainset("dkz32", "AW2")
    disturbance = DISTURBANCES.get(name, Disturbance())
    fields = {n: (getattr(disturbance, n),) * 2 for n in DRAWN}
    begin = {n: [getattr(disturbance, n)] for n in DRAWN}
    config = DrivingConfig(
        (section,),
        (trainset,),
        ideal=False,
        spacing_m=1.0,
        dt=0.5,
        action=CommandAction(),
        outcomes=OutcomeRule(),
        assists=Assists(False, False),
    )
    scenarios = replace(config.scenarios, **fields)
    if name == "restriction":
        scenarios = replace(scenarios, restriction=1.0)
        found = scenarios.restricted_sections(section)
        reached = [k for k in range(len(found)) if found[k].restrictions[0].from_m < 800.0]
        slowest = min(reached, key=lambda k: found[k].restrictions[0].limit_mps)
        announced = found[slowest]
        begin |= {"restricted": [1.0 + slowest], "restricted_at_s": [10.0]}
        news = (TimetableUpdate(10.0, restriction=announced.restrictions[0]),)
        disturbance = replace(disturbance, updates=news)
    if name == "update":
        begin |= {"news_at_s": [20.0], "news_s": [40.0]}
        disturbance = replace(disturbance, updates=(TimetableUpdate(20.0, scheduled_time_s=40.0),))
    task = DrivingTask(replace(config, scenarios=scenarios))
    start = jax.tree.map(lambda a: a[0], starts([0], [110.0], **begin))
    episode, (position, speed) = compiled_episode(task, start)
    run = Run(section, trainset, 110.0, disturbance, 0.5)
    assert declared_bounds(run).mass == scenarios.bounds(section, trainset, 0.5).mass
    driven = drive(run, Scripted(COMMANDS))
    rows = slice(1, min(driven.trajectory.time_s.size, STEPS + 1))
    np.testing.assert_allclose(position[: rows.stop - 1], driven.trajectory.position_m[rows], atol=0.05)
    np.testing.assert_allclose(speed[: rows.stop - 1], driven.trajectory.speed_mps[rows], atol=5e-3)
    assert int(episode.interventions) == driven.interventions
    assert float(episode.scheduled_s) == driven.scheduled_time_s
    nominal = drive(Run(section, trainset, 110.0, dt=0.5), Scripted(COMMANDS))
    if name != "update":
        rows = min(driven.trajectory.time_s.size, nominal.trajectory.time_s.size)
        apart = driven.trajectory.position_m[:rows] - nominal.trajectory.position_m[:rows]
        assert np.abs(apart).max() > 1.0


def test_what_a_learner_meets_reaches_its_episodes():
    section, trainset = load_line("yizhuang").section("RJ", "WYJ"), load_trainset("dkz32", "AW2")
    scenarios = DrivingConfig((section,), (trainset,)).scenarios
    scenarios = replace(
        scenarios, headwind_mps=(-5.0, 10.0), adhesion=(0.06, 0.15), brake_factor=(0.8, 1.0), restriction=0.5
    )
    task = DrivingTask(DrivingConfig((section,), (trainset,), scenarios=scenarios))
    drawn = jax.vmap(task.draw)(jax.random.split(jax.random.key(1), 400))
    for name in ("headwind_mps", "adhesion", "brake_factor"):
        low, high = getattr(scenarios, name)
        values = np.asarray(getattr(drawn, name))
        assert (
            low <= values.min() < low + 0.1 * (high - low) < high - 0.1 * (high - low) < values.max() <= high
        )
    announced = np.isfinite(drawn.restricted_at_s)
    assert 0.4 < announced.mean() < 0.6
    assert set(np.asarray(drawn.restricted)[announced]) == {1, 2, 3, 4}


def test_the_diagram_of_a_control_period_names_what_there_is():
    page = (Path(__file__).parents[2] / "docs" / "design.md").read_text()
    part = page.split("## A control period")[1].split("\n## ")[0]
    diagram = part.split("```")[1]
    callers = re.findall(r"^\| `([a-z_]+(?:\.\w+)+)`", part, re.MULTILINE)
    names = {"RunParams", "RunState", "true_vehicle", "measured_speed", "overspeed_in_period", "outcome_of"}
    assert names <= set(re.findall(r"\w+", diagram))
    assert all(hasattr(step_module, name) for name in names - {"true_vehicle"})
    assert len(callers) == 7
    for caller in callers:
        package, _, name = caller.rpartition(".")
        found = importlib.import_module(f"metropilot.{package}")
        assert hasattr(found, name) or importlib.util.find_spec(f"metropilot.{caller}"), caller

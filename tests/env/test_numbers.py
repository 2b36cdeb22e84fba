"""Single precision, batch size and padding change next to nothing in drives of a learned policy.

The compiled task counts in float32, the host loop in float64. A case is driven alone, among six others, and
among 63 of which most are there to fill the batch; and with tables of its own section, not padded to those of
a longer one. The bounds are two to ten times what docs/robustness-testing.md says was seen.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from metropilot.drivers import LearnedDriver
from metropilot.env import DrivingConfig, DrivingTask, starts
from metropilot.policy import choose_action, load_driving_policy, network_output, shipped_policy
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Disturbance, Run, drive

STEPS = 500
LINE = load_line("yizhuang")
SECTIONS = [LINE.sections()[k] for k in (6, 3, 0)]
TRAINSETS = [load_trainset("dkz32", load) for load in ("AW0", "AW3")]
LOADED = load_driving_policy(shipped_policy("ppo"))
CASES = [(section, trainset) for section in SECTIONS for trainset in TRAINSETS]
TIMES = [1.1 * section.planned_time_s for section, _ in CASES]
EVERY = len(SECTIONS)
COLUMNS = ("time_s", "position_m", "speed_mps", "energy_wheel_j")


@cache
def program(sections):
    """Whole drives over the first so many sections: the task, and a function of starts."""
    seen = LOADED.interface
    config = DrivingConfig(
        tuple(SECTIONS[:sections]),
        tuple(TRAINSETS),
        observer=seen.features,
        action=seen.action,
        assists=seen.assists,
        spacing_m=1.0,
    )
    task, policy = DrivingTask(config), LOADED.policy.policy
    params = jax.tree.map(jnp.asarray, dict(policy.params))

    def one(start):
        def step(carry, _):
            state, observation, over = carry
            output = network_output(policy.spec, params, observation, jnp)
            after, transition = task.step(
                jax.random.key(0), state, choose_action(policy.spec, output, None, jnp)
            )
            after = jax.tree.map(lambda new, old: jnp.where(over, old, new), after, state)
            observation = jnp.where(over, observation, transition.observation)
            plant = after.plant
            kept = (plant.time_s, plant.position_m, plant.speed_mps, plant.traction_j)
            return (after, observation, over | transition.terminated), jnp.stack(kept)

        first = (*task.begin(start), jnp.zeros((), bool))
        (_, _, over), rows = jax.lax.scan(step, first, None, STEPS)
        return rows, over

    return task, jax.jit(jax.vmap(one))


def driven(cases, sections=EVERY):
    """The rows of a batch, shape (B, STEPS, 4)."""
    rows, over = program(sections)[1](starts(cases, [TIMES[k] for k in cases]))
    assert over.all()
    assert rows.dtype == jnp.float32
    return np.asarray(rows, np.float64)


def apart(one, other):
    """The largest difference of each column."""
    return dict(zip(COLUMNS, np.abs(one - other).reshape(-1, len(COLUMNS)).max(axis=0).tolist(), strict=True))


def near(found, **bounds):
    for name, bound in bounds.items():
        assert found[name] <= bound, found


def test_single_precision_drives_as_double_precision_does():
    rows, config = driven([*range(len(CASES))]), program(EVERY)[0].config
    for (section, trainset), time_s, single in zip(CASES, TIMES, rows, strict=True):
        run = Run(section, trainset, time_s, Disturbance(ideal=True), config.dt)
        double = drive(run, LearnedDriver(LOADED.policy, config.interface)).trajectory
        wanted = np.stack([getattr(double, name)[1:] for name in COLUMNS], axis=1)
        assert wanted.dtype == np.float64
        near(
            found=apart(single[: len(wanted)], wanted),
            time_s=0.005,
            position_m=0.005,
            speed_mps=0.001,
            energy_wheel_j=1e-5 * wanted[-1, 3],
        )


def test_neither_the_batch_nor_what_fills_it_changes_a_drive():
    seven = [*range(6), 0]
    among, filled = driven(seven), driven([*seven, *[0] * 57])[:7]
    assert (filled[0] == filled[6]).all(), "the same case twice in a batch"
    bounds = {"time_s": 0.005, "position_m": 0.002, "speed_mps": 0.001, "energy_wheel_j": 300.0}
    near(apart(among, filled), **bounds)
    for k in range(6):
        near(apart(driven([k])[0], among[k]), **bounds)


def test_padding_a_sections_tables_changes_nothing():
    assert SECTIONS[2].length_m > 1.5 * SECTIONS[0].length_m
    near(
        apart(driven([0, 1], sections=1), driven([0, 1])),
        time_s=0.002,
        position_m=0.001,
        speed_mps=1e-4,
        energy_wheel_j=100.0,
    )

"""Recipes, the rule by which the best policy is kept, runs that died, compiled programs that are kept."""

import multiprocessing
import os
import subprocess
import sys
import time

import numpy as np
import pytest

from metropilot._io import hold_lock, is_locked
from metropilot.env import TASKS
from metropilot.errors import InputError
from metropilot.learn import PPOConfig, RunStore, kept_row
from metropilot.learn.recipes import BUDGETS, RECIPES, recipe
from metropilot.learn.run_store import read_record
from metropilot.learn.train import select_kpis


@pytest.mark.parametrize("driver", RECIPES)
def test_recipes_can_be_followed(driver):
    row = recipe(driver)
    assert row.task in TASKS
    configs = [row.configuration(budget) for budget in BUDGETS]
    assert configs == [row.quick, row.paper]
    assert configs[0].steps < configs[1].steps
    assert row.configuration("quick", steps=77).steps == 77
    task = row.task_configuration()
    discrete = {"dqn": True, "tabular": True, "ddpg": False, "sac": False, "naf": False}
    assert task.action.space.discrete == discrete.get(row.algorithm, task.action.space.discrete)
    if row.algorithm == "tabular":
        numbers = {"position": 1, "speed": 1, "time_left": 1, "position_m": 1, "expert": 7}
        assert len(configs[0].bins) == sum(numbers[name] for name in task.features)


def test_what_there_is_no_recipe_for_names_the_nearest():
    with pytest.raises(InputError, match="did you mean ppo_scaled"):
        recipe("ppo-scaled")
    with pytest.raises(InputError, match="it is learned by: metropilot reproduce cheng2023"):
        recipe("ddpg_pid")
    with pytest.raises(InputError, match="did you mean entropy"):
        recipe("ppo").configuration("quick", entrpy=1.0)
    with pytest.raises(InputError, match="did you mean drive_jerk"):
        recipe("ppo").task_configuration("drive_jurk")
    with pytest.raises(InputError, match="allowed: quick, paper"):
        recipe("ppo").configuration("long")


def drives(safe, gap, late, error=None):
    import jax.numpy as jnp

    from metropilot.learn.policy_evaluation import EvaluationRuns
    from metropilot.sim import Episode

    count = len(safe)
    zero = jnp.zeros((count,), jnp.float32)
    episode = Episode(*[zero] * len(Episode._fields))._replace(
        outcome=jnp.asarray([0 if s else 3 for s in safe], jnp.int32),
        wheel_j=jnp.full((count,), 3.6e7, jnp.float32),
        stop_error_m=jnp.asarray(error or [0.0] * count, jnp.float32),
    )
    numbers = (jnp.asarray(x, jnp.float32) for x in (gap, late))
    return EvaluationRuns(episode, jnp.asarray(safe), *numbers)


def test_arrivals_come_first_then_energy_and_time():
    from metropilot.learn.policy_evaluation import score_drives

    # 3 safe drives; costs 0.02 + 0.01, 0.04 + 0, (0 + 0.02, a gap below zero counts as none): mean 0.03
    found = score_drives(drives([True] * 3, [0.02, 0.04, -0.01], [1.0, 0.0, -2.0], [0.0, -0.1, 0.05]))
    assert float(found["score"]) == pytest.approx(3.0 - 0.03)
    assert float(found["safe_share"]) == 1.0
    assert float(found["gap_percent"]) == pytest.approx(100 * 0.05 / 3)
    assert float(found["late_worst_s"]) == 2.0
    assert float(found["stop_error_worst_m"]) == pytest.approx(0.1)
    assert float(found["energy_wheel_kwh"]) == pytest.approx(10.0)
    # Two safe drives at the optimum are worth less than three wasteful ones.
    wasteful = score_drives(drives([True] * 3, [9.0] * 3, [2.9] * 3))
    thrifty = score_drives(drives([True, True, False], [0.0] * 3, [0.0] * 3))
    assert float(wasteful["score"]) == pytest.approx(2.0)
    assert float(wasteful["score"]) > float(thrifty["score"]) == pytest.approx(2.0 - 1 / 3)
    none = score_drives(drives([False] * 2, [0.5] * 2, [0.0] * 2))
    assert float(none["score"]) == -1.0
    assert np.isnan(float(none["gap_percent"]))


def test_the_kpis_kept_are_those_of_the_policy_kept():
    history = {
        "steps": np.arange(3.0),
        "evaluation.score": np.array([1.0, 2.0, 2.0]),
        "evaluation.safe_share": np.array([0.1, 0.5, 0.6]),
        "evaluation.gap_percent": np.array([np.nan, np.nan, 3.0]),
    }
    assert select_kpis(history, "best") == {"safe_share": 0.5}
    assert select_kpis(history, "last") == {"safe_share": 0.6, "gap_percent": 3.0}
    # the loop keeps no policy whose score is not a number
    history["evaluation.score"] = np.array([1.0, np.nan, 2.0])
    assert kept_row(history, "best") == 2
    assert select_kpis(history, "best") == {"safe_share": 0.6, "gap_percent": 3.0}
    history["evaluation.score"] = np.full(3, np.nan)
    assert kept_row(history, "best") is None
    assert select_kpis(history, "best") == {}
    assert kept_row({}, "last") is None


def hold(folder, ready):
    with hold_lock(folder):
        ready.set()
        time.sleep(60)


def test_a_run_whose_process_was_killed_is_interrupted(tmp_path):
    store = RunStore(tmp_path)
    record = store.create(PPOConfig(), "drive", 0, {}, driver="ppo", command="metropilot learn ppo")
    folder = store.folder(record.id)
    context = multiprocessing.get_context("spawn")
    ready = context.Event()
    process = context.Process(target=hold, args=(folder, ready))
    process.start()
    try:
        assert ready.wait(60)
        assert [r.status for r in store.find("")] == ["running"]
        assert is_locked(folder)
        with pytest.raises(InputError, match="another process is learning"), hold_lock(folder):
            pass
    finally:
        process.kill()
        process.join()
    assert [r.status for r in store.find("interrupted")] == ["interrupted"]
    assert read_record(folder / "run.toml").status == "interrupted"
    assert store.show(record.id[:6]).driver == "ppo"


def test_a_folder_is_a_run_of_its_own_name_whatever_it_says(tmp_path):
    store = RunStore(tmp_path / "a", indexed=False)
    store.create(PPOConfig(), "drive", 0, {}, id="run")
    text = (tmp_path / "a" / "run" / "run.toml").read_text()
    evil = tmp_path / "b" / "other"
    evil.mkdir(parents=True)
    (evil / "run.toml").write_text(text.replace('id = "run"', 'id = "../../c"'))
    assert RunStore(tmp_path / "b", indexed=False).show("other").status == "interrupted"
    assert not (tmp_path / "c").exists()
    (evil / "run.toml").write_text(text.replace("steps = 0", 'steps = "0"'))
    assert read_record(evil / "run.toml") is None


def test_an_index_of_another_version_is_made_anew(tmp_path):
    import sqlite3

    store = RunStore(tmp_path)
    record = store.create(PPOConfig(), "drive", 0, {})
    with sqlite3.connect(tmp_path / "index.sqlite") as database:
        database.execute("ALTER TABLE runs DROP COLUMN kpis")
        database.execute("PRAGMA user_version = 1")
    database.close()
    assert [r.id for r in store.find("")] == [record.id]


SCRIPT = """
import jax
from metropilot.learn.compile_cache import keep_compiled
{before}
print(keep_compiled(), jax.config.values["jax_compilation_cache_dir"])
"""


def kept(tmp_path, before="", **environment):
    told = {**os.environ, "METROPILOT_HOME": str(tmp_path / "home")} | environment
    told.pop("JAX_COMPILATION_CACHE_DIR", None)  # the suite's own choice would win
    command = [sys.executable, "-c", SCRIPT.format(before=before)]
    return subprocess.run(command, env=told, capture_output=True, text=True, check=True).stdout.split()


def test_compiled_programs_are_kept_where_the_user_wants_it(tmp_path):
    returned, used = kept(tmp_path)
    assert returned == used
    assert returned.startswith(str(tmp_path / "home" / "cache" / "compiled" / "jax-"))
    other, _ = kept(tmp_path, XLA_FLAGS="--xla_cpu_multi_thread_eigen=true")
    assert other != returned
    assert kept(tmp_path, METROPILOT_COMPILE_CACHE="0") == ["None", "None"]
    mine, _ = kept(tmp_path, METROPILOT_COMPILE_CACHE=str(tmp_path / "mine"))
    assert mine.startswith(str(tmp_path / "mine"))
    chosen = f'jax.config.update("jax_compilation_cache_dir", {str(tmp_path / "theirs")!r})'
    assert kept(tmp_path, chosen) == [str(tmp_path / "theirs")] * 2

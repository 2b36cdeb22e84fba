"""Runs from Python: stopped at any moment and continued, they give the same bits."""

import os
import signal
import subprocess
import sys

import jax
import numpy as np
import pytest
from tests.learn.problems import DoubleIntegrator, Masked

from metropilot.errors import InputError
from metropilot.learn import DQNConfig, PPOConfig, SACConfig, TrainingOptions, learn_in_chunks, make_loop
from metropilot.learn.checkpoint import load_checkpoint, save_checkpoint

SHORT = {"environments": 4, "evaluations": 4, "evaluation_steps": 5, "evaluation_episodes": 2, "hidden": (8,)}
MEMORY = {"warmup": 16, "buffer_size": 64, "batch_size": 8, "steps": 128}
CASES = {
    "ppo": (
        PPOConfig(**SHORT, steps=256, rollout=16, minibatches=2, epochs=2, reward_scaling=True),
        DoubleIntegrator(),
    ),
    "dqn": (DQNConfig(**SHORT, **MEMORY, prioritised=True, n_step=2), Masked()),
    "sac": (SACConfig(**SHORT, **MEMORY, normalise_observations=True), DoubleIntegrator()),
}


class Stopped(Exception):
    pass


def equal(a, b):
    assert a.history.keys() == b.history.keys()
    for name in a.history:
        np.testing.assert_array_equal(a.history[name], b.history[name], err_msg=name)
    for name in a.policy.params:
        np.testing.assert_array_equal(a.policy.params[name], b.policy.params[name], err_msg=name)
    assert a.score == b.score


@pytest.mark.parametrize("name", ["ppo", "dqn", "sac"])
def test_a_run_stopped_twice_ends_like_one_that_was_not(name, tmp_path):
    config, task = CASES[name]
    whole = learn_in_chunks(config, task, 5)
    path = tmp_path / "checkpoint.safetensors"

    def stop_at(chunk):
        def check(progress):
            if progress.chunk == chunk:
                raise Stopped

        return TrainingOptions(on_progress=check, checkpoint=path, resume=True)

    for chunk in (1, 3):
        with pytest.raises(Stopped):
            learn_in_chunks(config, task, 5, stop_at(chunk))
    equal(learn_in_chunks(config, task, 5, TrainingOptions(checkpoint=path, resume=True)), whole)
    # Once it is done, going on changes nothing.
    equal(learn_in_chunks(config, task, 5, TrainingOptions(checkpoint=path, resume=True)), whole)


def test_progress_counts_up_and_estimates(tmp_path):
    config, task = CASES["ppo"]
    seen = []
    learned = learn_in_chunks(config, task, 0, TrainingOptions(on_progress=seen.append))
    assert [p.chunk for p in seen] == [1, 2, 3, 4]
    assert [p.steps for p in seen] == [64, 128, 192, 256] == learned.history["steps"].tolist()
    assert seen[-1].seconds_left == 0.0
    assert seen[0].total_steps == 256
    assert seen[0].rate > 0.0
    assert "evaluation.score" in seen[0].row


def test_a_checkpoint_of_another_run_is_refused(tmp_path):
    config, task = CASES["sac"]
    path = tmp_path / "checkpoint.safetensors"
    learn_in_chunks(config, task, 0, TrainingOptions(checkpoint=path, about={"line": "a"}))
    again = TrainingOptions(checkpoint=path, resume=True, about={"line": "a"})
    with pytest.raises(
        InputError, match=r"seed: the checkpoint was made with another value: '1' \(allowed: 0\)"
    ):
        learn_in_chunks(config, task, 1, again)
    with pytest.raises(InputError, match=r"task.line: .*'b'"):
        learn_in_chunks(config, task, 0, TrainingOptions(checkpoint=path, resume=True, about={"line": "b"}))
    other = SACConfig(**SHORT, **MEMORY, normalise_observations=True, gamma=0.5)
    with pytest.raises(InputError, match=r"config\.gamma"):
        learn_in_chunks(other, task, 0, again)
    with pytest.raises(InputError, match="another"):
        learn_in_chunks(*CASES["ppo"], 0, again)


def test_a_damaged_checkpoint_is_one_line(tmp_path):
    config, task = CASES["ppo"]
    loop = make_loop(config, task)
    state = jax.jit(loop.init)(jax.random.key(0))
    template = jax.eval_shape(loop.init, jax.random.key(0))
    path = tmp_path / "c.safetensors"
    save_checkpoint(path, state, {"steps": np.arange(3.0)}, {"seed": 1})
    restored, history, about = load_checkpoint(path, template)
    for a, b in zip(jax.tree.leaves(restored), jax.tree.leaves(state), strict=True):
        assert a.dtype == b.dtype
        if not jax.dtypes.issubdtype(a.dtype, jax.dtypes.prng_key):
            np.testing.assert_array_equal(a, b)
    assert history["steps"].tolist() == [0, 1, 2]
    assert about == {"seed": 1}
    data = path.read_bytes()
    for broken in (data[:-5], data[: len(data) // 2], data[:4], b"", data + b"x", b"\x80\x04." + data):
        path.write_bytes(broken)
        with pytest.raises(InputError) as error:
            load_checkpoint(path, template)
        assert "\n" not in str(error.value)


SCRIPT = """
import sys, time, pathlib
from metropilot.learn import PPOConfig, TrainingOptions, learn_in_chunks
from tests.learn.problems import DoubleIntegrator

config = PPOConfig(steps=6_400, environments=4, rollout=16, minibatches=1, epochs=1, evaluations=50,
                   evaluation_steps=5, evaluation_episodes=2, hidden=(8,))

def slowly(progress):
    print(progress.chunk, flush=True)
    time.sleep(0.05)

learn_in_chunks(config, DoubleIntegrator(), 7, TrainingOptions(checkpoint=pathlib.Path(sys.argv[1]),
on_progress=slowly))
"""


def test_kill_9_loses_at_most_one_interval(tmp_path):
    path = tmp_path / "checkpoint.safetensors"
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(path)],
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": "."},
    )
    seen = 0
    for line in process.stdout:
        seen = int(line)
        if seen >= 5:
            os.kill(process.pid, signal.SIGKILL)
            break
    more, _ = process.communicate()
    seen = max([seen, *map(int, more.split())])
    assert process.returncode == -signal.SIGKILL
    config = PPOConfig(
        steps=6_400,
        environments=4,
        rollout=16,
        minibatches=1,
        epochs=1,
        evaluations=50,
        evaluation_steps=5,
        evaluation_episodes=2,
        hidden=(8,),
    )
    reached = []
    sitting = TrainingOptions(checkpoint=path, resume=True, on_progress=lambda p: reached.append(p.chunk))
    resumed = learn_in_chunks(config, DoubleIntegrator(), 7, sitting)
    # What was reported was saved before; the first chunk done anew is the next,
    # or one later if that was saved too.
    assert reached[0] in {seen + 1, seen + 2}
    equal(resumed, learn_in_chunks(config, DoubleIntegrator(), 7))

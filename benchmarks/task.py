"""Task steps per second: plant, protection, assists, reward and observation of a whole batch.

``python -m benchmarks task [--json] [--write docs/benchmarks.md]``

Each figure comes from a process of its own, since JAX fixes its devices when it starts: two cores are two
single-threaded devices, each with half of the batch. Episodes that end are reset, as a learner does.
"""

from __future__ import annotations

import json
import sys
import time

from benchmarks.plant import rate
from benchmarks.report import Benchmark, Row, on_devices, run

BATCH = 4096
STEPS = 200
TARGET = 5e6
TASKS = ("drive", "drive_line", "drive_jerk", "chen2023a")


def measure_task(name: str, batch: int) -> dict[str, float]:
    """Steps per second of random actions in this process, and how long it takes until the first."""
    import jax
    import jax.numpy as jnp

    from metropilot import physics
    from metropilot.env import make_task
    from metropilot.learn import Environments, random_actions, reset_environments, step_environments

    begun = time.perf_counter()
    task = make_task(name)
    built = time.perf_counter() - begun
    shares = len(jax.devices())

    def one(carry: Environments, key: jax.Array) -> tuple[Environments, jax.Array]:
        act_key, step_key = jax.random.split(key)
        action = random_actions(task, act_key, carry)
        carry, step = step_environments(task, step_key, carry, action)
        return carry, jnp.sum(step.reward) + jnp.sum(step.observation)

    def part(key: jax.Array) -> tuple[Environments, jax.Array]:
        start = reset_environments(task, key, batch // shares)
        return jax.lax.scan(one, start, jax.random.split(key, STEPS))

    whole = jax.pmap(part) if shares > 1 else jax.jit(jax.vmap(part))
    keys = jax.random.split(jax.random.key(0), shares)
    keys = physics.spread(keys) if shares > 1 else keys

    def work() -> None:
        jax.block_until_ready(whole(keys))

    begun = time.perf_counter()
    work()
    first = time.perf_counter() - begun
    count = batch * STEPS
    return {
        "wall": rate(work, count),
        "cpu": rate(work, count, clock=time.process_time),
        "built": built,
        "first": first,
    }


def measure() -> list[Row]:
    """Every figure in one run."""
    single = on_devices(1, "benchmarks.task", "--compiled", "drive", str(BATCH))
    base, unit = single["wall"], "task steps/s"
    rows = [
        Row(f"drive, batch {BATCH:,}, 1 core", single["wall"], unit, 1.0),
        Row("the same per second of processor time", single["cpu"], unit, single["cpu"] / base),
    ]
    for name in TASKS:
        pair = on_devices(2, "benchmarks.task", "--compiled", name, str(BATCH))
        target = f"{TARGET:,.0f}" if name == "drive" else ""
        rows.append(Row(f"{name}, batch {BATCH:,}, 2 cores", pair["wall"], unit, pair["wall"] / base, target))
        rows.append(Row(f"{name}: tables of its cases", pair["built"], "s"))
        rows.append(Row(f"{name}: compiled and run once", pair["first"], "s"))
    return rows


BENCHMARK = Benchmark(
    name="task",
    title="Task steps per second",
    packages=("metropilot", "jax", "jaxlib", "numpy"),
    measure=measure,
    note=(
        "One step is one decision of a policy, every 0.5 s: action, assists, supervisor, plant, outcome, "
        "reward terms and observation, under random actions, resets included. "
        "With other work on the machine (see its load), the processor time is the better measure."
    ),
)

if __name__ == "__main__":
    if sys.argv[1:2] == ["--compiled"]:
        print(json.dumps(measure_task(sys.argv[2], int(sys.argv[3]))))
    else:
        run([BENCHMARK])

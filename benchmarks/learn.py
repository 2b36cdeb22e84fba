"""Learning speed: environment steps and gradient updates per second, compile time.

``python -m benchmarks learn [--json] [--write docs/benchmarks.md]``

The task is a mass to be brought to rest, eight observations wide: next to nothing to simulate, so that the
figures are the learners' own; PPO also learns the driving task ``drive``. Each figure is CPU seconds of one
single-threaded process (a busy machine changes them little). Where Stable-Baselines3 is installed with CPU
torch (``pip install stable-baselines3 torch``), it learns the same with the same networks and batches in the
same run; where it is not, those rows are left out.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from importlib.util import find_spec
from typing import Any, NamedTuple

from benchmarks.report import ROOT, Benchmark, Row, run

FLAGS = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
CASES = (
    "ppo",
    "ppo_wide",
    "ppo_drive",
    "sac",
    "sac_1m",
    "ddpg",
    "ddpg_1m",
    "dqn",
    "dqn_1m",
    "improved_dqn",
    "improved_dqn_131k",
    "improved_dqn_1m",
)
WHAT = {
    "ppo": ("PPO 64-64, 64 environments, 10 epochs of 16 minibatches", "environment steps/s"),
    "ppo_wide": ("PPO 64-64, 256 environments, 4 epochs of 8 minibatches", "environment steps/s"),
    "ppo_drive": ("PPO 64-64 on `drive`, 512 environments, 4 epochs of 16", "environment steps/s"),
    "sac": ("SAC 64-64, batch 128, memory of 10k", "updates/s"),
    "sac_1m": ("SAC, memory of 1M", "updates/s"),
    "ddpg": ("DDPG 64-64, batch 64, memory of 10k", "updates/s"),
    "ddpg_1m": ("DDPG, memory of 1M", "updates/s"),
    "dqn": ("DQN 128-256, batch 64, memory of 10k", "updates/s"),
    "dqn_1m": ("DQN, memory of 1M", "updates/s"),
    "improved_dqn": ("improved DQN (double, dueling, prioritised) 128-256, memory of 10k", "updates/s"),
    "improved_dqn_131k": ("improved DQN, memory of 131k", "updates/s"),
    "improved_dqn_1m": ("improved DQN, memory of 1M", "updates/s"),
}
TARGETS = {
    "ppo_wide": "100,000",
    "ppo_drive": "100,000",
    "sac_1m": "flat",
    "ddpg_1m": "flat",
    "dqn_1m": "flat",
    "improved_dqn_131k": "flat",
    "improved_dqn_1m": "flat",
}
BASELINES = {"ppo": ">= 30 x", "ppo_drive": ">= 30 x", "sac": ">= 8 x", "ddpg": ">= 8 x", "dqn": ">= 8 x"}
"""How many times as fast as Stable-Baselines3 ours is to be."""


def task(choices: int = 0) -> Any:
    """The mass, with a continuous command or so many choices."""
    import jax
    import jax.numpy as jnp

    from metropilot.env import AbstractTask, ActionSpace, Transition

    class Mass(NamedTuple):
        position: Any
        speed: Any
        time: Any

    class Rest(AbstractTask):
        observation_size = 8
        action_space = ActionSpace(count=choices) if choices else ActionSpace(size=1)

        def reset(self, key: Any) -> Any:
            position = jax.random.uniform(key, (), jnp.float32, -1.0, 1.0)
            state = Mass(position, jnp.zeros(()), jnp.zeros((), jnp.int32))
            return state, self.observe(state)

        def observe(self, state: Mass) -> Any:
            return jnp.tile(jnp.stack([state.position, state.speed]), 4)

        def step(self, key: Any, state: Mass, action: Any) -> Any:
            del key
            u = jnp.linspace(-1.0, 1.0, choices)[action] if choices else action[0]
            speed = jnp.clip(state.speed + 0.2 * u, -2.0, 2.0)
            state = Mass(jnp.clip(state.position + 0.2 * speed, -2.0, 2.0), speed, state.time + 1)
            reward = -(state.position**2 + 0.1 * speed**2 + 0.05 * u**2)
            over = jnp.zeros((), bool)
            return state, Transition(self.observe(state), reward, over, state.time >= 200, {"cost": reward})

    return Rest()


def configuration(case: str) -> Any:
    """Configuration of the learner of a case."""
    from metropilot.learn import DDPGConfig, DQNConfig, PPOConfig, SACConfig

    common: dict[str, Any] = {"evaluations": 1, "evaluation_episodes": 1, "evaluation_steps": 1}
    size = {"1m": 1_000_000, "131k": 131_072}.get(case.rpartition("_")[2], 10_000)
    memory = common | {"buffer_size": size, "warmup": 1_000, "steps": 4_000}
    driving: dict[str, Any] = {"environments": 512, "rollout": 64, "epochs": 4}
    if case == "ppo":
        return PPOConfig(**common, steps=262_144)
    if case == "ppo_wide":
        return PPOConfig(**common, steps=524_288, environments=256, epochs=4, minibatches=8)
    if case == "ppo_drive":
        return PPOConfig(**common, **driving, steps=524_288)
    if case.startswith("sac"):
        return SACConfig(**memory, hidden=(64, 64), batch_size=128)
    if case.startswith("ddpg"):
        return DDPGConfig(**memory)
    improved = case.startswith("improved")
    return DQNConfig(**memory, hidden=(128, 256), double=improved, dueling=improved, prioritised=improved)


def one(case: str, rounds: int = 3) -> tuple[float, float]:
    """Steps or updates per CPU second of one case, and CPU seconds to compile it."""
    import jax

    from metropilot.env import make_task
    from metropilot.learn import make_loop

    config = configuration(case)
    learned = make_task("drive") if case == "ppo_drive" else task(12 if "dqn" in case else 0)
    loop = make_loop(config, learned)
    state = jax.jit(loop.init)(jax.random.key(0))
    start = time.process_time()
    chunk = jax.jit(loop.chunk, donate_argnums=0).lower(state).compile()
    compiled = time.process_time() - start
    best = float("inf")
    for _ in range(rounds):
        start = time.process_time()
        state, _ = jax.block_until_ready(chunk(state))
        best = min(best, time.process_time() - start)
    return loop.steps / best, compiled


def apart(case: str) -> tuple[float, float]:
    """One case in a process of its own, single-threaded."""
    environment = os.environ | {"XLA_FLAGS": FLAGS, "OMP_NUM_THREADS": "1", "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-m", "benchmarks.learn", "--case", case]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    rate, compiled = done.stdout.split()[-2:]
    return float(rate), float(compiled)


STEPS = {"ppo": 16_384, "ppo_drive": 2_048, "sac": 1_500, "ddpg": 1_500, "dqn": 3_000}
"""That Stable-Baselines3 learns for in each case."""


def baselines(rates: dict[str, float]) -> list[Row]:
    """Stable-Baselines3 on the same tasks, where it is installed; else nothing."""
    if find_spec("stable_baselines3") is None:
        return []
    rows = []
    for case, target in BASELINES.items():
        rate = stable_baselines(case, STEPS[case])
        what, unit = WHAT[case]
        rows.append(Row(f"Stable-Baselines3: {what}", rate, unit, rates[case] / rate, target))
    return rows


def gymnasium_mass(choices: int) -> type:
    """The mass as a plain Gymnasium environment in NumPy, as quick as such a thing gets."""
    import gymnasium
    import numpy as np

    class Rest(gymnasium.Env):
        observation_space = gymnasium.spaces.Box(-2.0, 2.0, (8,), np.float32)
        action_space = (
            gymnasium.spaces.Discrete(choices) if choices else gymnasium.spaces.Box(-1.0, 1.0, (1,))
        )

        def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
            super().reset(seed=seed)
            del options
            self.position, self.speed, self.time = self.np_random.uniform(-1.0, 1.0), 0.0, 0
            return self.observe(), {}

        def observe(self) -> Any:
            return np.tile(np.float32([self.position, self.speed]), 4)

        def step(self, action: Any) -> Any:
            u = np.linspace(-1.0, 1.0, choices)[action] if choices else float(action[0])
            self.speed = min(max(self.speed + 0.2 * u, -2.0), 2.0)
            self.position = min(max(self.position + 0.2 * self.speed, -2.0), 2.0)
            self.time += 1
            reward = -(self.position**2 + 0.1 * self.speed**2 + 0.05 * u**2)
            return self.observe(), reward, False, self.time >= 200, {}

    return Rest


def stable_baselines(case: str, steps: int) -> float:
    """Environment steps (one update each, but for PPO) per CPU second of Stable-Baselines3."""
    import gymnasium
    import stable_baselines3 as sb3
    import torch
    from stable_baselines3.common.env_util import make_vec_env

    torch.set_num_threads(1)
    mass = gymnasium_mass(12 if case == "dqn" else 0)
    wide = [128, 256] if case == "dqn" else [64, 64]
    common: dict[str, Any] = {"policy_kwargs": {"net_arch": wide}, "device": "cpu"}
    memory = common | {
        "learning_starts": 100,
        "train_freq": 1,
        "gradient_steps": 1,
        "buffer_size": 10_000,
        "batch_size": 128 if case == "sac" else 64,
    }
    if case == "ppo":
        environments = make_vec_env(mass, 64)
        model = sb3.PPO("MlpPolicy", environments, n_steps=128, batch_size=512, n_epochs=10, **common)
    elif case == "ppo_drive":
        environment = gymnasium.make("metropilot.env.adapters:metropilot/Drive-v0")
        environment.reset(seed=0)
        environment.step(environment.action_space.sample())
        model = sb3.PPO("MlpPolicy", environment, n_steps=2_048, batch_size=128, n_epochs=4, **common)
    else:
        model = {"sac": sb3.SAC, "ddpg": sb3.DDPG, "dqn": sb3.DQN}[case]("MlpPolicy", mass(), **memory)
    start = time.process_time()
    model.learn(steps)
    return steps / (time.process_time() - start)


def decision() -> list[Row]:
    """Time of one decision, in NumPy and in ONNX where that is installed."""
    import tempfile
    from pathlib import Path

    import numpy as np

    from metropilot.learn import export_onnx
    from metropilot.policy import Policy, PolicySpec

    spec = PolicySpec("clip", 8, 1, (64, 64), "tanh", 1, normalised=True)
    rng = np.random.default_rng(0)
    params = {name: rng.normal(0.0, 0.2, shape).astype(np.float32) for name, shape in spec.shapes().items()}
    policy, x = Policy(spec, params), np.zeros(8, np.float32)
    start = time.process_time()
    for _ in range(5_000):
        policy(x)
    rows = [Row("one decision, 64-64, NumPy", (time.process_time() - start) / 5_000 * 1e6, "us")]
    if find_spec("onnxruntime"):
        with tempfile.TemporaryDirectory() as folder:
            report = export_onnx(policy, Path(folder, "policy.onnx"))
        rows.append(Row("one decision, 64-64, onnxruntime", report.latency_us_median, "us", None, "below 50"))
        rows.append(Row("ONNX against the policy, largest difference", report.parity, "", None, "below 1e-5"))
    return rows


def measure() -> list[Row]:
    """Every case."""
    rates, rows, compiled = {}, [], {}
    for case in CASES:
        rates[case], compiled[case] = apart(case)
        base = case.rpartition("_")[0]
        ratio = rates[case] / rates[base] if base in rates and "ppo" not in case else None
        what, unit = WHAT[case]
        rows.append(Row(what, rates[case], unit, ratio, TARGETS.get(case, "")))
    rows += [
        Row(f"compiling {WHAT[case][0]}", compiled[case], "s") for case in ("ppo", "sac", "improved_dqn")
    ]
    return rows + decision() + baselines(rates)


BENCHMARK = Benchmark(
    "learn",
    "Learning",
    ("jax", "numpy"),
    measure,
    "Rates are per CPU second of one single-threaded process. Ratios: of a larger memory, to the memory of "
    "10k; for Stable-Baselines3, metropilot over it. Its environment is plain NumPy, and on `drive` the "
    "Gymnasium environment, one at a time.",
)

if __name__ == "__main__":
    if "--case" in sys.argv:
        print(*one(sys.argv[sys.argv.index("--case") + 1]))
    else:
        run([BENCHMARK])

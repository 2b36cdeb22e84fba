"""Cost of a learned driver: until learning begins, the first time and the second, and for each decision.

python -m benchmarks.learned
"""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.report import Benchmark, Row, run
from metropilot._processes import ONE_THREAD

PROGRAM = Path(sys.executable).with_name("metropilot")
LEARN = ("learn", "ppo", "--steps", "65536", "--set", "evaluations=1")
SECOND = 3
DECISIONS = 5_000


def learn_s(home: str, **switches: str) -> tuple[float, float]:
    """Wall and processor time of the smallest learning of a shipped driver's recipe, in a fresh process."""
    environment = os.environ | ONE_THREAD | {"METROPILOT_HOME": home} | switches
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([PROGRAM, *LEARN], env=environment, capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - began, busy


def measure_compilation() -> list[Row]:
    """Learning begins: without the cache of compiled programs, filling it, and with it."""
    with TemporaryDirectory() as home:
        off = learn_s(home, METROPILOT_COMPILE_CACHE="0")
        first = learn_s(home)
        again = [learn_s(home) for _ in range(SECOND)]
    second = tuple(statistics.median(column) for column in zip(*again, strict=True))
    rows = []
    for what, (wall, busy) in (("cache off", off), ("first", first), ("second", second)):
        rows.append(Row(f"`metropilot learn ppo`, two rollouts, {what}", wall, "s", wall / off[0]))
        rows.append(Row(f"the same, {what}, processor time", busy, "s", busy / off[1]))
    return rows


def measure_decision() -> list[Row]:
    """One decision of a shipped driver: the network in NumPy and in onnxruntime, and all on the host."""
    import numpy as np

    from metropilot.drivers import DRIVERS
    from metropilot.learn import export_onnx
    from metropilot.policy import load_policy, shipped_policy
    from metropilot.railway import load_line, load_trainset
    from metropilot.sim import Run, drive

    rows = []
    for driver in ("ppo", "ppo_scaled"):
        path = shipped_policy(driver)
        if not path.is_file():
            continue
        policy, _ = load_policy(path)
        x, spent = np.zeros(policy.spec.observation_size, np.float32), np.empty(DECISIONS)
        for k in range(DECISIONS):
            began = time.perf_counter_ns()
            policy(x)
            spent[k] = (time.perf_counter_ns() - began) / 1e3
        rows.append(Row(f"{driver}: network in NumPy, median", float(np.median(spent)), "µs"))
        if find_spec("onnxruntime"):
            with TemporaryDirectory() as folder:
                report = export_onnx(policy, Path(folder, "policy.onnx"))
            rows.append(
                Row(
                    f"{driver}: network in onnxruntime, median", report.latency_us_median, "µs", None, "50 µs"
                )
            )
            rows.append(Row(f"{driver}: ONNX against the policy, largest", report.parity, "", None, "1e-5"))
        section, trainset = load_line("yizhuang").section("RJ", "WYJ"), load_trainset("dkz32", "AW2")
        done = drive(Run(section, trainset, 110.0), DRIVERS.make(driver))
        median = float(np.median(done.decision_us))
        rows.append(Row(f"{driver}: features, network and assists on the host, median", median, "µs"))
    return rows


def measure() -> list[Row]:
    """Both."""
    return measure_compilation() + measure_decision()


BENCHMARK = Benchmark(
    name="learned",
    title="What a learned driver costs",
    packages=("metropilot", "jax", "jaxlib", "numpy"),
    measure=measure,
    note="Learning in a fresh process on one thread: import, tables of the task, tracing, compiling, 65,536 "
    f"steps, one evaluation. *Second* is the median of {SECOND}. The ratio is against no cache.",
)

if __name__ == "__main__":
    run([BENCHMARK])

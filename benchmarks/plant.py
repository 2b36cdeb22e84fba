"""Plant steps per second: the compiled batch against the same step in NumPy.

``python -m benchmarks.plant [--json] [--write docs/benchmarks.md]``

All 26 Yizhuang sections with the three loads of dkz32 (78 cases) drive from standstill under random
commands that change every 2 s. The NumPy loop steps one trainset at a time, as a single drive does;
vectorised NumPy runs the same formulas over a row of states of one trainset on one section (it cannot mix
sections). Each compiled figure comes from a process of its own, since JAX fixes its devices when it starts.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable

import numpy as np

from benchmarks.report import Benchmark, Row, on_devices, run
from metropilot import physics
from metropilot.railway import Section, Trainset, load_line, load_trainset

DT = 0.2
REPEATS = 16
STEPS = 1000
TARGET = 10e6


def cases() -> tuple[list[Section], list[Trainset]]:
    """All sections, both ways, and the loads."""
    line, trainset = load_line("yizhuang"), load_trainset("dkz32")
    return [*line.sections(), *line.sections(backward=True)], [
        trainset.with_load(load) for load in trainset.loads
    ]


def commands(batch: int, steps: int) -> np.ndarray:
    """Random commands that change every ten steps. Shape (batch, steps)."""
    rng = np.random.default_rng(0)
    return np.repeat(rng.uniform(-0.5, 1.0, (batch, -(-steps // 10))), 10, axis=1)[:, :steps]


def rate(
    work: Callable[[], object],
    steps: int,
    rounds: int = 5,
    clock: Callable[[], float] = time.perf_counter,
) -> float:
    """Median steps per second over some rounds, after one that does not count."""
    work()
    taken = []
    for _ in range(rounds):
        start = clock()
        work()
        taken.append(clock() - start)
    return steps / statistics.median(taken)


def numpy_loop(steps: int = 100) -> float:
    """One trainset at a time, over nine of the cases."""
    sections, trainsets = cases()
    pairs = [(section, trainset) for section in sections[::9] for trainset in trainsets]
    plants = [(physics.vehicle_arrays(t), physics.track_arrays(s, t)) for s, t in pairs]
    shares = commands(len(plants), steps)
    dt = np.float64(DT)

    def work() -> None:
        for (vehicle, track), row in zip(plants, shares, strict=True):
            state = physics.at_rest(vehicle)
            for share in row:
                state = physics.step(vehicle, track, state, physics.Command(share), dt)

    return rate(work, len(plants) * steps)


def numpy_rows(batch: int = 78 * REPEATS, steps: int = 40) -> float:
    """A row of states of one trainset on one section."""
    sections, trainsets = cases()
    vehicle = physics.vehicle_arrays(trainsets[0], np.float32)
    track = physics.track_arrays(sections[0], trainsets[0], np.float32)
    start = physics.stack([physics.at_rest(vehicle)] * batch)._replace(
        pipeline=np.zeros((1, batch), np.float32)
    )
    shares = commands(batch, steps).astype(np.float32)
    released = np.zeros(batch, bool)

    def work() -> None:
        state = start
        for k in range(steps):
            state = physics.step(
                vehicle, track, state, physics.Command(shares[:, k], released), np.float32(DT)
            )

    return rate(work, batch * steps, rounds=3)


def measure_batch(dtype: type, steps: int = STEPS) -> dict[str, float]:
    """The batch in this process, on all its devices: steps per second, of the clock and of processor time."""
    import jax

    sections, trainsets = cases()
    with jax.enable_x64(dtype is np.float64):
        vehicles, tracks = physics.grid(sections, trainsets, dtype)
        states = physics.stack([physics.at_rest(physics.vehicle_arrays(trainsets[0], dtype))] * 78)
        trees = jax.tree.map(lambda a: np.tile(a, (REPEATS, *[1] * (a.ndim - 1))), (vehicles, tracks, states))
        shares = commands(78 * REPEATS, steps).astype(dtype)
        batch = physics.spread((*trees, shares))

        def work() -> None:
            jax.block_until_ready(physics.rollout_batch(*batch, DT))

        count = 78 * REPEATS * steps
        return {"wall": rate(work, count), "cpu": rate(work, count, clock=time.process_time)}


def measure() -> list[Row]:
    """Every figure in one run, the baseline first."""
    loop, batch = numpy_loop(), f"{78 * REPEATS:,}"
    single, double, pair = (
        on_devices(n, "benchmarks.plant", "--compiled", name)
        for n, name in ((1, "float32"), (2, "float64"), (2, "float32"))
    )
    unit = "plant steps/s"
    figures = [
        ("NumPy, one trainset at a time, float64", loop, ""),
        (f"NumPy, a row of {batch} states, float32", numpy_rows(), ""),
        (f"compiled batch of {batch}, float32, 1 core", single["wall"], ""),
        ("the same per second of processor time", single["cpu"], ""),
        (f"compiled batch of {batch}, float64, 2 cores", double["wall"], ""),
        (f"compiled batch of {batch}, float32, 2 cores", pair["wall"], f"{TARGET:,.0f}"),
    ]
    return [Row(what, value, unit, value / loop, target) for what, value, target in figures]


BENCHMARK = Benchmark(
    name="plant",
    title="Plant steps per second",
    packages=("metropilot", "jax", "jaxlib", "numpy"),
    measure=measure,
    note=(
        "One step is the whole plant: actuation, effort, resistance over the trainset's length, exact stop, "
        "energies. The batch holds 26 sections x 3 loads, 16 times each, under different commands; "
        "the ratio is to the first row, medians of one run. "
        "With other work on the machine (see its load), the processor time is the better measure."
    ),
)

if __name__ == "__main__":
    if sys.argv[1:2] == ["--compiled"]:
        print(json.dumps(measure_batch(np.dtype(sys.argv[2]).type)))
    else:
        run([BENCHMARK])

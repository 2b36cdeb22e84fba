"""Compare a driver in C with Python, and measure it: drives, hostile states, time, size, sanitizers.

    python tools/aboard.py drives --load AW0 --keep DIR      # 13 drives; --way, --number, --driver, --count
    python tools/aboard.py drives --driver ppo --trainset dkz32@0.5,0.35 --count 3 --keep DIR
    python tools/aboard.py folder --run FOLDER --keep DIR    # the rows of a run's folder driven again
    python tools/aboard.py supervisor --keep DIR             # 10 million states; --seed, --states for batches
    python tools/aboard.py build --keep DIR                  # compilers, sanitizers, time; --driver, --number
    python tools/aboard.py analyse --driver pid --keep DIR   # clang --analyze and cppcheck; --limit
    python tools/aboard.py page --keep DIR --write docs/howto/controller.md

Each part takes a few minutes and keeps its numbers in a folder, with the commit, the date and the load of the
machine; from these the last writes the tables, and names the parts that were measured at another commit.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import re
import resource
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np

from metropilot.aboard import (
    STRICT,
    AboardProgram,
    CompiledDriver,
    compile_driver,
    drive_compiled,
    trace_driver,
    write_driver,
)
from metropilot.drivers import DRIVERS, AbstractPolicyDriver
from metropilot.evaluate import run_from_toml
from metropilot.physics import Command, double_precision, to_jax
from metropilot.policy import LoadedPolicy, load_driving_policy, shipped_policy
from metropilot.protection import LEVELS, Memory, protect, supervise
from metropilot.railway import Section, load_line, load_trainset
from metropilot.sim import AbstractDriver, Rollout, Run, Trajectory

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))
from benchmarks.report import circumstances, write_section  # noqa: E402

LINE, TRAINSET, DRIVER = "yizhuang", "dkz32", "generalist"
STATES, CHUNK = 10_000_000, 200_000
MARGIN_MPS = 2e-3
"""Speed by which the verdicts of a supervisor in single precision may differ."""
STEPS = 1_000_000
REPEATS = 3
"""Times that each step is taken from the same state."""
PRIORITY, LOCK_ALL = 80, 3
"""Real-time priority of a timed step, and the flags MCL_CURRENT | MCL_FUTURE."""
WORST_US = 200.0
"""What the worst of all steps may take."""
WITHOUT_NETWORK = ("eitoe", "pid")
COMMANDS = (1.0, 0.5, 0.0, -0.3, -1.0, 3.0, -7.0, float("inf"), float("-inf"), float("nan"))
ZIG = f"{sys.executable} -m ziglang cc"
ANALYSERS = {
    "clang --analyze": ("clang", "--analyze", "-Xclang", "-analyzer-output=text", "-std=c99"),
    "cppcheck": ("cppcheck", "--max-configs=1", "--enable=warning,portability", "--std=c99", "--quiet"),
}
"""Analysers of the source, as commands; what they print is what they find."""
SANITIZERS = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
MANY = """
#define REPEATS @REPEATS@
#include "@NAME@.h"
#include <math.h>
#include <time.h>
#define BETWEEN_PAUSES 128
#define PAUSE_MS 2
void many(int64_t n, int32_t section, const double *x, const double *v, const double *share,
    const bool *asked, const double *kept, const double *acceleration, const bool *latched,
    const int32_t *before, int32_t *level, bool *emergency, double *out);
void many(int64_t n, int32_t section, const double *x, const double *v, const double *share,
    const bool *asked, const double *kept, const double *acceleration, const bool *latched,
    const int32_t *before, int32_t *level, bool *emergency, double *out)
{
    for (int64_t k = 0; k < n; k++) {
        @NAME@_state state;
        @NAME@_input input = {0};
        @NAME@_output output;
        @NAME@_init(&state, section);
        state.protection.share = (@NAME@_real)kept[k];
        state.protection.acceleration_mps2 = (@NAME@_real)acceleration[k];
        state.protection.emergency = latched[k];
        state.protection.level = before[k];
        input.position_m = (@NAME@_real)x[k];
        input.speed_mps = (@NAME@_real)v[k];
        @NAME@_supervise(&state, &input, (@NAME@_real)share[k], asked[k], &output);
        level[k] = output.level;
        emergency[k] = output.emergency;
        out[k] = (double)output.share;
    }
}
void clocked(int64_t n, int64_t rows, const double *vectors, double *processor_us, double *least_us,
    double *wall_us);
static double us_between(struct timespec a, struct timespec b)
{
    return 1e6 * (double)(b.tv_sec - a.tv_sec) + 1e-3 * (double)(b.tv_nsec - a.tv_nsec);
}
void clocked(int64_t n, int64_t rows, const double *vectors, double *processor_us, double *least_us,
    double *wall_us)
{
    @NAME@_state state, before;
    @NAME@_input input;
    @NAME@_output output;
    const struct timespec pause = {0, PAUSE_MS * 1000000};
    for (int64_t k = 0; k < n; k++) {
        const double *row = vectors + 8 * (k % rows);
        struct timespec a, b, c, d;
        /* a task that never waits would lose its priority now and then, as the system defends itself */
        if (k % BETWEEN_PAUSES == 0) nanosleep(&pause, NULL);
        if (row[1] <= 0.0) @NAME@_init(&state, (int32_t)row[0]);
        input.time_s = (@NAME@_real)row[1];
        input.position_m = (@NAME@_real)row[2];
        input.speed_mps = (@NAME@_real)row[3];
        input.acceleration_mps2 = (@NAME@_real)row[4];
        input.scheduled_s = (@NAME@_real)row[5];
        before = state;
        for (int j = 0; j < REPEATS; j++) {
            double us;
            state = before;
            clock_gettime(CLOCK_MONOTONIC, &a);
            clock_gettime(CLOCK_THREAD_CPUTIME_ID, &b);
            @NAME@_step(&state, &input, &output);
            clock_gettime(CLOCK_THREAD_CPUTIME_ID, &c);
            clock_gettime(CLOCK_MONOTONIC, &d);
            us = us_between(b, c);
            if (j == 0) {
                processor_us[k] = us;
                wall_us[k] = us_between(a, d);
            }
            if (j == 0 || us < least_us[k]) least_us[k] = us;
        }
    }
}
"""
HOSTILE = """
#include "@NAME@.h"
#include <math.h>
#include <stdio.h>
int main(void)
{
    const double extreme[] = {0.0, 1.0, -1.0, 20.0, 700.0, 1e6, -1e6, 1e300, -1e300, 1e-300, INFINITY,
        -INFINITY, NAN};
    uint64_t seed = 2026;
    @NAME@_state state;
    @NAME@_output output;
    long wrong = 0;
    @NAME@_init(&state, 0);
    for (long k = 0; k < 30000; k++) {
        double value[6];
        @NAME@_input input;
        for (int j = 0; j < 6; j++) {
            seed = seed * 6364136223846793005u + 1442695040888963407u;
            value[j] = extreme[(seed >> 40) % (sizeof extreme / sizeof *extreme)];
        }
        input.time_s = (@NAME@_real)value[0];
        input.position_m = (@NAME@_real)value[1];
        input.speed_mps = (@NAME@_real)value[2];
        input.acceleration_mps2 = (@NAME@_real)value[3];
        input.scheduled_s = (@NAME@_real)value[4];
        if (k % 2) @NAME@_step(&state, &input, &output);
        else @NAME@_supervise(&state, &input, (@NAME@_real)value[5], k % 7 == 0, &output);
        wrong += !(output.share >= -1.0 && output.share <= 1.0) || output.level < 0 || output.level > 3;
    }
    printf("%ld", wrong);
    return wrong != 0;
}
"""


def load_driver(name: str) -> AbstractDriver | LoadedPolicy:
    """A driver as it is exported: a shipped policy, or the driver itself."""
    kind = DRIVERS.get(name)
    if issubclass(kind, AbstractPolicyDriver):
        return load_driving_policy(shipped_policy(name))
    return kind()


def export_driver(
    sections: Sequence[Section],
    load: str,
    number: str,
    *,
    many: bool = False,
    name: str = DRIVER,
    trainset: str = TRAINSET,
) -> tuple[Any, Path]:
    """A driver written and compiled; with ``many`` together with the loops of this file."""
    program = trace_driver(name, load_driver(name), sections, load_trainset(trainset, load), number=number)
    folder = Path(mkdtemp(prefix="aboard-"))
    write_driver(program, folder)
    if many:
        source = folder / f"{name}.c"
        loops = MANY.replace("@NAME@", name).replace("@REPEATS@", str(REPEATS))
        source.write_text("#define _GNU_SOURCE\n" + source.read_text() + loops)
    return compile_driver(program, folder), folder


def sections_of(way: str) -> list[Section]:
    """Sections of the leaderboard, one way."""
    return list(load_line(LINE).sections(backward=way == "backward"))


def drive_python(program: AboardProgram, section: Section, *, exact: bool) -> Rollout:
    """The same drive in Python; ``exact``: its network, if it has one, in double precision."""
    driver = program.driver if exact else DRIVERS.get(program.name)()
    return Rollout(Run(section, program.trainset, float(section.planned_time_s or 0.0)), driver)


def compare_drive(driver: CompiledDriver, number: int, *, exact: bool) -> dict[str, float]:
    """Largest differences of one drive from Python's."""
    section = driver.program.sections[number]
    run = drive_compiled(driver, number, float(section.planned_time_s or 0.0))
    rollout = drive_python(driver.program, section, exact=exact)
    worst, last = 0.0, len(run.states) - 1
    for k, state in enumerate(run.states):
        if rollout.outcome is None:
            rollout.advance()
        if k < last:
            worst = max(worst, abs(float(state.plant.position_m - rollout.state.plant.position_m)))
    while rollout.outcome is None:
        rollout.advance()
    end, python = run.states[-1], rollout.state
    return {
        "position_m": worst,
        "stop_m": abs(float(end.plant.position_m - python.plant.position_m)),
        "time_s": abs(float(end.stood_since_s - python.stood_since_s)),
        "energy": abs(float(end.plant.traction_j / python.plant.traction_j) - 1.0),
        "outcome": float(end.outcome != python.outcome),
        "overruled": float(sum(answer.level > 0 for answer in run.supervised)),
    }


def measure_drives(
    name: str, trainset: str, load: str, way: str, number: str, count: int | None
) -> dict[str, Any]:
    """Sections one way with a load; in double against both networks of Python, in single and double."""
    found: dict[str, Any] = {}
    driver, _ = export_driver(sections_of(way)[:count], load, number, name=name, trainset=trainset)
    for kind, exact in (("exact", True), ("shipped", False)):
        if number == "double" or not exact:
            rows = [compare_drive(driver, k, exact=exact) for k in range(len(driver.program.sections))]
            worst = {key: max(row[key] for row in rows) for key in rows[0]}
            found[f"{number}_{kind}"] = worst | {"runs": len(rows)}
            print(name, trainset, load, way, number, kind, worst, flush=True)
    return found


def measure_folder(folder: Path) -> dict[str, Any]:
    """The rows of a run's folder driven again: its measurements period by period, and its commands.

    Args:
        folder: What ``metropilot drive --out`` wrote; without noise, as that is not in it.
    """
    spec = run_from_toml(folder / "run.toml").resolve()
    run, rows = spec.run(), Trajectory.read(folder / "trajectory.csv")
    program = trace_driver(spec.driver, load_driver(spec.driver), [run.section], run.trainset, dt_s=run.dt)
    scratch = Path(mkdtemp(prefix="aboard-"))
    write_driver(program, scratch)
    driver = compile_driver(program, scratch)
    driver.init(0)
    command, permitted, other = 0.0, 0.0, 0
    # a row has the acceleration of the step that starts there, a driver measures that of the one before
    before = np.concatenate([[0.0], rows.acceleration_mps2[:-1]])
    columns = (rows.time_s, rows.position_m, rows.speed_mps, before)
    last = len(rows.time_s) - 1
    for k in range(last):
        time_s, position_m, speed_mps, acceleration_mps2 = (float(column[k]) for column in columns)
        answer = driver.step(time_s, position_m, speed_mps, acceleration_mps2, run.scheduled_time_s)
        command = max(command, abs(answer.share - float(rows.command[k])))
        permitted = max(permitted, abs(answer.permitted_mps - float(rows.permitted_mps[k])))
        other += answer.level > 0
    found = {
        "driver": spec.driver,
        "rows": last,
        "command": command,
        "permitted_mps": permitted,
        "other": other,
    }
    print(found, flush=True)
    return found


def random_states(rng: np.random.Generator, guard: Any, count: int) -> dict[str, np.ndarray]:  # noqa: ANN401
    """States about the curves, and hostile commands and measurements."""
    at = float(guard.start_m) + float(guard.spacing_m) * np.arange(guard.permitted_mps.size)
    x = rng.uniform(at[0] - 20.0, at[int(np.flatnonzero(guard.permitted_mps)[-1])] + 40.0, count)
    near = np.interp(x, at, np.sqrt(2.0 * guard.emergency)) + rng.normal(0.0, 0.6, count)
    v = np.where(rng.random(count) < 0.7, np.maximum(near, 0.0), rng.uniform(0.0, 28.0, count))
    v = np.where(rng.random(count) < 0.05, 0.0, v)
    share = np.where(rng.random(count) < 0.5, rng.choice(COMMANDS, count), rng.uniform(-1.2, 1.2, count))
    lost = rng.random(count) < 0.01
    return {
        "x": np.where(lost, rng.choice([np.nan, np.inf, -np.inf], count), x),
        "v": np.where(rng.random(count) < 0.01, rng.choice([np.nan, np.inf], count), v),
        "share": share,
        "asked": rng.random(count) < 0.01,
        "kept": rng.uniform(-1.0, 1.0, count),
        "acceleration": rng.uniform(-1.5, 1.2, count),
        "latched": rng.random(count) < 0.05,
        "before": rng.integers(0, 4, count, np.int32),
    }


def call_many(driver: CompiledDriver, states: dict[str, np.ndarray]) -> tuple[np.ndarray, ...]:
    """Answers of the compiled supervisor."""
    count = states["x"].size
    out = np.zeros(count, np.int32), np.zeros(count, np.bool_), np.zeros(count)
    pointers = [np.ascontiguousarray(a).ctypes.data_as(ctypes.c_void_p) for a in (*states.values(), *out)]
    driver.library.many(ctypes.c_int64(count), ctypes.c_int32(0), *pointers)
    return out


def measure_supervisor(count: int, seed: int) -> dict[str, Any]:
    """Verdicts of Python and C; where the compiled Python differs, NumPy decides."""
    import jax

    section, load = load_line(LINE).section("RJ", "WYJ"), "AW2"
    double, _ = export_driver([section], load, "double", many=True)
    single, _ = export_driver([section], load, "float", many=True)
    guard = protect(section, double.program.trainset, double.program.bounds)

    def verdict(guard: Any, s: dict[str, Any]) -> Any:  # noqa: ANN401 (arrays)
        memory = Memory(guard.slots, s["kept"], s["acceleration"], s["latched"], s["before"], 0, 0, 0)
        command, _, found = supervise(guard, memory, s["x"], s["v"], Command(s["share"], s["asked"]))
        return found.level, command.emergency, command.share

    rng = np.random.default_rng(seed)
    different, less, beyond, levels = 0, 0, 0, np.zeros(len(LEVELS), int)
    with double_precision(), jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        batch = jax.jit(jax.vmap(partial(verdict, to_jax(guard))))
        for first in range(0, count, CHUNK):
            states = random_states(rng, guard, min(CHUNK, count - first))
            python = [np.asarray(a) for a in batch(states)]
            c = call_many(double, states)
            off = np.flatnonzero((python[0] != c[0]) | (python[1] != c[1]) | (python[2] != c[2]))
            for k in off:
                one = {name: values[k].item() for name, values in states.items()}
                with np.errstate(all="ignore"):
                    host = verdict(guard, one)
                different += (int(host[0]), bool(host[1]), float(host[2])) != tuple(a[k].item() for a in c)
            levels += np.bincount(c[0], minlength=len(LEVELS))
            looser = np.flatnonzero(call_many(single, states)[0] < c[0])
            less += looser.size
            slower = {name: values[looser] for name, values in states.items()}
            found = call_many(single, slower)[0]
            slower["v"] = np.maximum(slower["v"] - MARGIN_MPS, 0.0)
            beyond += int((call_many(double, slower)[0] > found).sum())
            print(first, different, less, beyond, flush=True)
    return {
        "states": count,
        "different": different,
        "float_less": less,
        "float_beyond": beyond,
        "levels": levels.tolist(),
    }


def call(folder: Path, *command: str) -> tuple[bool, str]:
    """Run a command in a folder: whether it succeeded, and what it said."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode == 0, done.stdout + done.stderr


def stack_bytes(text: str, name: str) -> int:
    """Stack of a step from the report of gcc: step, the larger of what it calls, and all that these call."""
    used = {m[1]: int(m[2]) for m in re.finditer(r":(\w+)[.\w]*\t(\d+)\t", text)}
    large = (f"{name}_step", "decide", f"{name}_supervise")
    helpers = sum(size for function, size in used.items() if function not in large)
    return used[large[0]] + max(used.get("decide", 0), used[large[2]]) + helpers


@contextmanager
def real_time() -> Iterator[bool]:
    """Let this thread run before all others, its memory in place, as a controller's; tell whether it does."""
    libc = ctypes.CDLL(None)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, PermissionError):
        yield False
        return
    libc.mlockall(LOCK_ALL)
    try:
        yield True
    finally:
        libc.munlockall()
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def measure_build(name: str, trainset: str, number: str, second: str) -> dict[str, Any]:
    """Compilers, sanitizers, size, stack and time of one section.

    Args:
        name: Driver.
        trainset: Trainset.
        number: Number type.
        second: Command of the second compiler.
    """
    section = load_line(LINE).section("RJ", "WYJ")
    driver, folder = export_driver([section], "AW2", number, many=True, name=name, trainset=trainset)
    vectors = np.loadtxt(folder / "vectors.csv", delimiter=",", skiprows=1)
    us, least_us, wall_us = np.zeros(STEPS), np.zeros(STEPS), np.zeros(STEPS)
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (vectors, us, least_us, wall_us)]
    with real_time() as first:
        driver.library.clocked(ctypes.c_int64(STEPS), ctypes.c_int64(len(vectors)), *pointers)
    print(number, np.median(us), us.max(), least_us.max(), np.median(wall_us), wall_us.max(), flush=True)
    write_driver(driver.program, folder)
    (folder / "hostile.c").write_text(HOSTILE.replace("@NAME@", name))
    builds = {}
    for kind, compiler in {"clang": second, "gcc": "cc -fstack-usage"}.items():
        built, _ = call(folder, "make", "clean", "check", "example", f"CC={compiler}")
        builds[kind] = built
    _, size = call(folder, "size", f"{name}.o")
    stack = stack_bytes((folder / f"{name}.su").read_text(), name)
    good, said = call(folder, "make", "clean", "check", "example", "SANITIZE=1")
    hostile = [*STRICT, *SANITIZERS, "hostile.c", f"{name}.o", "-lm", "-o", "hostile"]
    for command in (("./example",), ("cc", *hostile), ("./hostile",)):
        good, more = call(folder, *command) if good else (False, "")
        said += more
    if not good:
        print(said[-1500:])
    return {
        "median_us": float(np.median(us)),
        "p999_us": float(np.quantile(us, 0.999)),
        "worst_us": float(us.max()),
        "least_worst_us": float(least_us.max()),
        "beyond_wanted": int((us > WORST_US).sum()),
        "least_beyond_wanted": int((least_us > WORST_US).sum()),
        "real_time": first,
        "wall_p999_us": float(np.quantile(wall_us, 0.999)),
        "wall_worst_us": float(wall_us.max()),
        "object_bytes": sum(map(int, size.splitlines()[1].split()[:2])),
        "stack_bytes": stack,
        "builds": builds,
        "sanitized": good,
    }


def drive_rows(drives: Sequence[dict[str, Any]], name: str, trainset: str) -> list[tuple[str, str, str]]:
    """Rows of the drives of one driver aboard one trainset."""
    whose = f"`{name}`" if trainset == TRAINSET else f"`{name}` aboard {trainset}"

    def most(kind: str, key: str) -> float:
        return max(each[kind][key] for each in drives if kind in each)

    def count(kind: str) -> int:
        return sum(each[kind]["runs"] for each in drives if kind in each)

    odd = sum(value["outcome"] + value["overruled"] for each in drives for value in each.values())
    said, rows = f"{whose}, {{}} drives: position", []
    if count("double_exact"):
        first = said.format(count("double_exact"))
        words = ", network of Python in double precision" if name not in WITHOUT_NETWORK else ""
        rows.append((f"{first}{words}", f"{most('double_exact', 'position_m'):.0e} m", "1e-9 m"))
        if name not in WITHOUT_NETWORK:
            rows.append(
                (
                    "position; energy of traction; network of Python in single precision",
                    f"{most('double_shipped', 'position_m'):.0e} m; {most('double_shipped', 'energy'):.0e}",
                    "–",
                )
            )
    if count("float_shipped"):
        rows += [
            (
                f"{whose} in `float`, {count('float_shipped')} drives: position at the stop",
                f"{1e3 * most('float_shipped', 'stop_m'):.1f} mm",
                "5 mm",
            ),
            ("`float`: arrival", f"{most('float_shipped', 'time_s'):.3f} s", "0.05 s"),
            ("`float`: position on the way", f"{1e3 * most('float_shipped', 'position_m'):.1f} mm", "–"),
        ]
    return [*rows, (f"{whose}: drives with another outcome, or overruled by protection", f"{odd:.0f}", "0")]


def folder_rows(found: Sequence[dict[str, Any]]) -> list[tuple[str, str, str]]:
    """Rows of the folders of runs."""
    return [
        (
            f"folder of a run of `{each['driver']}`, {each['rows']} periods: command; permitted speed",
            f"{each['command']:.0e}; {each['permitted_mps']:.0e} m/s",
            "–",
        )
        for each in found
    ]


def state_rows(found: Sequence[dict[str, Any]]) -> list[tuple[str, str, str]]:
    """Rows of the supervisor, its batches together."""
    keys = ("states", "different", "float_less", "float_beyond")
    state = {key: sum(each[key] for each in found) for key in keys}
    return [
        (f"{state['states']:,} random and hostile states: other verdicts", f"{state['different']}", "0"),
        (
            f"`float`: verdicts milder by more than {1e3 * MARGIN_MPS:g} mm/s; milder at all",
            f"{state['float_beyond']}; {state['float_less']}",
            "0",
        ),
    ]


def measure_analysis(name: str, trainset: str, kind: str, limit_s: int) -> dict[str, Any]:
    """Findings of analysers in the source of one section, and the processor time that they take.

    Args:
        name: Driver.
        trainset: Trainset.
        kind: Number type.
        limit_s: Longest processor time of an analyser, s.
    """
    _, folder = export_driver(
        [load_line(LINE).section("RJ", "WYJ")], "AW2", kind, name=name, trainset=trainset
    )
    found = {}
    for tool, command in ANALYSERS.items():
        version = call(folder, command[0], "--version")[1].splitlines()[0]
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(
            [*command, f"{name}.c"],
            cwd=folder,
            capture_output=True,
            text=True,
            check=False,
            preexec_fn=partial(resource.setrlimit, resource.RLIMIT_CPU, (limit_s, limit_s)),
        )
        lines = (done.stdout + done.stderr).strip().splitlines()
        # a process that the limit ended has a signal for a status
        said = lines if done.returncode >= 0 else None
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        print(name, tool, seconds, said if said is None else said[:5], flush=True)
        found[tool] = {
            "version": re.sub(r"[^.\d]*([.\d]+).*", r"\1", version),
            "seconds": seconds,
            "said": said,
        }
    return found


BUILD_HEADS = (
    "driver",
    "trainset",
    "number",
    "object file, network included",
    "stack",
    "median",
    "99.9 %",
    f"worst; beyond {WORST_US:g} µs",
    f"the least of {REPEATS} calls from one state: worst; beyond {WORST_US:g} µs",
    "by the wall, 99.9 %; worst",
    "no warning, vectors right",
    "sanitizers",
)
WANTED = (
    "wanted",
    "",
    "",
    "300 kB",
    "16 kB",
    "100 µs",
    "–",
    "200 µs; 0",
    "200 µs; 0",
    "–",
    "two compilers",
    "clean",
)


def build_row(driver: str, trainset: str, number: str, build: dict[str, Any]) -> tuple[str, ...]:
    """Row of a build."""
    return (
        f"`{driver}`",
        trainset,
        number,
        f"{build['object_bytes'] / 1e3:.0f} kB",
        f"{build['stack_bytes'] / 1e3:.1f} kB",
        f"{build['median_us']:.0f} µs",
        f"{build['p999_us']:.0f} µs",
        f"{build['worst_us']:,.0f} µs; {build['beyond_wanted']}",
        f"{build['least_worst_us']:,.0f} µs; {build['least_beyond_wanted']}",
        f"{build['wall_p999_us']:.0f} µs; {build['wall_worst_us']:,.0f} µs",
        ", ".join(name for name, good in build["builds"].items() if good),
        "clean" if build["sanitized"] else "no",
    )


def analysis_rows(driver: str, found: dict[str, Any]) -> list[tuple[str, str, str]]:
    """Rows of the analysers of one source."""
    rows = []
    for tool, one in found.items():
        # that it checks one configuration, as it was told, is no finding
        said = None if one["said"] is None else [line for line in one["said"] if "information:" not in line]
        words = f"`{driver}`: {tool}, {one['version']}"
        result = "no end" if said is None else f"{len(said)} lines" if said else "nothing"
        rows.append((words, f"{result} in {one['seconds']:.1f} s of processor time", "nothing"))
    return rows


def read_parts(kept: Path) -> tuple[dict[str, Any], dict[str, dict[str, str]]]:
    """Values and circumstances of each part, by its name.

    Raises:
        SystemExit: A part does not say how it was measured, or there is none.
    """
    values, about = {}, {}
    for path in sorted(kept.glob("*.json")):
        part = json.loads(path.read_text())
        if set(part) != {"circumstances", "values"}:
            sys.exit(f"{path}: does not say at which commit it was measured; measure it again")
        values[path.stem], about[path.stem] = part["values"], part["circumstances"]
    if not values:
        sys.exit(f"{kept}: nothing was measured")
    return values, about


def describe_circumstances(about: Mapping[str, Mapping[str, str]]) -> str:
    """Sentence on the circumstances: dates and loads of all parts, the commit, and parts of another one."""
    by_commit = defaultdict(list)
    for name, one in about.items():
        by_commit[one["commit"]].append(name)
    most, *others = sorted(by_commit, key=lambda commit: -len(by_commit[commit]))
    loads = sorted(float(one["load"]) for one in about.values())
    dates = sorted({one["date"] for one in about.values()})
    said = {
        "machine": " and ".join(sorted({one["machine"] for one in about.values()})),
        "load": f"{loads[0]:.1f} to {loads[-1]:.1f}",
        "date": dates[0] if len(dates) == 1 else f"{dates[0]} to {dates[-1]}",
        "commit": most,
        "versions": " and ".join(sorted({one["versions"] for one in about.values()})),
    }
    text = f"Measured on {'; '.join(f'{key}: {value}' for key, value in said.items())}."
    if others:
        words = "; ".join(f"{commit}: {', '.join(by_commit[commit])}" for commit in others)
        text += f" **Parts of another commit**: {words}."
    return text


def format_table(heads: Sequence[str], rows: Sequence[Sequence[str]], texts: int = 1) -> list[str]:
    """Lines of a table, the first columns texts."""
    rule = "|" + "---|" * texts + "---:|" * (len(heads) - texts)
    return [f"| {' | '.join(heads)} |", rule, *(f"| {' | '.join(row)} |" for row in rows)]


REAL_TIME = "at a real-time priority, memory locked, 2 ms of waiting after every 128"


def page(kept: Path) -> str:
    """The tables of what was kept."""
    values, about = read_parts(kept)
    rows = []
    drives = [name for name in values if name.startswith("drives-")]
    for driver, trainset in sorted({tuple(name.split("-")[1:3]) for name in drives}):
        found = [values[name] for name in drives if name.startswith(f"drives-{driver}-{trainset}-")]
        rows += drive_rows(found, driver, trainset)
    rows += folder_rows([value for name, value in values.items() if name.startswith("folder-")])
    if states := [value for name, value in values.items() if name.startswith("supervisor")]:
        rows += state_rows(states)
    for name in sorted(name for name in values if name.startswith("analyse-")):
        _, driver, trainset, _ = name.split("-", 3)
        said = driver if trainset == TRAINSET else f"{driver} aboard {trainset}"
        rows += analysis_rows(said, values[name])
    builds = []
    for name in sorted(name for name in values if name.startswith("build-")):
        _, driver, trainset, number = name.split("-", 3)
        builds.append(build_row(driver, trainset, number, values[name]))
    lines = format_table(("what: largest difference or amount", "measured", "wanted"), rows)
    lines += ["", *format_table(BUILD_HEADS, [*builds, WANTED], 3), ""]
    said = f"{LINE} with {TRAINSET}; `{DRIVER}` for states, and one section for these, builds and analysers."
    timed = [value for name, value in values.items() if name.startswith("build-")]
    if timed:
        alone = all(value["real_time"] for value in timed)
        said += f" {STEPS:,} steps timed {REAL_TIME if alone else 'at the priority of every other program'}."
    return "\n".join([*lines, f"{said} {describe_circumstances(about)}"])


def main() -> None:
    """Measure one part, or write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("part", choices=("drives", "folder", "supervisor", "build", "analyse", "page"))
    parser.add_argument("--load", default="AW2", help="load aboard, of drives")
    parser.add_argument("--way", default="forward", help="forward or backward, of drives")
    parser.add_argument("--number", default="double", help="number type, of the same")
    parser.add_argument("--states", type=int, default=STATES, help="states, of the supervisor")
    parser.add_argument("--seed", type=int, default=2026, help="seed of the states")
    parser.add_argument("--driver", default=DRIVER, help="driver, of drives, build and analyse")
    parser.add_argument("--trainset", default=TRAINSET, help="trainset, of the same; ID@DELAY,LAG")
    parser.add_argument("--count", type=int, help="sections, of drives; all if not given")
    parser.add_argument("--run", type=Path, metavar="FOLDER", help="folder of a run, of folder")
    parser.add_argument("--limit", type=int, default=300, help="longest processor time of an analyser, s")
    parser.add_argument("--second", default=ZIG, metavar="CC", help="second compiler, of build")
    parser.add_argument("--keep", type=Path, required=True, metavar="DIR")
    parser.add_argument("--write", type=Path, metavar="PAGE")
    options = parser.parse_args()
    if options.part == "page":
        write_section(options.write, "aboard", page(options.keep))
        return
    measures = {
        "drives": lambda: measure_drives(
            options.driver, options.trainset, options.load, options.way, options.number, options.count
        ),
        "folder": lambda: measure_folder(options.run),
        "supervisor": lambda: measure_supervisor(options.states, options.seed),
        "build": lambda: measure_build(options.driver, options.trainset, options.number, options.second),
        "analyse": lambda: measure_analysis(options.driver, options.trainset, options.number, options.limit),
    }
    more = {
        "drives": f"-{options.driver}-{options.trainset}-{options.load}-{options.way}-{options.number}",
        "folder": f"-{options.run.name}" if options.run else "",
        "supervisor": f"-{options.seed}",
        **dict.fromkeys(("build", "analyse"), f"-{options.driver}-{options.trainset}-{options.number}"),
    }
    name = options.part + more.get(options.part, "")
    options.keep.mkdir(parents=True, exist_ok=True)
    # before it runs, so that the load is that of others, and the commit that of the code which runs
    about = circumstances(("jax", "numpy"))
    about |= {"load": f"{os.getloadavg()[0]:.1f}", "machine": about["machine"].rpartition(", load")[0]}
    part = {"circumstances": about, "values": measures[options.part]()}
    (options.keep / f"{name}.json").write_text(json.dumps(part))


if __name__ == "__main__":
    main()

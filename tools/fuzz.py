"""Coverage-guided fuzzing of every file metropilot reads.

    python tools/fuzz.py --inputs 100000
    python tools/fuzz.py policy=200000 toml=10000

Needs atheris (`pip install atheris`) beside the development environment; what is fuzzed and how real files
are damaged is in `tests/fuzz`. Each target runs in a process of its own, its memory limited, guided by the
branches of metropilot it reaches. What fails is written to `tests/fuzz/corpus/TARGET/`, where
the tests replay it, and counted in the table at the end.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import resource
import subprocess
import sys
import time
import traceback
from importlib import import_module
from pathlib import Path
from random import Random
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
CORPUS = ROOT / "tests" / "fuzz" / "corpus"
SLOW_S, MEMORY_BYTES = 2.0, 4 << 30
PACKAGES = (
    *(
        "metropilot.errors",
        "metropilot.railway",
        "metropilot.policy",
        "metropilot.env.policy_interface",
    ),
    *("metropilot.evaluate.run_spec", "metropilot.sim.trajectory"),
    *(
        "metropilot.campaign",
        "metropilot.learn.run_store",
        "metropilot.learn.checkpoint",
        "metropilot.cli.show",
    ),
)


class Log:
    """Record of one target: inputs, accepted ones, and each different failure once, as a file."""

    def __init__(self, name: str) -> None:
        self.name, self.inputs, self.accepted, self.slowest_s = name, 0, 0, 0.0
        self.failures: dict[str, str] = {}
        self.began = time.process_time()

    def keep_failure(self, error: BaseException, data: bytes) -> None:
        """Keep the first input of each place that fails."""
        frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename.startswith(str(ROOT))]
        last = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
        place = f"{type(error).__name__} {last}"
        if place not in self.failures:
            self.failures[place] = str(error)[:200]
            folder = CORPUS / self.name
            folder.mkdir(parents=True, exist_ok=True)
            (folder / hashlib.sha256(data).hexdigest()[:12]).write_bytes(data)

    def row(self) -> dict[str, Any]:
        """For the table."""
        mega = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        counts = {"inputs": self.inputs, "accepted": self.accepted, "failures": self.failures}
        spent = {"cpu_s": round(time.process_time() - self.began, 1), "slowest_s": round(self.slowest_s, 3)}
        return {"target": self.name, **counts, **spent, "memory_mb": round(mega)}


def fuzz(name: str, inputs: int, seed: int) -> None:
    """Fuzz one target in this process, which ends with it; the last line of the output is its row."""
    atheris: Any = import_module("atheris")

    sys.path[:0] = [str(ROOT / "src"), str(ROOT)]
    with atheris.instrument_imports(include=list(PACKAGES)):
        from tests.fuzz.mutate import damaged
        from tests.fuzz.targets import TARGETS, check

        target = TARGETS[name]
        seeds = target.seeds()
        for data in seeds:
            if not check(name, data):
                raise SystemExit(f"{name}: a real file is refused")
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    log = Log(name)

    def one(data: bytes) -> None:
        began = time.process_time()
        log.inputs += 1
        try:
            log.accepted += check(name, data)
        except Exception as error:  # noqa: BLE001 (what must not come out is anything)
            log.keep_failure(error, data)
        spent = time.process_time() - began
        log.slowest_s = max(log.slowest_s, spent)
        if spent > SLOW_S:
            log.keep_failure(TimeoutError(f"{spent:.1f} s"), data)
        if log.inputs >= inputs:
            sys.stdout.write(json.dumps(log.row()) + "\n")
            sys.stdout.flush()

    def mutate(data: bytes, most: int, number: int) -> bytes:
        random = Random(number)
        begin = random.choice(seeds) if len(data) < 2 or random.random() < 0.2 else data
        return damaged(begin, target.kind, random)[: max(most, 1)]

    options = [f"-runs={inputs}", f"-seed={seed}", "-max_len=1000000", "-len_control=0", "-verbosity=0"]
    options += ["-rss_limit_mb=0", "-timeout=60", "-print_final_stats=0"]
    atheris.Setup([sys.argv[0], *options], one, custom_mutator=mutate)
    atheris.Fuzz()


def main() -> None:
    """Fuzz the targets one after the other and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "targets", nargs="*", help="all of them by default; TARGET=INPUTS for a number of its own"
    )
    parser.add_argument("--inputs", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    told = parser.parse_args()
    if told.one:
        fuzz(told.targets[0], told.inputs, told.seed)
        return
    sys.path[:0] = [str(ROOT / "src"), str(ROOT)]
    from tests.fuzz.targets import TARGETS

    rows = []
    for text in told.targets or list(TARGETS):
        name, _, count = text.partition("=")
        command = [sys.executable, __file__, name, "--one", "--inputs", count or str(told.inputs)]
        done = subprocess.run(
            [*command, "--seed", str(told.seed)], capture_output=True, text=True, check=False
        )
        lines = [line for line in done.stdout.splitlines() if line.startswith('{"target"')]
        row = json.loads(lines[-1]) if lines else {"target": name, "died": done.stderr[-2000:]}
        print(json.dumps(row), flush=True)
        rows.append(row)
    failures = sum(len(row.get("failures", "x")) for row in rows)
    print(f"{sum(row.get('inputs', 0) for row in rows)} inputs, {failures} failures")
    raise SystemExit(failures > 0)


if __name__ == "__main__":
    main()

"""How long a user waits: `metropilot --help` (target 0.3 s) and a second `metropilot drive` (target 3 s).

python -m benchmarks.startup
"""

import statistics
import subprocess
import sys
import time
from pathlib import Path

RUNS = 9
PROGRAM = Path(sys.executable).with_name("metropilot")
CASES = (
    ("--help", ("--help",), 0.3),
    ("drive, flat_out", ("drive", "yizhuang", "RJ", "WYJ", "--time", "101", "--driver", "flat_out"), 3.0),
    ("drive, optimal", ("drive", "yizhuang", "RJ", "WYJ", "--time", "101", "--driver", "optimal"), 3.0),
    ("drive, optimal, --out", ("drive", "yizhuang", "RJ", "WYJ", "--time", "101", "--out", "{out}"), 3.0),
)


def median_s(arguments: tuple[str, ...], runs: int = RUNS) -> float:
    """Median wall time of a command in fresh processes, after one that warms the file cache, s."""
    seconds = []
    for _ in range(runs + 1):
        began = time.perf_counter()
        subprocess.run([PROGRAM, *arguments], capture_output=True, check=False)
        seconds.append(time.perf_counter() - began)
    return statistics.median(seconds[1:])


def main() -> None:
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as out:
        for name, arguments, target_s in CASES:
            seconds = median_s(tuple(a.format(out=out) for a in arguments))
            verdict = "ok" if seconds <= target_s else "TOO SLOW"
            print(f"{name:24} {seconds:6.3f} s   target {target_s:g} s   {verdict}")


if __name__ == "__main__":
    main()

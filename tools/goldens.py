"""Record what metropilot drives, to the bit, and compare another commit with it.

`python tools/goldens.py record FOLDER` drives through the command line only, so that the same file serves
before and after modules have moved; `python tools/goldens.py compare BEFORE AFTER` names every difference.
Meant for changes that must not move a number. Times that the machine took are left out.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

SECTION = ("yizhuang", "RJ", "WYJ", "--time", "101")
DISTURBED = ("--mass-factor", "1.15", "--resistance-factor", "1.2", "--delay", "0.6", "--lag", "0.4")
WEATHER = ("--headwind", "8", "--adhesion", "0.07", "--speed-noise", "0.05", "--seed", "3")
UPDATES = ("--restriction", "600-800@40@20", "--arrive", "116@30")
PLANNERS = ("optimal", "mpc", "generalist", "eitop", "manual")
OWN_SECTIONS = {
    "dqn": ("yizhuang", "WHY", "WYJ", "--time", "130"),
    "improved_dqn": ("yizhuang", "WHY", "WYJ", "--time", "130"),
    "pid_lu2023": ("yizhuang", "WHY", "WYJ", "--time", "130"),
}
LEARNERS = (
    ("ppo", "--steps", "600000"),
    ("dqn", "--steps", "20000"),
    ("sac", "--steps", "20000"),
    ("eitop", "--steps", "49152"),
)
CONVOYS = (
    ("--trainsets", "3"),
    ("--trainsets", "3", "--driver", "sac_pid", "--link-delay", "0.3", "--link-loss", "0.1"),
)
STUDIES = ("cheng2023",)
OF_THE_MACHINE = re.compile(
    r"decision|seconds|created|written|commit|date|started|version|machine|^path$|^folder$|^out$|"
    r"^deviations$|^remarks$"
)


def commands() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Every command with the name its results go by."""
    listed = json.loads(_run("drivers", "--json").stdout)
    for driver in sorted(row["id"] for row in listed):
        if driver != "learned":
            where = OWN_SECTIONS.get(driver, SECTION)
            yield f"drive-{driver}", ("drive", *where, "--driver", driver)
    for driver in PLANNERS:
        for name, more in (("disturbed", DISTURBED), ("weather", WEATHER), ("updates", UPDATES)):
            long = ("--time", "125") if name == "updates" else ()
            yield (
                f"drive-{driver}-{name}",
                ("drive", *SECTION[:3], *(long or SECTION[3:]), "--driver", driver, *more),
            )
    for k, more in enumerate(CONVOYS):
        yield f"convoy-{k}", ("convoy", *SECTION, *more)
    for driver, *more in LEARNERS:
        yield f"learn-{driver}", ("learn", driver, *more)
    for study in STUDIES:
        yield f"reproduce-{study}", ("reproduce", study, "--budget", "quick")
    yield "plan", ("plan", *SECTION)


def record(folder: Path) -> None:
    """Run every command into a folder of its own."""
    folder.mkdir(parents=True, exist_ok=True)

    def one(item: tuple[str, tuple[str, ...]]) -> None:
        name, command = item
        out = folder / name
        shutil.rmtree(out, ignore_errors=True)
        more = () if command[0] == "plan" else ("--out", str(out))
        done = _run(*command, *more, "--json")
        (folder / f"{name}.json").write_text(done.stdout or done.stderr[-2000:])
        print(name, done.returncode, flush=True)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(one, commands()))


def compare(before: Path, after: Path) -> int:
    """Name what differs; the number of differences."""
    found = 0
    for old in sorted(before.rglob("*")):
        new = after / old.relative_to(before)
        if old.suffix not in {".json", ".csv", ".safetensors", ".npz"}:
            continue
        same = new.exists() and _digest(old) == _digest(new)
        if not same:
            found += 1
            print(f"{old.relative_to(before)}: {'differs' if new.exists() else 'missing'}")
    print(f"{found} differences")
    return found


def _digest(path: Path) -> str:
    data = path.read_bytes()
    if path.suffix == ".json":
        with contextlib.suppress(json.JSONDecodeError):
            data = json.dumps(_keep(json.loads(data)), sort_keys=True).encode()
    if path.suffix == ".safetensors":  # the header holds provenance; the numbers follow it
        data = data[8 + int.from_bytes(data[:8], "little") :]
    return hashlib.sha256(data).hexdigest()


def _keep(value: Any) -> Any:  # noqa: ANN401 (any JSON)
    if isinstance(value, dict):
        return {k: _keep(v) for k, v in value.items() if not OF_THE_MACHINE.search(k)}
    if isinstance(value, list):
        return [_keep(v) for v in value]
    return value


def _run(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "metropilot", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False)


if __name__ == "__main__":
    if sys.argv[1] == "record":
        record(Path(sys.argv[2]))
    else:
        sys.exit(1 if compare(Path(sys.argv[2]), Path(sys.argv[3])) else 0)

"""Remove each guard of protection in turn and see which test notices.

    python tools/mutate_guards.py --write docs/safety.md      # all of them, half an hour
    python tools/mutate_guards.py --only "dead time"          # those whose name holds this

The source is copied, one line of the copy is changed, and the tests named for the guard run against the copy;
if they pass, all tests of protection do. ``--write`` keeps the rows of other guards. The guards are in
`tools/guards.py`. One whose removal no test notices is a test that is missing.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import re
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import jax  # noqa: F401 (loaded once, for all children)
import pytest
import scipy.optimize  # noqa: F401
from guards import ALL, GUARDS, ROOT, Guard, remove_guard


@dataclass(frozen=True)
class Mutant:
    """Result of one guard's removal.

    Attributes:
        guard: The guard.
        noticed: First test that failed; empty: none did.
        seconds: How long it took.
    """

    guard: Guard
    noticed: str
    seconds: float


def mutate(guard: Guard) -> Mutant:
    """Remove one guard from a copy of the package and run its tests against that."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="metropilot-guard-") as folder:
        copy = Path(folder, "src")
        shutil.copytree(ROOT / "src", copy, ignore=shutil.ignore_patterns("__pycache__"))
        path = copy / "metropilot" / guard.file
        path.write_text(remove_guard(path.read_text(), guard))
        noticed = first_failure(copy, guard.tests) or first_failure(copy, ALL)
    return Mutant(guard, noticed, time.monotonic() - began)


def first_failure(source: Path, tests: tuple[str, ...]) -> str:
    """The first test that fails against this source; empty: none."""
    report = source / "report.txt"
    child = multiprocessing.get_context("fork").Process(target=_run, args=(source, tests, report))
    child.start()
    child.join()
    said = report.read_text()
    if child.exitcode == 0:
        return ""
    found = re.search(r"^(?:FAILED|ERROR) tests/protection/(.+?)(?: - .*)?$", said, re.MULTILINE)
    if child.exitcode != 1 or not found:
        raise RuntimeError(said[-2000:])
    return found[1]


def _run(source: Path, tests: tuple[str, ...], report: Path) -> None:
    """In a process of its own: nothing of metropilot is loaded yet, and the copy comes first."""
    sys.path[:0] = [str(source), str(ROOT)]
    os.chdir(ROOT)
    with report.open("w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
        options = ["-x", "-q", "-p", "no:cacheprovider", "--no-header", "--tb=no"]
        code = pytest.main([*options, *(f"tests/protection/{test}" for test in tests)])
        sys.stdout.flush()
        os._exit(int(code))


def row(guard: Guard, noticed: str) -> str:
    """A guard's row of the table."""
    test = f"`{noticed}`" if noticed else "**none**"
    return f"| {guard.hazard} | {guard.name} | `{guard.file}` | {test} |"


def table(rows: dict[str, str]) -> str:
    """The table of the page: the row of each guard by its name, in the order of the list."""
    lines = ["| hazard | guard removed | in | first test that fails |", "|---|---|---|---|"]
    lines += [rows[guard.name] for guard in GUARDS if guard.name in rows]
    survived = sum("**none**" in line for line in lines)
    count = len(lines) - 2
    lines += ["", f"{count} guards removed, {count - survived} noticed, {survived} survived."]
    if missing := [guard.name for guard in GUARDS if guard.name not in rows]:
        lines += ["", "Not run yet: " + "; ".join(missing) + "."]
    return "\n".join(lines)


def known_rows(page: str) -> dict[str, str]:
    """The rows that a page already has, by guard."""
    rows = re.findall(r"^(\| (?:H\d+|comfort) \| (.+?) \| `.+)$", page, re.MULTILINE)
    return {name: line for line, name in rows}


def main() -> None:
    """Run the guards asked for, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", default="", help="guards whose name holds this")
    parser.add_argument("--missing", action="store_true", help="guards that the page does not have yet")
    parser.add_argument("--write", type=Path, metavar="PAGE")
    options = parser.parse_args()
    page = options.write.read_text() if options.write else ""
    rows, survived = known_rows(page), False
    for guard in GUARDS:
        if options.only in guard.name and not (options.missing and guard.name in rows):
            mutant = mutate(guard)
            survived = survived or not mutant.noticed
            rows[guard.name] = row(guard, mutant.noticed)
            print(f"{guard.name}: {mutant.noticed or 'SURVIVED'} ({mutant.seconds:.0f} s)", flush=True)
    if options.write:
        sys.path.insert(0, str(ROOT))
        from benchmarks.report import replace_section

        options.write.write_text(replace_section(page, "mutate_guards", table(rows)))
    else:
        print(table(rows))
    raise SystemExit(survived)


if __name__ == "__main__":
    main()

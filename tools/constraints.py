"""Write constraints.txt: one exact version of everything that development installs.

Each interpreter named on the command line resolves the project by itself (``pip install --dry-run``), and the
answers are merged: a version that all agree on stands once, one that differs gets a Python-version marker.

    python tools/constraints.py python3.11 python3.12 python3.13
"""

import argparse
import json
import subprocess
import tempfile
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TARGET = ROOT / "constraints.txt"
HEADER = """\
# Exact versions of everything that development installs (extras dev, nlp and browser).
# Written by `make constraints`; do not edit by hand.
"""


def resolve(interpreter: str) -> tuple[str, dict[str, str]]:
    """Return the Python version of an interpreter and the versions that pip resolves under it."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder, "report.json")
        install = f"{interpreter} -m pip install --quiet --dry-run --ignore-installed --report".split()
        subprocess.run([*install, str(report), f"{ROOT}[dev,nlp,browser]"], check=True)
        answer = json.loads(report.read_text())
    rows = (item["metadata"] for item in answer["install"])
    versions = {row["name"].lower().replace("_", "-"): row["version"] for row in rows}
    versions.pop("metropilot")
    return answer["environment"]["python_version"], versions


def marker(pythons: list[str], newest: str) -> str:
    """Say for which Pythons a pin holds; the newest one's pin also holds for those to come."""
    if newest in pythons:
        return f'python_version >= "{pythons[0]}"'
    return " or ".join(f'python_version == "{python}"' for python in pythons)


def merge(resolved: dict[str, dict[str, str]]) -> list[str]:
    """Merge the versions of each Python (oldest first) into lines, with markers where they differ."""
    pythons_of: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for python, versions in resolved.items():
        for name, version in versions.items():
            pythons_of[name][version].append(python)
    newest = list(resolved)[-1]
    lines = []
    for name, by_version in sorted(pythons_of.items()):
        for version, pythons in by_version.items():
            suffix = f" ; {marker(pythons, newest)}" if len(by_version) > 1 else ""
            lines.append(f"{name}=={version}{suffix}")
    return lines


def main() -> None:
    """Resolve under every interpreter given and write the merged file."""
    parser = argparse.ArgumentParser(description="Refresh constraints.txt.")
    parser.add_argument("interpreters", nargs="+", help="for example python3.11 python3.12 python3.13")
    resolved = dict(resolve(interpreter) for interpreter in parser.parse_args().interpreters)
    TARGET.write_text(HEADER + "\n".join(merge(resolved)) + "\n")


if __name__ == "__main__":
    main()

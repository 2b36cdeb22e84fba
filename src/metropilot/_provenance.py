"""Provenance of a result: versions, commit, machine and date."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from platform import machine as architecture
from platform import processor, python_version
from subprocess import DEVNULL, SubprocessError, run

DRIVING = ("clarabel", "numpy", "scipy", "matplotlib", "jax")
"""Packages on which the numbers and pictures of a drive depend."""
LEARNING = ("jax", "jaxlib", "numpy", "safetensors")
"""Packages on which the numbers of a learned policy depend."""


def versions(packages: Sequence[str]) -> dict[str, str]:
    """Versions of Python, metropilot and those of the packages that are installed, by name."""
    found = {"python": python_version()}
    for package in ("metropilot", *packages):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def provenance() -> dict[str, str]:
    """Versions behind a drive, and the commit where there is one."""
    found = versions(DRIVING)
    return found | ({"commit": known} if (known := commit()) else {})


def circumstances() -> dict[str, str]:
    """Machine, date, commit and versions of a learning run, as a page states them."""
    found = commit()
    return {
        "machine": machine(),
        "date": datetime.now(UTC).date().isoformat(),
        "commit": found[:9] + "+" * found.endswith("+") if found else "not a checkout",
        "versions": ", ".join(f"{name} {number}" for name, number in versions(LEARNING).items()),
    }


@cache
def machine() -> str:
    """The processor and how many threads it runs."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return f"{model or processor() or architecture()}, {os.cpu_count()} cores"


@cache
def commit() -> str:
    """The commit of the source checkout, ``+`` where files differ from it; empty outside a checkout."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""  # installed: a repository further up is somebody else's
    describe = ["describe", "--always", "--abbrev=40", "--dirty=+", "--exclude=*"]
    try:
        done = run(
            ["git", "-C", str(root), *describe],
            stdout=-1,
            stderr=DEVNULL,
            stdin=DEVNULL,
            text=True,
            check=True,
            timeout=5,
        )
    except (OSError, SubprocessError):
        return ""
    return done.stdout.strip()

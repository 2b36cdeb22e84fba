"""Where a learned driver comes from: versions and commit."""

from __future__ import annotations

import os
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from platform import machine as architecture
from platform import processor, python_version
from subprocess import DEVNULL, SubprocessError, run

PACKAGES = ("metropilot", "jax", "jaxlib", "numpy", "safetensors")


def versions() -> dict[str, str]:
    """Python and the packages that decide what is learned, by name."""
    found = {"python": python_version()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


@cache
def machine() -> str:
    """The processor and how many threads it runs."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return f"{model or processor() or architecture()}, {os.cpu_count()} cores"


@cache
def commit() -> str:
    """The commit this code is at, ``+`` where files have changed since; empty outside a checkout."""
    folder = Path(__file__).parent
    try:
        head = run(["git", "rev-parse", "HEAD"], cwd=folder, stdout=-1, stderr=DEVNULL, text=True, check=True)
        status = ["git", "status", "--porcelain", "--untracked-files=no", "--", "."]
        changed = run(status, cwd=folder, stdout=-1, stderr=DEVNULL, text=True, check=True)
    except (OSError, SubprocessError):
        return ""
    return head.stdout.strip() + ("+" if changed.stdout.strip() else "")

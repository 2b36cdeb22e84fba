"""On what, when and with which code something was measured."""

from __future__ import annotations

import os
import platform
from datetime import UTC, datetime
from pathlib import Path

from metropilot._provenance import commit, versions


def circumstances() -> dict[str, str]:
    """Machine, date, commit and versions, as a page states them."""
    found = commit()
    return {
        "machine": f"{_processor()}, {os.cpu_count()} cores",
        "date": datetime.now(UTC).date().isoformat(),
        "commit": found[:9] + "+" * found.endswith("+") if found else "not a checkout",
        "versions": ", ".join(f"{name} {number}" for name, number in versions().items()),
    }


def _processor() -> str:
    """The processor's name where the system tells it."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else []
    named = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return named[0] if named else platform.processor() or platform.machine()

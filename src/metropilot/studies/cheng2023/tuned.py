"""What the search found on the base scenario, 1200 runs a driver, seed 0; the budget paper searches again.

Source: ``metropilot reproduce cheng2023 --budget paper``.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from metropilot.drivers import fuzzy_pid, neural_pid, pid

TUNED: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {"pid": pid.TUNED, "fuzzy_pid": fuzzy_pid.TUNED, "neural_pid": neural_pid.TUNED}
)

"""Incremental PID on the speed error, with fixed gains (Cheng23 eqs. 15 and 16)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar, final

from metropilot._schema import declare
from metropilot.control import Errors, Gains, incremental_pid
from metropilot.drivers.tracking import AbstractPidOptions, AbstractTracker, TrackingView

TUNED_PID: Mapping[str, float] = MappingProxyType({"kp": 4.986, "ki": 1.4996, "kd": 0.1019})
"""Found on the base scenario of Cheng23 by differential evolution, 1200 runs
(:func:`metropilot.studies.cheng2023.tuning.tune_driver`)."""


@final
@dataclass(frozen=True)
class PidOptions(AbstractPidOptions):
    """Options of ``pid``: the reference and the gains.

    Attributes:
        tuned: Take the gains that were found by search instead.
    """

    tuned: bool = declare(False)


@final
class Pid(AbstractTracker):
    """Tracks a reference with fixed gains.

    Args:
        options: Reference and gains; Cheng23's by default.
    """

    id: ClassVar[str] = "pid"

    def __init__(self, options: PidOptions | None = None) -> None:
        options = options or PidOptions()
        options = replace(options, **TUNED_PID) if options.tuned else options
        super().__init__(options)
        self.gains = Gains(options.kp, options.ki, options.kd)

    def control(self, memory: Errors, seen: TrackingView) -> tuple[float, Errors]:
        """One period of the law."""
        return incremental_pid(seen.command, self.gains, seen.error_mps, memory)

"""Incremental PID on the speed error, with fixed gains (Cheng23 eqs. 15 and 16)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import ClassVar, final

from metropilot.control import CHENG2023_GAINS, Errors, Gains, incremental_pid
from metropilot.drivers.tracking import AbstractTracker, AbstractTrackingOptions, TrackingView

TUNED_PID: Mapping[str, float] = MappingProxyType({"kp": 4.986, "ki": 1.4996, "kd": 0.1019})
"""Found on the base scenario of Cheng23 by differential evolution, 1200 runs
(:func:`metropilot.studies.cheng2023.tuning.tune_driver`)."""


@final
@dataclass(frozen=True)
class PidOptions(AbstractTrackingOptions):
    """Options of ``pid``: the reference, and gains for a control period of 0.2 s.

    Attributes:
        kp: Gain on the change of the error, 1/(m/s).
        ki: Gain on the error, 1/(m/s) and period.
        kd: Gain on the change of the change, 1/(m/s).
        tuned: Take the gains that were found by search instead.
    """

    kp: float = CHENG2023_GAINS.proportional
    ki: float = CHENG2023_GAINS.integral
    kd: float = CHENG2023_GAINS.derivative
    tuned: bool = False


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

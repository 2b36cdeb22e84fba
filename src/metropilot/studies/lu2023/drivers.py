"""Drivers of Lu23: DQN, improved DQN over twelve notches, and a PID that tracks the curve of the latter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final

from metropilot import drivers
from metropilot._schema import declare
from metropilot.control import Ceiling, Errors, Gains, Model, incremental_pid
from metropilot.planning import TimedReference, sample_profile
from metropilot.sim import Run, simulate_nominal


@final
class Dqn(drivers.AbstractShippedDriver):
    """Learned by plain DQN over Lu23's twelve notches, without the filter, for 118 to 142 s."""

    id: ClassVar[str] = "dqn"


@final
class ImprovedDqn(drivers.AbstractShippedDriver):
    """Learned by double dueling DQN with prioritised replay, its choices filtered by minimum arrival time."""

    id: ClassVar[str] = "improved_dqn"


@final
@dataclass(frozen=True)
class PidLu2023Options(drivers.AbstractPidOptions):
    """Options of ``pid-lu2023``: the tracked curve, and gains (the paper gives none; these are Cheng23's).

    Attributes:
        policy: Policy file whose drive is tracked; empty: that of ``improved_dqn``.
    """

    policy: str = declare("")


@final
class PidLu2023(drivers.AbstractTracker):
    """Tracks what improved DQN would drive (Lu23 Fig. 9); a curve laid anew on the way is an S-curve.

    Args:
        options: Options: curve and gains.
    """

    id: ClassVar[str] = "pid_lu2023"

    def __init__(self, options: PidLu2023Options | None = None) -> None:
        self.given = options or PidLu2023Options()
        super().__init__(self.given)
        self.gains = Gains(self.given.kp, self.given.ki, self.given.kd)
        self.curve: TimedReference | None = None

        self.learned = ImprovedDqn(drivers.PolicyOptions(self.given.policy))

    def read_policy(self) -> object:
        """Read the policy that drives the curve it tracks."""
        return self.learned.loaded_policy

    def init(self, run: Run) -> drivers.TrackingMemory:
        """Let improved DQN drive the run ahead of departure, and take its curve as the reference."""
        learned = simulate_nominal(run, self.learned)
        self.curve = sample_profile(learned.position_m, learned.speed_mps, drivers.REFERENCE_PERIOD_S)
        return super().init(run)

    def control(self, memory: Errors, seen: drivers.TrackingView) -> tuple[float, Errors]:
        """One period of the law."""
        return incremental_pid(seen.command, self.gains, seen.error_mps, memory)

    def _lay_reference(
        self, model: Model, ceiling: Ceiling, left_s: float, start_m: float, start_mps: float
    ) -> TimedReference:
        """The learned curve from the origin; elsewhere an S-curve."""
        if self.curve is not None and start_m <= 0.0:
            return self.curve
        return super()._lay_reference(model, ceiling, left_s, start_m, start_mps)

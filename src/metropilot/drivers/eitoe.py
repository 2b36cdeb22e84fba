"""EITOE: the enhanced intelligent train operation algorithm by an expert system, without a reference profile.

Rules 1 to 5, the speed window of the double minimal-time distribution, the safe speed, and the station stop
that learns the brake's gain. Source: Huang25 section 3.1, eqs. 14 to 18 and Algorithm 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from metropilot.drivers.expert.driving import ExpertMemory, RateInputs, decide, prepare_expert
from metropilot.drivers.expert.hoa import GAIN, SETTLED, UNSURE, Hoa
from metropilot.env import ExpertRules, constant_rate_change
from metropilot.errors import InputError
from metropilot.physics import scalars
from metropilot.sim import AbstractDriver, Observation, Run


@dataclass(frozen=True)
class EitoeOptions:
    """Prior knowledge of the expert about the brake.

    Attributes:
        start_mps2: Largest acceleration (rule 2).
        brake_gain: Actual over believed braking force, as learned at earlier stops.
        brake_known: True if it was learned: a driver that never stopped this trainset plans its stop with
            care.
        intervals: Keep to a time for each speed-limit interval, as Algorithm 1 prints it.
    """

    start_mps2: float = 0.6
    brake_gain: float = 1.0
    brake_known: bool = True
    intervals: bool = False

    def __post_init__(self) -> None:
        if not GAIN[0] <= self.brake_gain <= GAIN[1]:
            allowed = f"{GAIN[0]:g} to {GAIN[1]:g}"
            raise InputError("out of range", field="brake_gain", value=self.brake_gain, allowed=allowed)

    @property
    def hoa(self) -> Hoa:
        """Knowledge of the brake before the first stop."""
        return Hoa(self.brake_gain, SETTLED if self.brake_known else UNSURE)


@final
class Eitoe(AbstractDriver):
    """Drives by an expert's rules: accelerate, coast as long as the time left allows, brake to the stop.

    Args:
        options: Acceleration, and what is known about the brake.
    """

    id = "eitoe"

    def __init__(self, options: EitoeOptions | None = None) -> None:
        self.options = options or EitoeOptions()

    def init(self, run: Run) -> ExpertMemory:
        """Tables of the section, once."""
        rules = ExpertRules(start_mps2=self.options.start_mps2, intervals=self.options.intervals)
        return prepare_expert(run, run.section, rules, self.options.hoa)

    def act(self, memory: ExpertMemory, observation: Observation) -> tuple[float, ExpertMemory]:
        """One decision by the rules; the change of the rate is the constant of eqs. 15 and 16."""
        rules = memory.rules

        def change(seen: RateInputs) -> float:
            return constant_rate_change(scalars, rules, seen.window, seen.rate_mps2)

        return decide(memory, observation, change)

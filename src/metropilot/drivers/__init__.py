"""Drivers: anything that gives the command, one file each; listing them imports none of those files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metropilot._lazy import lazy_door

if TYPE_CHECKING:
    from metropilot.drivers.ddpg_pid import (
        GAINS_OBSERVATION,
        DdpgPid,
        DdpgPidOptions,
        load_gains_policy,
        step_ddpg_pid,
    )
    from metropilot.drivers.eitoe import Eitoe, EitoeOptions
    from metropilot.drivers.flat_out import FlatOut
    from metropilot.drivers.fuzzy_pid import ASSUMED_UNIVERSES, TUNED_FUZZY_PID, Universes, step_fuzzy_pid
    from metropilot.drivers.learned import DECISION_EARLY_S, LearnedDriver
    from metropilot.drivers.neural_pid import (
        TEXTBOOK_RATES,
        TUNED_NEURAL_PID,
        LearningRates,
        fresh_network,
        step_neural_pid,
    )
    from metropilot.drivers.pid import TUNED_PID, Pid, PidOptions
    from metropilot.drivers.pid_lu2023 import PidLu2023, PidLu2023Options
    from metropilot.drivers.registry import DRIVERS
    from metropilot.drivers.shipped import AbstractPolicyDriver

__all__ = [
    "ASSUMED_UNIVERSES",
    "DECISION_EARLY_S",
    "DRIVERS",
    "GAINS_OBSERVATION",
    "TEXTBOOK_RATES",
    "TUNED_FUZZY_PID",
    "TUNED_NEURAL_PID",
    "TUNED_PID",
    "AbstractPolicyDriver",
    "DdpgPid",
    "DdpgPidOptions",
    "Eitoe",
    "EitoeOptions",
    "FlatOut",
    "LearnedDriver",
    "LearningRates",
    "Pid",
    "PidLu2023",
    "PidLu2023Options",
    "PidOptions",
    "Universes",
    "fresh_network",
    "load_gains_policy",
    "step_ddpg_pid",
    "step_fuzzy_pid",
    "step_neural_pid",
]

__getattr__, __dir__ = lazy_door(
    __name__,
    {
        "ddpg_pid": ("DdpgPid", "DdpgPidOptions", "GAINS_OBSERVATION", "load_gains_policy", "step_ddpg_pid"),
        "eitoe": ("Eitoe", "EitoeOptions"),
        "flat_out": ("FlatOut",),
        "fuzzy_pid": ("ASSUMED_UNIVERSES", "TUNED_FUZZY_PID", "Universes", "step_fuzzy_pid"),
        "learned": ("DECISION_EARLY_S", "LearnedDriver"),
        "neural_pid": (
            "LearningRates",
            "TEXTBOOK_RATES",
            "TUNED_NEURAL_PID",
            "fresh_network",
            "step_neural_pid",
        ),
        "pid": ("Pid", "PidOptions", "TUNED_PID"),
        "pid_lu2023": ("PidLu2023", "PidLu2023Options"),
        "registry": ("DRIVERS",),
        "shipped": ("AbstractPolicyDriver",),
    },
)

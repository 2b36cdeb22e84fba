"""One control period after another: a run, its disturbance, the host loop, its outcome and trajectory."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metropilot._lazy import lazy_door

if TYPE_CHECKING:
    from metropilot.sim.bounds import MASS_SCATTER, declared_bounds
    from metropilot.sim.disturbance import NOISE_CUT, Disturbance, TimetableUpdate, true_vehicle
    from metropilot.sim.driver import DRIVER_REGISTRY, AbstractDriver, register
    from metropilot.sim.outcome import (
        CODES,
        NEVER_ENDS,
        OVERSPEED_MPS,
        RUNNING,
        Episode,
        OutcomeRule,
        final_outcome,
    )
    from metropilot.sim.rollout import Drive, Moment, NominalDrive, Rollout, drive, simulate_nominal
    from metropilot.sim.run import (
        CONTROL_PERIOD_S,
        PUNCTUALITY_S,
        STOP_TOLERANCE_M,
        Observation,
        Outcome,
        Run,
    )
    from metropilot.sim.step import (
        PeriodRecord,
        RunParams,
        RunState,
        control_period,
        first_state,
        hold_ended,
        measured_speed,
        noise_stream,
        overspeed_in_period,
        running_time,
    )
    from metropilot.sim.trajectory import (
        COASTING,
        COLUMNS,
        PHASES,
        STANDSTILL,
        Recorder,
        Trajectory,
        build_trajectory,
        phase_names,
        train_limit_at,
        train_limits_at,
    )

__all__ = [
    "COASTING",
    "CODES",
    "COLUMNS",
    "CONTROL_PERIOD_S",
    "DRIVER_REGISTRY",
    "MASS_SCATTER",
    "NEVER_ENDS",
    "NOISE_CUT",
    "OVERSPEED_MPS",
    "PHASES",
    "PUNCTUALITY_S",
    "RUNNING",
    "STANDSTILL",
    "STOP_TOLERANCE_M",
    "AbstractDriver",
    "Disturbance",
    "Drive",
    "Episode",
    "Moment",
    "NominalDrive",
    "Observation",
    "Outcome",
    "OutcomeRule",
    "PeriodRecord",
    "Recorder",
    "Rollout",
    "Run",
    "RunParams",
    "RunState",
    "TimetableUpdate",
    "Trajectory",
    "build_trajectory",
    "control_period",
    "declared_bounds",
    "drive",
    "final_outcome",
    "first_state",
    "hold_ended",
    "measured_speed",
    "noise_stream",
    "overspeed_in_period",
    "phase_names",
    "register",
    "running_time",
    "simulate_nominal",
    "train_limit_at",
    "train_limits_at",
    "true_vehicle",
]

__getattr__, __dir__ = lazy_door(
    __name__,
    {
        "bounds": (
            "MASS_SCATTER",
            "declared_bounds",
        ),
        "disturbance": (
            "Disturbance",
            "NOISE_CUT",
            "TimetableUpdate",
            "true_vehicle",
        ),
        "driver": (
            "AbstractDriver",
            "DRIVER_REGISTRY",
            "register",
        ),
        "outcome": (
            "CODES",
            "Episode",
            "NEVER_ENDS",
            "OVERSPEED_MPS",
            "OutcomeRule",
            "RUNNING",
            "final_outcome",
        ),
        "rollout": (
            "Drive",
            "Moment",
            "NominalDrive",
            "Rollout",
            "drive",
            "simulate_nominal",
        ),
        "run": (
            "CONTROL_PERIOD_S",
            "Observation",
            "Outcome",
            "PUNCTUALITY_S",
            "Run",
            "STOP_TOLERANCE_M",
        ),
        "step": (
            "PeriodRecord",
            "RunParams",
            "RunState",
            "control_period",
            "first_state",
            "hold_ended",
            "measured_speed",
            "noise_stream",
            "overspeed_in_period",
            "running_time",
        ),
        "trajectory": (
            "COASTING",
            "COLUMNS",
            "PHASES",
            "Recorder",
            "STANDSTILL",
            "Trajectory",
            "build_trajectory",
            "phase_names",
            "train_limit_at",
            "train_limits_at",
        ),
    },
)

"""Control laws on the nominal plant: estimation, station stop, ceiling, coasting, incremental PID."""

from metropilot.control.adaptation import Adapted, adapted_trainset, adapted_vehicle
from metropilot.control.ceiling import Ceiling, ceiling_acceleration, ceiling_of, model_of, traction_limit
from metropilot.control.coasting import Forecast, coast_point_for, cruise_for, forecast_of
from metropilot.control.estimator import (
    Model,
    PredictedState,
    StateEstimate,
    initial_estimate,
    look_ahead,
    record_command,
    share_for,
    update_estimate,
    weighs_load,
)
from metropilot.control.headroom import Headroom, headroom_of, largest_admissible_command
from metropilot.control.incremental_pid import Errors, Gains, incremental_pid
from metropilot.control.stopping import (
    Stop,
    StopCurve,
    comfortable_deceleration,
    curve_for,
    deceleration_to,
    stand,
    stop_command,
)

__all__ = [
    "Adapted",
    "Ceiling",
    "Errors",
    "Forecast",
    "Gains",
    "Headroom",
    "Model",
    "PredictedState",
    "StateEstimate",
    "Stop",
    "StopCurve",
    "adapted_trainset",
    "adapted_vehicle",
    "ceiling_acceleration",
    "ceiling_of",
    "coast_point_for",
    "comfortable_deceleration",
    "cruise_for",
    "curve_for",
    "deceleration_to",
    "forecast_of",
    "headroom_of",
    "incremental_pid",
    "initial_estimate",
    "largest_admissible_command",
    "look_ahead",
    "model_of",
    "record_command",
    "share_for",
    "stand",
    "stop_command",
    "traction_limit",
    "update_estimate",
    "weighs_load",
]

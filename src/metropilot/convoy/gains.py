"""What a policy sees that sets the gains of a follower's PID (Chen23b), and what its actions mean."""

from __future__ import annotations

from typing import Any, no_type_check

import numpy as np

from metropilot.control import Gains
from metropilot.convoy.step import FollowerObservation
from metropilot.physics import namespace, scalars

Array = Any
GAIN_LOW, GAIN_HIGH = Gains(0.0, 0.0, 0.0), Gains(5.0, 1.5, 1.5)
"""Chen23b table 1."""
STATE = ("command", "acceleration", "speed", "position", "speed difference", "gap less wanted gap")
SPEED_MPS, POSITION_M, FINE_MPS, FINE_M, FINE_SCALE = 20.0, 1000.0, 0.02, 0.01, 3.0


@no_type_check
def chen2023b_state(sight: FollowerObservation) -> Array:
    """The state of Chen23b eq. 16, scaled: u, acceleration, v, p, dv, dp. Shape (6,), float32.

    The differences run through ``asinh``, so that a millimetre counts near zero and a metre still fits. The
    speed difference is the trainset ahead's less the own one, the gap is counted from the wanted one.
    """
    xp = namespace(sight.position_m, sight.gap_m)
    join = np if xp is scalars else xp
    values = (
        sight.command,
        sight.acceleration_mps2,
        sight.speed_mps / SPEED_MPS,
        sight.position_m / POSITION_M,
        join.arcsinh((sight.ahead_mps - sight.speed_mps) / FINE_MPS) / FINE_SCALE,
        join.arcsinh((sight.gap_m - sight.wanted_gap_m) / FINE_M) / FINE_SCALE,
    )
    return join.stack([join.asarray(value, np.float32) for value in values])


@no_type_check
def gains_of(action: Array) -> Gains:
    """Gains within the bounds of Chen23b table 1 from actions in [-1, 1] (eq. 15)."""
    return Gains(
        *(
            low + (action[k] + 1.0) * (high - low) / 2.0
            for k, (low, high) in enumerate(zip(GAIN_LOW, GAIN_HIGH, strict=True))
        )
    )

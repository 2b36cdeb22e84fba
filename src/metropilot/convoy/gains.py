"""State and actions of a policy that sets the gains of the PID of a follower (Chen23b)."""

from __future__ import annotations

from typing import no_type_check

import numpy as np

from metropilot._typing import Array
from metropilot.control import Gains
from metropilot.convoy.step import FollowerObservation
from metropilot.physics import namespace, scalars

GAIN_LOW, GAIN_HIGH = Gains(0.0, 0.0, 0.0), Gains(5.0, 1.5, 1.5)
"""Chen23b table 1."""
# Names of the entries of the state, in order.
STATE = ("command", "acceleration", "speed", "position", "speed difference", "gap less wanted gap")
SPEED_MPS, POSITION_M, FINE_MPS, FINE_M, FINE_SCALE = 20.0, 1000.0, 0.02, 0.01, 3.0


@no_type_check
def chen2023b_state(observation: FollowerObservation) -> Array:
    """The state of Chen23b eq. 16, scaled: u, acceleration, v, p, dv, dp. Shape (6,), float32.

    ``asinh`` scales the differences, to resolve millimetres near zero and still hold metres. The speed
    difference is the speed ahead minus the own speed; the gap is counted from the desired one.
    """
    xp = namespace(observation.position_m, observation.gap_m)
    join = np if xp is scalars else xp
    values = (
        observation.command,
        observation.acceleration_mps2,
        observation.speed_mps / SPEED_MPS,
        observation.position_m / POSITION_M,
        join.arcsinh((observation.ahead_mps - observation.speed_mps) / FINE_MPS) / FINE_SCALE,
        join.arcsinh((observation.gap_m - observation.wanted_gap_m) / FINE_M) / FINE_SCALE,
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

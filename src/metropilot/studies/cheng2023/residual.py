"""DDPG-PID beside feed-forward: a learned network corrects a tuned PID on speed and position error.

The controller knows the reference ahead and the nominal plant, so the command that the reference takes is
fed forward; a PID with constant gains on speed and position error does the rest. The policy changes these
gains by factors and adds a little to the command; with zeros it is that controller.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from metropilot._typing import Array, Float, Scalar
from metropilot.control import CHENG2023_UPPER, Errors, Gains, incremental_pid
from metropilot.drivers import TrackingView
from metropilot.studies.cheng2023.law import TrackingLaw
from metropilot.studies.cheng2023.tracking import array_namespace

CORRECTIONS = Path(__file__).with_name("residual.safetensors")
"""Policy of the median seed, for the quick budget of the study; it is no driver's."""
ACTIONS = 5
"""Factors on three gains and on the rate of the position error, and the addition to the command."""
OCTAVES = 1.0
"""Largest factor, as a power of two."""
ADDED = 0.005
"""Largest addition to the command in a period."""
NEAR_MPS = 0.01
"""Speed error at which corrections have faded away: far from the reference the tuned PID drives alone..."""
SPARE = 0.05
"""...and so it does at full traction or braking; from this part of them off, corrections count in full."""
SPEED_MPS, ERROR_MPS, DISTANCE_M, CHANGE = 20.0, 0.004, 0.004, 0.02
"""What counts as 1 in the observation: speed, speed error, position error, change of the fed command."""
MOST = 5.0
"""Size at which every entry of the observation is cut off."""
OBSERVED = (
    "speed",
    "command",
    "speed_error",
    "position_error",
    "speed_error_before",
    "fed_forward",
)
"""Observation entries of the policy, as its file must list them."""


class PlacedGains(NamedTuple):
    """Gains on the speed error and the position error.

    Attributes:
        gains: Gains on their sum.
        position_per_s: Speed error that a metre of position error counts as, 1/s.
    """

    gains: Gains
    position_per_s: Scalar


def placed_gains(values: Mapping[str, float]) -> PlacedGains:
    """Gains as the search names them."""
    return PlacedGains(Gains(values["kp"], values["ki"], values["kd"]), values["position_per_s"])


def step_fed_pid(
    placed: PlacedGains, seen: TrackingView, errors: Errors, added: Scalar = 0.0
) -> tuple[Any, Errors]:
    """One period of the PID on speed and position error, beside the command that the reference takes.

    Args:
        placed: Gains.
        seen: Controller inputs.
        errors: Errors of the two periods before.
        added: Addition to the command.
    """
    error = seen.error_mps + placed.position_per_s * seen.distance_m
    return incremental_pid(seen.command + seen.feed_forward + added, placed.gains, error, errors)


def step_corrected_pid(
    action: Float[Array, "5"], placed: PlacedGains, seen: TrackingView, errors: Errors
) -> tuple[Any, Errors]:
    """One period of the law under the corrections of an action of five numbers in [-1, 1].

    Args:
        action: Answer of the policy.
        placed: Gains of the action of zeros.
        seen: Controller inputs.
        errors: Errors of the two periods before.
    """
    xp = array_namespace(action)
    near = xp.maximum(1.0 - xp.abs(seen.error_mps) / NEAR_MPS, 0.0)
    action = action * near * xp.clip((1.0 - xp.abs(seen.command)) / SPARE, 0.0, 1.0)
    factors = 2.0 ** (OCTAVES * action[:4])
    gains = Gains(*(xp.minimum(factors[j] * placed.gains[j], CHENG2023_UPPER[j]) for j in range(3)))
    corrected = PlacedGains(gains, factors[3] * placed.position_per_s)
    return step_fed_pid(corrected, seen, errors, ADDED * action[4])


def residual_observation(seen: TrackingView, errors: Errors) -> Float[Array, "6"]:
    """Observation of the policy, scaled."""
    xp = array_namespace(seen.error_mps)
    parts = (
        seen.speed_mps / SPEED_MPS,
        seen.command,
        seen.error_mps / ERROR_MPS,
        seen.distance_m / DISTANCE_M,
        errors.last / ERROR_MPS,
        seen.feed_forward / CHANGE,
    )
    return xp.clip(xp.stack([xp.asarray(part, np.float32) for part in parts]), -MOST, MOST)


def residual_law(placed: PlacedGains) -> TrackingLaw:
    """The law in which a policy corrects that PID.

    Args:
        placed: Gains of the action of zeros.
    """

    def step(action: Array, seen: TrackingView, errors: Errors) -> tuple[Any, Errors]:
        return step_corrected_pid(action, placed, seen, errors)

    return TrackingLaw(OBSERVED, ACTIONS, residual_observation, step)

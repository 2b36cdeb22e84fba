"""Trainset and section as lists of plain numbers: what a decision of a few microseconds reads."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from metropilot.control import (
    Ceiling,
    CommandActuation,
    Model,
    Motion,
    PredictedState,
    lead_command,
    predict_motion,
)
from metropilot.env import EXPERT_SEGMENTS, ExpertRules, ExpertStretch, expert_safe_speed
from metropilot.physics import command_for_effort, effort_at, felt_slopes

STEP_M = 4.0
SPEED_STEP_MPS = 0.25
BEYOND_M = 60.0
FOR_LIMITS = 0.85
"""Share of the largest deceleration to brake for lower limits with: protection watches the brake build up."""
UNDER_MPS = 0.4
"""Speed below a lower limit's ceiling at which the braking for it ends."""


class ExpertTrack(NamedTuple):
    """Tables of a section, even in position and speed; every number over effective mass.

    Attributes:
        length_m: Position of the stop.
        climb_jpkg: Work of gradients and curves since the origin, by position.
        downhill_mps2: Loss of station-stop deceleration to gradients and curves, by position: their mean from
            there, or from somewhere behind it, to the stop, where that is worst; at most 0.
        safe_mps: Speed to stay under, by position.
        traction_mps2: Largest traction, by speed.
        brake_mps2: Braking that command -1 asks for, by speed.
        davis: Constant, linear and quadratic resistance.
        most_mps2: Largest acceleration in service.
        jerk_mps3: Jerk limit in service.
    """

    length_m: float
    climb_jpkg: list[float]
    downhill_mps2: list[float]
    safe_mps: list[float]
    traction_mps2: list[float]
    brake_mps2: list[float]
    davis: tuple[float, float, float]
    most_mps2: float
    jerk_mps3: float

    def climb(self, position_m: float) -> float:
        """Work of gradients and curves from the origin, J/kg."""
        return _interpolate(self.climb_jpkg, position_m / STEP_M)

    def downhill(self, position_m: float) -> float:
        """Loss of station-stop deceleration to gradients and curves from a position, m/s^2; at most 0."""
        return _interpolate(self.downhill_mps2, position_m / STEP_M)

    def safe(self, position_m: float) -> float:
        """Speed to stay under, m/s."""
        return _interpolate(self.safe_mps, position_m / STEP_M)

    def lowest(self, position_m: float, way_m: float) -> float:
        """The lowest speed to stay under from a position over a little way, m/s."""
        first = max(int(position_m / STEP_M), 0)
        return min(self.safe_mps[first : int((position_m + way_m) / STEP_M) + 2] or self.safe_mps[-1:])

    def traction(self, speed_mps: float) -> float:
        """Largest traction, m/s^2."""
        return _interpolate(self.traction_mps2, speed_mps / SPEED_STEP_MPS)

    def brake(self, speed_mps: float) -> float:
        """Full service brake, m/s^2."""
        return _interpolate(self.brake_mps2, speed_mps / SPEED_STEP_MPS)

    def drag(self, position_m: float, speed_mps: float) -> float:
        """Resistance and gradient, m/s^2."""
        k = min(max(int(position_m / STEP_M), 0), len(self.climb_jpkg) - 2)
        slope = (self.climb_jpkg[k + 1] - self.climb_jpkg[k]) / STEP_M
        a, b, c = self.davis
        return a + speed_mps * (b + speed_mps * c) + slope

    def stretch(self, position_m: float, end_m: float, end_mps: float) -> ExpertStretch:
        """Summarise the track between a position and the end of an interval."""
        left = max(end_m - position_m, 1e-3)
        ds = left / EXPERT_SEGMENTS
        at = [position_m + k * ds for k in range(EXPERT_SEGMENTS + 1)]
        climb, safe = self.climb_jpkg, self.safe_mps
        caps = [_interpolate(safe, x / STEP_M) for x in at]
        return ExpertStretch(
            left, [_interpolate(climb, x / STEP_M) for x in at], [0.5 * v * v for v in caps], end_mps
        )

    def ahead(
        self, actuation: CommandActuation, state: tuple[float, float, float], brake_gain: float
    ) -> PredictedState:
        """The state at the moment a command given now begins to act.

        Args:
            actuation: Commands on their way.
            state: Position, speed and acceleration of the last period; m, m/s, m/s^2.
            brake_gain: Actual over believed braking force.
        """
        x, v, a = state
        motion = Motion(x, v, a, actuation.share)
        limits = self.traction(v), brake_gain * self.brake(v), self.drag(x, v)
        if actuation.delay_steps > 0:
            commands, steps, keep = actuation.commands, actuation.delay_steps, actuation.keep
            motion = predict_motion(motion, commands, steps, keep, limits, self.jerk_mps3, actuation.dt)
            x, v = motion.position_m, motion.speed_mps
            limits = self.traction(v), brake_gain * self.brake(v), self.drag(x, v)
        traction, brake, drag = limits
        return PredictedState(actuation.seconds, *motion, drag, 0.0, traction, brake)


def share_of(actuation: CommandActuation, ahead: PredictedState, effort_mps2: float) -> float:
    """The command that gives a wheel effort when it begins to act, in [-1, 1].

    Args:
        actuation: Commands on their way.
        ahead: The state at that moment.
        effort_mps2: Effort over mass, traction positive.
    """
    share = command_for_effort(effort_mps2, ahead.traction_mps2, ahead.brake_mps2)
    return lead_command(share, ahead.share, actuation.keep)


def expert_track(model: Model, ceiling: Ceiling, rules: ExpertRules) -> ExpertTrack:
    """Tables of a section for a trainset.

    Args:
        model: Nominal trainset and section.
        ceiling: Speeds protection permits, less a margin; eqs. 17 and 18 of Huang25 come on top.
        rules: The expert's constants.
    """
    vehicle, track = model.vehicle, model.track
    mass = float(vehicle.effective_mass_kg)
    at = np.arange(0.0, float(track.length_m) + BEYOND_M, STEP_M)
    gradient, curve, _ = felt_slopes(vehicle, track, at)
    pull = (float(vehicle.gravity_mps2) * gradient + curve) * float(vehicle.mass_kg) / mass
    climb = np.concatenate([[0.0], np.cumsum(0.5 * (pull[1:] + pull[:-1]) * STEP_M)])
    speeds = np.arange(0.0, float(vehicle.max_speed_mps) + 3.0, SPEED_STEP_MPS)
    effort = [effort_at(vehicle, np.float64(v)) for v in speeds]
    return ExpertTrack(
        length_m=float(track.length_m),
        climb_jpkg=climb.tolist(),
        downhill_mps2=_downhill(at, climb, float(track.length_m)).tolist(),
        safe_mps=_safe(model, ceiling, rules, at).tolist(),
        traction_mps2=[max(float(e.traction_n), 1.0) / mass for e in effort],
        brake_mps2=[max(float(e.brake_n), 1.0) / mass for e in effort],
        davis=tuple(float(d) / mass for d in vehicle.davis_n),  # pyright: ignore[reportArgumentType]
        most_mps2=float(vehicle.max_acceleration_mps2),
        jerk_mps3=float(vehicle.jerk_mps3),
    )


def _downhill(at: np.ndarray, climb: np.ndarray, length_m: float) -> np.ndarray:
    """The least mean slope from a position or any place behind it to the stop, by position."""
    left = np.maximum(length_m - at, STEP_M)
    mean = (np.interp(length_m, at, climb) - climb) / left
    mean = np.where(at < length_m, mean, mean[np.flatnonzero(at < length_m)[-1]])
    return np.minimum.accumulate(np.minimum(mean, 0.0)[::-1])[::-1]


def drops(model: Model) -> list[tuple[float, float]]:
    """Starts of lower limits and their values, for every one of the section; m and m/s."""
    begins, limits = np.asarray(model.track.limit_from_m), np.asarray(model.track.limit_mps)
    inside = np.isfinite(begins) & (begins > 0.0) & (begins < float(model.track.length_m))
    return [(float(begins[k]), float(limits[k])) for k in np.flatnonzero(inside) if limits[k] < limits[k - 1]]


def _safe(model: Model, ceiling: Ceiling, rules: ExpertRules, at: np.ndarray) -> np.ndarray:
    """The safe speed at every position: eqs. 17 and 18 for every lower limit ahead, under the ceiling."""
    begins, limits = np.asarray(model.track.limit_from_m), np.asarray(model.track.limit_mps)
    here = limits[np.clip(np.searchsorted(begins, at, side="right") - 1, 0, limits.size - 1)]
    safe = np.minimum(here, [ceiling.at(float(x)) for x in at])
    for place, lower in drops(model):
        most = float(model.vehicle.max_deceleration_mps2)
        kept = min(lower, ceiling.at(place)) - UNDER_MPS
        begins = place - lower * lead_s(model)
        before = expert_safe_speed(np, rules, FOR_LIMITS * most, kept / rules.safe_share, begins - at, here)
        safe = np.where(at < place, np.minimum(safe, before), safe)
    return safe


def _interpolate(values: list[float], steps: float) -> float:
    """A table at a place between its entries, held beyond its ends."""
    if steps <= 0.0:
        return values[0]
    k = int(steps)
    if k >= len(values) - 1:
        return values[-1]
    low = values[k]
    return low + (values[k + 1] - low) * (steps - k)


def lead_s(model: Model) -> float:
    """Time between a command and its effect, jerk limit apart, s."""
    return float(model.vehicle.delay_s) + float(model.vehicle.lag_s)


def build_up_s(ground: ExpertTrack, rate_mps2: float) -> float:
    """Half the time the jerk limit takes for a change of the acceleration, s."""
    return 0.5 * abs(rate_mps2) / ground.jerk_mps3 if math.isfinite(ground.jerk_mps3) else 0.0

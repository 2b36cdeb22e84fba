"""Estimator of state and plant parameters from the measurements and commands of a run.

A driver measures a position (accurately), a noisy speed and the acceleration of the last period. The
estimator fuses them into a state and identifies, from commands and accelerations, the gain of traction and
brake (a trainset 20 % heavier than nominal has a gain of 1/1.2), the factor on running resistance, and the
dead time and lag between command and force. For dead time and lag it has a bank of hypotheses, each with a
recursive least-squares estimate, and uses the one with the smallest prediction error; the jerk limit is
known to the driver and is part of every prediction.

The model, per unit of nominal effective mass (Huang25 eqs. 3 and 4, Chen23a eq. 1)::

    a = gain_traction * f_traction(u, v) + gain_brake * f_brake(u, v) - factor * r(x, v) - g(x)

All functions are pure over :class:`StateEstimate`. One control period calls :func:`update_estimate`, then
:func:`look_ahead` and ``share_for`` of the state it predicts as needed, then :func:`record_command` with the
command that was given.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.control.prediction import (
    Model,
    Motion,
    PredictedState,
    acting_command,
    periods_before,
    predict_motion,
)
from metropilot.physics import Vehicle, curve_n, effort_limits

MAX_EXTRA_DELAY_S = 1.0
"""Largest dead time among the hypotheses beyond the nominal one."""
EXTRA_LAGS_S = (0.0, 0.2, 0.4, 0.6)
"""Lags of the hypotheses beyond the nominal one."""
POSITION_SIGMA_M = 0.01
"""Standard deviation of the measured position."""
SPEED_SIGMA_MPS = 0.05
"""Standard deviation of the measured speed."""
ANSWER_SIGMA_MPS2 = 0.02
"""Standard deviation of the acceleration about the model's with the right parameters."""
MASS_SIGMA = 0.12
"""Prior standard deviation of the mass, common to the gains of traction and brake."""
EFFORT_SIGMA = 0.05
"""Prior standard deviation of each gain apart from the mass."""
RESISTANCE_SIGMA = 0.4
"""Prior standard deviation of the factor on running resistance."""
DRIFT_VARIANCE = np.diag([1e-6, 1e-6, 1e-6])
"""Variance added to the parameters in each period, so that they can follow slow changes."""
SWITCH_MARGIN = 6.0
"""Advantage in the sum of squared normalised residuals at which another hypothesis is selected."""
FORGETTING = 0.998
"""Discount of the residuals of earlier periods; a half-life of 346 periods."""


class HypothesisBank(NamedTuple):
    """Hypotheses about dead time and lag, each with its own parameters.

    Attributes:
        delay_steps: Dead time in control periods, not always whole. Shape (H,).
        keep: Share of the old effort that remains after a period of lag. Shape (H,).
        share: Command after delay and lag. Shape (H,).
        gains: Traction gain, brake gain, resistance factor. Shape (H, 3).
        covariance: Their covariance. Shape (H, 3, 3).
        cost: Discounted sum of squared normalised residuals. Shape (H,).
    """

    delay_steps: Float[ndarray, " hypotheses"]
    keep: Float[ndarray, " hypotheses"]
    share: Float[ndarray, " hypotheses"]
    gains: Float[ndarray, "hypotheses 3"]
    covariance: Float[ndarray, "hypotheses 3 3"]
    cost: Float[ndarray, " hypotheses"]


class StateEstimate(NamedTuple):
    """Estimate of state and plant parameters at the start of a control period.

    Attributes:
        position_m: Position of the head.
        speed_mps: Filtered speed.
        acceleration_mps2: Acceleration over the last period.
        covariance: Covariance of position and speed. Shape (2, 2).
        commands: Commands already given, newest first. Shape (D,).
        bank: Hypotheses about the actuation.
        best: Index of the selected hypothesis.
        started: False until the first observation.
    """

    position_m: float
    speed_mps: float
    acceleration_mps2: float
    covariance: Float[ndarray, "2 2"]
    commands: Float[ndarray, " given"]
    bank: HypothesisBank
    best: int
    started: bool

    @property
    def traction_gain(self) -> float:
        """Estimated over nominal traction force per mass."""
        return float(self.bank.gains[self.best, 0])

    @property
    def brake_gain(self) -> float:
        """Estimated over nominal braking force per mass."""
        return float(self.bank.gains[self.best, 1])

    @property
    def brake_gain_sigma(self) -> float:
        """Standard deviation of :attr:`brake_gain`."""
        return float(np.sqrt(self.bank.covariance[self.best, 1, 1]))

    @property
    def resistance_factor(self) -> float:
        """Estimated over nominal resistance per mass."""
        return float(self.bank.gains[self.best, 2])


def weighs_load(vehicle: Vehicle, spare: float = 1.0 + 2.0 * MASS_SIGMA) -> bool:
    """Test for load-weighed brakes: full service braking is a deceleration, not a force.

    Args:
        vehicle: Nominal plant.
        spare: Mass over the nominal one for which the brake force must still suffice.
    """
    speeds = np.linspace(0.0, float(vehicle.max_speed_mps), 9)
    electric = min(float(curve_n(vehicle.brake_from_mps, vehicle.brake, v)) for v in speeds)
    force = min(electric + float(vehicle.friction_n), float(vehicle.adhesion_n))
    return spare * float(vehicle.service_n) <= force


def initial_estimate(
    model: Model, position_m: float = 0.0, speed_mps: float = 0.0, *, weighed_brakes: bool = False
) -> StateEstimate:
    """Estimate before any observation: nominal gains, with hypotheses of up to one second more dead time.

    Args:
        model: Nominal trainset and section.
        position_m: Position at the start.
        speed_mps: Speed at the start.
        weighed_brakes: The brake is controlled to a deceleration at any load (see :func:`weighs_load`), so a
            wrong mass changes the gain of traction alone.
    """
    dt = model.dt
    # rounded, as 0.6 / 0.2 is 2.9999999999999996 and would count as not whole
    known = round(float(model.vehicle.delay_s) / dt, 6)
    extra = np.arange(round(MAX_EXTRA_DELAY_S / dt) + 1)
    lags = np.array(EXTRA_LAGS_S) + float(model.vehicle.lag_s)
    steps, lag = (x.ravel() for x in np.meshgrid(known + extra, lags, indexing="ij"))
    count = steps.size
    covariance = np.diag([EFFORT_SIGMA**2, EFFORT_SIGMA**2, RESISTANCE_SIGMA**2])
    weighs = 1 if weighed_brakes else 2
    covariance[:weighs, :weighs] += MASS_SIGMA**2
    bank = HypothesisBank(
        delay_steps=steps,
        keep=np.where(lag > 0, np.exp(-dt / np.maximum(lag, 1e-6)), 0.0),
        share=np.zeros(count),
        gains=np.ones((count, 3)),
        covariance=np.repeat(covariance[None], count, axis=0),
        cost=np.where(np.arange(count) == 0, -SWITCH_MARGIN, 0.0),
    )
    return StateEstimate(
        position_m=float(position_m),
        speed_mps=float(speed_mps),
        acceleration_mps2=0.0,
        covariance=np.diag([POSITION_SIGMA_M**2, SPEED_SIGMA_MPS**2]),
        commands=np.zeros(math.ceil(steps.max()) + 1),
        bank=bank,
        best=0,
        started=False,
    )


def update_estimate(
    model: Model,
    estimate: StateEstimate,
    position_m: float,
    speed_mps: float,
    acceleration_mps2: float,
    *,
    overruled: bool = False,
) -> StateEstimate:
    """Update the estimate with this period's measurements.

    Args:
        model: Nominal trainset and section.
        estimate: The estimate of the period before, after :func:`record_command`.
        position_m: Measured position.
        speed_mps: Measured speed, noisy.
        acceleration_mps2: Acceleration over the last period.
        overruled: Protection overruled the last command: its answer says nothing about the plant.
    """
    if not estimate.started:
        return estimate._replace(
            position_m=float(position_m),
            speed_mps=float(speed_mps),
            acceleration_mps2=float(acceleration_mps2),
            started=True,
        )
    bank, best = estimate.bank, estimate.best
    if not overruled:
        bank, best = _learn(model, estimate, float(acceleration_mps2))
    position, speed, covariance = _fuse(model.dt, estimate, position_m, speed_mps, acceleration_mps2)
    return estimate._replace(
        position_m=position,
        speed_mps=speed,
        acceleration_mps2=float(acceleration_mps2),
        covariance=covariance,
        bank=bank,
        best=best,
    )


def record_command(estimate: StateEstimate, share: float) -> StateEstimate:
    """Add the command just given to the estimate."""
    commands = np.concatenate([[min(max(float(share), -1.0), 1.0)], estimate.commands[:-1]])
    return estimate._replace(commands=commands)


def _fuse(
    dt: float, estimate: StateEstimate, position_m: float, speed_mps: float, acceleration_mps2: float
) -> tuple[float, float, Float[ndarray, "2 2"]]:
    """Kalman filter of position and speed, with the measured acceleration of the period as its input."""
    a = float(acceleration_mps2)
    position = estimate.position_m + estimate.speed_mps * dt + 0.5 * a * dt * dt
    speed = estimate.speed_mps + a * dt
    move = np.array([[1.0, dt], [0.0, 1.0]])
    push = np.array([0.5 * dt * dt, dt]) * 0.5 * ANSWER_SIGMA_MPS2
    p = move @ estimate.covariance @ move.T + np.outer(push, push)
    noise = np.diag([POSITION_SIGMA_M**2, SPEED_SIGMA_MPS**2])
    gain = p @ np.linalg.inv(p + noise)
    miss = np.array([position_m - position, speed_mps - speed])
    correction = gain @ miss
    return (
        float(position + correction[0]),
        max(float(speed + correction[1]), 0.0),
        (np.eye(2) - gain) @ p,
    )


def _learn(model: Model, estimate: StateEstimate, answer: float) -> tuple[HypothesisBank, int]:
    """Update every hypothesis with the measured acceleration, and select the best.

    A recursive least-squares step with forgetting; the cost of a hypothesis is its prediction error.
    """
    vehicle, bank, v = model.vehicle, estimate.bank, estimate.speed_mps
    acting = acting_command(estimate.commands, bank.delay_steps)
    share = acting + (bank.share - acting) * bank.keep
    limits = effort_limits(vehicle, model.track, estimate.position_m, v)
    features = np.stack(
        [
            np.maximum(share, 0.0) * limits.traction_mps2,
            np.minimum(share, 0.0) * limits.brake_mps2,
            np.full(share.shape, -limits.resistance_mps2),
        ],
        axis=1,
    )
    free = np.einsum("hk,hk->h", bank.gains, features) - limits.gradient_mps2
    room = float(vehicle.jerk_mps3) * model.dt
    expected = np.clip(free, estimate.acceleration_mps2 - room, estimate.acceleration_mps2 + room)
    standing = v < 0.05
    if standing:
        expected = np.maximum(expected, 0.0)
    miss = np.clip((answer - expected) / ANSWER_SIGMA_MPS2, -6.0, 6.0)
    cost = FORGETTING * bank.cost + miss**2
    # no update where the jerk limit or standstill determines the acceleration: the gains do not show there
    learns = (np.abs(expected - free) < 1e-9) & (not standing or answer > 0)
    wide = bank.covariance + DRIFT_VARIANCE
    spread = np.einsum("hjk,hk->hj", wide, features)
    scale = ANSWER_SIGMA_MPS2**2 + np.einsum("hk,hk->h", features, spread)
    weight = np.where(learns, 1.0 / scale, 0.0)
    bounded = np.clip(answer - free, -0.5, 0.5)
    gains = bank.gains + spread * (weight * bounded)[:, None]
    covariance = wide - np.einsum("hj,hk->hjk", spread, spread) * weight[:, None, None]
    learned = bank._replace(
        share=share,
        gains=np.clip(gains, (0.6, 0.6, 0.0), (1.6, 1.6, 3.0)),
        covariance=covariance,
        cost=cost,
    )
    challenger = int(np.argmin(cost))
    best = challenger if cost[challenger] < cost[estimate.best] - SWITCH_MARGIN else estimate.best
    return learned, best


def look_ahead(model: Model, estimate: StateEstimate) -> PredictedState:
    """Predict the state when a command given now begins to act, with the commands still in the pipeline.

    Args:
        model: Nominal trainset and section.
        estimate: State and plant as estimated.
    """
    bank, best = estimate.bank, estimate.best
    age, keep = float(bank.delay_steps[best]), float(bank.keep[best])
    up, down, drag = (float(k) for k in bank.gains[best])
    motion = Motion(
        estimate.position_m, estimate.speed_mps, estimate.acceleration_mps2, float(bank.share[best])
    )
    limits = effort_limits(model.vehicle, model.track, motion.position_m, motion.speed_mps)
    resistance, gradient, _, traction, brake = map(float, limits)
    if age > 0:
        acting = up * traction, down * brake, drag * resistance + gradient
        commands, jerk = estimate.commands.tolist(), float(model.vehicle.jerk_mps3)
        motion = predict_motion(motion, commands, age, keep, acting, jerk, model.dt)
        limits = effort_limits(model.vehicle, model.track, motion.position_m, motion.speed_mps)
        resistance, gradient, _, traction, brake = map(float, limits)
    before = periods_before(age)
    actuation = float(estimate.commands[0]), max(age - before, 0.0), keep
    return PredictedState(
        before * model.dt, *motion, *actuation, drag * resistance, gradient, up * traction, down * brake
    )

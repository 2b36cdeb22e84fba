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
from collections.abc import Callable
from typing import NamedTuple, no_type_check

import numpy as np
from numpy import ndarray

from metropilot._typing import Float, Scalar
from metropilot.control.prediction import (
    CommandActuation,
    Model,
    Motion,
    PredictedState,
    predict_motion,
    predict_path,
)
from metropilot.physics import (
    Vehicle,
    curve_n,
    effort_limits,
    namespace,
    push_command,
    resistance_and_gradient,
)

MAX_EXTRA_DELAY_S = 1.0
"""Largest dead time among the hypotheses beyond the nominal one."""
EXTRA_LAGS_S = (0.05, 0.25, 0.5)
"""Lags beyond the nominal one at which the hypotheses begin."""
MAX_EXTRA_LAG_S = 0.8
"""Largest lag beyond the nominal one."""
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
GAIN_RANGE = np.array([[0.6, 1.6], [0.6, 1.6], [0.0, 3.0]])
"""Range of traction gain, brake gain and resistance factor."""
DRIFT_PER_S = np.zeros((3, 5, 5, 1))
"""Covariance that a second adds to the parameters at standstill, without traction, and with it: a gain
follows slow changes while it acts. Shape (3, 5, 5, 1)."""
DRIFT_PER_S[1, [1, 2], [1, 2]] = DRIFT_PER_S[2, [0, 2], [0, 2]] = 5e-6
DRIFT_PER_S[1:, 3, 3], DRIFT_PER_S[1:, 4, 4] = 1e-3, 1e-4
NOMINAL_ADVANTAGE = 2.0
"""Prior of the nominal actuation over each other hypothesis, as twice the log-likelihood."""
SWITCH_MARGIN = 10.0
"""Advantage in twice the log-likelihood at which the nominal actuation is given up for another."""
RESELECT_MARGIN = 1.0
"""The same between two others, which differ less."""
FORGETTING = 0.998
"""Discount of the residuals of earlier periods; a half-life of 346 periods."""


CELL_S = 0.1
"""Least range of dead times of a hypothesis, s."""
LEAST_KEEP, MOST_KEEP = 1e-6, 0.999
"""Shares of the effort that remain after a period with no lag, and with the largest that is told."""
KEEP_SIGMA = 0.15
"""Prior standard deviation of the share of the old effort that remains after a period."""
STANDING_MPS = 0.05
"""Speed below which the trainset stands."""
SURE = 3.0
"""Residual in standard deviations that the model cannot explain."""
MOST_SQUARE = 36.0
"""Largest squared normalised residual that counts against a hypothesis."""
NOISE_RATE = 0.02
"""Share of a new residual in the variance of the acceleration."""
LEAST_SIGMA_MPS2 = 0.005
"""Least standard deviation of the acceleration."""
NORMAL_95 = 1.959964
"""Half width of a 95 % interval in standard deviations."""


class Estimate(NamedTuple):
    """Estimate of one number.

    Attributes:
        value: Estimate.
        sigma: Standard deviation.
        low: Lower end of the 95 % interval.
        high: Upper end of it.
    """

    value: float
    sigma: float
    low: float
    high: float


class MeasuredMotion(NamedTuple):
    """Position and speed as estimated, with their covariance. All 0-d.

    Attributes:
        position_m: Position.
        speed_mps: Speed.
        position_variance: Variance of the position.
        covariance: Covariance of both.
        speed_variance: Variance of the speed.
    """

    position_m: Scalar
    speed_mps: Scalar
    position_variance: Scalar
    covariance: Scalar
    speed_variance: Scalar


class PlantEstimate(NamedTuple):
    """Estimate of the plant in the terms of :class:`metropilot.sim.Disturbance`.

    Attributes:
        mass_factor: True over nominal mass, as the traction tells it.
        resistance_factor: True over nominal running resistance.
        brake_factor: Deceleration of the service brake over the nominal one.
        delay_s: Dead time in addition to the nominal one.
        lag_s: Lag in addition to the nominal one.
    """

    mass_factor: Estimate
    resistance_factor: Estimate
    brake_factor: Estimate
    delay_s: Estimate
    lag_s: Estimate


class HypothesisBank(NamedTuple):
    """Hypotheses about dead time and lag, each with its own parameters.

    The parameters are traction gain, brake gain, resistance factor, dead time in control periods (not always
    whole), and the share of the old effort that remains after a period of lag.

    Attributes:
        parameters: Estimated parameters. Shape (5, H).
        covariance: Their covariance. Shape (5, 5, H).
        share: Command after delay and lag. Shape (H,).
        share_slopes: Its derivatives by dead time and by the share that remains. Shape (2, H).
        cost: Discounted negative log-likelihood, twice. Shape (H,).
    """

    parameters: Float[ndarray, "5 hypotheses"]
    covariance: Float[ndarray, "5 5 hypotheses"]
    share: Float[ndarray, " hypotheses"]
    share_slopes: Float[ndarray, "2 hypotheses"]
    cost: Float[ndarray, " hypotheses"]


class Prior(NamedTuple):
    """Bounds and drift of the hypotheses' parameters.

    Attributes:
        low: Least value of each parameter. Shape (5, H).
        high: Largest value. Shape (5, H).
        drift: Covariance added in a period at standstill, without traction, and with it. Shape (3, 5, 5, H).
        nominal_delay_steps: Nominal dead time in control periods.
        nominal_lag_s: Nominal lag.
    """

    low: Float[ndarray, "5 hypotheses"]
    high: Float[ndarray, "5 hypotheses"]
    drift: Float[ndarray, "3 5 5 hypotheses"]
    nominal_delay_steps: float
    nominal_lag_s: float


class StateEstimate(NamedTuple):
    """Estimate of state and plant parameters at the start of a control period.

    Attributes:
        position_m: Position of the head.
        speed_mps: Filtered speed.
        acceleration_mps2: Acceleration over the last period.
        covariance: Variance of position, covariance of position and speed, variance of speed.
        commands: Commands already given, newest first. Shape (D,).
        bank: Hypotheses about the actuation.
        prior: Bounds and drift of their parameters.
        best: Index of the selected hypothesis.
        variance: Variance of the acceleration about the selected hypothesis, m^2/s^4.
        started: False until the first observation.
    """

    position_m: float
    speed_mps: float
    acceleration_mps2: float
    covariance: tuple[float, float, float]
    commands: Float[ndarray, " given"]
    bank: HypothesisBank
    prior: Prior
    best: int
    variance: float
    started: bool

    @property
    def traction_gain(self) -> float:
        """Estimated over nominal traction force per mass."""
        return float(self.bank.parameters[0, self.best])

    @property
    def brake_gain(self) -> float:
        """Estimated over nominal braking force per mass."""
        return float(self.bank.parameters[1, self.best])

    @property
    def brake_gain_sigma(self) -> float:
        """Standard deviation of :attr:`brake_gain`."""
        return float(np.sqrt(self.bank.covariance[1, 1, self.best]))

    @property
    def resistance_factor(self) -> float:
        """Estimated over nominal resistance per mass."""
        return float(self.bank.parameters[2, self.best])

    @property
    def gain_sigmas(self) -> Float[ndarray, " 3"]:
        """Standard deviations of traction gain, brake gain and resistance factor."""
        return np.sqrt(np.diagonal(self.bank.covariance[:3, :3, self.best]))

    @property
    def delay_steps(self) -> float:
        """Estimated dead time in control periods, not always whole."""
        return float(self.bank.parameters[3, self.best])

    @property
    def keep(self) -> float:
        """Estimated share of the old effort that remains after a period of lag."""
        return float(self.bank.parameters[4, self.best])

    @property
    def share(self) -> float:
        """Command after the estimated dead time and lag."""
        return float(self.bank.share[self.best])

    def plant(self, dt: float) -> PlantEstimate:
        """Estimate the plant over the nominal one, with intervals.

        Args:
            dt: Control period, s.
        """
        bank, prior = self.bank, self.prior
        # Between hypotheses, their likelihoods weigh; within each, its own covariance.
        weights = np.exp(-0.5 * (bank.cost - bank.cost.min()))
        weights /= weights.sum()
        delay, keep = bank.parameters[3:]
        delay_variance = weights @ (bank.covariance[3, 3] + (delay - self.delay_steps) ** 2)
        keep_variance = weights @ (bank.covariance[4, 4] + (keep - self.keep) ** 2)
        traction, brake, drag = (float(x) for x in bank.parameters[:3, self.best])
        covariance = bank.covariance[:3, :3, self.best]
        row = np.array([-drag / traction**2, 0.0, 1.0 / traction])
        half = NORMAL_95 * math.sqrt(keep_variance)
        lags = (_lag_of(x, dt) - prior.nominal_lag_s for x in (self.keep, self.keep - half, self.keep + half))
        lag, low, high = (max(x, 0.0) for x in lags)
        return PlantEstimate(
            mass_factor=_interval(1.0 / traction, covariance[0, 0] / traction**4),
            resistance_factor=_interval(drag / traction, float(row @ covariance @ row)),
            brake_factor=_interval(brake, covariance[1, 1]),
            delay_s=_interval((self.delay_steps - prior.nominal_delay_steps) * dt, dt * dt * delay_variance),
            lag_s=Estimate(lag, (high - low) / (2.0 * NORMAL_95), low, high),
        )


def _interval(value: float, variance: float) -> Estimate:
    """Estimate with its normal 95 % interval, cut at zero."""
    sigma = math.sqrt(max(variance, 0.0))
    half = NORMAL_95 * sigma
    return Estimate(float(value), sigma, max(float(value) - half, 0.0), float(value) + half)


def _lag_of(keep: float, dt: float) -> float:
    """Lag with which so much of the old effort remains after a period, s."""
    return -dt / math.log(min(keep, MOST_KEEP)) if keep > LEAST_KEEP else 0.0


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
    lag = float(model.vehicle.lag_s)
    cells = max(round(MAX_EXTRA_DELAY_S / max(dt, CELL_S)), 1)
    width = MAX_EXTRA_DELAY_S / dt / cells
    floors, lags = (x.ravel() for x in np.meshgrid(np.arange(cells) * width, EXTRA_LAGS_S, indexing="ij"))
    # The first hypothesis is the nominal actuation, which is exact unless the answers contradict it.
    floors, width = np.append(0.0, floors) + known, np.append(0.0, np.full(floors.size, width))
    lags = np.append(0.0, lags) + lag
    keep = np.where(lags > 0.0, np.exp(-dt / np.maximum(lags, 1e-6)), 0.0)
    count = floors.size
    parameters = np.ones((5, count))
    parameters[3], parameters[4] = floors + 0.5 * width, keep
    low, high = np.empty((5, count)), np.empty((5, count))
    low[:3], high[:3] = GAIN_RANGE[:, :1], GAIN_RANGE[:, 1:]
    low[3], high[3] = floors, floors + width
    low[4], high[4] = 0.0, math.exp(-dt / (lag + MAX_EXTRA_LAG_S))
    covariance = np.zeros((5, 5, count))
    covariance[range(3), range(3)] = np.array([[EFFORT_SIGMA], [EFFORT_SIGMA], [RESISTANCE_SIGMA]]) ** 2
    weighs = 1 if weighed_brakes else 2
    covariance[:weighs, :weighs] += MASS_SIGMA**2
    covariance[3, 3] = width**2 / 12.0
    covariance[4, 4, 1:] = KEEP_SIGMA**2
    drift = np.repeat(dt * DRIFT_PER_S, count, axis=3)
    drift[:, 3:, 3:, 0] = 0.0
    bank = HypothesisBank(
        parameters=parameters,
        covariance=covariance,
        share=np.zeros(count),
        share_slopes=np.zeros((2, count)),
        cost=np.where(np.arange(count) == 0, -NOMINAL_ADVANTAGE, 0.0),
    )
    return StateEstimate(
        position_m=float(position_m),
        speed_mps=float(speed_mps),
        acceleration_mps2=0.0,
        covariance=(POSITION_SIGMA_M**2, 0.0, SPEED_SIGMA_MPS**2),
        commands=np.zeros(math.floor(float(high[3].max())) + 2),
        bank=bank,
        prior=Prior(low, high, drift, known, lag),
        best=0,
        variance=ANSWER_SIGMA_MPS2**2,
        started=False,
    )


def update_estimate(
    model: Model,
    estimate: StateEstimate,
    position_m: float,
    speed_mps: float,
    acceleration_mps2: float,
    *,
    intervention: int = 0,
) -> StateEstimate:
    """Update the estimate with this period's measurements.

    Args:
        model: Nominal trainset and section.
        estimate: The estimate of the period before, after :func:`record_command`.
        position_m: Measured position.
        speed_mps: Measured speed, noisy.
        acceleration_mps2: Acceleration over the last period.
        intervention: Level at which protection overruled the last command (0: it did not): the answer says
            nothing about the plant, and protection's command is on its way instead.
    """
    if not estimate.started:
        return estimate._replace(
            position_m=float(position_m),
            speed_mps=float(speed_mps),
            acceleration_mps2=float(acceleration_mps2),
            started=True,
        )
    bank, best, variance = estimate.bank, estimate.best, estimate.variance
    if intervention > 0:
        estimate = estimate._replace(commands=_overrule(estimate.commands, intervention))
        share, slopes = _next_shares(bank, estimate.commands)
        bank = bank._replace(share=share, share_slopes=slopes)
    else:
        bank, best, variance = _learn(model, estimate, float(acceleration_mps2))
    known = MeasuredMotion(estimate.position_m, estimate.speed_mps, *estimate.covariance)
    measured = float(position_m), float(speed_mps), float(acceleration_mps2)
    motion = MeasuredMotion(*map(float, fuse_motion(known, *measured, model.dt)))
    return estimate._replace(
        position_m=motion.position_m,
        speed_mps=motion.speed_mps,
        acceleration_mps2=float(acceleration_mps2),
        covariance=motion[2:],
        bank=bank,
        best=best,
        variance=variance,
    )


def record_command(estimate: StateEstimate, share: float) -> StateEstimate:
    """Add the command just given to the estimate."""
    newest = min(max(float(share), -1.0), 1.0)
    return estimate._replace(commands=push_command(estimate.commands, newest))


@no_type_check
def first_motion(position_m: Scalar, speed_mps: Scalar) -> MeasuredMotion:
    """Motion as first measured."""
    zero = 0.0 * position_m
    return MeasuredMotion(position_m, speed_mps, zero + POSITION_SIGMA_M**2, zero, zero + SPEED_SIGMA_MPS**2)


@no_type_check
def fuse_motion(
    motion: MeasuredMotion, position_m: Scalar, speed_mps: Scalar, acceleration_mps2: Scalar, dt: Scalar
) -> MeasuredMotion:
    """Kalman filter of position and speed, with the measured acceleration of the period as its input.

    Args:
        motion: As estimated a period ago.
        position_m: Measured position.
        speed_mps: Measured speed, noisy.
        acceleration_mps2: Acceleration over the period.
        dt: Period, s.
    """
    x, v, xx, xv, vv = motion
    x = x + v * dt + 0.5 * acceleration_mps2 * dt * dt
    v = v + acceleration_mps2 * dt
    push = 0.5 * ANSWER_SIGMA_MPS2
    along, across = 0.5 * dt * dt * push, dt * push
    xx = xx + (dt * (2.0 * xv + dt * vv) + along * along)
    xv = xv + (dt * vv + along * across)
    vv = vv + across * across
    # The errors of the two measurements are independent: one after the other is the same as both at once.
    scale, miss = xx + POSITION_SIGMA_M**2, position_m - x
    x, v = x + xx / scale * miss, v + xv / scale * miss
    xx, xv, vv = xx - xx * xx / scale, xv - xx * xv / scale, vv - xv * xv / scale
    scale, miss = vv + SPEED_SIGMA_MPS**2, speed_mps - v
    x, v = x + xv / scale * miss, v + vv / scale * miss
    xx, xv, vv = xx - xv * xv / scale, xv - xv * vv / scale, vv - vv * vv / scale
    return MeasuredMotion(x, namespace(x, v).maximum(v, 0.0), xx, xv, vv)


def _overrule(commands: Float[ndarray, " given"], intervention: int) -> Float[ndarray, " given"]:
    """Commands given with protection's in place of the newest: traction cut, or full braking."""
    share = min(float(commands[0]), 0.0) if intervention == 1 else -1.0
    return np.append(share, commands[1:])


def _next_shares(
    bank: HypothesisBank, commands: Float[ndarray, " given"]
) -> tuple[Float[ndarray, " hypotheses"], Float[ndarray, "2 hypotheses"]]:
    """Command after dead time and lag in the coming period, and its derivatives by both."""
    delay, keep = bank.parameters[3:]
    whole = delay.astype(np.intp)
    newer = commands.take(whole)
    slope = commands.take(whole + 1) - newer
    acting = newer + (delay - whole) * slope
    behind = bank.share - acting
    slopes = keep * bank.share_slopes
    slopes[0] += (1.0 - keep) * slope
    slopes[1] += behind
    return acting + keep * behind, slopes


def _learn(model: Model, estimate: StateEstimate, answer: float) -> tuple[HypothesisBank, int, float]:
    """Update every hypothesis with the measured acceleration, and select the most likely.

    A step of the recursive prediction error method (Ljung and Soderstrom, 1983): least squares in which the
    command after dead time and lag has its derivatives by both as further features.
    """
    vehicle, bank, prior, v = model.vehicle, estimate.bank, estimate.prior, estimate.speed_mps
    traction_gain, brake_gain = bank.parameters[:2]
    share, slopes = _next_shares(bank, estimate.commands)
    limits = effort_limits(vehicle, model.track, estimate.position_m, v)
    traction, brake = float(limits.traction_mps2), float(limits.brake_mps2)
    features = np.empty_like(bank.parameters)
    features[0] = np.maximum(share, 0.0) * traction
    features[1] = np.minimum(share, 0.0) * brake
    features[2] = -float(limits.resistance_mps2)
    features[3:] = np.where(share > 0.0, traction_gain * traction, brake_gain * brake) * slopes
    free = np.einsum("kh,kh->h", bank.parameters[:3], features[:3]) - float(limits.gradient_mps2)
    room = float(vehicle.jerk_mps3) * model.dt
    expected = np.minimum(
        np.maximum(free, estimate.acceleration_mps2 - room), estimate.acceleration_mps2 + room
    )
    standing = v < STANDING_MPS
    if standing:
        expected = np.maximum(expected, 0.0)
    mode = 0 if standing and answer == 0.0 else 1 + int(share[estimate.best] > 0.0)
    wide = bank.covariance + prior.drift[mode]
    spread = np.einsum("jkh,kh->jh", wide, features)
    variance = estimate.variance
    scale = variance + np.einsum("kh,kh->h", features, spread)
    miss, weight = answer - free, 1.0 / scale
    informative = expected == free
    if not informative.all():
        # Where the jerk limit or standstill explains the acceleration, it says nothing about the effort.
        informative |= np.abs(answer - expected) > SURE * math.sqrt(variance)
        miss = np.where(informative, miss, answer - expected)
        scale, weight = np.where(informative, scale, variance), weight * informative
    square = miss * miss / scale
    cost = FORGETTING * bank.cost + np.minimum(square, MOST_SQUARE) + np.log(scale / variance)
    # A miss that the estimate cannot explain moves it no further than one that it just can.
    bounded = miss / np.sqrt(np.maximum(1.0, square / SURE**2))
    parameters = bank.parameters + spread * (weight * bounded)
    parameters = np.minimum(np.maximum(parameters, prior.low), prior.high)
    covariance = wide - spread[:, None] * (spread * weight)
    challenger = int(cost.argmin())
    margin = SWITCH_MARGIN if estimate.best == 0 else RESELECT_MARGIN
    best = challenger if cost[challenger] < cost[estimate.best] - margin else estimate.best
    if informative[best]:
        found = variance * min(float(square[best]), SURE**2)
        variance = max(variance + NOISE_RATE * (found - variance), LEAST_SIGMA_MPS2**2)
    return HypothesisBank(parameters, covariance, share, slopes, cost), best, variance


def look_ahead(model: Model, estimate: StateEstimate) -> PredictedState:
    """Predict the state when a command given now begins to act, with the commands still in the pipeline.

    Args:
        model: Nominal trainset and section.
        estimate: State and plant as estimated.
    """
    age, keep, motion = _motion(estimate)
    up, down, drag = estimate.bank.parameters[:3, estimate.best].tolist()
    limits = effort_limits(model.vehicle, model.track, motion.position_m, motion.speed_mps)
    resistance, gradient, _, traction, brake = map(float, limits)
    if age > 0:
        acting = up * traction, down * brake, drag * resistance + gradient
        commands, jerk = estimate.commands.tolist(), float(model.vehicle.jerk_mps3)
        motion = predict_motion(motion, commands, age, keep, acting, jerk, model.dt)
        limits = effort_limits(model.vehicle, model.track, motion.position_m, motion.speed_mps)
        resistance, gradient, _, traction, brake = map(float, limits)
    seconds = age * model.dt
    return PredictedState(seconds, *motion, keep, drag * resistance, gradient, up * traction, down * brake)


def look_along(
    model: Model, estimate: StateEstimate, periods: int
) -> Callable[[Scalar], Float[ndarray, "2 periods"]]:
    """Prepare to predict the path of the coming periods.

    Args:
        model: Nominal trainset and section.
        estimate: State and plant as estimated.
        periods: Periods to predict.

    Returns:
        Positions, m, and speeds, m/s, at the end of each period, as a function of the command.
    """
    age, keep, motion = _motion(estimate)
    vehicle, (x, v) = model.vehicle, motion[:2]
    up, down, factor = estimate.bank.parameters[:3, estimate.best].tolist()
    limits = effort_limits(vehicle, model.track, x, v)
    acting = up * float(limits.traction_mps2), down * float(limits.brake_mps2)
    drags = [factor * float(limits.resistance_mps2) + float(limits.gradient_mps2)]
    if periods > 1:
        # A gradient may change within the dead time by more than a brake gives; the speed hardly does.
        at = x + v * model.dt * np.arange(1, periods)
        resistance, gradient = resistance_and_gradient(vehicle, model.track, at, v)
        drags += list((factor * resistance + gradient) / float(vehicle.effective_mass_kg))
    before, jerk = estimate.commands.tolist(), float(vehicle.jerk_mps3)

    @no_type_check
    def look(share: Scalar) -> Float[ndarray, "2 periods"]:
        return predict_path(motion, [share, *before], age, keep, acting, drags, jerk, model.dt)

    return look


def estimated_actuation(estimate: StateEstimate, dt: float) -> CommandActuation:
    """Commands in the pipeline of the dead time and the lag as estimated.

    Args:
        estimate: State and plant as estimated.
        dt: Control period, s.
    """
    age, keep, motion = _motion(estimate)
    return CommandActuation(estimate.commands.tolist(), motion.share, age, keep, _lag_of(keep, dt), dt)


def _motion(estimate: StateEstimate) -> tuple[float, float, Motion]:
    """Dead time in control periods, share of an effort that a period of lag keeps, and the motion now."""
    delay, keep = estimate.bank.parameters[3:, estimate.best].tolist()
    # A part of a period that is only estimated is not compensated: commands would ring at each correction.
    nominal = estimate.prior.nominal_delay_steps
    motion = Motion(estimate.position_m, estimate.speed_mps, estimate.acceleration_mps2, estimate.share)
    return nominal + round(delay - nominal), keep, motion

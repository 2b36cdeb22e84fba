"""The own plant as a trainset of a convoy knows it: what is on its way, and gains learned from its answer."""

from __future__ import annotations

import math
from typing import NamedTuple, no_type_check

import numpy as np

from metropilot._typing import Array, Scalar
from metropilot.control import (
    Adaptation,
    MeasuredMotion,
    Motion,
    PredictedState,
    acting_command,
    adapt_vehicle,
    first_motion,
    fuse_motion,
    predict_motion,
    weighs_load,
)
from metropilot.convoy.step import FollowerObservation
from metropilot.physics import Vehicle, effort_limits, kept_share, namespace, push_command, scalars

SURE_MPS2 = 0.02
"""Least distance of a deceleration from the controlled rate at which it says something about the brake."""
MOVING_MPS = 0.05
BELOW = 0.98
"""A change of acceleration below this share of the largest one is not made by the jerk limit."""
STANDS_MPS = 0.005
"""Estimated speed up to which a measured speed of nothing means standstill, and not noise."""
MASS_SIGMA, EFFORT_SIGMA, RESISTANCE_SIGMA = 0.12, 0.05, 0.4
"""Prior standard deviations: of the mass, of each gain apart from it, of the factor on resistance."""
ANSWER_SIGMA_MPS2 = 0.02
"""Standard deviation of the acceleration about the model's."""
DRIFT_VARIANCE = np.diag([1e-6, 1e-6, 1e-6])
"""Variance added to the gains in each period, so that they can follow slow changes."""
LEAST_GAINS, LARGEST_GAINS = np.array([0.6, 0.6, 0.0]), np.array([1.6, 1.6, 3.0])
"""Bounds on traction gain, brake gain and resistance factor."""


BANDWIDTH_PER_JERK, BANDWIDTH_LAG = 0.8, 0.3
"""Bandwidth with which a place can be held: over the jerk limit in m/s^3, and its product with the lag."""


class OwnPlant(NamedTuple):
    """Estimate of the own motion, actuation and plant.

    Attributes:
        commands: Commands that protection passed, newest first. Shape (D,).
        share: Command after dead time and lag. 0-d, as all below but the two of the gains.
        gains: Traction gain, brake gain, resistance factor. Shape (3,).
        covariance: Their covariance. Shape (3, 3).
        motion: Own position and speed, filtered; without variance before the first measurement.
        stands: 1 once it has stood for a period, else 0.
        acceleration_mps2: Own acceleration over the period before.
    """

    commands: Array
    share: Scalar
    gains: Array
    covariance: Array
    motion: MeasuredMotion
    stands: Scalar
    acceleration_mps2: Scalar


def own_plant(vehicle: Vehicle, period_s: float) -> OwnPlant:
    """Make the estimate before departure: nominal gains, nothing on its way (NumPy).

    Args:
        vehicle: Nominal plant.
        period_s: Control period.
    """
    kind = np.asarray(vehicle.mass_kg).dtype.type
    covariance = np.diag([EFFORT_SIGMA**2, EFFORT_SIGMA**2, RESISTANCE_SIGMA**2])
    # A brake that is controlled to a deceleration at any load says nothing about the mass.
    weighs = 1 if weighs_load(vehicle) else 2
    covariance[:weighs, :weighs] += MASS_SIGMA**2
    slots = math.ceil(round(float(vehicle.delay_s) / period_s, 6)) + 1
    zero = kind(0.0)
    return OwnPlant(
        commands=np.zeros(slots, kind),
        share=zero,
        gains=np.ones(3, kind),
        covariance=covariance.astype(kind),
        motion=MeasuredMotion(*(zero,) * len(MeasuredMotion._fields)),
        stands=kind(1.0),
        acceleration_mps2=zero,
    )


def learned_vehicle(plant: OwnPlant, vehicle: Vehicle) -> Vehicle:
    """The nominal plant with the learned gains (NumPy)."""
    return adapt_vehicle(vehicle, Adaptation(*(float(gain) for gain in plant.gains)))


@no_type_check
def update_gains(
    gains: Array, covariance: Array, features: Array, miss_mps2: Scalar, learns: Scalar
) -> tuple[Array, Array]:
    """Update gains and their covariance by recursive least squares with drift.

    Unlike :mod:`metropilot.control.estimator` it takes dead time and lag as they are declared, and runs
    compiled.

    Args:
        gains: Traction gain, brake gain, resistance factor. Shape (3,).
        covariance: Their covariance. Shape (3, 3).
        features: Traction, brake (negative) and resistance (negative) of the nominal plant. Shape (3,).
        miss_mps2: Measured acceleration less the expected one. 0-d.
        learns: True if the measurement says something about the gains. 0-d.
    """
    xp = namespace(gains, features)
    kind = covariance.dtype
    wide = covariance + DRIFT_VARIANCE.astype(kind)
    spread = wide @ features
    weight = xp.where(learns, 1.0 / (ANSWER_SIGMA_MPS2**2 + features @ spread), 0.0)
    gains = gains + spread * (weight * xp.clip(miss_mps2, -0.5, 0.5))
    covariance = wide - xp.outer(spread, spread) * weight
    return xp.clip(gains, LEAST_GAINS.astype(kind), LARGEST_GAINS.astype(kind)), covariance


@no_type_check
def learn(plant: OwnPlant, observation: FollowerObservation) -> OwnPlant:
    """Update the own actuation, speed and gains with what the last command did."""
    vehicle, dt = observation.vehicle, observation.period_s
    xp = namespace(observation.position_m, observation.gap_m)
    join = np if xp is scalars else xp
    commands = push_command(plant.commands, observation.command)
    acting = acting_command(commands, xp.maximum(vehicle.delay_s / dt - 1e-6, 0.0))
    share = acting + (plant.share - acting) * kept_share(vehicle.lag_s, dt)
    known = plant.motion
    limits = effort_limits(vehicle, observation.track, known.position_m, known.speed_mps)
    features = join.stack(
        [
            xp.maximum(share, 0.0) * limits.traction_mps2,
            xp.minimum(share, 0.0) * limits.brake_mps2,
            -limits.resistance_mps2,
        ]
    )
    free = (plant.gains * features).sum() - limits.gradient_mps2
    answer, before = observation.acceleration_mps2, plant.acceleration_mps2
    room = xp.minimum(vehicle.jerk_mps3 * dt, 1e3)
    # Nothing shows at the jerk limit, at a controlled rate, at standstill, or in the period of the stop.
    unlimited = xp.abs(answer - before) < BELOW * room
    controlled = answer < SURE_MPS2 - observation.most_mps2
    moving = (known.speed_mps > MOVING_MPS) & (observation.speed_mps > MOVING_MPS)
    learns = unlimited & (controlled ^ True) & moving
    gains, covariance = update_gains(plant.gains, plant.covariance, features, answer - free, learns)
    measured = observation.position_m, observation.speed_mps
    fused = fuse_motion(known, *measured, answer, dt)
    first, zero = first_motion(*measured), 0.0 * observation.position_m
    begins = known.speed_variance <= 0.0
    motion = MeasuredMotion(*(xp.where(begins, a, b) for a, b in zip(first, fused, strict=True)))
    # A measured speed is never negative: at a crawl noise makes it nothing.
    nothing = observation.speed_mps <= 0.0
    stands = nothing & (answer == 0.0)
    still = stands | (nothing & (motion.speed_mps <= STANDS_MPS))
    return plant._replace(
        commands=commands,
        share=share,
        gains=gains,
        covariance=covariance,
        motion=motion._replace(speed_mps=xp.where(still, 0.0 * motion.speed_mps, motion.speed_mps)),
        stands=xp.where(stands, 1.0, zero),
        acceleration_mps2=answer,
    )


@no_type_check
def most_bandwidth(vehicle: Vehicle) -> Scalar:
    """Largest bandwidth with which a trainset can hold a place, 1/s; a faster correction would swing."""
    xp = namespace(vehicle.jerk_mps3, vehicle.lag_s)
    return xp.minimum(BANDWIDTH_PER_JERK * vehicle.jerk_mps3, BANDWIDTH_LAG / xp.maximum(vehicle.lag_s, 1e-6))


@no_type_check
def look_ahead(plant: OwnPlant, observation: FollowerObservation) -> PredictedState:
    """Predict the own state when a command given now begins to act."""
    vehicle, track, dt = observation.vehicle, observation.track, observation.period_s
    up, down, drag = plant.gains
    xp = namespace(observation.position_m, vehicle.delay_s)
    # A dead time of whole periods stays whole: 0.14 / 0.02 is a little more than 7.
    steps, keep = xp.maximum(vehicle.delay_s / dt - 1e-6, 0.0), kept_share(vehicle.lag_s, dt)
    motion = Motion(plant.motion.position_m, plant.motion.speed_mps, plant.acceleration_mps2, plant.share)
    limits = effort_limits(vehicle, track, motion.position_m, motion.speed_mps)
    if plant.commands.shape[0] > 1:
        forces = (
            up * limits.traction_mps2,
            down * limits.brake_mps2,
            drag * limits.resistance_mps2 + limits.gradient_mps2,
        )
        motion = predict_motion(motion, plant.commands, steps, keep, forces, vehicle.jerk_mps3, dt)
        limits = effort_limits(vehicle, track, motion.position_m, motion.speed_mps)
    return PredictedState(
        steps * dt,
        *motion,
        keep,
        drag * limits.resistance_mps2,
        limits.gradient_mps2,
        up * limits.traction_mps2,
        down * limits.brake_mps2,
    )

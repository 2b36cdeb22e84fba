"""Plant mismatch under a learned policy: look ahead, replan the tables, and keep clear of protection.

A policy and its assists see the nominal plant and the current state. Under plant mismatch (a command that
acts late, a heavier trainset, a stronger resistance) their station-stop braking begins too late and their
ceiling is too high. The estimator of every run is that of :mod:`metropilot.control.estimator`. As
long as protection's bounds hold neither dead time nor lag, nor a brake guaranteed weaker than the service
brake, the jerk limit is no lower than ``SLOW_MPS3``, and the estimator finds nothing, nothing of it is
acted upon, and the drive is the policy's own to the last bit. With a low jerk limit, a dead time or lag, in
the bounds or found, or efforts that are off by more than ``LEAST`` and by more than doubt allows, the policy
sees the state in which its command begins to act and the estimated plant, the station-stop braking follows
the law of :mod:`metropilot.control.stopping`, and the ceiling is that of :mod:`metropilot.control.ceiling`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from metropilot.control import (
    LAG_SOFT_M,
    Adaptation,
    Ceiling,
    Model,
    PredictedState,
    StateEstimate,
    StopCurve,
    StopOptions,
    ask_protection,
    braking_distance,
    braking_time,
    build_up,
    ceiling_of,
    curve_for,
    departs_from,
    initial_estimate,
    model_of,
    record_command,
    stand,
    stop_with_brake,
    update_estimate,
    weighs_load,
)
from metropilot.protection import Bounds, Memory, at_start, guarantees_less
from metropilot.railway import Section, Trainset
from metropilot.sim import Observation, Run, declared_bounds

LEAST = 0.04
"""Efforts this near to nominal count as nominal."""
LEAST_RESISTANCE = 0.2
"""The same for resistance, which is a small part of what moves a trainset."""
SURE = 3.0
"""Standard deviations by which an effort must be off."""
PATIENCE_S = 3.0
"""Least time between two adaptations to what was learned."""
CAREFUL_USE = 0.97
"""Share of the policy's own station-stop deceleration that is planned with."""
BEGIN = 0.97
"""The station-stop braking begins where it needs this share of the deceleration planned."""
LATEST = 1.05
"""...or where it would need this share of it after another period."""
LET_GO = 0.75
"""Below this share of it the braking was too early, and the policy drives on..."""
LET_GO_M = 60.0
"""...if there is more than this left to the stop."""
CAREFUL_STOP = StopOptions(release_share=0.95)
"""The station stop of a careful driver: a quick release, as its policy's own stop takes longer."""
LATE_STOP = StopOptions(build_share=0.9, release_share=0.5, end_share=0.125)
"""The same where dead time or lag are in the bounds: what is on its way cannot be taken back, and the rest of
the jerk limit is there to correct the error."""
LAG_STOP = replace(LATE_STOP, soft_m=LAG_SOFT_M)
"""The same under a declared lag."""
NEAR_ENOUGH_M = 0.1
"""An error at the stop that is not worth the time a correction takes."""
RESERVE_S = 0.2
"""Time before the scheduled one at which the policy is asked to arrive, besides the careful stop's."""
LATE_S = 3.0
"""A trainset that would arrive later by less than this if it coasted holds its speed..."""
NEAR_STOP = 1.25
"""...where no more than this share of the time to go is left."""
SURELY_LATE_S = 0.5
"""One that even flat out would be later by more than this drives flat out..."""
STOPS_S = 15.0
"""...until the station stop is so near, flat out."""
SLOW_MPS3 = 0.8
"""Jerk limit under which a brake has to be asked for earlier than a policy learned to."""
MARGIN_MPS = 0.05
"""Distance of the ceiling below the permitted speed, besides the error of a measurement."""


class ProtectionCopy(NamedTuple):
    """Protection kept alongside, to stay clear of it.

    Attributes:
        supervision: State of protection.
        ceiling: Largest speed and acceleration under it.
    """

    supervision: Memory
    ceiling: Ceiling


class PlantMonitor(NamedTuple):
    """Estimate of the plant during a run.

    Attributes:
        model: Nominal trainset and section.
        estimate: Estimate of the state and of the plant.
        protection: Protection kept alongside; None as long as nothing departs from the nominal plant and
            nothing is late.
        adapted: Plant that the tables in force assume.
        adapted_at_s: Since when.
    """

    model: Model
    estimate: StateEstimate
    protection: ProtectionCopy | None
    adapted: Adaptation
    adapted_at_s: float

    @property
    def adaptation(self) -> Adaptation:
        """Estimated plant; a brake stronger than nominal counts as nominal."""
        estimate = self.estimate
        return Adaptation(estimate.traction_gain, min(estimate.brake_gain, 1.0), estimate.resistance_factor)


def start_monitor(run: Run) -> PlantMonitor:
    """Estimate before departure."""
    model = model_of(run, run.section)
    estimate = initial_estimate(model, weighed_brakes=weighs_load(model.vehicle))
    protection = _copy_protection(estimate, run, run.section) if declares_departure(run) else None
    return PlantMonitor(model, estimate, protection, Adaptation(), -np.inf)


def update_monitor(monitor: PlantMonitor, run: Run, observation: Observation) -> PlantMonitor:
    """Update the estimate with this period's measurements.

    Args:
        monitor: Estimate before, the command of the last period included.
        run: The run.
        observation: Measurements of this period.
    """
    seen = observation.position_m, observation.speed_mps, observation.acceleration_mps2
    protection = monitor.protection
    own = 0 if protection is None else int(protection.supervision.level)
    intervention = max(own, observation.intervention)
    estimate = update_estimate(monitor.model, monitor.estimate, *seen, intervention=intervention)
    if protection is None and departs(estimate):
        protection = _copy_protection(estimate, run, observation.section)
    return monitor._replace(estimate=estimate, protection=protection)


def set_section(monitor: PlantMonitor, run: Run, section: Section) -> PlantMonitor:
    """Change to a section with a restriction that has just been announced."""
    monitor = monitor._replace(model=model_of(run, section))
    if monitor.protection is None:
        return monitor
    return monitor._replace(
        protection=_copy_protection(monitor.estimate, run, section)._replace(
            supervision=monitor.protection.supervision
        )
    )


def record_decision(monitor: PlantMonitor, share: float) -> PlantMonitor:
    """Add a command that has been given to the estimate."""
    return monitor._replace(estimate=record_command(monitor.estimate, share))


def declares_departure(run: Run) -> bool:
    """Tell if protection's bounds say before departure that a policy must not drive as it learned to."""
    declared, trainset = declared_bounds(run), run.disturbance.nominal(run.trainset)
    return builds_up_slowly(trainset) or answers_late(declared) or guarantees_less(trainset, declared)


def builds_up_slowly(trainset: Trainset) -> bool:
    """Tell if a brake builds up more slowly than a policy learned to reckon with."""
    return trainset.actuation.jerk_limit_mps3 < SLOW_MPS3


def answers_late(declared: Bounds) -> bool:
    """Tell if protection's bounds hold a dead time or a lag of the service actuation."""
    return declared.delay_s > 0.0 or declared.lag_s > 0.0


def stop_options(monitor: PlantMonitor) -> StopOptions:
    """Constants of the station stop, soft where protection's bounds hold late commands."""
    if monitor.protection is None or monitor.protection.ceiling.late_s <= 0.0:
        return CAREFUL_STOP
    return LAG_STOP if float(monitor.model.vehicle.lag_s) > 0.0 else LATE_STOP


def departs(estimate: StateEstimate) -> bool:
    """Tell if the plant surely departs from the nominal one."""
    if estimate.best != 0:
        return True
    gains = estimate.traction_gain, estimate.brake_gain, estimate.resistance_factor
    off = np.abs(np.subtract(gains, 1.0))
    least = np.array([LEAST, LEAST, LEAST_RESISTANCE])
    return bool((off > np.maximum(least, SURE * estimate.gain_sigmas)).any())


def is_outdated(monitor: PlantMonitor, time_s: float) -> bool:
    """Tell if the tables in force are of another plant than the one estimated since."""
    if monitor.protection is None or time_s - monitor.adapted_at_s < PATIENCE_S:
        return False
    return departs_from(monitor.adaptation, monitor.adapted)


def arrival_reserve(monitor: PlantMonitor, planned_mps2: float, own: StopOptions, speed_mps: float) -> float:
    """Time before the scheduled one at which the policy is asked to arrive, s.

    The policy allows for the station stop it was trained with; the careful one takes longer.

    Args:
        monitor: Estimate of the plant.
        planned_mps2: Deceleration the policy's station-stop braking is planned with.
        own: Constants of that stop.
        speed_mps: Speed from which it will brake.
    """
    model = monitor.model
    careful = curve_for(model.vehicle, model.dt, CAREFUL_USE * planned_mps2, stop_options(monitor))
    later_s = _stop_delay(careful, speed_mps)
    prompt = model.vehicle._replace(lag_s=np.float64(0.0))
    later_s -= _stop_delay(curve_for(prompt, model.dt, planned_mps2, own), speed_mps)
    return RESERVE_S + max(later_s, 0.0)


def limit_to_ceiling(monitor: PlantMonitor, ahead: PredictedState, share: float, most_mps2: float) -> float:
    """Limit a command to stay under the ceiling.

    Args:
        monitor: Estimate of the plant.
        ahead: State in which a command given now begins to act.
        share: Command wanted.
        most_mps2: Largest acceleration for other reasons.
    """
    if monitor.protection is None:
        return share
    most = min(monitor.protection.ceiling.approach(ahead), most_mps2)
    return min(share, ahead.share_for(most))


def station_stop_braking(
    monitor: PlantMonitor, ahead: PredictedState, planned_mps2: float, stopping: bool
) -> tuple[bool, float]:
    """Decide on the station-stop braking: True if it is on, and its command.

    Args:
        monitor: Estimate of the plant.
        ahead: State in which a command given now begins to act.
        planned_mps2: Deceleration the policy's station-stop braking is planned with.
        stopping: True if it was on.
    """
    model, rate = monitor.model, CAREFUL_USE * planned_mps2
    target = float(model.track.length_m)
    options = stop_options(monitor)
    curve = curve_for(model.vehicle, model.dt, rate, options)
    stop, available = stop_with_brake(model, monitor.estimate, ahead, target, curve, CAREFUL_USE, options)
    left = stop.left_m
    early = stop.required_mps2 < LET_GO * rate and left > LET_GO_M
    short = ahead.speed_mps <= 0 and left > LET_GO_M
    begins = stop.required_mps2 >= BEGIN * rate or stop.later_mps2 >= min(LATEST * planned_mps2, available)
    share = stand(model, stop, NEAR_ENOUGH_M, NEAR_ENOUGH_M, options)
    return (begins or (stopping and not early)) and not short, share


def limit_by_protection(
    monitor: PlantMonitor, observation: Observation, share: float
) -> tuple[float, PlantMonitor]:
    """Limit a command to the largest that protection lets pass."""
    if monitor.protection is None:
        return share, monitor
    protection = monitor.protection
    guard, before = protection.ceiling.guard, protection.supervision
    share, supervision = ask_protection(guard, before, monitor.model, monitor.estimate, observation, share)
    return float(share), monitor._replace(protection=protection._replace(supervision=supervision))


def _stop_delay(curve: StopCurve, speed_mps: float) -> float:
    """Time that a stop takes longer than its distance at constant speed, s."""
    quick, built_m, built_s = build_up(speed_mps, 0.0, curve.deceleration_mps2, curve.build_jerk_mps3)
    distance = built_m + braking_distance(quick, curve)
    return float(built_s + braking_time(quick, curve) - distance / speed_mps)


def _copy_protection(estimate: StateEstimate, run: Run, section: Section) -> ProtectionCopy:
    """Set up protection on a section, with the commands that are on their way."""
    ceiling = ceiling_of(run, section, MARGIN_MPS)
    supervision = at_start(ceiling.guard)
    count, known = np.size(supervision.recent), estimate.commands.size
    supervision = supervision._replace(
        recent=np.pad(estimate.commands, (0, max(count - known, 0)), "edge")[:count],
        share=np.float64(estimate.share),
        acceleration_mps2=np.float64(estimate.acceleration_mps2),
    )
    return ProtectionCopy(supervision, ceiling)

"""Plant mismatch under a learned policy: look ahead, replan the tables, and keep clear of protection.

A policy and its assists see the nominal plant and the current state. Under plant mismatch (a command that
acts late, a heavier trainset, a stronger resistance) their station-stop braking begins too late and their
ceiling is too high. So every run is watched by the estimator of :mod:`metropilot.control.estimator`. As
long as protection's bounds hold neither dead time nor lag, and the estimator finds nothing, nothing of it is
acted upon, and the drive is the policy's own to the last bit. With a dead time or lag, in the bounds or
found, or efforts that are off by more than ``LEAST`` and by more than doubt allows, the policy sees the state
in which its command begins to act and the estimated plant, the station-stop braking follows the law
of :mod:`metropilot.control.stopping`, and the ceiling is that of :mod:`metropilot.control.ceiling`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from metropilot.control import (
    Adaptation,
    Ceiling,
    Model,
    PredictedState,
    StateEstimate,
    StopOptions,
    ceiling_of,
    curve_for,
    initial_estimate,
    largest_admissible_command,
    record_command,
    share_for,
    stand,
    stop_command,
    update_estimate,
    weighs_load,
)
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.protection import Bounds, Memory, at_start
from metropilot.railway import Section
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
LET_GO = 0.75
"""Below this share of it the braking was too early, and the policy drives on..."""
LET_GO_M = 60.0
"""...if there is more than this left to the stop."""
CAREFUL_STOP = StopOptions(release_share=0.95)
"""The station stop of a careful driver: a quick release, as its policy's own stop takes longer."""
LATE_STOP = StopOptions(build_share=0.5, release_share=0.35, end_share=0.125)
"""The same where dead time or lag are in the bounds: what is on its way cannot be taken back, and the rest of
the jerk limit is there to correct the error."""
NEAR_ENOUGH_M = 0.1
"""An error at the stop that is not worth the time a correction takes."""
RESERVE_S = 0.5
"""Time before the scheduled one at which the policy is asked to arrive; careful braking takes time."""
MARGIN_MPS = 0.05
"""Distance of the ceiling below the permitted speed, besides the error of a measurement."""


class Care(NamedTuple):
    """Protection kept alongside, to stay clear of it.

    Attributes:
        watched: State of protection.
        ceiling: Largest speed and acceleration under it.
    """

    watched: Memory
    ceiling: Ceiling


class Watch(NamedTuple):
    """Estimate of the plant during a run.

    Attributes:
        model: Nominal trainset and section.
        belief: Estimate of the state and of the plant.
        care: Protection kept alongside; None as long as nothing departs from the nominal plant and nothing is
            late.
        adapted: Plant that the tables in force assume.
        adapted_at_s: Since when.
    """

    model: Model
    belief: StateEstimate
    care: Care | None
    adapted: Adaptation
    adapted_at_s: float

    @property
    def believed(self) -> Adaptation:
        """Estimated plant; a brake stronger than nominal counts as nominal."""
        belief = self.belief
        return Adaptation(belief.traction_gain, min(belief.brake_gain, 1.0), belief.resistance_factor)


def first_watch(run: Run) -> Watch:
    """Estimate before departure."""
    trainset = run.disturbance.nominal(run.trainset)
    vehicle = vehicle_arrays(trainset)
    model = Model(vehicle, track_arrays(run.section, trainset), run.dt)
    belief = initial_estimate(model, weighed_brakes=weighs_load(vehicle))
    watch = Watch(model, belief, None, Adaptation(), -np.inf)
    return (
        watch._replace(care=_care(watch, run, run.section)) if answers_late(declared_bounds(run)) else watch
    )


def update_watch(watch: Watch, run: Run, observation: Observation) -> Watch:
    """Update the estimate with this period's measurements.

    Args:
        watch: Estimate before, the command of the last period included.
        run: The run.
        observation: Measurements of this period.
    """
    seen = observation.position_m, observation.speed_mps, observation.acceleration_mps2
    overruled = watch.care is not None and (int(watch.care.watched.level) > 0 or observation.intervention > 0)
    belief = update_estimate(watch.model, watch.belief, *seen, overruled=overruled)
    if watch.care is None:
        watch = watch._replace(belief=belief)
        return watch._replace(care=_care(watch, run, observation.section)) if departs(belief) else watch
    return watch._replace(belief=belief)


def set_section(watch: Watch, run: Run, section: Section) -> Watch:
    """Change to a section with a restriction that has just been announced."""
    trainset = run.disturbance.nominal(run.trainset)
    watch = watch._replace(model=watch.model._replace(track=track_arrays(section, trainset)))
    if watch.care is None:
        return watch
    return watch._replace(care=_care(watch, run, section)._replace(watched=watch.care.watched))


def record_decision(watch: Watch, share: float) -> Watch:
    """Add a command that has been given to the estimate."""
    return watch._replace(belief=record_command(watch.belief, share))


def answers_late(declared: Bounds) -> bool:
    """Tell if protection's bounds hold a dead time or a lag of the service actuation."""
    return declared.delay_s > 0.0 or declared.lag_s > 0.0


def stop_options(watch: Watch) -> StopOptions:
    """Constants of the station stop, soft where protection's bounds hold late commands."""
    late = watch.care is not None and watch.care.ceiling.late_s > 0.0
    return LATE_STOP if late else CAREFUL_STOP


def departs(belief: StateEstimate) -> bool:
    """Tell if the plant surely departs from the nominal one."""
    if belief.best != 0:
        return True
    gains, covariance = belief.bank.gains[belief.best], belief.bank.covariance[belief.best]
    off, sigma = np.abs(gains - 1.0), np.sqrt(np.diagonal(covariance))
    least = np.array([LEAST, LEAST, LEAST_RESISTANCE])
    return bool((off > np.maximum(least, SURE * sigma)).any())


def is_outdated(watch: Watch, time_s: float) -> bool:
    """Tell if the tables in force are of another plant than the one estimated since."""
    if watch.care is None or time_s - watch.adapted_at_s < PATIENCE_S:
        return False
    off = np.abs(np.subtract(watch.believed, watch.adapted))
    return bool((off > (LEAST, LEAST, LEAST_RESISTANCE)).any())


def limit_to_ceiling(watch: Watch, ahead: PredictedState, share: float, most_mps2: float) -> float:
    """Limit a command to stay under the ceiling.

    Args:
        watch: Estimate of the plant.
        ahead: State in which a command given now begins to act.
        share: Command wanted.
        most_mps2: Largest acceleration for other reasons.
    """
    if watch.care is None:
        return share
    most = min(watch.care.ceiling.approach(ahead), most_mps2)
    return min(share, share_for(watch.belief, ahead, most))


def station_stop_braking(
    watch: Watch, planned_mps2: float, stopping: bool
) -> tuple[bool, float, PredictedState]:
    """Decide on the station-stop braking: True if it is on, its command, and the state in which that acts.

    Args:
        watch: Estimate of the plant.
        planned_mps2: Deceleration the policy's station-stop braking is planned with.
        stopping: True if it was on.
    """
    model, rate = watch.model, CAREFUL_USE * planned_mps2
    target = float(model.track.length_m)
    options = stop_options(watch)
    curve = curve_for(model.vehicle, model.dt, rate, options)
    stop = stop_command(model, watch.belief, target, curve, options)
    left = stop.left_m
    early = stop.required_mps2 < LET_GO * rate and left > LET_GO_M
    short = stop.ahead.speed_mps <= 0 and left > LET_GO_M
    begins = stop.required_mps2 >= BEGIN * rate
    share = stand(model, watch.belief, stop, NEAR_ENOUGH_M, NEAR_ENOUGH_M, options)
    return (begins or (stopping and not early)) and not short, share, stop.ahead


def limit_by_protection(watch: Watch, observation: Observation, share: float) -> tuple[float, Watch]:
    """Limit a command to the largest that protection lets pass."""
    if watch.care is None:
        return share, watch
    care = watch.care
    seen = observation.position_m, observation.speed_mps
    share, watched = largest_admissible_command(care.ceiling.guard, care.watched, *seen, share)
    return float(share), watch._replace(care=care._replace(watched=watched))


def _care(watch: Watch, run: Run, section: Section) -> Care:
    """Set up protection on a section, with the commands that are on their way."""
    ceiling, belief = ceiling_of(run, section, MARGIN_MPS), watch.belief
    watched = at_start(ceiling.guard)
    count, known = np.size(watched.recent), belief.commands.size
    watched = watched._replace(
        recent=np.pad(belief.commands, (0, max(count - known, 0)), "edge")[:count],
        share=np.float64(belief.bank.share[belief.best]),
        acceleration_mps2=np.float64(belief.acceleration_mps2),
    )
    return Care(watched, ceiling)

"""Place of a follower in the planned motion of the convoy, its own mark, and the command that holds them.

The trainset's own place at every moment is its own planned motion, corrected by how far the trainset ahead
has departed from its plan. That departure arrives late and passes a filter; the corrected place is followed
with the feed-forward of its acceleration, so that the place of one trainset moves as that of the next ahead,
but for the filter and the delay:

    |exp(-i w age) / (1 + i w T)| <= 1

at every frequency: no departure is amplified from trainset to trainset, as long as a follower holds its place
to within what the filter takes off (:func:`metropilot.convoy.string_gains` measures it). What is planned is
common to all and needs no filter. Dead time, lag and gains of the own actuation are answered by prediction:
reference and feedback are those of the moment when the command begins to act.

Without a plan the place is at the desired gap behind the trainset ahead. A constant gap by the motion of the
trainset ahead alone cannot be string stable with late messages (Seiler, Pant and Hedrick, 2004).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import NamedTuple, final, no_type_check

import numpy as np

from metropilot._typing import Scalar
from metropilot.control import (
    LAG_SOFT_M,
    STOP_OPTIONS,
    PredictedState,
    StopOptions,
    curve_for,
    draws_up,
    settle,
    start_command,
    stop_deceleration,
)
from metropilot.convoy.drivers.base import AbstractFollower, Memory, waits
from metropilot.convoy.own_plant import OwnPlant, learn, look_ahead, own_plant
from metropilot.convoy.plan import STANDING_MPS, PlannedMotion, plan_at
from metropilot.convoy.step import (
    HALF,
    FollowerObservation,
    NeededGaps,
    gap_per_mps,
    most_share,
    most_within,
)
from metropilot.physics import Vehicle, namespace

JERK_USE = 0.97
"""Share of the jerk limit that a follower uses."""
FILTER_S = 0.6
"""Time constant of the filter on departures of the trainset ahead."""
ALONE_MPS = 1.5
"""Departure of the trainset ahead in speed beyond which its plan no longer counts."""
NEAR_M, STOP_SHARE, BEHIND_M = 8.0, 0.95, 1.0
"""Distance to the own mark at which the stop's own law takes over from the plan; and from how far behind the
plan, the deceleration to the mark over what the brakes give."""
NEAR_ENOUGH_M, CREEP_M = 0.04, 0.05
"""Error at the stop that is not worth a correction in the last period; distance at which creeping ends."""
PULL_S, BRAKE_S, HARSH_MPS2 = 0.1, 0.5, 1e3
"""Times beyond the lag in which spare gap is used, and a lack of it made up for; no limit of acceleration."""
BEGINS_MPS = 0.5
"""Speed up to which a trainset begins a new plan from where it is, as after an emergency brake."""
GOES_MPS2 = 0.05
"""Acceleration wanted from which on a trainset leaves a stand."""
SHIFT_M = 0.5
"""Departure of the trainset ahead at its stop that does not move the own mark."""
RELEASE_SHARE, LAG_RELEASE_SHARE = 0.8, 0.3
"""Jerk of the last release over the jerk limit, without and with a lag."""


class PlaceMemory(NamedTuple):
    """Own plant, and where the trainset should be. All 0-d but the plant and the law's own memory.

    Attributes:
        plant: Own plant.
        off_m: Filtered departure of the trainset ahead, by which the own place is moved.
        off_mps: The same of its speed.
        off_mps2: The same of its acceleration.
        place_m: Own place at the moment when the next command begins to act.
        place_mps: Speed there.
        number: Number of the plan.
        alone: 1 while no plan counts, else 0.
        law: Memory of the law that holds the place.
    """

    plant: OwnPlant
    off_m: Scalar
    off_mps: Scalar
    off_mps2: Scalar
    place_m: Scalar
    place_mps: Scalar
    number: Scalar
    alone: Scalar
    law: Memory


class AbstractPlaceFollower(AbstractFollower):
    """Follower that holds its place in the convoy and stops at its own mark, within its rates and jerk limit.

    What its laws have in common: the own plant learned, the look-ahead over the own dead time, the place, the
    stop, the limits. A law is its ``hold_place``.
    """

    @final
    def init(self, vehicle: Vehicle, period_s: float) -> PlaceMemory:
        """Start with the nominal plant."""
        zero = np.asarray(vehicle.mass_kg).dtype.type(0.0)
        known = len(PlaceMemory._fields) - 2
        return PlaceMemory(
            own_plant(vehicle, period_s), *(zero,) * known, law=self.init_law(vehicle, period_s)
        )

    @final
    @no_type_check
    def act(self, memory: PlaceMemory, observation: FollowerObservation) -> tuple[Scalar, PlaceMemory]:
        """Learn, predict, hold the place; near the own mark, stop."""
        memory = memory._replace(plant=learn(memory.plant, observation))
        observation = expect_noise(memory.plant, observation)
        ahead = look_ahead(memory.plant, observation)
        memory, place = own_place(memory, observation, ahead)
        wanted, law = self.hold_place(memory, observation, place, ahead)
        memory = memory._replace(law=law)
        if observation.plan is not None:
            wanted = stop(memory, observation, ahead, wanted)
        return command(memory, observation, ahead, wanted), memory

    def init_law(self, vehicle: Vehicle, period_s: float) -> Memory:
        """Make the memory of the law: a tuple of NumPy numbers."""
        del vehicle, period_s
        return ()

    @abstractmethod
    def hold_place(
        self,
        memory: PlaceMemory,
        observation: FollowerObservation,
        place: PlannedMotion,
        ahead: PredictedState,
    ) -> tuple[Scalar, Memory]:
        """Acceleration that holds the place, and the next memory of the law.

        Args:
            memory: Memory of the follower.
            observation: Its observation.
            place: Its place when the command begins to act.
            ahead: Its own state then.
        """


@no_type_check
def expect_noise(plant: OwnPlant, observation: FollowerObservation) -> FollowerObservation:
    """The observation with the estimated speed, and the gaps that protection may need in the next period.

    It takes the speed as measured, which by then may be higher by the whole error that it allows for.
    """
    xp = namespace(observation.position_m, observation.gap_m)
    v, needs = plant.motion.speed_mps, observation.needs
    higher_mps = xp.maximum(v + observation.speed_error_mps - observation.speed_mps, 0.0)
    more_m = xp.where(
        observation.speed_error_mps > 0.0, higher_mps * gap_per_mps(v, observation.held_mps2), 0.0
    )
    return observation._replace(
        speed_mps=xp.where(observation.speed_error_mps > 0.0, v, observation.speed_mps),
        needs=NeededGaps(needs.on_its_way, *(need_m + more_m for need_m in needs[1:])),
    )


@no_type_check
def own_place(
    memory: PlaceMemory, observation: FollowerObservation, ahead: PredictedState
) -> tuple[PlaceMemory, PlannedMotion]:
    """Place of the trainset when the command begins to act, and the memory with the filters of it."""
    xp = namespace(observation.position_m, observation.gap_m)
    dt, then_s = observation.period_s, observation.time_s + ahead.seconds
    alone = place_alone(observation, ahead)
    if observation.plan is None:
        return memory._replace(alone=1.0 + 0.0 * memory.alone), alone
    planned = plan_at(observation.plan, then_s)
    # The own place moves on without a step when a new plan comes, unless the trainset (nearly) stands, or
    # kept the desired gap behind one that had left its plan: the new one begins where the trainset is.
    fresh = observation.plan_number != memory.number
    step_m = memory.place_m - planned.position_m
    nearly = (observation.speed_mps <= BEGINS_MPS) & (xp.abs(step_m) > SHIFT_M)
    begins = (memory.number <= 0.0) | nearly | (memory.alone > 0.0)
    step_m = xp.where(begins, 0.0, step_m)
    step_mps = xp.where(begins, 0.0, memory.place_mps - planned.speed_mps)
    off_m = xp.where(fresh, step_m, memory.off_m)
    off_mps = xp.where(fresh, step_mps, memory.off_mps)
    part = 1.0 - xp.exp(-dt / FILTER_S)
    off_m = off_m + part * (observation.off_m - off_m)
    off_mps = off_mps + part * (observation.off_mps - off_mps)
    off_mps2 = memory.off_mps2 + part * (observation.off_mps2 - memory.off_mps2)
    departs = (observation.alarm > 0.0) | (xp.abs(observation.off_mps) > ALONE_MPS)
    by_itself = xp.where(fresh, 0.0, memory.alone)
    by_itself = xp.where(departs, 1.0, by_itself)

    place = PlannedMotion(
        planned.position_m + off_m,
        planned.speed_mps + off_mps,
        planned.acceleration_mps2 + off_mps2,
    )
    place = PlannedMotion(*(xp.where(by_itself > 0.0, a, b) for a, b in zip(alone, place, strict=True)))
    later_mps = xp.maximum(place.speed_mps + dt * place.acceleration_mps2, 0.0)
    return memory._replace(
        off_m=off_m,
        off_mps=off_mps,
        off_mps2=off_mps2,
        place_m=place.position_m + 0.5 * dt * (place.speed_mps + later_mps),
        place_mps=later_mps,
        number=observation.plan_number,
        alone=by_itself,
    ), place


@no_type_check
def place_alone(observation: FollowerObservation, ahead: PredictedState) -> PlannedMotion:
    """Place at the desired gap behind a trainset ahead that goes on as its last message says."""
    v, a = observation.ahead_mps, observation.ahead_mps2
    xp = namespace(v, a)
    t = xp.minimum(ahead.seconds, xp.where(a < 0.0, v / xp.maximum(-a, 1e-6), 1e9))
    rear = observation.position_m + observation.gap_m + t * (v + 0.5 * a * t)
    speed = xp.maximum(v + a * t, 0.0)
    # A gap for a command is opened by none that is larger than the gap there is admits.
    gap_m = xp.maximum(observation.desired_gap_m, observation.needs.coasting_m)
    return PlannedMotion(rear - gap_m, speed, xp.where(speed > 0.0, a, 0.0 * a))


@no_type_check
def stop(
    memory: PlaceMemory, observation: FollowerObservation, ahead: PredictedState, wanted_mps2: Scalar
) -> Scalar:
    """Acceleration of the station stop at the own mark where that is near, else the wanted one."""
    vehicle, dt = observation.vehicle, observation.period_s
    xp = namespace(observation.position_m, observation.gap_m)
    v, left_m = ahead.speed_mps, own_mark(memory, observation) - ahead.position_m
    rate = v * v / (2.0 * xp.maximum(left_m, 0.1))
    lags = vehicle.lag_s > 0.0
    options = StopOptions(
        release_share=xp.where(lags, LAG_RELEASE_SHARE, RELEASE_SHARE),
        soft_m=xp.where(lags, LAG_SOFT_M, 0.0),
    )
    curve = curve_for(vehicle, dt, xp.maximum(rate, 0.1), options)
    a, jerk = ahead.acceleration_mps2, vehicle.jerk_mps3
    demand = stop_deceleration(v, a, left_m, curve, dt, options)
    drawing = draws_up(v, a, left_m, jerk, vehicle.lag_s)
    stopping = xp.where(drawing, STOP_OPTIONS.draw_up_mps2, -demand.wanted_mps2)
    settles, settling = settle(v, a, left_m, jerk, dt, NEAR_ENOUGH_M, CREEP_M, options)
    stopping = xp.where(settles, settling, stopping)
    # Whoever may stand does not move again for what is left; it holds once it surely stands.
    still = (v <= 0.0) & (left_m < STOP_OPTIONS.inch_m)
    stopping = xp.where(still, -xp.minimum(STOP_OPTIONS.hold_mps2, JERK_USE * jerk * dt), stopping)
    able = xp.minimum(observation.most_mps2, ahead.brake_mps2 + ahead.resistance_mps2 + ahead.gradient_mps2)
    # A plan that is held ends at the mark; whoever is behind it comes too fast for its last metres.
    behind = memory.place_m - ahead.position_m > v * dt + BEHIND_M
    near = (left_m < NEAR_M) | (behind & (rate > STOP_SHARE * able))
    # Whoever an emergency brake has left short of its mark may have to wait for the trainset ahead.
    short_m = own_mark(memory, observation) - memory.place_m
    paused = (memory.place_mps <= STANDING_MPS) & (short_m > SHIFT_M)
    near = near & (memory.alone <= 0.0) & ~paused
    return xp.where(near, stopping, wanted_mps2)


@no_type_check
def own_mark(memory: PlaceMemory, observation: FollowerObservation) -> Scalar:
    """Own mark, moved where the trainset ahead has gone well beyond its own or stays well short of it."""
    xp = namespace(observation.position_m, observation.gap_m)
    off_m = memory.off_m
    return observation.plan.position_m[-1] + off_m - xp.clip(off_m, -SHIFT_M, SHIFT_M)


@no_type_check
def most_in_gap(observation: FollowerObservation, ahead: PredictedState) -> Scalar:
    """Largest acceleration with which protection will have its gap when the command acts, and thereafter.

    What is on its way cannot be taken back: each m/s that it adds to the own speed takes ``v / b`` more gap,
    at a brake rate ``b``, and so does each that the trainset ahead loses meanwhile: by what it does now, or
    where speeds are noisy by what it plans. Without dead time and lag there is no such limit: protection's
    own answer is prompt.
    """
    vehicle, v, later_s, needs = observation.vehicle, observation.speed_mps, ahead.seconds, observation.needs
    xp = namespace(observation.position_m, observation.gap_m)
    per_mps = xp.maximum(v, ahead.speed_mps) / observation.held_mps2
    # A message says it too late where the errors of measured speeds leave little of the gap.
    planned_mps = xp.where(observation.speed_error_mps > 0.0, observation.ahead_loses_mps, 0.0)
    loses_mps = xp.maximum(-observation.ahead_mps2 * later_s, planned_mps)
    grows_m = per_mps * (ahead.speed_mps - v + loses_mps)
    closes_m = later_s * (0.5 * (v + ahead.speed_mps + loses_mps) - observation.ahead_mps)
    left_m = observation.gap_m - grows_m - closes_m
    drag = ahead.resistance_mps2 + ahead.gradient_mps2
    spare_m = left_m - needs.coasting_m
    pulls_m, brakes_m = (xp.maximum(per_mps * (vehicle.lag_s + time_s), 1e-3) for time_s in (PULL_S, BRAKE_S))
    # Above what is on its way a larger command needs more now, too; on a climb so does a constant speed.
    first = needs.on_its_way * ahead.traction_mps2 - drag
    first = xp.where(ahead.gradient_mps2 > 0.0, first, xp.maximum(first, 0.0))
    least = xp.minimum(first, 0.0) + spare_m / xp.where(spare_m > 0.0, pulls_m, brakes_m)
    full = xp.maximum(ahead.traction_mps2 - drag, first + 1e-3)
    half = xp.clip(xp.maximum(HALF, needs.on_its_way) * ahead.traction_mps2 - drag, first, full)
    rates = first, half, full
    now_m = needs.coasting_m, needs.half_m, needs.pulling_m
    gaps_m = tuple(
        need_m + pulls_m * xp.maximum(mps2, 0.0) for need_m, mps2 in zip(now_m, rates, strict=True)
    )
    most = xp.where(left_m > gaps_m[0], most_within(left_m, gaps_m, rates), least)
    limited = (vehicle.delay_s + vehicle.lag_s > 0.0) & (needs.pulling_m > 0.0)
    return xp.where(limited, most, HARSH_MPS2)


@no_type_check
def command(
    memory: PlaceMemory, observation: FollowerObservation, ahead: PredictedState, wanted_mps2: Scalar
) -> Scalar:
    """Command for an acceleration within the permitted speed, the trainset's rates and its jerk limit."""
    vehicle = observation.vehicle
    xp = namespace(observation.position_m, observation.gap_m)
    wanted = xp.minimum(wanted_mps2, vehicle.max_acceleration_mps2)
    passes = xp.minimum(observation.most_rise_mps2, most_in_gap(observation, ahead))
    wanted = xp.minimum(wanted, passes)
    goes = wanted > GOES_MPS2
    wanted = xp.maximum(wanted, -vehicle.max_deceleration_mps2)
    room = JERK_USE * vehicle.jerk_mps3 * observation.period_s
    wanted = xp.clip(wanted, ahead.acceleration_mps2 - room, ahead.acceleration_mps2 + room)
    # What a command adds against the lag counts for protection, too.
    most = xp.where(vehicle.lag_s > 0.0, xp.maximum(ahead.share_for(passes, lead=0.0), 0.0), 1.0)
    most = xp.minimum(most, most_share(observation.needs, observation.gap_m))
    most = xp.minimum(most, observation.most_share)
    drag = ahead.resistance_mps2 + ahead.gradient_mps2
    share = start_command(ahead.share_for(wanted, lead=1.0), observation.speed_mps, drag, goes)
    share = xp.minimum(share, most)
    stands = waits(observation, observation.desired_gap_m)
    if observation.plan is not None:
        left_m = own_mark(memory, observation) - observation.position_m
        arrived = (memory.plant.stands > 0.0) & (left_m < STOP_OPTIONS.inch_m)
        stands = xp.where(memory.alone > 0.0, stands, arrived)
    return xp.where(stands, -0.3, share)

"""A surrogate of a human driver: no recorded drive is public, so this one is made up, and says so.

It accelerates, holds a speed within a band, coasts when the clock allows, brakes and corrects near the
stop. What makes it human: every change of the lever comes after a reaction time, the lever has notches, the
speed is held with hysteresis, and the points where coasting and braking begin and where it means to stop
are missed by a scatter drawn once for the run. It knows the route and the timetable as a trained driver does,
by a coarse forecast looked at every few seconds. It keeps its eye on the platform, not on the jerk limit: the
last notch often lets the trainset stop with a jolt.

Source: own surrogate. Huang25 compares with the best of 100 recorded drives (EITOM), which are not published;
reaction, notches and scatter are assumed. Do not read its energy as a measured human's.
"""

from __future__ import annotations

import math
from typing import NamedTuple, final

import numpy as np

from metropilot.control import (
    SERVICE_USE,
    Ceiling,
    Forecast,
    Model,
    PredictedState,
    StateEstimate,
    StopCurve,
    StopOptions,
    ceiling_acceleration,
    ceiling_of,
    coast_point_for,
    cruise_for,
    curve_for,
    forecast_of,
    initial_estimate,
    lasting_deceleration,
    look_ahead,
    model_of,
    record_command,
    required_later,
    required_with_build_up,
    start_on_fall,
    stop_command,
    time_to_go,
    traction_limit,
    update_estimate,
    weakest_gradient,
)
from metropilot.physics import effort_at
from metropilot.railway import Section
from metropilot.sim import AbstractDriver, Observation, Run

TRACTION_NOTCH = 0.25
BRAKE_NOTCH = 0.05
HOLD_NOTCH = 0.5
GENTLE_BRAKE = 0.15
LOOK_AGAIN_S = 3.0
RESERVE_S = 0.3
NEAR_SHARE = 0.4
"""From this share of the deceleration meant on, a human asks what the brake could still do after the hand."""
SPARE_SHARE = 0.9
"""A brake of which a human uses no more than this share has something to spare."""
HUMAN_MARGIN_MPS = 0.7
USUAL_PERIOD_S = 0.2
"""Up to this control period the margin allows for what a speed rises by before the hand is there."""
LATE_S = 1.0
BY_HAND = StopOptions(left_share=math.inf)
"""By hand nobody lets go of a brake in the last tenth of a second."""
LEAST_MPS2 = 0.1
"""Least deceleration to plan a stop with."""


class Habits(NamedTuple):
    """Habits of one driver, drawn once for a run.

    Attributes:
        reaction_s: Time from seeing to moving the lever.
        band_mps: Half width of the band a speed is held in.
        deceleration_mps2: Deceleration this driver brakes with.
        onset_s: Time by which braking begins too early (negative: too late).
        coast_share: Share of the section this driver means to coast.
        clock_s: Error of the driver's feeling for the time left.
        aim_m: Stopping point this driver aims at, past the stop.
    """

    reaction_s: float
    band_mps: float
    deceleration_mps2: float
    onset_s: float
    coast_share: float
    clock_s: float
    aim_m: float


class LeverPosition(NamedTuple):
    """The lever: where it is, and where it will be moved once the hand has reacted."""

    share: float = 0.0
    wanted: float = 0.0
    moves_at_s: float = math.inf


class Intent(NamedTuple):
    """Driver's intention: hold a speed, coast from a point, power or brake now."""

    cruise_mps: float
    coast_from_m: float
    looks_at_s: float = 0.0
    powering: bool = True
    braking: bool = False


class ManualMemory(NamedTuple):
    """Memory of the driver between two periods."""

    run: Run
    section: Section
    scheduled_time_s: float
    habits: Habits
    at_hand_mps2: float
    model: Model
    ceiling: Ceiling
    curve: StopCurve
    forecast: Forecast
    estimate: StateEstimate
    lever: LeverPosition
    intent: Intent


@final
class Manual(AbstractDriver):
    """A made-up human driver, seeded by the run."""

    id = "manual"

    def init(self, run: Run) -> ManualMemory:
        """Draw the habits and think the run through."""
        habits = draw_habits(run.seed)
        return _begin(run, run.section, run.scheduled_time_s, habits)

    def act(self, memory: ManualMemory, observation: Observation) -> tuple[float, ManualMemory]:
        """Look, decide, and move the lever when the hand is there."""
        memory = _follow_updates(memory, observation)
        estimate = update_estimate(
            memory.model,
            memory.estimate,
            observation.position_m,
            observation.speed_mps,
            observation.acceleration_mps2,
            intervention=observation.intervention,
        )
        intent = _review_timing(memory, estimate, observation)
        wanted, intent = _decide(memory._replace(estimate=estimate, intent=intent))
        wanted = start_on_fall(memory.model, observation.position_m, observation.speed_mps, wanted)
        lever = _move_lever(memory.lever, wanted, observation.time_s, memory.habits, intent)
        memory = memory._replace(estimate=record_command(estimate, lever.share), intent=intent, lever=lever)
        return lever.share, memory


def draw_habits(seed: int) -> Habits:
    """Draw the habits of a driver; ranges assumed (see the module)."""
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2,)))
    return Habits(
        reaction_s=float(random.uniform(0.4, 0.8)),
        band_mps=float(random.uniform(0.3, 0.6)),
        deceleration_mps2=float(random.uniform(0.55, 0.75)),
        onset_s=float(np.clip(random.normal(0.0, 0.4), -0.8, 0.8)),
        coast_share=float(random.uniform(0.05, 0.25)),
        clock_s=float(np.clip(random.normal(0.0, 0.5), -1.0, 1.0)),
        aim_m=float(np.clip(random.normal(0.0, 0.08), -0.16, 0.16)),
    )


def _begin(run: Run, section: Section, scheduled_s: float, habits: Habits) -> ManualMemory:
    model = model_of(run, section)
    ceiling = ceiling_of(run, section, HUMAN_MARGIN_MPS)
    at_hand = _at_hand_mps2(model, ceiling.speed_mps)
    # who has nothing to spare does not begin late
    onset_s = habits.onset_s if habits.deceleration_mps2 < SPARE_SHARE * at_hand else max(habits.onset_s, 0.0)
    habits = habits._replace(deceleration_mps2=min(habits.deceleration_mps2, at_hand), onset_s=onset_s)
    forecast = forecast_of(model, ceiling, habits.deceleration_mps2)
    left = scheduled_s - RESERVE_S - _overhead_s(model, habits, standing=True)
    coast = section.length_m * (1.0 - habits.coast_share)
    cruise = cruise_for(forecast, 0.0, 0.0, left, coast)
    return ManualMemory(
        run=run,
        section=section,
        scheduled_time_s=scheduled_s,
        habits=habits,
        at_hand_mps2=at_hand,
        model=model,
        ceiling=ceiling,
        curve=curve_for(model.vehicle, run.dt, habits.deceleration_mps2),
        forecast=forecast,
        estimate=initial_estimate(model),
        lever=LeverPosition(),
        intent=Intent(cruise, coast),
    )


def _at_hand_mps2(model: Model, caps_mps: np.ndarray) -> float:
    """Deceleration the data sheet promises at any speed, on the worst gradient on the way to the stop."""
    vehicle = model.vehicle
    speeds = np.linspace(0.0, float(vehicle.max_speed_mps), 9)
    brake = min(float(effort_at(vehicle, v).brake_n) for v in speeds) / float(vehicle.effective_mass_kg)
    gradient = min(weakest_gradient(model, float(model.track.length_m)), 0.0)
    level = max(min(SERVICE_USE * (brake + gradient), float(vehicle.max_deceleration_mps2)), LEAST_MPS2)
    # a weak brake begins so early that the fall before counts, too
    end, fastest = float(model.track.length_m), min(float(vehicle.max_speed_mps), float(caps_mps.max()))
    start = max(end - 0.5 * fastest * fastest / level, 0.0)
    lasts = lasting_deceleration(vehicle, model.track, start, end, fastest)
    return max(min(level, SERVICE_USE * lasts), LEAST_MPS2)


def _overhead_s(model: Model, habits: Habits, *, standing: bool) -> float:
    """Time the forecast does not know: reaction, build-up and release of effort."""
    jerk = float(model.vehicle.jerk_mps3)
    build = 1.0 / jerk if math.isfinite(jerk) else 0.0
    late_s = float(model.vehicle.delay_s + model.vehicle.lag_s)
    start = habits.reaction_s + 0.5 * build + late_s if standing else 0.0
    return start + habits.deceleration_mps2 * build


def _follow_updates(memory: ManualMemory, observation: Observation) -> ManualMemory:
    """Take note of a new timetable or a restriction."""
    same_time = observation.scheduled_time_s == memory.scheduled_time_s
    if same_time and observation.section is memory.section:
        return memory
    fresh = _begin(memory.run, observation.section, observation.scheduled_time_s, memory.habits)
    intent = memory.intent._replace(looks_at_s=0.0)
    return fresh._replace(estimate=memory.estimate, lever=memory.lever, intent=intent)


def _review_timing(memory: ManualMemory, estimate: StateEstimate, observation: Observation) -> Intent:
    """Adapt the cruising speed and the coasting point to the time left, every few seconds."""
    intent, now = memory.intent, observation.time_s
    if intent.braking or now < intent.looks_at_s:
        return intent
    x, v, forecast = estimate.position_m, estimate.speed_mps, memory.forecast
    standing = v < 1.0
    left = memory.scheduled_time_s - now + memory.habits.clock_s - RESERVE_S
    left -= _overhead_s(memory.model, memory.habits, standing=standing)
    cruise, coast = intent.cruise_mps, intent.coast_from_m
    if x >= coast:
        if time_to_go(forecast, x, v, cruise, x) > left + LATE_S:
            coast = coast_point_for(forecast, x, v, left, cruise)
    else:
        meant = max(memory.section.length_m * (1.0 - memory.habits.coast_share), x)
        cruise = cruise_for(forecast, x, v, left, meant)
        coast = coast_point_for(forecast, x, v, left, cruise)
    return intent._replace(cruise_mps=cruise, coast_from_m=coast, looks_at_s=now + LOOK_AGAIN_S)


def _decide(memory: ManualMemory) -> tuple[float, Intent]:
    """Choose the lever position and the intention behind it."""
    model, estimate, intent, curve = memory.model, memory.estimate, memory.intent, memory.curve
    target = memory.section.length_m + memory.habits.aim_m
    ahead = look_ahead(model, estimate)
    if intent.braking:
        return _to_notch(stop_command(model, ahead, target, curve, BY_HAND).share), intent
    hand_s = max(memory.habits.reaction_s, model.dt)
    early_m = ahead.speed_mps * (hand_s + memory.habits.onset_s)
    required, _ = required_with_build_up(
        ahead.speed_mps, ahead.acceleration_mps2, target - ahead.position_m - early_m, curve
    )
    begins = required >= curve.deceleration_mps2
    if not begins and required >= NEAR_SHARE * curve.deceleration_mps2:
        # the lever may be on its way to traction
        pulls = memory.lever.wanted * ahead.traction_mps2 - ahead.resistance_mps2 - ahead.gradient_mps2
        rise_mps = max(ahead.acceleration_mps2, pulls if memory.lever.wanted > 0.0 else 0.0, 0.0) * hand_s
        then = ahead._replace(speed_mps=ahead.speed_mps + rise_mps)
        left_m = target - ahead.position_m - early_m - 0.5 * rise_mps * hand_s
        begins = required_later(then, left_m, curve, model.dt) >= memory.at_hand_mps2
    if begins:
        return _to_notch(stop_command(model, ahead, target, curve, BY_HAND).share), intent._replace(
            braking=True
        )
    # the hand moves the lever to where it was wanted a period before, and a fall pulls meanwhile
    pull_mps2 = max(ahead.acceleration_mps2, -ahead.resistance_mps2 - ahead.gradient_mps2, 0.0)
    rise_mps = pull_mps2 * max(model.dt - USUAL_PERIOD_S, 0.0)
    ahead = ahead._replace(speed_mps=ahead.speed_mps + rise_mps)
    sooner = ahead._replace(position_m=ahead.position_m + ahead.speed_mps * hand_s)
    limited = ceiling_acceleration(model, sooner, memory.ceiling, math.inf, curve)
    if limited < -0.05:
        return _to_notch(min(ahead.share_for(limited), 0.0)), intent._replace(powering=False)
    then = estimate._replace(speed_mps=estimate.speed_mps + rise_mps)
    return _hold_speed(memory._replace(estimate=then), ahead, limited)


def _hold_speed(memory: ManualMemory, ahead: PredictedState, limited_mps2: float) -> tuple[float, Intent]:
    """Power below the band, coast above it, brake gently well above it."""
    intent, band = memory.intent, memory.habits.band_mps
    if ahead.position_m >= intent.coast_from_m:
        return 0.0, intent._replace(powering=False)
    top = min(intent.cruise_mps, memory.ceiling.at(ahead.position_m))
    missing = top - ahead.speed_mps
    powering = missing > 0 if intent.powering else missing > 2.0 * band
    if missing < -3.0 * band:
        return -GENTLE_BRAKE, intent._replace(powering=False)
    if not powering:
        return 0.0, intent._replace(powering=False)
    full = ahead.share_for(limited_mps2)
    share = full if missing > 6.0 * band else min(full, HOLD_NOTCH)
    share = min(share, traction_limit(memory.estimate, ahead, memory.ceiling))
    return _to_notch(share), intent._replace(powering=True)


def _to_notch(share: float) -> float:
    """Round to the notch at or below a traction share, or nearest to a braking share."""
    if share > 0:
        return TRACTION_NOTCH * math.floor(share / TRACTION_NOTCH + 1e-9)
    return BRAKE_NOTCH * round(share / BRAKE_NOTCH)


def _move_lever(
    lever: LeverPosition, wanted: float, now_s: float, habits: Habits, intent: Intent
) -> LeverPosition:
    """Move the lever for a period: a new wanted position takes a reaction time, half of it while braking."""
    if now_s >= lever.moves_at_s - 1e-9:
        lever = LeverPosition(lever.wanted, lever.wanted)
    if wanted != lever.share and math.isinf(lever.moves_at_s):
        reaction = habits.reaction_s * (0.5 if intent.braking else 1.0)
        return lever._replace(wanted=wanted, moves_at_s=now_s + reaction)
    if wanted == lever.share:
        return LeverPosition(lever.share, lever.share)
    return lever._replace(wanted=wanted)

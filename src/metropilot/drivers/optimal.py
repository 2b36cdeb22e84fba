"""The optimal plan in closed loop: follow it, plan anew when something departs from it, stop at the point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np

from metropilot.drivers.base import AbstractDriver, register
from metropilot.drivers.observer import (
    Belief,
    Model,
    first_belief,
    issued,
    look_ahead,
    observe,
    share_for,
)
from metropilot.drivers.stopping import Curve, curve_for, stop_command
from metropilot.errors import SolverError
from metropilot.physics import Vehicle, track_arrays, vehicle_arrays
from metropilot.planning import Plan, PlanOptions, plan_arrays
from metropilot.railway import Section, Trainset
from metropilot.task import Observation, Run


class Adapted(NamedTuple):
    """What the plan in force assumed of the trainset: factors on effort, brake and resistance."""

    traction: float = 1.0
    brake: float = 1.0
    resistance: float = 1.0


@dataclass(frozen=True)
class OptimalOptions:
    """How closely the plan is followed.

    Attributes:
        speed_gain_per_s: Correction of a departure in speed.
        coast_band_mps2: Efforts below this are not given where the plan coasts.
        time_band_s: A departure in time that calls for a new plan.
        speed_band_mps: A departure in speed that calls for a new plan.
        patience_s: Least time between two plans.
        last_plan_m: No new plan this close to the braking point.
        release_share: Jerk of the last brake's release over the trainset's limit.
        reserve_s: How much earlier than scheduled the plan arrives.
        spacing_m: Mesh of the plan.
    """

    speed_gain_per_s: float = 0.8
    coast_band_mps2: float = 0.03
    time_band_s: float = 0.1
    speed_band_mps: float = 0.5
    patience_s: float = 4.0
    last_plan_m: float = 30.0
    release_share: float = 0.8
    reserve_s: float = 0.0
    spacing_m: float = 12.5


@dataclass(frozen=True)
class Following:
    """The driver's memory.

    Attributes:
        trainset: The trainset as it is known.
        model: What it believes about trainset and section.
        belief: Where it is and how the trainset answers.
        plan: The plan in force.
        clock_s: When the plan began.
        curve: Shape of the stop.
        braking: Whether it is on its way to the stop.
        adapted: What the plan assumed of the trainset.
        scheduled_s: The scheduled time the plan was made for.
        section: The section the plan was made for.
        planned_at_s: When the plan was made.
    """

    trainset: Trainset
    model: Model
    belief: Belief
    plan: Plan
    clock_s: float
    curve: Curve
    braking: bool
    adapted: Adapted
    scheduled_s: float
    section: Section
    planned_at_s: float


LATE_W = 500.0


@register
class Optimal(AbstractDriver):
    """Follows the energy-optimal plan and re-plans when time, track or state depart from it."""

    id: ClassVar[str] = "optimal"
    summary: ClassVar[str] = "convex optimal plan in closed loop: follows, re-plans, stops at the point"
    source: ClassVar[str] = "own; convex plan of the design"

    def __init__(self, options: OptimalOptions | None = None) -> None:
        self.options = options or OptimalOptions()

    def init(self, run: Run) -> Following:
        """Plan the whole section for the trainset as it is known."""
        trainset = run.scenario.believed(run.trainset)
        vehicle, track = vehicle_arrays(trainset), track_arrays(run.section, trainset)
        model = Model(vehicle, track, run.dt)
        curve = self._curve(model, Adapted())
        options = self._plan_options(model, curve)
        plan = plan_arrays(vehicle, track, run.scheduled_time_s - self.options.reserve_s, options)
        return Following(
            trainset=trainset,
            model=model,
            belief=first_belief(model),
            plan=plan,
            clock_s=0.0,
            curve=curve,
            braking=False,
            adapted=Adapted(),
            scheduled_s=run.scheduled_time_s,
            section=run.section,
            planned_at_s=0.0,
        )

    def act(self, memory: Following, observation: Observation) -> tuple[float, Following]:
        """Re-plan if need be, then follow the plan or the stop."""
        belief = observe(
            memory.model,
            memory.belief,
            observation.position_m,
            observation.speed_mps,
            observation.acceleration_mps2,
        )
        memory = replace(memory, belief=belief)
        if self._departs(memory, observation):
            memory = self._replanned(memory, observation)
        target = float(memory.model.track.length_m)
        stop = stop_command(memory.model, belief, target, memory.curve)
        braking = memory.braking or stop.required_mps2 >= memory.curve.deceleration_mps2
        share = stop.share if braking else self._follow(memory)
        return share, replace(memory, belief=issued(belief, share), braking=braking)

    def _follow(self, memory: Following) -> float:
        """The command that keeps to the plan's speed at the state where it begins to act."""
        plan, dt = memory.plan, memory.model.dt
        ahead = look_ahead(memory.model, memory.belief)
        here = plan_speed(plan, ahead.position_m)
        step = 0.5 * (here + ahead.speed_mps) * dt
        start = max(ahead.position_m, float(plan.position_m[0]))
        then = plan_speed(plan, start + max(step, 1e-3))
        planned = (then * then - here * here) / (2 * max(step, 1e-3))
        if here < 0.5:
            planned = _first_acceleration(plan, start, dt)
        wanted = planned + self.options.speed_gain_per_s * (here - ahead.speed_mps)
        wanted = min(
            max(wanted, -memory.curve.deceleration_mps2), float(memory.model.vehicle.max_acceleration_mps2)
        )
        effort = wanted + ahead.resistance_mps2 + ahead.gradient_mps2
        k = min(
            int(np.searchsorted(plan.position_m, start + step, side="right")) - 1, plan.traction_n.size - 1
        )
        mass = float(memory.model.vehicle.effective_mass_kg)
        coasts = (plan.traction_n[k] + plan.brake_n[k]) / mass < 1e-3
        if coasts and abs(effort) < self.options.coast_band_mps2:
            return 0.0
        return share_for(memory.belief, ahead, wanted)

    def _departs(self, memory: Following, observation: Observation) -> bool:
        """Whether the plan in force no longer answers the question."""
        news = observation.scheduled_time_s != memory.scheduled_s or observation.section is not memory.section
        if news:
            return True
        if memory.braking or observation.time_s - memory.planned_at_s < self.options.patience_s:
            return False
        plan, belief = memory.plan, memory.belief
        if float(memory.model.track.length_m) - belief.position_m < self.options.last_plan_m + braking_room(
            memory
        ):
            return False
        late = observation.time_s - memory.clock_s - plan_time(plan, belief.position_m)
        off = belief.speed_mps - plan_speed(plan, belief.position_m)
        now = _adaptation(belief)
        learned = (
            max(abs(now.traction - memory.adapted.traction), abs(now.brake - memory.adapted.brake)) > 0.04
        )
        return abs(late) > self.options.time_band_s or abs(off) > self.options.speed_band_mps or learned

    def _replanned(self, memory: Following, observation: Observation) -> Following:
        """A plan from the state as it is, with the trainset as it has shown itself."""
        model, belief = memory.model, memory.belief
        if observation.section is not memory.section:
            model = model._replace(track=track_arrays(observation.section, memory.trainset))
        adapted = _adaptation(belief)
        curve = self._curve(model, adapted)
        left = max(observation.scheduled_time_s - self.options.reserve_s - observation.time_s, 1.0)
        options = replace(
            self._plan_options(model, curve),
            start_m=max(belief.position_m, 0.0),
            start_mps=max(belief.speed_mps, 0.0),
            start_mps2=belief.acceleration_mps2,
            late_w=LATE_W,
        )
        vehicle = adapted_vehicle(model.vehicle, adapted)
        told = replace(
            memory,
            model=model,
            section=observation.section,
            scheduled_s=observation.scheduled_time_s,
            planned_at_s=observation.time_s,
            adapted=adapted,
        )
        if memory.braking:
            return told
        for attempt in (options, replace(options, jerk_mps3=None, release_mps3=None)):
            try:
                plan = plan_arrays(vehicle, model.track, left, attempt)
            except SolverError:
                continue
            return replace(told, plan=plan, clock_s=observation.time_s, curve=curve)
        return told

    def _curve(self, model: Model, adapted: Adapted) -> Curve:
        """The stop the plan ends with: the deceleration it brakes at, let go softly."""
        vehicle = model.vehicle
        rate = min(float(vehicle.max_deceleration_mps2), 1.02 * adapted.brake * _brake_rate(vehicle))
        curve = curve_for(vehicle, model.dt, rate)
        if np.isfinite(curve.release_jerk_mps3):
            curve = curve._replace(release_jerk_mps3=self.options.release_share * float(vehicle.jerk_mps3))
        return curve

    def _plan_options(self, model: Model, curve: Curve) -> PlanOptions:
        jerk = float(model.vehicle.jerk_mps3)
        limited = bool(np.isfinite(jerk))
        return PlanOptions(
            spacing_m=self.options.spacing_m,
            jerk_mps3=jerk if limited else None,
            release_mps3=curve.release_jerk_mps3 if limited else None,
            deceleration_mps2=curve.deceleration_mps2,
        )


def _brake_rate(vehicle: Vehicle) -> float:
    from metropilot.physics import brake_available_n

    return float(brake_available_n(vehicle, np.float64(5.0))) / float(vehicle.effective_mass_kg)


def braking_room(memory: Following) -> float:
    """Distance the stop needs from the present speed."""
    v = memory.belief.speed_mps
    return v * v / (2 * memory.curve.deceleration_mps2) + v


def plan_speed(plan: Plan, position_m: float) -> float:
    """Speed of the plan at a position; kinetic energy is linear between its nodes."""
    return float(np.sqrt(np.interp(position_m, plan.position_m, plan.speed_mps**2)))


def plan_time(plan: Plan, position_m: float) -> float:
    """Time since the plan's start at a position, at constant acceleration between its nodes."""
    k = int(np.clip(np.searchsorted(plan.position_m, position_m, side="right") - 1, 0, plan.time_s.size - 2))
    v0, v = float(plan.speed_mps[k]), plan_speed(plan, position_m)
    gone = min(max(position_m, float(plan.position_m[k])), float(plan.position_m[-1])) - float(
        plan.position_m[k]
    )
    return float(plan.time_s[k]) + (2 * gone / (v0 + v) if v0 + v > 1e-6 else 0.0)


def _first_acceleration(plan: Plan, position_m: float, dt: float) -> float:
    """Mean acceleration of the plan over the next period when it starts from (almost) rest."""
    begin = plan_time(plan, position_m)
    speeds = np.interp([begin, begin + dt], plan.time_s, plan.speed_mps)
    return float(speeds[1] - speeds[0]) / dt


def _adaptation(belief: Belief) -> Adapted:
    return Adapted(belief.traction_gain, belief.brake_gain, belief.resistance_factor)


def adapted_vehicle(vehicle: Vehicle, adapted: Adapted) -> Vehicle:
    """The trainset as it has shown itself: effort and resistance per mass scaled."""
    up, down, drag = adapted
    return vehicle._replace(
        traction=vehicle.traction * up,
        brake=vehicle.brake * down,
        friction_n=vehicle.friction_n * down,
        service_n=vehicle.service_n * down,
        davis_n=vehicle.davis_n * drag,
    )

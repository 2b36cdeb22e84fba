"""The optimal plan in closed loop: follow it, plan anew when something departs from it, stop at the point."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar, get_args

import numpy as np

from metropilot._schema import CheckedFields, declare
from metropilot.control import (
    LAG_STOP,
    STOP_OPTIONS,
    Adaptation,
    Ceiling,
    Model,
    PredictedState,
    StateEstimate,
    Stop,
    StopCurve,
    StopOptions,
    adapt_trainset,
    adapt_vehicle,
    ask_protection,
    ceiling_of,
    curve_for,
    departs_from,
    initial_estimate,
    lasting_deceleration,
    look_ahead,
    model_of,
    record_command,
    stand,
    stop_with_brake,
    update_estimate,
    weighs_load,
)
from metropilot.errors import SolverError
from metropilot.physics import Track, Vehicle, effort_at, vehicle_arrays
from metropilot.planning import (
    START_STRETCH_M,
    Coupled,
    Objective,
    Plan,
    PlanOptions,
    check_running_time,
    couple_trainsets,
    coupled_acceleration,
    fastest_time,
    plan_arrays,
    plan_speed,
    plan_time,
    pull_away,
    ramped_acceleration,
)
from metropilot.protection import Memory, at_start
from metropilot.railway import Section, Trainset
from metropilot.sim import AbstractDriver, Observation, Run


@dataclass(frozen=True)
class OptimalOptions(CheckedFields):
    """Options of ``optimal``: the plan, and how closely it is followed.

    Attributes:
        objective: Energy the plan saves: ``wheel`` or ``line``.
        speed_gain_per_s: Correction of a departure in speed.
        coast_band_mps2: Efforts below this are not given where the plan coasts.
        time_band_s: A departure in time that calls for a new plan.
        late_time_band_s: The same where making up less takes a pulse of traction: where commands act late,
            and where the plan has no traction ahead.
        speed_band_mps: A departure in speed that calls for a new plan.
        patience_s: Least time between two plans that a departure calls for.
        period_s: A new plan at least this often, with what was learned of the trainset by then.
        last_plan_m: No new plan this close to the braking point.
        late_last_plan_m: The same where commands act late; less at a low speed.
        release_share: Jerk of the last brake's release over the trainset's limit.
        brake_use: Share of the braking force that plan and stop count on; the rest is for corrections.
        careful_brake_use: The same where commands act late, the brake has no force to spare, or the trainset
            departs from the nominal plant.
        handover_m: Distance from the stop at which the stop's own law takes over from the plan.
        alarm: Factor on the planned deceleration: a stop that needs more is given to the stop's own law at
            once.
        careful_alarm: The same, wherever it is, where commands act late.
        near_enough_m: Error at the stop that is not worth a correction in the last period.
        cap_margin_mps: Distance of the plan below the permitted speed.
        reserve_s: Time before the scheduled one at which the plan arrives.
        spacing_m: Mesh of the plan.
        joint: At the head of a convoy, plan for the trainsets behind too.
        coupled_use: Share of their efforts that this plan counts on; the rest is for their corrections.
    """

    objective: Objective = declare("wheel", choices=get_args(Objective))
    speed_gain_per_s: float = declare(0.8, unit="1/s", low=0.0, high=10.0)
    coast_band_mps2: float = declare(0.1, unit="m/s^2", low=0.0, high=3.0)
    time_band_s: float = declare(0.1, unit="s", low=0.0, infinite=True)
    late_time_band_s: float = declare(0.3, unit="s", low=0.0, infinite=True)
    speed_band_mps: float = declare(0.3, unit="m/s", low=0.0, infinite=True)
    patience_s: float = declare(2.0, unit="s", low=0.0, infinite=True)
    period_s: float = declare(math.inf, unit="s", low=0.0, above=True, infinite=True)
    last_plan_m: float = declare(30.0, unit="m", low=0.0, infinite=True)
    late_last_plan_m: float = declare(150.0, unit="m", low=0.0, infinite=True)
    release_share: float = declare(0.95, low=0.0, high=1.0, above=True)
    brake_use: float = declare(0.995, low=0.0, high=1.0, above=True)
    careful_brake_use: float = declare(0.97, low=0.0, high=1.0, above=True)
    handover_m: float = declare(60.0, unit="m", low=0.0, infinite=True)
    alarm: float = declare(1.15, low=0.0, high=10.0, above=True)
    careful_alarm: float = declare(0.95, low=0.0, high=10.0, above=True)
    near_enough_m: float = declare(0.04, unit="m", low=0.0, high=1.0)
    cap_margin_mps: float = declare(0.05, unit="m/s", low=0.0, high=5.0)
    reserve_s: float = declare(0.0, unit="s", low=0.0)
    spacing_m: float = declare(12.5, unit="m", low=1.0, high=200.0)
    joint: bool = declare(True)
    coupled_use: float = declare(0.97, low=0.0, high=1.0, above=True)


@dataclass(frozen=True)
class FollowingMemory:
    """The driver's memory.

    Attributes:
        trainset: The trainset as it is known.
        run: The run.
        supervision: State of protection, kept alongside.
        ceiling: Largest speed and acceleration under protection.
        model: Nominal trainset and section.
        estimate: Estimate of the state and of the plant.
        plan: The plan in force.
        clock_s: Start of the plan.
        curve: Shape of the stop.
        braking: True on the way to the stop.
        adapted: Plant that the plan assumes.
        scheduled_s: The scheduled time the plan was made for.
        section: The section the plan was made for.
        planned_at_s: Time at which the plan was made.
        coupled: Trainsets behind, for which the plan is made too.
    """

    trainset: Trainset
    run: Run
    supervision: Memory
    ceiling: Ceiling
    model: Model
    estimate: StateEstimate
    plan: Plan
    clock_s: float
    curve: StopCurve
    braking: bool
    adapted: Adaptation
    scheduled_s: float
    section: Section
    planned_at_s: float
    coupled: tuple[Coupled, ...] = ()


LATE_W = 500.0
LAST_METRES_M = 8.0
CREEP_M = 0.05
LAST_STRETCH_M = 30.0
LAST_PLAN_S = 15.0
"""No new plan so shortly before the braking point, where commands act late."""
EARLY_S = 1e-6
DUE_SHARE = 0.5
"""Share of what must have been learned for a plan that is due, where commands act late."""
LATEST = 1.05
"""Braking begins where waiting a period would take more than this share of the largest deceleration."""
DRIFT_MPS, COASTS_S = 0.03, 4.0
"""A trainset that coasts so much faster than planned must not meet the ceiling within this time."""
BRAKING_SHARE = 0.25
"""The last braking of a plan is where it brakes with more than this share of its strongest."""
LEAST_LASTING_MPS2, STRONGER = 0.1, 1.05
"""Least deceleration that a stop counts on; a plan whose last braking is this much stronger is made again."""
UNEASED_M = 1.0
"""An eased braking ends so far before the stop."""
COASTS_UP = replace(STOP_OPTIONS, coasts_up=True)
"""A plan may coast up a climb to the stop."""
POWERED_MPS2 = 1e-3
SOON_S = 3.0
"""Time before the plan brakes from which on it is not made again only because it is due."""
SURPRISE = 0.05
"""A traction gain this far from 1 says that the mass is not nominal."""


class Optimal(AbstractDriver):
    """Follows the energy-optimal plan and re-plans when time, track or state depart from it."""

    id: ClassVar[str] = "optimal"

    def __init__(self, options: OptimalOptions | None = None) -> None:
        self.options = options or OptimalOptions()

    def init(self, run: Run) -> FollowingMemory:
        """Plan the whole section for the trainset as it is known."""
        trainset = run.disturbance.nominal(run.trainset)
        model = model_of(run, run.section)
        vehicle, track = model.vehicle, model.track
        ceiling = ceiling_of(run, run.section, self.options.cap_margin_mps)
        coupled = self._couple(run, run.section)
        options = self._plan_options(model, ceiling, coupled)
        least = PlanOptions(coupled=_couple(run, run.section, Adaptation()))
        check_running_time(run.scheduled_time_s, fastest_time(vehicle_arrays(trainset), track, least))
        use = self._brake_use(vehicle, Adaptation(), ceiling, coupled)
        careful = adapt_vehicle(vehicle, Adaptation(brake=use))
        estimate = initial_estimate(model, weighed_brakes=weighs_load(vehicle))
        # The trainset stands until the first command begins to act.
        clock_s = look_ahead(model, estimate).seconds
        left = max(run.scheduled_time_s - self.options.reserve_s - clock_s, 1.0)
        plan = _plan(careful, track, left, options)
        curve = self._curve(model, plan, ceiling, coupled)
        return FollowingMemory(
            trainset=trainset,
            run=run,
            supervision=at_start(ceiling.guard),
            ceiling=ceiling,
            model=model,
            estimate=estimate,
            plan=plan,
            clock_s=clock_s,
            curve=curve,
            braking=False,
            adapted=Adaptation(),
            scheduled_s=run.scheduled_time_s,
            section=run.section,
            planned_at_s=0.0,
            coupled=coupled,
        )

    def act(self, memory: FollowingMemory, observation: Observation) -> tuple[float, FollowingMemory]:
        """Re-plan if need be, then follow the plan or the stop."""
        estimate = update_estimate(
            memory.model,
            memory.estimate,
            observation.position_m,
            observation.speed_mps,
            observation.acceleration_mps2,
            intervention=max(int(memory.supervision.level), observation.intervention),
        )
        memory = replace(memory, estimate=estimate)
        if memory.braking and stands_short(memory):
            memory = replace(memory, braking=False)
        if self._departs(memory, observation):
            memory = self._replan(memory, observation)
        target = float(memory.model.track.length_m)
        use = self._brake_use(memory.model.vehicle, memory.adapted, memory.ceiling, memory.coupled)
        ahead = look_ahead(memory.model, estimate)
        stop, available = stop_with_brake(memory.model, estimate, ahead, target, memory.curve, use, COASTS_UP)
        braking = memory.braking or self._takes_over(memory, stop, available)
        share = self._brake(memory, stop) if braking else self._follow(memory, ahead)
        guard = memory.ceiling.guard
        share, supervision = ask_protection(
            guard, memory.supervision, memory.model, estimate, observation, share
        )
        return share, replace(
            memory,
            estimate=record_command(estimate, share),
            supervision=supervision,
            braking=braking,
        )

    @staticmethod
    def _left(memory: FollowingMemory, ahead: PredictedState) -> float:
        """Distance to the stop from the state where a command begins to act."""
        return float(memory.model.track.length_m) - ahead.position_m

    def _takes_over(self, memory: FollowingMemory, stop: Stop, available_mps2: float) -> bool:
        """Tell if the stop's own law takes over: near the point, or where the plan would come too late."""
        left = self._left(memory, stop.ahead)
        rate = memory.curve.deceleration_mps2
        if memory.ceiling.late_s > 0.0:
            needed = self.options.careful_alarm * rate
        else:
            needed = rate if left <= self.options.handover_m else self.options.alarm * rate
        most = min(available_mps2, LATEST * float(memory.model.vehicle.max_deceleration_mps2))
        return bool(left <= LAST_METRES_M or stop.required_mps2 >= needed or stop.later_mps2 >= most)

    def _brake(self, memory: FollowingMemory, stop: Stop) -> float:
        """The stop's command; in the last period the deceleration in force, where it ends near enough."""
        options = LAG_STOP if memory.ceiling.lag_s > 0.0 else STOP_OPTIONS
        return stand(memory.model, stop, self.options.near_enough_m, CREEP_M, options)

    def _follow(self, memory: FollowingMemory, ahead: PredictedState) -> float:
        """The command that keeps to the plan's speed at the state where it begins to act."""
        plan, dt = memory.plan, memory.model.dt
        # The plan counts on no stronger brake than the nominal one; neither may the command that follows it.
        ahead = ahead._replace(brake_mps2=ahead.brake_mps2 / max(memory.estimate.brake_gain, 1.0))
        here = plan_speed(plan, ahead.position_m)
        step = 0.5 * (here + ahead.speed_mps) * dt
        start = max(ahead.position_m, float(plan.position_m[0]))
        then = plan_speed(plan, start + max(step, 1e-3))
        planned = (then * then - here * here) / (2 * max(step, 1e-3))
        if np.isfinite(lowest_jerk(memory.model.vehicle, memory.coupled)):
            planned = ramped_acceleration(plan, start + 0.5 * step)
        if float(plan.speed_mps[0]) == 0.0 and start - float(plan.position_m[0]) < START_STRETCH_M:
            planned = pull_away(plan, start + step)
        wanted = planned + self.options.speed_gain_per_s * (here - ahead.speed_mps)
        most = min(memory.ceiling.approach(ahead), float(memory.model.vehicle.max_acceleration_mps2))
        most = min(most, coupled_acceleration(memory.coupled, ahead.position_m, ahead.speed_mps))
        wanted = max(min(wanted, most), -float(memory.model.vehicle.max_deceleration_mps2))
        effort = wanted + ahead.resistance_mps2 + ahead.gradient_mps2
        k = min(
            int(np.searchsorted(plan.position_m, start + step, side="right")) - 1, plan.traction_n.size - 1
        )
        mass = float(memory.model.vehicle.effective_mass_kg)
        coasts = (plan.traction_n[k] + plan.brake_n[k]) / mass < 1e-3
        x, v = ahead.position_m, ahead.speed_mps
        drifts = v > here + DRIFT_MPS and v > memory.ceiling.at(x, COASTS_S * v)
        if coasts and abs(effort) < self.options.coast_band_mps2 and not drifts:
            return 0.0
        return ahead.share_for(wanted)

    def _departs(self, memory: FollowingMemory, observation: Observation) -> bool:
        """Tell if the run has left the plan in force."""
        news = observation.scheduled_time_s != memory.scheduled_s or observation.section is not memory.section
        if news:
            return True
        since_s = observation.time_s - memory.planned_at_s + EARLY_S
        if stands_short(memory):
            return since_s >= self.options.patience_s
        if memory.braking or since_s < min(self.options.patience_s, self.options.period_s):
            return False
        plan, estimate, options = memory.plan, memory.estimate, self.options
        acts = acts_late(memory.ceiling, memory.coupled)
        last_m = options.last_plan_m
        if acts:
            last_m = max(last_m, min(options.late_last_plan_m, LAST_PLAN_S * estimate.speed_mps))
        if float(memory.model.track.length_m) - estimate.position_m < last_m + braking_room(memory):
            return False
        due = since_s >= options.period_s
        if due and not acts and not brakes_soon(memory):
            return True
        # A plan begins with a correction, and a lag drags it on: late, a plan that holds is not made again,
        # unless it leaves time unused.
        early_s = memory.scheduled_s - options.reserve_s - memory.clock_s - plan.running_time_s
        late = observation.time_s - memory.clock_s - plan_time(plan, estimate.position_m)
        off = estimate.speed_mps - plan_speed(plan, estimate.position_m)
        learned = departs_from(self._adaptation(estimate), memory.adapted, DUE_SHARE if due else 1.0)
        pulse = acts or (late > 0.0 and not powers_ahead(memory))
        return (
            abs(late) > (options.late_time_band_s if pulse else options.time_band_s)
            or abs(off) > options.speed_band_mps
            or (acts and early_s > options.late_time_band_s)
            or learned
        )

    def _replan(self, memory: FollowingMemory, observation: Observation) -> FollowingMemory:
        """Make a plan from the current state, with the estimated plant."""
        model, estimate = memory.model, memory.estimate
        ceiling, coupled = memory.ceiling, memory.coupled
        if observation.section is not memory.section:
            model = model_of(memory.run, observation.section)
            ceiling = ceiling_of(memory.run, observation.section, self.options.cap_margin_mps)
            coupled = self._couple(memory.run, observation.section)
        adapted = self._adaptation(estimate)
        # What is in flight cannot be changed: the plan begins where a command given now begins to act.
        ahead = look_ahead(model, estimate)
        clock_s = observation.time_s + ahead.seconds
        left = max(observation.scheduled_time_s - self.options.reserve_s - clock_s, 1.0)
        options = replace(
            self._plan_options(model, ceiling, coupled),
            start_m=max(ahead.position_m, 0.0),
            start_mps=max(ahead.speed_mps, 0.0),
            start_mps2=ahead.acceleration_mps2,
        )
        use = self._brake_use(model.vehicle, adapted, ceiling, coupled)
        vehicle = adapt_vehicle(model.vehicle, adapted._replace(brake=adapted.brake * use))
        updated = replace(
            memory,
            model=model,
            ceiling=ceiling,
            section=observation.section,
            scheduled_s=observation.scheduled_time_s,
            planned_at_s=observation.time_s,
            adapted=adapted,
            braking=False,
            coupled=coupled,
        )
        try:
            plan = _plan(vehicle, model.track, left, options, memory.plan)
        except SolverError:
            return updated
        return replace(updated, plan=plan, clock_s=clock_s, curve=self._curve(model, plan, ceiling, coupled))

    def _adaptation(self, estimate: StateEstimate) -> Adaptation:
        """Plant to plan with: the estimated one, with a brake no stronger than nominal."""
        return Adaptation(estimate.traction_gain, min(estimate.brake_gain, 1.0), estimate.resistance_factor)

    def _couple(self, run: Run, section: Section) -> tuple[Coupled, ...]:
        """The trainsets behind, with the part of their efforts that the plan counts on."""
        use = self.options.coupled_use
        return _couple(run, section, Adaptation(use, use)) if self.options.joint else ()

    def _brake_use(
        self, vehicle: Vehicle, adapted: Adaptation, ceiling: Ceiling, coupled: tuple[Coupled, ...]
    ) -> float:
        """Share of the braking force to plan with."""
        nominal = not acts_late(ceiling, coupled) and abs(adapted.traction - 1.0) <= SURPRISE
        sure = nominal and weighs_load(vehicle, spare=1.0)
        return self.options.brake_use if sure else self.options.careful_brake_use

    def _release_share(self, model: Model, ceiling: Ceiling, coupled: tuple[Coupled, ...]) -> float:
        """Mean jerk of the last brake's release over the lowest jerk limit; a lag makes it take longer."""
        vehicle, share = model.vehicle, self.options.release_share
        jerk = lowest_jerk(vehicle, coupled)
        if not np.isfinite(jerk):
            return share
        lag_s = max(ceiling.lag_s, *(float(each.vehicle.lag_s) for each in coupled), 0.0)
        brake = float(effort_at(vehicle, np.float64(0.0)).brake_n) / float(vehicle.effective_mass_kg)
        released = min(brake, float(vehicle.max_deceleration_mps2))
        return share / (1.0 + share * jerk * lag_s / released)

    def _curve(self, model: Model, plan: Plan, ceiling: Ceiling, coupled: tuple[Coupled, ...]) -> StopCurve:
        """The stop the plan ends with: the deceleration it brakes at before it lets go."""
        vehicle = model.vehicle._replace(jerk_mps3=lowest_jerk(model.vehicle, coupled))
        braking = -np.diff(plan.speed_mps**2) / (2 * np.diff(plan.position_m))
        left_m = float(plan.position_m[-1]) - plan.position_m
        last = left_m[1:] < LAST_STRETCH_M
        rate = float(braking[last].max())
        # An eased braking grows again at the very end: nothing to hold on the way to it.
        held = braking[last & (left_m[1:] >= UNEASED_M) & (plan.brake_n > BRAKING_SHARE * plan.brake_n.max())]
        rate = float(held.max()) if held.size and rate > STRONGER * held.max() else rate
        rate = min(max(rate, 0.3), float(vehicle.max_deceleration_mps2))
        shape = StopOptions(release_share=self._release_share(model, ceiling, coupled))
        return curve_for(vehicle, model.dt, rate, shape)

    def _plan_options(self, model: Model, ceiling: Ceiling, coupled: tuple[Coupled, ...]) -> PlanOptions:
        """Plans allow for the lowest jerk limit, and stay below the ceiling over a control period."""
        jerk = lowest_jerk(model.vehicle, coupled)
        limited = bool(np.isfinite(jerk))
        cap = ceiling.speed_mps
        held = int(np.ceil(float(cap.max()) * model.dt))
        late = [np.concatenate([np.repeat(cap[:1], k), cap[: cap.size - k]]) for k in range(held + 1)]
        return PlanOptions(
            objective=self.options.objective,
            spacing_m=self.options.spacing_m,
            late_w=LATE_W,
            jerk_mps3=jerk if limited else None,
            release_mps3=self._release_share(model, ceiling, coupled) * jerk if limited else None,
            cap_m=ceiling.position_m,
            cap_mps=np.min(late, axis=0),
            coupled=coupled,
        )


def _couple(run: Run, section: Section, adapted: Adaptation) -> tuple[Coupled, ...]:
    """Trainsets coupled behind that of a run, with their efforts scaled."""
    behind = [adapt_trainset(trainset, adapted) for trainset, _ in run.coupled]
    at = [offset_m for _, offset_m in run.coupled]
    return couple_trainsets(section, [run.trainset, *behind], [0.0, *at], limits_extended=True)


def lowest_jerk(vehicle: Vehicle, coupled: tuple[Coupled, ...]) -> float:
    """Lowest jerk limit of a trainset and of those coupled behind it, m/s^3."""
    return min(float(each.jerk_mps3) for each in (vehicle, *(each.vehicle for each in coupled)))


def acts_late(ceiling: Ceiling, coupled: tuple[Coupled, ...]) -> bool:
    """True if the commands of a trainset, or of one coupled behind it, act after a dead time or a lag."""
    behind = max((float(each.vehicle.delay_s + each.vehicle.lag_s) for each in coupled), default=0.0)
    return max(ceiling.late_s, behind) > 0.0


def _plan(
    vehicle: Vehicle, track: Track, time_s: float, options: PlanOptions, about: Plan | None = None
) -> Plan:
    """The plan that allows for the jerk limit or, where there is none, one that leaves it to the plant."""
    try:
        plan = plan_arrays(vehicle, track, time_s, options, about)
    except SolverError:
        options = replace(options, jerk_mps3=None, release_mps3=None)
        plan = plan_arrays(vehicle, track, time_s, options)
    return _ease_last_braking(vehicle, track, time_s, options, plan)


def _ease_last_braking(
    vehicle: Vehicle, track: Track, time_s: float, options: PlanOptions, plan: Plan
) -> Plan:
    """The plan, or one whose last braking is no stronger than the stop's own law keeps up to the stop.

    On a fall before the stop, or at the end of a climb, that is less than what the brake could give on the
    way.
    """
    if options.coupled or options.cap_m is None or options.cap_mps is None:
        return plan
    brakes = plan.brake_n > BRAKING_SHARE * plan.brake_n.max()
    begin = int(np.flatnonzero(np.append(True, ~brakes))[-1])
    start, end = float(plan.position_m[begin]), float(plan.position_m[-1])
    speed = float(plan.speed_mps[begin])
    if end - start < LAST_STRETCH_M:
        return plan
    lasts = max(lasting_deceleration(vehicle, track, start, end, speed), LEAST_LASTING_MPS2)
    if speed * speed <= STRONGER * 2.0 * lasts * (end - start):
        return plan
    cap = np.minimum(options.cap_mps, np.sqrt(2.0 * lasts * np.maximum(end - options.cap_m, UNEASED_M)))
    try:
        return plan_arrays(vehicle, track, time_s, replace(options, cap_mps=cap), plan)
    except SolverError:
        return plan


def powers_ahead(memory: FollowingMemory) -> bool:
    """Tell if the plan still needs traction between here and the stop."""
    plan = memory.plan
    here = int(np.searchsorted(plan.position_m, memory.estimate.position_m, side="right")) - 1
    mass = float(memory.model.vehicle.effective_mass_kg)
    return bool((plan.traction_n[max(here, 0) :] / mass > POWERED_MPS2).any())


def brakes_soon(memory: FollowingMemory) -> bool:
    """Tell if the plan brakes here or in a moment: a plan made now would not allow for the build-up."""
    plan, estimate = memory.plan, memory.estimate
    at = estimate.position_m, estimate.position_m + SOON_S * estimate.speed_mps
    first, last = np.searchsorted(plan.position_m, at, side="right")
    mass = float(memory.model.vehicle.effective_mass_kg)
    return bool((plan.brake_n[max(first - 1, 0) : last] / mass > POWERED_MPS2).any())


def stands_short(memory: FollowingMemory) -> bool:
    """Tell if the trainset stands, once departed, so far from the stop that it takes a plan to get there."""
    estimate = memory.estimate
    left = float(memory.model.track.length_m) - estimate.position_m
    return (
        estimate.speed_mps < STOP_OPTIONS.creep_mps
        and left > LAST_METRES_M
        and estimate.position_m > LAST_METRES_M
    )


def braking_room(memory: FollowingMemory) -> float:
    """Distance the stop needs from the present speed."""
    v = memory.estimate.speed_mps
    return v * v / (2 * memory.curve.deceleration_mps2) + v

"""Shared part of the drivers that track a reference: the reference, the errors, the stop at the point.

The controllers of Cheng23 see a reference over time and answer its speed error. Around them stands what a
real line needs and the paper leaves out: the reference keeps to limits and effort and is laid anew when the
schedule changes or the trainset cannot follow; the error is taken where a command begins to act; the last
metres belong to the stop's own law; protection is asked before it has to intervene.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from copy import copy
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from metropilot._schema import CheckedFields, declare
from metropilot._typing import Array
from metropilot.control import (
    CHENG2023_GAINS,
    SERVICE_USE,
    Ceiling,
    Errors,
    Model,
    PredictedState,
    StateEstimate,
    Stop,
    StopCurve,
    ask_protection,
    ceiling_of,
    curve_for,
    initial_estimate,
    look_ahead,
    model_of,
    record_command,
    stop_with_brake,
    update_estimate,
)
from metropilot.planning import (
    PlanOptions,
    ReferenceShape,
    ReferenceTrack,
    TimedReference,
    plan_arrays,
    reference_under_for_time,
    sample_profile,
)
from metropilot.protection import Memory, at_start
from metropilot.railway import Section
from metropilot.sim import AbstractDriver, Observation, Run

Kind = Literal["trapezoid", "s_curve", "optimal"]
KINDS: tuple[Kind, ...] = ("trapezoid", "s_curve", "optimal")
REFERENCE_PERIOD_S = 0.05
GAINS_PERIOD_S = 0.2
"""Control period that the gains are for."""
CAP_MARGIN_MPS = 0.4
PATIENCE_S = 4.0
HANDOVER_M = 25.0
ALARM = 1.15
LATEST = 1.25
"""The stop's own law takes over where waiting a period would take more than this share of the rate."""


class TrackingView(NamedTuple):
    """Inputs of a controller in one period.

    Attributes:
        error_mps: Speed of the reference less speed.
        distance_m: Position of the reference less position.
        speed_mps: Speed.
        reference_mps: Speed of the reference.
        command: Command of the period before.
        feed_forward: Change since then of the command that the reference takes of the nominal plant; 0 where
            nobody computes it.
    """

    error_mps: Array
    distance_m: Array
    speed_mps: Array
    reference_mps: Array
    command: Array
    feed_forward: Array = 0.0


@dataclass(frozen=True)
class AbstractTrackingOptions(CheckedFields):
    """Options of a tracking driver: the reference it follows and its assists.

    Attributes:
        reference: ``trapezoid``, ``s_curve`` or ``optimal`` (the energy-optimal plan).
        acceleration_mps2: Largest acceleration of the reference.
        deceleration_mps2: Largest deceleration of the reference.
        jerk_mps3: Largest jerk of the S-curve.
        effort_share: Share of traction and brake the reference may use.
        station_stop: The last metres belong to the stop's own law; off, the controller stops by itself.
        slip_m: A distance behind or ahead of the reference that calls for a new one.
    """

    reference: str = declare("s_curve", choices=KINDS)
    acceleration_mps2: float = declare(0.9, unit="m/s^2", low=0.0, high=3.0, above=True)
    deceleration_mps2: float = declare(0.8, unit="m/s^2", low=0.0, high=3.0, above=True)
    jerk_mps3: float = declare(0.5, unit="m/s^3", low=0.0, above=True)
    effort_share: float = declare(0.9, low=0.0, high=1.0, above=True)
    station_stop: bool = declare(True)
    slip_m: float = declare(5.0, unit="m", low=0.0, infinite=True)


@dataclass(frozen=True)
class AbstractPidOptions(AbstractTrackingOptions):
    """Options of a tracking driver with an incremental PID, for a control period of 0.2 s.

    Attributes:
        kp: Gain on the change of the error, 1/(m/s).
        ki: Gain on the error, 1/(m/s) and period.
        kd: Gain on the change of the change, 1/(m/s).
    """

    kp: float = declare(CHENG2023_GAINS.proportional, low=0.0, high=100.0)
    ki: float = declare(CHENG2023_GAINS.integral, low=0.0, high=100.0)
    kd: float = declare(CHENG2023_GAINS.derivative, low=0.0, high=100.0)


class TrackingMemory(NamedTuple):
    """The driver's memory.

    Attributes:
        run: The run.
        section: The section the reference was laid for.
        scheduled_s: The scheduled time it was laid for.
        model: Nominal trainset and section.
        supervision: State of protection, kept alongside.
        ceiling: Largest speed and acceleration under protection.
        estimate: Estimate of the state and of the plant.
        reference: Reference in force.
        clock_s: Start of the reference.
        controller: The controller's own memory.
        command: The controller's last command.
        stop: Shape of the stop.
        stopping: True once the stop's own law drives.
    """

    run: Run
    section: Section
    scheduled_s: float
    model: Model
    supervision: Memory
    ceiling: Ceiling
    estimate: StateEstimate
    reference: TimedReference
    clock_s: float
    controller: Any
    command: float
    stop: StopCurve
    stopping: bool


class AbstractTracker(AbstractDriver):
    """A controller of the speed error with a reference to follow.

    Args:
        options: Options of the driver.
    """

    def __init__(self, options: AbstractTrackingOptions) -> None:
        self.options = options
        self.keeps_reference = False

    def aboard(self, number: type) -> AbstractTracker | None:
        """The same driver, its reference laid once: on a controller there is nothing to lay another with."""
        del number
        found = copy(self)
        found.keeps_reference = True
        return found

    def fresh(self, run: Run) -> Any:  # noqa: ANN401 (each controller has its own)
        """The controller's memory at the start of a run: by default no errors yet."""
        del run
        return Errors(0.0, 0.0)

    @abstractmethod
    def control(self, memory: Any, seen: TrackingView) -> tuple[float, Any]:  # noqa: ANN401
        """The command in [-1, 1] for this period, and the memory to bring next time."""

    def init(self, run: Run) -> TrackingMemory:
        """Lay the reference for the whole section."""
        model = model_of(run, run.section)
        ceiling = ceiling_of(run, run.section, CAP_MARGIN_MPS)
        return TrackingMemory(
            run=run,
            section=run.section,
            scheduled_s=run.scheduled_time_s,
            model=model,
            supervision=at_start(ceiling.guard),
            ceiling=ceiling,
            estimate=initial_estimate(model),
            reference=self._lay_reference(model, ceiling, run.scheduled_time_s, 0.0, 0.0),
            clock_s=0.0,
            controller=self.fresh(run),
            command=0.0,
            stop=self._curve(model),
            stopping=False,
        )

    def act(self, memory: TrackingMemory, observation: Observation) -> tuple[float, TrackingMemory]:
        """Take the errors, let the controller or the stop's law answer, ask protection."""
        estimate = update_estimate(
            memory.model,
            memory.estimate,
            observation.position_m,
            observation.speed_mps,
            observation.acceleration_mps2,
            intervention=max(int(memory.supervision.level), observation.intervention),
        )
        memory = self._follow_updates(memory._replace(estimate=estimate), observation)
        ahead = look_ahead(memory.model, estimate)
        place, speed, _ = memory.reference.at(observation.time_s - memory.clock_s + ahead.seconds)
        seen = TrackingView(
            speed - ahead.speed_mps, place - ahead.position_m, ahead.speed_mps, speed, memory.command
        )
        command, controller = self._control(memory, seen)
        if memory.ceiling.late_s > 0.0:
            # A late command is judged by what it would do until it can be taken back: ease off in time.
            command = min(command, ahead.share_for(memory.ceiling.approach(ahead), lead=0.0))
        memory = memory._replace(controller=controller, command=command)
        memory = self._hand_over(memory, ahead)
        share = self._share(memory, ahead)
        guard = memory.ceiling.guard
        share, supervision = ask_protection(
            guard, memory.supervision, memory.model, estimate, observation, share
        )
        return share, memory._replace(
            estimate=record_command(estimate, share),
            supervision=supervision,
        )

    def _share(self, memory: TrackingMemory, ahead: PredictedState) -> float:
        """Command of the stop's own law once it drives, before that the controller's, ahead of the lag."""
        return (
            self._stop(memory, ahead, memory.stop)[0].share if memory.stopping else ahead.lead(memory.command)
        )

    def _control(self, memory: TrackingMemory, seen: TrackingView) -> tuple[float, Any]:
        """The law's command, in a longer control period than its gains are for as in several of theirs."""
        periods = max(round(memory.model.dt / GAINS_PERIOD_S), 1)
        wanted, controller = self.control(memory.controller, seen)
        for _ in range(periods - 1):
            wanted, controller = self.control(controller, seen._replace(command=wanted))
        # The law is incremental, and the plant answers for so much longer before it sees what came of it.
        return memory.command + (float(wanted) - memory.command) / periods, controller

    def _stop(self, memory: TrackingMemory, ahead: PredictedState, curve: StopCurve) -> tuple[Stop, float]:
        """The stop, and the deceleration that it may count on: what the brake surely gives."""
        target = float(memory.model.track.length_m)
        return stop_with_brake(memory.model, memory.estimate, ahead, target, curve, SERVICE_USE)

    def _hand_over(self, memory: TrackingMemory, ahead: PredictedState) -> TrackingMemory:
        """Give the last metres to the stop's own law, from the deceleration that is in force there."""
        if not self.options.station_stop or memory.stopping:
            return memory
        left = float(memory.model.track.length_m) - ahead.position_m
        curve = self._curve(memory.model)
        rate = float(curve.deceleration_mps2)
        stop, available = self._stop(memory, ahead, curve)
        required, most = stop.required_mps2, min(available, LATEST * rate)
        if left > HANDOVER_M and required < ALARM * rate and stop.later_mps2 < most:
            return memory
        curve = curve._replace(deceleration_mps2=min(max(required, 0.1), ALARM * rate))
        return memory._replace(stop=curve, stopping=True)

    def _curve(self, model: Model) -> StopCurve:
        """Shape of a stop as the reference has it."""
        rate = min(self.options.deceleration_mps2, float(model.vehicle.max_deceleration_mps2))
        return curve_for(model.vehicle, model.dt, rate)

    def _follow_updates(self, memory: TrackingMemory, observation: Observation) -> TrackingMemory:
        """Lay the reference anew after news, or where the trainset is far from it."""
        if self.keeps_reference:
            return memory
        section, model, ceiling = memory.section, memory.model, memory.ceiling
        news = observation.scheduled_time_s != memory.scheduled_s or observation.section is not section
        clock = observation.time_s - memory.clock_s
        slipped = (
            clock > PATIENCE_S
            and not memory.stopping
            and abs(memory.reference.at(clock)[0] - memory.estimate.position_m) > self.options.slip_m
        )
        if not (news or slipped):
            return memory
        if observation.section is not section:
            section = observation.section
            model = model_of(memory.run, section)
            ceiling = ceiling_of(memory.run, section, CAP_MARGIN_MPS)
        left = max(observation.scheduled_time_s - observation.time_s, 1.0)
        reference = self._lay_reference(
            model, ceiling, left, memory.estimate.position_m, memory.estimate.speed_mps
        )
        return memory._replace(
            section=section,
            scheduled_s=observation.scheduled_time_s,
            model=model,
            ceiling=ceiling,
            reference=reference,
            clock_s=observation.time_s,
        )

    def _lay_reference(
        self, model: Model, ceiling: Ceiling, left_s: float, start_m: float, start_mps: float
    ) -> TimedReference:
        """The reference from a state to the stop in the time left."""
        options = self.options
        start, start_mps = min(max(start_m, 0.0), float(model.track.length_m) - 1.0), max(start_mps, 0.0)
        if options.reference == "optimal":
            plan_options = PlanOptions(
                start_m=start,
                start_mps=start_mps,
                cap_m=ceiling.position_m,
                cap_mps=ceiling.speed_mps,
                late_w=500.0,
            )
            plan = plan_arrays(model.vehicle, model.track, left_s, plan_options)
            return sample_profile(plan.position_m, plan.speed_mps, REFERENCE_PERIOD_S)
        jerk = options.jerk_mps3 if options.reference == "s_curve" else math.inf
        jerk = min(jerk, 0.8 * float(model.vehicle.jerk_mps3))
        braking = min(options.deceleration_mps2, float(model.vehicle.max_deceleration_mps2))
        shape = ReferenceShape(options.acceleration_mps2, braking, jerk)
        constraints = ReferenceTrack(
            model.vehicle,
            model.track,
            ceiling.position_m,
            ceiling.line_mps,
            options.effort_share,
            start,
            start_mps,
        )
        return reference_under_for_time(constraints, shape, left_s, REFERENCE_PERIOD_S)

"""The fastest run a driver can make: full traction, just under the limit, latest comfortable braking."""

from __future__ import annotations

from typing import NamedTuple, final

from metropilot.control import (
    SERVICE_USE,
    Ceiling,
    Model,
    StateEstimate,
    ask_protection,
    ceiling_acceleration,
    ceiling_of,
    comfortable_deceleration,
    curve_for,
    initial_estimate,
    look_ahead,
    model_of,
    record_command,
    stop_with_brake,
    traction_limit,
    update_estimate,
    weakest_gradient,
)
from metropilot.protection import Memory, at_start
from metropilot.railway import Section
from metropilot.sim import AbstractDriver, Observation, Run


class FlatOutMemory(NamedTuple):
    """Memory of the driver between two periods.

    Attributes:
        run: The run.
        section: The section as last announced.
        model: Trainset and section as believed.
        ceiling: Speeds to keep under.
        supervision: Memory of protection kept alongside.
        gradient_mps2: Steepest downhill before the stop.
        estimate: State and plant as estimated.
        braking_mps2: Deceleration of the final braking, 0 before it.
    """

    run: Run
    section: Section
    model: Model
    ceiling: Ceiling
    supervision: Memory
    gradient_mps2: float
    estimate: StateEstimate
    braking_mps2: float


@final
class FlatOut(AbstractDriver):
    """Drives as fast as protection, comfort and the trainset allow; the scheduled time is ignored."""

    id = "flat_out"

    def init(self, run: Run) -> FlatOutMemory:
        """Look at the section once."""
        model, ceiling = model_of(run, run.section), ceiling_of(run, run.section)
        return FlatOutMemory(
            run=run,
            section=run.section,
            model=model,
            ceiling=ceiling,
            supervision=at_start(ceiling.guard),
            gradient_mps2=weakest_gradient(model, run.section.length_m),
            estimate=initial_estimate(model),
            braking_mps2=0.0,
        )

    def act(self, memory: FlatOutMemory, observation: Observation) -> tuple[float, FlatOutMemory]:
        """Full speed until the final braking has to begin, then stop."""
        memory = self._follow_updates(memory, observation)
        model = memory.model
        estimate = update_estimate(
            model,
            memory.estimate,
            observation.position_m,
            observation.speed_mps,
            observation.acceleration_mps2,
            intervention=max(int(memory.supervision.level), observation.intervention),
        )
        share, braking = self._share(memory, estimate)
        guard = memory.ceiling.guard
        share, supervision = ask_protection(guard, memory.supervision, model, estimate, observation, share)
        return share, memory._replace(
            estimate=record_command(estimate, share), supervision=supervision, braking_mps2=braking
        )

    def _share(self, memory: FlatOutMemory, estimate: StateEstimate) -> tuple[float, float]:
        model, target = memory.model, memory.section.length_m
        comfortable = memory.braking_mps2 or comfortable_deceleration(model, estimate, memory.gradient_mps2)
        curve = curve_for(model.vehicle, model.dt, comfortable)
        ahead = look_ahead(model, estimate)
        stop, available = stop_with_brake(model, estimate, ahead, target, curve, SERVICE_USE)
        if memory.braking_mps2 or stop.required_mps2 >= comfortable or stop.later_mps2 >= available:
            return stop.share, comfortable
        wanted = ceiling_acceleration(model, ahead, memory.ceiling, float("inf"), curve)
        return min(ahead.share_for(wanted), traction_limit(estimate, ahead, memory.ceiling)), 0.0

    def _follow_updates(self, memory: FlatOutMemory, observation: Observation) -> FlatOutMemory:
        """Take note of a restriction announced on the way."""
        if observation.section is memory.section:
            return memory
        section = observation.section
        return memory._replace(
            section=section, model=model_of(memory.run, section), ceiling=ceiling_of(memory.run, section)
        )

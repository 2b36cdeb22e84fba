"""Tracking of a reference on the plant alone: the loop in which Cheng23's controllers are compared.

There is no protection and no assist: in each control period a controller maps the speed error to a command,
and the plant is stepped. Written over the array namespace, so that a controller runs the same way compiled in
a batch, in NumPy, and (through :mod:`metropilot.drivers.tracking`) on a section with protection.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from metropilot._typing import Array
from metropilot.control import Errors
from metropilot.physics import (
    Command,
    Forces,
    State,
    Track,
    Vehicle,
    namespace,
    to_jax,
    track_arrays,
    vehicle_arrays,
)
from metropilot.planning import TimedReference
from metropilot.railway import Section, Trainset
from metropilot.sim import NEVER_ENDS, RunParams, control_period, first_state

GRACE_S = 3.0
"""A trainset may come to a stand this much later than its reference."""


class ReferenceCourse(NamedTuple):
    """Reference to be tracked, with plant and track.

    Attributes:
        vehicle: True plant.
        track: The section.
        position_m: Position of the reference at the start of each period, held after its end. Shape (N + 1,).
        speed_mps: Its speed. Shape (N + 1,).
        end: Period in which the reference comes to a standstill.
        dt: Control period, s.
    """

    vehicle: Vehicle
    track: Track
    position_m: Array
    speed_mps: Array
    end: Array
    dt: Array

    @property
    def periods(self) -> int:
        """Number of control periods of the reference and the grace time."""
        return int(self.position_m.shape[0]) - 1


class TrackingView(NamedTuple):
    """Inputs of a controller in one period.

    Attributes:
        error_mps: Speed of the reference less speed.
        distance_m: Position of the reference less position.
        speed_mps: Speed.
        reference_mps: Speed of the reference.
        command: Command of the period before.
    """

    error_mps: Array
    distance_m: Array
    speed_mps: Array
    reference_mps: Array
    command: Array


class TrackState(NamedTuple):
    """State of the trainset and of its controller.

    Attributes:
        plant: State of the plant.
        command: Command of the period before.
        errors: Speed errors of the two periods before.
        period: Control periods gone.
    """

    plant: State
    command: Array
    errors: Errors
    period: Array


def course_of(
    trainset: Trainset,
    section: Section,
    reference: TimedReference,
    resistance_factor: float = 1.0,
) -> ReferenceCourse:
    """Course in NumPy float64 with the reference's control period and without dead time.

    Args:
        trainset: Nominal trainset.
        section: Section.
        reference: Reference, sampled at the control period.
        resistance_factor: True over nominal running resistance.
    """
    vehicle = vehicle_arrays(trainset)
    vehicle = vehicle._replace(davis_n=vehicle.davis_n * resistance_factor)
    dt = reference.period_s
    end = int(np.ceil(reference.duration_s / dt - 1e-9))
    count = end + round(GRACE_S / dt) + 1
    held = np.minimum(np.arange(count), reference.position_m.size - 1)
    return ReferenceCourse(
        vehicle,
        track_arrays(section, trainset),
        reference.position_m[held],
        reference.speed_mps[held],
        np.int64(end),
        np.float64(dt),
    )


def compile_course(course: ReferenceCourse) -> ReferenceCourse:
    """The course in JAX, single precision."""
    import jax

    single = jax.tree.map(
        lambda x: np.asarray(x, np.float32 if np.asarray(x).dtype.kind == "f" else np.int32), course
    )
    return to_jax(single)


def start_tracking() -> TrackState:
    """At rest at the origin (NumPy)."""
    zero = np.float64(0.0)
    forces = Forces(zero, zero, zero, zero, zero)
    plant = State(
        time_s=zero,
        position_m=zero,
        speed_mps=zero,
        acceleration_mps2=zero,
        share=zero,
        pipeline=np.zeros(1),
        emergency_s=zero,
        forces=forces,
        traction_j=zero,
        electric_brake_j=zero,
        line_j=zero,
        recovered_j=zero,
    )
    return TrackState(plant, zero, Errors(zero, zero), np.int64(0))


def tracking_view(course: ReferenceCourse, state: TrackState) -> TrackingView:
    """Inputs of the controller at the start of a period."""
    plant, k = state.plant, state.period
    reference = course.speed_mps[k]
    return TrackingView(
        reference - plant.speed_mps,
        course.position_m[k] - plant.position_m,
        plant.speed_mps,
        reference,
        state.command,
    )


def advance_tracking(
    course: ReferenceCourse, state: TrackState, command: Array, errors: Errors
) -> TrackState:
    """One control period under a command, without protection (Cheng23 eqs. 1 to 3)."""
    params = RunParams(
        vehicle=course.vehicle,
        track=course.track,
        protection=None,
        length_m=course.track.length_m,
        scheduled_s=state.plant.time_s,
        speed_noise_mps=0.0,
        dt=course.dt,
    )
    run, _, _ = control_period(
        params,
        first_state(state.plant, None),
        None,
        lambda _, __: (Command(command, False), None),
        rule=NEVER_ENDS,
    )
    return TrackState(run.plant, command, errors, state.period + 1)


def tracking_observation(given: TrackingView) -> Array:
    """Observation of DDPG-PID, scaled: speed, command, speed and position error, (4,). Cheng23 eq. 7."""
    xp = namespace(given.error_mps)
    xp = np if xp.__name__ == "scalars" else xp
    parts = (
        given.speed_mps / 20.0,
        given.command,
        given.error_mps / 0.05,
        given.distance_m / 0.15,
    )
    return xp.clip(xp.stack([xp.asarray(part, np.float32) for part in parts]), -5.0, 5.0)

"""Tracking of a reference on the plant alone: the loop in which Cheng23's controllers are compared.

There is no protection and no assist: in each control period a controller maps the speed error to a command,
and the plant is stepped. Written over the array namespace, so that a controller runs the same way compiled in
a batch, in NumPy, and (through :mod:`metropilot.drivers.tracking`) on a section with protection.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from metropilot import physics
from metropilot._typing import Array, Float, Index, Scalar
from metropilot.control import Errors
from metropilot.drivers import TrackingView
from metropilot.planning import TimedReference
from metropilot.railway import Section, Trainset
from metropilot.sim import NEVER_ENDS, RunParams, control_period, first_state
from metropilot.units import J_PER_KWH

GRACE_S = 3.0
"""A trainset may come to a stand this much later than its reference."""


class ReferenceCourse(NamedTuple):
    """Reference to be tracked, with plant and track.

    Attributes:
        vehicle: True plant.
        track: The section.
        position_m: Position of the reference at the start of each period, held after its end.
        speed_mps: Its speed.
        needed: Command that it takes of the nominal plant in each period.
        end: Period in which the reference comes to a standstill.
        dt: Control period, s.
    """

    vehicle: physics.Vehicle
    track: physics.Track
    position_m: Float[Array, " nodes"]
    speed_mps: Scalar
    needed: Float[Array, " nodes"]
    end: Index
    dt: Scalar

    @property
    def periods(self) -> int:
        """Number of control periods of the reference and the grace time."""
        return int(self.position_m.shape[0]) - 1


class TrackState(NamedTuple):
    """State of the trainset and of its controller.

    Attributes:
        plant: State of the plant.
        command: Command of the period before.
        errors: Speed errors of the two periods before.
        period: Control periods gone.
    """

    plant: physics.State
    command: Scalar
    errors: Errors
    period: Index


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
    nominal = physics.vehicle_arrays(trainset)
    vehicle = nominal._replace(davis_n=nominal.davis_n * resistance_factor)
    dt = reference.period_s
    end = int(np.ceil(reference.duration_s / dt - 1e-9))
    count = end + round(GRACE_S / dt) + 1
    held = np.minimum(np.arange(count), reference.position_m.size - 1)
    return ReferenceCourse(
        vehicle,
        physics.track_arrays(section, trainset),
        reference.position_m[held],
        reference.speed_mps[held],
        needed_commands(nominal, reference.speed_mps[held], dt),
        np.int64(end),
        np.float64(dt),
    )


def needed_commands(
    nominal: physics.Vehicle, speed_mps: Float[np.ndarray, " nodes"], dt: float
) -> Float[np.ndarray, " nodes"]:
    """Compute the command that a reference takes of the nominal plant in each period, on level track.

    Args:
        nominal: Plant as it is known, not as it is.
        speed_mps: Speed of the reference at the start of each period.
        dt: Control period, s.
    """
    rate = np.diff(speed_mps, append=speed_mps[-1]) / dt
    moves = (speed_mps > 0.0) | (rate > 0.0)
    force = np.where(moves, rate * nominal.effective_mass_kg + physics.davis_n(nominal, speed_mps), 0.0)
    return physics.command_for_force(nominal, speed_mps, force)


def compile_course(course: ReferenceCourse) -> ReferenceCourse:
    """The course in JAX, single precision."""
    import jax

    single = jax.tree.map(
        lambda x: np.asarray(x, np.float32 if np.asarray(x).dtype.kind == "f" else np.int32), course
    )
    return physics.to_jax(single)


def start_tracking() -> TrackState:
    """At rest at the origin (NumPy)."""
    zero = np.float64(0.0)
    parts: dict[str, Any] = dict.fromkeys(physics.State._fields, zero) | {
        "pipeline": np.zeros(1),
        "forces": physics.Forces(*[zero] * 5),
    }
    return TrackState(physics.State(**parts), zero, Errors(zero, zero), np.int64(0))


def start_compiled() -> TrackState:
    """The same in JAX, single precision."""
    import jax
    import jax.numpy as jnp

    return jax.tree.map(
        lambda x: jnp.asarray(x, jnp.int32 if np.asarray(x).dtype.kind == "i" else jnp.float32),
        start_tracking(),
    )


def tracking_view(course: ReferenceCourse, state: TrackState) -> TrackingView:
    """Inputs of the controller at the start of a period."""
    plant, k = state.plant, state.period
    reference, xp = course.speed_mps[k], array_namespace(course.needed)
    return TrackingView(
        reference - plant.speed_mps,
        course.position_m[k] - plant.position_m,
        plant.speed_mps,
        reference,
        state.command,
        course.needed[k] - xp.where(k > 0, course.needed[xp.maximum(k - 1, 0)], 0.0),
    )


def advance_tracking(
    course: ReferenceCourse, state: TrackState, command: Scalar, errors: Errors
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
        lambda _, __: (physics.Command(command, False), None),
        rule=NEVER_ENDS,
    )
    return TrackState(run.plant, command, errors, state.period + 1)


class ObservationScale(NamedTuple):
    """Values that count as 1 in the observation of DDPG-PID.

    Attributes:
        speed_mps: Speed.
        error_mps: Speed error.
        distance_m: Position error.
        most: Size at which every entry is cut off.
    """

    speed_mps: float
    error_mps: float
    distance_m: float
    most: float


SCALE = ObservationScale(20.0, 0.05, 0.15, 5.0)


def array_namespace(*values: Array) -> Any:  # noqa: ANN401 (a module)
    """NumPy or JAX's: single numbers count as NumPy's here."""
    found = physics.namespace(*values)
    return np if found.__name__ == "scalars" else found


def tracking_observation(given: TrackingView, scale: ObservationScale = SCALE) -> Float[Array, "4"]:
    """Observation of DDPG-PID, scaled: speed, command, speed and position error. Cheng23 eq. 7."""
    xp = array_namespace(given.error_mps)
    parts = (
        given.speed_mps / scale.speed_mps,
        given.command,
        given.error_mps / scale.error_mps,
        given.distance_m / scale.distance_m,
    )
    return xp.clip(xp.stack([xp.asarray(part, np.float32) for part in parts]), -scale.most, scale.most)


Memory = Any
Namespace = Any
TrackingController = Callable[[Any, TrackingView], tuple[Any, Any]]
"""A controller: its memory and what it is given, to a command and its next memory."""
JERK_WINDOW_S = 2.0


class TrackRecord(NamedTuple):
    """Record of the tracking of a reference, one row per control period. Shape (N,) each.

    Attributes:
        time_s: Start of the period.
        reference_mps: Speed of the reference.
        speed_mps: Speed.
        position_m: Position.
        error_mps: Speed of the reference less speed.
        distance_m: Position of the reference less position.
        command: Command given.
        acceleration_mps2: Acceleration held over the period.
        traction_j: Traction work up to the end of the period.
        counted: True for periods before the end of the reference or in motion; only these count.
    """

    time_s: Array
    reference_mps: Array
    speed_mps: Array
    position_m: Array
    error_mps: Array
    distance_m: Array
    command: Array
    acceleration_mps2: Array
    traction_j: Array
    counted: Array


class TrackingKpis(NamedTuple):
    """The columns of Cheng23's tables 1, 3 and 4.

    Attributes:
        speed_total_mps: Sum of the size of the speed error over the control periods (0.2 s in the paper).
        speed_max_mps: Largest speed error.
        position_total_m: Sum of the size of the position error over the control periods.
        position_max_m: Largest position error.
        parking_m: Distance from the stop at the end.
        energy_kwh: Traction work at the wheel.
        jerk_mps3: Largest change of acceleration within 2 s, over 2 s.
        periods: Control periods counted.
        end_mps: Speed left at the end, 0 for a stand.
    """

    speed_total_mps: Array
    speed_max_mps: Array
    position_total_m: Array
    position_max_m: Array
    parking_m: Array
    energy_kwh: Array
    jerk_mps3: Array
    periods: Array
    end_mps: Array


def track_course(course: ReferenceCourse, control: TrackingController, memory: Memory) -> TrackRecord:
    """Let a controller track a course, in NumPy float64.

    Args:
        course: Reference, track and plant.
        control: The controller.
        memory: Its memory at the start.
    """
    state, rows = start_tracking(), []
    for _ in range(course.periods):
        state, memory, row = _period(course, control, state, memory)
        rows.append(row)
    return TrackRecord(*(np.asarray(column, np.float64) for column in zip(*rows, strict=True)))


def track_compiled(course: ReferenceCourse, control: TrackingController, memory: Memory) -> TrackRecord:
    """The same as one compiled scan; the course is of :func:`compile_course`."""
    import jax

    def one(carry: tuple[TrackState, Any], _: None) -> tuple[tuple[TrackState, Any], TrackRecord]:
        state, held, row = _period(course, control, *carry)
        return (state, held), row

    return jax.lax.scan(one, (start_compiled(), memory), None, length=course.periods)[1]


def _period(
    course: ReferenceCourse, control: TrackingController, state: TrackState, memory: Memory
) -> tuple[TrackState, Memory, TrackRecord]:
    given = tracking_view(course, state)
    command, memory = control(memory, given)
    after = advance_tracking(course, state, command, state.errors)
    row = TrackRecord(
        time_s=state.period.astype(course.dt.dtype) * course.dt,
        reference_mps=given.reference_mps,
        speed_mps=given.speed_mps,
        position_m=state.plant.position_m,
        error_mps=given.error_mps,
        distance_m=given.distance_m,
        command=command,
        acceleration_mps2=after.plant.acceleration_mps2,
        traction_j=after.plant.traction_j,
        counted=(state.period <= course.end) | (given.speed_mps > 0),
    )
    return after, memory, row


def tracking_kpis(
    course: ReferenceCourse, record: TrackRecord, xp: Namespace = np, dt: float | None = None
) -> TrackingKpis:
    """The columns of a table, in NumPy or (``xp=jax.numpy``) compiled.

    The jerk is the largest change of acceleration between two moments at most 2 s apart, divided by 2 s:
    "the maximum acceleration rate over the time span of 2s" in m/s^3 (Cheng23, text on Table 1).

    Args:
        course: Course that was driven.
        record: Its drive.
        xp: Array namespace.
        dt: Control period, s; None: that of the course, which must then be a number while compiling.
    """
    counted = xp.asarray(record.counted, bool)
    error, distance = (xp.where(counted, xp.abs(x), 0.0) for x in (record.error_mps, record.distance_m))
    window = round(JERK_WINDOW_S / (float(course.dt) if dt is None else dt))
    accel = record.acceleration_mps2
    changes = [xp.max(xp.abs(accel[k:] - accel[:-k])) for k in range(1, window + 1)]
    return TrackingKpis(
        speed_total_mps=xp.sum(error),
        speed_max_mps=xp.max(error),
        position_total_m=xp.sum(distance),
        position_max_m=xp.max(distance),
        parking_m=xp.abs(course.track.length_m - record.position_m[-1]),
        energy_kwh=record.traction_j[-1] / J_PER_KWH,
        jerk_mps3=xp.max(xp.stack(changes)) / JERK_WINDOW_S,
        periods=xp.sum(counted),
        end_mps=record.speed_mps[-1],
    )


def tracking_score(kpis: TrackingKpis) -> Array:
    """One number for tuning and for keeping the best policy; higher is better, 0 is perfect.

    Total errors in speed and (by a fifth) position, the largest speed error, parking, jerk; a speed left at
    the end is penalised. The weights are our choice.
    """
    return -(
        kpis.speed_total_mps
        + kpis.position_total_m / 5.0
        + 5.0 * kpis.speed_max_mps
        + 20.0 * kpis.parking_m
        + 2.0 * kpis.jerk_mps3
        + 20.0 * kpis.end_mps
    )

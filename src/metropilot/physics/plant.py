"""The plant: one step of one trainset. Batch it with ``jax.vmap``; run it alone in NumPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple, no_type_check

import numpy as np

from metropilot._typing import Array, Flag, Float, Scalar
from metropilot.physics.arrays import namespace
from metropilot.physics.forces import Effort, effort_at, resistance_and_gradient, step_energy
from metropilot.physics.types import Forces, State, Track, Vehicle

Acceleration = Callable[[Scalar, Scalar], Scalar]
Integrator = Callable[[Acceleration, Scalar, Scalar, Scalar], tuple[Scalar, Scalar]]


def euler(acceleration: Acceleration, x: Scalar, v: Scalar, dt: Scalar) -> tuple[Scalar, Scalar]:
    """Explicit Euler, order 1."""
    return v * dt, v + acceleration(x, v) * dt


def hold_acceleration(acceleration: Acceleration, x: Scalar, v: Scalar, dt: Scalar) -> tuple[Scalar, Scalar]:
    """Constant acceleration over the step, order 1, exact where it is constant (Chen23a eq. 15)."""
    after = v + acceleration(x, v) * dt
    return 0.5 * (v + after) * dt, after


def heun(acceleration: Acceleration, x: Scalar, v: Scalar, dt: Scalar) -> tuple[Scalar, Scalar]:
    """Heun's method, order 2."""
    a0 = acceleration(x, v)
    v1 = v + a0 * dt
    a1 = acceleration(x + v * dt, v1)
    return 0.5 * (v + v1) * dt, v + 0.5 * (a0 + a1) * dt


def rk4(acceleration: Acceleration, x: Scalar, v: Scalar, dt: Scalar) -> tuple[Scalar, Scalar]:
    """The classical Runge-Kutta method, order 4."""
    h = 0.5 * dt
    a0 = acceleration(x, v)
    v1 = v + h * a0
    a1 = acceleration(x + h * v, v1)
    v2 = v + h * a1
    a2 = acceleration(x + h * v1, v2)
    v3 = v + dt * a2
    a3 = acceleration(x + dt * v2, v3)
    return dt * (v + 2 * v1 + 2 * v2 + v3) / 6, v + dt * (a0 + 2 * a1 + 2 * a2 + a3) / 6


INTEGRATORS: Mapping[str, Integrator] = MappingProxyType(
    {"euler": euler, "held": hold_acceleration, "heun": heun, "rk4": rk4}
)


class Command(NamedTuple):
    """Command that reaches the trainset, with protection's emergency brake.

    Attributes:
        share: Command in [-1, 1].
        emergency: True cuts traction and applies the emergency brake, whatever ``share`` says.
    """

    share: Scalar
    emergency: Flag = False


def at_rest(
    vehicle: Vehicle,
    *,
    delay_steps: int = 0,
    position_m: float = 0.0,
    speed_mps: float = 0.0,
) -> State:
    """A state with nothing on its way through the actuation (NumPy; move it to JAX with ``jnp.asarray``).

    Args:
        vehicle: The trainset (only its number type matters).
        delay_steps: Steps of dead time the pipeline must hold; see :func:`delay_steps`.
        position_m: Position of the head.
        speed_mps: Speed.
    """
    dtype = np.asarray(vehicle.mass_kg).dtype
    zero = dtype.type(0.0)
    return State(
        time_s=zero,
        position_m=dtype.type(position_m),
        speed_mps=dtype.type(speed_mps),
        acceleration_mps2=zero,
        share=zero,
        pipeline=np.zeros(delay_steps + 1, dtype),
        emergency_s=zero,
        forces=Forces(zero, zero, zero, zero, zero),
        traction_j=zero,
        electric_brake_j=zero,
        line_j=zero,
        recovered_j=zero,
    )


def delay_steps(delay_s: float, dt: float) -> int:
    """Slots a pipeline needs beyond the newest for a dead time (a shape: decide it outside ``jit``)."""
    # 0.14 / 0.02 is a little more than 7: without the margin a whole number of periods takes a slot more.
    return int(np.ceil(delay_s / dt - 1e-9)) if delay_s > 0 else 0


@no_type_check
def blend_delay(pipeline: Float[Array, "slots *rows"], delay_s: Scalar, dt: Scalar) -> Scalar:
    """The command that acts during this step: the one issued ``delay_s`` ago, blended between two periods."""
    if pipeline.shape[0] == 1:
        return pipeline[0]
    xp = namespace(pipeline, delay_s)
    # Hat functions over the ages: an interpolation without an index that a batch would have to gather.
    age = namespace(delay_s, dt).clip(delay_s / dt, 0.0, pipeline.shape[0] - 1.0)
    weights = xp.maximum(1.0 - xp.abs(xp.arange(pipeline.shape[0], dtype=pipeline.dtype) - age), 0.0)
    return xp.sum(weights * pipeline)


@no_type_check
def push_command(pipeline: Float[Array, "slots *rows"], newest: Scalar) -> Float[Array, "slots *rows"]:
    """The pipeline one period later, the oldest command gone."""
    xp = namespace(pipeline, newest)
    if xp is np:
        # on the host this is a tenth of the time of stacking two arrays
        pushed = np.empty_like(pipeline)
        pushed[0], pushed[1:] = newest, pipeline[:-1]
        return pushed
    first = xp.expand_dims(xp.asarray(newest, dtype=pipeline.dtype), 0)
    return xp.concatenate([first, pipeline[:-1]]) if pipeline.shape[0] > 1 else first


@no_type_check
def kept_share(lag_s: Scalar, dt: Scalar) -> Scalar:
    """Share of the old effort that remains after a period of a lag; 0 without a lag."""
    xp = namespace(lag_s, dt)
    return xp.where(lag_s > 0, xp.exp(-dt / xp.maximum(lag_s, 1e-6)), 0.0)


def actuate(
    vehicle: Vehicle, state: State, command: Command, dt: Scalar
) -> tuple[Float[Array, "slots *rows"], Scalar]:
    """Dead time and lag (Huang25 eq. 4 with K = 1): the new pipeline and the share after both."""
    xp = namespace(state.position_m, command.share)
    share = xp.clip(command.share, -1.0, 1.0)
    pipeline = push_command(state.pipeline, share)
    target = blend_delay(pipeline, vehicle.delay_s, dt)
    return pipeline, target + (state.share - target) * kept_share(vehicle.lag_s, dt)


def wheel_force(
    vehicle: Vehicle,
    acceleration_mps2: Scalar,
    effort: Effort,
    share: Scalar,
    emergency: Flag,
    resisting_n: Scalar,
    dt: Scalar,
    most_brake_n: Scalar | None = None,
) -> Scalar:
    """Signed wheel force of this step: the effort asked for, reached no faster than the jerk limit allows.

    Args:
        vehicle: The trainset.
        acceleration_mps2: Acceleration of the step before.
        effort: Forces available at this speed.
        share: Command after dead time and lag.
        emergency: True for the emergency brake.
        resisting_n: Resistance and gradient.
        dt: Control period, s.
        most_brake_n: Largest force of a brake that is controlled to a deceleration; None: it is not.
    """
    xp = namespace(acceleration_mps2, share)
    asked, strongest_n = effort.force_n(share), effort.brake_n
    if most_brake_n is not None:
        asked, strongest_n = xp.maximum(asked, -most_brake_n), xp.minimum(strongest_n, most_brake_n)
    # Of the two brakes the stronger one acts: an emergency never takes back what the service brake gives,
    # and the service brake, where it asks for more, never delays what the emergency brake gives.
    guaranteed = (-vehicle.emergency_n - resisting_n) / vehicle.effective_mass_kg
    built = xp.maximum(guaranteed, acceleration_mps2 - vehicle.emergency_jerk_mps3 * dt)
    most = xp.where(emergency, built, float("inf"))
    emergency = emergency & (asked >= -vehicle.emergency_n)
    wanted = xp.where(emergency, -vehicle.emergency_n, asked)
    jerk = xp.where(emergency, vehicle.emergency_jerk_mps3, vehicle.jerk_mps3)
    target = (wanted - resisting_n) / vehicle.effective_mass_kg
    room = jerk * dt
    accel = xp.minimum(xp.clip(target, acceleration_mps2 - room, acceleration_mps2 + room), most)
    force = accel * vehicle.effective_mass_kg + resisting_n
    floor = xp.where(emergency, vehicle.emergency_n, strongest_n)
    return xp.clip(force, -floor, effort.traction_n)


def stays_at_rest(speed_mps: Scalar, acceleration_mps2: Scalar, share: Scalar) -> Flag:
    """True if a holding brake keeps a trainset at rest: no traction is asked for, or it is too weak."""
    return (speed_mps <= 0) & ((acceleration_mps2 <= 0) | (share <= 0))


def split(effort: Effort, force_n: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Traction, electric and friction share of a signed wheel force: electric first, friction the rest."""
    xp = namespace(force_n)
    braking = xp.maximum(-force_n, 0.0)
    electric = xp.minimum(braking, effort.electric_n)
    return xp.maximum(force_n, 0.0), electric, braking - electric


def step(
    vehicle: Vehicle,
    track: Track,
    state: State,
    command: Command,
    dt: Scalar,
    integrator: str = "held",
    most_brake_n: Scalar | None = None,
) -> State:
    """One control period of the plant.

    The wheel force is decided at the start of the period and held. A trainset that comes to a stand inside
    the period stops there exactly (time advances only to that moment), and a holding brake keeps it there,
    on any gradient, until traction is asked for and exceeds what holds it back.

    Args:
        vehicle: The trainset.
        track: The section.
        state: State at the start of the period.
        command: Command given at the start of the period.
        dt: Control period, s.
        integrator: A key of ``INTEGRATORS``.
        most_brake_n: Largest force of a brake that is controlled (:func:`control_brakes`); None: it is not.

    Returns:
        The state at the end of the period, or at the stop.
    """
    xp = namespace(state.position_m, command.share)
    x, v = state.position_m, state.speed_mps
    pipeline, share = actuate(vehicle, state, command, dt)
    resistance, gradient = resistance_and_gradient(vehicle, track, x, v)
    effort = effort_at(vehicle, v)
    # The clock is a sum of periods and rounded; a thousandth of one decides in favour of the brake.
    emergency = command.emergency & (state.emergency_s >= vehicle.emergency_delay_s - 1e-3 * dt)
    resisting = resistance + gradient
    before = state.acceleration_mps2
    force = wheel_force(vehicle, before, effort, share, emergency, resisting, dt, most_brake_n)
    accel = (force - resistance - gradient) / vehicle.effective_mass_kg

    @no_type_check
    def acceleration(at: Scalar, speed: Scalar) -> Scalar:
        # Most integrators begin with the force balance already at hand.
        if at is x and speed is v:
            return accel
        r, g = resistance_and_gradient(vehicle, track, at, speed)
        return (force - r - g) / vehicle.effective_mass_kg

    moved, after = INTEGRATORS[integrator](acceleration, x, v, dt)
    mean = (after - v) / dt
    stops = after < 0
    # The exact stop: constant deceleration takes ``v / -mean``, and ``v / 2`` times that is the distance.
    stop_s = xp.where(stops, v / xp.maximum(-mean, 1e-9), dt)
    held_still = stays_at_rest(v, accel, share)
    duration = xp.where(held_still, dt, xp.where(stops, stop_s, dt))
    zero = xp.zeros_like(v)
    moved = xp.where(held_still, zero, xp.where(stops, 0.5 * v * stop_s, moved))
    after = xp.where(held_still | stops, zero, after)

    traction, electric, friction = split(effort, force)
    forces = Forces(
        xp.where(held_still, zero, traction),
        xp.where(held_still, zero, electric),
        xp.where(held_still, -gradient, friction),
        xp.where(held_still, zero, resistance),
        gradient,
    )
    work, braked, line, recovered = step_energy(vehicle, forces, 0.5 * (v + after), moved, duration)
    return State(
        time_s=state.time_s + duration,
        position_m=x + moved,
        speed_mps=after,
        acceleration_mps2=xp.where(held_still, zero, accel),
        share=share,
        pipeline=pipeline,
        emergency_s=xp.where(command.emergency, state.emergency_s + dt, zero),
        forces=forces,
        traction_j=state.traction_j + work,
        electric_brake_j=state.electric_brake_j + braked,
        line_j=state.line_j + line,
        recovered_j=state.recovered_j + recovered,
    )


def control_brakes(vehicle: Vehicle, track: Track, state: State, most_mps2: Scalar) -> tuple[Vehicle, Scalar]:
    """Trainset for the coming period, and the largest force of its brakes, controlled to a deceleration.

    The emergency brake asks for what gradient and resistance leave of the rate, as far as its own force and
    the adhesion reach. The service brake gives what was asked for, and no more than that. Trainsets that run
    close behind each other need it: with the same brake force, a few permille of difference between their
    gradients part their stopping points by many metres. The control acts at the brake, behind dead time and
    lag: a command that leads a lag passes it.

    Args:
        vehicle: The trainset.
        track: The section.
        state: State at the start of the period.
        most_mps2: Total deceleration, gradient and resistance included; infinite leaves the brakes alone.
    """
    xp = namespace(state.position_m, most_mps2)
    resistance, gradient = resistance_and_gradient(vehicle, track, state.position_m, state.speed_mps)
    most_n = xp.maximum(most_mps2 * vehicle.effective_mass_kg - (resistance + gradient), 0.0)
    reach = xp.minimum(vehicle.emergency_n, vehicle.adhesion_n)
    return vehicle._replace(emergency_n=xp.minimum(most_n, reach)), most_n

"""Types of the plant: plain tuples of arrays, the same in NumPy and JAX (a NamedTuple is a pytree)."""

from __future__ import annotations

from typing import NamedTuple

from metropilot._typing import Array, Float, Scalar


class Vehicle(NamedTuple):
    """One trainset with its load, as numbers. Fields are 0-d unless a shape is given.

    Attributes:
        mass_kg: Mass.
        effective_mass_kg: Mass with the rotating share.
        length_m: Length over which gradients act.
        davis_n: Constant, linear and quadratic resistance, N, N/(m/s), N/(m/s)^2. Shape (3,).
        gravity_mps2: Standard gravity.
        traction_from_mps: Start of each piece of the traction curve. Shape (P,).
        traction: ``power, c0, c1, c2, c3, cap`` of each piece. Shape (P, 6).
        brake_from_mps: The same for the electric brake. Shape (P,).
        brake: The same for the electric brake. Shape (P, 6).
        friction_n: Friction braking force available.
        service_n: Braking force command -1 asks for where there is enough (infinite: all there is).
        emergency_n: Force of the emergency brake.
        adhesion_n: Largest wheel force.
        max_acceleration_mps2: Largest acceleration in service.
        max_deceleration_mps2: Largest deceleration in service.
        max_speed_mps: Design speed.
        delay_s: Dead time of the actuation.
        lag_s: Time constant of the actuation.
        jerk_mps3: Limit on the change of acceleration in service.
        emergency_jerk_mps3: The same under emergency braking, build-up included.
        emergency_delay_s: Dead time of the emergency brake: it acts from the first control period that begins
            this long after it was demanded.
        efficiency_speed_mps: Speeds of the efficiency maps. Shape (S,).
        efficiency_share: Effort shares of the efficiency maps. Shape (E,).
        efficiency_traction: Wheel over line power. Shape (S, E).
        efficiency_braking: Line over wheel power. Shape (S, E).
        receptivity: Share of the recovered power the line takes.
        auxiliary_w: Auxiliary power.
    """

    mass_kg: Scalar
    effective_mass_kg: Scalar
    length_m: Scalar
    davis_n: Float[Array, "3"]
    gravity_mps2: Scalar
    traction_from_mps: Float[Array, " pieces"]
    traction: Float[Array, "pieces 6"]
    brake_from_mps: Float[Array, " pieces"]
    brake: Float[Array, "pieces 6"]
    friction_n: Scalar
    service_n: Scalar
    emergency_n: Scalar
    adhesion_n: Scalar
    max_acceleration_mps2: Scalar
    max_deceleration_mps2: Scalar
    max_speed_mps: Scalar
    delay_s: Scalar
    lag_s: Scalar
    jerk_mps3: Scalar
    emergency_jerk_mps3: Scalar
    emergency_delay_s: Scalar
    efficiency_speed_mps: Float[Array, " speeds"]
    efficiency_share: Float[Array, " shares"]
    efficiency_traction: Float[Array, "speeds shares"]
    efficiency_braking: Float[Array, "speeds shares"]
    receptivity: Scalar
    auxiliary_w: Scalar


class Track(NamedTuple):
    """One section as a trainset feels it, padded with infinite breaks.

    Attributes:
        length_m: Distance from the origin to the stopping point. 0-d.
        node_m: Positions where a slope changes. Shape (K,).
        potential: Altitude (m), curve work (N m/kg) and tunnel coefficient integral (N/(m/s)^2 m) at each
            node; each is linear in between. Shape (K, 3).
        slope: Their derivatives after each node. Shape (K, 3).
        limit_from_m: Start of each piece of the most restrictive speed profile. Shape (M,).
        limit_mps: Speed limit of the trainset's head, held until the tail has cleared. Shape (M,).
    """

    length_m: Scalar
    node_m: Float[Array, " breaks"]
    potential: Float[Array, "breaks 3"]
    slope: Float[Array, "breaks 3"]
    limit_from_m: Float[Array, " limits"]
    limit_mps: Float[Array, " limits"]


class Forces(NamedTuple):
    """Forces held over one step, N; ``effective_mass * acceleration`` is their balance.

    Attributes:
        traction_n: Traction at the wheel.
        electric_brake_n: Electric braking force (recoverable).
        friction_brake_n: Friction braking force; at standstill whatever holds the trainset.
        resistance_n: Davis, curve and tunnel resistance.
        gradient_n: Gradient force, positive uphill.
    """

    traction_n: Scalar
    electric_brake_n: Scalar
    friction_brake_n: Scalar
    resistance_n: Scalar
    gradient_n: Scalar


class State(NamedTuple):
    """Motion, actuation and energy of a trainset at one moment.

    Attributes:
        time_s: Time since departure.
        position_m: Head of the trainset from the section's origin.
        speed_mps: Speed, never negative.
        acceleration_mps2: Acceleration held over the last step.
        share: Command after delay and lag.
        pipeline: Commands on their way through the dead time, newest first. Shape (D,).
        emergency_s: Time for which the emergency brake has been demanded without a break.
        forces: Forces held over the last step.
        traction_j: Mechanical traction energy at the wheel.
        electric_brake_j: Energy taken by the electric brake at the wheel.
        line_j: Net energy at the line: traction over efficiency, auxiliaries, minus recovered.
        recovered_j: Energy given back to the line.
    """

    time_s: Scalar
    position_m: Scalar
    speed_mps: Scalar
    acceleration_mps2: Scalar
    share: Scalar
    pipeline: Float[Array, " slots"]
    emergency_s: Scalar
    forces: Forces
    traction_j: Scalar
    electric_brake_j: Scalar
    line_j: Scalar
    recovered_j: Scalar

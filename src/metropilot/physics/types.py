"""What the plant is made of: plain tuples of arrays, the same in NumPy and JAX (a NamedTuple is a pytree)."""

from __future__ import annotations

from typing import Any, NamedTuple

Array = Any


class Vehicle(NamedTuple):
    """One trainset with its load, as numbers. Fields are 0-d unless a shape is given.

    Attributes:
        mass_kg: Mass.
        effective_mass_kg: Mass with the rotating share.
        length_m: Length over which gradients act.
        davis_n: Constant, linear and quadratic resistance, N, N/(m/s), N/(m/s)^2. Shape (3,).
        gravity_mps2: Standard gravity.
        traction_from_mps: Where each piece of the traction curve begins. Shape (P,).
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

    mass_kg: Array
    effective_mass_kg: Array
    length_m: Array
    davis_n: Array
    gravity_mps2: Array
    traction_from_mps: Array
    traction: Array
    brake_from_mps: Array
    brake: Array
    friction_n: Array
    service_n: Array
    emergency_n: Array
    adhesion_n: Array
    max_acceleration_mps2: Array
    max_deceleration_mps2: Array
    max_speed_mps: Array
    delay_s: Array
    lag_s: Array
    jerk_mps3: Array
    emergency_jerk_mps3: Array
    emergency_delay_s: Array
    efficiency_speed_mps: Array
    efficiency_share: Array
    efficiency_traction: Array
    efficiency_braking: Array
    receptivity: Array
    auxiliary_w: Array


class Track(NamedTuple):
    """One section as a trainset feels it, padded with infinite breaks.

    Attributes:
        length_m: Distance from the origin to the stopping point. 0-d.
        node_m: Where a slope changes. Shape (K,).
        potential: Altitude (m), curve work (N m/kg) and tunnel coefficient integral (N/(m/s)^2 m) at each
            node; each is linear in between. Shape (K, 3).
        slope: Their derivatives after each node. Shape (K, 3).
        limit_from_m: Where each piece of the most restrictive speed profile begins. Shape (M,).
        limit_mps: Speed limit of the trainset's head, held until the tail has cleared. Shape (M,).
    """

    length_m: Array
    node_m: Array
    potential: Array
    slope: Array
    limit_from_m: Array
    limit_mps: Array


class Forces(NamedTuple):
    """Forces held over one step, N; ``effective_mass * acceleration`` is their balance.

    Attributes:
        traction_n: Traction at the wheel.
        electric_brake_n: Electric braking force (recoverable).
        friction_brake_n: Friction braking force; at standstill whatever holds the trainset.
        resistance_n: Davis, curve and tunnel resistance.
        gradient_n: Gradient force, positive uphill.
    """

    traction_n: Array
    electric_brake_n: Array
    friction_brake_n: Array
    resistance_n: Array
    gradient_n: Array


class State(NamedTuple):
    """Where a trainset is, what it does, and what it has used.

    Attributes:
        time_s: Time since departure.
        position_m: Head of the trainset from the section's origin.
        speed_mps: Speed, never negative.
        acceleration_mps2: Acceleration held over the last step.
        share: Command after delay and lag.
        pipeline: Commands on their way through the dead time, newest first. Shape (D,).
        emergency_s: How long the emergency brake has been demanded without a break.
        forces: Forces held over the last step.
        traction_j: Mechanical traction energy at the wheel.
        electric_brake_j: Energy taken by the electric brake at the wheel.
        line_j: Net energy at the line: traction over efficiency, auxiliaries, minus recovered.
        recovered_j: Energy given back to the line.
    """

    time_s: Array
    position_m: Array
    speed_mps: Array
    acceleration_mps2: Array
    share: Array
    pipeline: Array
    emergency_s: Array
    forces: Forces
    traction_j: Array
    electric_brake_j: Array
    line_j: Array
    recovered_j: Array

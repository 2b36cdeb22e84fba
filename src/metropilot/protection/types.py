"""Types of protection: plain tuples of arrays, the same in NumPy and JAX."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from metropilot._typing import Array, Flag, Float, Index, Int, Scalar
from metropilot.physics import Vehicle


class Rates(NamedTuple):
    """Assumptions about one brake and the plant until it acts. All 0-d.

    Attributes:
        reaction_s: From a command let pass to the brake decided one period later acting.
        brake_mps2: Braking rate on level track.
        jerk_mps3: Rate at which it builds up (a large finite number where it is immediate).
        mass_low: Smallest mass factor.
        mass_high: Largest mass factor.
        resistance_low: Smallest resistance factor.
        service_share: Smallest share of the nominal service brake.
        speed_error_mps: Largest error of the measured speed.
    """

    reaction_s: Scalar
    brake_mps2: Scalar
    jerk_mps3: Scalar
    mass_low: Scalar
    mass_high: Scalar
    resistance_low: Scalar
    service_share: Scalar
    speed_error_mps: Scalar


class Fading(NamedTuple):
    """Slowest fading of an effort let pass. All 0-d.

    Attributes:
        share: Share of a command's effect left after one period, at the longest lag.
        acceleration_mps2: Least fall of an acceleration in one period (infinite: at once).
        nominal: 1 where the service brake is asked for by the acceleration that the nominal trainset keeps,
            as that of the lightest one leaves climbs out; else 0.
    """

    share: Scalar
    acceleration_mps2: Scalar
    nominal: Scalar


class Protection(NamedTuple):
    """One section as protection sees it: curves on a uniform grid, padded with zero speed.

    Energies are ``v^2/2`` per kilogram, so that a constant acceleration is a straight line over distance.

    Attributes:
        vehicle: The nominal trainset.
        rates: The emergency brake and the declared bounds: what the guarantee rests on.
        service_rates: The service brake of the nominal plant: what spares the emergency brake.
        fading: Fading of an effort.
        authority_m: End of the movement authority; whoever is beyond it is braked. Infinite: none. 0-d.
        start_m: Position of the first node. 0-d.
        spacing_m: Distance between nodes. 0-d.
        emergency: Emergency braking curve: from anywhere under it the guaranteed brake alone keeps the limit
            for ever; straight between nodes, m^2/s^2. Shape (N,).
        service: Service braking curve: from under it the nominal service brake keeps the permitted speed,
            with a little more where that is level, m^2/s^2. Shape (N,).
        pull_mps2: Largest acceleration that gradient, less certain curve resistance, can give from shortly
            before a node to the end of the look-ahead. Shape (N,).
        usual_pull_mps2: The same less all curve resistance, over the service brake's reaction. Shape (N,).
        permitted_mps: Permitted speed: whoever holds a speed at or under it is not overruled. Shape (N,).
        ahead: Number of each node of the look-ahead, from the last one passed. Shape (W,).
        slots: Commands that may still be on their way, newest first; only the shape counts. Shape (D,).
    """

    vehicle: Vehicle
    rates: Rates
    service_rates: Rates
    fading: Fading
    authority_m: Scalar
    start_m: Scalar
    spacing_m: Scalar
    emergency: Float[Array, " nodes"]
    service: Float[Array, " nodes"]
    pull_mps2: Float[Array, " nodes"]
    usual_pull_mps2: Float[Array, " nodes"]
    permitted_mps: Float[Array, " nodes"]
    ahead: Int[Array, " ahead"]
    slots: Float[Array, " slots"]


class Memory(NamedTuple):
    """Memory of the supervisor from one period to the next.

    Attributes:
        recent: Commands let pass that may still be on their way, newest first. Shape (D,).
        share: Upper bound on the share in effect after dead time and lag.
        acceleration_mps2: Upper bound on the acceleration over the last period.
        emergency: True while the emergency brake is latched.
        level: Last level: an index into ``LEVELS``.
        interventions: Spells in which the driver was overruled.
        emergencies: Number of them that came to the emergency brake.
        invalid: Commands that were not finite or out of range.
    """

    recent: Float[Array, " slots"]
    share: Scalar
    acceleration_mps2: Scalar
    emergency: Flag
    level: Index
    interventions: Index
    emergencies: Index
    invalid: Index


class Verdict(NamedTuple):
    """Verdict of protection on one command.

    Attributes:
        level: Level of intervention: an index into ``LEVELS``.
        permitted_mps: Permitted speed at the measured position.
        emergency_mps: Speed of the emergency braking curve there.
        valid: True if the driver's command was a number in [-1, 1].
    """

    level: Index
    permitted_mps: Scalar
    emergency_mps: Scalar
    valid: Flag


LEVELS = ("none", "traction cut-off", "service brake", "emergency brake")
"""Interventions on a command, the least first; ``Verdict.level`` is an index."""


def at_start(protection: Protection, *, share: float = 0.0, acceleration_mps2: float = 0.0) -> Memory:
    """The supervisor's memory at departure, or in a run already under way (NumPy constants, also in JAX).

    Args:
        protection: Protection of the section (only its number type and shapes matter).
        share: No command that may still act is above this.
        acceleration_mps2: The present acceleration is not above this.
    """
    dtype = protection.spacing_m.dtype.type
    none = np.int32(0)
    return Memory(
        recent=np.full(protection.slots.shape, share, dtype),
        share=dtype(share),
        acceleration_mps2=dtype(acceleration_mps2),
        emergency=np.bool_(False),
        level=none,
        interventions=none,
        emergencies=none,
        invalid=none,
    )

"""A trainset as vehicles joined by springs and dampers, over the same array namespace.

Vehicle i of n obeys ``m_i dv_i/dt = lambda_i F + T_i-1 - T_i - r_i(v_i) - c_i(x_i) - g_i(x_i)``, where
``T_j`` is the tension of coupler j (spring and damper) behind vehicle j, and every vehicle meets the Davis,
curve, tunnel and gradient forces of its own place over its own length. Source: Huang25 eq. 3 and section 2.1;
``lambda`` is its distribution constant. With stiff couplers it becomes the plant's single mass with its
length-averaged gradient.

Integrator: implicit midpoint in the couplers (a tridiagonal system, solved directly), outer forces held at
the start of the substep. It is stable for any stiffness and damping, conserves momentum always and, without
damping and outer forces, energy. :func:`substeps` gives the number that also resolves the fastest coupler
oscillation. Brakes and resistance oppose the motion: where they could stop a vehicle within the substep, they
take exactly its speed and no more, so that they hold it and never push it back.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from metropilot._typing import Array, Float, Scalar
from metropilot.errors import InputError
from metropilot.physics.arrays import namespace
from metropilot.physics.build import vehicle_arrays
from metropilot.physics.forces import resistance_and_gradient
from metropilot.physics.types import Track, Vehicle
from metropilot.railway import Trainset


class Consist(NamedTuple):
    """The vehicles of a trainset and what joins them, numbered from the head.

    Attributes:
        vehicles: The plant's numbers, but mass, effective mass and length of shape (n,), Davis of shape (3,
            n).
        traction_share: Share of the traction force on each vehicle, sum 1. Shape (n,).
        brake_share: Share of the braking force on each vehicle, sum 1. Shape (n,).
        stiffness_n_per_m: Spring rate of each coupler. Shape (n-1,).
        damping_n_s_per_m: Damping of each coupler. Shape (n-1,).
    """

    vehicles: Vehicle
    traction_share: Float[Array, " vehicles"]
    brake_share: Float[Array, " vehicles"]
    stiffness_n_per_m: Float[Array, " couplers"]
    damping_n_s_per_m: Float[Array, " couplers"]


class Bodies(NamedTuple):
    """Positions and speeds of the vehicles of a trainset.

    Attributes:
        position_m: Head of the first vehicle from the section's origin. 0-d.
        extension_m: Extension of each coupler from its length at rest. Shape (n-1,).
        speed_mps: Speed of each vehicle. Shape (n,).
        coupler_n: Tension of each coupler, mean over the last substep; negative pushes. Shape (n-1,).
    """

    position_m: Scalar
    extension_m: Float[Array, " couplers"]
    speed_mps: Float[Array, " vehicles"]
    coupler_n: Float[Array, " couplers"]


def consist(trainset: Trainset, *, motors: Sequence[int] | None = None) -> Consist:
    """The trainset cut into equal vehicles as its couplers say.

    Args:
        trainset: Trainset with its load; mass, length and Davis resistance are shared evenly.
        motors: Vehicles that carry the traction, counted from the head; None spreads it over all (as Huang25
            does). Brakes act on every vehicle.

    Raises:
        InputError: A motor car the trainset does not have.
    """
    couplers = trainset.couplers
    count = couplers.vehicles
    motors = range(count) if motors is None else motors
    if not len(motors) or not all(0 <= k < count for k in motors):
        raise InputError("no such vehicle", field="motors", value=list(motors), allowed=f"0 to {count - 1}")
    whole = vehicle_arrays(trainset)
    shares = np.full(count, 1.0 / count)
    traction = np.zeros(count)
    traction[list(motors)] = 1.0 / len(motors)
    vehicles = whole._replace(
        mass_kg=whole.mass_kg * shares,
        effective_mass_kg=whole.effective_mass_kg * shares,
        length_m=whole.length_m * shares,
        davis_n=whole.davis_n[:, None] * shares,
    )
    stiffness = np.full(count - 1, couplers.stiffness_n_per_m)
    damping = np.full(count - 1, couplers.damping_n_s_per_m)
    return Consist(vehicles, traction, shares, stiffness, damping)


def bodies_at(consist: Consist) -> Bodies:
    """All vehicles at rest at the origin, and so the couplers (NumPy)."""
    mass = np.asarray(consist.vehicles.mass_kg)
    loose = np.zeros(mass.size - 1, mass.dtype)
    return Bodies(mass.dtype.type(0.0), loose, np.zeros_like(mass), loose)


def heads_m(consist: Consist, bodies: Bodies) -> Float[Array, " vehicles"]:
    """Position of the head of each vehicle. Shape (n,)."""
    xp = namespace(bodies.speed_mps)
    back = consist.vehicles.length_m[:-1] + bodies.extension_m
    return bodies.position_m - xp.concatenate([xp.zeros_like(bodies.speed_mps[:1]), xp.cumsum(back)])


def centre_of_mass_m(consist: Consist, bodies: Bodies) -> Scalar:
    """Centre of the (effective) mass, counted as the head of the unstretched trainset.

    The plant's single mass has its position there.
    """
    xp = namespace(bodies.speed_mps)
    mass = consist.vehicles.effective_mass_kg
    stretched = xp.cumsum(bodies.extension_m) if bodies.extension_m.shape[0] else bodies.extension_m
    return bodies.position_m - xp.sum(mass[1:] * stretched) / xp.sum(mass)


def substeps(consist: Consist, dt: float) -> int:
    """Substeps that resolve the couplers: at most one radian of the fastest oscillation, or one damping time.

    For equal masses the fastest coupler mode has ``omega = 2 sqrt(k/m)`` and damping rate ``4 c/m``. Fewer
    substeps stay stable and blur only that oscillation. A static number: decide it outside ``jit``.
    """
    mass = float(np.min(consist.vehicles.effective_mass_kg))
    if not np.size(consist.stiffness_n_per_m):
        return max(1, int(np.ceil(dt / 0.1)))
    omega = 2.0 * np.sqrt(float(np.max(consist.stiffness_n_per_m)) / mass)
    rate = 4.0 * float(np.max(consist.damping_n_s_per_m)) / mass
    return max(1, int(np.ceil(dt * max(omega, rate, 10.0))))


def outer_forces_n(
    consist: Consist, track: Track, bodies: Bodies, force_n: Scalar
) -> tuple[Float[Array, " vehicles"], Float[Array, " vehicles"]]:
    """Forces on each vehicle besides its couplers, N.

    Args:
        consist: The trainset.
        track: The section, built for the whole trainset.
        bodies: Positions and speeds of the vehicles.
        force_n: Wheel force of the whole trainset, braking negative.

    Returns:
        Traction less gradient, and braking with resistance, which opposes the motion. Shape (n,) each.
    """
    heads = heads_m(consist, bodies)
    resistance, gradient = resistance_and_gradient(consist.vehicles, track, heads, bodies.speed_mps)
    xp = namespace(bodies.speed_mps)
    driving = xp.maximum(force_n, 0.0) * consist.traction_share
    braking = xp.maximum(-force_n, 0.0) * consist.brake_share
    return driving - gradient, braking + resistance


def multibody_step(
    consist: Consist, track: Track, bodies: Bodies, force_n: Scalar, dt: Scalar, count: int
) -> Bodies:
    """Advance the vehicles by one control period with the wheel force held.

    Args:
        consist: The trainset.
        track: The section.
        bodies: Positions and speeds of the vehicles.
        force_n: Wheel force of the whole trainset after actuation, braking negative (in the plant's terms
            ``traction - electric_brake - friction_brake``).
        dt: Control period, s.
        count: Substeps, see :func:`substeps`.
    """
    h = dt / count
    for _ in range(count):
        bodies = _substep(consist, track, bodies, force_n, h)
    return bodies


def _substep(consist: Consist, track: Track, bodies: Bodies, force_n: Scalar, h: Scalar) -> Bodies:
    """Implicit midpoint: solve for the mean speeds, then extrapolate.

    ``(2 m/h + c_eff L) v_mid = 2 m/h v_0 + F + T_0``, L being the couplers' Laplacian and ``c_eff = c + k
    h/2`` because the mean extension is ``d_0 + h/2 (v_j - v_j+1)``.
    """
    v = bodies.speed_mps
    xp = namespace(v)
    mass = consist.vehicles.effective_mass_kg
    inertia = 2.0 * mass / h
    spring = consist.stiffness_n_per_m * bodies.extension_m
    rate = consist.damping_n_s_per_m + 0.5 * h * consist.stiffness_n_per_m
    none = xp.zeros_like(mass[:1])
    before, behind = xp.concatenate([none, rate]), xp.concatenate([rate, none])
    pull = xp.concatenate([none, spring]) - xp.concatenate([spring, none])
    pushing, opposing = outer_forces_n(consist, track, bodies, force_n)
    driving = pushing + pull
    holding = xp.clip(driving + mass * v / h, -opposing, opposing)
    middle = solve_tridiagonal(-rate, inertia + before + behind, inertia * v + driving - holding)
    opening = middle[:-1] - middle[1:]
    return Bodies(
        position_m=bodies.position_m + h * middle[0],
        extension_m=bodies.extension_m + h * opening,
        speed_mps=2.0 * middle - v,
        coupler_n=spring + rate * opening,
    )


def solve_tridiagonal(
    beside: Float[Array, " couplers"], diagonal: Float[Array, " vehicles"], right: Float[Array, " vehicles"]
) -> Float[Array, " vehicles"]:
    """Solve a symmetric tridiagonal system (Thomas' algorithm, unrolled: a trainset has few vehicles).

    Args:
        beside: Off-diagonal.
        diagonal: Diagonal, dominant.
        right: Right-hand side.
    """
    xp = namespace(diagonal)
    pivots, values = [diagonal[0]], [right[0]]
    for k in range(1, diagonal.shape[0]):
        factor = beside[k - 1] / pivots[-1]
        pivots.append(diagonal[k] - factor * beside[k - 1])
        values.append(right[k] - factor * values[-1])
    solution = [values[-1] / pivots[-1]]
    for k in range(diagonal.shape[0] - 2, -1, -1):
        solution.append((values[k] - beside[k] * solution[-1]) / pivots[k])
    return xp.stack(solution[::-1])

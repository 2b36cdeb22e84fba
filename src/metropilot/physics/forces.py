"""Forces and energy of a trainset at a speed and a place: effort, resistance, gradient, efficiency."""

from __future__ import annotations

from typing import Any, NamedTuple, no_type_check

import numpy as np

from metropilot._typing import Array, Float, Index, Scalar
from metropilot.physics.arrays import locate, namespace, scalars
from metropilot.physics.types import Forces, Track, Vehicle

FEW = 4
"""Up to so many pieces of a curve are chosen from rather than fetched."""


@no_type_check
def curve_n(
    breaks_mps: Float[Array, " pieces"], pieces: Float[Array, "pieces 6"], speed_mps: Scalar
) -> Scalar:
    """Force of a piecewise effort curve, N: ``min(cap, h/v + c0 + c1 v + c2 v^2 + c3 v^3)``, not below 0.

    Args:
        breaks_mps: Start of each piece.
        pieces: ``h, c0, c1, c2, c3, cap`` of each piece.
        speed_mps: Speed.
    """
    k = locate(breaks_mps, speed_mps)
    xp = namespace(speed_mps) if type(k) is int else namespace(pieces, speed_mps)
    # on the host as Python's numbers: a few of them are ten times as fast as NumPy's
    row = pieces[k].tolist() if xp is scalars else (_row(xp, pieces, k, j) for j in range(6))
    power, c0, c1, c2, c3, cap = row
    v = speed_mps
    # A hyperbola has a pole at standstill; there ``cap`` decides, and the division only has to stay finite.
    return xp.clip(power / xp.maximum(v, 1e-3) + c0 + v * (c1 + v * (c2 + v * c3)), 0.0, cap)


@no_type_check
def _row(xp: Any, pieces: Float[Array, "pieces 6"], k: Index, j: int) -> Scalar:
    """``pieces[k, j]``; in a compiled batch by choosing among the few pieces, sooner than by fetching."""
    if not hasattr(xp, "ndarray") or xp.ndim(k) or type(k) is int:
        return pieces[k, j]
    if pieces.shape[0] > FEW:
        # a constant of NumPy cannot be indexed by what is only traced
        return (pieces if xp is np else xp.asarray(pieces))[k, j]
    value = pieces[0, j]
    for piece in range(1, pieces.shape[0]):
        value = xp.where(k >= piece, pieces[piece, j], value)
    return value


class Effort(NamedTuple):
    """Forces available to a trainset at one speed, N.

    Attributes:
        traction_n: Largest traction force.
        electric_n: Largest electric braking force.
        brake_n: Braking force that command -1 asks for.
    """

    traction_n: Scalar
    electric_n: Scalar
    brake_n: Scalar

    def force_n(self, command: Scalar) -> Scalar:
        """Signed wheel force of a command in [-1, 1], traction positive, N (Chen23a eqs. 13 and 14)."""
        xp = namespace(self.traction_n, command)
        return xp.maximum(command, 0.0) * self.traction_n + xp.minimum(command, 0.0) * self.brake_n


def effort_at(vehicle: Vehicle, speed_mps: Scalar) -> Effort:
    """The three forces available at a speed, each curve looked up once."""
    traction = curve_n(vehicle.traction_from_mps, vehicle.traction, speed_mps)
    electric = curve_n(vehicle.brake_from_mps, vehicle.brake, speed_mps)
    return limit_effort(vehicle, traction, electric)


def limit_effort(vehicle: Vehicle, traction_n: Scalar, electric_n: Scalar) -> Effort:
    """The forces available of those that the curves give: friction brake, service rate and adhesion."""
    xp = namespace(vehicle.adhesion_n, traction_n)
    brake = xp.minimum(electric_n + vehicle.friction_n, vehicle.service_n)
    most = vehicle.adhesion_n
    return Effort(xp.minimum(traction_n, most), xp.minimum(electric_n, most), xp.minimum(brake, most))


class BrakingBands(NamedTuple):
    """Least deceleration of full service braking on level track, in equal bands of speed.

    Attributes:
        rates_mps2: From standstill to the top speed.
        per_mps: Bands per m/s.
    """

    rates_mps2: list[float]
    per_mps: float

    def at(self, speed_mps: float) -> float:
        """Rate in the band of a speed, m/s^2; beyond the top speed that of the last band."""
        return self.rates_mps2[min(int(speed_mps * self.per_mps), len(self.rates_mps2) - 1)]


BANDS = 64


def braking_bands(vehicle: Vehicle) -> BrakingBands:
    """Full service braking over speed, for curves that are laid backward: many brakes fade at high speed.

    Args:
        vehicle: Nominal plant (NumPy).
    """
    speeds = np.linspace(0.0, float(vehicle.max_speed_mps), BANDS + 1)
    rates = effort_at(vehicle, speeds).brake_n / float(vehicle.effective_mass_kg)
    return BrakingBands(np.minimum(rates[1:], rates[:-1]).tolist(), BANDS / float(speeds[-1]))


def traction_available_n(vehicle: Vehicle, speed_mps: Scalar) -> Scalar:
    """Largest traction force at a speed, adhesion included, N."""
    return effort_at(vehicle, speed_mps).traction_n


def electric_available_n(vehicle: Vehicle, speed_mps: Scalar) -> Scalar:
    """Largest electric braking force at a speed, adhesion included, N."""
    return effort_at(vehicle, speed_mps).electric_n


def brake_available_n(vehicle: Vehicle, speed_mps: Scalar) -> Scalar:
    """Braking force that command -1 asks for: electric and friction, up to service rate and adhesion, N."""
    return effort_at(vehicle, speed_mps).brake_n


def command_for_effort(effort: Scalar, traction: Scalar, brake: Scalar) -> Scalar:
    """The command in [-1, 1] whose effort is nearest the wanted one.

    Args:
        effort: Wanted effort, traction positive: a force, or an acceleration per mass.
        traction: Largest traction, above 0, in the same unit.
        brake: Largest service brake, above 0, in the same unit.
    """
    xp = namespace(effort, traction)
    return xp.clip(effort / xp.where(effort >= 0, traction, brake), -1.0, 1.0)


def command_for_force(vehicle: Vehicle, speed_mps: Scalar, force_n: Scalar) -> Scalar:
    """The command whose force is nearest the wanted one; inverse of :meth:`Effort.force_n`."""
    xp = namespace(vehicle.adhesion_n, speed_mps, force_n)
    effort = effort_at(vehicle, speed_mps)
    return command_for_effort(force_n, xp.maximum(effort.traction_n, 1.0), xp.maximum(effort.brake_n, 1.0))


def mean_slopes(vehicle: Vehicle, track: Track, position_m: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Mean slope of each potential between tail and head; the slope at the head for a point mass.

    Returns:
        Gradient (1), specific curve resistance (N/kg) and tunnel coefficient (N/(m/s)^2).
    """
    xp = namespace(vehicle.length_m, position_m)
    tail_m = position_m - vehicle.length_m
    head, tail = locate(track.node_m, position_m), locate(track.node_m, tail_m)
    past_head, past_tail = position_m - track.node_m[head], tail_m - track.node_m[tail]
    # ``where`` computes both branches: that of a length must stay finite for a point mass, too.
    per_length = 1.0 / xp.maximum(vehicle.length_m, 1e-6)
    is_point = vehicle.length_m <= 0
    if xp is scalars:
        # as Python's numbers, like the effort curves
        ends = track.potential[head], track.potential[tail], track.slope[head], track.slope[tail]
        rows = zip(*(end.tolist() for end in ends), strict=True)
        return tuple(
            at_head if is_point else (there - here + at_head * past_head - at_tail * past_tail) * per_length
            for there, here, at_head, at_tail in rows
        )

    @no_type_check
    def mean_over_length(j: int) -> Scalar:
        at_head = track.slope[head, j]
        rise = track.potential[head, j] - track.potential[tail, j]
        rise = rise + at_head * past_head - track.slope[tail, j] * past_tail
        return xp.where(is_point, at_head, rise * per_length)

    return mean_over_length(0), mean_over_length(1), mean_over_length(2)


def davis_n(vehicle: Vehicle, speed_mps: Scalar) -> Scalar:
    """Running resistance ``a + b v + c v^2`` on straight open track, N (Davis)."""
    return vehicle.davis_n[0] + speed_mps * (vehicle.davis_n[1] + speed_mps * vehicle.davis_n[2])


def resistance_and_gradient(
    vehicle: Vehicle, track: Track, position_m: Scalar, speed_mps: Scalar
) -> tuple[Scalar, Scalar]:
    """Resistance (Davis, curve, tunnel) and gradient force, N.

    Sources: Huang25 eq. 3 (force balance), Chen23a eqs. 5 and 7. A gradient acts as the difference in
    altitude between head and tail over the length.
    """
    gradient, curve_n_per_kg, tunnel = mean_slopes(vehicle, track, position_m)
    track_n = vehicle.mass_kg * curve_n_per_kg + tunnel * speed_mps * speed_mps
    return davis_n(vehicle, speed_mps) + track_n, vehicle.mass_kg * vehicle.gravity_mps2 * gradient


class EffortLimits(NamedTuple):
    """Resistance and available efforts at a state, per kilogram of effective mass.

    Attributes:
        resistance_mps2: Running, curve and tunnel resistance.
        gradient_mps2: Gradient force, positive uphill.
        drag_mps2: Resistance and gradient.
        traction_mps2: Largest traction.
        brake_mps2: Largest service braking.
    """

    resistance_mps2: Scalar
    gradient_mps2: Scalar
    drag_mps2: Scalar
    traction_mps2: Scalar
    brake_mps2: Scalar

    def command_for(self, acceleration_mps2: Scalar) -> Scalar:
        """The command in [-1, 1] whose acceleration is nearest the wanted one."""
        return command_for_effort(acceleration_mps2 + self.drag_mps2, self.traction_mps2, self.brake_mps2)


def effort_limits(vehicle: Vehicle, track: Track, position_m: Scalar, speed_mps: Scalar) -> EffortLimits:
    """Resistance and available efforts of a trainset at a state."""
    resistance, gradient = resistance_and_gradient(vehicle, track, position_m, speed_mps)
    effort, mass = effort_at(vehicle, speed_mps), vehicle.effective_mass_kg
    xp = namespace(effort.traction_n)
    return EffortLimits(
        resistance / mass,
        gradient / mass,
        (resistance + gradient) / mass,
        # at least 1 N, as commands are efforts divided by these
        xp.maximum(effort.traction_n, 1.0) / mass,
        xp.maximum(effort.brake_n, 1.0) / mass,
    )


@no_type_check
def map_value(
    vehicle: Vehicle, values: Float[Array, "speeds shares"], speed_mps: Scalar, share: Scalar
) -> Scalar:
    """Bilinear value of an efficiency map, held outside its corners."""
    i, a = _bracket(vehicle.efficiency_speed_mps, speed_mps)
    j, b = _bracket(vehicle.efficiency_share, share)
    i1 = min(values.shape[0] - 1, 1) + i
    j1 = min(values.shape[1] - 1, 1) + j
    low = values[i, j] * (1 - b) + values[i, j1] * b
    high = values[i1, j] * (1 - b) + values[i1, j1] * b
    return low * (1 - a) + high * a


@no_type_check
def _bracket(points: Float[Array, " points"], x: Scalar) -> tuple[Index, Scalar]:
    xp = namespace(points, x)
    if points.shape[0] == 1:
        return 0, 0.0 * x
    k = xp.clip(locate(points, x), 0, points.shape[0] - 2)
    return k, xp.clip((x - points[k]) / (points[k + 1] - points[k]), 0.0, 1.0)


def step_energy(
    vehicle: Vehicle, forces: Forces, mean_speed_mps: Scalar, distance_m: Scalar, duration_s: Scalar
) -> tuple[Scalar, Scalar, Scalar, Scalar]:
    """Energy of one step with its forces held (Chen23a eq. 2).

    Returns:
        Wheel traction, electric braking at the wheel, net at the line, recovered at the line; all J.
    """
    traction_j = forces.traction_n * distance_m
    braking_j = forces.electric_brake_n * distance_m
    motoring, braking = efficiencies(vehicle, forces, mean_speed_mps)
    recovered_j = braking_j * braking * vehicle.receptivity
    line_j = traction_j / motoring + vehicle.auxiliary_w * duration_s - recovered_j
    return traction_j, braking_j, line_j, recovered_j


def efficiencies(vehicle: Vehicle, forces: Forces, speed_mps: Scalar) -> tuple[Scalar, Scalar]:
    """Efficiency of traction and of electric braking, at these forces as shares of what there is."""
    if vehicle.efficiency_traction.shape == vehicle.efficiency_braking.shape == (1, 1):
        return vehicle.efficiency_traction[0, 0], vehicle.efficiency_braking[0, 0]
    xp = namespace(forces.traction_n, speed_mps)
    effort = effort_at(vehicle, speed_mps)
    up = forces.traction_n / xp.maximum(effort.traction_n, 1.0)
    down = forces.electric_brake_n / xp.maximum(effort.electric_n, 1.0)
    return (
        map_value(vehicle, vehicle.efficiency_traction, speed_mps, up),
        map_value(vehicle, vehicle.efficiency_braking, speed_mps, down),
    )

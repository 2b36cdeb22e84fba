"""The energy-optimal drive of a trainset that has only notches: a few forces, coasting among them.

The problem is no longer convex, so it is solved by dynamic programming over distance with a price on time
(Lagrange). Three choices keep it exact where a coarse programme overstates energy by 5 to 25 %:

- the speed nodes of each position run from standstill to the curve of limits and last braking, so that the
  frontier of what can still stop is a node and never interpolated with what cannot;
- the value is interpolated in kinetic energy, in which every notch, coasting included, moves the trainset by
  an exact amount over a segment;
- the drive reported is not read off the grid: it is rolled forward in continuous speed with the notch that
  the value function prefers, so its energy and time are those of forces it really has.

Over the last metres the brake is set to whatever ends at the stop (at most the strongest notch): no table of
notches stops at a point.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy import ndarray
from scipy.optimize import brentq

from metropilot._schema import CheckedFields, declare
from metropilot._typing import Float, Int
from metropilot.errors import Infeasible, InputError
from metropilot.physics import track_arrays, vehicle_arrays
from metropilot.planning import STEP_MPS, Mesh, Specific, build_mesh, specific
from metropilot.railway import Section, Trainset

STOP_M = 12.0
"""Nominal length of the last segment, on which the brake is continuous."""
ITERATIONS = 3
HIGHEST_PRICE_WPKG = 1e3
BISECTIONS = 40
CLOSE_S = 2e-3
INFEASIBLE = 1e9
JUMP = 1e-6


@dataclass(frozen=True)
class NotchOptions(CheckedFields):
    """Options of the programme.

    Attributes:
        spacing_m: Largest segment; a notch is held over a segment.
        speeds: Speed nodes at each position.
        brake_weight: Price of braking work over that of traction work; 1 counts both (Lu23 eq. 16).
        most_mps2: Largest acceleration by traction and deceleration by braking, m/s^2; coasting has none.
    """

    spacing_m: float = declare(4.0, low=0.2, high=50.0)
    speeds: int = declare(600, low=20, high=10_000)
    brake_weight: float = declare(0.0, low=0.0, high=10.0)
    most_mps2: float = declare(5.0, low=0.5, high=5.0)


@dataclass(frozen=True)
class NotchPlan:
    """A drive by notches.

    Attributes:
        position_m: Nodes. Shape (N+1,).
        speed_mps: Speed at the nodes. Shape (N+1,).
        time_s: Time since the start at the nodes. Shape (N+1,).
        force_n: Force of the notch held on each segment, braking negative. Shape (N,).
        running_time_s: Total time, at most the time asked for.
        energy_j: Minimised energy: traction work, plus ``brake_weight`` times braking work.
        energy_wheel_j: Traction work.
        energy_effort_j: Traction and braking work (Lu23 eq. 16).
        bound_j: Lower bound of the programme on any such drive in the time asked for: the dual over the price
            of time, exact but for the interpolation of the value.
        second_w: Energy that one more second would save, J/s.
    """

    position_m: Float[ndarray, " nodes"]
    speed_mps: Float[ndarray, " nodes"]
    time_s: Float[ndarray, " nodes"]
    force_n: Float[ndarray, " segments"]
    running_time_s: float
    energy_j: float
    energy_wheel_j: float
    energy_effort_j: float
    bound_j: float
    second_w: float


class Moves(NamedTuple):
    """Every notch from every node, independent of the price of time; all per kg of effective mass.

    Attributes:
        cap: Largest ``v^2/2`` at each position from which everything ahead is still kept. Shape (N,).
        share: Nodes as shares of the square root of the cap. Shape (V,).
        lower: Node below the speed reached. Shape (N-1, V, K).
        way: Share of the way from there to the next node. Shape (N-1, V, K).
        time_s: Time taken; infinite where the notch is not allowed. Shape (N-1, V, K).
        work: Priced work, J/kg. Shape (N-1, V, K).
    """

    cap: Float[ndarray, " positions"]
    share: Float[ndarray, " speeds"]
    lower: Int[ndarray, "segments speeds notches"]
    way: Float[ndarray, "segments speeds notches"]
    time_s: Float[ndarray, "segments speeds notches"]
    work: Float[ndarray, "segments speeds notches"]


def notch_plan(
    section: Section,
    trainset: Trainset,
    time_s: float,
    notches_n: Sequence[float],
    options: NotchOptions | None = None,
) -> NotchPlan:
    """The drive of least energy within a running time when only some forces can be chosen.

    A traction notch gives what the effort curve has where that is less. With more and more notches the energy
    comes down to that of :func:`optimal_plan`; with few it is above.

    Args:
        section: Section.
        trainset: Trainset with its load.
        time_s: Running time.
        notches_n: Forces in N, braking negative; 0 (coasting) is one of them, and at least one brakes.
        options: See :class:`NotchOptions`.

    Raises:
        InputError: The notches are not such a table.
        Infeasible: No drive by these notches is that fast; the message names the minimum.
    """
    return notch_plans(section, trainset, [time_s], notches_n, options)[0]


def notch_plans(
    section: Section,
    trainset: Trainset,
    times_s: Sequence[float],
    notches_n: Sequence[float],
    options: NotchOptions | None = None,
) -> list[NotchPlan]:
    """:func:`notch_plan` for several running times: what does not depend on the time is computed once."""
    problem = _Problem(section, trainset, notches_n, options or NotchOptions())
    fastest = problem.forward(HIGHEST_PRICE_WPKG, problem.values(HIGHEST_PRICE_WPKG))
    for time_s in times_s:
        if not fastest.running_time_s <= time_s:
            least = math.ceil(fastest.running_time_s * 10.0) / 10.0
            raise Infeasible(
                f"minimum running time by these notches is {least:.1f} s",
                field="time",
                value=round(time_s, 3),
                unit="s",
                allowed=f">= {least:.1f} s",
            )
    return [_cheapest(problem, fastest, time_s) for time_s in times_s]


def _cheapest(problem: _Problem, fastest: NotchPlan, time_s: float) -> NotchPlan:
    """Bisect the price of time; the best drive that is in time, with the largest dual value met."""
    best, bound, price = fastest, -np.inf, HIGHEST_PRICE_WPKG
    low, high = 0.0, HIGHEST_PRICE_WPKG
    for count in range(BISECTIONS):
        # halve in the logarithm, but for zero: there the time asked for is more than the cheapest drive takes
        middle = 0.0 if count == 0 else math.sqrt(max(low, 1e-3) * high)
        value = problem.values(middle)
        plan = problem.forward(middle, value)
        bound = max(bound, (value[0][0] - middle * time_s) * problem.mass_kg)
        if plan.running_time_s <= time_s:
            high = middle
            if plan.energy_j <= best.energy_j:
                best, price = plan, middle
        else:
            low = middle
        if high <= 1e-3 or high / max(low, 1e-3) < 1.0 + 1e-4 or 0 <= time_s - plan.running_time_s < CLOSE_S:
            break
    return replace(best, bound_j=bound, second_w=price * problem.mass_kg)


class _Problem:
    """A section, a trainset and its notches on a mesh."""

    def __init__(
        self, section: Section, trainset: Trainset, notches_n: Sequence[float], options: NotchOptions
    ) -> None:
        vehicle, track = vehicle_arrays(trainset), track_arrays(section, trainset)
        self.table = specific(vehicle)
        self.mass_kg = self.table.mass_kg
        self.options = options
        self.notches = _check(notches_n, self.table) / self.mass_kg
        mesh = build_mesh(vehicle, track, np.array([0.0, float(track.length_m)]), options.spacing_m)
        self.mesh = mesh
        # the last segments become one: there the brake is continuous
        self.last = int(np.searchsorted(mesh.node_m, mesh.node_m[-1] - STOP_M))
        self.stop_m = float(mesh.node_m[-1] - mesh.node_m[self.last])
        self.stop_drag = float(np.average(mesh.slope_mps2[self.last :], weights=mesh.length_m[self.last :]))
        self.moves = self._moves()

    def rates(self, k: int, energy: ndarray) -> tuple[ndarray, ndarray]:
        """Acceleration and force per kg under every notch over segment ``k``. Both of shape (V, K)."""
        return _rates(self.table, self.mesh, k, energy[:, None], self.notches[None, :])

    def too_strong(self, rate: ndarray) -> ndarray:
        """Tell which notches accelerate or brake more than allowed. Shape (V, K)."""
        most = self.options.most_mps2
        return np.where(self.notches > 0.0, rate > most, (self.notches < 0.0) & (rate < -most))

    def _moves(self) -> Moves:
        mesh, count = self.mesh, self.last + 1
        cap = self._cap()
        share = np.linspace(0.0, 1.0, self.options.speeds)
        shape = (count - 1, share.size, self.notches.size)
        lower, way = np.zeros(shape, np.int32), np.zeros(shape)
        time_s, work = np.zeros(shape), np.zeros(shape)
        for k in range(count - 1):
            energy = cap[k] * share**2
            rate, force = self.rates(k, energy)
            lower[k], way[k], time_s[k] = self._reach(k, energy[:, None], rate, cap[k + 1])
            time_s[k][self.too_strong(rate)] = np.inf
            work[k] = self._work(force, mesh.length_m[k])
        return Moves(cap, share, lower, way, time_s, work)

    def _work(self, force: ndarray, length_m: float) -> ndarray:
        return (np.maximum(force, 0.0) + self.options.brake_weight * np.maximum(-force, 0.0)) * length_m

    def _reach(self, k: int, energy: ndarray, rate: ndarray, cap: float) -> tuple[ndarray, ndarray, ndarray]:
        """Node below, share of the way in energy to the next, and time; infinite where not allowed."""
        length = self.mesh.length_m[k]
        after = energy + rate * length
        # the frontier itself is allowed in spite of rounding
        allowed = (after > 0.0) & (after <= cap * (1.0 + 1e-9) + 1e-9)
        after = np.clip(after, 0.0, cap)
        top = self.options.speeds - 1
        place = np.sqrt(after / cap) * top
        lower = np.minimum(place.astype(np.int32), top - 1)
        below, above = (lower / top) ** 2, ((lower + 1) / top) ** 2
        way = (after / cap - below) / (above - below)
        total = np.sqrt(2.0 * energy) + np.sqrt(2.0 * after)
        taken = np.where(allowed, 2.0 * length / np.maximum(total, 1e-9), np.inf)
        return lower, way, taken

    def _cap(self) -> ndarray:
        """Largest ``v^2/2`` up to the last segment: the limits, and the strongest allowed brake."""
        mesh, strongest = self.mesh, self.notches[:1]
        energy = 0.5 * mesh.cap_mps[: self.last + 1] ** 2
        resting = float(self.table.davis[0]) + self.stop_drag
        most = min(resting - float(strongest[0]), self.options.most_mps2)
        energy[-1] = min(energy[-1], most * self.stop_m)
        for k in range(self.last - 1, -1, -1):

            def excess(before: float, k: int = k) -> float:
                rate = self.rates(k, np.array([before]))[0]
                least = float(rate[~self.too_strong(rate)].min())
                return before + least * mesh.length_m[k] - energy[k + 1]

            # the energy from which the strongest notch just leads to the next cap; a fall may take all of it
            low, high = energy[k + 1], energy[k + 1] + 3.0 * mesh.length_m[k]
            if excess(low) < 0.0:
                low = float(np.asarray(brentq(excess, low, high, xtol=1e-11)))
                if excess(low) > JUMP:  # just beyond the energy up to which the strongest notch is allowed
                    low -= 2e-11
            energy[k] = min(energy[k], low)
        return energy

    def stop_cost(self, energy: ndarray) -> tuple[ndarray, ndarray]:
        """Time and braking work per kg of the last segment at constant deceleration."""
        rate = energy / self.stop_m
        a, b, c = self.table.davis
        speed = np.sqrt(energy)  # at half the energy: sqrt(2 e / 2)
        brake = rate - (a + speed * (b + c * speed) + self.stop_drag)
        with np.errstate(divide="ignore"):
            time_s = np.where(
                energy > 0, 2.0 * self.stop_m / np.sqrt(2.0 * np.maximum(energy, 1e-300)), np.inf
            )
        time_s = np.where(brake < -1e-9, np.inf, time_s)
        return time_s, np.maximum(brake, 0.0) * self.stop_m

    def values(self, price: float) -> list[ndarray]:
        """Least cost to go, J/kg, with a price on time in W/kg. One array of shape (V,) a position."""
        moves = self.moves
        time_s, braked = self.stop_cost(moves.cap[-1] * moves.share**2)
        time_s = np.where(np.isfinite(time_s), time_s, INFEASIBLE)
        value = [np.minimum(price * time_s, INFEASIBLE) + self.options.brake_weight * braked]
        value[0] = np.where(time_s >= INFEASIBLE, INFEASIBLE, value[0])
        for k in range(moves.lower.shape[0] - 1, -1, -1):
            cost = self._costs(k, price, value[-1])
            value.append(np.minimum(cost.min(axis=1), INFEASIBLE))
        return value[::-1]

    def _costs(self, k: int, price: float, later: ndarray) -> ndarray:
        moves = self.moves
        low = later[moves.lower[k]]
        cost = low + (later[moves.lower[k] + 1] - low) * moves.way[k] + moves.work[k]
        taken = moves.time_s[k]
        allowed = np.isfinite(taken)
        return np.where(allowed, cost + price * np.where(allowed, taken, 0.0), INFEASIBLE)

    def forward(self, price: float, values: list[ndarray]) -> NotchPlan:
        """The drive the values prefer, in continuous speed from rest."""
        mesh, cap = self.mesh, self.moves.cap
        energy, times, forces = [0.0], [0.0], []
        wheel = effort = 0.0
        for k in range(self.last):
            here = np.array([energy[-1]])
            rate, force = self.rates(k, here)
            lower, way, taken = self._reach(k, here[:, None], rate, cap[k + 1])
            taken = np.where(self.too_strong(rate), np.inf, taken)
            later = values[k + 1]
            cost = (
                later[lower] + (later[lower + 1] - later[lower]) * way + self._work(force, mesh.length_m[k])
            )
            cost = np.where(np.isfinite(taken), cost + price * np.where(np.isfinite(taken), taken, 0), np.inf)
            best = int(np.argmin(cost[0]))
            if not np.isfinite(cost[0, best]):
                raise Infeasible(
                    "no notch keeps the trainset going", field="notches", value=mesh.node_m[k], unit="m"
                )
            chosen = float(force[0, best])
            energy.append(min(float(energy[-1] + rate[0, best] * mesh.length_m[k]), float(cap[k + 1])))
            times.append(times[-1] + float(taken[0, best]))
            forces.append(chosen * self.mass_kg)
            wheel += max(chosen, 0.0) * mesh.length_m[k]
            effort += abs(chosen) * mesh.length_m[k]
        time_s, braked = (float(x[0]) for x in self.stop_cost(np.array([energy[-1]])))
        forces.append(-braked / self.stop_m * self.mass_kg)
        wheel, effort = wheel * self.mass_kg, (effort + braked) * self.mass_kg
        weight = self.options.brake_weight
        return NotchPlan(
            position_m=np.append(mesh.node_m[: self.last + 1], mesh.node_m[-1]),
            speed_mps=np.append(np.sqrt(2.0 * np.array(energy)), 0.0),
            time_s=np.append(times, times[-1] + time_s),
            force_n=np.array(forces),
            running_time_s=times[-1] + time_s,
            energy_j=wheel + weight * (effort - wheel),
            energy_wheel_j=wheel,
            energy_effort_j=effort,
            bound_j=-math.inf,
            second_w=0.0,
        )


def _check(notches_n: Sequence[float], table: Specific) -> ndarray:
    """The notches, increasing, none stronger than the brakes.

    Raises:
        InputError: No brake, no coasting, no traction, or a brake beyond the trainset's.
    """
    notches = np.unique(np.asarray(notches_n, np.float64))
    if not (np.isfinite(notches).all() and notches[0] < 0.0 < notches[-1] and (notches == 0.0).any()):
        words = "needs finite forces: at least one brakes, one coasts (0), one pulls"
        raise InputError(words, field="notches", value=str(list(notches_n)))
    most = float(table.braking.min()) * table.mass_kg
    if -notches[0] > most * (1.0 + 1e-9):
        raise InputError(
            "stronger than the brakes",
            field="notches",
            value=float(notches[0]),
            unit="N",
            allowed=f">= {-most:g} N",
        )
    return notches


def _rates(table: Specific, mesh: Mesh, k: int, energy: ndarray, notches: ndarray) -> tuple[ndarray, ndarray]:
    """Acceleration and force per kg over segment ``k``, both taken at its middle in energy."""
    a, b, c = table.davis
    quad = c + mesh.tunnel_n[k] / table.mass_kg
    length, slope = mesh.length_m[k], mesh.slope_mps2[k]
    rate = np.zeros(np.broadcast_shapes(energy.shape, notches.shape))
    force = rate
    for _ in range(ITERATIONS):
        middle = np.maximum(energy + 0.5 * rate * length, 0.0)
        v = np.sqrt(2.0 * middle)
        index = np.minimum((v / STEP_MPS + 0.5).astype(np.int32), table.traction.size - 1)
        drag = a + v * (b + v * quad) + slope
        force = np.minimum(notches, np.minimum(table.traction[index], table.acceleration + drag))
        rate = force - drag
    return rate, force

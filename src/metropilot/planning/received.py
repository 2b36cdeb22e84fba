"""The least net energy of a trip of whose returned power others can take only so much, and only at times."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.physics import Track, Vehicle
from metropilot.planning.cone_program import Answer, Programme, TimeBound
from metropilot.planning.effort_table import specific
from metropilot.planning.fastest import fastest_profile, relaxed_cap, times
from metropilot.planning.loads import build_loads
from metropilot.planning.mesh import build_mesh
from metropilot.planning.optimal import (
    MESH_TOLERANCE,
    Plan,
    PlanOptions,
    evaluate_profile,
    solve_until_settled,
)
from metropilot.planning.prices import prices_at


class Receiver(NamedTuple):
    """Somebody who takes returned power while a trip is both in its first and in its last seconds.

    Attributes:
        first_s: Time after the departure; infinite: until the arrival.
        last_s: Time before the arrival; infinite: from the departure.
        power_w: Most power it takes.
    """

    first_s: float
    last_s: float
    power_w: float


class TripBound(NamedTuple):
    """Net energy that no drive of a trip undercuts.

    Attributes:
        bound_j: In the running time asked for.
        second_w: Its slope: least energy is convex in time, so that in a running time longer by ``s`` none is
            below ``bound_j - second_w * s``.
    """

    bound_j: float
    second_w: float


class ReceivedEnergy:
    """Least net energy of a trip by who receives what it returns.

    What is received when is a matter of time, but the programme of the plan is one over distance: a receiver
    is granted all places where a drive can be at its times. After a departure no drive is farther than the
    flat-out run, and before an arrival none is farther away from it.

    Args:
        vehicle: Trainset, its efficiencies constant; received power is worth its receptivity.
        track: Section.
        time_s: Running time, at least the minimum.

    Attributes:
        programme: Programme of the plan, all that is returned received.
        clock_s: Time of the flat-out run at the nodes.
        energy: Kinetic energy per kg at the nodes of the last answer.
    """

    def __init__(self, vehicle: Vehicle, track: Track, time_s: float) -> None:
        self._vehicle = vehicle
        table = specific(vehicle)
        mesh = build_mesh(vehicle, track, np.array([0.0, float(track.length_m)]), PlanOptions.spacing_m)
        loads, fastest = build_loads(vehicle, table, mesh), fastest_profile(table, mesh)
        self.clock_s = np.concatenate([[0.0], np.cumsum(times(mesh, fastest))])
        self.energy = fastest
        self.programme = Programme(
            mesh=mesh,
            table=table,
            loads=loads,
            prices=prices_at(loads, "line", fastest, None),
            start_mps=0.0,
            end_mps=0.0,
            cap_mps=relaxed_cap(table, mesh, 0.0),
            bounds=self.in_time(time_s),
        )

    def in_time(self, time_s: float) -> tuple[TimeBound]:
        """Bound on the running time; on this mesh the flat-out run may take a hair longer than the minimum.

        More time than asked for never makes the least energy more.
        """
        kept_s = max(time_s, float(self.clock_s[-1]) * (1.0 + MESH_TOLERANCE))
        return (TimeBound(0, self.clock_s.size - 1, None, kept_s),)

    def plan(self, own_w: float, receivers: Iterable[Receiver] = ()) -> Plan:
        """Plan of least net energy; its ``energy_j`` counts all that it returns as received."""
        found = self.bound(own_w, receivers)
        return replace(self._evaluate(), bound_j=found.bound_j, second_w=found.second_w)

    def plan_beside(self, others_w: Float[ndarray, " segments"], speed_mps: Float[ndarray, " nodes"]) -> Plan:
        """Plan of least net energy beside trains whose power is known while each segment is passed.

        Args:
            others_w: What all others and the trainset itself draw less what others return. So much of the
                power that the plan returns is received; where it is negative, so much of what it draws costs
                nothing. Shape (N,).
            speed_mps: Speeds at the nodes of the drive that passes the segments then. Shape (N+1,).
        """
        self.energy = 0.5 * speed_mps**2
        self._solve(np.maximum(others_w, 0.0), np.maximum(-others_w, 0.0))
        return self._evaluate()

    def bound(self, own_w: float, receivers: Iterable[Receiver]) -> TripBound:
        """Least net energy of any drive.

        Args:
            own_w: Power that the trainset itself takes, at any time.
            receivers: Others, who take what is returned beyond that.
        """
        mass_kg, clock_s = self.programme.table.mass_kg, self.clock_s
        taken_w = np.full(clock_s.size - 1, own_w)
        for each in receivers:
            reached = clock_s[:-1] < each.first_s
            taken_w[reached & (clock_s[1:] > clock_s[-1] - each.last_s)] += each.power_w
        answer = self._solve(taken_w)
        return TripBound(answer.dual * mass_kg, answer.second * mass_kg)

    def _solve(self, taken_w: ndarray, surplus_w: ndarray | None = None) -> Answer:
        mass_kg = self.programme.table.mass_kg
        prices = self.programme.prices._replace(
            received_w=None if np.isinf(taken_w).all() else taken_w / mass_kg,
            surplus_w=None if surplus_w is None else surplus_w / mass_kg,
        )
        answer, _ = solve_until_settled(replace(self.programme, prices=prices), self.energy)
        self.energy = answer.energy
        return answer

    def _evaluate(self) -> Plan:
        programme, options = self.programme, PlanOptions(objective="line")
        return evaluate_profile(self._vehicle, programme.table, programme.mesh, self.energy, options)

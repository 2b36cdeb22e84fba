"""The plan's programme as a nonlinear one, for CasADi/IPOPT: speeds at the nodes, forces on the segments."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy import ndarray

from metropilot.planning import Mesh, Specific

SPLINE_MPS = 0.5
LIMIT_S = 300.0
SLOWEST_MPS = 0.05


@dataclass(frozen=True)
class Problem:
    """Problem that both solvers are given.

    Attributes:
        mesh: Mesh; caps of 0 are stops.
        table: Trainset, per kg.
        flat_out: Kinetic energies of the flat-out run.
        times_s: Running time of each run between two stops.
    """

    mesh: Mesh
    table: Specific
    flat_out: ndarray
    times_s: ndarray


@dataclass(frozen=True)
class Found:
    """Solution of IPOPT; times in s, wheel traction energy in J."""

    solved: bool
    energy_j: float
    solve_s: float
    build_s: float


def solve_nlp(problem: Problem) -> Found:
    """Transcribe and solve from a cold start."""
    began = time.perf_counter()
    solver, arguments = _transcribe(problem)
    built = time.perf_counter()
    answer = solver(**arguments)
    ended = time.perf_counter()
    energy = float(answer["f"]) * problem.table.mass_kg
    return Found(bool(solver.stats()["success"]), energy, ended - built, built - began)


def _transcribe(problem: Problem) -> tuple[Any, dict[str, Any]]:
    import casadi as ca

    mesh, table, ds = problem.mesh, problem.table, problem.mesh.length_m
    n = ds.size
    v, f, b = ca.MX.sym("v", n + 1), ca.MX.sym("f", n), ca.MX.sym("b", n)
    before, after = v[:-1], v[1:]
    mean_energy = (before**2 + after**2) / 4
    a, linear, quad = table.davis
    drag = a + linear / 2 * (before + after) + 2 * (quad + mesh.tunnel_n / table.mass_kg) * mean_energy
    gained = (after**2 - before**2) / (2 * ds)
    middle = ca.sqrt(2 * mean_energy)
    seconds = 2 * ds / (before + after)
    stops = [0, *np.flatnonzero(mesh.cap_mps[1:-1] == 0) + 1, n]
    legs = [ca.sum1(seconds[i:j]) for i, j in itertools.pairwise(stops)]
    rows = [
        (gained - f + b + drag + mesh.slope_mps2, 0.0, 0.0, n),
        (f - spline("traction", table, table.traction)(middle), -np.inf, 0.0, n),
        (b - spline("braking", table, table.braking)(middle), -np.inf, 0.0, n),
        (gained, -table.deceleration, table.acceleration, n),
        (ca.vertcat(*legs), 0.0, problem.times_s, len(legs)),
    ]
    low, high = np.full(n + 1, SLOWEST_MPS), mesh.cap_mps.copy()
    low[stops] = high[stops] = 0.0
    cost = ca.dot(ds, f)
    programme = {"x": ca.vertcat(v, f, b), "f": cost, "g": ca.vertcat(*(r[0] for r in rows))}
    quiet = {"print_level": 0, "sb": "yes", "max_iter": 3000, "max_wall_time": LIMIT_S}
    solver = ca.nlpsol("plan", "ipopt", programme, {"ipopt": quiet, "print_time": False})
    none = np.zeros(n)
    arguments = {
        "x0": np.concatenate([_guess(problem, stops), none + 0.1, none + 0.1]),
        "lbx": np.concatenate([low, none, none]),
        "ubx": np.concatenate([high, none + np.inf, none + np.inf]),
        "lbg": np.concatenate([np.broadcast_to(r[1], r[3]) for r in rows]),
        "ubg": np.concatenate([np.broadcast_to(r[2], r[3]) for r in rows]),
    }
    return solver, arguments


def spline(name: str, table: Specific, values: ndarray) -> Callable[[Any], Any]:
    """A smooth effort curve: IPOPT needs second derivatives."""
    import casadi as ca

    grid = np.arange(0.0, table.speed_mps[-1], SPLINE_MPS)
    curve = ca.interpolant(name, "bspline", [grid], np.interp(grid, table.speed_mps, values))
    return lambda speed: curve(speed.T).T


def _guess(problem: Problem, stops: list[int]) -> ndarray:
    """The flat-out run with its top cut off at 1.2 times the mean speed of each run."""
    speed = np.sqrt(2 * problem.flat_out)
    for i, j, seconds in zip(stops[:-1], stops[1:], problem.times_s, strict=True):
        mean = (problem.mesh.node_m[j] - problem.mesh.node_m[i]) / seconds
        speed[i : j + 1] = np.minimum(speed[i : j + 1], 1.2 * mean)
    return speed

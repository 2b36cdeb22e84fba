"""The plan's programme as it is usually written: direct multiple shooting for CasADi/IPOPT.

States are time and speed squared at the nodes, controls the forces held on a segment; Runge-Kutta of order 4
over each segment; effort bounded at both of its ends. Source: the structure of ms-eetc (github
dkouzoup/ms-eetc; Kouzoupis et al. 2023), vectorised with ``map``, on our mesh and limits.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks.nlp import LIMIT_S, Found, Problem, spline

GUESS_MPS = 60 / 3.6


def solve_shooting(problem: Problem, ends_mps: float) -> Found:
    """Transcribe and solve from a constant-speed guess; a small speed at every stop, where 1/v has a pole."""
    began = time.perf_counter()
    solver, arguments = _transcribe(problem, ends_mps)
    built = time.perf_counter()
    answer = solver(**arguments)
    ended = time.perf_counter()
    energy = float(answer["f"]) * problem.table.mass_kg
    return Found(bool(solver.stats()["success"]), energy, ended - built, built - began)


def _segment(problem: Problem) -> Any:  # noqa: ANN401 -- CasADi has no types
    """Time and speed squared after one segment, by one Runge-Kutta step."""
    import casadi as ca

    a, linear, quad = problem.table.davis
    state, control, given = ca.MX.sym("state", 2), ca.MX.sym("control", 2), ca.MX.sym("given", 3)
    ds, slope, tunnel = ca.vertsplit(given)

    def rate(at: Any) -> Any:  # noqa: ANN401
        speed = ca.sqrt(at[1])
        drag = a + linear * speed + (quad + tunnel) * at[1] + slope
        return ca.vertcat(1 / speed, 2 * (control[0] - control[1] - drag))

    k1 = rate(state)
    k2 = rate(state + ds / 2 * k1)
    k3 = rate(state + ds / 2 * k2)
    k4 = rate(state + ds * k3)
    after = state + ds / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.Function("segment", [state, control, given], [after])


def _transcribe(problem: Problem, ends_mps: float) -> tuple[Any, dict[str, Any]]:
    import casadi as ca

    mesh, table, ds = problem.mesh, problem.table, problem.mesh.length_m
    n, seconds = ds.size, float(problem.times_s.sum())
    stops = [0, *np.flatnonzero(mesh.cap_mps[1:-1] == 0) + 1, n]
    x, u = ca.MX.sym("x", 2, n + 1), ca.MX.sym("u", 2, n)
    given = np.stack([ds, mesh.slope_mps2, mesh.tunnel_n / table.mass_kg])
    step = _segment(problem).map(n)
    speed = ca.sqrt(x[1, :]).T
    gained = (x[1, 1:] - x[1, :-1]).T / (2 * ds)
    traction, braking = (spline(k, table, v) for k, v in (("f", table.traction), ("b", table.braking)))
    strongest, hardest = traction(speed), braking(speed)
    rows = [
        (ca.vec(step(x[:, :-1], u, given) - x[:, 1:]), 0.0, 0.0, 2 * n),
        (u[0, :].T - strongest[:-1], -np.inf, 0.0, n),
        (u[0, :].T - strongest[1:], -np.inf, 0.0, n),
        (u[1, :].T - hardest[:-1], -np.inf, 0.0, n),
        (u[1, :].T - hardest[1:], -np.inf, 0.0, n),
        (gained, -table.deceleration, table.acceleration, n),
        ((x[0, stops[1:]] - x[0, stops[:-1]]).T, 0.0, problem.times_s, len(stops) - 1),
    ]
    low, high = np.zeros((2, n + 1)), np.full((2, n + 1), seconds)
    low[1], high[1] = ends_mps**2, np.maximum(mesh.cap_mps, ends_mps) ** 2
    high[0, 0], high[1, stops] = 0.0, ends_mps**2
    guess = np.stack([np.linspace(0.0, seconds, n + 1), np.full(n + 1, GUESS_MPS**2)])
    programme = {
        "x": ca.vertcat(ca.vec(x), ca.vec(u)),
        "f": ca.dot(ds, u[0, :].T),
        "g": ca.vertcat(*(r[0] for r in rows)),
    }
    quiet = {"print_level": 0, "sb": "yes", "max_iter": 3000, "max_wall_time": LIMIT_S}
    solver = ca.nlpsol("plan", "ipopt", programme, {"ipopt": quiet, "print_time": False})
    return solver, {
        "x0": np.concatenate([guess.T.ravel(), np.full(2 * n, 0.1)]),
        "lbx": np.concatenate([low.T.ravel(), np.zeros(2 * n)]),
        "ubx": np.concatenate([high.T.ravel(), np.full(2 * n, np.inf)]),
        "lbg": np.concatenate([np.broadcast_to(r[1], r[3]) for r in rows]),
        "ubg": np.concatenate([np.broadcast_to(r[2], r[3]) for r in rows]),
    }

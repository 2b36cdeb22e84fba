"""Direct answers: sections, plans, fronts, journeys, uploads."""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from multiprocessing import parent_process
from multiprocessing.connection import wait
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from metropilot import physics, planning
from metropilot._processes import ONE_THREAD
from metropilot.errors import Infeasible, InputError
from metropilot.evaluate import POLICY, RunSpec, attainable_of, driving_limits, traction_work_j
from metropilot.operation import LineOperation, OperationOptions
from metropilot.policy import load_driving_policy
from metropilot.railway import Line, Section, Station, Steps, Trainset, import_file, load_line, load_trainset
from metropilot.sim import Disturbance


@dataclass(frozen=True, kw_only=True)
class LineRequest:
    """A line with its trainset and options of its operation.

    Attributes:
        line: Id of the catalogue, or path.
        trainset: The same of the trainset.
        load: Its load; None: the trainset's.
        options: Headway, dwells, windows, feeding zones.
    """

    line: str
    trainset: str
    load: str | None
    options: OperationOptions

    def operation(self) -> LineOperation:
        """The line in operation.

        Raises:
            InputError: A name is unknown, or the options do not fit the line.
        """
        return LineOperation(load_line(self.line), load_trainset(self.trainset, self.load), self.options)


def begin(worker_bytes: int | None, nice: int) -> None:
    """Set up this process; call it before anything numerical is imported.

    Args:
        worker_bytes: Bound on the address space; None leaves it (JAX maps far more than it uses).
        nice: Increment of the niceness over the server's.
    """
    for name, value in ONE_THREAD.items():
        os.environ.setdefault(name, value)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_outlive_nobody, daemon=True).start()
    if hasattr(os, "nice"):
        os.nice(nice)
    if worker_bytes is not None:
        try:
            import resource
        except ImportError:
            return
        resource.setrlimit(resource.RLIMIT_AS, (worker_bytes, worker_bytes))


def _outlive_nobody() -> None:
    """End this process when the server ends, so that no worker outlives it."""
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def numbers(values: Iterable[Any], digits: int = 6) -> list[Any]:
    """Convert to a list of rounded numbers; None where one is not finite."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiu":
        return array.tolist()
    return [round(x, digits) if math.isfinite(x) else None for x in array.tolist()]


def pieces(steps: Steps) -> dict[str, list[Any]]:
    """Convert a piecewise-constant profile."""
    return {"from_m": numbers(steps.from_m), "value": numbers(steps.value)}


def window(section: Section, name: str) -> dict[str, list[Any]]:
    """Convert a profile of a section, from its origin to its end."""
    return pieces(getattr(section, name).window(0.0, section.length_m))


def station(stop: Station, position_m: float | None = None) -> dict[str, Any]:
    """Convert a station."""
    at = stop.position_m if position_m is None else position_m
    return {"code": stop.code, "name": stop.name, "position_m": at, "local_name": stop.local_name}


BARELY = 1.0 + 1e-4
"""Shortest planned running time over the minimum one, at which the program has hardly any interior."""
LONGEST_M = 200_000.0
CURVE_POINTS = 81
"""Speeds at which effort curves are drawn."""
SUFFIX = ".safetensors"
"""Ending of the file name of a policy."""
LOG, LOG_SUFFIX = "log", ".csv"
"""Kind of an uploaded log of runs, and the ending of its file name."""


def section_of(request: RunSpec) -> dict[str, Any]:
    """The section and its minimum running time."""
    section, trainset = request.section(), request.loaded_trainset()
    if section.length_m > LONGEST_M:
        raise InputError("section too long", field="destination", value=section.length_m, unit="m")
    return {
        "name": section.name,
        "origin": station(section.origin, 0.0),
        "destination": station(section.destination, section.length_m),
        "length_m": section.length_m,
        "planned_time_s": section.planned_time_s,
        "minimum_running_time_s": planning.minimum_running_time(section, trainset),
        "limit_mps": window(section, "limit_mps"),
        "gradient_permil": window(section, "gradient_permil"),
    }


def plan_of(request: RunSpec) -> dict[str, Any]:
    """The optimal plan for the scheduled time."""
    section, trainset = request.section(), request.loaded_trainset()
    fastest = planning.minimum_running_time(section, trainset)
    time_s = request.time_s or section.planned_time_s or fastest * 1.1
    planning.check_running_time(time_s, fastest)
    options = planning.PlanOptions(objective=request.objective)
    made = plan_out(planning.optimal_plan(section, trainset, max(time_s, fastest * BARELY), options), fastest)
    return made | {"plant": plant_plan_of(replace(request, time_s=max(time_s, fastest * BARELY)))}


def plant_plan_of(request: RunSpec) -> dict[str, Any] | None:
    """Plan that the true plant can attain in the running time, with its actuation under protection.

    Returns:
        The plan; None without a disturbance, and where the true plant cannot keep the time.
    """
    if replace(request.disturbance, updates=()) == Disturbance():
        return None
    run = request.run()
    plant = run.disturbance.true_plant(run.trainset)
    options = planning.PlanOptions(objective=request.objective)
    try:
        fastest = planning.minimum_running_time(run.section, plant)
        ideal = planning.optimal_plan(run.section, plant, run.scheduled_time_s, options)
    except Infeasible:
        return None
    limits = driving_limits(run, run.section)
    found = attainable_of(run.section, plant, run.scheduled_time_s, limits, ideal, request.objective)
    return None if found is None else plan_out(found.plan, fastest)


def plan_out(plan: planning.Plan, fastest_s: float) -> dict[str, Any]:
    """Convert a plan to plain values."""
    return {
        "position_m": numbers(plan.position_m, 3),
        "speed_mps": numbers(plan.speed_mps, 4),
        "time_s": numbers(plan.time_s, 3),
        "energy_wheel_so_far_j": numbers(traction_work_j(plan), 0),
        "running_time_s": plan.running_time_s,
        "minimum_running_time_s": fastest_s,
        "energy_j": plan.energy_j,
        "bound_j": plan.bound_j,
        "certificate_gap": plan.gap,
        "second_w": plan.second_w,
    }


def front_of(request: RunSpec) -> dict[str, Any]:
    """The time-energy front."""
    section, trainset = request.section(), request.loaded_trainset()
    front = planning.time_energy_front(
        section, trainset, options=planning.PlanOptions(objective=request.objective)
    )
    return {
        "minimum_running_time_s": front.minimum_s,
        "time_s": numbers(front.time_s),
        "energy_j": numbers(front.energy_j, 0),
        "second_w": numbers(front.second_w, 3),
    }


def journey_of(body: dict[str, Any]) -> dict[str, Any]:
    """A journey that calls at every station.

    Args:
        body: Fields of :class:`metropilot.web.schemas.requests.JourneyIn`, names of files resolved.
    """
    line, trainset = load_line(body["line"]), load_trainset(body["trainset"], body["load"])
    origin = line.station(body["origin"]) if body["origin"] else line.stations[0]
    destination = line.station(body["destination"]) if body["destination"] else line.stations[-1]
    if origin == destination:
        raise InputError("a journey needs two stations", field="destination", value=destination.code)
    length = abs(destination.position_m - origin.position_m)
    if length > LONGEST_M:
        raise InputError("journey too long", field="destination", value=length, unit="m")
    options = planning.PlanOptions(objective=body["objective"])
    ends = {"origin": origin, "destination": destination}
    points = planning.timetable_waypoints(line, origin, destination, total_s=body["total_s"])
    made = planning.plan_journey(line, trainset, points, options, **ends)
    planned = None
    if body["total_s"] is not None and line.planned_forward_s:
        # The timetable's own running times, for comparison; they may be too short for this trainset.
        with suppress(Infeasible):
            points = planning.timetable_waypoints(line, origin, destination)
            planned = planning.plan_journey(line, trainset, points, options, **ends).plan.energy_j
    return {**_journey_out(made), "planned_energy_j": planned}


def _journey_out(made: planning.JourneyPlan) -> dict[str, Any]:
    plan, calls = made.plan, made.calls
    time, at, speed = [], [], []
    for before, after in pairwise(calls):
        inside = (plan.position_m >= before.position_m - 1e-6) & (plan.position_m <= after.position_m + 1e-6)
        moving = plan.time_s[inside]
        time += [*(before.departure_s + moving - moving[0])]
        at += [*plan.position_m[inside]]
        speed += [*plan.speed_mps[inside]]
    rows = [
        {
            "station": c.name,
            "position_m": c.position_m,
            "arrival_s": c.arrival_s,
            "departure_s": c.departure_s,
            "running_time_s": c.running_time_s,
            "minimum_running_time_s": c.minimum_s,
            "energy_j": c.energy_j,
        }
        for c in calls
    ]
    return {
        "calls": rows,
        "time_s": numbers(time, 3),
        "position_m": numbers(at, 3),
        "speed_mps": numbers(speed, 4),
        "running_time_s": calls[-1].arrival_s,
        "energy_j": plan.energy_j,
        "bound_j": plan.bound_j,
    }


def effort_curves(trainset: Trainset) -> dict[str, list[Any]]:
    """Forces and rates of a trainset on level track over speed, within its limits."""
    vehicle = physics.vehicle_arrays(trainset)
    speed = np.linspace(0.0, trainset.max_speed_mps, CURVE_POINTS)
    found = {
        name: np.array([force(vehicle, v) for v in speed.tolist()])
        for name, force in (
            ("traction_n", physics.traction_available_n),
            ("electric_brake_n", physics.electric_available_n),
            ("brake_n", physics.brake_available_n),
            ("resistance_n", physics.davis_n),
        )
    }
    mass_kg = trainset.effective_mass_kg
    faster = np.minimum(
        (found["traction_n"] - found["resistance_n"]) / mass_kg, trainset.max_acceleration_mps2
    )
    slower = np.minimum((found["brake_n"] + found["resistance_n"]) / mass_kg, trainset.max_deceleration_mps2)
    found |= {"speed_mps": speed, "acceleration_mps2": faster, "deceleration_mps2": slower}
    return {name: numbers(values, 4) for name, values in found.items()}


def read_upload(path: str, shown: str) -> dict[str, Any]:
    """Read an uploaded file; return its kind (line, trainset, policy, log), name and notes.

    Raises:
        InputError: The file is none of these; the message has the sender's file name and the field.
    """
    try:
        if Path(path).suffix == SUFFIX:
            about = load_driving_policy(path).about
            return {
                "kind": POLICY,
                "name": shown,
                "notes": [f"task {about['task']}"] if "task" in about else [],
            }
        if Path(path).suffix == LOG_SUFFIX:
            from metropilot.fit import describe_log, read_log

            return {"kind": LOG, "name": shown, "notes": [describe_log(read_log(path))]}
        found = import_file(Path(path))
    except InputError as error:
        shape = {name: getattr(error, name) for name in ("field", "value", "unit", "allowed")}
        raise InputError(error.message, file=shown, **shape) from None
    if not isinstance(found, Line | Trainset):
        raise InputError("neither a line nor a trainset", file=shown, field="kind", allowed="line, trainset")
    if isinstance(found, Line):
        return {"kind": "line", "name": found.name, "notes": list(found.notes)}
    return {"kind": "trainset", "name": found.name, "notes": list(found.notes)}

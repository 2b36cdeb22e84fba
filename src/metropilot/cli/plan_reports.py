"""Output of `metropilot plan`: a run, a front, a journey."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from metropilot._io import fill_folder, write_json
from metropilot.cli.console import console, number, print_json, show_activity, table
from metropilot.errors import InputError, rename_fields
from metropilot.planning import (
    JourneyPlan,
    Plan,
    PlanOptions,
    check_running_time,
    journey_waypoints,
    minimum_running_time,
    optimal_plan,
    plan_journey,
    round_up_time,
    time_energy_front,
    timetable_waypoints,
)
from metropilot.railway import Line, Section, Station, Trainset, load_journey
from metropilot.units import J_PER_KWH, KMH_PER_MPS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AT_STATION_M = 1.0


class PlanArguments(NamedTuple):
    """Arguments common to all plans.

    Attributes:
        trainset: Loaded trainset.
        options: Objective and limits.
        out: Folder for the results, if any.
        as_json: JSON instead of tables.
    """

    trainset: Trainset
    options: PlanOptions
    out: Path | None
    as_json: bool


def run(asked: PlanArguments, section: Section, time_s: float | None) -> int:
    """One run between two stations."""
    from metropilot.evaluate import plan_figure

    time_s = time_s if time_s is not None else section.planned_time_s
    if time_s is None:
        raise InputError(
            f"the line plans no running time for {section.name}; give one", field="time_s", allowed="> 0 s"
        )
    with show_activity(f"planning {section.name}"):
        fastest = minimum_running_time(section, asked.trainset)
        check_running_time(time_s, fastest)
        plan = optimal_plan(section, asked.trainset, time_s, asked.options)
    values = {
        "line": section.line_id,
        "origin": section.origin.code,
        "destination": section.destination.code,
        "trainset": asked.trainset.id,
        "load": asked.trainset.load,
        "scheduled_time_s": time_s,
        "minimum_running_time_s": fastest,
        **summary(plan, asked.options),
    }

    def screen() -> None:
        head = (
            f"{section.line_id} {section.origin.code} → {section.destination.code}, {section.length_m:.0f} m"
        )
        rows = [
            (
                "running time",
                number(plan.running_time_s, 2, "s"),
                f"asked {time_s:g} s, minimum {round_up_time(fastest):.2f} s",
            ),
            *energy_rows(plan, asked.options),
        ]
        title = f"{head}, {asked.trainset.id} {asked.trainset.load}"
        console().print(table(title, ("optimal plan", "value", ""), rows, right=(1,)))

    return deliver(asked, values, screen, plan, lambda: plan_figure(section, asked.trainset, plan))


def energy_rows(plan: Plan, options: PlanOptions) -> list[tuple[str, str, str]]:
    """Rows of energy, certificate and price of a second."""
    where = "at the wheel" if options.objective == "wheel" else "net at the line"
    return [
        (f"energy {where}", number(plan.energy_j / J_PER_KWH, 3, "kWh"), f"passes {plan.passes}"),
        (
            "lower bound",
            number(plan.bound_j / J_PER_KWH, 3, "kWh"),
            f"certificate gap {100 * plan.gap:.4f} %",
        ),
        ("one more second saves", number(plan.second_w / 1000, 1, "kJ"), ""),
        ("highest speed", number(KMH_PER_MPS * float(plan.speed_mps.max()), 1, "km/h"), ""),
    ]


def summary(plan: Plan, options: PlanOptions) -> dict[str, Any]:
    """A plan as plain values."""
    return {
        "objective": options.objective,
        "running_time_s": plan.running_time_s,
        "energy_kwh": plan.energy_j / J_PER_KWH,
        "energy_wheel_kwh": plan.energy_wheel_j / J_PER_KWH,
        "bound_kwh": plan.bound_j / J_PER_KWH,
        "certificate_gap_percent": 100 * plan.gap,
        "tightness": plan.tightness,
        "second_j": plan.second_w,
        "profile": {
            "position_m": plan.position_m.tolist(),
            "time_s": plan.time_s.tolist(),
            "speed_mps": plan.speed_mps.tolist(),
            "traction_n": plan.traction_n.tolist(),
            "brake_n": plan.brake_n.tolist(),
        },
    }


def deliver(
    asked: PlanArguments,
    values: dict[str, Any],
    screen: Callable[[], None],
    plan: Plan | None,
    draw: Callable[[], Figure],
) -> int:
    """Write the requested files, then print."""
    written = []
    if asked.out is not None:
        from metropilot.evaluate import save_figure

        with fill_folder(asked.out) as scratch:
            write_json(scratch / "plan.json", values)
            if plan is not None:
                write_profile(scratch / "plan.csv", plan)
            save_figure(draw(), scratch / "plan")
            written = sorted(path.name for path in scratch.iterdir())
    if asked.as_json:
        print_json(values)
        return 0
    screen()
    if written:
        console().print(f"Written to {asked.out}: {' '.join(written)}")
    return 0


def write_profile(path: Path, plan: Plan) -> None:
    """Write the plan node by node; a force holds to the next node."""
    rows = ["position_m,time_s,speed_mps,traction_n,brake_n"]
    forces = zip([*plan.traction_n.tolist(), 0.0], [*plan.brake_n.tolist(), 0.0], strict=True)
    nodes = zip(plan.position_m.tolist(), plan.time_s.tolist(), plan.speed_mps.tolist(), forces, strict=True)
    rows += [f"{x},{t},{v},{f},{b}" for x, t, v, (f, b) in nodes]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def front(asked: PlanArguments, section: Section) -> int:
    """Optimal energy over running time."""
    from metropilot.evaluate import front_figure

    with show_activity(f"planning {section.name} at twelve running times"):
        found = time_energy_front(section, asked.trainset, options=asked.options)
        usual = section.planned_time_s
        if usual is not None and not found.time_s[0] <= usual <= found.time_s[-1]:
            usual = None
        planned = None if usual is None else optimal_plan(section, asked.trainset, usual, asked.options)
    points = [
        {
            "time_s": p.running_time_s,
            "over_minimum": t / found.minimum_s,
            "energy_kwh": p.energy_j / J_PER_KWH,
            "bound_kwh": p.bound_j / J_PER_KWH,
            "certificate_gap_percent": 100 * p.gap,
            "second_j": p.second_w,
        }
        for t, p in zip(found.time_s.tolist(), found.plans, strict=True)
    ]
    values = {
        "line": section.line_id,
        "origin": section.origin.code,
        "destination": section.destination.code,
        "trainset": asked.trainset.id,
        "load": asked.trainset.load,
        "objective": asked.options.objective,
        "minimum_running_time_s": found.minimum_s,
        "planned_time_s": section.planned_time_s,
        "front": points,
    }

    def screen() -> None:
        rows = [
            (
                number(p["time_s"], 1),
                number(p["over_minimum"], 3),
                number(p["energy_kwh"], 3),
                number(p["certificate_gap_percent"], 4),
                number(p["second_j"] / 1000, 1),
            )
            for p in points
        ]
        columns = ("running time s", "of minimum", "energy kWh", "certificate gap %", "a second saves kJ")
        title = f"{section.line_id} {section.name}, {asked.trainset.id} {asked.trainset.load}"
        console().print(table(f"{title}, minimum {found.minimum_s:.1f} s", columns, rows, right=range(5)))

    words = f"{asked.trainset.id} {asked.trainset.load}"
    return deliver(
        asked,
        values,
        screen,
        None,
        lambda: front_figure(section, found, planned, words, asked.options.objective),
    )


def timetable(asked: PlanArguments, line: Line, path: Path) -> int:
    """A journey with the timing points of a file."""
    wanted = load_journey(path)
    wanted.check_line(line)
    ends = [_station_at(line, point.position_m, path) for point in (wanted.points[0], wanted.points[-1])]
    named = rename_fields({"slowest": "slowest"}, path)
    with show_activity(f"planning the journey {wanted.id}"), named:
        found = plan_journey(
            line,
            asked.trainset,
            journey_waypoints(wanted),
            asked.options,
            origin=ends[0],
            destination=ends[1],
        )
    return _journey(asked, line, found, ends[0], ends[1])


def _station_at(line: Line, position_m: float, path: Path) -> Station:
    nearest = min(line.stations, key=lambda s: abs(s.position_m - position_m))
    if abs(nearest.position_m - position_m) > AT_STATION_M:
        raise InputError(
            f"a journey begins and ends at a station of {line.id}",
            file=path,
            field="position",
            value=position_m,
            unit="m",
            allowed=", ".join(f"{s.position_m:g} m ({s.code})" for s in line.stations),
        )
    return nearest


def journey(
    asked: PlanArguments, line: Line, ends: tuple[Station, Station] | None, total_s: float | None
) -> int:
    """The line's timetable, or its stations within a total time."""
    origin, destination = ends or (line.stations[0], line.stations[-1])
    waypoints = timetable_waypoints(line, origin, destination, total_s=total_s)
    named = {"journey": "timetable" if total_s is None else "time_s"}
    with show_activity(f"planning {origin.code} to {destination.code}"), rename_fields(named):
        found = plan_journey(
            line, asked.trainset, waypoints, asked.options, origin=origin, destination=destination
        )
    return _journey(asked, line, found, origin, destination)


def _journey(
    asked: PlanArguments, line: Line, found: JourneyPlan, origin: Station, destination: Station
) -> int:
    from metropilot.evaluate import plan_figure

    calls = [asdict(call) for call in found.calls]
    values = {
        "line": line.id,
        "origin": origin.code,
        "destination": destination.code,
        "trainset": asked.trainset.id,
        "load": asked.trainset.load,
        "calls": calls,
        **summary(found.plan, asked.options),
        # of a journey the time with its dwells, as asked for
        "running_time_s": found.calls[-1].arrival_s - found.calls[0].departure_s,
    }

    def screen() -> None:
        rows = [
            (
                c.name,
                number(c.position_m, 0),
                number(c.arrival_s, 1),
                number(c.departure_s, 1),
                number(c.running_time_s, 1),
                number(c.running_time_s / c.minimum_s if c.minimum_s else None, 3),
                number(c.energy_j / J_PER_KWH, 2),
            )
            for c in found.calls
        ]
        columns = ("at", "m", "arrival s", "departure s", "running time s", "of minimum", "wheel kWh")
        title = f"{line.id} {origin.code} → {destination.code}, {asked.trainset.id} {asked.trainset.load}"
        out = console()
        out.print(table(title, columns, rows, right=range(1, 7)))
        out.print(
            table("", ("whole journey", "value", ""), energy_rows(found.plan, asked.options), right=(1,))
        )

    section = line.section(origin, destination)
    return deliver(
        asked,
        values,
        screen,
        found.plan,
        lambda: plan_figure(section, asked.trainset, found.plan, found.calls),
    )

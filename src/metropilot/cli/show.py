"""`metropilot show`."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metropilot._registry import did_you_mean
from metropilot.cli import complete
from metropilot.cli import options as opt
from metropilot.cli.console import citations, console, heading, number, print_json, table
from metropilot.cli.show_learned import policy_json, read_policy, say_policy, show_learning_run, show_policy
from metropilot.errors import InputError
from metropilot.units import J_PER_KWH, KMH_PER_MPS

if TYPE_CHECKING:
    from metropilot._registry import Registry
    from metropilot.learn import RunRecord
    from metropilot.railway import Feeding, Journey, Line, Section, ServiceDay, Trainset

SPEEDS_KMH = (0.0, 20.0, 40.0, 60.0, 80.0)
EXAMPLES = {
    "show": (
        "metropilot show yizhuang",
        "metropilot show dkz32:AW2",
        "metropilot show optimal --json",
        "metropilot show follow_gap",
        "metropilot show drive",
    ),
}


def show_command(
    what: Annotated[
        str,
        typer.Argument(
            metavar="ID|PATH",
            autocompletion=complete.showable,
            help="Line, trainset, driver, follower, file, run or its folder.",
        ),
    ],
    as_json: opt.Json = False,
) -> int:
    """Show a line, a trainset, a driver, a policy or a run."""
    from metropilot.convoy import FOLLOWERS
    from metropilot.drivers import DRIVERS
    from metropilot.railway import list_lines, list_trainsets, load_line, load_trainset, parse_trainset

    if what in list_lines():
        return show_line(load_line(what), as_json=as_json)
    if parse_trainset(what).is_named:
        return show_trainset(load_trainset(what), as_json=as_json)
    for registry in (DRIVERS, FOLLOWERS):
        if what in registry:
            return show_driver(registry, what, as_json=as_json)
    if (Path(what) / "run.toml").is_file():
        return show_run_folder(Path(what), as_json=as_json)
    if Path(what).is_file() or Path(what).suffix in {".toml", ".json", ".safetensors"}:
        return show_file(Path(what), as_json=as_json)
    if (found := find_user_run(what)) is not None:
        return show_learning_run(*found, as_json=as_json)
    if Path(what).is_dir():
        raise InputError("no run in the folder", file=what, allowed="the folder of a run, with run.toml")
    known = (*list_lines(), *list_trainsets(), *DRIVERS.ids(), *FOLLOWERS.ids())
    raise InputError(
        f"unknown name{did_you_mean(what, known)}",
        field="show",
        value=what,
        allowed=", ".join(known) + ", a file or a run's folder",
    )


def find_user_run(what: str) -> tuple[RunRecord, Path] | None:
    """Find the user's learning run by its id or the beginning of its id, and its folder."""
    from metropilot._dirs import runs_folder
    from metropilot.learn import RunStore

    store = RunStore(runs_folder())
    try:
        record = store.show(what)
    except InputError:
        return None
    return record, store.folder(record.id)


def show_run_folder(folder: Path, *, as_json: bool) -> int:
    """Show the folder of a learning run or of a drive."""
    from metropilot.cli.learn import find_run
    from metropilot.learn import read_record

    if read_record(folder / "run.toml") is None:
        return show_run(folder, as_json=as_json)
    store, record = find_run(str(folder))
    return show_learning_run(record, store.folder(record.id), as_json=as_json)


def show_file(path: Path, *, as_json: bool) -> int:
    """Show a line, trainset, journey, feeding, day or policy file, or a `run.toml`."""
    from metropilot.railway import Feeding, Line, ServiceDay, Trainset, import_file

    if path.name == "run.toml":
        return show_run_folder(path.parent, as_json=as_json)
    if path.suffix == ".safetensors":
        return show_policy(read_policy(path), as_json=as_json)
    found = import_file(path)
    if isinstance(found, Line):
        code = show_line(found, as_json=as_json)
    elif isinstance(found, Trainset):
        code = show_trainset(found, as_json=as_json)
    elif isinstance(found, Feeding):
        code = show_feeding(found, as_json=as_json)
    elif isinstance(found, ServiceDay):
        code = show_day(found, as_json=as_json)
    else:
        code = show_journey(found, as_json=as_json)
    return code


def show_journey(found: Journey, *, as_json: bool) -> int:
    """Show timing points."""
    points = [dict(vars(p)) for p in found.points]
    if as_json:
        print_json({"kind": "journey", "id": found.id, "line": found.line_id, "points": points})
        return 0
    columns = tuple(points[0])
    rows = [[number(p[name], 1) for name in columns] for p in points]
    console().print(table(f"journey {found.id} on {found.line_id}", columns, rows, right=range(len(columns))))
    return 0


def section_row(section: Section, back: Section) -> dict[str, Any]:
    """Cells of one section of a line, with planned times in both directions."""
    window = section.limit_mps.window(0.0, section.length_m)
    slope = section.gradient_permil.window(0.0, section.length_m).value
    curves = [
        c for c in section.curves if c.curvature_start_per_m != 0 and -1e-9 <= c.from_m < section.length_m
    ]
    tightest = min((1 / abs(c.curvature_start_per_m) for c in curves), default=None)
    return {
        "section": section.name,
        "length_m": section.length_m,
        "planned_forward_s": section.planned_time_s,
        "planned_backward_s": back.planned_time_s,
        "limit_lowest_mps": float(window.value.min()),
        "limit_highest_mps": float(window.value.max()),
        "gradient_lowest_permil": float(slope.min()),
        "gradient_highest_permil": float(slope.max()),
        "curve_tightest_m": tightest,
    }


def show_line(line: Line, *, as_json: bool) -> int:
    """Show stations, sections, notes, sources."""
    forward, backward = line.sections(), line.sections(backward=True)[::-1]
    sections = [section_row(f, b) for f, b in zip(forward, backward, strict=True)]
    if as_json:
        stations = [dict(vars(s)) for s in line.stations]
        print_json(
            {
                "kind": "line",
                "id": line.id,
                "name": line.name,
                "stations": stations,
                "sections": sections,
                "dwell_s": list(line.dwell_s),
                "notes": list(line.notes),
                "unused": list(line.unused),
                "source": dict(line.source),
            }
        )
        return 0
    out = console()
    dwell = [None, *line.dwell_s, None] if line.dwell_s else [None] * len(line.stations)
    rows = [
        (s.code, s.name, s.pinyin, s.local_name, f"{s.position_m:.0f}", number(d, 0))
        for s, d in zip(line.stations, dwell, strict=True)
    ]
    out.print(table(line.name, ("code", "station", "pinyin", "", "m", "dwell s"), rows, right=(4, 5)))
    cells = [
        (
            r["section"],
            f"{r['length_m']:.0f}",
            f"{number(r['planned_forward_s'], 0)} / {number(r['planned_backward_s'], 0)}",
            f"{KMH_PER_MPS * r['limit_lowest_mps']:.0f} – {KMH_PER_MPS * r['limit_highest_mps']:.0f}",
            f"{r['gradient_lowest_permil']:+.1f} – {r['gradient_highest_permil']:+.1f}",
            number(r["curve_tightest_m"], 0),
        )
        for r in sections
    ]
    columns = (
        "section",
        "length m",
        "planned s, there / back",
        "limit km/h",
        "gradient ‰",
        "tightest curve m",
    )
    out.print(table("", columns, cells, right=range(1, 6)))
    heading(out, "notes", line.notes)
    heading(out, "read but unused", line.unused)
    citations(out, line.source)
    return 0


def show_feeding(feeding: Feeding, *, as_json: bool) -> int:
    """Show substations, rails, limits, notes, sources."""
    from dataclasses import asdict

    if as_json:
        print_json({"kind": "feeding", **asdict(feeding)})
        return 0
    out = console()
    columns = ("substation", "m", "no load V", "inner mohm", "inverter V")
    rows = [
        (
            s.name,
            f"{s.position_m:.0f}",
            f"{s.no_load_v:.0f}",
            number(1000.0 * s.resistance_ohm, 1),
            number(s.inverter_v, 0),
        )
        for s in feeding.substations
    ]
    out.print(table(feeding.name, columns, rows, right=range(1, 5)))
    conductor, running = (1e6 * r for r in (feeding.conductor_ohm_per_m, feeding.running_ohm_per_m))
    out.print(
        f"Rails of a track {conductor:g} + {running:g} mohm/km; trains draw {feeding.max_current_a:g} A "
        f"at most above {feeding.reduced_below_v:g} V, nothing at {feeding.cut_off_v:g} V; they return "
        f"all below {feeding.squeezed_above_v:g} V, nothing at {feeding.max_v:g} V."
    )
    for each in (*feeding.storages, *(() if feeding.onboard is None else (feeding.onboard,))):
        where = each.name if each is feeding.onboard else f"{each.name} at {each.position_m:.0f} m"
        out.print(
            f"Storage {where}: {each.capacity_j / J_PER_KWH:g} kWh, {each.power_w / 1000.0:g} kW, charged "
            f"above {each.charge_above_v:g} V, discharged below {each.discharge_below_v:g} V."
        )
    heading(out, "notes", feeding.notes)
    citations(out, feeding.source)
    return 0


def show_day(day: ServiceDay, *, as_json: bool) -> int:
    """Show periods, trains, notes, sources."""
    from dataclasses import asdict

    from metropilot.units import format_clock

    if as_json:
        print_json({"kind": "day", **asdict(day)})
        return 0
    out = console()
    rows = [
        (p.name, format_clock(p.from_s), format_clock(p.to_s), f"{p.headway_s}", number(p.dwell_s, 0))
        for p in day.periods
    ]
    out.print(table(day.name, ("period", "from", "to", "headway s", "dwell s"), rows, right=range(1, 5)))
    fleet = "as many trains as it takes" if day.fleet is None else f"{day.fleet} trains"
    out.print(f"{fleet}; one that would wait more than {day.longest_wait_s} s goes to the depot.")
    heading(out, "notes", day.notes)
    citations(out, day.source)
    return 0


def show_trainset(t: Trainset, *, as_json: bool) -> int:
    """Show masses, effort at some speeds, notes, sources."""
    import numpy as np

    speeds = np.array(SPEEDS_KMH) / KMH_PER_MPS
    a, b, c = t.davis.newtons(t.mass_kg)
    resistance = a + speeds * (b + speeds * c)
    effort = {
        "speed_mps": speeds.tolist(),
        "traction_n": t.traction.at(speeds).tolist(),
        "electric_brake_n": t.electric_brake.at(speeds).tolist(),
        "davis_n": resistance.tolist(),
    }
    if as_json:
        print_json(
            {
                "kind": "trainset",
                "id": t.id,
                "name": t.name,
                "loads_kg": dict(t.loads),
                "load": t.load,
                "mass_kg": t.mass_kg,
                "effective_mass_kg": t.effective_mass_kg,
                "length_m": t.length_m,
                "max_speed_mps": t.max_speed_mps,
                "max_acceleration_mps2": t.max_acceleration_mps2,
                "max_deceleration_mps2": t.max_deceleration_mps2,
                "actuation": dict(vars(t.actuation)),
                "effort": effort,
                "notes": list(t.notes),
                "unused": list(t.unused),
                "source": dict(t.source),
            }
        )
        return 0
    out = console()
    masses = [(name, f"{kg / 1000:.3f}", "aboard" if name == t.load else "") for name, kg in t.loads.items()]
    out.print(table(t.name, ("load", "mass t", ""), masses, right=(1,)))
    rows = [
        (
            f"{kmh:g}",
            *(f"{effort[name][k] / 1000:.1f}" for name in ("traction_n", "electric_brake_n", "davis_n")),
        )
        for k, kmh in enumerate(SPEEDS_KMH)
    ]
    columns = ("speed km/h", "traction kN", "electric brake kN", "Davis kN")
    out.print(table(f"effort, {t.load}", columns, rows, right=range(4)))
    heading(out, "in service", _service(t))
    heading(out, "notes", t.notes)
    heading(out, "read but unused", t.unused)
    citations(out, t.source)
    return 0


def _service(t: Trainset) -> list[str]:
    jerk = t.actuation.jerk_limit_mps3
    top, rotating = KMH_PER_MPS * t.max_speed_mps, 100 * t.rotating_fraction
    up, down = t.max_acceleration_mps2, t.max_deceleration_mps2
    smooth = "jerk without limit" if jerk == float("inf") else f"jerk up to {jerk:g} m/s³"
    friction, aboard = t.friction_brake_n / 1000, t.auxiliary_w / 1000
    return [
        f"length {t.length_m:g} m, top speed {top:g} km/h, rotating mass {rotating:g} %",
        f"acceleration up to {up:g} m/s², deceleration up to {down:g} m/s²",
        f"{smooth}, delay {t.actuation.delay_s:g} s, lag {t.actuation.lag_s:g} s",
        f"friction brake {friction:g} kN, receptivity {100 * t.receptivity:g} %, auxiliaries {aboard:g} kW",
        f"curve resistance {t.curve_formula}",
    ]


def show_driver(registry: Registry[Any], driver_id: str, *, as_json: bool) -> int:
    """Show description and options of a driver or of a follower in a convoy."""
    import inspect

    from metropilot.evaluate import option_defaults
    from metropilot.policy import shipped_policy

    driver, row = registry.get(driver_id), registry.row(driver_id)
    text = inspect.getdoc(driver) or ""
    taken = option_defaults(driver)
    path = shipped_policy(driver_id)
    file = read_policy(path) if path.is_file() else None
    if as_json:
        print_json(
            {
                "kind": registry.kind,
                "id": driver_id,
                "summary": row.summary,
                "source": row.source,
                "options": taken,
                "text": text,
            }
            | ({"policy": policy_json(file)} if file else {})
        )
        return 0
    out = console()
    out.print(f"{driver_id}: {row.summary}", style="bold")
    out.print(f"source: {row.source}")
    heading(out, "options (--set NAME=VALUE)", [f"{name} = {value}" for name, value in taken.items()])
    heading(out, "in full", text.splitlines())
    if file:
        say_policy(file)
    return 0


def show_run(folder: Path, *, as_json: bool) -> int:
    """Show request and result of a drive."""
    try:
        asked = tomllib.loads((folder / "run.toml").read_text(encoding="utf-8"))
        name = "kpis.json" if (folder / "kpis.json").is_file() else "comparison.json"
        kpis = json.loads((folder / name).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"not the folder of a run ({error})", file=folder) from None
    if not isinstance(kpis, dict) or not isinstance(asked.get("run", {}), dict):
        raise InputError("not the folder of a run (no table of a request or of results)", file=folder)
    if as_json:
        print_json({"kind": "run", "folder": str(folder), **asked, "result": kpis})
        return 0
    out = console()
    told = [(key, json.dumps(value, ensure_ascii=False)) for key, value in asked.get("run", {}).items()]
    out.print(table(f"{folder}", ("run", ""), told))
    kpis = {k: ", ".join(v) or None if k == "failed" else v for k, v in kpis.items()}
    flat = [(key, _value(value)) for key, value in kpis.items() if not isinstance(value, dict | list)]
    out.print(table("", ("KPI", ""), flat, right=(1,)))
    return 0


def _value(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else "–" if value is None else str(value)

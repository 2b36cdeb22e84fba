"""`metropilot drive`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metropilot.cli import options as opt
from metropilot.cli.console import console, number, print_json, requirements, show_activity, table
from metropilot.units import KMH_PER_MPS

if TYPE_CHECKING:
    from metropilot.evaluate import Kpis, RunSpec
EXAMPLES = {
    "drive": (
        "metropilot drive yizhuang RJ WYJ --time 101 --out drive",
        "metropilot drive yizhuang rongjing wanyuan --load AW2 --mass-factor 1.2 --speed-noise 0.05",
        "metropilot drive yizhuang RJ WYJ --time 101 --restriction 400-600@40@30 --arrive 116@30",
        "metropilot drive --from drive/run.toml",
    ),
}


@opt.with_run_options()
def drive_command(
    line: Annotated[str | None, opt.LINE] = None,
    origin: Annotated[str | None, opt.ORIGIN] = None,
    destination: Annotated[str | None, opt.DESTINATION] = None,
    again: Annotated[
        Path | None, typer.Option("--from", metavar="RUN.TOML", help="Repeat the run of this file.")
    ] = None,
    out: opt.Out = None,
    as_json: opt.Json = False,
    **given: Any,  # noqa: ANN401 (the fields of a run)
) -> int:
    """Drive one run under protection and report it.

    Exit code 0: every requirement shown was met; 1: not; 2: invalid input.
    """
    from metropilot.evaluate import RunSpec, in_run_toml, run_from_toml

    opt.check_source(again, "run.toml", line, origin, destination)
    if again is not None:
        spec = run_from_toml(again)
        with in_run_toml(again):
            return run_and_report(spec, out, as_json=as_json)
    spec = RunSpec.from_values({"line": line, "origin": origin, "destination": destination, **given})
    return run_and_report(spec, out, as_json=as_json)


def run_and_report(request: RunSpec, out: Path | None, *, as_json: bool) -> int:
    """Drive, print and write; return the exit code."""
    from metropilot._io import check_writable
    from metropilot.evaluate import kpis_of, optimum_of, write_run
    from metropilot.sim import drive

    if out is not None:
        check_writable(out)
    run, driver = request.run(), request.make_driver()
    with show_activity(f"driving {run.section.name} with {request.driver}"):
        drive_ = drive(run, driver)
        optimum = optimum_of(drive_, request.objective)
        kpis = kpis_of(drive_, optimum, request.objective)
    if out is not None:
        with show_activity(f"writing {out}"):
            write_run(out, request, drive_, kpis, optimum)
    if as_json:
        print_json(kpis.as_dict())
    else:
        report(request, kpis)
        if out is not None:
            console().print(f"Written to {out}: trajectory.csv kpis.json profile.svg profile.png run.toml")
    return 0 if kpis.success else 1


def report(request: RunSpec, kpis: Kpis) -> None:
    """Print the drive: requirements and KPIs."""
    from metropilot.evaluate import checks, verdict

    out = console()
    known = request.resolve()
    where = f"{known.line} {known.origin} → {known.destination}"
    out.print(
        f"{where}, {known.trainset} {known.load}, driver {known.driver}: {verdict(kpis)}",
        style="bold" if kpis.success else "bold red",
    )
    out.print(requirements(checks(kpis)))
    out.print(table("", ("KPI", "value", ""), rows(kpis), right=(1,)))


def rows(kpis: Kpis) -> list[tuple[str, str, str]]:
    """Rows of the printed KPIs: name, value with unit, remark."""
    from metropilot.planning import round_up_time

    share, gap = kpis.optimality_gap_percent, kpis.certificate_gap_percent
    objective = "at the wheel" if kpis.energy_objective == "wheel" else "net at the line"
    certificate = "" if gap is None else f"certified within {max(gap, 0.001):.3f} %"
    least = kpis.minimum_running_time_s
    fastest = number(None if least is None else round_up_time(least), 2, "s")
    protected = kpis.protected_running_time_s
    if protected is not None and protected > kpis.scheduled_time_s:
        fastest += f", under protection {number(round_up_time(protected), 2, 's')}"
    return [
        (
            "running time",
            number(kpis.running_time_s, 1, "s"),
            f"scheduled {kpis.scheduled_time_s:g} s, minimum {fastest}",
        ),
        ("energy at the wheel", number(kpis.energy_wheel_kwh, 2, "kWh"), "traction"),
        (
            "energy at the line",
            number(kpis.energy_line_kwh, 2, "kWh"),
            f"net of {kpis.energy_regenerated_kwh:.2f} kWh regenerated",
        ),
        (f"optimum {objective}", number(kpis.optimal_energy_kwh, 2, "kWh"), certificate),
        ("above the optimum", number(share, 2, "%"), "for the running time achieved"),
        *attainable_rows(kpis),
        ("highest speed", number(KMH_PER_MPS * kpis.max_speed_mps, 1, "km/h"), ""),
        (
            "acceleration",
            f"{kpis.max_acceleration_mps2:+.2f} / {-kpis.max_deceleration_mps2:+.2f} m/s²",
            f"r.m.s. {kpis.rms_acceleration_mps2:.2f} m/s²: {kpis.comfort_band}",
        ),
        ("change within 2 s", number(kpis.jerk_cheng2023_mps3, 2, "m/s²"), "jerk as in Cheng23"),
        ("sum of command changes", number(kpis.comfort_huang2025, 2), "comfort as in Huang25"),
        ("coasting", number(kpis.coasting_distance_m, 0, "m"), f"{kpis.regime_switches} changes of regime"),
        ("decision time", number(kpis.decision_time_us_median, 0, "µs"), "median"),
    ]


def attainable_rows(kpis: Kpis) -> list[tuple[str, str, str]]:
    """Rows of what the trainset can attain, and of the gap split into trainset and driver."""
    if kpis.attainable_energy_kwh is None:
        return []
    about = f"with jerk limit, dead time, lag and protection; at least {kpis.attainable_bound_kwh:.2f} kWh"
    return [
        ("attainable", number(kpis.attainable_energy_kwh, 2, "kWh"), about),
        ("lost by the trainset", number(kpis.trainset_gap_percent, 2, "%"), "attainable above the optimum"),
        ("lost by the driver", number(kpis.driver_gap_percent, 2, "%"), "this run above the attainable"),
    ]

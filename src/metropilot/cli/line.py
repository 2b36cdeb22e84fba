"""`metropilot line`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metropilot.cli import complete
from metropilot.cli import options as opt
from metropilot.cli.console import console, number, print_json, show_activity, table
from metropilot.cli.line_day import (
    DayRequest,
    check_day_options,
    compute_day,
    energy_cells,
    make_scatter,
    print_day,
    print_scatter,
)
from metropilot.errors import InputError
from metropilot.operation import OperationOptions

if TYPE_CHECKING:
    from metropilot.operation import FeedingEnergy, LineOperation, OperationEnergy
    from metropilot.railway import Feeding, Line

EXAMPLES = {
    "line": (
        "metropilot line yizhuang --headway 180 --zones 4",
        "metropilot line yizhuang --headway 180 --feeding yizhuang",
        "metropilot line yizhuang --day yizhuang --feeding yizhuang",
        "metropilot line yizhuang --headway 300 --optimise --time-window 1 --out line --json",
    ),
}
OPERATION = "Operation"
OF_DAY = ("headway_s",)
OF_TIMETABLE = (*OF_DAY, "dwell_s", "dwell_window_s", "time_window_s")
"""Options without effect where a day, or its timetable, is given."""


@opt.with_run_options(only=("trainset", "load"), more=opt.options_of(OperationOptions, OPERATION))
def line_command(
    context: Any,  # noqa: ANN401 (typer.Context, as far as typer knows)
    line: opt.LineArgument,
    optimise: Annotated[
        bool,
        typer.Option(
            "--optimise",
            help="Search dwells and running times too, not only the offset of the directions.",
            rich_help_panel=OPERATION,
        ),
    ] = False,
    sharp: Annotated[
        bool,
        typer.Option(
            "--sharp",
            help="Sharpen the floor where each section is a zone, in minutes.",
            rich_help_panel=OPERATION,
        ),
    ] = False,
    seed: Annotated[int, typer.Option(help="Seed of the search.", min=0, rich_help_panel=OPERATION)] = 0,
    day: Annotated[
        str | None,
        typer.Option(
            help="Working day, instead of one headway: its journeys, trains and energy by hours.",
            metavar="ID|FILE",
            rich_help_panel=OPERATION,
        ),
    ] = None,
    timetable: Annotated[
        Path | None,
        typer.Option(
            help="Timetable of a day from a GTFS feed, instead of one that is found.",
            metavar="FOLDER|FILE.zip",
            rich_help_panel=OPERATION,
        ),
    ] = None,
    service: Annotated[
        str | None,
        typer.Option(help="Service of that feed, where it has several.", rich_help_panel=OPERATION),
    ] = None,
    driver: Annotated[
        str | None,
        typer.Option(
            help="A driver who drives every trip besides; see `metropilot drivers`.",
            metavar="ID",
            autocompletion=complete.drivers,
            rich_help_panel=OPERATION,
        ),
    ] = None,
    runs: Annotated[
        int,
        typer.Option(
            help="Runs of every trip by that driver, by seeds.", min=1, max=100, rich_help_panel=OPERATION
        ),
    ] = 1,
    scatter: Annotated[
        float | None,
        typer.Option(
            help="Departures that move by up to so many seconds either way, evenly drawn.",
            metavar="S",
            min=0.0,
            max=300.0,
            rich_help_panel=OPERATION,
        ),
    ] = None,
    feeding: Annotated[
        str | None,
        typer.Option(
            help="DC network that feeds the trains; --optimise seeks the timetable for it.",
            metavar="ID|FILE",
            rich_help_panel=OPERATION,
        ),
    ] = None,
    out: opt.Out = None,
    as_json: opt.Json = False,
    **given: Any,  # noqa: ANN401 (the fields of an operation and of a run)
) -> int:
    """Compute the energy of all trains of a line, beside its floor.

    Braking trains feed those that draw at the same moment in the same feeding zone. Energies are those of all
    trains in one headway, which is one train's in a round trip, or those of a day. Exit code 0: computed; 2:
    invalid input.
    """
    from metropilot._io import check_writable
    from metropilot.operation import LineOperation, feed_line, operation_energy, write_operation
    from metropilot.railway import load_feeding, load_line, load_trainset

    request = DayRequest(day, timetable, service, driver, runs, scatter, optimise, seed)
    check_day_options(request)
    _check_given_options(context, request, sharp=sharp)
    loaded = load_line(line)
    given |= OperationOptions.fitting(
        loaded, {key: given[key] for key in given if opt.is_typed(context, key)}
    )
    _check_without_effect(request, loaded, given)
    typed = {"line": line, **given, **vars(request), "feeding": feeding}
    trainset = load_trainset(given.pop("trainset"), given.pop("load"))
    operation = LineOperation(loaded, trainset, OperationOptions(**given))
    network = None if feeding is None else load_feeding(feeding)
    if network is not None:
        network.check_line(operation.line)
    of_day = day is not None or timetable is not None
    if out is not None:
        check_writable(out, "day.json" if of_day else "line.json")
    if of_day:
        for name in OF_DAY if timetable is None else OF_TIMETABLE:
            del typed[name]
        return _run_day(operation, request, network, typed, out, as_json=as_json)
    with show_activity(f"planning {len(operation.trips)} trips and their timetable"):
        found = operation_energy(
            operation,
            searched=optimise,
            seed=seed,
            feeding=network,
            sharp=sharp,
            scatter=make_scatter(operation, request),
        )
        fed = None if network is None else feed_line(operation, found.timetable, found.profiles, network)
    if out is not None:
        write_operation(out, found, fed)
    if as_json:
        print_json(found.as_dict(fed))
        return 0
    _print(found)
    if fed is not None:
        _print_network(found, fed)
    print_scatter(found)
    if out is not None:
        files = "line.json timetable.csv trains.svg trains.png power.svg power.png"
        files += "" if fed is None else " voltage.svg voltage.png"
        console().print(f"Written to {out}: {files}")
    return 0


def _check_given_options(
    context: Any,  # noqa: ANN401 (typer.Context, as far as typer knows)
    request: DayRequest,
    *,
    sharp: bool,
) -> None:
    """Refuse an option of what a day or a timetable has by itself.

    Raises:
        InputError: Such an option is typed.
    """
    if request.day is None and request.timetable is None:
        return
    if sharp:
        raise InputError("a day has no sharp floor", field="sharp", allowed="with a headway")
    for name in OF_DAY:
        if opt.is_typed(context, name):
            raise InputError("a day has its own headways", field=name, allowed="without a day")
    for name in OF_TIMETABLE if request.timetable is not None else ():
        if opt.is_typed(context, name):
            words = "a timetable that is given has its own dwells and running times"
            raise InputError(words, field=name, allowed="without --timetable")


def _check_without_effect(request: DayRequest, line: Line, given: Mapping[str, Any]) -> None:
    """Refuse an option that alters nothing, but with its usual value: so `run.toml` has it.

    Raises:
        InputError: Such an option is given.
    """
    if not request.optimise:
        usual = {"time_window_s": OperationOptions.time_window_s}
        usual |= OperationOptions.fitting(line, {"zones": 1, "dwell_s": given["dwell_s"]})
        for name, window_s in usual.items():
            # without a search no dwell and no running time moves
            if given[name] not in (window_s, 0):
                raise InputError(
                    "needs a search of dwells and running times",
                    field=name,
                    value=given[name],
                    unit="s",
                    allowed="--optimise",
                )
        if request.seed and request.driver is None and request.scatter is None:
            allowed = "--optimise, --driver or --scatter"
            raise InputError("nothing is drawn at random", field="seed", value=request.seed, allowed=allowed)
    both = (*line.sections(), *line.sections(backward=True))
    if given["reserve"] != OperationOptions.reserve and (
        request.timetable is not None or all(each.planned_time_s is not None for each in both)
    ):
        raise InputError(
            "the running times are given",
            field="reserve",
            value=given["reserve"],
            allowed="a line without planned times",
        )


def _run_day(
    operation: LineOperation,
    request: DayRequest,
    network: Feeding | None,
    typed: dict[str, Any],
    out: Path | None,
    *,
    as_json: bool,
) -> int:
    from metropilot.operation import feed_day, write_day

    with show_activity(f"planning {len(operation.trips)} trips and the timetable of a day"):
        found = compute_day(operation, request)
        fed = None if network is None else feed_day(found.day, network, found.links)
    if out is not None:
        write_day(out, found, typed, fed)
    if as_json:
        print_json(found.as_dict(fed))
        return 0
    print_day(found, fed)
    if out is not None:
        files = "day.json run.toml timetable.csv timetable.parquet gtfs.zip"
        files += " trains.svg trains.png power.svg power.png"
        files += "" if fed is None else " voltage.svg voltage.png"
        console().print(f"Written to {out}: {files}")
    return 0


def _print(found: OperationEnergy) -> None:
    operation = found.operation
    options, trainset = operation.options, operation.trainset
    rows = [
        ("cruise and brake", "plain, mean offset", found.cruise_kwh),
        ("optimal driving", "plain, mean offset", found.driving_only_kwh),
        ("cruise and brake", "best found", found.timetable_only_kwh),
        ("optimal driving", "best found", found.energy_kwh),
        ("floor", "any", found.floor_kwh),
        ("floor, all received", "any", found.all_received_floor_kwh),
    ]
    cells = energy_cells(found, rows, 1)
    zones = f"{options.zones} feeding zone{'s' * (options.zones > 1)}"
    title = (
        f"{operation.line.id}, {trainset.id} {trainset.load}, every {options.headway_s} s, {zones}; "
        f"{operation.fleet(found.timetable)} trains"
    )
    columns = ("driving", "timetable", "kWh a round trip", "saved %", "gap %")
    console().print(table(title, columns, cells, right=(2, 3, 4)))
    least = max((each.bottleneck for each in found.headways()), key=lambda each: each.headway_s)
    console().print(
        f"Least technical headway {least.headway_s:.1f} s, at {least.kind} {least.name}, messages "
        f"{options.age_s:g} s old."
    )
    if not found.searched:
        console().print(
            "Best found: offset of the directions alone; --optimise searches dwells and running times."
        )


def _print_network(found: OperationEnergy, fed: FeedingEnergy) -> None:
    told = found.as_dict(fed)["feeding"]["network"]
    rows = [
        (
            each["name"],
            f"{each['position_m']:.0f}",
            number(each["supplied_kwh"], 1),
            number(each["mean_w"] / 1e6, 2),
            number(each["peak_w"] / 1e6, 2),
            number(each["lowest_v"], 0),
        )
        for each in told["substations"]
    ]
    title = f"feeding {told['id']}: {told['energy_kwh']:.1f} kWh a round trip"
    columns = ("substation", "m", "kWh", "mean MW", "peak MW", "lowest V")
    console().print(table(title, columns, rows, right=range(1, 6)))
    sought = "zones_timetable_kwh" in told
    names = ("cruise", "driving_only"), ("timetable_only", "zones_timetable" if sought else "energy")
    known = [[told[f"{name}_kwh"] for name in each] for each in names]
    plain, found_for = ([number(kwh, 1) for kwh in each] for each in known)
    console().print(
        f"Here cruise and brake takes {plain[0]} kWh with the plain timetable and {found_for[0]} with the "
        f"one found for the zones, optimal driving {plain[1]} and {found_for[1]}."
    )
    if None in (*known[0], *known[1]):
        console().print("–: the network cannot carry that load.")
    if sought:
        console().print(
            f"Optimal driving takes {told['energy_kwh']:.1f} kWh with the timetable sought on the network."
        )
    stores = [*told.get("storages", ()), *([told["onboard_storage"]] if "onboard_storage" in told else [])]
    if stores:
        charged, discharged = (sum(each[f"{way}charged_kwh"] for each in stores) for way in ("", "dis"))
        console().print(f"Storages take {charged:.1f} kWh and give back {discharged:.1f}.")
    inverted = f"; inverters return {told['inverted_kwh']:.1f}" if told["inverted_kwh"] else ""
    console().print(
        f"Trains draw {told['drawn_kwh']:.1f} kWh and return {told['returned_kwh']:.1f}, "
        f"{told['squeezed_kwh']:.1f} less than they could{inverted}. Lost in the rails "
        f"{told['rail_loss_kwh']:.1f}, in substations {told['substation_loss_kwh']:.1f}. Lowest voltage "
        f"{told['lowest_v']:.0f} V at {told['lowest_position_m']:.0f} m in second {told['lowest_second']}; "
        f"peak of all substations {told['peak_w'] / 1e6:.1f} MW."
    )

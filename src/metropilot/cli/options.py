"""Arguments and options that several commands share: declared once, documented once."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from metropilot.cli import complete

if TYPE_CHECKING:
    from metropilot.evaluate import Request

ABOUT, WORLD, OUTPUT = "What to drive", "Disturbances", "Output"

LINE = typer.Argument(
    help="Line: catalogue id or path to a .toml or .json file.", autocompletion=complete.lines
)
ORIGIN = typer.Argument(help="Station of departure: code or name.", autocompletion=complete.stations)
DESTINATION = typer.Argument(help="Station of arrival: code or name.", autocompletion=complete.stations)
LineArgument = Annotated[str, LINE]
OriginArgument = Annotated[str, ORIGIN]
DestinationArgument = Annotated[str, DESTINATION]
Time = Annotated[
    float | None,
    typer.Option(
        "--time", help="Running time, s; the line's planned time if not given.", rich_help_panel=ABOUT
    ),
]
TrainsetOption = Annotated[
    str,
    typer.Option(
        help="Trainset: catalogue id or path, with its load as ID:LOAD.",
        rich_help_panel=ABOUT,
        autocompletion=complete.trainsets,
    ),
]
Load = Annotated[str | None, typer.Option(help="Load aboard, e.g. AW2.", rich_help_panel=ABOUT)]
Driver = Annotated[
    str,
    typer.Option(
        help="Driver id; see `metropilot drivers`.",
        rich_help_panel=ABOUT,
        autocompletion=complete.drivers,
    ),
]
DriverOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="NAME=VALUE", help="Option of the driver; repeatable.", rich_help_panel=ABOUT
    ),
]
ObjectiveOption = Annotated[
    str, typer.Option(help="Energy to minimise: wheel or line.", rich_help_panel=ABOUT)
]
Period = Annotated[float, typer.Option("--dt", help="Control period, s.", rich_help_panel=ABOUT)]
Seed = Annotated[int, typer.Option(help="Seed of everything random.", rich_help_panel=WORLD)]
Ideal = Annotated[
    bool, typer.Option("--ideal", help="Ideal actuation: no delay, lag or jerk limit.", rich_help_panel=WORLD)
]
MassFactor = Annotated[float, typer.Option(help="True mass over nominal mass.", rich_help_panel=WORLD)]
ResistanceFactor = Annotated[
    float, typer.Option(help="True over nominal Davis resistance.", rich_help_panel=WORLD)
]
Delay = Annotated[
    float, typer.Option(help="Dead time in addition to the trainset's, s.", rich_help_panel=WORLD)
]
Lag = Annotated[float, typer.Option(help="Additional lag, s.", rich_help_panel=WORLD)]
SpeedNoise = Annotated[
    float, typer.Option(help="Standard deviation of the measured speed, m/s.", rich_help_panel=WORLD)
]
Headwind = Annotated[
    float, typer.Option(help="Wind from ahead, m/s; below 0 from behind.", rich_help_panel=WORLD)
]
Adhesion = Annotated[
    float,
    typer.Option(help="Traction over weight at which the wheels slip, e.g. 0.06.", rich_help_panel=WORLD),
]
Restrictions = Annotated[
    list[str] | None,
    typer.Option(
        "--restriction",
        metavar="FROM-TO@KMH[@T]",
        help="Temporary speed restriction, m from the origin and 5 to 400 km/h; @T: announced T s after "
        "departure.",
        rich_help_panel=WORLD,
    ),
]
Arrivals = Annotated[
    list[str] | None,
    typer.Option(
        "--arrive",
        metavar="S@T",
        help="New running time of S s, announced T s after departure.",
        rich_help_panel=WORLD,
    ),
]
Out = Annotated[Path | None, typer.Option(help="Folder for the results.", rich_help_panel=OUTPUT)]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.", rich_help_panel=OUTPUT)]


def request_of(**given: Any) -> Request:  # noqa: ANN401 (the fields of Request, one by one)
    """The run a command was asked for.

    Args:
        given: Fields of :class:`~metropilot.evaluate.Request`; lists that were not given are None.
    """
    from metropilot.evaluate import Request
    from metropilot.evaluate.driver_options import named_option

    given["restrictions"] = tuple(given.get("restrictions") or ())
    given["arrivals"] = tuple(given.get("arrivals") or ())
    given["options"] = dict(map(named_option, given.get("options") or ()))
    return Request(**given)

"""Interactive figures (Plotly) in the colours of the printed ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal

from metropilot.evaluate import BLACK, BLUE, GREEN, GREY, ORANGE, SERIES_STYLES, SKY, VERMILION, driver_styles
from metropilot.fit import NORMAL_95
from metropilot.units import J_PER_KWH, KMH_PER_MPS
from metropilot.web.words.language import N_, _
from metropilot.web.words.said import retell

DASHES = dict(
    zip(
        (dashes for _, dashes in SERIES_STYLES),
        ("solid", "dash", "dashdot", "dot", "longdashdot", "longdash", "2px,6px"),
        strict=True,
    )
)
"""Plotly's names of the printed line styles."""
SYMBOLS = dict(
    zip(DASHES, ("diamond", "square", "cross", "x", "triangle-up", "circle", "star"), strict=True),
)
"""Markers of the line styles, so that drivers of one colour stay distinct."""
INK = "#5a6673"
REMOVED = ["lasso2d", "select2d", "toImage"]
CONFIG = {"displaylogo": False, "responsive": True, "modeBarButtonsToRemove": REMOVED}
Figure = dict[str, Any]
Trace = dict[str, Any]


def figure(traces: Sequence[Trace], height: int, **layout: Any) -> Figure:  # noqa: ANN401 (Plotly's layout)
    """Make a figure with a transparent background, for light and dark pages."""
    base: dict[str, Any] = {
        "height": height,
        "margin": {"l": 58, "r": 14, "t": 34, "b": 44},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "font": {"size": 12, "color": INK},
        "legend": {"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom", "font": {"size": 12}},
        "hovermode": "x unified",
        "uirevision": "kept",
    }
    return {"data": list(traces), "layout": {**base, **layout}, "config": CONFIG}


def blank(height: int, words: str = "") -> Figure:
    """Make an empty figure of a height, with words; without, that it is being computed."""
    said = {
        "text": words or _("computing …"),
        "showarrow": False,
        "xref": "paper",
        "yref": "paper",
        "x": 0.5,
        "y": 0.5,
    }
    hidden = {"visible": False}
    return figure([], height, xaxis=hidden, yaxis=hidden, annotations=[said])


def axis(title: str, **more: Any) -> dict[str, Any]:  # noqa: ANN401 (Plotly's axis)
    """Make an axis with its unit."""
    return {"title": {"text": title, "standoff": 8}, "zeroline": False, "automargin": True, **more}


def line(
    name: str,
    x: Sequence[Any],
    y: Sequence[Any],
    colour: str,
    *,
    width: float = 2.0,
    **more: Any,  # noqa: ANN401
) -> Trace:
    """Make a line trace; ``dash`` and ``shape`` go into its ``line``."""
    return _scatter("line", name, x, y, {"color": colour, "width": width}, ("dash", "shape"), more)


def markers(name: str, x: Sequence[Any], y: Sequence[Any], colour: str, size: int = 10, **more: Any) -> Trace:  # noqa: ANN401
    """Make a trace of markers; ``symbol`` and ``line`` go into its ``marker``."""
    return _scatter("marker", name, x, y, {"color": colour, "size": size}, ("symbol", "line"), more)


def _scatter(
    part: Literal["line", "marker"],
    name: str,
    x: Sequence[Any],
    y: Sequence[Any],
    style: dict[str, Any],
    own: Sequence[str],
    more: dict[str, Any],
) -> Trace:
    """Trace of lines or of markers, with those of its further values that belong to their style."""
    style |= {key: more.pop(key) for key in own if key in more}
    return {
        "type": "scatter",
        "mode": f"{part}s",
        "name": name,
        "x": list(x),
        "y": list(y),
        part: style,
        **more,
    }


def kmh(speeds: Sequence[float]) -> list[float]:
    """Convert speeds to km/h."""
    return [round(v * KMH_PER_MPS, 3) for v in speeds]


def kwh(joules: Sequence[float]) -> list[float]:
    """Convert energies to kWh."""
    return [round(j / J_PER_KWH, 5) for j in joules]


def stairs(
    pieces: dict[str, list[float]], end: float, factor: float = 1.0
) -> tuple[list[float], list[float]]:
    """A piecewise-constant profile as positions and values for a stepped line."""
    values = [v * factor for v in pieces["value"]]
    return [*pieces["from_m"], end], [*values, values[-1]]


def run_figure() -> Figure:
    """Figure of a live run, filled by the browser: speeds and plan; command; time; energy."""
    head = {
        "type": "scatter",
        "mode": "markers",
        "x": [],
        "y": [],
        "marker": {"size": 10, "color": BLUE, "line": {"width": 2, "color": "#fff"}},
        "hoverinfo": "skip",
        "showlegend": False,
    }
    bar = {"mode": "lines+text", "textposition": "middle left", "textfont": {"size": 11}, "yaxis": "y4"}
    bar |= {"cliponaxis": False, "showlegend": False}
    traces = [
        line(_("speed limit"), [], [], BLACK, width=1.4, shape="hv"),
        line(_("permitted speed"), [], [], ORANGE, width=1.6, dash="dash"),
        line(_("optimal plan"), [], [], SKY, width=6.0, opacity=0.65),
        line(_("driven"), [], [], BLUE, width=2.2),
        markers(_("protection"), [], [], VERMILION, symbol="triangle-down"),
        head,
        line(_("command"), [], [], BLUE, width=1.4, shape="hv", fill="tozeroy", yaxis="y2", showlegend=False),
        line(_("plan's energy"), [], [], SKY, width=6.0, opacity=0.65, yaxis="y3", showlegend=False),
        line(_("energy at the wheel"), [], [], BLUE, yaxis="y3", showlegend=False),
        line(_("net at the line"), [], [], GREY, width=1.4, dash="dash", yaxis="y3"),
        line(_("plan of the true plant"), [], [], GREEN, dash="dash"),
        line(_("energy of the true plant"), [], [], GREEN, dash="dash", yaxis="y3", showlegend=False),
        line(_("optimal plan"), [], [], SKY, width=6.0, opacity=0.65, yaxis="y4", showlegend=False),
        line(_("driven"), [], [], BLUE, width=2.2, yaxis="y4", showlegend=False),
        line(_("plan of the true plant"), [], [], GREEN, dash="dash", yaxis="y4", showlegend=False),
        {**head, "yaxis": "y4"},
        line(_("scheduled arrival"), [], [], BLACK, width=3.0, **bar),
        line(_("not sent yet"), [], [], VERMILION, dash="dot", width=3.0, **bar),
    ]
    return figure(
        traces,
        690,
        xaxis=axis(_("distance (m)"), anchor="y3"),
        yaxis=axis(_("speed (km/h)"), domain=[0.578, 1.0], rangemode="tozero"),
        yaxis4=axis(_("time (s)"), domain=[0.206, 0.395], rangemode="tozero"),
        yaxis2=axis(
            _("command"),
            domain=[0.438, 0.533],
            range=[-1.1, 1.1],
            tickvals=[-1, 0, 1],
            ticktext=[_("brake"), "", _("power")],
        ),
        yaxis3=axis(_("energy (kWh)"), domain=[0.0, 0.163], rangemode="tozero"),
    ) | {"config": {**CONFIG, "edits": {"shapePosition": True}}}


ROW = "restriction-"
"""Beginning of the name of the rectangle of a restriction in the form; static/moments.js has it, too."""
BAR = 0.9
"""Begin of the bar of the arrival, which ends with the section, as a share of it; static/live.js has it."""
HEADROOM = 1.15
"""Top of the lane of time over the latest time that it shows."""


def plan_figure(
    section: dict[str, Any],
    plan: dict[str, Any],
    time_s: float,
    bounds_s: tuple[float, float],
    restrictions: Sequence[Mapping[str, float | None]] = (),
) -> Figure:
    """Figure of a run before departure: the limit, the optimal plan, restrictions and arrival to be dragged.

    Args:
        section: Values of :class:`metropilot.web.schemas.responses.SectionOut`.
        plan: Values of :class:`metropilot.web.schemas.responses.PlansOut`.
        time_s: Scheduled running time.
        bounds_s: Least and greatest running time to which the arrival can be dragged.
        restrictions: Those of the form: ``from_m``, ``to_m``, ``limit_mps``.
    """
    made = run_figure()
    end = section["length_m"]
    _place_arrival(made, time_s, end, bounds_s[1])
    told = {"time_s": time_s, "from_m": BAR * end, "to_m": end}
    made["layout"]["meta"] = {"arrival": {**told, "least_s": bounds_s[0], "most_s": bounds_s[1]}}
    top = 1.1 * KMH_PER_MPS * max(section["limit_mps"]["value"])
    made["layout"]["shapes"] = [
        {
            "type": "rect",
            "name": f"{ROW}{k}",
            "x0": each["from_m"],
            "x1": each["to_m"],
            "y0": KMH_PER_MPS * (each["limit_mps"] or 0.0),
            "y1": top,
            "fillcolor": "rgba(213,94,0,.22)",
            "line": {"width": 1.5, "color": VERMILION, "dash": "dot"},
        }
        for k, each in enumerate(restrictions)
    ]
    values: dict[int, tuple[Sequence[float], Sequence[float]]] = {
        0: stairs(section["limit_mps"], section["length_m"], KMH_PER_MPS),
        2: (plan["position_m"], kmh(plan["speed_mps"])),
        7: (plan["position_m"], kwh(plan["energy_wheel_so_far_j"])),
        12: (plan["position_m"], plan["time_s"]),
    }
    if (plant := plan.get("plant")) is not None:
        values[10] = (plant["position_m"], kmh(plant["speed_mps"]))
        values[11] = (plant["position_m"], kwh(plant["energy_wheel_so_far_j"]))
        values[14] = (plant["position_m"], plant["time_s"])
    return _fill(made, values)


def drive_figure(driven: dict[str, Any]) -> Figure:
    """Figure of a finished run: limit, permitted speed, optimum for the achieved time, drive.

    Args:
        driven: Values of :class:`metropilot.web.schemas.responses.DriveOut`.
    """
    columns, plan = driven["columns"], driven["plan"]
    at = columns["position_m"]
    values: dict[int, tuple[Sequence[float], Sequence[float]]] = {
        0: (at, kmh(columns["limit_mps"])),
        1: (at, kmh(columns["permitted_mps"])),
        3: (at, kmh(columns["speed_mps"])),
        6: (at, columns["command"]),
        8: (at, kwh(columns["energy_wheel_j"])),
        9: (at, kwh(columns["energy_line_j"])),
        13: (at, columns["time_s"]),
    }
    end = float(at[-1])
    if plan is not None:
        values[2] = (plan["position_m"], kmh(plan["speed_mps"]))
        values[7] = (plan["position_m"], kwh(plan["energy_wheel_so_far_j"]))
        values[12] = (plan["position_m"], plan["time_s"])
        end = plan["position_m"][-1]
    made, scheduled = run_figure(), driven["kpis"]["scheduled_time_s"]
    _place_arrival(made, scheduled, end, max(scheduled, columns["time_s"][-1]))
    return _fill(made, values)


def _place_arrival(made: Figure, time_s: float, end_m: float, latest_s: float) -> None:
    """Place the bar of the scheduled arrival at the end of a section, in a lane up to a time."""
    words = _("scheduled {time} s", time=f"{time_s:g}")
    made["data"][16] |= {"x": [BAR * end_m, end_m], "y": [time_s, time_s], "text": [f"{words}\u00a0", ""]}
    made["layout"]["yaxis4"]["range"] = [0, HEADROOM * latest_s]
    # as of a live run; by itself the axis leaves room for the words
    made["layout"]["xaxis"]["range"] = [-0.01 * end_m, 1.02 * end_m]


def _fill(made: Figure, values: Mapping[int, tuple[Sequence[Any], Sequence[Any]]]) -> Figure:
    """Fill traces of a figure with curves, by number."""
    for index, (x, y) in values.items():
        made["data"][index]["x"], made["data"][index]["y"] = list(x), list(y)
    return made


REGIME_COLOURS = {N_("power"): VERMILION, N_("cruise"): GREY, N_("coast"): GREEN, N_("brake"): BLUE}
BOUND_COLOURS = {
    N_("protection"): VERMILION,
    N_("speed limit"): BLACK,
    N_("permitted speed"): ORANGE,
    N_("effort"): BLUE,
    N_("comfort"): SKY,
    N_("stop"): GREY,
    N_("time"): GREEN,
}


def explanation_figure(driven: dict[str, Any]) -> Figure:
    """Figure of the reasons of a drive: regimes behind the speed, what bound it, losses over distance.

    Args:
        driven: Values of :class:`metropilot.web.schemas.responses.DriveOut` with an explanation.
    """
    columns, told, plan = driven["columns"], driven["explanation"], driven["plan"]
    at = columns["position_m"]
    traces = [
        line(_("speed limit"), at, kmh(columns["limit_mps"]), BLACK, width=1.4, shape="hv"),
        line(_("permitted speed"), at, kmh(columns["permitted_mps"]), ORANGE, width=1.6, dash="dash"),
        line(_("driven"), at, kmh(columns["speed_mps"]), BLUE, width=2.2),
    ]
    if plan is not None:
        optimal = line(
            _("optimal plan"), plan["position_m"], kmh(plan["speed_mps"]), SKY, width=6.0, opacity=0.65
        )
        traces.insert(2, optimal)
    hits = told["interventions"]
    if hits:
        places, speeds = [hit["from_m"] for hit in hits], kmh([hit["speed_mps"] for hit in hits])
        more = {"symbol": "triangle-down", "text": [retell(hit["guard"]) for hit in hits]}
        traces.append(markers(_("protection"), places, speeds, VERMILION, **more))
    for bound, colour in BOUND_COLOURS.items():
        spans = [span for span in told["bounds"] if span["bound"] == bound and span["to_m"] > span["from_m"]]
        x = [value for span in spans for value in (span["from_m"], span["to_m"], None)]
        y = [_(bound) if value is not None else None for value in x]
        if x:
            more = {"hoverinfo": "x+name", "showlegend": False, "yaxis": "y2"}
            traces.append(line(_(bound), x, y, colour, width=12.0, **more))
    losses = {
        _("lost by the trainset"): ("trainset_loss_j", GREY, "solid"),
        _("lost by the driver"): ("driver_loss_j", VERMILION, "dash"),
    }
    for words, (name, colour, dash) in losses.items():
        lost = kwh(told[name])
        traces.append(line(words, told["position_m"], lost, colour, dash=dash, yaxis="y3"))
    prices = told.get("prices", [])
    worth = {
        _("a second more saves"): ("later_j", GREEN, "solid"),
        _("a second less costs"): ("sooner_j", BLUE, "dash"),
    }
    for words, (name, colour, dash) in worth.items():
        kwhs = [None if price[name] is None else price[name] / J_PER_KWH for price in prices]
        places = [price["position_m"] for price in prices]
        traces.append(line(words, places, kwhs, colour, dash=dash, yaxis="y4", mode="lines+markers"))
    bands = [
        {
            "type": "rect",
            "xref": "x",
            "yref": "y domain",
            "x0": span["from_m"],
            "x1": span["to_m"],
            "y0": 0,
            "y1": 1,
            "line": {"width": 0},
            "fillcolor": REGIME_COLOURS[span["regime"]],
            "opacity": 0.14,
            "layer": "below",
        }
        for span in told["regimes"]
        if span["regime"] in REGIME_COLOURS
    ]
    order = [
        _(bound) for bound in reversed(BOUND_COLOURS) if any(s["bound"] == bound for s in told["bounds"])
    ]
    return figure(
        traces,
        760,
        shapes=bands,
        xaxis=axis(_("distance (m)"), anchor="y4"),
        yaxis=axis(_("speed (km/h)"), domain=[0.6, 1.0], rangemode="tozero"),
        yaxis2=axis("", domain=[0.39, 0.56], type="category", categoryorder="array", categoryarray=order),
        yaxis3=axis(_("loss (kWh)"), domain=[0.2, 0.35]),
        yaxis4=axis(_("a second (kWh)"), domain=[0.0, 0.16], rangemode="tozero"),
        hovermode="closest",
    )


def difference_figure(found: dict[str, Any]) -> Figure:
    """Figure of two drives: speeds, and time and energy of the second less the first, over distance."""
    at = found["position_m"]
    first, second = (kmh(row) for row in found["speed_mps"])
    late = [b - a for a, b in zip(*found["time_s"], strict=True)]
    more = kwh([b - a for a, b in zip(*found["energy_wheel_j"], strict=True)])
    names = [f"{key}: {name}" for key, name in zip("ab", found["drivers"], strict=True)]
    traces = [
        line(names[0], at, first, BLUE),
        line(names[1], at, second, VERMILION, dash="dash"),
        line(_("time of b − a"), at, late, GREEN, yaxis="y2", showlegend=False, fill="tozeroy"),
        line(_("energy of b − a"), at, more, ORANGE, yaxis="y3", showlegend=False, fill="tozeroy"),
    ]
    return figure(
        traces,
        560,
        xaxis=axis(_("distance (m)"), anchor="y3"),
        yaxis=axis(_("speed (km/h)"), domain=[0.5, 1.0], rangemode="tozero"),
        yaxis2=axis(_("b − a (s)"), domain=[0.26, 0.44]),
        yaxis3=axis(_("b − a (kWh)"), domain=[0.0, 0.2]),
    )


def compare_figure(entries: Sequence[dict[str, Any]]) -> Figure:
    """Figure of speed and energy over distance of several drivers."""
    first = entries[0]["drive"]
    at = first["columns"]["position_m"]
    traces = [line(_("speed limit"), at, kmh(first["columns"]["limit_mps"]), BLACK, width=1.4, shape="hv")]
    if first["plan"]:
        plan = first["plan"]
        where = plan["position_m"]
        traces.append(line(_("optimal plan"), where, kmh(plan["speed_mps"]), SKY, width=6.0, opacity=0.65))
        work = kwh(plan["energy_wheel_so_far_j"])
        below = {"yaxis": "y2", "showlegend": False, "opacity": 0.65}
        traces.append(line(_("plan's energy"), where, work, SKY, width=6.0, **below))
    styles = driver_styles([entry["driver"] for entry in entries])
    for entry in entries:
        columns, name = entry["drive"]["columns"], entry["driver"]
        colour, dashes = styles[name]
        style = {"dash": DASHES[dashes], "legendgroup": name}
        where = columns["position_m"]
        traces.append(line(name, where, kmh(columns["speed_mps"]), colour, **style))
        energy = kwh(columns["energy_wheel_j"])
        traces.append(line(name, where, energy, colour, yaxis="y2", showlegend=False, **style))
    return figure(
        traces,
        520,
        xaxis=axis(_("distance (m)"), anchor="y2"),
        yaxis=axis(_("speed (km/h)"), domain=[0.4, 1.0], rangemode="tozero"),
        yaxis2=axis(_("energy at the wheel (kWh)"), domain=[0.0, 0.33], rangemode="tozero"),
    )


def front_figure(
    front: dict[str, Any], cursor: tuple[float, float], entries: Sequence[dict[str, Any]]
) -> Figure:
    """Figure of the time-energy front with a cursor (s, kWh) and the compared drives."""
    energy = kwh(front["energy_j"])
    time_s, here = cursor
    traces = [
        line(_("optimum"), front["time_s"], energy, SKY, width=4.0, mode="lines+markers", shape="spline"),
        markers(_("cursor"), [time_s], [here], SKY, 13, line={"width": 3, "color": "#fff"}, showlegend=False),
    ]
    styles = driver_styles([entry["driver"] for entry in entries])
    for entry in entries:
        kpis = entry["drive"]["kpis"]
        if kpis["outcome"] != "arrived":
            continue
        colour, dashes = styles[entry["driver"]]
        at = [kpis["running_time_s"]], [kpis["energy_wheel_kwh"]]
        traces.append(markers(entry["driver"], *at, colour, symbol=SYMBOLS[dashes]))
    least = front["minimum_running_time_s"]
    wall = {"type": "line", "x0": least, "x1": least, "yref": "paper", "y0": 0, "y1": 1}
    now = {"type": "line", "x0": time_s, "x1": time_s, "yref": "paper", "y0": 0, "y1": 1}
    shapes = [
        {**wall, "line": {"color": GREY, "width": 1, "dash": "dot"}},
        {**now, "line": {"color": SKY, "width": 1}},
    ]
    return figure(
        traces,
        380,
        xaxis=axis(_("running time (s)")),
        yaxis=axis(_("energy at the wheel (kWh)")),
        shapes=shapes,
        hovermode="closest",
    )


def journey_figure(journey: dict[str, Any]) -> Figure:
    """Train graph: distance over time, with stations as lines and the energy of each section."""
    calls = journey["calls"]
    minutes = [t / 60 for t in journey["time_s"]]
    path = line(_("trainset"), minutes, [s / 1000 for s in journey["position_m"]], BLUE, width=2.4)
    path["hovertemplate"] = "%{x:.2f} min, %{y:.2f} km<extra></extra>"
    ticks = [c["position_m"] / 1000 for c in calls]
    return figure(
        [path],
        460,
        xaxis=axis(_("time since departure (min)")),
        yaxis=axis("", tickvals=ticks, ticktext=[c["station"] for c in calls], showgrid=True),
        hovermode="closest",
        showlegend=False,
        margin={"l": 58, "r": 14, "t": 12, "b": 44},
    )


PATHS = {
    "draws": (N_("draws"), VERMILION),
    "stands": (N_("coasts or stands"), GREY),
    "returns": (N_("returns"), GREEN),
    "forward": (N_("forward"), BLUE),
    "backward": (N_("backward"), VERMILION),
}
"""Name and colour of each kind of path of a train graph of many trains."""
HEADWAY_SERIES = {
    "cruise_kwh": (N_("cruise and brake, plain timetable"), GREY, "dash"),
    "timetable_only_kwh": (N_("cruise and brake, timetable found"), GREY, "solid"),
    "driving_only_kwh": (N_("optimal driving, plain timetable"), BLUE, "dash"),
    "energy_kwh": (N_("optimal driving, timetable found"), BLUE, "solid"),
    "floor_kwh": (N_("floor"), VERMILION, "dot"),
}
"""Energies over the headway: label, colour and style."""


MOST_CODES = 24
"""Stations whose codes stand beside them in the drawing of a line."""


def line_figure(values: dict[str, Any], handles: Sequence[Mapping[str, Any]] = ()) -> Figure:
    """Limits, stations and gradients of a line.

    Args:
        values: Values of :class:`metropilot.web.schemas.responses.LineOut`.
        handles: Limits and stations that can be dragged (:mod:`metropilot.web.pages.handles`).
    """
    stops = values["stops"]
    end = stops[-1]["position_m"]
    limits = stairs(values["limit_mps"], end, KMH_PER_MPS)
    slopes = stairs(values["gradient_permil"], end)
    km = [[x / 1000 for x in limits[0]], [x / 1000 for x in slopes[0]]]
    low: Trace = {"width": 1.4, "shape": "hv", "fill": "tozeroy", "yaxis": "y2"}
    stations = {
        "type": "scatter",
        "mode": "markers+text" if len(stops) <= MOST_CODES else "markers",
        "name": _("station"),
        "x": [stop["position_m"] / 1000 for stop in stops],
        "y": [0.0] * len(stops),
        "text": [stop["code"] for stop in stops],
        # by turns above and below: on a telephone they would touch
        "textposition": [("top center", "bottom center")[k % 2] for k in range(len(stops))],
        "textfont": {"size": 10},
        "marker": {"symbol": "triangle-up", "size": 10, "color": GREY},
        "cliponaxis": False,
        "hovertemplate": "%{text}",
    }
    return figure(
        [
            line(_("speed limit (km/h)"), km[0], limits[1], BLACK, width=1.6, shape="hv"),
            line(_("gradient (‰)"), km[1], slopes[1], BLUE, **low),
            stations,
        ],
        380,
        showlegend=False,
        meta={"handles": list(handles)},
        xaxis=axis(_("position (km)"), anchor="y2"),
        yaxis=axis(_("limit (km/h)"), domain=[0.55, 1.0], rangemode="tozero"),
        yaxis2=axis(_("gradient (‰)"), domain=[0.0, 0.42]),
    )


def effort_figure(curves: dict[str, Any]) -> Figure:
    """Effort curves and resistance of a trainset over speed, and the acceleration that they give.

    Args:
        curves: Values of :func:`metropilot.web.work.plans.effort_curves`.
    """
    at = kmh(curves["speed_mps"])
    forces = (
        (_("traction"), "traction_n", BLUE, "solid"),
        (_("electric brake"), "electric_brake_n", GREEN, "solid"),
        (_("all brakes"), "brake_n", GREEN, "dash"),
        (_("resistance, level"), "resistance_n", VERMILION, "solid"),
    )
    traces = [
        line(label, at, [f / 1000 for f in curves[name]], colour, dash=dash)
        for label, name, colour, dash in forces
    ]
    rates = (
        (_("acceleration"), "acceleration_mps2", BLUE),
        (_("deceleration"), "deceleration_mps2", GREEN),
    )
    traces += [
        line(label, at, curves[name], colour, yaxis="y2", showlegend=False) for label, name, colour in rates
    ]
    return figure(
        traces,
        460,
        xaxis=axis(_("speed (km/h)"), anchor="y2"),
        yaxis=axis(_("force (kN)"), domain=[0.48, 1.0], rangemode="tozero"),
        yaxis2=axis(_("rate, level (m/s²)"), domain=[0.0, 0.38], rangemode="tozero"),
        margin={"l": 58, "r": 14, "t": 50, "b": 44},
    )


def residual_figure(residuals: dict[str, Any], noise_mps: float) -> Figure:
    """Measured and simulated speed of a fit, the residuals over time, and their correlation.

    Args:
        residuals: Values of :class:`metropilot.web.schemas.responses.ResidualsOut`.
        noise_mps: Standard deviation of the residuals.
    """
    at = residuals["time_s"]
    measured, simulated = (
        [None if v is None else round(v * KMH_PER_MPS, 3) for v in residuals[name]]
        for name in ("measured_mps", "simulated_mps")
    )
    dots = {"mode": "markers", "marker": {"size": 3, "color": GREY}}
    far = {"mode": "markers", "marker": {"size": 3, "color": BLUE}, "yaxis": "y2", "showlegend": False}
    traces = [
        line(_("measured"), at, measured, GREY, **dots),
        line(_("simulated"), at, simulated, BLUE, width=1.4),
        line(_("measured − simulated"), at, residuals["residual_mps"], BLUE, **far),
        {
            "type": "bar",
            "name": _("correlation"),
            "x": residuals["lag_s"],
            "y": residuals["correlation"],
            "marker": {"color": BLUE},
            "xaxis": "x2",
            "yaxis": "y3",
            "showlegend": False,
        },
    ]
    ends = [
        {
            "type": "line",
            "xref": "x domain",
            "x0": 0,
            "x1": 1,
            "yref": "y2",
            "y0": side * NORMAL_95 * noise_mps,
            "y1": side * NORMAL_95 * noise_mps,
            "line": {"color": VERMILION, "width": 1, "dash": "dash"},
        }
        for side in (-1, 1)
    ]
    return figure(
        traces,
        640,
        shapes=ends,
        xaxis=axis(_("time since the start of each run (s)"), anchor="y2"),
        xaxis2=axis(_("seconds between two residuals"), anchor="y3"),
        yaxis=axis(_("speed (km/h)"), domain=[0.66, 1.0], rangemode="tozero"),
        yaxis2=axis(_("residual (m/s)"), domain=[0.36, 0.61], range=[-5 * noise_mps, 5 * noise_mps]),
        yaxis3=axis(_("correlation"), domain=[0.0, 0.2], range=[-0.5, 1.0]),
        hovermode="closest",
    )


def operation_figure(graph: dict[str, Any], *, day: bool) -> Figure:
    """Train graph of all trains of a line.

    Args:
        graph: Values of :class:`metropilot.web.schemas.responses.TrainGraphOut`.
        day: True for a day, in hours; else a few headways, in seconds.
    """
    scale, unit = (3600.0, _("time of day (h)")) if day else (1.0, _("time (s)"))
    traces = []
    for kind, (name, colour) in PATHS.items():
        path = graph["paths"].get(kind)
        if path is not None:
            time = [None if t is None else round(t / scale, 4) for t in path["time_s"]]
            at = [None if x is None else x / 1000 for x in path["position_m"]]
            traces.append(line(_(name), time, at, colour, width=1.0 if day else 1.5, hoverinfo="skip"))
    ticks = [stop["position_m"] / 1000 for stop in graph["stops"]]
    return figure(
        traces,
        460,
        xaxis=axis(unit, range=[t / scale for t in graph["span_s"]]),
        yaxis=axis("", tickvals=ticks, ticktext=[stop["code"] for stop in graph["stops"]], showgrid=True),
        hovermode=False,
        uirevision=str(graph["span_s"]),
    )


def running_figure() -> Figure:
    """Figure of a running line, filled by the browser: train graph, delays, energy and floor over time."""
    kinds = (
        (_("on time"), GREY, 1.0),
        (_("more than 5 s late"), ORANGE, 1.6),
        (_("more than 1 min late"), VERMILION, 2.0),
    )
    traces = [line(name, [], [], colour, width=width, hoverinfo="skip") for name, colour, width in kinds]
    traces += [
        line(_("delays of all"), [], [], VERMILION, yaxis="y2", showlegend=False),
        line(_("energy"), [], [], BLUE, yaxis="y3"),
        line(_("floor"), [], [], BLACK, dash="dash", yaxis="y3"),
        line(_("trains"), [], [], BLUE, mode="markers", showlegend=False, hoverinfo="skip"),
    ]
    return figure(
        traces,
        640,
        xaxis=axis(_("time (min)"), anchor="y3", range=[0, 10]),
        yaxis=axis("", domain=[0.42, 1.0], tickvals=[]),  # its stations come with the first state
        yaxis2=axis(_("delay (min)"), domain=[0.22, 0.37], rangemode="tozero"),
        yaxis3=axis(_("energy (kWh)"), domain=[0.0, 0.17], rangemode="tozero"),
        hovermode=False,
    )


LATE_S = (5.0, 60.0)
"""Delays above which a path of a running line has another colour; line.js has them, too."""


def finished_line_figure(graph: dict[str, Any]) -> Figure:
    """Figure of a running line at its end, as the browser had drawn it.

    Args:
        graph: Values of :class:`metropilot.web.schemas.responses.RunningGraphOut`.
    """
    made = running_figure()
    minutes = [t / 60 for t in graph["time_s"]]
    paths: list[tuple[list[float | None], list[float | None]]] = [
        ([], []) for _late in range(len(LATE_S) + 1)
    ]
    for k, (at, late) in enumerate(zip(graph["position_m"], graph["delay_s"], strict=True)):
        for before, now, delay_s in zip(graph["position_m"][k - 1] if k else (), at, late, strict=False):
            x, y = paths[sum(delay_s > bound for bound in LATE_S)]
            x += [minutes[k - 1], minutes[k], None]
            y += [before / 1000, now / 1000, None]
    sums = [sum(max(s, 0.0) for s in row) / 60 for row in graph["delay_s"]]
    last = [m / 1000 for m in graph["position_m"][-1]] if minutes else []
    drawn = [(minutes, sums), (minutes, graph["energy_kwh"]), (minutes, graph["floor_kwh"])]
    _fill(made, dict(enumerate([*paths, *drawn, ([minutes[-1]] * len(last) if minutes else [], last)])))
    stops = graph["stops"]
    made["layout"]["xaxis"] |= {"range": [0.0, max([*minutes, 10.0])]}
    made["layout"]["yaxis"] |= {
        "tickvals": [s["position_m"] / 1000 for s in stops],
        "ticktext": [s["code"] for s in stops],
    }
    return made


def headways_figure(found: dict[int, dict[str, Any]], headway_s: float) -> Figure:
    """Energies and floor over the headways that are computed, with a cursor.

    Args:
        found: Values of `line.json` by headway; without any, the figure says so.
        headway_s: Headway of the cursor.
    """
    if not found:
        return blank(360, _("No headway is computed yet."))
    at = sorted(found)
    traces = [
        line(_(label), at, [found[h][name] for h in at], colour, dash=dash, mode="lines+markers")
        for name, (label, colour, dash) in HEADWAY_SERIES.items()
    ]
    now = {"type": "line", "x0": headway_s, "x1": headway_s, "yref": "paper", "y0": 0, "y1": 1}
    return figure(
        traces,
        360,
        xaxis=axis(_("headway (s)")),
        yaxis=axis(_("energy of a round trip (kWh)")),
        shapes=[{**now, "line": {"color": SKY, "width": 1}}],
        margin={"l": 58, "r": 14, "t": 64, "b": 44},
    )


def sections_figure(journey: dict[str, Any]) -> Figure:
    """Figure of energy and reserve of every section."""
    calls = journey["calls"]
    names = [f"{a['station']}–{b['station']}" for a, b in pairwise(calls)]
    energy = kwh([c["energy_j"] for c in calls[1:]])
    reserve = [100 * (c["running_time_s"] / max(c["minimum_running_time_s"], 1e-9) - 1) for c in calls[1:]]
    bars = {"type": "bar", "x": names, "showlegend": False}
    traces = [
        {**bars, "name": _("energy (kWh)"), "y": energy, "marker": {"color": BLUE}},
        {**bars, "name": _("reserve (%)"), "y": reserve, "marker": {"color": ORANGE}, "yaxis": "y2"},
    ]
    return figure(
        traces,
        400,
        xaxis=axis("", anchor="y2", tickangle=-45),
        yaxis=axis(_("energy (kWh)"), domain=[0.54, 1.0], rangemode="tozero"),
        yaxis2=axis(_("reserve (%)"), domain=[0.0, 0.44], rangemode="tozero"),
        margin={"l": 58, "r": 14, "t": 12, "b": 70},
    )


MOST = 6
"""Largest number of trainsets of a convoy that are drawn."""


def convoy_figure() -> Figure:
    """Figure of a live convoy, filled by the browser: gaps, speed differences and speeds over time."""
    traces = []
    for message, where in (
        (N_("gap {first} to {second}"), "y"),
        (N_("difference {first} to {second}"), "y2"),
    ):
        for k in range(MOST):
            colour, dashes = SERIES_STYLES[k % len(SERIES_STYLES)]
            style: Trace = {"dash": DASHES[dashes], "yaxis": where, "showlegend": False}
            traces.append(line(_(message, first=k + 1, second=k + 2), [], [], colour, **style))
    for k in range(MOST):
        colour, dashes = (BLACK, "-") if k == 0 else SERIES_STYLES[(k - 1) % len(SERIES_STYLES)]
        style = {"dash": DASHES[dashes], "yaxis": "y3", "showlegend": k < 3}
        traces.append(line(_("head") if k == 0 else _("trainset {k}", k=k + 1), [], [], colour, **style))
    return figure(
        traces,
        560,
        xaxis=axis(_("time since departure (s)"), anchor="y3", rangemode="tozero"),
        yaxis=axis(_("gap (m)"), domain=[0.66, 1.0], rangemode="tozero"),
        yaxis2=axis(_("difference (km/h)"), domain=[0.36, 0.6]),
        yaxis3=axis(_("speed (km/h)"), domain=[0.0, 0.3], rangemode="tozero"),
    )


def finished_convoy_figure(found: dict[str, Any]) -> Figure:
    """Figure of a finished convoy."""
    made = convoy_figure()
    for first, name, factor in ((0, "gap_m", 1.0), (MOST, "speed_difference_mps", KMH_PER_MPS)):
        for k, values in enumerate(zip(*found.get(name, ()), strict=True)):
            made["data"][first + k] |= {"x": found["time_s"], "y": [factor * x for x in values]}
    for k, trainset in enumerate(found.get("speeds", ())):
        seen = {"x": trainset["time_s"], "y": kmh(trainset["speed_mps"]), "showlegend": True}
        made["data"][2 * MOST + k] |= seen
    for trace in made["data"][2 * MOST + len(found.get("speeds", ())) :]:
        trace["showlegend"] = False
    return made


def history_figure(columns: dict[str, list[float | None]]) -> Figure:
    """Figure of a learning run over its steps: share of successful drives, energy and time error."""
    steps = columns.get("steps", [])
    share = [None if x is None else 100 * x for x in columns.get("evaluation.safe_share", [])]
    marks: Trace = {"mode": "lines+markers"}
    gap = columns.get("evaluation.gap_percent", [])
    late = columns.get("evaluation.late_worst_s", [])
    traces = [
        line(_("safe and on time"), steps, share, BLUE, width=2.4, **marks),
        line(
            _("energy above the optimum, of those"), steps, gap, VERMILION, dash="dash", yaxis="y2", **marks
        ),
        line(_("worst time error"), steps, late, GREEN, dash="dot", yaxis="y3", **marks),
    ]
    return figure(
        traces,
        560,
        xaxis=axis(_("environment steps"), anchor="y3", rangemode="tozero"),
        yaxis=axis(_("drives (%)"), domain=[0.7, 1.0], range=[-3, 103]),
        yaxis2=axis(_("energy (%)"), domain=[0.36, 0.62], rangemode="tozero"),
        yaxis3=axis(_("time (s)"), domain=[0.0, 0.28], rangemode="tozero"),
    )

"""Drawing of the track as SVG: height, gradients, limits, stations. A tree of elements escapes all names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, tostring

from metropilot.units import KMH_PER_MPS
from metropilot.web.words.language import _

WIDTH, X0, X1 = 1000.0, 34.0, 966.0
TOP, HILL, RAIL = 24.0, 84.0, 104.0
NARROW = 46.0


def section_strip(section: dict[str, Any], trainset_length_m: float = 0.0, behind_m: float = 0.0) -> str:
    """Draw a section with a trainset that the browser moves.

    Args:
        section: Values of :class:`metropilot.web.schemas.responses.SectionOut`.
        trainset_length_m: Drawn to scale, its head at the origin; 0 draws none.
        behind_m: Room for a convoy behind the origin, which the browser draws.
    """
    length, room = section["length_m"], max(trainset_length_m, behind_m)
    frame = Frame(X0 + (X1 - X0) * room / (length + room), 0.0, length)
    root = _root(frame, 150.0)
    _hill(root, section["gradient_permil"], frame)
    _limits(root, section["limit_mps"], frame)
    for stop, anchor in ((section["origin"], "start"), (section["destination"], "end")):
        x = frame.at(stop["position_m"])
        _stop(root, x, 5.0)
        _text(root, x - 6 if anchor == "start" else x + 6, 146.0, stop["name"], anchor, size=12)
    SubElement(root, "g", {"class": "mp-restrictions"})
    SubElement(root, "g", {"class": "mp-convoy"})
    if trainset_length_m > 0:
        group = SubElement(root, "g", {"class": "mp-train"})
        drawn = max(frame.scale * trainset_length_m, 14.0)
        shape = {"x": _n(frame.x0 - drawn), "y": _n(RAIL - 13), "width": _n(drawn), "height": "9", "rx": "3"}
        SubElement(group, "rect", {**shape, "class": "train"})
    return _svg(root)


def line_strip(line: dict[str, Any], chosen: tuple[str, str] | None = None) -> str:
    """Draw a whole line with the chosen section marked.

    Args:
        line: Values of :class:`metropilot.web.schemas.responses.LineOut`.
        chosen: Codes of origin and destination.
    """
    stops = line["stops"]
    frame = Frame(X0, stops[0]["position_m"], stops[-1]["position_m"])
    root = _root(frame, 142.0)
    _hill(root, line["gradient_permil"], frame, numbers=False)
    _limits(root, line["limit_mps"], frame, numbers=False)
    at = {stop["code"]: frame.at(stop["position_m"]) for stop in stops}
    if chosen and chosen[0] in at and chosen[1] in at:
        ends = {"x1": _n(at[chosen[0]]), "x2": _n(at[chosen[1]]), "y1": _n(RAIL), "y2": _n(RAIL)}
        SubElement(root, "line", {**ends, "class": "chosen", "stroke-width": "6"})
    last = -NARROW
    for stop in stops:
        x = at[stop["code"]]
        _stop(root, x, 4.0)
        marked = chosen is not None and stop["code"] in chosen
        low = x - last < 30 and not marked
        text = _text(root, x, 138.0 if low else 124.0, stop["code"], "middle", size=11)
        text.set("font-weight", "700" if marked else "400")
        SubElement(text, "title").text = f"{stop['name']}, {stop['position_m'] / 1000:.3f} km"
        last = last if low else x
    return _svg(root)


class Frame(NamedTuple):
    """Scale of the drawing: positions along the line to abscissas."""

    x0: float
    start_m: float
    end_m: float

    @property
    def scale(self) -> float:
        """Drawing units a metre."""
        return (X1 - self.x0) / (self.end_m - self.start_m)

    def at(self, position_m: float) -> float:
        """Abscissa of a position."""
        return self.x0 + self.scale * (position_m - self.start_m)

    def edges(self, profile: dict[str, list[float]]) -> list[float]:
        """Begins of the pieces of a profile and the end of the last one, m."""
        return [max(x, self.start_m) for x in profile["from_m"] if x < self.end_m] + [self.end_m]


def _root(frame: Frame, height: float) -> Element:
    values = {
        "xmlns": "http://www.w3.org/2000/svg",
        "viewBox": f"0 0 {WIDTH:g} {height:g}",
        "role": "img",
        "aria-label": _("track with stations, gradients and speed limits"),
        "data-x0": _n(frame.x0),
        "data-scale": f"{frame.scale:.8g}",
        "data-rail": _n(RAIL),
    }
    return Element("svg", values)


def _hill(root: Element, gradient: dict[str, list[float]], frame: Frame, *, numbers: bool = True) -> None:
    """Draw the height over distance, scaled to its band, with the gradient of each longer piece in permil."""
    edges = frame.edges(gradient)
    values = gradient["value"][: len(edges) - 1]
    heights = [0.0]
    for k, value in enumerate(values):
        heights.append(heights[-1] + value / 1000 * (edges[k + 1] - edges[k]))
    low, high = min(heights), max(heights)
    room = max(high - low, 0.5)
    xs = [frame.at(x) for x in edges]
    ys = [HILL - 6 - (HILL - TOP - 12) * (h - low) / room for h in heights]
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(xs, ys, strict=True))
    SubElement(
        root, "polygon", {"points": f"{frame.x0:g},{RAIL:g} {points} {X1:g},{RAIL:g}", "class": "hill"}
    )
    if not numbers:
        _text(
            root,
            X0,
            12.0,
            _("height, {height} m in all", height=f"{high - low:.0f}"),
            "start",
            size=11,
            soft=True,
        )
        return
    _text(root, X0, 12.0, _("gradient in ‰, uphill positive"), "start", size=11, soft=True)
    for k, value in enumerate(values):
        if xs[k + 1] - xs[k] > NARROW:
            said = f"{value:+.1f}".replace("-", "−") if value else "0"
            _text(root, (xs[k] + xs[k + 1]) / 2, (ys[k] + ys[k + 1]) / 2 - 5, said, "middle", size=11)


def _limits(root: Element, limit: dict[str, list[float]], frame: Frame, *, numbers: bool = True) -> None:
    """Draw the rail and, below it, each limit in km/h."""
    ends = {"x1": _n(frame.x0), "x2": _n(X1), "y1": _n(RAIL), "y2": _n(RAIL)}
    SubElement(root, "line", {**ends, "class": "rail", "stroke-width": "3"})
    xs = [frame.at(x) for x in frame.edges(limit)]
    for k, value in enumerate(limit["value"][: len(xs) - 1]):
        if k:
            mark = {"x1": _n(xs[k]), "x2": _n(xs[k]), "y1": _n(RAIL - 7), "y2": _n(RAIL + 7), "class": "rail"}
            SubElement(root, "line", mark)
        if numbers and xs[k + 1] - xs[k] > NARROW:
            unit = " km/h" if xs[k + 1] - xs[k] > 70 else ""
            words = f"{value * KMH_PER_MPS:.0f}{unit}"
            _text(root, (xs[k] + xs[k + 1]) / 2, RAIL + 19, words, "middle", size=11, soft=True)


def _stop(root: Element, x: float, radius: float) -> None:
    where = {"cx": _n(x), "cy": _n(RAIL), "r": _n(radius)}
    SubElement(root, "circle", {**where, "class": "stop", "stroke-width": "2.5"})


def _text(
    root: Element, x: float, y: float, words: str, anchor: str, *, size: int, soft: bool = False
) -> Element:
    where = {"x": _n(x), "y": _n(y), "text-anchor": anchor, "font-size": str(size)}
    text = SubElement(root, "text", {**where, "class": "soft" if soft else "ink"})
    text.text = words
    return text


def _svg(root: Element) -> str:
    return tostring(root, encoding="unicode")


def _n(value: float) -> str:
    return f"{value:.6g}"


def names(stops: Sequence[dict[str, Any]]) -> dict[str, str]:
    """Options of a list of stations."""
    return {stop["code"]: f"{stop['code']} · {stop['name']}" for stop in stops}

"""Report of a run, a comparison or a journey as PDF: its picture, its tables, where it comes from."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metropilot.evaluate import BLUE, GREY, ORANGE, add_headline, house_style, label_panel, new_panels
from metropilot.units import J_PER_KWH, KMH_PER_MPS
from metropilot.web.words import tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH_IN, HEIGHT_IN = 8.27, 11.69
LEFT_IN, TOP_IN, BOTTOM_IN = 0.75, 0.75, 0.8
ROOM_IN = WIDTH_IN - 2 * LEFT_IN
ROW_IN = 0.19
GLYPH_IN = 0.068
"""Width of a letter of a paragraph, on the average."""
PICTURES = {"drive": "profile.png", "live": "profile.png", "compare": "comparison.png"}
COMPARED = (
    ("running_time_s", "time (s)", 1),
    ("energy_wheel_kwh", "wheel (kWh)", 2),
    ("energy_line_kwh", "line (kWh)", 2),
    ("optimality_gap_percent", "gap (%)", 2),
    ("stopping_error_m", "stop (m)", 3),
    ("max_jerk_mps3", "jerk (m/s³)", 2),
)
"""KPIs of a comparison: name, heading, digits."""


class Sheets:
    """Pages of A4 that are filled from the top.

    Args:
        title: Title of the first page.
        foot: Line at the foot of every page.
    """

    def __init__(self, title: str, foot: str) -> None:
        self.foot = foot
        self.figures: list[Figure] = []
        self._turn()
        self._write(LEFT_IN, title, size=15.0, weight="bold")
        self.at_in += 0.38

    def _turn(self) -> None:
        from matplotlib.figure import Figure

        self.figures.append(Figure(figsize=(WIDTH_IN, HEIGHT_IN)))
        self.at_in = TOP_IN

    def _write(self, x_in: float, text: str, *, size: float = 9.0, align: str = "left", **more: Any) -> None:  # noqa: ANN401
        where = {"ha": align, "va": "top", "fontsize": size, "parse_math": False}
        self.figures[-1].text(x_in / WIDTH_IN, 1 - self.at_in / HEIGHT_IN, text, **where, **more)

    def need(self, height_in: float) -> None:
        """Begin a page where a height is not left on this one."""
        if self.at_in + height_in > HEIGHT_IN - BOTTOM_IN:
            self._turn()

    def heading(self, text: str) -> None:
        """Write a heading, with room for something below it."""
        self.need(1.0)
        self.at_in += 0.14
        self._write(LEFT_IN, text, size=11.0, weight="bold")
        self.at_in += 0.27

    def paragraph(self, text: str) -> None:
        """Write a paragraph."""
        from textwrap import wrap

        for words in wrap(text, int(ROOM_IN / GLYPH_IN)):
            self.need(ROW_IN)
            self._write(LEFT_IN, words)
            self.at_in += ROW_IN
        self.at_in += 0.08

    def picture(self, path: Path | BytesIO) -> None:
        """Place a picture over the whole width."""
        from matplotlib.image import imread

        pixels = imread(path)
        height_in = ROOM_IN * pixels.shape[0] / pixels.shape[1]
        self.need(height_in)
        below = 1 - (self.at_in + height_in) / HEIGHT_IN
        box = (LEFT_IN / WIDTH_IN, below, ROOM_IN / WIDTH_IN, height_in / HEIGHT_IN)
        axes = self.figures[-1].add_axes(box)
        axes.imshow(pixels, aspect="auto", interpolation="none")
        axes.set_axis_off()
        self.at_in += height_in + 0.1

    def table(
        self,
        columns: Sequence[str],
        rows: Sequence[Sequence[str]],
        shares: Sequence[float | int],
        right: Sequence[int] = (),
    ) -> None:
        """Write a table; its headings are repeated on every page.

        Args:
            columns: Headings.
            rows: Texts.
            shares: Widths of the columns, relative to each other.
            right: Columns that are flush right.
        """
        edges = [LEFT_IN]
        for share in shares:
            edges.append(edges[-1] + ROOM_IN * share / sum(shares))

        def write(texts: Sequence[str], **more: Any) -> None:  # noqa: ANN401
            for k, text in enumerate(texts):
                flush = k in right
                x_in = edges[k + 1] - 0.12 if flush else edges[k]
                most = max(int((edges[k + 1] - edges[k]) / GLYPH_IN), 4)
                shown = text if len(text) <= most else text[: most - 1] + "…"
                self._write(x_in, shown, size=8.5, align="right" if flush else "left", **more)
            self.at_in += ROW_IN

        def head() -> None:
            write(columns, color=GREY)

        self.need(2 * ROW_IN)
        head()
        for row in rows:
            if self.at_in + ROW_IN > HEIGHT_IN - BOTTOM_IN:
                self._turn()
                head()
            write(row)
        self.at_in += 0.1

    def figure(self, made: Figure) -> None:
        """Place a figure of Matplotlib as a picture."""
        content = BytesIO()
        made.savefig(content, format="png", dpi=200)
        content.seek(0)
        self.picture(content)

    def content(self) -> bytes:
        """The pages as a PDF."""
        from matplotlib.backends.backend_pdf import PdfPages

        made = BytesIO()
        with PdfPages(made, metadata={"Creator": "metropilot", "Producer": "metropilot"}) as pages:
            for k, figure in enumerate(self.figures):
                texts = (
                    (LEFT_IN, "left", self.foot),
                    (WIDTH_IN - LEFT_IN, "right", f"{k + 1} / {len(self.figures)}"),
                )
                for x_in, align, text in texts:
                    figure.text(x_in / WIDTH_IN, 0.45 / HEIGHT_IN, text, ha=align, fontsize=7, color=GREY)
                pages.savefig(figure)
        return made.getvalue()


def report_pdf(kind: str, about: dict[str, Any], result: dict[str, Any], folder: str) -> bytes:
    """Write a report; see :func:`report_of`."""
    with house_style():
        return report_of(kind, about, result, folder).content()


def report_of(kind: str, about: dict[str, Any], result: dict[str, Any], folder: str) -> Sheets:
    """Lay out the report of a run, a comparison or a journey.

    Args:
        kind: Kind of the job.
        about: ``id``, ``name``, ``created``, ``request`` (its values that differ from the defaults),
            ``made_with`` (versions and commit, where no `run.toml` has them).
        result: Its result.
        folder: Folder of its files.
    """
    with house_style():
        made = _provenance(Path(folder), about["made_with"])
        sheets = Sheets(about["name"], f"{about['id']} · metropilot {made['metropilot']}")
        sheets.paragraph(f"{KIND_WORDS[kind]} of {about['created'][:16].replace('T', ' ')} UTC.")
        picture = Path(folder) / PICTURES.get(kind, "")
        if kind == "journey":
            sheets.figure(journey_figure(result))
            _journey(sheets, result)
        else:
            if picture.is_file():
                sheets.picture(picture)
            if kind == "compare":
                _comparison(sheets, result)
            else:
                _drive(sheets, result)
        sheets.heading("Request")
        values = [(name, told(value)) for name, value in about["request"].items() if value is not None]
        sheets.table(("field", "value"), values, (1, 3))
        sheets.heading("Made with")
        sheets.table(("what", "version"), [(name, str(value)) for name, value in made.items()], (1, 3))
        return sheets


def told(value: object) -> str:
    """Write a value of a request for a reader."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, dict):
        return ", ".join(f"{name} {told(each)}" for name, each in value.items() if each is not None)
    if isinstance(value, list):
        return ("; " if any(isinstance(each, dict) for each in value) else ", ").join(map(told, value))
    return str(value)


KIND_WORDS = {"drive": "Drive", "live": "Live run", "compare": "Comparison", "journey": "Journey"}
"""Kinds of jobs that have a report."""


def _provenance(folder: Path, present: dict[str, str]) -> dict[str, str]:
    path = folder / "run.toml"
    if not path.is_file():
        return present
    return tomllib.loads(path.read_text(encoding="utf-8")).get("made_with", present)


def _requirements(sheets: Sheets, title: str, checks: list[dict[str, Any]]) -> None:
    sheets.heading(title)
    rows = [(*texts, "passed" if passed else "FAILED") for *texts, passed in tables.check_rows(checks)]
    sheets.table(("requirement", "measured", "allowed", ""), rows, (3, 2, 3, 1.2), right=(1,))


def _drive(sheets: Sheets, driven: dict[str, Any]) -> None:
    _requirements(sheets, "Requirements", driven["checks"])
    sheets.heading("KPIs")
    sheets.table(("KPI", "value", ""), tables.translate_kpis(driven["kpis"]), (2.4, 1.4, 5.2), right=(1,))
    told = driven.get("explanation")
    if told is None:
        return
    sheets.heading("Why it drives so")
    sheets.paragraph(tables.explain_words(told, driven["kpis"]))
    sheets.table(*tables.regime_table(told), (1, 1.6, 1.6, 1.9, 1.5, 1.1, 1.1), right=(4, 5, 6))
    sheets.paragraph("Trainset and driver: energy (kWh) lost in the regime against the optimal plan.")
    if told["interventions"]:
        sheets.heading("Interventions of protection")
        sheets.table(*tables.hit_table(told), (2, 1.5, 1.5, 1.3, 1.2, 1.5), right=(3, 4, 5))


def _comparison(sheets: Sheets, result: dict[str, Any]) -> None:
    sheets.heading("Drivers")
    rows = []
    for entry in result["entries"]:
        ended = entry.get("ended", entry["outcomes"])
        said = "; ".join(f"{ended.count(w)} × {w}" if len(ended) > 1 else w for w in dict.fromkeys(ended))
        means = [entry["kpis"].get(name) for name, _heading, _digits in COMPARED]
        values = [
            tables.number(None if mean is None else mean["mean"], digits)
            for mean, (_name, _heading, digits) in zip(means, COMPARED, strict=True)
        ]
        rows.append((entry["driver"], said, *values))
    columns = ("driver", "ended", *(heading for _name, heading, _digits in COMPARED))
    shares = (1.8, 2.4, 1.3, 1.7, 1.5, 1.2, 1.2, 1.7)
    sheets.table(columns, rows, shares, right=range(2, len(columns)))
    sheets.paragraph("Means over the seeds; gap: energy above the optimum for the time achieved.")
    for entry in result["entries"]:
        _requirements(sheets, f"Requirements of {entry['driver']}", entry["drive"]["checks"])


def _journey(sheets: Sheets, journey: dict[str, Any]) -> None:
    energy, planned = journey["energy_j"], journey.get("planned_energy_j")
    words = f"Running time with dwells {tables.number(journey['running_time_s'], 0)} s"
    words += f", energy {tables.number(energy / J_PER_KWH, 2)} kWh"
    if planned:
        words += f"; with the timetable's own running times {tables.number(planned / J_PER_KWH, 2)} kWh"
    sheets.paragraph(f"{words}.")
    sheets.heading("Calls")
    rows = [
        (
            call["station"],
            tables.number(call["position_m"], 0),
            tables.number(call["arrival_s"], 1),
            tables.number(call["departure_s"], 1),
            tables.number(call["running_time_s"], 1),
            tables.number(call["minimum_running_time_s"], 1),
            tables.number(call["energy_j"] / J_PER_KWH, 2),
        )
        for call in journey["calls"]
    ]
    columns = (
        "station",
        "place (m)",
        "arrival (s)",
        "departure (s)",
        "running (s)",
        "least (s)",
        "energy (kWh)",
    )
    sheets.table(columns, rows, (2.6, 1.2, 1.3, 1.5, 1.4, 1.2, 1.5), right=range(1, 7))


def journey_figure(journey: dict[str, Any]) -> Figure:
    """Draw a journey: speed over distance, energy and reserve of each section.

    Args:
        journey: Values of :class:`metropilot.web.schemas.responses.JourneyOut`.
    """
    calls = journey["calls"]
    figure, (speed, energy, reserve) = new_panels(8.4, 6.4, (4.0, 2.4, 2.4))
    at_km = [x / 1000 for x in journey["position_m"]]
    speed.plot(at_km, [KMH_PER_MPS * v for v in journey["speed_mps"]], color=BLUE, lw=1.0)
    speed.set_ylabel("speed (km/h)")
    add_headline(speed, f"{calls[0]['station']} – {calls[-1]['station']}", f"{len(calls)} stations")
    edges = [call["position_m"] / 1000 for call in calls]
    widths = [0.9 * (b - a) for a, b in pairwise(edges)]
    middles = [(a + b) / 2 for a, b in pairwise(edges)]
    energy.bar(middles, [call["energy_j"] / J_PER_KWH for call in calls[1:]], widths, color=BLUE)
    label_panel(energy, "energy of the section (kWh)")
    share = [100 * (c["running_time_s"] / max(c["minimum_running_time_s"], 1e-9) - 1) for c in calls[1:]]
    reserve.bar(middles, share, widths, color=ORANGE)
    label_panel(reserve, "running-time reserve (%)")
    reserve.set_xlabel("distance (km)")
    return figure

"""Published pages of the studies, read back from the documentation: verdicts, rows, figures."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from metropilot._io import read_text
from metropilot._published import published_file
from metropilot.errors import InputError
from metropilot.studies.page import NOTHING, ROWS_FILE
from metropilot.studies.report import ReportRow
from metropilot.studies.study import STUDIES

CELL = re.compile(r"(?<!\\)\|")
FIGURE = re.compile(r"(?m)^!\[(?P<caption>.*)\]\([^/)]+/(?P<name>[a-z0-9_]+\.png)\)$")
VERDICTS: tuple[str, ...] = ("claim", "unit", "published", "ours", "interval", "rival", "verdict", "why")
COLUMNS = ("case", "driver", "kpi", "unit", "published", "ours", "range", "optimum")


class PublishedFigure(NamedTuple):
    """A figure of a page.

    Attributes:
        name: File name.
        caption: Its caption.
        path: The file.
    """

    name: str
    caption: str
    path: Path


@dataclass(frozen=True)
class PublishedStudy:
    """The page of a study.

    Attributes:
        id: Id of the study.
        title: Heading of the page.
        written: How and when it was written.
        summary: Verdicts and rivals in words; empty where the paper's claims are not judged.
        verdicts: A row for each claim: ``claim, unit, published, ours, interval, rival, verdict, why``.
        rows: Every number, as far as the page or its file has it.
        figures: Its figures.
    """

    id: str
    title: str
    written: str
    summary: str
    verdicts: tuple[dict[str, str], ...]
    rows: tuple[ReportRow, ...]
    figures: tuple[PublishedFigure, ...]


def published_study(study: str) -> PublishedStudy:
    """Read the published page of a study.

    Args:
        study: Id of the study.

    Raises:
        InputError: No such study, or its page is not there.
    """
    STUDIES.row(study)
    text = read_text(published_file(f"studies/{study}.md"), "page")
    title = text.partition("\n")[0].removeprefix("# ")
    written = re.search(r"(?m)^Written by .*$", text)
    sections = dict(_sections(text))
    judged = sections.get("Verdicts", "")
    rows = tuple(dict(zip(VERDICTS, cells, strict=False)) for cells in _table(judged))
    figures = [
        PublishedFigure(each["name"], each["caption"], published_file(f"studies/{study}/{each['name']}"))
        for each in FIGURE.finditer(text)
    ]
    summary = judged.strip().partition("\n")[0].partition(" *Ours*")[0].replace("**", "")
    told = "" if written is None else written[0]
    return PublishedStudy(study, title, told, summary, rows, _rows(study, sections), tuple(figures))


def _rows(study: str, sections: dict[str, str]) -> tuple[ReportRow, ...]:
    """Rows of the file beside the page, or else those of the page."""
    try:
        path = published_file(f"studies/{study}/{ROWS_FILE}")
    except InputError:
        return tuple(row for name, part in sections.items() for row in _page_rows(name, part))
    with path.open(newline="", encoding="utf-8") as file:
        return tuple(_file_row(row) for row in csv.DictReader(file))


def _file_row(row: dict[str, str]) -> ReportRow:
    table, case, driver, kpi, unit = (row[name] for name in ("table", "case", "driver", "kpi", "unit"))
    numbers = [_number(row[name]) for name in ("published", "ours", "low", "high", "optimum")]
    seeds = [_number(value) for name, value in row.items() if name and name.startswith("seed ")]
    return ReportRow(
        table, case, driver, kpi, unit, *numbers, values=tuple(value for value in seeds if value is not None)
    )


def _page_rows(name: str, part: str) -> Iterator[ReportRow]:
    """Rows of the table of a section; case and driver stand only where they change."""
    if "| case | driver | KPI | unit | published | ours | range | optimum |" not in part:
        return
    case = driver = ""
    for cells in _table(part):
        row = dict(zip(COLUMNS, cells, strict=False))
        if row["case"]:
            case, driver = row["case"], ""
        driver = row["driver"].strip("`") or driver
        published, ours, optimum = (_number(row[key]) for key in ("published", "ours", "optimum"))
        low, _, high = row["range"].partition(" … ")
        ends = (_number(low), _number(high)) if high else (ours, ours)
        yield ReportRow(name, case, driver, row["kpi"], row["unit"], published, ours, *ends, optimum)


def _sections(text: str) -> Iterator[tuple[str, str]]:
    for part in text.split("\n## ")[1:]:
        title, _, rest = part.partition("\n")
        yield title, rest


def _table(part: str) -> Iterator[list[str]]:
    """Cells of the first table of a section, without its heading."""
    lines = [line for line in part.splitlines() if line.startswith("|")]
    for line in lines[2:]:
        yield [cell.strip().replace("\\|", "|") for cell in CELL.split(line)[1:-1]]


def _number(text: str | None) -> float | None:
    text = (text or "").replace("−", "-").replace(",", "")
    return None if text in {"", NOTHING} else float(text)

"""A report as a page of the documentation and as a folder of files, and pages read back."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

from metropilot._io import fill_folder, read_text, to_json
from metropilot._published import published_file
from metropilot.studies.report import LiteralReport, LiteralRow, ReportRow, StudyReport
from metropilot.studies.study import STUDIES, Study
from metropilot.studies.verdict import ClaimVerdict, count_verdicts, sum_up_rivals

if TYPE_CHECKING:
    from metropilot.learn import RunRecord

NOTHING = "–"
LEGEND = (
    "*Ours* is the median over the seeds, *range* their smallest and largest value; *optimum* is the "
    "certified plan for the same running time."
)
VERDICT_LEGEND = (
    "*Ours* is the median over the seeds with the 95 % bootstrap interval of it; *beaten*, *matched* "
    "and *missed* compare it with the published number. *Simple rival* is the best of the drivers without "
    "learning, and *why* says whether the difference from it may be chance (Mann-Whitney, or Wilcoxon "
    "against a driver without random numbers)."
)
LITERAL_LEGEND = (
    "The paper's own settings, as far as it prints them, beside those of this study: *as printed* is the "
    "median over the seeds of a run of the first column, *ours* that of the tables above. What is settled "
    "where the paper is silent or ambiguous is listed with the deviations."
)
LONG = 40
"""Rows from which a table shows only those with a published number; the file holds all."""
ROWS_FILE = "rows.csv"


def number(value: float | None) -> str:
    """Format with three or four significant digits; None becomes a dash."""
    if value is None:
        return NOTHING
    size = abs(value)
    if size >= 1e5 or 0 < size < 1e-3:
        return f"{value:.2e}"
    digits = 0 if size >= 1000 else 1 if size >= 100 else 2 if size >= 1 else 3
    return f"{value:.{digits}f}"


def row_numbers(row: ReportRow) -> tuple[str, str, str, str]:
    """Format the published value, ours, the range and the optimum."""
    return number(row.published), number(row.ours), span(row), number(row.optimum)


def literal_numbers(row: LiteralRow) -> tuple[str, str, str, str]:
    """Format the published value, ours, that of the printed settings and its range."""
    return number(row.published), number(row.ours), number(row.as_printed), span(row)


def span(row: ReportRow | LiteralRow) -> str:
    """Format the range over the seeds; a dash where they agree."""
    if row.low is None or row.high is None or number(row.low) == number(row.high):
        return NOTHING
    return f"{number(row.low)} … {number(row.high)}"


def study_page(study: Study, report: StudyReport) -> str:
    """Render the page as Markdown; its figures are in a folder with the study's id beside it."""
    command = f"metropilot reproduce {study.id} --budget {report.budget}"
    command += " --as-printed" * (report.as_printed is not None)
    about = "; ".join(f"{name}: {value}" for name, value in report.circumstances.items())
    lines = [f"# {report.title}", "", study.citation, ""]
    took = f"{report.seeds} seeds, {report.seconds / 60:.1f} minutes"
    took += " (without learning runs of earlier calls)"
    lines += [f"Written by `{command}`: {took}. {about}.", ""]
    if report.verdicts:
        first = f"{count_verdicts(report.verdicts).capitalize()}. {sum_up_rivals(report.verdicts)}".rstrip()
        lines += ["## Verdicts", "", first, "", VERDICT_LEGEND, ""]
        lines += [*_verdict_table(report.verdicts), ""]
    if report.remarks:
        lines += ["## Findings", "", *(f"- {remark}" for remark in report.remarks), ""]
    lines += [f"{LEGEND} Every row with the value of each seed: [{ROWS_FILE}]({study.id}/{ROWS_FILE}).", ""]
    for name, rows in report.tables().items():
        shown = rows if len(rows) <= LONG else [row for row in rows if row.published is not None]
        lines += [f"## {name}", ""]
        if shown:
            lines += [*_table(shown), ""]
        if len(shown) < len(rows):
            lines += [
                f"{len(rows) - len(shown)} further rows without a published number are in the file.",
                "",
            ]
    if report.as_printed is not None:
        lines += ["## As printed", "", LITERAL_LEGEND, "", *_literal_section(report.as_printed), ""]
    for figure in report.figures:
        lines += [f"![{figure.caption}]({study.id}/{figure.name}.png)", "", f"*{figure.caption}*", ""]
    if report.learning:
        lines += ["## Learning runs", "", *_learning_table(report), ""]
        lines += ["## Hyper-parameters", "", *_settings_table(report.learning), ""]
    if report.deviations:
        lines += ["## Deviations from the paper", ""]
        lines += [f"{n}. {text}" for n, text in enumerate(report.deviations, 1)]
    return "\n".join(lines).rstrip() + "\n"


def _verdict_table(verdicts: Sequence[ClaimVerdict]) -> list[str]:
    lines = ["| claim of the paper | unit | published | ours | interval | simple rival | verdict | why |"]
    lines += ["|---|---|---:|---:|---:|---|---|---|"]
    return [*lines, *(_cells((v.claim, v.unit, *verdict_numbers(v), v.verdict, v.why)) for v in verdicts)]


def verdict_numbers(verdict: ClaimVerdict) -> tuple[str, str, str, str]:
    """Format the published value, ours, the interval and the strongest simple rival."""
    rival = NOTHING if verdict.rival is None else f"{verdict.rival.driver}: {number(verdict.rival.value)}"
    low, high = number(verdict.low), number(verdict.high)
    interval = NOTHING if low == high else f"{low} … {high}"
    return number(verdict.published), number(verdict.ours), interval, rival


def _literal_section(found: LiteralReport) -> list[str]:
    lines = ["| setting | printed | this study |", "|---|---|---|"]
    lines += [_cells((one.name, one.printed, one.ours)) for one in found.settings]
    lines += ["", "| case | driver | KPI | unit | published | ours | as printed | range |"]
    lines += ["|---|---|---|---|---:|---:|---:|---:|"]
    lines += [
        _cells((row.case, f"`{row.driver}`", row.kpi, row.unit, *literal_numbers(row))) for row in found.rows
    ]
    return [*lines, "", *(f"- {remark}" for remark in found.remarks)]


def _learning_table(report: StudyReport) -> list[str]:
    """Render the learning runs: one line for those of one name and commit."""
    lines = ["| run | algorithm | seeds | steps | median time | machine | begun | commit |"]
    lines += ["|---|---|---|---:|---:|---|---|---|"]
    groups: dict[tuple[str, ...], list[RunRecord]] = {}
    for run in report.learning:
        groups.setdefault((run.task, run.algorithm, run.machine, run.commit_id), []).append(run)
    here = report.circumstances.get("commit", "").rstrip("+")
    for (name, algorithm, machine, commit), runs in groups.items():
        seeds = ", ".join(str(run.seed) for run in runs)
        seconds = median(run.seconds for run in runs)
        code = commit[:9] + "+" * commit.endswith("+")
        told = code if commit.rstrip("+").startswith(here) else f"{code} (other code than this page)"
        begun = min(run.created for run in runs)[:10]
        steps = f"{max(run.steps for run in runs):,}"
        lines.append(_cells((name, algorithm, seeds, steps, f"{seconds:.0f} s", machine, begun, told)))
    return lines


def _settings_table(learning: Sequence[RunRecord]) -> list[str]:
    """Render the hyper-parameters of every learning run; runs of one configuration share a column."""
    columns: dict[str, Mapping[str, Any]] = {}
    for run in learning:
        columns.setdefault(run.task, run.config)
    kinds: dict[str, list[str]] = {}
    for name, config in columns.items():
        kinds.setdefault(to_json(config), []).append(name)
    heads = [", ".join(names) for names in kinds.values()]
    configs = [columns[names[0]] for names in kinds.values()]
    fields_of = dict.fromkeys(key for config in configs for key in config)
    rows = ((key, *(_setting(config.get(key)) for config in configs)) for key in fields_of)
    return [_cells(("hyper-parameter", *heads)), "|---|" + "---|" * len(heads), *map(_cells, rows)]


def _setting(value: object) -> str:
    if value is None:
        return NOTHING
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_setting(part)}" for name, part in value.items() if part is not None)
    if isinstance(value, Sequence) and not isinstance(value, str):
        return " × ".join(_setting(part) for part in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _cells(cells: Iterable[str]) -> str:
    return "| " + " | ".join(re.sub(r"([|])", r"\\\1", cell) for cell in cells) + " |"


def _table(rows: list[ReportRow]) -> list[str]:
    """Render one table; case and driver are repeated only where they change."""
    lines = ["| case | driver | KPI | unit | published | ours | range | optimum |"]
    lines += ["|---|---|---|---|---:|---:|---:|---:|"]
    before = ("", "")
    for row in rows:
        case = "" if row.case == before[0] else row.case
        driver = "" if (row.case, row.driver) == before else f"`{row.driver}`"
        before = (row.case, row.driver)
        cells = (case, driver, row.kpi, row.unit, *row_numbers(row))
        lines.append(_cells(cells))
    return lines


def write_rows(path: Path, report: StudyReport) -> None:
    """Write every row as a table of comma-separated values, with the value of each seed.

    Rows of the printed settings follow as a table of their own.
    """
    literal = [] if report.as_printed is None else report.as_printed.rows
    rows = [*report.rows, *(_plain_row(row) for row in literal)]
    count = max((len(row.values) for row in rows), default=0)
    names = [f.name for f in fields(ReportRow) if f.name != "values"]
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow([*names, *(f"seed {k}" for k in range(count))])
        for row in rows:
            table.writerow([*(getattr(row, name) for name in names), *row.values])


def _plain_row(row: LiteralRow) -> ReportRow:
    numbers = {"published": row.published, "ours": row.as_printed, "low": row.low, "high": row.high}
    return ReportRow("As printed", row.case, row.driver, row.kpi, row.unit, **numbers, values=row.values)


def write_figures(folder: Path, report: StudyReport) -> None:
    """Draw every figure into a folder, as SVG and PNG, and write every row.

    Raises:
        InputError: The folder cannot be written.
    """
    from matplotlib import pyplot as plt

    from metropilot.evaluate import house_style, save_figure

    with fill_folder(folder) as scratch:
        for figure in report.figures:
            with house_style():
                drawing = figure.draw()
                save_figure(drawing, scratch / figure.name)
                plt.close(drawing)
        write_rows(scratch / ROWS_FILE, report)


def write_report(folder: Path, study: Study, report: StudyReport) -> None:
    """Write `report.json`, `ID.md` the figures and `rows.csv` in folder `ID`.

    Raises:
        InputError: The folder cannot be written.
    """
    write_figures(folder / study.id, report)
    with fill_folder(folder) as scratch:
        (scratch / "report.json").write_text(to_json(report.as_dict()) + "\n")
        (scratch / f"{study.id}.md").write_text(study_page(study, report))


def write_docs(folder: Path, study: Study, report: StudyReport) -> None:
    """Write the page and its figures and rows into the documentation; PNG only, to keep the site small.

    Raises:
        InputError: The folder cannot be written.
    """
    write_figures(folder / study.id, report)
    for drawing in (folder / study.id).glob("*.svg"):
        drawing.unlink()
    with fill_folder(folder) as scratch:
        (scratch / f"{study.id}.md").write_text(study_page(study, report))


CELL = re.compile(r"(?<!\\)\|")
FIGURE = re.compile(r"(?m)^!\[(?P<caption>.*)\]\([^/)]+/(?P<name>[a-z0-9_]+\.png)\)$")
VERDICTS: tuple[str, ...] = ("claim", "unit", "published", "ours", "interval", "rival", "verdict", "why")


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
        rows: Every number.
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
    judged = dict(_sections(text)).get("Verdicts", "")
    rows = tuple(dict(zip(VERDICTS, cells, strict=False)) for cells in _read_table(judged))
    figures = [
        PublishedFigure(each["name"], each["caption"], published_file(f"studies/{study}/{each['name']}"))
        for each in FIGURE.finditer(text)
    ]
    summary = judged.strip().partition("\n")[0].partition(" *Ours*")[0].replace("**", "")
    told = "" if written is None else written[0]
    return PublishedStudy(study, title, told, summary, rows, _read_rows(study), tuple(figures))


def _read_rows(study: str) -> tuple[ReportRow, ...]:
    with published_file(f"studies/{study}/{ROWS_FILE}").open(newline="", encoding="utf-8") as file:
        return tuple(_file_row(row) for row in csv.DictReader(file))


def _file_row(row: dict[str, str]) -> ReportRow:
    table, case, driver, kpi, unit = (row[name] for name in ("table", "case", "driver", "kpi", "unit"))
    numbers = [_number(row[name]) for name in ("published", "ours", "low", "high", "optimum")]
    seeds = [_number(value) for name, value in row.items() if name and name.startswith("seed ")]
    return ReportRow(
        table, case, driver, kpi, unit, *numbers, values=tuple(value for value in seeds if value is not None)
    )


def _sections(text: str) -> Iterator[tuple[str, str]]:
    for part in text.split("\n## ")[1:]:
        title, _, rest = part.partition("\n")
        yield title, rest


def _read_table(part: str) -> Iterator[list[str]]:
    """Cells of the first table of a section, without its heading."""
    lines = [line for line in part.splitlines() if line.startswith("|")]
    for line in lines[2:]:
        yield [cell.strip().replace("\\|", "|") for cell in CELL.split(line)[1:-1]]


def _number(text: str | None) -> float | None:
    return float(text) if text else None

"""A report as a page of the documentation, and as a folder of files."""

from __future__ import annotations

import re
from pathlib import Path

from metropilot._io import fill_folder, to_json
from metropilot.studies.report import ReportRow, StudyReport
from metropilot.studies.study import Study

NOTHING = "–"
LEGEND = (
    "*Ours* is the median over the seeds, *range* their smallest and largest value; *optimum* is the "
    "certified plan for the same running time."
)


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


def span(row: ReportRow) -> str:
    """Format the range over the seeds; a dash where they agree."""
    if row.low is None or row.high is None or number(row.low) == number(row.high):
        return NOTHING
    return f"{number(row.low)} … {number(row.high)}"


def study_page(study: Study, report: StudyReport) -> str:
    """Render the page as Markdown; its figures are in a folder with the study's id beside it."""
    command = f"metropilot reproduce {study.id} --budget {report.budget}"
    about = "; ".join(f"{name}: {value}" for name, value in report.circumstances.items())
    lines = [f"# {report.title}", "", study.citation, ""]
    took = f"{report.seeds} seeds, {report.seconds / 60:.1f} minutes"
    took += " (without learning runs of earlier calls)"
    lines += [f"Written by `{command}`: {took}. {about}.", "", LEGEND, ""]
    if report.remarks:
        lines += ["## Findings", "", *(f"- {remark}" for remark in report.remarks), ""]
    for name, rows in report.tables().items():
        lines += [f"## {name}", "", *_table(rows), ""]
    for figure in report.figures:
        lines += [f"![{figure.caption}]({study.id}/{figure.name}.png)", "", f"*{figure.caption}*", ""]
    if report.deviations:
        lines += ["## Deviations from the paper", ""]
        lines += [f"{n}. {text}" for n, text in enumerate(report.deviations, 1)]
    return "\n".join(lines).rstrip() + "\n"


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
        lines.append("| " + " | ".join(re.sub(r"([|])", r"\\\1", cell) for cell in cells) + " |")
    return lines


def write_figures(folder: Path, report: StudyReport) -> None:
    """Draw every figure into a folder, as SVG and PNG.

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


def write_report(folder: Path, study: Study, report: StudyReport) -> None:
    """Write `report.json`, `ID.md` and the figures in folder `ID`.

    Raises:
        InputError: The folder cannot be written.
    """
    write_figures(folder / study.id, report)
    with fill_folder(folder) as scratch:
        (scratch / "report.json").write_text(to_json(report.as_dict()) + "\n")
        (scratch / f"{study.id}.md").write_text(study_page(study, report))


def write_docs(folder: Path, study: Study, report: StudyReport) -> None:
    """Write the page and its figures into the documentation; PNG only, to keep the site small.

    Raises:
        InputError: The folder cannot be written.
    """
    write_figures(folder / study.id, report)
    for drawing in (folder / study.id).glob("*.svg"):
        drawing.unlink()
    with fill_folder(folder) as scratch:
        (scratch / f"{study.id}.md").write_text(study_page(study, report))

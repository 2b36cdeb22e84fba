"""Results of a campaign of any kind, collected and summarised; its report and page."""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import UTC, datetime
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from metropilot._io import atomic_write
from metropilot._provenance import provenance
from metropilot.campaign.matrix import AbstractCampaign
from metropilot.campaign.store import PARTS_FOLDER, TIMINGS_FOLDER, CampaignStore, campaign_of_folder
from metropilot.errors import InputError

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection
    from matplotlib.figure import Figure

RESULTS_FILE, TIMINGS_FILE = "results.parquet", "timings.parquet"
DASH = "–"
REPORT = "report.html"
STYLE = """
body{font:14px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:76rem;padding:0 1rem;color:#202020}
h1{font-size:1.5rem}h2{font-size:1.15rem;margin-top:2rem}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;margin:.6rem 0}
th,td{padding:.25rem .7rem;border-bottom:1px solid #d9d9d9;text-align:right;vertical-align:top}
th:first-child,td:first-child,td.text,th.text{text-align:left}th{border-bottom:2px solid #6b6b6b}
small{color:#6b6b6b}code{background:#efefef;padding:0 .25rem}svg{max-width:100%;height:auto}
.wide{overflow-x:auto}
.runs{display:grid;grid-template-columns:repeat(auto-fill,minmax(26rem,1fr));gap:1.2rem}
figure{margin:0}figcaption{font-size:.9rem}
"""


def open_database(folder: Path) -> DuckDBPyConnection:
    """Open a database with the view ``runs``: the results of its groups with their rows and timings."""
    import duckdb

    group = campaign_of_folder(folder).group_column
    database = duckdb.connect(config={"memory_limit": "512MB"})
    database.execute(
        f"CREATE VIEW runs AS SELECT * FROM ({_parts(folder, PARTS_FOLDER)}) AS result "
        f"LEFT JOIN ({_parts(folder, TIMINGS_FOLDER)}) AS timing USING (row, {group}, cell)"
    )
    return database


def _parts(folder: Path, kind: str) -> str:
    """Query for all parts of one kind, ordered by group, with the number of the row."""
    campaign = campaign_of_folder(folder)
    group = campaign.group_column
    quoted = [name.replace("'", "''") for name in campaign.groups]
    names = ", ".join(f"'{name}'" for name in quoted)
    parts = str(folder / kind / "*" / "*.parquet").replace("'", "''")
    columns = campaign.columns if kind == PARTS_FOLDER else campaign.timing_columns
    # parts of an earlier version lack the columns of a later one
    whole = ", ".join(f"NULL::{sql} AS {name}" for name, sql in {"row": "BIGINT", **columns}.items())
    return (
        f"SELECT {whole} WHERE false UNION ALL BY NAME "
        f"SELECT (list_position([{names}], {group}) - 1) * {campaign.cells} + cell AS row, * "
        f"FROM read_parquet('{parts}', union_by_name=true) WHERE {group} IN ({names})"
    )


def collect_parts(folder: Path) -> None:
    """Write all parts as one file each: ``results.parquet``, ``timings.parquet``, ordered by row.

    Raises:
        InputError: A file cannot be written, or a part cannot be read.
    """
    for kind, target in ((PARTS_FOLDER, RESULTS_FILE), (TIMINGS_FOLDER, TIMINGS_FILE)):
        query = f"SELECT * FROM ({_parts(folder, kind)}) ORDER BY row"
        atomic_write(folder / target, lambda partial, query=query: _copy(query, partial))


def _copy(query: str, partial: Path) -> None:
    import duckdb

    place = str(partial).replace("'", "''")
    with duckdb.connect(config={"threads": 1, "memory_limit": "512MB"}) as database:
        try:
            database.execute(f"COPY ({query}) TO '{place}' (FORMAT parquet, COMPRESSION zstd)")
        except duckdb.Error as error:
            words = str(error).splitlines()[0]
            raise InputError("cannot collect the results", file=partial, value=words) from None


def summarise(folder: Path) -> dict[str, Any]:
    """Summarise a campaign as plain values.

    Args:
        folder: Folder of the campaign, which may be unfinished.

    Returns:
        ``campaign, kind, digest, rows, done, checksum``; ``cost`` holds processor time and memory. Of drives
        also lists of rows ``drivers`` (one per driver), ``cells`` (one per driver and disturbance) and
        ``worst``; of lines ``lines``, one per row.

    Raises:
        InputError: Not the folder of a campaign.
    """
    campaign = campaign_of_folder(folder)
    store = CampaignStore(folder, campaign)
    done = store.finished_rows()
    found: dict[str, Any] = {
        "campaign": campaign.name,
        "kind": campaign.kind,
        "digest": campaign.digest,
        "rows": campaign.rows,
        "done": done,
        "checksum": store.checksum(),
    }
    if not done:
        return found | campaign.statistics(None) | {"cost": {}}
    with open_database(folder) as database:
        return found | campaign.statistics(database) | {"cost": query_rows(database, COST)[0]}


COST = """
    SELECT sum(processor_s) AS processor_s, avg(processor_s) AS processor_s_mean,
        quantile_cont(processor_s, 0.95) AS processor_s_95, max(worker_mb) AS worker_mb FROM runs
"""


def query_rows(
    database: DuckDBPyConnection, query: str, values: Sequence[object] = ()
) -> list[dict[str, Any]]:
    """The rows of a query, as dictionaries.

    Args:
        database: The database.
        query: The query.
        values: Values of its question marks.
    """
    answer = database.execute(query, list(values))
    names = [column[0] for column in answer.description or ()]
    return [dict(zip(names, row, strict=True)) for row in answer.fetchall()]


def number(value: int | float | None, digits: int, sign: str = "") -> str:
    """A number with some digits; a dash for None."""
    return DASH if value is None else f"{value:{sign}.{digits}f}"


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table, its first column flush left and the others right; a bar in a cell is escaped."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in each) + " |" for each in (heads, *rows)]
    return [lines[0], "|---" + "|---:" * (len(heads) - 1) + "|", *lines[1:]]


def inline_svg(draw: Callable[[], Figure]) -> str:
    """A figure, drawn in the house style, as SVG for a page."""
    from metropilot.evaluate import house_style

    text = io.StringIO()
    with house_style():
        draw().savefig(text, format="svg", metadata={"Date": None})
    return "".join(text.getvalue().partition("<svg")[1:])


def write_campaign_report(folder: Path, summary: Mapping[str, Any], about: Mapping[str, str]) -> Path:
    """Write ``report.html``, one file that loads nothing; of drives also a folder ``worst/NN`` for the worst.

    Args:
        folder: The campaign's folder.
        summary: From :func:`summarise`.
        about: Further lines of the head by name: time, machine, commit.

    Raises:
        InputError: The folder cannot be written.
    """
    campaign = campaign_of_folder(folder)
    title = f"<h1>Campaign {escape(campaign.name)}</h1>"
    body = "\n".join([title, _head(campaign, summary, about), *campaign.report_parts(folder, summary)])
    head = f"<meta charset='utf-8'><title>{escape(campaign.name)}</title><style>{STYLE}</style>"
    path = folder / REPORT
    text = f"<!doctype html><html lang='en'><head>{head}</head><body>{body}</body></html>\n"
    atomic_write(path, lambda partial: partial.write_text(text, encoding="utf-8"))
    return path


def _head(campaign: AbstractCampaign, summary: Mapping[str, Any], about: Mapping[str, str]) -> str:
    lines = [f"{summary['done']} of {summary['rows']} rows: {campaign.matrix_words}."]
    cost = summary["cost"]
    if cost:
        lines.append(
            f"{cost['processor_s']:.0f} s of processor time, {cost['processor_s_mean']:.3f} s a row "
            f"(95 %: {cost['processor_s_95']:.3f} s); workers used up to {cost['worker_mb']:.0f} MB."
        )
    lines.append(f"Checksum of the results: <code>{summary['checksum']}</code>.")
    lines += [f"{escape(name)}: {escape(text)}." for name, text in about.items()]
    return "".join(f"<p>{line}</p>" for line in lines)


def write_campaign_page(
    page: Path, folder: Path, summary: Mapping[str, Any], seconds: float, command: str
) -> None:
    """Write a campaign as a page of the documentation.

    Args:
        page: File to write.
        folder: The campaign's folder.
        summary: From :func:`summarise`.
        seconds: Duration of the command.
        command: Command line.

    Raises:
        InputError: It cannot be written.
    """
    campaign = campaign_of_folder(folder)
    written = written_words(f"{command} --write-docs {page}", summary, seconds)
    lines = [f"# {campaign.name[:1].upper()}{campaign.name[1:]}", ""]
    lines += campaign.page_parts(folder, summary, written)
    text = "\n".join(lines).rstrip() + "\n"
    atomic_write(page, lambda partial: partial.write_text(text, encoding="utf-8"))


def written_words(command: str, summary: Mapping[str, Any], seconds: float) -> str:
    """Command, cost, machine, date, commit and versions of what is written from a campaign, as a sentence.

    Args:
        command: Command line.
        summary: From :func:`summarise`.
        seconds: Duration of the command.
    """
    made = provenance()
    spent, today = summary["cost"].get("processor_s", 0.0), datetime.now(UTC).date().isoformat()
    return (
        f"Written by `{command}`: {summary['done']} rows, {seconds:.0f} s in the last "
        f"call, {spent:.0f} s of processor time; {os.cpu_count()} cores; date {today}; "
        f"commit {made.get('commit', DASH)[:9]}; metropilot {made['metropilot']}, Python {made['python']}."
    )

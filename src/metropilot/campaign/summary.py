"""Summary of a campaign by DuckDB: statistics by driver and disturbance, and the worst runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from metropilot._io import atomic_write
from metropilot.campaign.rows import FAILED, INFEASIBLE
from metropilot.campaign.store import PARTS_FOLDER, TIMINGS_FOLDER, CampaignStore, stored_campaign
from metropilot.errors import InputError

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

CONFIDENCE = 0.95
WORST = 10
RESULTS_FILE, TIMINGS_FILE = "results.parquet", "timings.parquet"
DRIVEN = f"outcome <> '{INFEASIBLE}'"
POSSIBLE = f"{DRIVEN} AND coalesce(scheduled_time_s >= minimum_running_time_s, true)"
"""Condition that the true plant can keep the scheduled time with all restrictions known in advance."""
NUMBERS = f"""
    count(*) AS runs,
    count(*) FILTER ({DRIVEN}) AS driven,
    count(*) FILTER (NOT ({POSSIBLE})) AS impossible,
    count(*) FILTER (outcome = '{FAILED}') AS failed,
    count(*) FILTER ({POSSIBLE}) AS possible,
    count(*) FILTER ({POSSIBLE} AND success) AS successes,
    count(*) FILTER ({DRIVEN} AND coalesce(safe, false)) AS safe,
    count(*) FILTER (outcome = 'arrived') AS arrived,
    count(*) FILTER (outcome = 'arrived' AND punctual) AS punctual,
    count(*) FILTER (interventions > 0) AS intervened,
    count(optimality_gap_percent) AS compared,
    median(optimality_gap_percent) AS gap_median,
    quantile_cont(optimality_gap_percent, 0.95) AS gap_95,
    max(optimality_gap_percent) AS gap_worst,
    median(abs(time_error_s)) FILTER (outcome = 'arrived' AND {POSSIBLE}) AS late_median_s,
    max(abs(time_error_s)) FILTER (outcome = 'arrived' AND {POSSIBLE}) AS late_worst_s,
    max(abs(stopping_error_m)) FILTER (outcome = 'arrived') AS stop_worst_m,
    median(comfort_huang2025) FILTER (outcome = 'arrived') AS comfort_median,
    max(max_jerk_mps3) FILTER (outcome = 'arrived') AS jerk_worst_mps3,
    max(max_overspeed_mps) AS overspeed_worst_mps,
    median(decision_us_median) AS decision_us_median,
    max(decision_us_max) AS decision_us_worst,
    median(processor_s) AS processor_s_median
"""
WORST_FIRST = f"""
    SELECT * FROM runs WHERE {DRIVEN} ORDER BY
        (outcome = '{FAILED}') DESC, coalesce(safe, false), success OR NOT ({POSSIBLE}),
        CASE WHEN success OR NOT ({POSSIBLE}) THEN NULL ELSE abs(time_error_s) END DESC NULLS LAST,
        optimality_gap_percent DESC NULLS LAST, row
    LIMIT {WORST}
"""


def open_database(folder: Path) -> DuckDBPyConnection:
    """Open a database with the view ``runs``: the results of the drivers with their rows and timings."""
    import duckdb

    database = duckdb.connect(config={"memory_limit": "512MB"})
    database.execute(
        f"CREATE VIEW runs AS SELECT * FROM ({_parts(folder, PARTS_FOLDER)}) AS result "
        f"LEFT JOIN ({_parts(folder, TIMINGS_FOLDER)}) AS timing USING (row, driver, cell)"
    )
    return database


def _parts(folder: Path, kind: str) -> str:
    """Query for all parts of one kind, ordered by driver, with the number of the row."""
    campaign = stored_campaign(folder)
    quoted = [name.replace("'", "''") for name in campaign.drivers]
    names = ", ".join(f"'{name}'" for name in quoted)
    parts = str(folder / kind / "*" / "*.parquet").replace("'", "''")
    return (
        f"SELECT (list_position([{names}], driver) - 1) * {campaign.cells} + cell AS row, * "
        f"FROM read_parquet('{parts}', union_by_name=true) WHERE driver IN ({names})"
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
    """Write a query's rows as Parquet."""
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
        ``campaign, digest, rows, done, checksum``, and lists of rows ``drivers`` (one per driver), ``cells``
        (one per driver and disturbance) and ``worst``; ``cost`` holds processor time and memory.

    Raises:
        InputError: Not the folder of a campaign.
    """
    campaign = stored_campaign(folder)
    store = CampaignStore(folder, campaign)
    done = sum(len(campaign.shard(piece)) for piece in store.done())
    found: dict[str, Any] = {
        "campaign": campaign.name,
        "digest": campaign.digest,
        "rows": campaign.rows,
        "done": done,
        "checksum": store.checksum(),
    }
    if not done:
        return found | {"drivers": [], "cells": [], "worst": [], "cost": {}}
    with open_database(folder) as database:
        drivers = group_statistics(database, "driver")
        cells = group_statistics(database, "driver", "disturbance")
        worst = query_rows(database, WORST_FIRST)
        cost = query_rows(database, COST)[0]
    return found | {"drivers": drivers, "cells": cells, "worst": worst, "cost": cost}


COST = """
    SELECT sum(processor_s) AS processor_s, avg(processor_s) AS processor_s_mean,
        quantile_cont(processor_s, 0.95) AS processor_s_95, max(worker_mb) AS worker_mb FROM runs
"""


def query_rows(database: DuckDBPyConnection, query: str) -> list[dict[str, Any]]:
    """The rows of a query, as dictionaries."""
    answer = database.execute(query)
    names = [column[0] for column in answer.description or ()]
    return [dict(zip(names, row, strict=True)) for row in answer.fetchall()]


def group_statistics(database: DuckDBPyConnection, *by: str) -> list[dict[str, Any]]:
    """Statistics by group, with 95 % intervals of the shares and of the median gap."""
    keys = ", ".join(by)
    rows = query_rows(database, f"SELECT {keys}, {NUMBERS} FROM runs GROUP BY ALL ORDER BY min(row)")
    for row in rows:
        row["success_low"], row["success_high"] = share_interval(row["successes"], row["possible"])
        row["safe_low"], row["safe_high"] = share_interval(row["safe"], row["driven"])
        low, high = median_ranks(row["compared"])
        where = " AND ".join(f"{key} = ?" for key in by)
        ends = database.execute(
            f"SELECT quantile_disc(optimality_gap_percent, [{low}, {high}]) FROM runs WHERE {where}",
            [row[key] for key in by],
        ).fetchone()
        row["gap_low"], row["gap_high"] = ends[0] if ends and ends[0] else (None, None)
    return rows


def share_interval(hits: int, total: int) -> tuple[float | None, float | None]:
    """95 % interval of a share. Source: Wilson (1927), from SciPy."""
    if total == 0:
        return None, None
    from scipy.stats import binomtest

    found = binomtest(hits, total).proportion_ci(CONFIDENCE, method="wilson")
    return float(found.low), float(found.high)


def median_ranks(count: int) -> tuple[float, float]:
    """Quantiles between which the median lies with 95 % confidence, whatever the distribution.

    The number of values below the median is binomial. Source: Conover, Practical Nonparametric Statistics
    (1999), section 3.2.
    """
    from scipy.stats import binom

    if count == 0:
        return 0.0, 1.0
    tail = 0.5 * (1.0 - CONFIDENCE)
    low = max(float(binom.ppf(tail, count, 0.5)) - 1.0, 0.0) / count
    high = min(float(binom.ppf(1.0 - tail, count, 0.5)) + 1.0, count) / count
    return low, high

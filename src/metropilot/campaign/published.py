"""Rows of a campaign as one file: results and timings, with the campaign and how they were computed.

The rows behind the pages of the documentation are such files, beside the pages and in the wheel.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import metropilot
from metropilot._io import atomic_write, encode_parquet
from metropilot._published import published_file
from metropilot.campaign.declared import Campaign
from metropilot.campaign.matrix import AbstractCampaign, Shard, from_text
from metropilot.campaign.report import open_database, query_rows
from metropilot.campaign.rows import request_of_row
from metropilot.campaign.store import CampaignStore, campaign_of_folder
from metropilot.errors import InputError
from metropilot.evaluate import RunSpec

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

SUFFIX = ".parquet"
PUBLISHED = ("leaderboard", "robustness", "trainsets")
"""Campaigns whose rows are beside their pages."""
TIMED = ("decision_us_median", "decision_us_max", "processor_s")
"""Columns of the timings that are published."""
NAMES = ("driver", "line", "trainset", "error")
"""Columns that may hold the name of a file."""


@dataclass(frozen=True)
class CampaignRows:
    """The rows of a campaign: of its folder, finished or not, or of a published file.

    Attributes:
        source: Folder or file.
        campaign: The campaign.
        written: How and when the rows were computed; empty for a folder.
    """

    source: Path
    campaign: AbstractCampaign
    written: str = ""

    def open(self) -> DuckDBPyConnection:
        """A database with the view ``runs``.

        Raises:
            InputError: Nothing is computed yet.
        """
        if self.source.is_dir():
            if not any(self.source.glob("parts/*/*.parquet")):
                raise InputError("no row is computed yet", field="campaign", value=self.campaign.name)
            return open_database(self.source)
        import duckdb

        database = duckdb.connect(config={"memory_limit": "512MB"})
        place = str(self.source).replace("'", "''")
        database.execute(f"CREATE VIEW runs AS SELECT * FROM read_parquet('{place}')")
        return database

    def statistics(self) -> dict[str, Any]:
        """Statistics by driver (``drivers``), and by driver and disturbance (``cells``)."""
        with self.open() as database:
            return self.campaign.statistics(database)

    def find(
        self,
        wanted: Mapping[str, str] | None = None,
        *,
        sort: str = "row",
        ascending: bool = True,
        limit: int = 100,
        offset: int = 0,
    ) -> tuple[int, list[dict[str, Any]]]:
        """Number of the rows that have some values, and those of them that are asked for.

        Args:
            wanted: Value by column, as text.
            sort: Column by which they are sorted; rows without a value come last.
            ascending: Smallest first.
            limit: Rows at most.
            offset: Rows that are left out before the first.

        Raises:
            InputError: No such column, or nothing is computed yet.
        """
        wanted = wanted or {}
        with self.open() as database:
            known = [name for name, *_ in database.execute("DESCRIBE runs").fetchall()]
            for name in (*wanted, sort):
                if name not in known:
                    raise InputError("no such column", field="column", value=name, allowed=", ".join(known))
            where = " AND ".join([f'CAST("{name}" AS VARCHAR) = ?' for name in wanted] or ["true"])
            values = list(wanted.values())
            count = database.execute(f"SELECT count(*) FROM runs WHERE {where}", values).fetchone()
            way = "ASC" if ascending else "DESC"
            rows = query_rows(
                database,
                f'SELECT * FROM runs WHERE {where} ORDER BY "{sort}" {way} NULLS LAST, row '
                f"LIMIT {int(limit)} OFFSET {int(offset)}",
                values,
            )
        return 0 if count is None else int(count[0]), rows

    def write(self, path: Path, names: Mapping[str, str]) -> None:
        """Write all rows as one Parquet file.

        Args:
            path: File to write.
            names: What stands in it instead of some texts, as paths of files.

        Raises:
            InputError: Nothing is computed yet.
        """
        place = str(path).replace("'", "''")
        shown = ", ".join(
            f"{'replace(' * len(names)}{name}{', ?, ?)' * len(names)} AS {name}" for name in NAMES
        )
        with self.open() as database:
            database.execute(
                f"COPY (SELECT * REPLACE ({shown}) FROM runs ORDER BY row) TO '{place}' (FORMAT parquet)",
                [text for pair in names.items() for text in pair] * len(NAMES),
            )

    def request(self, number: int) -> RunSpec:
        """A row as a run.

        Args:
            number: Number of the row.

        Raises:
            InputError: No such row, it is no run of a driver, or it has no scheduled time.
        """
        if not isinstance(self.campaign, Campaign):
            raise InputError("its rows are lines, no runs", field="campaign", value=self.campaign.name)
        _, rows = self.find({"row": str(number)})
        if not rows:
            raise InputError(
                "no such row", field="row", value=number, allowed=f"0 to {self.campaign.rows - 1}"
            )
        return request_of_row(self.campaign, rows[0])


def restore_rows(campaign: AbstractCampaign, folder: Path, path: Path, names: Mapping[str, str]) -> int:
    """Keep the rows of a file of :meth:`CampaignRows.write` as shards of a folder; return their number.

    A campaign goes on from them. Rows of a shard that the file does not hold whole are left out.

    Args:
        campaign: The campaign.
        folder: Folder of the shards.
        path: The file, of which nothing is trusted.
        names: What some texts of the file stand for, as paths of files.

    Raises:
        InputError: The file cannot be read, has other columns, or the folder cannot be written.
    """
    import duckdb

    store, count = CampaignStore(folder, campaign), 0
    columns = {**campaign.columns, **campaign.timing_columns}
    cast = ", ".join(f"TRY_CAST({name} AS {kind}) AS {name}" for name, kind in columns.items())
    query = f"SELECT {cast} FROM read_parquet(?) WHERE row BETWEEN ? AND ? ORDER BY row"
    with duckdb.connect(config={"memory_limit": "512MB", "threads": 1}) as database:
        for piece in campaign.pieces():
            rows = campaign.shard(piece)
            try:
                found = query_rows(database, query, [str(path), rows[0], rows[-1]])
            except duckdb.Error as error:
                told = str(error).splitlines()[0]
                raise InputError("not the rows of a campaign", file=path, value=told[:120]) from None
            if len(found) != len(rows):
                continue
            base = campaign.groups.index(piece.group) * campaign.cells
            for number, row in zip(rows, found, strict=True):
                for name in NAMES:
                    for text, meant in names.items() if row.get(name) else ():
                        row[name] = row[name].replace(text, meant)
                row |= {campaign.group_column: piece.group, "cell": number - base}
            results, timings = (
                encode_parquet(kinds, found) for kinds in (campaign.columns, campaign.timing_columns)
            )
            store.keep(Shard(piece, len(rows), results, timings, metropilot.__version__))
            count += len(rows)
    return count


def publish_rows(folder: Path, path: Path, written: str) -> None:
    """Write the rows of a campaign's folder as one file.

    Args:
        folder: The campaign's folder.
        path: File to write, ending in ``.parquet``.
        written: How and when they were computed.

    Raises:
        InputError: Another ending, or the file cannot be written.
    """
    if path.suffix != SUFFIX:
        raise InputError(
            "not a file of rows", file=path, field="write-rows", allowed=f"a name ending in {SUFFIX}"
        )
    campaign = campaign_of_folder(folder)
    columns = ", ".join(("row", *campaign.columns, *TIMED))
    told = {"campaign": campaign.text, "written": written}
    pairs = ", ".join("{}: '{}'".format(key, text.replace("'", "''")) for key, text in told.items())

    def write(partial: Path) -> None:
        place = str(partial).replace("'", "''")
        with open_database(folder) as database:
            database.execute("SET threads = 1")
            database.execute(
                f"COPY (SELECT {columns} FROM runs ORDER BY row) TO '{place}' "
                f"(FORMAT parquet, COMPRESSION zstd, KV_METADATA {{{pairs}}})"
            )

    atomic_write(path, write)


def rows_of_folder(folder: Path) -> CampaignRows:
    """Rows of a campaign's folder, which may be unfinished.

    Raises:
        InputError: Not the folder of a campaign.
    """
    return CampaignRows(folder, campaign_of_folder(folder))


@lru_cache
def published_rows(name: str) -> CampaignRows:
    """Rows behind a page of the documentation.

    Args:
        name: One of ``PUBLISHED``.

    Raises:
        InputError: No rows of that name are published.
    """
    import duckdb

    if name not in PUBLISHED:
        raise InputError("no such rows", field="campaign", value=name, allowed=", ".join(PUBLISHED))
    path = published_file(f"{name}{SUFFIX}")
    with duckdb.connect() as database:
        found = database.execute("SELECT key, value FROM parquet_kv_metadata(?)", [str(path)]).fetchall()
    told = {_text(key): _text(value) for key, value in found}
    return CampaignRows(path, from_text(told["campaign"]), told["written"])


def _text(value: bytes | str) -> str:
    return value.decode() if isinstance(value, bytes) else value

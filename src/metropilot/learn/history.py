"""The history of a run as Parquet, by DuckDB: one column a measure, one row a chunk."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from metropilot._io import atomic_write
from metropilot.errors import InputError


def write_history(path: Path, history: Mapping[str, np.ndarray]) -> None:
    """Write a history; what is not a number becomes empty.

    Args:
        path: NAME.parquet.
        history: Columns of equal length.

    Raises:
        InputError: The file cannot be written.
    """
    import duckdb

    columns = {name: np.asarray(column, np.float64) for name, column in history.items()}

    def write(partial: Path) -> None:
        with duckdb.connect() as database:
            database.register("history", columns)
            target = str(partial).replace("'", "''")
            try:
                database.execute(
                    f"COPY (SELECT * FROM history) TO '{target}' (FORMAT parquet, COMPRESSION zstd)"
                )
            except duckdb.IOException as error:
                raise InputError(
                    "cannot write the file", file=path, value=str(error).splitlines()[0]
                ) from None

    atomic_write(path, write)


def read_history(path: str | Path) -> dict[str, np.ndarray]:
    """Read a history; what is empty becomes NaN.

    Raises:
        InputError: The file cannot be read or is not Parquet.
    """
    import duckdb

    with duckdb.connect() as database:
        try:
            columns = database.execute("SELECT * FROM read_parquet(?)", [str(path)]).fetchnumpy()
        except duckdb.Error as error:
            raise InputError("cannot read the history", file=path, value=str(error).splitlines()[0]) from None
    return {name: np.ma.filled(np.ma.asarray(column, np.float64), np.nan) for name, column in columns.items()}

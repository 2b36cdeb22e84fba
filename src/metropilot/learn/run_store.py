"""Run store of learning: run folders and their index.

A run is a folder with ``run.toml`` (resolved configuration, seed, versions, commit, result),
``history.parquet``, ``policy.safetensors`` and ``checkpoint.safetensors``. The index is an SQLite file beside
them; lost or damaged, it is made anew from the folders. A run that says it is running while no process holds
its folder's lock was interrupted, and is shown so.
"""

from __future__ import annotations

import json
import math
import secrets
import shutil
import sqlite3
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from metropilot._io import atomic_write, is_locked, open_database
from metropilot._provenance import LEARNING, commit, machine, versions
from metropilot.errors import InputError
from metropilot.learn.config import AbstractConfig, config_from_mapping, config_to_mapping

Status = Literal["running", "interrupted", "done", "failed"]
INDEX_FILE = "index.sqlite"
RECORD_FILE, HISTORY_FILE, CHECKPOINT_FILE = "run.toml", "history.parquet", "checkpoint.safetensors"
"""Files of a run's folder, beside its policy."""
SCHEMA = """
CREATE TABLE IF NOT EXISTS runs (
    id TEXT PRIMARY KEY, algorithm TEXT NOT NULL, task TEXT NOT NULL, seed INTEGER NOT NULL, status TEXT NOT
    NULL, created TEXT NOT NULL, seconds REAL NOT NULL, steps INTEGER NOT NULL, score REAL, commit_id TEXT NOT
    NULL, config TEXT NOT NULL, about TEXT NOT NULL, versions TEXT NOT NULL, driver TEXT NOT NULL, command
    TEXT NOT NULL, machine TEXT NOT NULL, kpis TEXT NOT NULL, compile_seconds REAL NOT NULL
)
"""
SCHEMA_VERSION = 3
LARGEST = 2**63
"""Above what SQLite holds."""
PLAIN = {"config", "about", "versions", "kpis"}


@dataclass(frozen=True)
class RunRecord:
    """One run.

    Attributes:
        id: Name of its folder.
        algorithm: ``ppo``, ...
        task: Name of the task.
        seed: Of everything random.
        status: ``running``, ``interrupted``, ``done`` or ``failed``.
        created: Start of the run, UTC, ISO 8601.
        seconds: Spent learning.
        steps: Environment steps done.
        score: Of the policy kept; None before the first evaluation.
        commit_id: The commit of the code, ``+`` where it was changed.
        config: The resolved configuration as plain values.
        about: Further identification of the task: line, section, trainset.
        versions: Of Python and packages.
        driver: Id of the driver that was learned; empty where it has none.
        command: The command line that began it; empty where none did.
        machine: Machine on which it began.
        kpis: Of the policy kept, by driving the task from standstill; before the end, of the one kept so far.
        compile_seconds: Spent compiling, in the session that ended the run.
    """

    id: str
    algorithm: str
    task: str
    seed: int
    status: Status
    created: str
    seconds: float
    steps: int
    score: float | None
    commit_id: str
    config: Mapping[str, Any]
    about: Mapping[str, Any]
    versions: Mapping[str, str]
    driver: str = ""
    command: str = ""
    machine: str = ""
    kpis: Mapping[str, float] = field(default_factory=dict)
    compile_seconds: float = 0.0

    def configuration(self) -> AbstractConfig:
        """The configuration as learners take it."""
        return config_from_mapping(self.algorithm, self.config, file=f"run {self.id}")


COLUMNS = tuple(field.name for field in fields(RunRecord))


class RunStore:
    """The runs of one folder; any number of processes may use it at once.

    Args:
        root: The folder; made when the first run is.
        indexed: True if there is an index; without one, only single runs can be looked at.
    """

    def __init__(self, root: Path, *, indexed: bool = True) -> None:
        self.root = root
        self.indexed = indexed

    def folder(self, run_id: str) -> Path:
        """Folder of a run's files."""
        return self.root / run_id

    def create(
        self, config: AbstractConfig, task: str, seed: int, about: Mapping[str, Any], **more: str
    ) -> RunRecord:
        """A new run: its folder, its ``run.toml`` and its row.

        Args:
            config: Configuration; its type chooses the learner.
            task: Name of the task.
            seed: Of everything random.
            about: Further identification of the task.
            more: ``id``, ``driver`` and ``command`` of the record.

        Raises:
            InputError: The folder cannot be written.
        """
        now = datetime.now(UTC)
        name = f"{more.get('driver') or config.algorithm}-{now:%Y%m%d-%H%M%S}-{secrets.token_hex(2)}"
        record = RunRecord(
            id=more.get("id", name),
            algorithm=config.algorithm,
            task=task,
            seed=seed,
            status="running",
            created=now.isoformat(timespec="seconds"),
            seconds=0.0,
            steps=0,
            score=None,
            commit_id=commit(),
            config=config_to_mapping(config),
            about=dict(about),
            versions=versions(LEARNING),
            driver=more.get("driver", ""),
            command=more.get("command", ""),
            machine=machine(),
        )
        self.save(record)
        return record

    def update(self, record: RunRecord, **changes: Any) -> RunRecord:
        """The record with some fields changed, stored.

        Raises:
            InputError: The folder cannot be written.
        """
        record = replace(record, **changes)
        self.save(record)
        return record

    def save(self, record: RunRecord) -> None:
        """Write a record's ``run.toml`` and its row.

        Raises:
            InputError: The folder cannot be written.
        """
        import tomli_w

        table = {name: value for name, value in asdict(record).items() if value is not None}
        text = tomli_w.dumps(table).encode()
        atomic_write(self.folder(record.id) / RECORD_FILE, lambda partial: partial.write_bytes(text))
        if self.indexed:
            with self._index() as database:
                _insert(database, record)

    def find(self, words: str, limit: int = 100) -> list[RunRecord]:
        """Runs in whose id, task, configuration or identity every word occurs, the newest first."""
        self._settle()
        parts = [
            f"%{word.replace('~', '~~').replace('%', '~%').replace('_', '~_')}%" for word in words.split()
        ]
        text = "(id || ' ' || task || ' ' || status || ' ' || config || ' ' || about)"
        where = " AND ".join([f"{text} LIKE ? ESCAPE '~'"] * len(parts)) or "1"
        return self._select(f"WHERE {where} ORDER BY created DESC, id DESC LIMIT ?", (*parts, limit))

    def show(self, run_id: str) -> RunRecord:
        """The run whose id begins so.

        Raises:
            InputError: None does, or several.
        """
        if not self.indexed:
            return settle_status(self, record_of(self.folder(run_id)))
        self._settle()
        found = self._select("WHERE substr(id, 1, ?) = ? ORDER BY id LIMIT 6", (len(run_id), run_id))
        exact = [record for record in found if record.id == run_id]
        if exact or len(found) == 1:
            return (exact or found)[0]
        names = ", ".join(record.id for record in (found or self.find("", limit=6)))
        words = "several runs begin so" if found else "no such run"
        raise InputError(
            words, file=self.root, field="id", value=run_id, allowed=names or "there are no runs yet"
        )

    def forget(self, run_id: str) -> None:
        """Remove a run: its folder and its row."""
        shutil.rmtree(self.folder(run_id), ignore_errors=True)
        if self.indexed:
            with self._index() as database:
                database.execute("DELETE FROM runs WHERE id = ?", (run_id,))

    def rebuild(self) -> int:
        """Make the index anew from the folders; returns how many runs there are."""
        for name in (INDEX_FILE, f"{INDEX_FILE}-wal", f"{INDEX_FILE}-shm"):
            (self.root / name).unlink(missing_ok=True)
        records = [
            record for path in sorted(self.root.glob(f"*/{RECORD_FILE}")) if (record := read_record(path))
        ]
        with self._connect() as database:
            for record in records:
                _insert(database, record)
        return len(records)

    def _settle(self) -> None:
        """Find the runs whose process is gone."""
        for record in self._select("WHERE status = 'running'", ()):
            settle_status(self, record)

    def _select(self, rest: str, values: tuple[Any, ...]) -> list[RunRecord]:
        if not self.root.is_dir():
            return []
        with self._index() as database:
            rows = database.execute(f"SELECT {', '.join(COLUMNS)} FROM runs {rest}", values).fetchall()
        named = (dict(zip(COLUMNS, row, strict=True)) for row in rows)
        return [RunRecord(**{**row, **{name: json.loads(row[name]) for name in PLAIN}}) for row in named]

    @contextmanager
    def _index(self) -> Iterator[sqlite3.Connection]:
        """The index in a transaction; rebuilt if it is missing or damaged."""
        if not (self.root / INDEX_FILE).exists():
            self.rebuild()
        with ExitStack() as stack:
            try:
                database = stack.enter_context(self._connect())
            except sqlite3.DatabaseError:
                self.rebuild()
                database = stack.enter_context(self._connect())
            yield database

    @contextmanager
    def _connect(self) -> Iterator[sqlite3.Connection]:
        with open_database(self.root / INDEX_FILE) as database:
            (version,) = database.execute("PRAGMA user_version").fetchone()
            tables = database.execute("SELECT name FROM sqlite_master WHERE name = 'runs'").fetchall()
            if tables and version != SCHEMA_VERSION:
                raise sqlite3.DatabaseError("an index of another version")
            database.execute(SCHEMA)
            database.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
            yield database


def settle_status(store: RunStore, record: RunRecord) -> RunRecord:
    """The record, its status put right if it is running no more."""
    folder = store.folder(record.id)
    if record.status != "running" or is_locked(folder):
        return record
    # its process may have ended the run, and let the folder go, since the record was read
    latest = read_record(folder / RECORD_FILE) or record
    return store.update(latest, status="interrupted" if latest.status == "running" else latest.status)


def record_of(folder: Path) -> RunRecord:
    """The record of a learning run's folder.

    Raises:
        InputError: It is not one.
    """
    record = read_record(folder / RECORD_FILE)
    if record is None:
        raise InputError("not the folder of a learning run", file=folder, allowed="see `metropilot runs`")
    return record


def read_record(path: Path) -> RunRecord | None:
    """A record from its ``run.toml``, or None if that is damaged; its id is the folder's name."""
    try:
        table: dict[str, Any] = {"score": None, **tomllib.loads(path.read_text(encoding="utf-8"))}
        record = replace(RunRecord(**table), id=path.resolve().parent.name)
        return record if _fits(record) else None
    except (OSError, ValueError, TypeError, RecursionError):
        return None


def _fits(record: RunRecord) -> bool:
    """Tell if each value is of its kind, and the index can take it.

    Raises:
        TypeError: A table holds what JSON does not know, as a date.
    """
    kinds = {
        "seed": int,
        "steps": int,
        "seconds": float,
        "score": float,
        "compile_seconds": float,
        **dict.fromkeys(PLAIN, dict),
    }
    values = {name: value for name, value in asdict(record).items() if value is not None}
    return (
        all(type(value) is kinds.get(name, str) for name, value in values.items())
        and record.status in get_args(Status)
        and max(abs(record.seed), abs(record.steps)) < LARGEST
        and math.isfinite(record.seconds + record.compile_seconds)
        and bool(json.dumps([values[name] for name in PLAIN]))
    )


def _insert(database: sqlite3.Connection, record: RunRecord) -> None:
    """Write a row over the one with its id."""
    row = [json.dumps(value) if name in PLAIN else value for name, value in asdict(record).items()]
    marks = ", ".join("?" * len(COLUMNS))
    database.execute(f"INSERT OR REPLACE INTO runs ({', '.join(COLUMNS)}) VALUES ({marks})", row)


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

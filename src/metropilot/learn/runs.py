"""Run folders and their index: what was learned, from what, with what result.

A run is a folder with ``run.toml`` (resolved configuration, seed, versions, commit, result),
``history.parquet``, ``policy.safetensors`` and ``checkpoint.safetensors``. The index is an SQLite file beside
them; lost or damaged, it is made anew from the folders.
"""

from __future__ import annotations

import json
import secrets
import sqlite3
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from metropilot.drivers.policy.files import write_whole
from metropilot.errors import InputError
from metropilot.learn.config_base import AbstractConfig
from metropilot.learn.config_reading import config_from_mapping, config_to_mapping
from metropilot.learn.provenance import commit, versions

Status = Literal["running", "interrupted", "done", "failed"]
INDEX = "index.sqlite"
SCHEMA = """
CREATE TABLE IF NOT EXISTS runs (
    id TEXT PRIMARY KEY, algorithm TEXT NOT NULL, task TEXT NOT NULL, seed INTEGER NOT NULL, status TEXT NOT
    NULL, created TEXT NOT NULL, seconds REAL NOT NULL, steps INTEGER NOT NULL, score REAL, commit_id TEXT NOT
    NULL, config TEXT NOT NULL, about TEXT NOT NULL, versions TEXT NOT NULL
)
"""
COLUMNS = (
    "id",
    "algorithm",
    "task",
    "seed",
    "status",
    "created",
    "seconds",
    "steps",
    "score",
    "commit_id",
    "config",
    "about",
    "versions",
)
PLAIN = {"config", "about", "versions"}


@dataclass(frozen=True)
class RunRecord:
    """One run.

    Attributes:
        id: Name of its folder.
        algorithm: ``ppo``, ...
        task: What was learned, in a word.
        seed: Of everything random.
        status: ``running``, ``interrupted``, ``done`` or ``failed``.
        created: When it began, UTC, ISO 8601.
        seconds: Spent learning.
        steps: Environment steps done.
        score: Of the policy kept; None before the first evaluation.
        commit_id: The commit of the code, ``+`` where it was changed.
        config: The resolved configuration as plain values.
        about: What else identifies the task: line, section, trainset.
        versions: Of Python and packages.
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

    def configuration(self) -> AbstractConfig:
        """The configuration as learners take it."""
        return config_from_mapping(self.algorithm, self.config, file=f"run {self.id}")


class RunStore:
    """The runs of one folder; any number of processes may use it at once.

    Args:
        root: The folder; made when the first run is.
    """

    def __init__(self, root: Path) -> None:
        self.root = root

    def folder(self, run_id: str) -> Path:
        """Where a run's files are."""
        return self.root / run_id

    def create(self, config: AbstractConfig, task: str, seed: int, about: Mapping[str, Any]) -> RunRecord:
        """A new run: its folder, its ``run.toml`` and its row.

        Raises:
            InputError: The folder cannot be written.
        """
        now = datetime.now(UTC)
        record = RunRecord(
            id=f"{config.algorithm}-{now:%Y%m%d-%H%M%S}-{secrets.token_hex(2)}",
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
            versions=versions(),
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
        write_whole(self.folder(record.id) / "run.toml", lambda partial: partial.write_bytes(text))
        with self._index() as database:
            _insert(database, record)

    def recent(
        self, *, algorithm: str = "", task: str = "", status: str = "", limit: int = 100
    ) -> list[RunRecord]:
        """Runs, the newest first.

        Args:
            algorithm: Only of this one.
            task: Only of this one.
            status: Only of this one.
            limit: At most so many.
        """
        wanted = {"algorithm": algorithm, "task": task, "status": status}
        wanted = {name: value for name, value in wanted.items() if value}
        where = " AND ".join(f"{name} = ?" for name in wanted) or "1"
        return self._select(
            f"WHERE {where} ORDER BY created DESC, id DESC LIMIT ?", (*wanted.values(), limit)
        )

    def find(self, words: str, limit: int = 100) -> list[RunRecord]:
        """Runs in whose id, task, configuration or identity every word occurs, the newest first."""
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
        found = self._select("WHERE substr(id, 1, ?) = ? ORDER BY id LIMIT 6", (len(run_id), run_id))
        exact = [record for record in found if record.id == run_id]
        if exact or len(found) == 1:
            return (exact or found)[0]
        names = ", ".join(record.id for record in (found or self.recent(limit=6)))
        words = "several runs begin so" if found else "no such run"
        raise InputError(
            words, file=self.root, field="id", value=run_id, allowed=names or "there are no runs yet"
        )

    def rebuild(self) -> int:
        """Make the index anew from the folders; returns how many runs there are."""
        for name in (INDEX, f"{INDEX}-wal", f"{INDEX}-shm"):
            (self.root / name).unlink(missing_ok=True)
        records = [record for path in sorted(self.root.glob("*/run.toml")) if (record := read_record(path))]
        with closing(self._connect()) as database, database:
            for record in records:
                _insert(database, record)
        return len(records)

    def _select(self, rest: str, values: tuple[Any, ...]) -> list[RunRecord]:
        if not self.root.is_dir():
            return []
        with self._index() as database:
            rows = database.execute(f"SELECT {', '.join(COLUMNS)} FROM runs {rest}", values).fetchall()
        return [_record(row) for row in rows]

    @contextmanager
    def _index(self) -> Iterator[sqlite3.Connection]:
        """The index in a transaction; rebuilt if it is missing or damaged."""
        if not (self.root / INDEX).exists():
            self.rebuild()
        try:
            database = self._connect()
        except sqlite3.DatabaseError:
            self.rebuild()
            database = self._connect()
        with closing(database), database:
            yield database

    def _connect(self) -> sqlite3.Connection:
        self.root.mkdir(parents=True, exist_ok=True)
        database = sqlite3.connect(self.root / INDEX, timeout=30.0)
        try:
            database.execute("PRAGMA journal_mode = WAL")
            database.execute(SCHEMA)
        except sqlite3.DatabaseError:
            database.close()
            raise
        return database


def read_record(path: Path) -> RunRecord | None:
    """A record from its ``run.toml``, or None if that is damaged."""
    try:
        table: dict[str, Any] = {"score": None, **tomllib.loads(path.read_text())}
        return RunRecord(**table)
    except (OSError, ValueError, TypeError):
        return None


def _insert(database: sqlite3.Connection, record: RunRecord) -> None:
    """Write a row over the one with its id."""
    row = [json.dumps(value) if name in PLAIN else value for name, value in asdict(record).items()]
    marks = ", ".join("?" * len(COLUMNS))
    database.execute(f"INSERT OR REPLACE INTO runs ({', '.join(COLUMNS)}) VALUES ({marks})", row)


def _record(row: tuple[Any, ...]) -> RunRecord:
    """A record from its row."""
    named: dict[str, Any] = dict(zip(COLUMNS, row, strict=True))
    return RunRecord(**{name: json.loads(value) if name in PLAIN else value for name, value in named.items()})

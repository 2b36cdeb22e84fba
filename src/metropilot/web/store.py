"""Store of the console in one SQLite file: jobs, journals of live runs, uploads."""

from __future__ import annotations

import json
import secrets
import sqlite3
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from metropilot._io import open_database
from metropilot.planning import excess_percent
from metropilot.units import J_PER_KWH
from metropilot.web.errors import Refused
from metropilot.web.users import check_may_change, present_user
from metropilot.web.words.language import N_

SCHEMA = """
CREATE TABLE IF NOT EXISTS jobs (
    id TEXT PRIMARY KEY, kind TEXT NOT NULL, status TEXT NOT NULL, request TEXT NOT NULL,
    created TEXT NOT NULL, progress REAL NOT NULL DEFAULT 0, words TEXT NOT NULL DEFAULT '', run TEXT,
    stop INTEGER NOT NULL DEFAULT 0, error TEXT, result TEXT, name TEXT NOT NULL DEFAULT '', summary TEXT
);
CREATE TABLE IF NOT EXISTS journal (
    job TEXT NOT NULL, number INTEGER NOT NULL, step INTEGER NOT NULL, event TEXT NOT NULL,
    PRIMARY KEY (job, number)
);
CREATE TABLE IF NOT EXISTS uploads (
    id TEXT PRIMARY KEY, kind TEXT NOT NULL, name TEXT NOT NULL, file TEXT NOT NULL, created TEXT NOT NULL
);
CREATE TABLE IF NOT EXISTS versions (
    upload TEXT NOT NULL, number INTEGER NOT NULL, name TEXT NOT NULL, file TEXT NOT NULL,
    created TEXT NOT NULL, PRIMARY KEY (upload, number)
);
CREATE TABLE IF NOT EXISTS projects (
    id TEXT PRIMARY KEY, name TEXT NOT NULL, notes TEXT NOT NULL DEFAULT '', created TEXT NOT NULL
);
INSERT INTO versions SELECT id, 1, name, file, created FROM uploads
    WHERE id NOT IN (SELECT upload FROM versions);
"""
OVER = ("done", "failed", "stopped")
Check = Callable[[sqlite3.Connection], None]
"""Refusal of a change, which is called in the transaction that makes it: nothing comes between."""
SORTS = {name: name for name in ("created", "name", "kind", "status")}
SORTS |= {name: f"json_extract(summary, '$.{name}')" for name in ("time_s", "energy_kwh", "gap_percent")}
"""SQL by which jobs are sorted."""


@dataclass(frozen=True)
class JobRow:
    """A job as it is stored; see :class:`metropilot.web.schemas.responses.JobOut`."""

    id: str
    kind: str
    status: str
    request: dict[str, Any]
    created: str
    progress: float
    words: str
    run: str | None
    error: dict[str, Any] | None
    name: str
    summary: dict[str, Any]
    project: str | None
    user: str | None


@dataclass(frozen=True)
class UploadRow:
    """An uploaded file."""

    id: str
    kind: str
    name: str
    file: str
    project: str | None = None
    user: str | None = None


@dataclass(frozen=True)
class ProjectRow:
    """A named folder of runs, lines and trainsets, with notes."""

    id: str
    name: str
    notes: str
    created: str
    user: str | None


@dataclass(frozen=True)
class VersionRow:
    """A version of an upload; the newest is the one that its id stands for."""

    number: int
    name: str
    file: str
    created: str


class JobStore:
    """The SQLite file; any number of processes may use it at once.

    Args:
        root: Folder of the server's data; made if it is not there.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self._shared: sqlite3.Connection | None = None
        with self._open() as database:
            columns = {row[1] for row in database.execute("PRAGMA table_info(jobs)")}
            if "asked" in columns:  # a folder of before the fields had the names of run.toml
                database.execute("ALTER TABLE jobs RENAME COLUMN asked TO request")
                database.execute("""UPDATE jobs SET request = replace(request, '"told_s"', '"at_s"')""")
            database.executescript(SCHEMA)
            if columns and "summary" not in columns:  # a folder of before jobs had names
                database.execute("ALTER TABLE jobs ADD COLUMN name TEXT NOT NULL DEFAULT ''")
                database.execute("ALTER TABLE jobs ADD COLUMN summary TEXT")
                for job, result in database.execute(
                    "SELECT id, result FROM jobs WHERE result > ''"
                ).fetchall():
                    values = (json.dumps(summarise(json.loads(result))), job)
                    database.execute("UPDATE jobs SET summary = ? WHERE id = ?", values)
            for table in ("jobs", "uploads"):
                if "project" not in {row[1] for row in database.execute(f"PRAGMA table_info({table})")}:
                    database.execute(f"ALTER TABLE {table} ADD COLUMN project TEXT")
            for table in ("jobs", "uploads", "projects"):  # a folder of before users had names
                if "user" not in {row[1] for row in database.execute(f"PRAGMA table_info({table})")}:
                    database.execute(f"ALTER TABLE {table} ADD COLUMN user TEXT")

    @contextmanager
    def _open(self) -> Iterator[sqlite3.Connection]:
        if self._shared is not None:
            yield self._shared
            return
        with open_database(self.root / "console.sqlite") as database:
            database.execute("PRAGMA synchronous = NORMAL")
            yield database

    @contextmanager
    def _read(self, database: sqlite3.Connection | None) -> Iterator[sqlite3.Connection]:
        """Read in a transaction that is there, or in one of its own."""
        if database is not None:
            yield database
            return
        with self._open() as opened:
            yield opened

    @contextmanager
    def _change(self, check: Check | None = None) -> Iterator[sqlite3.Connection]:
        """Change in one transaction, which a check begins, if there is one."""
        check_may_change()
        with self._open() as database:
            if check is not None:
                if self._shared is None:
                    database.execute("BEGIN IMMEDIATE")
                check(database)
            yield database

    @contextmanager
    def together(self, check: Check) -> Iterator[JobStore]:
        """Store of which all changes in the body of the context are one transaction: all are kept, or none.

        Args:
            check: Refuses them before the first.
        """
        with self._change(check) as database:
            made = copy(self)
            made._shared = database  # noqa: SLF001 (of this class)
            yield made

    def new_job(
        self, kind: str, request: dict[str, Any], check: Check | None = None, job: str | None = None
    ) -> str:
        """Add a job of the present user with status ``queued``; return its id.

        Args:
            kind: Kind of the job.
            request: Its request.
            check: Refuses the job where there is no room for it.
            job: Its id, of :func:`new_job_id`; None: a new one.
        """
        now, job = datetime.now(UTC), job or new_job_id(kind)
        with self._change(check) as database:
            sql = (
                "INSERT INTO jobs (id, kind, status, request, created, user) VALUES (?, ?, 'queued', ?, ?, ?)"
            )
            values = (job, kind, json.dumps(request), now.isoformat(timespec="seconds"), present_user().name)
            database.execute(sql, values)
        return job

    def update(
        self, job: str, check: Check | None = None, only: Sequence[str] = (), /, **changes: object
    ) -> bool:
        """Change columns of a job; ``error`` and ``result`` become JSON, a result is summarised.

        Args:
            job: Id of the job.
            check: Refuses the change.
            only: Statuses in which it is changed; empty: any.
            changes: Values of the columns.

        Returns:
            True if the job was changed.
        """
        if changes.get("result") is not None:
            changes["summary"] = summarise(changes["result"])
        values = [
            json.dumps(v) if k in {"error", "result", "summary"} and v is not None else v
            for k, v in changes.items()
        ]
        names = ", ".join(f"{name} = ?" for name in changes)
        with self._change(check) as database:
            where = f" AND status IN ({', '.join('?' * len(only))})" if only else ""
            sql = f"UPDATE jobs SET {names} WHERE id = ?{where}"
            return database.execute(sql, (*values, job, *only)).rowcount > 0

    def begin(self, job: str, words: str, progress: float = 0.0) -> None:
        """Mark a job as running, unless it was stopped while it waited."""
        self.update(job, None, ("queued",), status="running", words=words, progress=progress)

    def job(self, job: str) -> JobRow:
        """A job.

        Raises:
            Refused: No such job (404).
        """
        found = self._jobs("WHERE id = ?", (job,))
        if not found:
            raise Refused("no such job", 404, field="id", value=job)
        return found[0]

    def jobs(
        self,
        kind: str | None = None,
        limit: int = 100,
        *,
        status: str | None = None,
        text: str = "",
        sort: str = "created",
        ascending: bool = False,
        offset: int = 0,
        project: str | None = None,
    ) -> list[JobRow]:
        """Jobs, the newest first.

        Args:
            kind: Kind of the jobs; None: every one.
            limit: Number of jobs at most.
            status: Status of the jobs; None: any.
            text: Text that id, name, user or request holds, in capitals or not.
            sort: One of ``SORTS``; jobs without such a value come last.
            ascending: Smallest first.
            offset: Jobs that are left out before the first.
            project: Project of the jobs; None: any or none.
        """
        by, way = SORTS[sort], "ASC" if ascending else "DESC"
        where = "(?1 IS NULL OR kind = ?1) AND (?2 IS NULL OR status = ?2)"
        where += " AND (?6 IS NULL OR project = ?6)"
        told = "lower(id || ' ' || name || ' ' || coalesce(user, '') || ' ' || request)"
        where += f" AND instr({told}, lower(?3)) > 0"
        order = f"{by} IS NULL, {by} {way}, created DESC, id DESC LIMIT ?4 OFFSET ?5"
        return self._jobs(f"WHERE {where} ORDER BY {order}", (kind, status, text, limit, offset, project))

    def forget_job(self, job: str) -> None:
        """Remove the rows of a job."""
        with self._change() as database:
            database.execute("DELETE FROM jobs WHERE id = ?", (job,))
            database.execute("DELETE FROM journal WHERE job = ?", (job,))

    def list_unfinished(self) -> list[JobRow]:
        """Jobs with status ``queued`` or ``running``, the oldest first."""
        return self._jobs("WHERE status IN ('queued', 'running') ORDER BY created", ())

    def count_waiting(self, database: sqlite3.Connection | None = None) -> int:
        """Number of jobs that wait or run, without live runs."""
        with self._read(database) as opened:
            sql = "SELECT count(*) FROM jobs WHERE status IN ('queued', 'running') AND kind != 'live'"
            return int(opened.execute(sql).fetchone()[0])

    def count_of(self, user: str, database: sqlite3.Connection | None = None) -> int:
        """Number of jobs and live runs of a user that wait or run."""
        with self._read(database) as opened:
            sql = "SELECT count(*) FROM jobs WHERE status IN ('queued', 'running') AND user = ?"
            return int(opened.execute(sql, (user,)).fetchone()[0])

    def kept_by(self, user: str, database: sqlite3.Connection | None = None) -> tuple[int, list[str]]:
        """Bytes of a user's requests, results and journals, and folders and files beside them."""
        with self._read(database) as opened:
            sql = "SELECT id, run, length(request) + coalesce(length(result), 0) FROM jobs WHERE user = ?"
            jobs = opened.execute(sql, (user,)).fetchall()
            sql = "SELECT total(length(event)) FROM journal WHERE job IN (SELECT id FROM jobs WHERE user = ?)"
            events = int(opened.execute(sql, (user,)).fetchone()[0])
            sql = "SELECT file FROM versions WHERE upload IN (SELECT id FROM uploads WHERE user = ?)"
            files = opened.execute(sql, (user,)).fetchall()
        paths = [f"jobs/{job}" for job, _, _ in jobs] + [f"runs/{run}" for _, run, _ in jobs if run]
        return events + sum(size for _, _, size in jobs), paths + [f"uploads/{file}" for (file,) in files]

    def result(self, job: str) -> Any:  # noqa: ANN401 (whatever the job's kind gives)
        """Result of a job; None while there is none."""
        with self._open() as database:
            row = database.execute("SELECT result FROM jobs WHERE id = ?", (job,)).fetchone()
        return json.loads(row[0]) if row and row[0] else None

    def stop_requested(self, job: str) -> bool:
        """Tell whether a job is to be stopped."""
        with self._open() as database:
            row = database.execute("SELECT stop FROM jobs WHERE id = ?", (job,)).fetchone()
        return bool(row and row[0])

    def note(self, job: str, step: int, event: dict[str, Any]) -> None:
        """Write an event into a live run's journal."""
        with self._open() as database:
            database.execute(
                "INSERT INTO journal SELECT ?, count(*), ?, ? FROM journal WHERE job = ?",
                (job, step, json.dumps(event), job),
            )

    def note_all(self, job: str, journal: Sequence[tuple[int, dict[str, Any]]]) -> None:
        """Write the whole journal of a live run that has none yet."""
        rows = [(job, number, step, json.dumps(event)) for number, (step, event) in enumerate(journal)]
        with self._open() as database:
            database.executemany("INSERT INTO journal VALUES (?, ?, ?, ?)", rows)

    def journal(self, job: str) -> list[tuple[int, dict[str, Any]]]:
        """Journal of a live run: (step before which it applies, event)."""
        with self._open() as database:
            rows = database.execute(
                "SELECT step, event FROM journal WHERE job = ? ORDER BY number", (job,)
            ).fetchall()
        return [(int(step), json.loads(event)) for step, event in rows]

    def add_upload(
        self, kind: str, name: str, file: str, check: Check | None = None, upload: str | None = None
    ) -> UploadRow:
        """Add an upload of the present user, with its first version.

        Args:
            kind: Kind of the upload.
            name: Name that the file gives.
            file: File of the first version.
            check: Refuses the upload where there is no room for it.
            upload: Its id, of :func:`new_upload_id`; None: a new one.
        """
        key, user = upload or new_upload_id(), present_user().name
        row, now = UploadRow(key, kind, name, file, user=user), _now()
        with self._change(check) as database:
            sql = "INSERT INTO uploads (id, kind, name, file, created, user) VALUES (?, ?, ?, ?, ?, ?)"
            database.execute(sql, (row.id, kind, name, file, now, user))
            database.execute("INSERT INTO versions VALUES (?, 1, ?, ?, ?)", (row.id, name, file, now))
        return row

    def set_project(self, entry: str, project: str | None) -> None:
        """File a job or an upload in a project, or in none."""
        with self._change() as database:
            for table in ("jobs", "uploads"):
                database.execute(f"UPDATE {table} SET project = ? WHERE id = ?", (project, entry))

    def projects(self) -> list[ProjectRow]:
        """Projects by name."""
        with self._open() as database:
            sql = "SELECT id, name, notes, created, user FROM projects ORDER BY lower(name), created"
            return [ProjectRow(*row) for row in database.execute(sql).fetchall()]

    def project(self, project: str) -> ProjectRow:
        """A project.

        Raises:
            Refused: No such project (404).
        """
        for row in self.projects():
            if row.id == project:
                return row
        raise Refused("no such project", 404, field="project", value=project)

    def new_project(self, name: str, notes: str = "") -> ProjectRow:
        """Add a project of the present user."""
        row = ProjectRow(f"project-{secrets.token_hex(4)}", name, notes, _now(), present_user().name)
        with self._change() as database:
            sql = "INSERT INTO projects (id, name, notes, created, user) VALUES (?, ?, ?, ?, ?)"
            database.execute(sql, tuple(vars(row).values()))
        return row

    def update_project(self, project: str, **changes: str) -> None:
        """Change name or notes of a project."""
        names = ", ".join(f"{name} = ?" for name in changes)
        with self._change() as database:
            database.execute(f"UPDATE projects SET {names} WHERE id = ?", (*changes.values(), project))

    def forget_project(self, project: str) -> None:
        """Remove a project; its jobs and uploads stay, in none."""
        with self._change() as database:
            database.execute("DELETE FROM projects WHERE id = ?", (project,))
            for table in ("jobs", "uploads"):
                database.execute(f"UPDATE {table} SET project = NULL WHERE project = ?", (project,))

    def add_version(
        self, upload: str, based_on: int, name: str, file: str, check: Check | None = None
    ) -> int:
        """Add a version of an upload and make it the one that its id stands for; return its number.

        Args:
            upload: Id of the upload.
            based_on: Version that was edited; it must be the newest one.
            name: Name that the file gives.
            file: File of the version.
            check: Refuses the version where there is no room for it.

        Raises:
            Refused: No such upload (404), or somebody saved another version meanwhile (409).
        """
        with self._change(check or (lambda _: None)) as database:
            sql = "SELECT max(number) FROM versions WHERE upload = ?"
            newest = database.execute(sql, (upload,)).fetchone()[0]
            if newest is None:
                raise Refused("no such upload", 404, field="id", value=upload)
            if newest != based_on:
                words = f"version {newest} was saved meanwhile"
                raise Refused(words, 409, field="version", value=based_on, allowed=f"{newest}")
            row = (upload, newest + 1, name, file, _now())
            database.execute("INSERT INTO versions VALUES (?, ?, ?, ?, ?)", row)
            database.execute("UPDATE uploads SET name = ?, file = ? WHERE id = ?", (name, file, upload))
        return newest + 1

    def versions(self, upload: str) -> list[VersionRow]:
        """Versions of an upload, the newest first; empty if there is no such upload."""
        sql = "SELECT number, name, file, created FROM versions WHERE upload = ? ORDER BY number DESC"
        with self._open() as database:
            return [VersionRow(*row) for row in database.execute(sql, (upload,)).fetchall()]

    def uploads(self, kind: str | None = None) -> list[UploadRow]:
        """Uploads, the newest first."""
        with self._open() as database:
            rows = database.execute(
                "SELECT id, kind, name, file, project, user FROM uploads ORDER BY created DESC, rowid DESC"
            ).fetchall()
        return [row for row in (UploadRow(*r) for r in rows) if kind is None or row.kind == kind]

    def forget_upload(self, upload: str) -> None:
        """Remove the rows of an upload."""
        with self._change() as database:
            database.execute("DELETE FROM uploads WHERE id = ?", (upload,))
            database.execute("DELETE FROM versions WHERE upload = ?", (upload,))

    def _jobs(self, rest: str, values: tuple[Any, ...]) -> list[JobRow]:
        columns = ", ".join(each.name for each in fields(JobRow))
        with self._open() as database:
            rows = database.execute(f"SELECT {columns} FROM jobs {rest}", values).fetchall()
        return [_job(row) for row in rows]


def new_job_id(kind: str) -> str:
    """Make an id for a job: its kind, the date and time, and a random part."""
    return f"{kind}-{datetime.now(UTC):%Y%m%d-%H%M%S}-{secrets.token_hex(3)}"


def new_upload_id() -> str:
    """Make an id for an upload."""
    return f"upload-{secrets.token_hex(4)}"


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def _job(row: tuple[Any, ...]) -> JobRow:
    names = [each.name for each in fields(JobRow)]
    found = dict(zip(names, row, strict=True))
    found |= {name: json.loads(found[name]) if found[name] else None for name in ("error", "summary")}
    return JobRow(**found | {"request": json.loads(found["request"]), "summary": found["summary"] or {}})


FAILED = {
    "on time": N_("not on time"),
    "stops at the mark": N_("not at the mark"),
    "no overspeed": N_("overspeed"),
    "no intervention": N_("intervention"),
    "no contact": N_("contact"),
    "couples and parts in time": N_("not coupled and parted in time"),
}
"""Words for a requirement that was failed, where they are not its name."""


def outcome_words(outcome: str, failed: Sequence[str]) -> str:
    """Outcome of a run with the requirements that it failed."""
    said = ", ".join(FAILED.get(name, name) for name in failed)
    return f"{outcome}: {said}" if said else outcome


def summarise(result: Any) -> dict[str, Any]:  # noqa: ANN401 (whatever the job's kind gives)
    """Result in short: outcome with failed requirements, success, time, energy at the wheel, gap."""
    if "kpis" in result:  # a drive, or a convoy, whose running time is that of its head
        k = result["kpis"]
        head = {**(k.get("trainsets") or [{}])[0], **k}
        gap = k.get("optimality_gap_percent", k.get("joint_gap_percent"))
        found = {
            "outcome": outcome_words(k["outcome"], k.get("failed", ())),
            "success": result["success"],
            "time_s": head.get("running_time_s"),
        }
        return found | {"energy_kwh": k["energy_wheel_kwh"], "gap_percent": gap}
    if "entries" in result:
        met = sum(e["successes"] == e["seeds"] for e in result["entries"])
        return {"outcome": f"{met} of {len(result['entries'])} drivers met every requirement"}
    if "energies" in result or "floor_kwh" in result:  # a line, computed or run
        told = result.get("energies", result)
        found = {"outcome": result.get("outcome", "computed"), "time_s": result.get("time_s")}
        return found | {"energy_kwh": told["energy_kwh"], "gap_percent": told["gap_percent"]}
    if "campaign" in result or "vectors" in result:
        files = len(result.get("files", ()))
        return {"outcome": f"{files} files" if files else f"{result['done']} of {result['rows']} rows"}
    if "calls" in result:
        gap = excess_percent(result["energy_j"], result["bound_j"])
        found = {"outcome": "planned", "time_s": result["running_time_s"], "gap_percent": gap}
        return found | {"energy_kwh": result["energy_j"] / J_PER_KWH}
    return {"outcome": f"residuals {result['residual_mps']:.3f} m/s"} if "parameters" in result else {}

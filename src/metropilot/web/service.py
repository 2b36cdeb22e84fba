"""Service behind the API and the pages: catalogue with uploads, jobs, live runs."""

from __future__ import annotations

import asyncio
import secrets
import shutil
import sqlite3
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from pathlib import Path
from traceback import print_exception
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from pydantic import BaseModel

from metropilot._schema import field_specs
from metropilot.errors import InputError
from metropilot.evaluate import POLICY, RunSpec, parse_driver
from metropilot.operation import OperationOptions
from metropilot.policy import POLICY_FILE
from metropilot.railway import document_text, list_lines, list_trainsets, load_line
from metropilot.web.errors import Refused, detail_of
from metropilot.web.kinds import JOB_KINDS, check_driver, request_values, row_of
from metropilot.web.live.session import Session, Spare, place_words, start_spare
from metropilot.web.pools import Pools, explain
from metropilot.web.schemas import requests
from metropilot.web.settings import Settings
from metropilot.web.store import OVER, JobRow, JobStore, UploadRow, VersionRow
from metropilot.web.users import check_may_change, present_user
from metropilot.web.work import campaigns, exports, fits, operations, plans
from metropilot.web.work.plans import LOG, LOG_SUFFIX

if TYPE_CHECKING:
    from metropilot.convoy import ConvoyRequest
    from metropilot.web.live.line import RunningRequest

LiveBody = requests.LiveIn | requests.ConvoyIn | requests.RunningLineIn
Operated = TypeVar("Operated", requests.OperationIn, requests.RunningLineIn)
SUFFIXES = (".toml", ".json", ".safetensors", LOG_SUFFIX)
WATCH_S = 10.0
"""Time between two looks at live runs that nobody watches or that wait."""
SAVE_STEPS = 25
"""Control periods between two writes of a live run's progress; at most these are lost with the server."""
ABANDONED_S = 120.0
"""Time without viewers or requests after which a live run is stopped; it can be resumed."""
NOT_STARTED = "not started"
"""Words of a job that waited when the server ended."""
RESUMABLE = ("interrupted", "stopped")
LISTED = 6
"""Number of live runs to resume that are listed, the newest first."""
FORGET = 50
"""Ended live runs kept in memory with their events, for viewers that come back."""


class Service:
    """Jobs, live runs, uploads and worker processes of one server.

    Args:
        settings: Settings of the server.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.root = settings.data
        self.store = JobStore(settings.data)
        self.pools = Pools(settings)
        self.futures: dict[str, Future[Any]] = {}
        self.sessions: dict[str, Session] = {}
        self.queue: list[Session] = []
        self.spare: Spare | None = None
        self.closing = False
        self._watch: asyncio.Task[None] | None = None

    async def open(self) -> None:
        """Mark unfinished jobs of an earlier server as interrupted and start the workers."""
        for job in self.store.list_unfinished():
            begun = job.status == "running" or job.progress > 0
            words = f"{'' if begun else NOT_STARTED + ': '}the server was restarted; it can be resumed"
            self.store.update(job.id, status="interrupted", words=words)
            if job.kind == "learn" and job.run:
                self._mark_run(job.run)
        self.pools.start()
        self.spare = start_spare(self.settings.worker_bytes)
        self._watch = asyncio.create_task(self._watch_live())

    async def close(self) -> None:
        """End every process; interrupted jobs can be resumed."""
        self.closing = True
        if self._watch:
            self._watch.cancel()
        for session in self.sessions.values():
            session.kill()
        if self.spare:
            self.spare.process.kill()
        await asyncio.to_thread(self.pools.stop)

    # ------------------------------------------------------------------------------------------ users
    def check_limits(
        self, database: sqlite3.Connection | None = None, *, jobs: int = 0, size: int = 0
    ) -> None:
        """Refuse what a viewer may not do, or what would exceed a limit of a named user.

        Args:
            database: Transaction that adds it, so that two at once are not both let in; None: a look before.
            jobs: Jobs or live runs that are to be added.
            size: Bytes that are to be added.

        Raises:
            Refused: The present user reads only (403), or is at a limit (429).
        """
        check_may_change()
        name = present_user().name
        if name is None:
            return
        most = self.settings.user_jobs
        if jobs and (going := self.store.count_of(name, database)) + jobs > most:
            words = f"{name} has {going} jobs that wait or run; stop one, or wait"
            raise Refused(words, 429, field="user", value=name, allowed=f"at most {most}")
        kept = self.kept_bytes(name, database)
        if kept + size > self.settings.user_bytes:
            told, added = f"{kept / 1e6:.1f}", f"{size / 1e6:.1f}"
            words = (
                f"{name} keeps {told} MB of runs and uploads, {added} MB more do not fit; delete some"
                if size
                else f"{name} keeps {told} MB of runs and uploads; delete some"
            )
            allowed = f"at most {self.settings.user_bytes / 1e6:g} MB"
            raise Refused(words, 429, field="user", value=name, allowed=allowed)

    def check_room(self, database: sqlite3.Connection | None = None) -> None:
        """Refuse a job of a viewer, beyond a limit of the present user, or beyond those that may wait."""
        self.check_limits(database, jobs=1)
        if self.store.count_waiting(database) >= self.settings.queued_jobs:
            raise Refused("too many jobs wait", 429)

    def kept_bytes(self, user: str, database: sqlite3.Connection | None = None) -> int:
        """Size of the requests, results, journals, files and uploads of a user, bytes."""
        size, places = self.store.kept_by(user, database)
        for place in places:
            path = self.root / place
            for file in [path] if path.is_file() else path.rglob("*"):
                with suppress(OSError):  # a file that is being replaced
                    size += file.stat().st_size if file.is_file() else 0
        return size

    # ------------------------------------------------------------------------------------------ names
    def paths(self, kind: str | None = None) -> dict[str, str]:
        """Paths of uploaded files by id."""
        return {row.id: str(self.root / "uploads" / row.file) for row in self.store.uploads(kind)}

    def policies(self) -> dict[str, str]:
        """Paths of policies by the id of their learning run or upload, the newest runs first."""
        runs = self.root / "runs"
        found = sorted(runs.glob(f"*/{POLICY_FILE}"), key=lambda path: path.stat().st_mtime, reverse=True)
        inside = [path for path in found if path.resolve().is_relative_to(runs.resolve())]
        return {path.parent.name: str(path) for path in inside} | self.paths(POLICY)

    def path(self, kind: str, key: str) -> str:
        """File of an id; the id itself where a line or trainset is one of the catalogue.

        Raises:
            InputError: No policy of that id.
        """
        if kind != POLICY:
            # of a trainset ID@DELAY,LAG, which declares another dead time and lag
            name, at, late = key.partition("@")
            return self.paths(kind).get(name, name) + at + late
        found = self.policies().get(key)
        if found is None:
            allowed = "the id of a learning run that has a policy, or of an uploaded policy"
            raise InputError("no such policy", field=f"options.{POLICY}", value=key, allowed=allowed)
        return found

    def run_spec(self, body: requests.SectionIn) -> RunSpec:
        """Resolve a request to a run.

        Raises:
            InputError: A name is unknown, or a number is not allowed.
        """
        values = body.model_dump(exclude={"drivers", "seeds", "pace"})
        return requests.request_of(requests.DriveIn.model_validate(values), self.path)

    def operation_request(self, body: requests.OperationIn) -> operations.OperationRequest:
        """Resolve the request of a line in operation.

        Raises:
            InputError: Options do not go together.
        """
        values = body.model_dump()
        options = OperationOptions(**{name: values.pop(name) for name in field_specs(OperationOptions)})
        names = {kind: self.path(kind, values.pop(kind)) for kind in ("line", "trainset")}
        return operations.OperationRequest(**names, **values, options=options)

    def campaign_values(self, body: requests.CampaignIn) -> dict[str, Any]:
        """Values of a campaign's file, ids of uploads and policies replaced by their files.

        Raises:
            InputError: A name is no id, or there is no such policy.
        """
        return campaigns.file_values(body.model_dump(by_alias=True, exclude_unset=True), self.path)

    def export_request(self, body: requests.ExportIn) -> exports.ExportRequest:
        """Resolve the request of an export.

        Raises:
            InputError: No such policy.
        """
        driver, options = parse_driver(body.driver)
        policy = options.get(POLICY)
        ends = (body.origin, body.destination) if body.origin and body.destination else None
        return exports.ExportRequest(
            driver=driver,
            policy=None if policy is None else self.path(POLICY, str(policy)),
            line=self.path("line", body.line),
            ends=ends,
            trainset=self.path("trainset", body.trainset),
            load=body.load,
            to=body.to,
            number=body.number,
        )

    def learn_values(self, body: requests.LearnIn) -> dict[str, Any]:
        """Values of a learning run, a line and a trainset that are no entries of the catalogue as files.

        Raises:
            InputError: No such line or trainset.
        """
        values = body.model_dump()
        kept = {kind: self.path(kind, values[kind]) for kind in ("line", "trainset") if values[kind]}
        return values | kept

    def fit_request(self, body: requests.FitIn) -> fits.FitRequest:
        """Resolve the request of a fit.

        Raises:
            InputError: No such log.
        """
        known = {row.id: row for row in self.store.uploads(LOG)}
        for k, key in enumerate(body.logs):
            if key not in known:
                allowed = "the id of an uploaded log"
                raise InputError("no such log", field=f"logs[{k}]", value=key, allowed=allowed)
        rows = [known[key] for key in body.logs]
        ends = (body.origin, body.destination) if body.origin and body.destination else None
        if body.line and ends is None:
            raise InputError("a section needs both stations", field="origin", value=body.origin)
        return fits.FitRequest(
            logs=tuple((str(self.root / "uploads" / row.file), row.name) for row in rows),
            trainset=self.path("trainset", body.trainset),
            load=body.load,
            section=(self.path("line", body.line), *ends) if body.line and ends else None,
            source=body.input,
            keep=tuple(body.keep),
            resistance=body.resistance,
        )

    def ids(self) -> dict[str, str]:
        """Ids of uploads and policies by their files."""
        return {path: key for key, path in (self.policies() | self.paths()).items()}

    async def upload(self, name: str, content: bytes) -> tuple[UploadRow, dict[str, Any]]:
        """Take a line, trainset, policy or log file.

        Raises:
            InputError: It is too large, of no known kind, or malformed: the message names the field.
        """
        file, found = await self.take_file(name, content)
        room = partial(self.check_limits, size=len(content))
        try:
            return self.store.add_upload(found["kind"], found["name"][:120], file, room), found
        except BaseException:
            (self.root / "uploads" / file).unlink(missing_ok=True)
            raise

    async def save(self, upload: str, text: str, based_on: int) -> int:
        """Save a TOML document as the next version of a line or trainset; return its number.

        Args:
            upload: Id of the upload.
            text: The document.
            based_on: Version that was edited.

        Raises:
            InputError: It is too large or malformed.
            Refused: No such upload (404), or somebody saved another version meanwhile (409).
        """
        kind = self.upload_row(upload).kind
        if kind in {POLICY, LOG}:
            raise Refused(f"a {kind} has no versions", 409, field="id", value=upload)
        file, found = await self.take_file("document.toml", text.encode())
        path = self.root / "uploads" / file
        try:
            if found["kind"] != kind:
                raise InputError(f"another kind than that of {upload}", field="kind", allowed=kind)
            room = partial(self.check_limits, size=len(text.encode()))
            return self.store.add_version(upload, based_on, found["name"][:120], file, room)
        except BaseException:
            path.unlink(missing_ok=True)
            raise

    async def take_file(self, name: str, content: bytes) -> tuple[str, dict[str, Any]]:
        """Check a line, trainset, policy or log file and write it into the folder of uploads.

        Nothing names it yet: the caller adds it to the store, or removes it.

        Args:
            name: Name of the file where it comes from.
            content: The file.

        Returns:
            Name of the file in the folder, and what it holds: ``kind``, ``name``, ``notes``.

        Raises:
            InputError: It is too large, of no known kind, or malformed: the message names the field.
            Refused: The present user reads only (403), or keeps too much (429).
        """
        self.check_limits(size=len(content))
        shown = Path(name.replace("\\", "/")).name[:80] or "file"
        suffix = Path(shown).suffix.lower()
        if suffix not in SUFFIXES:
            raise InputError(
                "unknown kind of file", file=shown, allowed=f"a file ending in {', '.join(SUFFIXES)}"
            )
        most = self.settings.log_bytes if suffix == LOG_SUFFIX else self.settings.upload_bytes
        if len(content) > most:
            limit = f"at most {most:,} bytes".replace(",", " ")
            raise InputError("too large", file=shown, value=len(content), unit="bytes", allowed=limit)
        folder = self.root / "uploads"
        folder.mkdir(exist_ok=True)
        path = folder / f"{secrets.token_hex(8)}{suffix}"
        path.write_bytes(content)
        try:
            return path.name, await self.pools.answer(plans.read_upload, str(path), shown)
        except BaseException:
            path.unlink(missing_ok=True)
            raise

    async def save_fit(self, job: str, upload: str | None) -> tuple[str, VersionRow]:
        """Save the trainset of a fit as a new entry, or as the next version of an own trainset.

        Returns:
            Id of the upload and its newest version.

        Raises:
            Refused: No such job or upload, the job is no fit or has no result (404).
            InputError: The upload is no trainset.
        """
        row = self.store.job(job)
        path = self.root / "jobs" / row.id / fits.TRAINSET
        if row.kind != "fit" or row.status != "done" or not path.is_file():
            words = f"the job is {row.status}" if row.kind == "fit" else f"the job is a {row.kind}"
            raise Refused(words, 404, field="id", value=job)
        text = path.read_text(encoding="utf-8")
        if upload is None:
            key = (await self.upload(fits.TRAINSET, text.encode()))[0].id
        else:
            key = self.upload_row(upload).id
            await self.save(key, text, self.store.versions(key)[0].number)
        return key, self.store.versions(key)[0]

    def upload_row(self, upload: str) -> UploadRow:
        """An upload.

        Raises:
            Refused: No such upload (404).
        """
        for row in self.store.uploads():
            if row.id == upload:
                return row
        raise Refused("no such upload", 404, field="id", value=upload)

    def text(self, kind: Literal["line", "trainset"], key: str, version: int | None = None) -> str:
        """TOML document of a line or trainset.

        Args:
            kind: Kind of the entry.
            key: Id of the catalogue, or of an upload.
            version: Version of the upload; None: the newest.

        Raises:
            Refused: No such entry or version (404).
        """
        known = list_lines() if kind == "line" else list_trainsets()
        if key not in self.paths(kind) and key not in known:
            raise Refused(f"no such {kind}", 404, field=kind, value=key)
        if version is None:
            return document_text(kind, self.path(kind, key))
        for row in self.store.versions(key) if key in self.paths(kind) else ():
            if row.number == version:
                return document_text(kind, str(self.root / "uploads" / row.file))
        raise Refused("no such version", 404, field="version", value=version)

    def forget(self, upload: str) -> None:
        """Remove an upload with its versions.

        Raises:
            Refused: No such upload (404).
        """
        self.upload_row(upload)
        files = [version.file for version in self.store.versions(upload)]
        self.store.forget_upload(upload)
        for file in files:
            (self.root / "uploads" / file).unlink(missing_ok=True)

    # ------------------------------------------------------------------------------------------ answers
    async def section(self, body: requests.SectionIn) -> dict[str, Any]:
        """A section and its minimum running time."""
        return await self.pools.answer(plans.section_of, self.run_spec(body))

    async def plan(self, body: requests.PlantPlanIn) -> dict[str, Any]:
        """The optimal plan, and with a disturbance that of the true plant."""
        return await self.pools.answer(plans.plan_of, self.run_spec(body))

    async def front(self, body: requests.PlanIn) -> dict[str, Any]:
        """The time-energy front."""
        return await self.pools.answer(plans.front_of, self.run_spec(body))

    async def journey(self, body: dict[str, Any]) -> dict[str, Any]:
        """A journey."""
        names = {name: self.path(name, body[name]) for name in ("line", "trainset")}
        return await self.pools.answer(plans.journey_of, {**body, **names})

    async def keep_journey(self, body: requests.JourneyIn) -> str:
        """Plan a journey and keep it as a job; return its id.

        Raises:
            MetropilotError: It cannot be planned; nothing is kept.
        """
        self.check_limits()
        found = await self.journey(body.model_dump())
        job = self.store.new_job("journey", body.model_dump())
        self.store.update(job, status="done", progress=1.0, result=found)
        return job

    # ------------------------------------------------------------------------------------------ jobs
    def name_job(self, job: str, name: str) -> JobRow:
        """Name a job; return it.

        Raises:
            Refused: No such job (404).
        """
        self.store.job(job)
        self.store.update(job, name=name.strip())
        return self.store.job(job)

    def forget_job(self, job: str) -> None:
        """Remove a job with its files; of a learning run the policy, too.

        Raises:
            Refused: A viewer does it (403), no such job (404), or it waits or runs (409).
        """
        check_may_change()
        row = self.store.job(job)
        if row.status in {"queued", "running"}:
            raise Refused(
                f"a job that is {row.status} cannot be deleted; stop it first", 409, field="id", value=job
            )
        self.store.forget_job(job)
        self.sessions.pop(job, None)
        shutil.rmtree(self.root / "jobs" / job, ignore_errors=True)
        if row.run:
            from metropilot.learn import RunStore

            RunStore(self.root / "runs").forget(row.run)

    def submit(self, body: BaseModel) -> str:
        """Queue a job; return its id.

        Args:
            body: Request of one of ``JOB_KINDS``.

        Raises:
            InputError: The job is not possible.
            Refused: Too many jobs wait, or too many of the user (429); a viewer (403).
        """
        self.check_room()
        if isinstance(body, requests.OperationIn):
            body = self._fit_options(body)
        kind = next(name for name, row in JOB_KINDS.items() if row.body is type(body))
        JOB_KINDS[kind].check(self, body)
        work = self._work(kind, body, None)
        job = self.store.new_job(kind, request_values(body), self.check_room)
        self._schedule(job, kind, *work)
        return job

    def _fit_options(self, body: Operated) -> Operated:
        """Fit the options that a request leaves open to its line and to each other."""
        given, line = body.model_dump(exclude_unset=True), load_line(self.path("line", body.line))
        return body.model_copy(update=OperationOptions.fitting(line, given))

    def stop(self, job: str) -> None:
        """Stop a job: a learning run at its next checkpoint, any other job at once."""
        row = self.store.job(job)
        if row.status in OVER:
            return
        session = self.sessions.get(job)
        if session is not None and not session.over:
            check_may_change()
            asyncio.run_coroutine_threadsafe(session.stop(), session.loop)
            return
        self.store.update(job, stop=1)
        future = self.futures.get(job)
        if not JOB_KINDS[row.kind].checkpoints or row.status == "queued":
            if future is not None:
                future.cancel()
            self.store.update(job, status="stopped", words="stopped")

    def resume(self, job: str) -> None:
        """Resume a job that was interrupted, stopped or failed.

        Raises:
            InputError: Something that its request names is gone; the job stays as it is.
            Refused: The job waits, runs or is done, or no worker computes it, as a live run (409).
        """
        row = self.store.job(job)
        if JOB_KINDS[row.kind].work is None or row.status in {"queued", "running", "done"}:
            raise Refused(f"a job that is {row.status} cannot be resumed", 409, field="id", value=job)
        work = self._work(row.kind, JOB_KINDS[row.kind].body.model_validate(row.request), row.run)
        limit = partial(self.check_limits, jobs=1)
        if not self.store.update(job, limit, (row.status,), status="queued", words="", stop=0, error=None):
            raise Refused("a job that is queued cannot be resumed", 409, field="id", value=job)
        self._schedule(job, row.kind, *work)

    def _work(self, kind: str, body: BaseModel, run: str | None) -> tuple[Any, ...]:
        """Function of a job's worker and its arguments after folder and id.

        Raises:
            InputError: Something that the request names does not exist.
        """
        row = JOB_KINDS[kind]
        return row.work, *row.values(self, body, run)

    def _schedule(self, job: str, kind: str, function: Callable[..., Any], *values: object) -> None:
        future = self.pools.submit(function, str(self.root), job, *values, long=JOB_KINDS[kind].long)
        self.futures[job] = future
        future.add_done_callback(lambda done: self._store_result(job, kind, done))

    def _store_result(self, job: str, kind: str, future: Future[Any]) -> None:
        """Store the result of a job; runs in a thread of the pool."""
        self.futures.pop(job, None)
        if self.closing:
            return
        if future.cancelled():
            self.store.update(job, status="stopped", words="stopped")
            return
        error = future.exception()
        if error is not None:
            bound = self.settings.learn_s if JOB_KINDS[kind].long else self.settings.job_s
            told = detail_of(explain(error, bound))
            self.store.update(job, status="failed", words=told["message"], error=told)
            return
        result = future.result()
        stopped = JOB_KINDS[kind].checkpoints and result["stopped"]
        words = "stopped; it can be resumed" if stopped else ""
        done = {} if stopped else {"progress": 1.0}
        self.store.update(job, status="stopped" if stopped else "done", words=words, result=result, **done)

    def _mark_run(self, run: str) -> None:
        """Mark a learning run without a process as interrupted."""
        from metropilot.learn import RunStore

        runs = RunStore(self.root / "runs")
        try:
            record = runs.show(run)
        except InputError:
            return
        if record.status == "running":
            runs.update(record, status="interrupted")

    # ------------------------------------------------------------------------------------------ live runs
    async def go_live(self, body: LiveBody, job: str | None = None) -> Session:
        """Start a live run, or resume one that was interrupted.

        One that finds ``live_runs`` under way waits in a queue and starts by itself.

        Raises:
            InputError: The run cannot be driven.
            Refused: Too many live runs wait (429), or it failed to start (422).
        """
        self.check_limits(jobs=1)
        if isinstance(body, requests.RunningLineIn):
            body = self._fit_options(body)
        await self.stop_abandoned()
        drives, request = self._live_request(body)
        if len(self.queue) >= self.settings.queued_jobs:
            words = f"{self.settings.live_runs} live runs are under way and {len(self.queue)} wait"
            raise Refused(words, 429, allowed=f"at most {self.settings.queued_jobs} that wait")
        order: dict[str, Any] = {
            "request": request,
            "drives": drives,
            "pace": body.pace,
            "root": str(self.root),
        }
        if job is None:
            job = self.store.new_job("live", body.model_dump(), partial(self.check_limits, jobs=1))
            order |= {"journal": [], "step": 0}
        else:
            limit = partial(self.check_limits, jobs=1)
            if not self.store.update(job, limit, RESUMABLE, status="queued", words="", error=None):
                raise Refused("a live run that is queued cannot be resumed", 409, field="id", value=job)
            order |= {"journal": self.store.journal(job), "step": int(self.store.job(job).progress)}
        order["job"] = job
        session = Session(
            job, body.model_dump(), order, self._keep, self._start_queued, self.store.job(job).user
        )
        self._forget_old()
        self.sessions[job] = session
        self.queue.append(session)
        self._start_queued()
        if not session.waiting:
            await session.wait_ready()
        return session

    def _start_queued(self) -> None:
        """Start the live runs that have found a place, the first of the queue first; tell the others."""
        if self.closing:
            return
        self.queue = [session for session in self.queue if session.waiting]
        under_way = sum(s.known.status == "running" for s in self.sessions.values())
        while self.queue and under_way < self.settings.live_runs:
            spare, self.spare = self.spare or start_spare(self.settings.worker_bytes), None
            session = self.queue.pop(0)
            self.store.update(session.id, status="running", words="")
            session.start(spare)
            self.spare = start_spare(self.settings.worker_bytes)
            under_way += 1
        for place, session in enumerate(self.queue, 1):
            if place != session.known.place:
                session.say_place(place)
                self.store.update(session.id, words=place_words(place))

    async def resume_live(self, job: str) -> Session:
        """Resume a live run: repeat its steps and events, then continue in real time.

        Raises:
            Refused: The job is no live run, or it is done, failed or running (409).
        """
        row = self.store.job(job)
        if row.kind != "live" or row.status not in RESUMABLE:
            raise Refused(f"a {row.kind} that is {row.status} cannot be resumed", 409, field="id", value=job)
        return await self.go_live(row_of(row.kind, row.request).body.model_validate(row.request), job)

    def live_run(self, job: str) -> JobRow:
        """Stored row of a live run or convoy, also of an earlier server, or of a drive.

        Raises:
            Refused: Unknown id (404).
        """
        row = self.store.job(job)
        if row.kind not in {"live", "drive"}:
            raise Refused("no such live run", 404, field="id", value=job)
        return row

    def live_runs(self) -> list[JobRow]:
        """Running live runs, those that wait in their order, and the newest of those that can be resumed."""
        rows = self.store.jobs("live", limit=1000)
        going = [row for row in rows if row.status == "running" and row.id in self.sessions]
        places = {session.id: session.known.place or 0 for session in self.queue}
        going += sorted((row for row in rows if row.id in places), key=lambda row: places[row.id])
        return going + [row for row in rows if row.status in RESUMABLE][:LISTED]

    async def stop_abandoned(self) -> None:
        """Stop live runs without viewers for ``ABANDONED_S``, so that others can start."""
        for session in list(self.sessions.values()):
            if session.over or session.waiting or session.unwatched_s <= ABANDONED_S:
                continue
            with suppress(Refused):
                await session.stop()
                words = f"no viewer for {ABANDONED_S:g} s; it can be resumed"
                self.store.update(session.id, words=words)

    def _live_request(self, body: LiveBody) -> tuple[str, Any]:
        """Kind of a live run, and its request as a worker takes it."""
        if isinstance(body, requests.RunningLineIn):
            return "line", self._running_line(body)
        if isinstance(body, requests.ConvoyIn):
            return "convoy", self._convoy(body)
        return "run", self._run(body)

    def _running_line(self, body: requests.RunningLineIn) -> RunningRequest:
        from metropilot.web.live.line import RunningRequest

        values = body.model_dump(exclude={"pace"})
        options = OperationOptions(**{name: values.pop(name) for name in field_specs(OperationOptions)})
        names = {kind: self.path(kind, values.pop(kind)) for kind in ("line", "trainset")}
        made = RunningRequest(**names, **values, options=options)
        made.operation()
        return made

    def _run(self, body: requests.LiveIn) -> RunSpec:
        request = self.run_spec(body)
        request.run()
        check_driver(request)
        return request

    def _convoy(self, body: requests.ConvoyIn) -> ConvoyRequest:
        from metropilot.convoy import ConvoyRequest, Link

        values = body.model_dump()
        of_head = {n: values[n] for n in requests.LiveIn.model_fields if n != "pace"}
        head = self._run(requests.LiveIn.model_validate(of_head))
        own = {n: values[n] for n in (*field_specs(ConvoyRequest), "disturbances") if n in values}
        link = {n: values[f"link_{n}"] for n in field_specs(Link) if f"link_{n}" in values}
        own["behind"] = [self.path("trainset", key) for key in values["behind"]]
        made = ConvoyRequest.from_values(own | {"count": body.trainsets, "link": link}, head)
        made.make_follower()
        made.run(made.convoy())
        return made

    def session(self, job: str) -> Session:
        """A live run of this server.

        Raises:
            Refused: Unknown id (404).
        """
        if job not in self.sessions:
            raise Refused("no such live run", 404, field="id", value=job)
        return self.sessions[job]

    def _keep(self, session: Session, kind: str, known: dict[str, Any]) -> None:
        """Store a message of a live run; runs in the reader's thread."""
        job = session.id
        if self.closing:
            return
        if kind == "journal":
            self.store.note(job, known["step"], known["event"])
        elif kind == "rows":
            if known["step"] // SAVE_STEPS != session.known.step // SAVE_STEPS:
                self.store.update(job, progress=known["step"])
        elif kind == "store":
            self.store.update(job, result=known["result"], words=known["outcome"])
        else:
            error = known["error"]
            changes = {"error": error, "words": error["message"]} if error is not None else {}
            if session.waiting:
                changes["words"] = NOT_STARTED if session.order["step"] == 0 else ""
            if "step" in known:
                changes["progress"] = known["step"]
            self.store.update(job, status=known["status"], **changes)

    def _forget_old(self) -> None:
        over = [key for key, session in self.sessions.items() if session.over and not session.viewers]
        for key in over[: max(len(over) - FORGET, 0)]:
            del self.sessions[key]

    async def _watch_live(self) -> None:
        """Stop abandoned live runs, and start those that wait, for as long as the server runs."""
        while True:
            await asyncio.sleep(WATCH_S)
            try:
                await self.stop_abandoned()
                self._start_queued()
            except Exception as error:  # noqa: BLE001 (a watch that died would leave runs in the queue)
                print_exception(error)

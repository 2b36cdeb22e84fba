"""Projects as archives: written, and read back with nothing of an archive trusted."""

from __future__ import annotations

import asyncio
import json
import re
import secrets
import shutil
import stat
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, BadZipFile, LargeZipFile, ZipFile, ZipInfo

from pydantic import BaseModel, ValidationError

from metropilot.errors import InputError
from metropilot.policy import POLICY_FILE
from metropilot.web.errors import Refused, refusal_of
from metropilot.web.kinds import JOB_KINDS, request_values, row_of
from metropilot.web.schemas.requests import CampaignIn
from metropilot.web.service import SUFFIXES, Service
from metropilot.web.store import OVER, JobRow, JobStore, ProjectRow, new_job_id, new_upload_id, summarise
from metropilot.web.work import campaigns, learning

FORMAT = 1
INDEX = "project.json"
RESULT = "result.json"
ENTRY = re.compile(r"(jobs|uploads)/([A-Za-z0-9][A-Za-z0-9_-]{0,63})/([A-Za-z0-9][A-Za-z0-9_.-]{0,63})")
UPLOAD = re.compile(r"upload-[0-9a-f]{8}")
RUN = re.compile(r"([a-z][a-z0-9_]{0,40}-[0-9]{8}-[0-9]{6})-[0-9a-f]{4}")
"""Id of a learning run."""
NAMED = re.compile(rf"\b(?:{UPLOAD.pattern}|{RUN.pattern.replace('(', '(?:')})\b")
"""Ids by which a request names uploads and policies."""
SOURCE = re.compile(r"Makefile|[A-Za-z][A-Za-z0-9_]*\.(?:c|h|mjs|wasm|html|csv)")
"""File of a driver written as C or WebAssembly."""
VERSIONED = ("line", "trainset")
"""Kinds of uploads that are edited, each time as another version."""
MOST_ENTRIES = 10_000
"""Files of an archive at most."""
CONVOY_RESULT = {"kpis", "success", "time_s", "speeds"}
"""Keys of the result of a convoy."""
RESTING = (*OVER, "interrupted")


def project_out(service: Service, project: str) -> dict[str, Any]:
    """A project with what it holds.

    Raises:
        Refused: No such project (404).
    """
    row = service.store.project(project)
    uploads = [
        {"id": each.id, "kind": each.kind, "name": each.name}
        for each in service.store.uploads()
        if each.project == project
    ]
    jobs = [each.id for each in service.store.jobs(limit=1000, project=project)]
    return {**vars(row), "jobs": jobs, "uploads": uploads}


def set_project(service: Service, entry: str, project: str | None) -> None:
    """File a job or an upload in a project, or in none.

    Raises:
        Refused: No such job, upload or project (404).
    """
    if project is not None:
        service.store.project(project)
    if UPLOAD.fullmatch(entry):
        service.upload_row(entry)
    else:
        service.store.job(entry)
    service.store.set_project(entry, project)


def write_archive(service: Service, project: str) -> bytes:
    """Project as a ZIP archive: its index, results and files of its jobs, every version of its uploads.

    Lines, trainsets, logs and policies that its jobs name go with it, filed or not.

    Raises:
        Refused: No such project (404), or it is too large (422).
    """
    row, made = service.store.project(project), BytesIO()
    jobs = [each for each in service.store.jobs(limit=1000, project=project) if each.status in RESTING]
    named = set(NAMED.findall(json.dumps([job.request for job in jobs])))
    for each in service.store.jobs("learn", limit=1000):
        if each.run in named and each.status in RESTING and each not in jobs:
            jobs.append(each)
    uploads = [each for each in service.store.uploads() if each.project == project or each.id in named]
    index: dict[str, Any] = {"format": FORMAT, "name": row.name, "notes": row.notes}
    index |= {"jobs": [], "uploads": []}
    size = 0
    with ZipFile(made, "w", ZIP_DEFLATED) as archive:

        def put(name: str, content: bytes) -> None:
            nonlocal size
            size += len(content)
            if size > service.settings.archive_bytes:
                most = f"at most {service.settings.archive_bytes} bytes unpacked"
                raise Refused("too large for an archive", 422, field="project", value=project, allowed=most)
            archive.writestr(name, content)

        for job in jobs:
            told = {name: getattr(job, name) for name in ("id", "kind", "status", "request", "words", "name")}
            told |= {"created": job.created, "progress": job.progress, "run": job.run}
            index["jobs"].append(told | {"journal": service.store.journal(job.id)})
            put(f"jobs/{job.id}/{RESULT}", json.dumps(service.store.result(job.id)).encode())
            for name, content in _files_of(service, job).items():
                put(f"jobs/{job.id}/{name}", content)
        for upload in uploads:
            versions = service.store.versions(upload.id)[::-1]
            names = [f"{k}{Path(version.file).suffix}" for k, version in enumerate(versions, 1)]
            index["uploads"].append({"id": upload.id, "name": upload.name, "versions": names})
            for name, version in zip(names, versions, strict=True):
                put(f"uploads/{upload.id}/{name}", (service.root / "uploads" / version.file).read_bytes())
        put(INDEX, json.dumps(index, indent=1).encode())
    return made.getvalue()


def _files_of(service: Service, job: JobRow) -> dict[str, bytes]:
    """Files of a job in an archive, by name."""
    folder, done = service.root / "jobs" / job.id, job.status == "done"
    if job.kind == "learn":
        return {} if job.run is None else learning.run_files(service.root, job.run, resumable=not done)
    if job.kind == "campaign":
        versions = {
            str(service.root / "uploads" / version.file): upload.id
            for upload in service.store.uploads()
            for version in service.store.versions(upload.id)
        }
        with suppress(InputError):  # nothing to go on from: it begins again
            values = service.campaign_values(CampaignIn.model_validate(job.request))
            rows = campaigns.archived_rows(folder, values, service.ids() | versions, whole=done)
            return {campaigns.RESULTS: rows}
        return {}
    paths = [path for path in sorted(folder.glob("[!.]*")) if path.is_file()]
    return {path.name: path.read_bytes() for path in paths if _is_file_of(job.kind, path.name)}


def _is_file_of(kind: str, name: str) -> bool:
    """Tell whether a file belongs to a job: one of its kind, or a copy of a file that its run.toml names."""
    if kind in {"learn", "study", "export"}:
        known = learning.run_file_names(resumable=True) if kind == "learn" else ()
        return name in known or (kind == "export" and SOURCE.fullmatch(name) is not None)
    return name in JOB_KINDS[kind].files or name.endswith((".toml", ".safetensors"))


async def read_archive(service: Service, content: bytes) -> ProjectRow:
    """Add the project of an archive with jobs and uploads under new ids; all of it or nothing.

    Raises:
        InputError: The archive, or something in it, cannot be used; one line names the entry.
        Refused: A viewer imports it (403), or the user keeps too much, or would with it (429).
    """
    service.check_limits()
    files = await asyncio.to_thread(_unpack, content, service.settings.archive_bytes)
    try:
        index = await asyncio.to_thread(json.loads, files.pop(INDEX))
        name, notes, jobs, uploads = (index[key] for key in ("name", "notes", "jobs", "uploads"))
        if index["format"] != FORMAT or not isinstance(name, str) or not isinstance(notes, str):
            raise ValueError("another format")
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError("not a project", file=INDEX, value=str(error)[:80]) from None
    ids: dict[str, str] = {}
    places: list[Path] = []
    try:
        sent = [await _take_upload(service, each, files, ids, places) for each in _rows(uploads, "uploads")]
        found = _rows(jobs, "jobs")
        runs = [run for each in found if RUN.fullmatch(run := str(each.get("run")))]
        ids |= {run: _new_run_id(service.root, run) for run in runs}
        made = [
            await asyncio.to_thread(_take_job, each, files, ids, f"jobs[{k}]") for k, each in enumerate(found)
        ]
        paths = {each.key: str(service.root / "uploads" / each.versions[-1][1]) for each in sent}
        keys = _new_job_ids(made)
        for key, job in keys.items():
            places.append(service.root / "runs" / job.run if job.run else service.root / "jobs" / key)
            await _write_job(service, job, places[-1], ids, paths)
        row = await asyncio.to_thread(_keep, service, (name, notes), sent, keys)
    except BaseException:
        for place in places:
            place.unlink(missing_ok=True) if place.is_file() else shutil.rmtree(place, ignore_errors=True)
        raise
    for job in made:
        if job.run:
            learning.keep_run(service.root, job.run)
    return row


def _keep(
    service: Service,
    about: tuple[str, str],
    uploads: Sequence[ArchivedUpload],
    jobs: Mapping[str, ArchivedJob],
) -> ProjectRow:
    """Add a project, by name and notes, with its uploads and jobs in one transaction."""
    size = sum(each.size for each in (*uploads, *jobs.values()))
    with service.store.together(partial(service.check_limits, size=size)) as store:
        row = store.new_project((about[0].strip() or "imported")[:80], about[1][:20_000])
        for upload in uploads:
            upload.keep(store, row.id)
        for key, job in jobs.items():
            job.keep(store, key, row.id)
    return row


def _rows(values: object, field: str) -> list[dict[str, Any]]:
    if not isinstance(values, list) or not all(isinstance(each, dict) for each in values):
        raise InputError("not a list of entries", file=INDEX, field=field)
    return values


def _unpack(content: bytes, most: int) -> dict[str, bytes]:
    """Files of an archive in memory; nothing of it names a place on this machine.

    Raises:
        InputError: Not a ZIP archive, too large unpacked, or an entry is a link or names another folder.
    """
    found: dict[str, bytes] = {}
    size = 0
    try:
        with ZipFile(BytesIO(content)) as archive:
            entries = archive.infolist()
            if len(entries) > MOST_ENTRIES:
                told = {"value": len(entries), "allowed": f"at most {MOST_ENTRIES}"}
                raise InputError("too many entries", file="archive", **told)
            for entry in entries:
                _check_entry(entry)
                if entry.filename in found:
                    raise InputError("entry is there twice", file="archive", value=entry.filename)
                with archive.open(entry) as file:
                    data = file.read(most - size + 1)
                size += len(data)
                if size > most:
                    allowed = f"at most {most} bytes unpacked"
                    raise InputError("too large", file="archive", value=entry.filename, allowed=allowed)
                found[entry.filename] = data
    except InputError:
        raise
    except (
        BadZipFile,
        LargeZipFile,
        NotImplementedError,
        RuntimeError,
        EOFError,
        OSError,
        ValueError,
    ) as error:
        raise InputError("not a readable ZIP archive", file="archive", value=str(error)[:80]) from None
    if INDEX not in found:
        raise InputError("not a project", file="archive", field=INDEX, allowed="an archive of a project")
    return found


def _check_entry(entry: ZipInfo) -> None:
    name, mode = entry.filename, entry.external_attr >> 16
    allowed = f"{INDEX}, jobs/ID/FILE, uploads/ID/FILE"
    if stat.S_IFMT(mode) not in {0, stat.S_IFREG}:
        raise InputError("entry is no plain file", file="archive", value=name[:80], allowed=allowed)
    if name != INDEX and (not ENTRY.fullmatch(name) or ".." in name):
        raise InputError("entry has another name", file="archive", value=name[:80], allowed=allowed)


@dataclass(frozen=True)
class ArchivedUpload:
    """An upload of an archive, checked: its files are written, its rows are not.

    Attributes:
        key: Its new id.
        kind: Kind of every version.
        versions: Name that the file gives, and file, of each version.
        size: Size of the files, bytes.
    """

    key: str
    kind: str
    versions: tuple[tuple[str, str], ...]
    size: int

    def keep(self, store: JobStore, project: str) -> None:
        """Add the upload with its versions."""
        for number, (name, file) in enumerate(self.versions):
            if number == 0:
                store.add_upload(self.kind, name, file, upload=self.key)
            else:
                store.add_version(self.key, number, name, file)
        store.set_project(self.key, project)


async def _take_upload(
    service: Service,
    told: dict[str, Any],
    files: dict[str, bytes],
    ids: dict[str, str],
    places: list[Path],
) -> ArchivedUpload:
    """Check an upload and write every version of it; add its new id to the ids, the files to the places.

    Raises:
        InputError: A version is missing, cannot be used, or is of another kind than the first.
    """
    old, versions = told.get("id"), told.get("versions")
    if (
        not isinstance(old, str)
        or not UPLOAD.fullmatch(old)
        or not isinstance(versions, list)
        or not versions
    ):
        raise InputError("not an upload", file=INDEX, field="uploads", value=str(told)[:80])
    kind, size = "", 0
    taken: list[tuple[str, str]] = []
    for number, name in enumerate(versions):
        where = f"uploads/{old}/{str(name)[:40]}"
        content = files.get(f"uploads/{old}/{name}")
        if content is None or not str(name).endswith(SUFFIXES):
            raise InputError("missing in the archive", file=where)
        # a log or policy is known by the name of its file
        sent = str(told.get("name", ""))
        first = sent if Path(sent).suffix == Path(name).suffix else str(name)
        file, found = await service.take_file("document.toml" if number else first, content)
        places.append(service.root / "uploads" / file)
        kind = kind or found["kind"]
        if number and (found["kind"] != kind or kind not in VERSIONED):
            told = {"value": found["kind"], "allowed": kind if kind in VERSIONED else "one version"}
            raise InputError(f"not a version of a {kind}", file=where, field="kind", **told)
        taken.append((found["name"][:120], file))
        size += len(content)
    ids[old] = new_upload_id()
    return ArchivedUpload(ids[old], kind, tuple(taken), size)


class ArchivedJob(BaseModel):
    """A job of an archive, checked."""

    kind: str
    status: str
    request: dict[str, Any]
    result: Any
    words: str
    name: str
    created: str
    progress: float
    journal: list[tuple[int, dict[str, Any]]]
    files: dict[str, bytes]
    run: str | None

    @property
    def size(self) -> int:
        """Bytes that are kept of it: files, request, result and journal, as ``Service.kept_bytes`` counts."""
        told = [self.request, *([] if self.result is None else [self.result])]
        told += [event for _, event in self.journal]
        return sum(len(json.dumps(each)) for each in told) + sum(map(len, self.files.values()))

    def write(self, folder: Path) -> None:
        """Write its files into a folder, which is made where there are any."""
        for name, content in self.files.items():
            folder.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)

    def keep(self, store: JobStore, job: str, project: str) -> None:
        """Add the job under a new id."""
        store.new_job(self.kind, self.request, job=job)
        store.note_all(job, self.journal)
        told = {"status", "words", "name", "created", "progress", "run", "result"}
        store.update(job, **self.model_dump(include=told))
        store.set_project(job, project)


def _take_job(told: dict[str, Any], files: dict[str, bytes], ids: dict[str, str], field: str) -> ArchivedJob:
    """Check a job with its request, result and files.

    Raises:
        InputError: Something in it cannot be used.
    """
    key, kind, status = (str(told.get(name)) for name in ("id", "kind", "status"))
    if kind not in JOB_KINDS or status not in RESTING:
        allowed = ", ".join((*JOB_KINDS, *RESTING))
        raise InputError("not a job", file=INDEX, field=field, value=f"{kind} {status}"[:80], allowed=allowed)
    given = told.get("request")
    row = row_of(kind, given)
    prefix = f"jobs/{key}/"
    kept = {name.removeprefix(prefix): data for name, data in files.items() if name.startswith(prefix)}
    try:
        # ids are words of their own, so that they are replaced wherever a request has them
        request = request_values(row.body.model_validate(_rename_ids(given, ids)))
        found = json.loads(kept.pop(RESULT, b"null"))
        run = ids.get(str(told.get("run"))) if kind == "learn" and kept else None
        if kind == "learn":
            found = _rename_ids(found, ids)
        if found is not None and row.result is not None:
            row.result.model_validate(found)
        elif found is not None and not set(found) >= CONVOY_RESULT:
            raise ValueError("not the result of a convoy")
        if found is not None:
            _check_summary(found, f"{field}.result")
        return ArchivedJob(
            kind=kind,
            status=status,
            request=request,
            result=found,
            words=str(told.get("words", ""))[:200],
            name=str(told.get("name", ""))[:80],
            created=datetime.fromisoformat(str(told.get("created"))).isoformat(timespec="seconds"),
            progress=told.get("progress", 0.0),
            journal=told.get("journal", []),
            files={name: data for name, data in kept.items() if _is_file_of(kind, name)},
            run=run,
        )
    except InputError:
        raise
    except (ValidationError, ValueError, TypeError, RecursionError) as error:
        words = str(refusal_of(error.errors(), None) if isinstance(error, ValidationError) else error)
        raise InputError(f"not usable: {words[:120]}", file=INDEX, field=field, value=key[:80]) from None


def _check_summary(result: object, field: str) -> None:
    """Refuse a result of which the list of runs could show nothing.

    Raises:
        InputError: It lacks something that is shown, or is of another form.
    """
    try:
        summarise(result)
    except (LookupError, TypeError, AttributeError, ArithmeticError, ValueError) as error:
        words = f"not usable: {type(error).__name__} {str(error)[:80]}"
        raise InputError(words, file=INDEX, field=field) from None


def _new_job_ids(jobs: Sequence[ArchivedJob]) -> dict[str, ArchivedJob]:
    """Give jobs new ids, the oldest first, and learning runs before others, which name their policies."""
    learned = [job for job in jobs[::-1] if job.kind == "learn"]
    keys: dict[str, ArchivedJob] = {}
    for job in (*learned, *(job for job in jobs[::-1] if job.kind != "learn")):
        key = new_job_id(job.kind)
        while key in keys:  # many at once may draw the same random part
            key = new_job_id(job.kind)
        keys[key] = job
    return keys


async def _write_job(
    service: Service, job: ArchivedJob, folder: Path, ids: Mapping[str, str], paths: dict[str, str]
) -> None:
    """Write the files of a job, those of a learning run or a campaign as its worker left them.

    Args:
        service: Service of the server.
        job: The job; a learning run that has to begin again loses its run.
        folder: Its folder, or that of its learning run.
        ids: New ids by those of the archive.
        paths: Files of the new uploads and policies, by id; a learning run adds its policy.

    Raises:
        InputError: A file of it cannot be used.
    """
    await asyncio.to_thread(job.write, folder)
    try:
        if job.run:
            resumable = job.status != "done"
            if not await service.pools.answer(learning.check_run, str(folder), job.request, resumable):
                shutil.rmtree(folder)
                job.run = None
            elif POLICY_FILE in job.files:
                paths[job.run] = str(folder / POLICY_FILE)
        elif job.kind == "campaign" and campaigns.RESULTS in job.files:

            def path(kind: str, key: str) -> str:
                name, at, late = key.partition("@")
                return paths[name] + at + late if name in paths else service.path(kind, key)

            values = campaigns.file_values(job.request, path)
            campaigns.read_declared(values, service.settings.campaign_rows)
            named = {old: paths[new] for old, new in ids.items() if new in paths}
            await service.pools.answer(campaigns.restore_job, str(service.root), folder.name, values, named)
    except InputError as error:
        # without its folder, which is one of this server and in the values of some errors, too
        name = Path(str(error.file or job.kind)).name
        raise InputError(error.message, file=name, field=error.field) from None


def _rename_ids(values: object, ids: Mapping[str, str]) -> Any:  # noqa: ANN401 (what JSON holds)
    """Replace every id of the archive by its new one."""
    return json.loads(NAMED.sub(lambda match: ids.get(match[0], match[0]), json.dumps(values)))


def _new_run_id(root: Path, run: str) -> str:
    """Make an id for a learning run of an archive that no run here has: driver, date and time stay."""
    while True:
        made = RUN.sub(lambda match: f"{match[1]}-{secrets.token_hex(2)}", run)
        if not (root / "runs" / made).exists():
            return made


def file_name(row: ProjectRow) -> str:
    """Name of the archive of a project."""
    return (re.sub(r"[^A-Za-z0-9_-]+", "-", row.name).strip("-")[:40] or "project") + ".zip"

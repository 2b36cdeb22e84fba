"""Lines, trainsets, drivers, learning runs and studies as plain values."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZIP_DEFLATED, ZipFile

from metropilot import railway
from metropilot._provenance import provenance
from metropilot.drivers import DRIVERS
from metropilot.errors import InputError
from metropilot.evaluate import difference_of, option_defaults
from metropilot.sim import Trajectory
from metropilot.web.errors import Refused
from metropilot.web.kinds import JOB_KINDS, LIVE, live_kind
from metropilot.web.service import Service
from metropilot.web.store import JobRow
from metropilot.web.work.learning import PROGRESS
from metropilot.web.work.plans import numbers, pieces, station

if TYPE_CHECKING:
    from metropilot.studies import PublishedStudy


def line_rows(service: Service) -> list[dict[str, Any]]:
    """Every line, those of the catalogue first."""
    return _rows(service, "line", railway.list_lines(), railway.load_line, _line_row)


def _rows(
    service: Service,
    kind: str,
    keys: Sequence[str],
    load: Callable[[Any], Any],
    row: Callable[..., dict[str, Any]],
) -> list[dict[str, Any]]:
    rows = [row(load(key), key, uploaded=False) for key in keys]
    paths = service.paths()
    for upload in service.store.uploads(kind):
        # an upload that a later version refuses is left out, and can still be deleted
        with suppress(InputError):
            rows.append(row(load(paths[upload.id]), upload.id, uploaded=True))
    return rows


def _line_row(line: railway.Line, key: str, *, uploaded: bool) -> dict[str, Any]:
    length = line.stations[-1].position_m - line.stations[0].position_m
    row = {"id": key, "name": line.name, "stations": len(line.stations), "length_m": length}
    return {**row, "uploaded": uploaded}


def line(service: Service, key: str) -> railway.Line:
    """A line by id.

    Raises:
        Refused: No such line (404).
    """
    path = service.paths("line").get(key)
    if path is None and key not in railway.list_lines():
        raise Refused("no such line", 404, field="line", value=key)
    return railway.load_line(path or key)


def line_out(service: Service, key: str) -> dict[str, Any]:
    """A line with stations, sections, limits and gradients."""
    return line_values(line(service, key), key)


def line_values(found: railway.Line, key: str) -> dict[str, Any]:
    """Plain values of a line.

    Args:
        found: Line.
        key: Id by which it is asked for.
    """
    forward, backward = found.sections(), found.sections(backward=True)[::-1]
    first, last = found.stations[0].position_m, found.stations[-1].position_m
    sections = [
        {
            "origin": f.origin.code,
            "destination": f.destination.code,
            "length_m": f.length_m,
            "planned_forward_s": f.planned_time_s,
            "planned_backward_s": b.planned_time_s,
        }
        for f, b in zip(forward, backward, strict=True)
    ]
    return {
        **_line_row(found, key, uploaded=key not in railway.list_lines()),
        "stops": [station(s) for s in found.stations],
        "sections": sections,
        "dwell_s": list(found.dwell_s),
        "limit_mps": pieces(found.limit_mps.window(first, last)),
        "gradient_permil": pieces(found.gradient_permil.window(first, last)),
        "source": dict(found.source),
        "notes": list(found.notes),
        "unused": list(found.unused),
    }


def trainset_rows(service: Service) -> list[dict[str, Any]]:
    """Every trainset, those of the catalogue first."""
    return _rows(service, "trainset", railway.list_trainsets(), railway.load_trainset, _trainset_out)


def trainset(service: Service, key: str) -> railway.Trainset:
    """A trainset by id, or by ``ID@DELAY,LAG``; ``drawn-SEED-NUMBER`` is a random one.

    Raises:
        Refused: No such trainset (404).
    """
    path = service.path("trainset", key)
    named = railway.parse_trainset(path)
    if not (named.is_named or named.id in service.paths("trainset").values()):
        raise Refused("no such trainset", 404, field="trainset", value=key)
    return railway.load_trainset(path)


def trainset_out(service: Service, key: str) -> dict[str, Any]:
    """Values of a trainset by id.

    Raises:
        Refused: No such trainset (404).
    """
    return _trainset_out(
        trainset(service, key), key, uploaded=key.partition("@")[0] in service.paths("trainset")
    )


def _trainset_out(found: railway.Trainset, key: str, *, uploaded: bool) -> dict[str, Any]:
    return {
        "id": key,
        "name": found.name,
        "loads_kg": dict(found.loads),
        "load": found.load,
        "length_m": found.length_m,
        "max_speed_mps": found.max_speed_mps,
        "max_acceleration_mps2": found.max_acceleration_mps2,
        "max_deceleration_mps2": found.max_deceleration_mps2,
        "uploaded": uploaded,
    }


def day_rows() -> list[dict[str, Any]]:
    """Every working day."""
    days = [railway.load_day(key) for key in railway.list_days()]
    return [
        {
            "id": day.id,
            "name": day.name,
            "line": day.line_id,
            "first_s": day.periods[0].from_s,
            "last_s": day.periods[-1].to_s,
        }
        for day in days
    ]


def feeding_rows(service: Service) -> list[dict[str, Any]]:
    """Every DC network, with the lines that reach all of its substations."""
    keys = [row["id"] for row in line_rows(service)]
    lines = {key: line(service, key) for key in keys}
    rows = []
    for feeding in map(railway.load_feeding, railway.list_feedings()):
        fed = []
        for key, each in lines.items():
            with suppress(InputError):
                feeding.check_line(each)
                fed.append(key)
        rows.append({"id": feeding.id, "name": feeding.name, "lines": fed})
    return rows


def driver_rows() -> list[dict[str, Any]]:
    """Every driver."""
    return [
        {
            "id": key,
            "summary": row.summary,
            "source": row.source,
            "options": _plain_options(option_defaults(DRIVERS.get(key))),
        }
        for key, row in DRIVERS.rows().items()
    ]


def _plain_options(options: dict[str, Any]) -> dict[str, Any]:
    return {
        name: value if isinstance(value, bool | int | float | str) or value is None else str(value)
        for name, value in options.items()
        if not (isinstance(value, float) and not math.isfinite(value))
    }


def run_rows(service: Service) -> list[dict[str, Any]]:
    """Learning runs, the newest first."""
    from metropilot.learn import RunStore

    return [_run_out(record) for record in RunStore(service.root / "runs").find("")]


def run_out(service: Service, key: str) -> dict[str, Any]:
    """A learning run.

    Raises:
        Refused: No such run (404).
    """
    from metropilot.learn import RunStore

    runs = RunStore(service.root / "runs")
    try:
        found = runs.show(key)
    except InputError:
        found = None
    if found is None or found.id != key:  # the store also takes the beginning of an id
        raise Refused("no such run", 404, field="id", value=key)
    return _run_out(found)


def _run_out(record: Any) -> dict[str, Any]:  # noqa: ANN401 (a RunRecord, whose module is imported late)
    names = ("id", "algorithm", "task", "seed", "status", "created", "seconds", "steps", "score")
    total = record.config.get("steps")
    return {**{name: getattr(record, name) for name in names}, "total_steps": total}


def history(service: Service, key: str) -> dict[str, list[float | None]]:
    """History of a learning run, one column for each measure; a repeated chunk counts once."""
    run_out(service, key)
    folder = service.root / "runs" / key
    rows: dict[float, dict[str, Any]] = {}
    path = folder / PROGRESS
    if path.exists():
        for text in path.read_text(encoding="utf-8").splitlines():
            with suppress(ValueError):  # the last one is still being written
                row = json.loads(text)
                rows[row["steps"]] = row
        names = list(dict.fromkeys(name for row in rows.values() for name in row))
        ordered = [rows[steps] for steps in sorted(rows)]
        return {name: numbers([_number(row.get(name)) for row in ordered]) for name in names}
    if (folder / "history.parquet").exists():
        from metropilot.learn import read_history

        return {name: numbers(column) for name, column in read_history(folder / "history.parquet").items()}
    return {}


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def task_rows() -> list[dict[str, Any]]:
    """Learning tasks."""
    from metropilot.env import TASKS

    return [{"id": key, "summary": row.summary} for key, row in TASKS.rows().items()]


def recipe_rows() -> list[dict[str, Any]]:
    """Learning recipes of drivers, with their sources and steps."""
    from metropilot.learn import RECIPES

    return [
        {
            "driver": key,
            "summary": row.summary,
            "source": row.source,
            "task": RECIPES.get(key).task,
            "steps_quick": RECIPES.get(key).quick.steps,
            "steps_paper": RECIPES.get(key).paper.steps,
        }
        for key, row in RECIPES.rows().items()
    ]


def study_rows(service: Service) -> list[dict[str, Any]]:
    """Every study; ``page`` is true where a report of it exists."""
    from metropilot.studies import STUDIES

    return [
        {"id": key, "title": row.summary, "page": _report(service, key) is not None}
        for key, row in STUDIES.rows().items()
    ]


def study_table(service: Service, key: str) -> list[dict[str, Any]]:
    """Rows of the newest report of a study.

    Raises:
        Refused: Unknown study, or no report yet (404).
    """
    from metropilot.studies import STUDIES

    found = _report(service, key) if key in STUDIES else None
    if found is None:
        words = "no report yet; start the study" if key in STUDIES else "no such study"
        raise Refused(words, 404, field="study", value=key)
    return found["rows"]


def study_page(key: str) -> PublishedStudy:
    """The published page of a study.

    Raises:
        Refused: No such study, or its page is not there (404).
    """
    from metropilot.studies import published_study

    try:
        return published_study(key)
    except InputError as error:
        raise Refused(error.message, 404, field="study", value=key) from None


def _report(service: Service, key: str) -> dict[str, Any] | None:
    """Newest report made by a job of this server."""
    for job in service.store.jobs("study", limit=1000):
        if job.status == "done" and job.request.get("study") == key:
            return service.store.result(job.id)
    return None


KINDS: dict[str, str] = {kind: row.words for kind, row in JOB_KINDS.items()}
KINDS |= {"convoy": LIVE["convoy"].words, "running": LIVE["line"].words}
"""Kinds of jobs in words; a live run with followers is a convoy, one of a whole line a running line."""


def kind_of(row: JobRow) -> str:
    """Kind of a job, one of ``KINDS``."""
    if row.kind != "live":
        return row.kind
    return {"convoy": "convoy", "line": "running", "run": "live"}[live_kind(row.request)]


def page_of(row: JobRow) -> str:
    """Address of the page on which a job is opened."""
    kind = kind_of(row)
    if kind == "export":
        return f"/learn?export={row.id}"
    if kind == "campaign":
        return f"/campaigns?campaign={row.id}"
    if kind == "study":
        return f"/learn?study={row.request['study']}"
    if kind in {"compare", "journey", "line", "learn", "fit"}:
        return f"/{kind}?job={row.id}"
    page = {"convoy": "/convoy", "running": "/line"}.get(kind, "/")
    return f"{page}?run={row.id}"


def describe_job(row: JobRow) -> str:
    """A job in words: where, what drives, in which time."""
    body, kind = row.request, kind_of(row)
    if kind == "learn":
        return f"{body['driver']} · {body['budget']} · seed {body['seed']}"
    if kind == "study":
        return f"{body['study']} · {body['budget']}"
    if kind in {"campaign", "fit"}:
        return body["name"] if kind == "campaign" else f"{body['trainset']} · logs: {len(body['logs'])}"
    if kind == "export":
        return f"{body['driver']} · {body['line']} · {body['to']} · {body['number']}"
    if kind in {"line", "running"}:
        return f"{body['line']} · {body.get('day') or 'every ' + str(body['headway_s']) + ' s'}"
    ends = f"{body['origin']} – {body['destination']}" if body["origin"] else "every station"
    what = {"compare": ", ".join(body.get("drivers", ())), "convoy": f"convoy of {body.get('trainsets')}"}
    parts = [body["line"], ends, what.get(kind, body.get("driver", ""))]
    time_s = body.get("time_s", body.get("total_s"))
    return " · ".join([part for part in parts if part] + ([] if time_s is None else [f"{time_s:g} s"]))


def result_of(service: Service, job: str, kinds: Sequence[str]) -> Any:  # noqa: ANN401 (of that kind of job)
    """Result of a job of one of some kinds, as :func:`kind_of` has them.

    Raises:
        Refused: No such job, it is of another kind, or it has no result (404).
    """
    row = service.store.job(job)
    kind = kind_of(row)
    found = service.store.result(job) if kind in kinds else None
    if found is None:
        words = (
            f"no result: the job is {row.status}" if kind in kinds else f"the job is a {KINDS[kind].lower()}"
        )
        raise Refused(words, 404, field="id", value=job)
    return found


def difference(service: Service, first: str, second: str) -> dict[str, Any]:
    """Two drives of one section against each other.

    Raises:
        Refused: One has no result or is no drive (404), or they are of different sections (422).
    """
    jobs, sections, told = (first, second), [], []
    for job in jobs:
        row = service.store.job(job)
        told.append(result_of(service, job, ("drive", "live")))
        sections.append(_section_words(service, row.request))
    if sections[0] != sections[1]:
        words = "runs of different sections cannot be compared"
        raise Refused(words, 422, field="other_id", value=sections[1], allowed=sections[0])
    paths = [service.root / "jobs" / job / "trajectory.csv" for job in jobs]
    found = difference_of(*(Trajectory.read(path) for path in paths))
    names = [
        name
        for name, value in told[0]["kpis"].items()
        if isinstance(value, int | float) and not isinstance(value, bool) and name in told[1]["kpis"]
    ]
    pairs = ("speed_mps", "time_s", "energy_wheel_j", "energy_line_j")
    return {
        "drivers": [each["driver"] for each in told],
        "position_m": numbers(found.position_m, 3),
        **{name: [numbers(row, 4) for row in getattr(found, name)] for name in pairs},
        "kpis": [{"name": n, "first": told[0]["kpis"][n], "second": told[1]["kpis"][n]} for n in names],
    }


def _section_words(service: Service, body: dict[str, Any]) -> str:
    """Line and station codes of a run."""
    ends = [body["origin"], body["destination"]]
    with suppress(InputError):
        known = line(service, body["line"])
        ends = [known.station(name).code for name in ends]
    return f"{body['line']} {ends[0]} – {ends[1]}"


def file_of(service: Service, job: str, name: str) -> Path:
    """Path of a file of a job, by one of the file names of its kind.

    Raises:
        Refused: No such job or file (404).
    """
    from metropilot.web.work.drives import archive

    row = service.store.job(job)
    folder = service.root / "jobs" / row.id
    path = archive(folder) if name == "trajectories.zip" else folder / name
    if name not in JOB_KINDS[row.kind].files or not path.is_file():
        raise Refused("no such file", 404, field="name", value=name)
    return path


async def report_of(service: Service, job: str) -> bytes:
    """Report of a run, a comparison or a journey as PDF, made now.

    Raises:
        Refused: No such job, it is of another kind, or it has no result (404).
    """
    from metropilot.web.work.reports import KIND_WORDS, report_pdf

    row = service.store.job(job)
    result = result_of(service, job, tuple(KIND_WORDS))
    fields = JOB_KINDS[row.kind].body.model_fields
    always = {"line", "origin", "destination", "trainset", "driver"}
    given = {
        name: value
        for name, value in row.request.items()
        if name in always
        or name not in fields
        or value != fields[name].get_default(call_default_factory=True)
    }
    what = f"{row.request['line']} {row.request['origin'] or ''} {row.request['destination'] or ''}".strip()
    about = {
        "id": row.id,
        "name": row.name or f"{KIND_WORDS[row.kind]}: {what}",
        "created": row.created,
        "request": given,
        "made_with": provenance(),
    }
    return await service.pools.answer(
        report_pdf, row.kind, about, result, str(service.root / "jobs" / row.id)
    )


def archive_of(service: Service, job: str) -> bytes:
    """Every file of a job as a ZIP archive, in a folder of the job's name.

    Raises:
        Refused: No such job, or it has no files (404).
    """
    row = service.store.job(job)
    folder = service.root / "jobs" / row.id
    files = sorted(p for p in folder.glob("[!.]*") if p.is_file() and p.suffix != ".zip")
    if not files:
        raise Refused("no files: nothing was driven to its end", 404, field="id", value=job)
    made = BytesIO()
    with ZipFile(made, "w", ZIP_DEFLATED) as archive:
        for path in files:
            archive.write(path, f"{row.id}/{path.name}")
    return made.getvalue()

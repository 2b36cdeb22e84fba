"""Routes of jobs: drives, comparisons, lines, learning runs and studies, computed in worker processes."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query
from fastapi.responses import FileResponse, Response

from metropilot.web import catalogue
from metropilot.web.api.catalogue import Key
from metropilot.web.errors import Refused
from metropilot.web.kinds import JOB_KINDS
from metropilot.web.schemas import requests, responses
from metropilot.web.service import Service
from metropilot.web.store import JobRow

ARCHIVE = "run.zip"
PNG: dict[int | str, dict[str, Any]] = {
    200: {"content": {"image/png": {"schema": {"type": "string", "format": "binary"}}}}
}
PDF: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/pdf": {"schema": {"type": "string", "format": "binary"}}}}
}
FigureName = Annotated[str, Path(pattern=r"^[a-z0-9_]{1,40}\.png$")]
FileName = Annotated[str, Path(pattern=r"^[a-z]{1,16}(-[0-9])?\.(csv|json|parquet|svg|png|toml|zip)$")]


def add_job(router: APIRouter, service: Service, kind: str, words: str) -> None:
    """Add the route that queues a job of a kind, described by words."""

    def submit(body: Any) -> JobRow:  # noqa: ANN401 (the body of the kind)
        return service.store.job(service.submit(body))

    submit.__annotations__["body"] = JOB_KINDS[kind].body
    told: dict[str, Any] = {"name": kind, "description": words, "status_code": 202}
    router.post(f"/jobs/{kind}", response_model=responses.JobOut, **told)(submit)


def add_result(router: APIRouter, service: Service, kind: str, words: str, *others: str) -> None:
    """Add the route of the result of a job of a kind, or of others with the same result."""

    def result(job_id: Key) -> Any:  # noqa: ANN401 (validated by the model)
        return catalogue.result_of(service, job_id, (kind, *others))

    told: dict[str, Any] = {"name": f"{kind}_result", "description": words}
    router.get(f"/jobs/{{job_id}}/{kind}", response_model=JOB_KINDS[kind].result, **told)(result)


def routes(service: Service) -> APIRouter:
    """Make the routes of jobs, learning runs and studies."""
    router = APIRouter(tags=["jobs"])

    add_job(router, service, "drive", "Drive one run.")
    add_job(router, service, "compare", "Drive the same run with several drivers and seeds.")

    @router.post("/jobs/journey", response_model=responses.JobOut, status_code=201)
    async def journey(body: requests.JourneyIn) -> JobRow:
        """Plan a journey at once and keep it."""
        return service.store.job(await service.keep_journey(body))

    add_job(router, service, "line", "Compute the energy of all trains of a line, beside its floor.")
    words = "Write a learned driver under protection as C or WebAssembly; `/files/run.zip` holds it."
    add_job(router, service, "export", words)
    add_job(router, service, "learn", "Learn a driver.")
    add_job(router, service, "study", "Reproduce a study.")

    @router.get("/jobs", response_model=list[responses.JobOut])
    def jobs(
        kind: responses.JobKind | None = None,
        status: responses.JobStatus | None = None,
        text: Annotated[str, Query(max_length=100)] = "",
        sort: responses.JobSort = "created",
        *,
        ascending: bool = False,
        limit: Annotated[int, Query(ge=1, le=1000)] = 100,
        offset: Annotated[int, Query(ge=0, lt=2**31)] = 0,
        project: Annotated[str | None, Query(max_length=64)] = None,
    ) -> list[JobRow]:
        """Jobs, the newest first; `text` is looked for in id, name and request."""
        found: dict[str, Any] = {
            "project": project,
            "status": status,
            "text": text,
            "sort": sort,
            "ascending": ascending,
            "offset": offset,
        }
        return service.store.jobs(kind, limit, **found)

    @router.get("/jobs/{job_id}", response_model=responses.JobOut)
    def job(job_id: Key) -> JobRow:
        """A job."""
        return service.store.job(job_id)

    @router.patch("/jobs/{job_id}", response_model=responses.JobOut)
    def name_job(job_id: Key, body: requests.NameIn) -> JobRow:
        """Name a job."""
        return service.name_job(job_id, body.name)

    @router.delete("/jobs/{job_id}", status_code=204)
    def forget(job_id: Key) -> None:
        """Remove a job with its files; of a learning run the policy, too. One that runs is refused (409)."""
        service.forget_job(job_id)

    add_result(router, service, "drive", "Result of a drive, or of a live run that has ended.", "live")
    add_result(router, service, "compare", "Result of a comparison.")

    @router.get("/jobs/{job_id}/difference/{other_id}", response_model=responses.DifferenceOut)
    def difference(job_id: Key, other_id: Key) -> dict[str, Any]:
        """Two drives or live runs of one section against each other, over distance."""
        return catalogue.difference(service, job_id, other_id)

    add_result(router, service, "journey", "Result of a journey.")
    words = "Energies and train graph of a line; there as soon as the files are being written."
    add_result(router, service, "line", words)

    @router.post("/jobs/{job_id}/stop", response_model=responses.JobOut)
    def stop(job_id: Key) -> JobRow:
        """Ask a job to end; a learning run ends at its next checkpoint."""
        service.stop(job_id)
        return service.store.job(job_id)

    @router.post("/jobs/{job_id}/resume", response_model=responses.JobOut, status_code=202)
    def resume(job_id: Key) -> JobRow:
        """Go on with a job that was interrupted, stopped or failed; learning from its last checkpoint."""
        service.resume(job_id)
        return service.store.job(job_id)

    _add_files(router, service)
    _add_learning(router, service)
    return router


def _add_files(router: APIRouter, service: Service) -> None:
    @router.get("/jobs/{job_id}/files/report.pdf", response_class=Response, responses=PDF)
    async def report(job_id: Key) -> Response:
        """Report of a run, a comparison or a journey for printing (A4), made when it is asked for.

        Its picture, requirements, KPIs, reasons, request, versions and commit.
        """
        told = {"Content-Disposition": f'inline; filename="{job_id}-report.pdf"'}
        return Response(
            await catalogue.report_of(service, job_id), media_type="application/pdf", headers=told
        )

    @router.get("/jobs/{job_id}/files/{name}", response_class=FileResponse)
    def file(job_id: Key, name: FileName) -> Response:
        """A file of a job: `trajectory.csv`, `kpis.json`, `profile.svg`, `profile.png`, `run.toml`, ...

        `run.zip` holds all of them and the files that `run.toml` names (an uploaded line, trainset or
        policy), so that `metropilot drive --from run.toml` drives it again anywhere. Of a convoy there are
        `trajectory-1.csv` and so on, and all of these in `trajectories.zip`; of a line in operation
        `line.json` or `day.json`, `timetable.csv` and, of a day, `gtfs.zip`; of a fit `trainset.toml`,
        `fit.json`, `residuals.svg`, `residuals.png`.
        """
        if name == ARCHIVE:
            told = {"Content-Disposition": f'attachment; filename="{job_id}.zip"'}
            content = catalogue.archive_of(service, job_id)
            return Response(content, media_type="application/zip", headers=told)
        return FileResponse(catalogue.file_of(service, job_id, name), filename=f"{job_id}-{name}")


def _add_learning(router: APIRouter, service: Service) -> None:
    @router.get("/tasks", response_model=list[responses.TaskOut], tags=["learning"])
    def tasks() -> list[dict[str, Any]]:
        """Learning tasks."""
        return catalogue.task_rows()

    @router.get("/recipes", response_model=list[responses.RecipeOut], tags=["learning"])
    def recipes() -> list[dict[str, Any]]:
        """Learning recipes of drivers."""
        return catalogue.recipe_rows()

    @router.get("/runs", response_model=list[responses.RunOut], tags=["learning"])
    def runs() -> list[dict[str, Any]]:
        """Learning runs, the newest first."""
        return catalogue.run_rows(service)

    @router.get("/runs/{run_id}", response_model=responses.RunOut, tags=["learning"])
    def run(run_id: Key) -> dict[str, Any]:
        """A learning run."""
        return catalogue.run_out(service, run_id)

    @router.get("/runs/{run_id}/history", response_model=responses.HistoryOut, tags=["learning"])
    def history(run_id: Key) -> dict[str, Any]:
        """History of a learning run, also while it runs."""
        return {"columns": catalogue.history(service, run_id)}

    @router.get("/studies", response_model=list[responses.StudyOut], tags=["learning"])
    def studies() -> list[dict[str, Any]]:
        """Papers reproduced."""
        return catalogue.study_rows(service)

    @router.get("/studies/{study_id}", response_model=list[responses.StudyRow], tags=["learning"])
    def study_table(study_id: Key) -> list[dict[str, Any]]:
        """The newest table of a study: published, reproduced and optimal values."""
        return catalogue.study_table(service, study_id)

    @router.get("/studies/{study_id}/page", response_model=responses.StudyPage, tags=["learning"])
    def study_page(study_id: Key) -> dict[str, Any]:
        """The published page of a study: verdicts on the paper's claims, every row, figures."""
        found = catalogue.study_page(study_id)
        rows = [asdict(row) for row in found.rows]
        return vars(found) | {"rows": rows, "figures": [each._asdict() for each in found.figures]}

    @router.get(
        "/studies/{study_id}/figures/{figure}",
        response_class=FileResponse,
        responses=PNG,
        tags=["learning"],
    )
    def study_figure(study_id: Key, figure: FigureName) -> FileResponse:
        """A figure of the published page of a study, as PNG."""
        for each in catalogue.study_page(study_id).figures:
            if each.name == figure:
                return FileResponse(each.path)
        raise Refused("no such figure", 404, field="figure", value=figure)

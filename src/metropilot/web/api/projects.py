"""Routes of projects: named folders of runs, lines and trainsets, with notes."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, UploadFile
from fastapi.responses import Response

from metropilot.web import projects
from metropilot.web.api.catalogue import Key
from metropilot.web.schemas.requests import FiledIn, ProjectIn
from metropilot.web.schemas.responses import JobOut, ProjectEntries, ProjectOut
from metropilot.web.service import Service
from metropilot.web.store import JobRow, ProjectRow

ZIP: dict[int | str, dict[str, Any]] = {
    200: {"content": {"application/zip": {"schema": {"type": "string", "format": "binary"}}}}
}


def routes(service: Service) -> APIRouter:
    """Make the routes of projects."""
    router = APIRouter(tags=["projects"])

    @router.get("/projects", response_model=list[ProjectOut])
    def every() -> list[ProjectRow]:
        """Every project, by name."""
        return service.store.projects()

    @router.post("/projects", response_model=ProjectOut, status_code=201)
    def begin(body: ProjectIn) -> ProjectRow:
        """Begin a project."""
        return service.store.new_project(body.name, body.notes)

    @router.post("/projects/archive", response_model=ProjectOut, status_code=201)
    async def read(file: UploadFile) -> ProjectRow:
        """Add the project of an archive; jobs and uploads get new ids."""
        return await projects.read_archive(service, await file.read())

    @router.get("/projects/{project_id}", response_model=ProjectEntries)
    def project(project_id: Key) -> dict[str, Any]:
        """A project with the ids of its jobs, and its uploads."""
        return projects.project_out(service, project_id)

    @router.put("/projects/{project_id}", response_model=ProjectOut)
    def change(project_id: Key, body: ProjectIn) -> ProjectRow:
        """Change name and notes of a project."""
        service.store.project(project_id)
        service.store.update_project(project_id, name=body.name, notes=body.notes)
        return service.store.project(project_id)

    @router.delete("/projects/{project_id}", status_code=204)
    def forget(project_id: Key) -> None:
        """Remove a project; what it holds stays."""
        service.store.project(project_id)
        service.store.forget_project(project_id)

    @router.get("/projects/{project_id}/archive", response_class=Response, responses=ZIP)
    def write_files(project_id: Key) -> Response:
        """A project as one archive: jobs with their files, lines and trainsets in every version, notes.

        Lines, trainsets, logs and policies that its jobs name go with it; what still runs is left out.
        """
        content = projects.write_archive(service, project_id)
        name = projects.file_name(service.store.project(project_id))
        told = {"Content-Disposition": f'attachment; filename="{name}"'}
        return Response(content, media_type="application/zip", headers=told)

    @router.put("/jobs/{job_id}/project", response_model=JobOut)
    def file_job(job_id: Key, body: FiledIn) -> JobRow:
        """File a job in a project, or in none."""
        service.store.job(job_id)
        projects.set_project(service, job_id, body.project)
        return service.store.job(job_id)

    @router.put("/uploads/{upload_id}/project", status_code=204)
    def file_upload(upload_id: Key, body: FiledIn) -> None:
        """File a line, trainset or policy in a project, or in none."""
        service.upload_row(upload_id)
        projects.set_project(service, upload_id, body.project)

    return router

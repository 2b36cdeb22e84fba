"""Lines, trainsets, drivers, uploads."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, UploadFile
from fastapi.responses import PlainTextResponse

from metropilot.web import catalogue
from metropilot.web.schemas import requests, responses
from metropilot.web.service import Service
from metropilot.web.store import VersionRow

Key = Annotated[str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
Version = Annotated[int | None, Query(ge=1, lt=2**31)]


def routes(service: Service) -> APIRouter:
    """Make the routes of the catalogue."""
    router = APIRouter(tags=["catalogue"])

    @router.get("/lines", response_model=list[responses.LineRow])
    def lines() -> list[dict[str, Any]]:
        """Every line."""
        return catalogue.line_rows(service)

    @router.get("/lines/{line_id}", response_model=responses.LineOut)
    def line(line_id: Key) -> dict[str, Any]:
        """A line with stations, sections, limits and gradients."""
        return catalogue.line_out(service, line_id)

    @router.get("/lines/{line_id}/toml", response_class=PlainTextResponse)
    def line_toml(line_id: Key, version: Version = None) -> PlainTextResponse:
        """A line as metropilot's TOML; of an upload the newest version, if none is named."""
        return _attach(line_id, service.text("line", line_id, version))

    @router.get("/trainsets", response_model=list[responses.TrainsetOut])
    def trainsets() -> list[dict[str, Any]]:
        """Every trainset."""
        return catalogue.trainset_rows(service)

    @router.get("/trainsets/{trainset_id}", response_model=responses.TrainsetOut)
    def trainset(trainset_id: Key) -> dict[str, Any]:
        """A trainset."""
        return catalogue.trainset_out(service, trainset_id)

    @router.get("/trainsets/{trainset_id}/toml", response_class=PlainTextResponse)
    def trainset_toml(trainset_id: Key, version: Version = None) -> PlainTextResponse:
        """A trainset as metropilot's TOML; of an upload the newest version, if none is named."""
        return _attach(trainset_id, service.text("trainset", trainset_id, version))

    @router.get("/drivers", response_model=list[responses.DriverOut])
    def drivers() -> list[dict[str, Any]]:
        """Every driver, with its options and their defaults."""
        return catalogue.driver_rows()

    @router.get("/days", response_model=list[responses.DayRow])
    def days() -> list[dict[str, Any]]:
        """Every working day."""
        return catalogue.day_rows()

    @router.get("/feedings", response_model=list[responses.FeedingRow])
    def feedings() -> list[dict[str, Any]]:
        """Every DC network, with the lines that it can feed."""
        return catalogue.feeding_rows(service)

    @router.post("/uploads", response_model=responses.UploadOut, status_code=201)
    async def upload(file: UploadFile) -> dict[str, Any]:
        """Upload a line or trainset (metropilot's TOML, TTOBench's JSON), a policy, or a log of runs (CSV).

        Policies are safetensors. Use the id like one of the catalogue; the id of a policy is given as the
        option `policy` of a driver, those of logs to `POST /api/jobs/fit`.
        """
        most = max(service.settings.upload_bytes, service.settings.log_bytes)
        content = await file.read(most + 1)
        row, found = await service.upload(file.filename or "file", content)
        return {"kind": row.kind, "id": row.id, "name": row.name, "notes": found["notes"]}

    @router.get("/uploads/{upload_id}/versions", response_model=list[responses.VersionOut])
    def versions(upload_id: Key) -> list[VersionRow]:
        """Versions of an upload, the newest first."""
        service.upload_row(upload_id)
        return service.store.versions(upload_id)

    @router.put("/uploads/{upload_id}", response_model=responses.VersionOut)
    async def save(upload_id: Key, body: requests.VersionIn) -> VersionRow:
        """Save the next version of a line or trainset; 409 if another one was saved meanwhile."""
        number = await service.save(upload_id, body.toml, body.version)
        return next(row for row in service.store.versions(upload_id) if row.number == number)

    @router.delete("/uploads/{upload_id}", status_code=204)
    def forget(upload_id: Key) -> None:
        """Remove an upload with all its versions."""
        service.forget(upload_id)

    return router


def _attach(key: str, text: str) -> PlainTextResponse:
    told = {"Content-Disposition": f'attachment; filename="{key}.toml"'}
    return PlainTextResponse(text, headers=told)

"""Lines, trainsets, drivers, uploads."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, UploadFile

from metropilot.web import catalogue
from metropilot.web.schemas.responses import DriverOut, LineOut, LineRow, TrainsetOut, UploadOut
from metropilot.web.service import Service

Key = Annotated[str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]


def routes(service: Service) -> APIRouter:
    """Make the routes of the catalogue."""
    router = APIRouter(tags=["catalogue"])

    @router.get("/lines", response_model=list[LineRow])
    def lines() -> list[dict[str, Any]]:
        """Every line."""
        return catalogue.line_rows(service)

    @router.get("/lines/{line_id}", response_model=LineOut)
    def line(line_id: Key) -> dict[str, Any]:
        """A line with stations, sections, limits and gradients."""
        return catalogue.line_out(service, line_id)

    @router.get("/trainsets", response_model=list[TrainsetOut])
    def trainsets() -> list[dict[str, Any]]:
        """Every trainset."""
        return catalogue.trainset_rows(service)

    @router.get("/trainsets/{trainset_id}", response_model=TrainsetOut)
    def trainset(trainset_id: Key) -> dict[str, Any]:
        """A trainset."""
        return catalogue.trainset_out(service, trainset_id)

    @router.get("/drivers", response_model=list[DriverOut])
    def drivers() -> list[dict[str, Any]]:
        """Every driver, with its options and their defaults."""
        return catalogue.driver_rows()

    @router.post("/uploads", response_model=UploadOut, status_code=201)
    async def upload(file: UploadFile) -> dict[str, Any]:
        """Upload a line or trainset (metropilot's TOML, TTOBench's JSON) or a policy (safetensors).

        Use the id like one of the catalogue; the id of a policy is given as the option `policy` of a driver.
        """
        content = await file.read(service.settings.upload_bytes + 1)
        row, found = await service.upload(file.filename or "file", content)
        return {"kind": row.kind, "id": row.id, "name": row.name, "notes": found["notes"]}

    @router.delete("/uploads/{upload_id}", status_code=204)
    def forget(upload_id: Key) -> None:
        """Remove an upload."""
        service.forget(upload_id)

    return router

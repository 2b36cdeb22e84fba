"""The application: API, pages, and the server that runs both."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp

import metropilot
from metropilot.web import errors
from metropilot.web.api import catalogue, docs, jobs, live, planning
from metropilot.web.refusals import Refused
from metropilot.web.schemas.responses import Health
from metropilot.web.security import Guard
from metropilot.web.service import Service
from metropilot.web.settings import Settings

METHODS = ("GET", "HEAD", "OPTIONS", "POST", "PUT", "PATCH", "DELETE", "TRACE")
SUMMARY = """Drive, compare, plan and learn over HTTP. SI units, in the names of the fields.

Every error is `{"error": {"message", "file", "field", "value", "unit", "allowed"}}`."""


def make_api(service: Service) -> FastAPI:
    """The API alone, described at ``/api/openapi.json`` and, to be read, at ``/api/docs``.

    The service opens and closes with it.

    Args:
        service: What does the work.
    """

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        await service.open()
        try:
            yield
        finally:
            await service.close()

    app = FastAPI(
        title="metropilot",
        description=SUMMARY,
        version=metropilot.__version__,
        lifespan=lifespan,
        openapi_url="/api/openapi.json",
        docs_url=None,
        redoc_url=None,
        responses=errors.RESPONSES,
    )
    errors.install(app)

    @app.get("/api/health", response_model=Health, tags=["server"])
    def health() -> dict[str, object]:
        """That the server is there."""
        lives = sum(not session.over for session in service.sessions.values())
        return {
            "version": metropilot.__version__,
            "jobs_running": service.store.waiting(),
            "live_runs": lives,
        }

    for module in (catalogue, planning, jobs, live):
        app.include_router(module.routes(service), prefix="/api")

    app.include_router(docs.routes(app), prefix="/api")

    @app.api_route("/api/{rest:path}", methods=list(METHODS), include_in_schema=False)
    def nowhere(rest: str) -> None:
        """What is no route of ours is no page either; a route of ours is asked in its own way."""
        path = f"/api/{rest}"
        if known := _methods(app.openapi()["paths"], path):
            raise HTTPException(errors.METHOD_NOT_ALLOWED, headers={"Allow": ", ".join(known)})
        raise Refused("no such route", 404, field="path", value=path[:200])

    return app


def _methods(paths: dict[str, Any], path: str) -> list[str]:
    """How a path may be asked; nothing if it is none of ours."""
    for template, operations in paths.items():
        parts = (re.escape(part) for part in re.split(r"\{[^}]*\}", template))
        if re.fullmatch("[^/]+".join(parts), path):
            return sorted(method.upper() for method in operations)
    return []


def make_app(settings: Settings) -> ASGIApp:
    """API and pages behind the guard. One to a process: NiceGUI keeps its pages globally.

    Args:
        settings: Where and how much.
    """
    from metropilot.web.pages import install

    service = Service(settings)
    app = make_api(service)
    install(app, service)
    return Guard(app, settings)


def serve(settings: Settings) -> None:
    """Run the server until it is interrupted.

    Args:
        settings: Where and how much.
    """
    import uvicorn

    uvicorn.run(
        make_app(settings),
        host=settings.host,
        port=settings.port,
        log_level="warning",
        server_header=False,
        timeout_graceful_shutdown=2,
        lifespan="on",
    )

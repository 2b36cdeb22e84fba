"""Application of API and pages, and the server that runs it."""

from __future__ import annotations

import asyncio
import logging
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI
from starlette.exceptions import HTTPException
from starlette.types import ASGIApp

import metropilot
from metropilot.web import errors
from metropilot.web.api import campaigns, catalogue, docs, fits, jobs, live, planning, projects
from metropilot.web.errors import Refused
from metropilot.web.schemas.responses import Health, UserOut
from metropilot.web.security import Guard
from metropilot.web.service import Service
from metropilot.web.settings import Settings
from metropilot.web.users import present_user

METHODS = ("GET", "HEAD", "OPTIONS", "POST", "PUT", "PATCH", "DELETE", "TRACE")
SUMMARY = """Drive, compare, plan and learn over HTTP. SI units, in the names of the fields.

Every error is `{"error": {"message", "file", "field", "value", "unit", "allowed"}}`."""


def make_api(service: Service) -> FastAPI:
    """Make the API without pages, described at ``/api/openapi.json`` and, to be read, at ``/api/docs``.

    The service opens and closes with it.

    Args:
        service: The service that the routes call.
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
        """State of the server."""
        lives = sum(session.known.status == "running" for session in service.sessions.values())
        return {
            "version": metropilot.__version__,
            "jobs_running": service.store.count_waiting(),
            "live_runs": lives,
            "live_runs_waiting": len(service.queue),
        }

    @app.get("/api/user", response_model=UserOut, tags=["server"])
    def user() -> dict[str, object]:
        """User of this request, with what it has under way and keeps, and how much of it is allowed."""
        found, bounds = present_user(), service.settings
        told: dict[str, object] = {"name": found.name, "role": found.role}
        if found.name is None:
            return told
        told |= {"jobs": service.store.count_of(found.name), "jobs_most": bounds.user_jobs}
        return told | {"bytes_kept": service.kept_bytes(found.name), "bytes_most": bounds.user_bytes}

    for module in (catalogue, planning, jobs, fits, campaigns, projects, live):
        app.include_router(module.routes(service), prefix="/api")

    app.include_router(docs.routes(app), prefix="/api")

    @app.api_route("/api/{rest:path}", methods=list(METHODS), include_in_schema=False)
    def nowhere(rest: str) -> None:
        """Refuse an unknown path (404) or a method that a route does not have (405)."""
        path = f"/api/{rest}"
        if known := _methods(app.openapi()["paths"], path):
            raise HTTPException(errors.METHOD_NOT_ALLOWED, headers={"Allow": ", ".join(known)})
        raise Refused("no such route", 404, field="path", value=path[:200])

    return app


def _methods(paths: dict[str, Any], path: str) -> list[str]:
    """Methods of a path; empty if it is no route."""
    for template, operations in paths.items():
        parts = (re.escape(part) for part in re.split(r"\{[^}]*\}", template))
        if re.fullmatch("[^/]+".join(parts), path):
            return sorted(method.upper() for method in operations)
    return []


def make_app(settings: Settings) -> ASGIApp:
    """Make the application with API and pages. One to a process: NiceGUI keeps its pages globally.

    Args:
        settings: Settings of the server.
    """
    from metropilot.web.pages import install

    service = Service(settings)
    app = make_api(service)
    install(app, service)
    return Guard(app, settings)


def is_news(record: logging.LogRecord) -> bool:
    """Tell whether a record of the log is more than that an open page, or a second Ctrl-C, ended a task."""
    if record.exc_info and isinstance(record.exc_info[1], asyncio.CancelledError):
        return False
    # uvicorn has the traceback of its own task in the text
    return not record.getMessage().rstrip().endswith("CancelledError")


def serve(settings: Settings) -> None:
    """Run the server until it is interrupted.

    Args:
        settings: Settings of the server.
    """
    import uvicorn

    logging.getLogger("uvicorn.error").addFilter(is_news)
    uvicorn.run(
        make_app(settings),
        host=settings.host,
        port=settings.port,
        log_level="warning",
        server_header=False,
        timeout_graceful_shutdown=2,
        lifespan="on",
        # else the address of a proxy, by which its headers are trusted, would be replaced by what they say
        proxy_headers=False,
    )

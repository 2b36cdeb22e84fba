"""Pages of the console."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI, Request, Response

from metropilot.web.service import Service
from metropilot.web.words.language import _

FAVICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32">'
    '<rect width="32" height="32" rx="7" fill="#16324a"/>'
    '<path d="M3 25 C9 25 9 8 15 8 S22 25 29 25" fill="none" stroke="#56b4e9" stroke-width="4"/></svg>'
)


NOT_FOUND = 404


async def say_missing(request: Request, error: Exception) -> Response:
    """Answer for an address without a page."""
    del error
    from nicegui import Client, ui

    from metropilot.web.pages.frame import frame

    with Client(ui.page("", title="metropilot"), request=request) as client:
        with frame(request, ""), ui.element("div").classes("mp-col mp-wide"):
            ui.label(_("There is no such page.")).classes("mp-card").props('data-test="missing"')
        return client.build_response(request, NOT_FOUND)


def install(app: FastAPI, service: Service) -> None:
    """Add the pages to an application.

    Args:
        app: The API.
        service: The service that API and pages call.
    """
    from nicegui import app as pages
    from nicegui import ui

    from metropilot.web.pages import (
        campaigns,
        compare,
        convoy,
        drive,
        edit,
        fit,
        journey,
        learn,
        lines,
        operation,
        runs,
    )

    pages.add_static_files("/static", Path(__file__).parent.parent / "static", max_cache_age=300)
    for module in (drive, compare, journey, operation, convoy, learn, lines, edit, fit, runs, campaigns):
        module.install(service)
    pages.exception_handler(NOT_FOUND)(say_missing)
    # A bar of Quasar's over every request of a page is no news to a reader of the screen.
    pages.config.quasar_config["loadingBar"] = {"skipHijack": True}
    ui.run_with(
        app,
        title="metropilot",
        favicon=FAVICON,
        language="en-US",
        reconnect_timeout=30.0,
        show_welcome_message=False,
    )

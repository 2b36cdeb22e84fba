"""Web console and HTTP API in one process; loads nothing from a network. Needs the extra ``web``."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metropilot._lazy import lazy_door

if TYPE_CHECKING:
    from metropilot.web.errors import install
    from metropilot.web.schemas.requests import DriveIn, request_of
    from metropilot.web.server import make_api, make_app, serve
    from metropilot.web.settings import Settings, data_folder

__all__ = ["DriveIn", "Settings", "data_folder", "install", "make_api", "make_app", "request_of", "serve"]

__getattr__, __dir__ = lazy_door(
    __name__,
    {
        "errors": ("install",),
        "schemas.requests": (
            "DriveIn",
            "request_of",
        ),
        "server": (
            "make_api",
            "make_app",
            "serve",
        ),
        "settings": (
            "Settings",
            "data_folder",
        ),
    },
)

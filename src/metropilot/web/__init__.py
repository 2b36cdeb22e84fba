"""Web console and HTTP API in one process; loads nothing from a network. Needs the extra ``web``."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from metropilot.web.server import make_api, make_app, serve
    from metropilot.web.settings import Settings

__all__ = ["Settings", "make_api", "make_app", "serve"]

_HOME = {"Settings": "settings", "make_api": "server", "make_app": "server", "serve": "server"}


def __getattr__(name: str) -> Any:  # noqa: ANN401 (whatever the name stands for)
    """Import a name from its private file on first use (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)

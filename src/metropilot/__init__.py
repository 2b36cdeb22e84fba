"""Metropilot: compute, learn, compare and explain how a metro train should be driven.

The root is a lazy door. ``import metropilot`` loads nothing but this file; a package such as
``metropilot.railway`` is imported when it is first named, so that neither ``metropilot --help`` nor
work on lines and trainsets ever waits for JAX.
"""

from importlib import import_module
from types import ModuleType

__version__ = "0.1.0"

__all__ = ["__version__"]

_PACKAGES = (
    "errors",
    "railway",
    "physics",
    "protection",
    "planning",
    "task",
    "drivers",
    "learn",
    "evaluate",
    "studies",
    "cli",
    "web",
)


def __getattr__(name: str) -> ModuleType:
    """Import one of the packages on first use (PEP 562)."""
    if name in _PACKAGES:
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names, the lazy packages included."""
    return sorted({*__all__, *_PACKAGES})

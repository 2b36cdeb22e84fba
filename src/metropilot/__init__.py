"""Metropilot: compute, learn, compare and explain how a metro train should be driven.

The root is a lazy door. ``import metropilot`` loads nothing but this file; a package such as
``metropilot.railway`` is imported when it is first named, so that neither ``metropilot --help`` nor
work on lines and trainsets ever waits for JAX.
"""

from types import ModuleType

__version__ = "0.1.0"

__all__ = ["__version__"]


def __getattr__(name: str) -> ModuleType:
    """Import one of the packages on first use (PEP 562)."""
    from importlib import import_module
    from importlib.util import find_spec

    if not name.startswith("_") and find_spec(f"{__name__}.{name}") is not None:
        return import_module(f"{__name__}.{name}")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names: the version and the packages and modules that can be named."""
    from pkgutil import iter_modules

    modules = (module.name for module in iter_modules(__path__))
    return sorted({*__all__, *(name for name in modules if not name.startswith("_"))})

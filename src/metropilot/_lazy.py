"""Lazy doors: the public names of a package, each imported when it is first used (PEP 562)."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any


def lazy_door(
    package: str, homes: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Make ``__getattr__`` and ``__dir__`` of a package that imports its public names on first use.

    An ``__init__`` calls it once, beside a literal ``__all__`` and an ``if TYPE_CHECKING:`` block that
    imports the same names for type checkers; ``tests/test_doors.py`` compares the three::

        __getattr__, __dir__ = lazy_door(__name__, {"file": ("load_policy", "save_policy")})

    Args:
        package: ``__name__`` of the package.
        homes: Public names by the module of the package that defines them. None may be a module's own name:
            once that module is imported, the package's attribute is the module.
    """
    home = {name: module for module, names in homes.items() for name in names}

    def get(name: str) -> Any:  # noqa: ANN401 (whatever the name stands for)
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{home[name]}"), name)
        # From now on the name is an ordinary attribute and costs nothing more.
        setattr(sys.modules[package], name, value)
        return value

    def names() -> list[str]:
        return sorted(home)

    return get, names

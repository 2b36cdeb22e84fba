"""Registries: what can be listed of an object before the module that holds it is imported."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from typing import Any, Generic, TypeVar, cast

from metropilot.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class RegistryRow:
    """One row of a registry.

    Attributes:
        target: The object itself, or where it is: ``module:name``, imported when it is asked for.
        summary: One line for listings.
        source: Paper or "own"; empty where a listing has no such column.
    """

    target: Any
    summary: str
    source: str = ""


class Registry(Generic[T]):
    """Objects by id, each imported when it is first asked for.

    Args:
        kind: Kind of the objects, in a word for messages.
        rows: Its rows by id.
        field: Option or field that names an id, for messages; by default the kind.
    """

    def __init__(self, kind: str, rows: Mapping[str, RegistryRow] | None = None, field: str = "") -> None:
        self.kind, self.field = kind, field or kind
        self._rows = dict(rows or {})

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)

    def __contains__(self, name: object) -> bool:
        return name in self._rows

    def ids(self) -> tuple[str, ...]:
        """All ids: those of the package first, then those that were registered."""
        return tuple(self._rows)

    def rows(self) -> Mapping[str, RegistryRow]:
        """Every row by id; importing nothing."""
        return dict(self._rows)

    def row(self, name: str) -> RegistryRow:
        """The row of an id; importing nothing.

        Raises:
            InputError: No such id (the nearest is named).
        """
        if name not in self._rows:
            words = f"unknown {self.kind}{did_you_mean(name, self)}"
            raise InputError(words, field=self.field, value=name, allowed=", ".join(self))
        return self._rows[name]

    def get(self, name: str) -> T:
        """The object of an id.

        Raises:
            InputError: No such id (the nearest is named).
        """
        target = self.row(name).target
        if not isinstance(target, str):
            return cast("T", target)
        module, _, attribute = target.partition(":")
        return cast("T", getattr(import_module(module), attribute))

    def make(self, name: str, **options: object) -> Any:  # noqa: ANN401 (what the object makes)
        """Make an object of an id with options: a driver of its class.

        Raises:
            InputError: No such id (the nearest is named).
        """
        return cast("Any", self.get(name))(**options)

    def add(self, rows: Mapping[str, RegistryRow]) -> None:
        """Add rows; a row that is there already stays."""
        self._rows = {**rows, **self._rows}

    def register(self, kind: type[Any]) -> None:
        """Add a class by its own ``id``, ``summary`` and ``source``, instead of any of the same id."""
        self._rows[kind.id] = RegistryRow(kind, kind.summary, kind.source)


def did_you_mean(name: str, names: Any) -> str:  # noqa: ANN401 (any iterable of names)
    """``, did you mean X?`` where a name is near enough to X, else nothing."""
    near = get_close_matches(name, list(names), 1)
    return f", did you mean {near[0]}?" if near else ""

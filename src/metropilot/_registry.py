"""Registries: what can be listed of an object before the module that holds it is imported."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast

from metropilot.errors import InputError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

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
        group: Group of the entry points by which installed packages add objects; empty: none do. They are
            imported when all ids are listed, or when an id is asked for that is not one of the package.
    """

    def __init__(
        self, kind: str, rows: Mapping[str, RegistryRow] | None = None, field: str = "", group: str = ""
    ) -> None:
        self.kind, self.field, self.group = kind, field or kind, group
        self._rows = dict(rows or {})

    def __iter__(self) -> Iterator[str]:
        return iter(self.rows())

    def __len__(self) -> int:
        return len(self.rows())

    def __contains__(self, name: object) -> bool:
        # also a name whose package cannot be used: whoever asks for its row is told why
        return name in self._rows or name in self._installed_rows

    def ids(self) -> tuple[str, ...]:
        """All ids: those of the package first, then those that were registered or installed."""
        return tuple(self.rows())

    def rows(self) -> Mapping[str, RegistryRow]:
        """Every row by id; of the package's own nothing is imported."""
        more = {name: row for name, row in self._installed_rows.items() if name not in self._rows}
        return self._rows | {name: row for name, row in more.items() if isinstance(row, RegistryRow)}

    def row(self, name: str) -> RegistryRow:
        """The row of an id.

        Raises:
            InputError: No such id (the nearest is named), or its package cannot be used.
        """
        row = self._rows.get(name) or self._installed_rows.get(name)
        if isinstance(row, str):
            raise InputError(
                f"the {self.kind} of an installed package cannot be used ({row})",
                field=self.field,
                value=name,
            )
        if row is None:
            words = f"unknown {self.kind}{did_you_mean(name, self)}"
            raise InputError(words, field=self.field, value=name, allowed=", ".join(self))
        return row

    @cached_property
    def _installed_rows(self) -> Mapping[str, RegistryRow | str]:
        """Rows that installed packages add, by id; the reason instead of a row that cannot be used."""
        if not self.group:
            return {}
        # the import takes a tenth of a second, and most commands ask for nothing that is not shipped
        from importlib.metadata import entry_points

        return {point.name: _installed_row(point) for point in entry_points(group=self.group)}

    def get(self, name: str) -> T:
        """The object of an id.

        Raises:
            InputError: No such id (the nearest is named), or its package cannot be used.
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
        """Add a class by its own ``id``, ``summary`` and ``source``, instead of any of the same id.

        Without a summary of its own the first line of its docstring stands for it.
        """
        self._rows[kind.id] = _row_of(kind)


def _row_of(target: Any, source: str = "") -> RegistryRow:  # noqa: ANN401 (of any type)
    """Row of an object that describes itself, or has a docstring."""
    said = getattr(target, "summary", "") or getattr(target, "title", "")
    docs = (target.__doc__ or "").partition("\n")[0].rstrip(".")
    return RegistryRow(target, said or docs, getattr(target, "source", "") or source)


def _installed_row(point: EntryPoint) -> RegistryRow | str:
    """Row of an entry point, or why it has none."""
    try:
        target = point.load()
    except Exception as error:  # noqa: BLE001 (code of others may raise anything)
        return f"{point.value}: {type(error).__name__}: {error}".splitlines()[0]
    own = getattr(target, "id", point.name)
    if own != point.name:
        return f"{point.value} has the id {own}"
    return _row_of(target, point.dist.name if point.dist else "")


def did_you_mean(name: str, names: Any) -> str:  # noqa: ANN401 (any iterable of names)
    """``, did you mean X?`` where a name is near enough to X, else nothing."""
    near = get_close_matches(name, list(names), 1)
    return f", did you mean {near[0]}?" if near else ""

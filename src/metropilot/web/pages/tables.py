"""Tables that are sorted by their headings, searched and filtered."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nicegui import ui

from metropilot.web.pages.frame import prop_of, set_quietly
from metropilot.web.words.language import _
from metropilot.web.words.said import retell

CELLS = Path(__file__).parent.parent / "static" / "datatable.js"


class CellTable(ui.table, component=CELLS):
    """Table whose cells stay what they are, with their focus, when rows change."""


@dataclass(frozen=True)
class DataColumn:
    """A column of a table.

    Attributes:
        name: Key of its values in the rows.
        label: Heading.
        digits: Decimals of its numbers; None: text.
        kind: ``link`` (to the row's ``link``), ``styled`` (with the class of the row's ``style``), or plain.
        wide: Left out on a telephone.
        filtered: A list above the table chooses one of its values.
        said: Its values are words of the library, which are translated when shown.
    """

    name: str
    label: str
    digits: int | None = None
    kind: str = ""
    wide: bool = False
    filtered: bool = False
    said: bool = False

    def as_dict(self) -> dict[str, Any]:
        """DataColumn as Quasar has it."""
        narrow = "gt-xs" if self.wide else ""
        found = {
            "name": self.name,
            "label": _(self.label),
            "field": self.name,
            "sortable": True,
            "align": "left" if self.digits is None else "right",
            "classes": narrow,
            "headerClasses": narrow,
            "kind": self.kind,
        }
        return found if self.digits is None else found | {"digits": self.digits}


class DataTable:
    """Table of many rows with a search field, and a list for each column that is filtered.

    Args:
        name: Name of the table for a screen reader.
        columns: Its columns.
        sort: DataColumn by which it is sorted first; with a minus before it largest first.
        actions: Buttons of a row by name, with what they call with the row's ``id``; a row names those that
            it has in ``actions``.
        selected: Called when rows are chosen; None: none can be.
        changed: Called when another value is chosen in a list above the table.
    """

    def __init__(
        self,
        name: str,
        columns: Sequence[DataColumn],
        *,
        sort: str = "",
        actions: dict[str, Callable[[str], Any]] | None = None,
        selected: Callable[[], Any] | None = None,
        changed: Callable[[], Any] | None = None,
    ) -> None:
        self.name, self.columns, self.sort = name, tuple(columns), sort
        self.actions, self.selected, self.changed = actions or {}, selected, changed
        self.rows: list[dict[str, Any]] = []
        self.filling = False

    def build(self) -> None:
        """Place search field, filters and table."""
        with ui.element("div").classes("mp-row items-center"):
            self.search = ui.input(_("Find")).props("outlined dense clearable debounce=150")
            self.search.props(prop_of("aria-label", _("Find in {name}", name=self.name)))
            self.filters = {
                column.name: ui.select({"": _("all")}, value="", label=_(column.label), on_change=self.filter)
                for column in self.columns
                if column.filtered
            }
            for each in self.filters.values():
                each.props("outlined dense options-dense").classes("mp-filter")
        columns = [column.as_dict() for column in self.columns]
        if self.actions:
            last = {"name": "actions", "label": _("Actions"), "field": "words", "align": "left"}
            columns.append(last | {"kind": "actions", "labels": {name: _(name) for name in self.actions}})
        self.table = CellTable(
            rows=[],
            columns=columns,
            row_key="id",
            selection="multiple" if self.selected else None,
            on_select=self.selected and (lambda _: self.selected and self.selected()),
            pagination={
                "rowsPerPage": 0,
                "sortBy": self.sort.lstrip("-"),
                "descending": self.sort[:1] == "-",
            },
        )
        self.table.props("dense flat hide-pagination wrap-cells").props(prop_of("aria-label", self.name))
        self.table.classes("mp-data").bind_filter_from(self.search, "value", lambda text: text or "")
        self.table.on("act", lambda event: self.actions[event.args["name"]](event.args["id"]))

    def fill(self, rows: list[dict[str, Any]]) -> None:
        """Show rows; those chosen stay so while they are there."""
        if rows == self.rows:
            return
        self.rows = rows
        with set_quietly(self):
            for name, field in self.filters.items():
                values = sorted({str(row[name]) for row in rows if row[name] is not None})
                field.set_options({"": _("all"), **{value: retell(value) for value in values}})
                if field.value not in field.options:
                    field.value = ""
        self.show()

    def restore(self, search: str, wanted: dict[str, str]) -> None:
        """Fill in the search field, and the lists whose columns are named."""
        self.search.value = search
        with set_quietly(self):
            for name, field in self.filters.items():
                if wanted.get(name) in field.options:
                    field.value = wanted[name]
        self.show()

    def filter(self) -> Any:  # noqa: ANN401 (a page's answer)
        """Show the rows that the filters let through, and tell the page."""
        if self.filling:
            return None
        self.show()
        return None if self.changed is None else self.changed()

    def show(self) -> None:
        """Show the rows that the filters let through."""
        wanted = {name: field.value for name, field in self.filters.items() if field.value}
        shown = [row for row in self.rows if all(str(row[name]) == value for name, value in wanted.items())]
        kept = {row["id"] for row in self.table.selected}
        said = [column.name for column in self.columns if column.said]
        shown = [row | {name: retell(row[name] or "") for name in said} for row in shown]
        self.table.rows = shown
        self.table.selected = [row for row in shown if row["id"] in kept]
        self.table.update()

    @property
    def chosen(self) -> list[str]:
        """Ids of the rows that are chosen, in the order in which they were."""
        return [row["id"] for row in self.table.selected]

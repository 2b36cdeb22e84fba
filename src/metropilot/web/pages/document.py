"""Form of a TOML document of a line or trainset: a field for each value, an editable table for its rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

from nicegui import events, ui

from metropilot.errors import InputError, MetropilotError
from metropilot.web.pages.frame import Problem, allowed_words, card, prop_of
from metropilot.web.pages.numbers import parse_number, split_list
from metropilot.web.words.language import ENGLISH, N_, _, present_language
from metropilot.web.words.said import retell

HEADER = ("name", "id")
NAMES = {
    name: message
    for message in (
        N_("Line"),
        N_("Trainset"),
        N_("Stations"),
        N_("Speed limits"),
        N_("Gradients"),
        N_("Curves"),
        N_("Tunnel"),
        N_("Timetable"),
        N_("Movement authority"),
        N_("Mass"),
        N_("Length"),
        N_("Resistance"),
        N_("Traction"),
        N_("Electric brake"),
        N_("Friction brake"),
        N_("Limits"),
        N_("Energy"),
        N_("Actuation"),
        N_("Notches"),
        N_("Code"),
        N_("Name"),
        N_("Position"),
        N_("Pinyin"),
        N_("Local name"),
        N_("From"),
        N_("Start"),
        N_("End"),
        N_("Gradient"),
        N_("Radius"),
        N_("Cross section"),
        N_("Speed"),
        N_("Force"),
        N_("Load"),
        N_("Constant"),
        N_("Linear"),
        N_("Quadratic"),
        N_("Cubic"),
        N_("Power"),
        N_("Cap"),
        N_("Forward"),
        N_("Backward"),
        N_("Dwell"),
        N_("Distance"),
        N_("Release speed"),
        N_("Rotating fraction"),
        N_("Service deceleration"),
        N_("Max speed"),
        N_("Max acceleration"),
        N_("Max deceleration"),
        N_("Adhesion"),
        N_("Braking"),
        N_("Receptivity"),
        N_("Auxiliary"),
        N_("Delay"),
        N_("Lag"),
        N_("Jerk limit"),
        N_("Vehicles"),
        N_("Table"),
        N_("Pieces"),
        N_("List"),
        N_("Davis"),
        N_("Loads"),
        N_("Source"),
        N_("Altitude"),
        N_("Body"),
        N_("Buildup"),
        N_("Couplers"),
        N_("Curve formula"),
        N_("Damping"),
        N_("Emergency deceleration"),
        N_("Emergency jerk"),
        N_("Gravity"),
        N_("Levels"),
        N_("Protection"),
        N_("Reaction"),
        N_("Stiffness"),
        N_("Values"),
    )
    for name in (message.lower().replace(" ", "_"),)
}
"""Blocks, fields and columns of a document in words; another one is shown as its file has it."""
OPTIONAL: dict[str, dict[str, dict[str, str]]] = {
    "line": {
        "timetable": {"forward": "s", "backward": "s", "dwell": "s"},
        "movement_authority": {"distance": "m", "release_speed": "km/h"},
    },
    "trainset": {
        "mass": {"rotating_fraction": "%"},
        "limits": {
            "service_deceleration": "m/s^2",
            "max_acceleration": "m/s^2",
            "max_deceleration": "m/s^2",
            "adhesion": "1",
        },
        "energy": {"traction": "1", "braking": "1", "receptivity": "1", "auxiliary": "kW"},
        "actuation": {"delay": "s", "lag": "s", "jerk_limit": "m/s^3"},
    },
}
"""Fields that a file may leave out, with the unit in which one that is filled in is written."""
STATION = ("code", "name", "position", "pinyin", "local_name")
PIECE = ("from", "constant", "linear", "quadratic", "cubic", "power", "cap")
UNITS_OF = {"mass": "loads", "from": "speed", "constant": "force", "cap": "force"}
"""Key of the units table under which the unit of a column stands, where it is not its own name."""
TEXTS = ("code", "name", "pinyin", "local_name", "load")
"""Columns of texts, which may look like numbers."""
UNITLESS = ("code", "name", "pinyin", "local_name", "load", "linear", "quadratic", "cubic", "vehicles")


TYPED = "(e) => emit(e.target.value)"
PASTED = """(e) => { const text = e.clipboardData.getData('text/plain');
    if (/[\\t\\n]/.test(text)) { e.preventDefault(); emit(text); } }"""
MARKED = frozenset(".,，．。eE")
"""Marks of a number that is written as one with decimals."""
LONGEST_PASTE = 2000
"""Rows of a paste that are taken."""


class FieldGrid(NamedTuple):
    """Rows of a table of a document.

    Attributes:
        columns: Names of its columns.
        rows: Values; None where a cell is empty.
        put: Function that turns rows into the value of the document.
    """

    columns: tuple[str, ...]
    rows: list[list[Any]]
    put: Callable[[list[list[Any]]], Any]


def show_name(key: str, other: str | None = None) -> str:
    """Name of a block, field or column in words.

    Args:
        key: Name in the file.
        other: Words in English, where they are not the name with a capital.
    """
    if other is not None and present_language() == ENGLISH:
        return other
    found = NAMES.get(key)
    return key.replace("_", " ").capitalize() if found is None else _(found)


def parse(text: str) -> Any:  # noqa: ANN401 (a value of TOML)
    """Value of a cell or field: a number where it reads as one, else text; None if it is empty."""
    text = text.strip()
    try:
        found = parse_number(text)
    except InputError:
        return text  # the loader says what is wrong with it, and where
    return found if found is None or not found.is_integer() or set(text) & MARKED else int(found)


def format_value(value: object) -> str:
    """Text of a value in a field."""
    if value is None:
        return ""
    if isinstance(value, list):
        return ", ".join(map(format_value, value))
    return f"{value:.15g}" if isinstance(value, float) else str(value)


def grid_of(block: str, key: str, value: object, units: Mapping[str, Any]) -> FieldGrid | None:
    """The table of a value of a document; None if it is none."""
    if key == "loads" and isinstance(value, Mapping):
        return FieldGrid(("load", "mass"), [list(item) for item in value.items()], _loads)
    if not isinstance(value, list) or not value:
        return None
    if key == "list" and all(isinstance(row, Mapping) for row in value):
        return FieldGrid(STATION, [[row.get(name) for name in STATION] for row in value], _stations)
    if key == "pieces" and all(isinstance(row, Mapping) for row in value):
        return FieldGrid(PIECE, [_piece_row(row) for row in value], _pieces)
    if not all(isinstance(row, list) for row in value):
        return None
    width = max(map(len, value))
    names = ("speed", "force") if key == "table" else tuple(units)
    if key == "tunnel":
        names = ("cross_section", "tunnel")
    if len(names) != width:
        names = (
            ("from", "start", "end")[:width] if block == "curves" else tuple(f"{k + 1}" for k in range(width))
        )
    return FieldGrid(names, [[*row, *[None] * (width - len(row))] for row in value], _rows)


def _rows(rows: list[list[Any]]) -> list[list[Any]]:
    return [[cell for cell in row if cell is not None] for row in rows]


def _loads(rows: list[list[Any]]) -> dict[str, Any]:
    # a load without a mass stays, so that its field is named where it is checked
    return {format_value(name): "" if mass is None else mass for name, mass in rows if name is not None}


def _stations(rows: list[list[Any]]) -> list[dict[str, Any]]:
    texts = {name for name in STATION if name != "position"}
    return [
        {
            name: format_value(cell) if name in texts else cell
            for name, cell in zip(STATION, row, strict=True)
            if cell is not None
        }
        for row in rows
    ]


def _piece_row(row: Mapping[str, Any]) -> list[Any]:
    terms = [*row.get("polynomial", ()), None, None, None, None][:4]
    return [row.get("from"), *terms, row.get("power"), row.get("cap")]


def _pieces(rows: list[list[Any]]) -> list[dict[str, Any]]:
    made = []
    for begin, *terms, power, cap in rows:
        while terms and terms[-1] is None:
            terms.pop()
        piece = {"from": begin, "power": power, "cap": cap}
        piece["polynomial"] = [0 if term is None else term for term in terms] or None
        made.append({name: value for name, value in piece.items() if value is not None})
    return made


class RowTable:
    """Editable table of rows: a cell is typed, rows are added and removed, a paste fills cells and adds rows.

    Args:
        path: Path of the table in the document.
        grid: Its rows, changed in place.
        labels: Headings of its columns.
        edit: Called with each change, which it makes.
    """

    def __init__(
        self, path: str, grid: FieldGrid, labels: Sequence[str], edit: Callable[[Callable[[], object]], None]
    ) -> None:
        self.path, self.grid, self.labels, self.edit = path, grid, labels, edit
        block, _dot, key = path.partition(".")
        self.title = path if present_language() == ENGLISH else f"{show_name(block)} · {show_name(key)}"

    def build(self) -> None:
        """Place the table."""
        self.place = ui.element("div").classes("mp-scroll mp-gridbox")
        self.fill()

    def fill(self) -> None:
        """Place heading and rows anew."""
        self.place.clear()
        with self.place, ui.element("table").classes("mp-grid").props(prop_of("aria-label", self.title)):
            with ui.element("thead"), ui.element("tr"):
                for label in self.labels:
                    with ui.element("th"):
                        ui.label(label)
                ui.element("td")
            with ui.element("tbody"):
                for k, row in enumerate(self.grid.rows):
                    self.row(k, row)

    def row(self, k: int, row: list[Any]) -> None:
        """Place a row with the buttons beside it."""
        with ui.element("tr"):
            for j, cell in enumerate(row):
                with ui.element("td"):
                    made = ui.element("input")
                    # "value" would be set anew whenever anything on the page changes, over what is typed
                    made.props["defaultValue"] = format_value(cell)
                    made.props["aria-label"] = _(
                        "{table} row {number} {column}",
                        table=self.title,
                        number=k + 1,
                        column=show_name(self.grid.columns[j], self.grid.columns[j]),
                    )
                    made.on("input", partial(self.type, k, j), js_handler=TYPED, throttle=0.15)
                    made.on("paste", partial(self.paste, k, j), js_handler=PASTED)
            with ui.element("td").classes("mp-grid-do"):
                more = ui.button(icon="add", on_click=partial(self.add, k)).props("flat dense round size=xs")
                words = _("Add a row after row {number} of {table}", number=k + 1, table=self.title)
                more.props(prop_of("aria-label", words))
                less = ui.button(icon="remove", on_click=partial(self.remove, k)).props("flat dense round")
                words = _("Remove row {number} of {table}", number=k + 1, table=self.title)
                less.props("size=xs").props(prop_of("aria-label", words))
                less.set_enabled(len(self.grid.rows) > 1)

    def type(self, k: int, j: int, event: events.GenericEventArguments) -> None:
        """Take what stands in a cell."""
        self.edit(lambda: self.grid.rows[k].__setitem__(j, self.value(j, str(event.args))))

    def value(self, j: int, text: str) -> Any:  # noqa: ANN401 (a value of TOML)
        """Value of a cell of a column; None if it is empty."""
        return text.strip() or None if self.grid.columns[j] in TEXTS else parse(text)

    def add(self, k: int) -> None:
        """Add a copy of a row after it."""
        self.edit(lambda: self.grid.rows.insert(k + 1, list(self.grid.rows[k])))
        self.fill()

    def remove(self, k: int) -> None:
        """Remove a row."""
        self.edit(lambda: self.grid.rows.pop(k))
        self.fill()

    def paste(self, k: int, j: int, event: events.GenericEventArguments) -> None:
        """Put the cells of a spreadsheet from a cell on; rows that are missing are added."""
        width, rows = len(self.grid.columns), self.grid.rows
        cells = [line.split("\t") for line in str(event.args).rstrip("\r\n").splitlines()]

        def act() -> None:
            for down, line in enumerate(cells[:LONGEST_PASTE]):
                if k + down == len(rows):
                    rows.append([None] * width)
                for right, cell in enumerate(line[: width - j]):
                    rows[k + down][j + right] = self.value(j + right, cell)

        self.edit(act)
        self.fill()


class DocumentForm:
    """Form of a document.

    Args:
        kind: Line or trainset.
        document: The document; edited in place.
        edit: Called with each change, which it makes.

    Attributes:
        problem: Place of errors.
        tables: Place of the errors of each table.
    """

    problem: Problem

    def __init__(
        self, kind: str, document: dict[str, Any], edit: Callable[[Callable[[], None]], None]
    ) -> None:
        self.kind, self.document, self.edit = kind, document, edit
        self.tables: dict[str, ui.label] = {}

    def build(self) -> None:
        """Place a card for the header and each block."""
        self.tables = {}
        with card(show_name(self.kind)):
            self.problem = Problem()
            for name in HEADER:
                self.field(self.document, name, name, _("Name") if name == "name" else _("Id in results"))
        optional = OPTIONAL.get(self.kind, {})
        blocks = [name for name, block in self.document.items() if isinstance(block, dict)]
        for name in [*blocks, *(name for name in optional if name not in blocks)]:
            if name != "sources":
                self.block(name, optional.get(name, {}))

    def block(self, name: str, optional: Mapping[str, str]) -> None:
        """Place a block: its fields in rows, its tables below."""
        block = self.document.get(name, {})
        with card(show_name(name)):
            keys = [key for key in block if key not in {"unit", "units", "source"}]
            tables, fields = [], []
            for key in [*keys, *(key for key in optional if key not in keys)]:
                grid = grid_of(name, key, block.get(key), block.get("units", {}))
                (tables if grid else fields).append((key, grid))
            with ui.element("div").classes("mp-fields"):
                for key, _grid in fields:
                    value = block.get(key)
                    if isinstance(value, dict):
                        ui.label(_("{key}: a table, kept as it is", key=show_name(key, key))).classes(
                            "mp-soft"
                        )
                        continue
                    unit = block.get("units", {}).get(key, optional[key]) if key in optional else ""
                    label = self.label({} if isinstance(value, str) else block, key, unit)
                    self.field(block, key, f"{name}.{key}", label, name, unit)
            for key, grid in tables:
                if grid:
                    self.table(block, key, f"{name}.{key}", grid)
            if name in self.document:
                self.field(block, "source", f"{name}.source", _("Source"))

    @staticmethod
    def label(block: Mapping[str, Any], key: str, unit: str = "") -> str:
        """Label of a field or column, with its unit in the file."""
        units = block.get("units", {})
        named = units.get(key) or units.get(UNITS_OF.get(key, "")) or block.get("unit") or unit
        words = show_name(key)
        return words if key in UNITLESS or not named or named == "1" else f"{words} ({named})"

    def field(
        self, block: dict[str, Any], key: str, path: str, label: str, name: str = "", unit: str = ""
    ) -> None:
        """Place a field of one value, or of numbers separated by commas."""
        was_list, text = isinstance(block.get(key), list), isinstance(block.get(key), str)
        text = text or key in {"name", "id", "source"}
        was_list = was_list or name == "timetable"

        def change(event: events.ValueChangeEventArguments) -> None:
            def act() -> None:
                given = str(event.value or "")
                into = self.document.setdefault(name, {}) if name else block
                if not given.strip():
                    into.pop(key, None)
                    if unit:
                        into.get("units", {}).pop(key, None)
                    if name and not into.keys() - {"unit", "units", "source"}:
                        del self.document[name]
                    return
                if was_list:
                    into[key] = [parse(part) for part in split_list(given)]
                else:
                    into[key] = given if text else parse(given)
                if unit and "unit" not in into:
                    into.setdefault("units", {}).setdefault(key, unit)

            self.edit(act)

        # a field's own validation runs after the change and would remove the error that it finds
        field = ui.input(
            label, value=format_value(block.get(key)), on_change=change
        ).without_auto_validation()
        field.props(
            f'outlined dense debounce=150 data-field="{path}"' + (" autogrow" if key == "source" else "")
        )
        self.problem.beside(path, field)

    def table(self, block: dict[str, Any], key: str, path: str, grid: FieldGrid) -> None:
        """Place a table of rows and, above it, its errors."""

        def edit(act: Callable[[], object]) -> None:
            def both() -> None:
                act()
                block[key] = grid.put(grid.rows)
                if key == "pieces" and any("power" in piece for piece in block[key]):
                    block["units"].setdefault("power", "kW")

            self.edit(both)

        labels = [self.label(block, column) for column in grid.columns]
        self.tables[path] = ui.label("").classes("mp-error")
        RowTable(path, grid, labels, edit).build()

    def show(self, error: InputError | None) -> None:
        """Show an error beside its field or above its table, or none."""
        self.problem.clear()
        for label in self.tables.values():
            label.text = ""
        if error is None:
            return
        field = error.field or ""
        for path, label in self.tables.items():
            if field.startswith(path):
                label.text = describe(error)
                return
        self.problem.show(error)


def describe(error: MetropilotError) -> str:
    """One line about an error: field, value and what is allowed."""
    if not isinstance(error, InputError):
        return retell(str(error))
    value = "" if error.value is None else f": {error.value}" + (f" {error.unit}" if error.unit else "")
    where = f"{error.field}: " if error.field else ""
    return f"{where}{retell(error.message)}{value}{allowed_words(error.allowed)}"

"""Edit: a line or trainset as a form beside its drawing, saved version by version."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from functools import partial
from typing import Any, Literal

from fastapi import Request
from nicegui import events, ui

from metropilot.errors import InputError, MetropilotError
from metropilot.railway import Line, Trainset, parse_document, toml_text
from metropilot.web import catalogue
from metropilot.web.errors import Refused
from metropilot.web.pages import frame as parts
from metropilot.web.pages.document import DocumentForm, describe
from metropilot.web.pages.handles import line_handles, move_handle
from metropilot.web.pages.plots import blank, effort_figure, line_figure
from metropilot.web.pages.strip import line_strip
from metropilot.web.service import Service
from metropilot.web.words.language import _
from metropilot.web.words.tables import number
from metropilot.web.work.plans import effort_curves

LOOK_S = 1.5
"""Time between two looks for versions that others saved."""
KEPT = 200
"""Changes that can be undone."""
COPIED = "-copy"


class EditPage:
    """State of the page for one browser.

    Args:
        service: Service of the server.
        kind: Line or trainset.
        key: Id of the catalogue, which gives a copy, or of an upload.

    Attributes:
        document: The document as it stands in the form.
        version: Version of the upload that is edited; 0 of a copy that is not saved yet.
        saved: The document as it was saved last.
        undone: Earlier documents, and those that were undone.
        wrong: What the loader finds wrong with the document.
    """

    def __init__(self, service: Service, kind: Literal["line", "trainset"], key: str) -> None:
        self.service, self.key = service, key
        self.kind: Literal["line", "trainset"] = kind
        self.document = self.read(None)
        versions = service.store.versions(key)
        self.version = versions[0].number if versions else 0
        self.newest = self.version
        self.saved: dict[str, Any] | None = deepcopy(self.document)
        if not versions:
            self.saved = None
            self.document["id"] = f"{self.document['id']}{COPIED}"
            self.document["name"] = _("{name} (copy)", name=self.document["name"])
        self.undone: tuple[list[dict[str, Any]], list[dict[str, Any]]] = ([], [])
        self.wrong: InputError | None = None

    def read(self, version: int | None) -> dict[str, Any]:
        """Document of a version.

        Raises:
            Refused: No such entry or version.
        """
        return tomllib.loads(self.service.text(self.kind, self.key, version))

    def build(self) -> None:
        """Build the form on the left and the drawing on the right."""
        self.fields = ui.element("div").classes("mp-col")
        with ui.element("div").classes("mp-col mp-beside"):
            with parts.card():
                self.title = parts.heading("")
                with ui.element("div").classes("mp-row items-center"):
                    self.save_button = parts.ActionButton(_("Save"), on_click=self.save).props(
                        'unelevated data-test="save"'
                    )
                    self.undo_button = ui.button(_("Undo"), on_click=partial(self.step, 0)).props(
                        'outline data-test="undo"'
                    )
                    self.redo_button = ui.button(_("Redo"), on_click=partial(self.step, 1)).props(
                        'outline data-test="redo"'
                    )
                    parts.ActionButton(_("Save as a copy"), on_click=self.save_copy).props("flat no-caps")
                self.problem = parts.Problem()
                self.status = ui.label("").classes("mp-soft").props('aria-live=polite data-test="status"')
                self.meanwhile = (
                    ui.element("div").classes("mp-stack mp-notice").props('role=status data-test="meanwhile"')
                )
                self.meanwhile.set_visibility(False)
                self.uses = ui.element("div")
            with parts.card() as drawing:
                self.numbers = ui.element("div").classes("w-full")
                self.map = parts.strip(_("Line as drawn"))
                self.plot = parts.plot(blank(380)).props('data-test="drawing"')
                if self.kind == "line":
                    ends = f"'c{drawing.id}', {self.plot.id}"
                    self.plot.on("plotly_afterplot", js_handler=f"() => metropilotHandles({ends})")
                    drawing.on("mp-handle", self.drag, ["detail"])
                    words = _("Limits are dragged up and down and at their begin, stations along the line.")
                    ui.label(words).classes("mp-soft")
            with parts.card(_("Versions")):
                self.versions = ui.element("div").classes("mp-stack").props('data-test="versions"')
        self.fill()
        self.list_versions()
        ui.timer(LOOK_S, self.look)

    def fill(self) -> None:
        """Build the form of the document anew."""
        self.fields.clear()
        self.form = DocumentForm(self.kind, self.document, self.edit)
        with self.fields:
            self.form.build()
        self.check()

    def edit(self, act: Callable[[], None]) -> None:
        """Make a change that can be undone."""
        self.keep()
        act()
        self.check()

    def drag(self, event: events.GenericEventArguments) -> None:
        """Move a limit or station that is dragged in the drawing: one change from its take to its release."""
        told = event.args["detail"]
        if told["first"]:
            self.keep()
        with suppress(KeyError, TypeError, ValueError, InputError):
            move_handle(self.document, str(told["kind"]), int(told["row"]), float(told["value"]))
        if told["done"]:
            self.fill()
        else:
            self.check()

    def keep(self) -> None:
        """Keep the document for undoing."""
        back, forth = self.undone
        back.append(deepcopy(self.document))
        del back[:-KEPT]
        forth.clear()

    def step(self, way: int) -> None:
        """Undo (0) or redo (1) a change."""
        if self.undone[way]:
            self.undone[1 - way].append(self.document)
            self.document = self.undone[way].pop()
            self.fill()

    def check(self) -> None:
        """Check the document with its loader; draw it, or show what is wrong."""
        try:
            found = parse_document(toml_text(self.document), None)
            self.draw(found)
        except (MetropilotError, TypeError, ValueError) as error:
            self.wrong = error if isinstance(error, InputError) else InputError(str(error))
        else:
            self.wrong = None
        self.form.show(self.wrong)
        self.show_state()

    def draw(self, found: object) -> None:
        """Draw a line or trainset.

        Raises:
            InputError: Another kind of document.
        """
        if self.kind == "line" and isinstance(found, Line):
            values = catalogue.line_values(found, self.key)
            self.map.content = line_strip(values)
            handles: list[dict[str, Any]] = []
            with suppress(KeyError, TypeError, ValueError, InputError):  # another form of rows: typed only
                handles = line_handles(self.document, values["stops"][-1]["position_m"])
            self.plot.update_figure(line_figure(values, handles))
            items = [
                (_("stations"), str(values["stations"]), ""),
                (_("length"), number(values["length_m"] / 1000, 3, "km"), ""),
                (_("highest limit"), number(3.6 * max(values["limit_mps"]["value"]), 0, "km/h"), ""),
            ]
        elif self.kind == "trainset" and isinstance(found, Trainset):
            curves = effort_curves(found)
            self.plot.update_figure(effort_figure(curves))
            items = [
                (_("mass"), number(found.mass_kg / 1000, 1, "t"), ""),
                (_("starts with"), number(curves["acceleration_mps2"][0], 2, "m/s²"), ""),
                (_("brakes with"), number(curves["deceleration_mps2"][0], 2, "m/s²"), ""),
            ]
        else:
            raise InputError("another kind of document", field="kind", allowed=self.kind)
        self.numbers.clear()
        with self.numbers:
            parts.reads(items)

    @property
    def dirty(self) -> bool:
        """True if the document differs from the saved version."""
        return self.document != self.saved

    def show_state(self) -> None:
        """Update title, buttons and the words beside them."""
        name = _("a copy of {key}, not saved yet", key=self.key)
        if self.version:
            name = _("version {version}", version=self.version)
        self.title.text = f"{self.document.get('name', '')} · {name}"
        self.save_button.set_enabled(self.wrong is None and self.dirty)
        for button, kept in zip((self.undo_button, self.redo_button), self.undone, strict=True):
            button.set_enabled(bool(kept))
        words = _("not saved") if self.dirty else _("saved as version {version}", version=self.version)
        self.status.text = words if self.wrong is None else f"{words}. {describe(self.wrong)}"
        ui.run_javascript(
            f"window.onbeforeunload = {'() => true' if self.dirty and self.version else 'null'}"
        )

    async def save(self) -> None:
        """Save the next version, or the first one of a copy."""
        if not self.version:
            await self.save_copy()
            return
        with self.problem.show_errors():
            document = deepcopy(self.document)
            try:
                self.version = await self.service.save(self.key, toml_text(document), self.version)
            except Refused as error:
                if error.field != "version":
                    raise
                self.look()
                return
            self.saved, self.newest = document, self.version
            self.show_saved()

    async def save_copy(self) -> None:
        """Save as a new entry."""
        with self.problem.show_errors():
            document = deepcopy(self.document)
            row = (await self.service.upload(f"{self.kind}.toml", toml_text(document).encode()))[0]
            self.key, self.version, self.newest, self.saved = row.id, 1, 1, document
            ui.run_javascript(f"history.replaceState(null, '', '/edit?{self.kind}={row.id}')")
            self.show_saved()

    def show_saved(self) -> None:
        """Show that the document is saved."""
        self.meanwhile.set_visibility(False)
        self.show_state()
        self.list_versions()

    def look(self) -> None:
        """Tell if somebody saved another version, or removed the entry."""
        if not self.version:
            return
        versions = self.service.store.versions(self.key)
        newest = versions[0].number if versions else 0
        if newest == self.newest:
            return
        self.newest = newest
        self.list_versions()
        self.meanwhile.clear()
        self.meanwhile.set_visibility(True)
        with self.meanwhile:
            if not newest:
                ui.label(_("This entry was removed elsewhere. Save as a copy keeps what stands here."))
                return
            ui.label(
                _(
                    "Version {newest} was saved elsewhere while you edit version {version}. What stands here "
                    "is kept; so is that version.",
                    newest=newest,
                    version=self.version,
                )
            )
            with ui.element("div").classes("mp-row"):
                mine = parts.ActionButton(
                    _("Save mine as version {newest}", newest=newest + 1),
                    on_click=partial(self.save_after, newest),
                )
                mine.props('outline dense no-caps data-test="save-mine"')
                theirs = ui.button(
                    _("Open version {newest}", newest=newest), on_click=partial(self.open_version, newest)
                )
                theirs.props('outline dense no-caps data-test="open-theirs"')

    async def save_after(self, newest: int) -> None:
        """Save what stands here behind a version that was saved elsewhere."""
        self.version = newest
        await self.save()

    def open_version(self, version: int) -> None:
        """Put a version into the form; what stood there can be got back by undoing."""
        with self.problem.show_errors():
            document = self.read(version)
            self.keep()
            self.document = document
            self.version = self.newest
            self.saved = document if version == self.newest else self.read(self.newest)
            self.saved = deepcopy(self.saved)
            self.meanwhile.set_visibility(False)
            self.fill()

    def list_versions(self) -> None:
        """List the versions, and where the entry can be used."""
        path = f"/api/{self.kind}s/{self.key}/toml"
        self.versions.clear()
        self.uses.clear()
        with self.uses:
            if self.version:
                used = f"{self.kind}={self.key}"
                parts.links(
                    [
                        (_("Drive"), f"/?{used}"),
                        (_("Compare"), f"/compare?{used}"),
                        (f"{self.kind}.toml", path),
                    ]
                )
        with self.versions:
            if not self.version:
                parts.empty(_("No version yet: Save makes the first one."))
            for row in self.service.store.versions(self.key):
                with ui.element("div").classes("mp-row items-center no-wrap"):
                    when = row.created.replace("T", " ").removesuffix("+00:00")
                    ui.label(f"{row.number} · {row.name} · {when} UTC").classes("mp-soft grow")
                    ui.link("TOML", f"{path}?version={row.number}", new_tab=True).classes("mp-links")
                    again = ui.button(_("Open"), on_click=partial(self.open_version, row.number))
                    words = _("Open version {version}", version=row.number)
                    again.props("flat dense no-caps").props(parts.prop_of("aria-label", words))


def install(service: Service) -> None:
    """Register the page."""

    @ui.page("/edit", title="Edit · metropilot")
    async def edit(request: Request, line: str | None = None, trainset: str | None = None) -> None:
        with parts.frame(request, "/lines"):
            root = ui.element("div").classes("mp-wide mp-edit")
        # what is typed before the browser is connected would be lost
        await ui.context.client.connected()
        with root:
            try:
                key = line or trainset or "yizhuang"
                page = EditPage(service, "line" if trainset is None else "trainset", key)
            except MetropilotError as error:
                with parts.card(_("Edit")):
                    parts.Problem().show(error)
                return
            page.build()

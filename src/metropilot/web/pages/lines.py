"""Lines: drawings of lines and trainsets, of the catalogue and of uploads, and errors of uploaded files."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from fastapi import Request
from nicegui import events, ui

from metropilot.errors import MetropilotError
from metropilot.web import catalogue
from metropilot.web.errors import detail_of
from metropilot.web.pages import frame as parts
from metropilot.web.pages.document import describe
from metropilot.web.pages.plots import effort_figure, line_figure
from metropilot.web.pages.strip import line_strip
from metropilot.web.service import SUFFIXES, Service
from metropilot.web.words.language import N_, _
from metropilot.web.words.said import retell
from metropilot.web.words.tables import number
from metropilot.web.work.plans import effort_curves

WHERE = (N_("file"), N_("field"), N_("value"), N_("unit"), N_("allowed"))


class LinesPage:
    """State of the page for one browser."""

    def __init__(self, service: Service) -> None:
        self.service = service

    def build(self) -> None:
        """Build the list and the upload on the left and the line on the right."""
        with ui.element("div").classes("mp-col"):
            with parts.card(_("Lines")):
                self.list = ui.element("div").classes("mp-stack")
            with parts.card(_("Trainsets")):
                self.trainsets = ui.element("div").classes("mp-stack").props('data-test="trainsets"')
                ui.link(_("Fit a trainset to logs"), "/fit").classes("mp-soft").props('data-test="to-fit"')
            most = f"{self.service.settings.upload_bytes / 1e6:g} MB"
            with parts.card(
                _("Upload"),
                _(
                    "A line or a trainset (metropilot's TOML, TTOBench's JSON), or a learned policy "
                    "(safetensors), up to {most}.",
                    most=most,
                ),
            ):
                largest = self.service.settings.upload_bytes
                self.upload_in = parts.upload_field(
                    _("Choose a file"), SUFFIXES, largest, self.upload, lambda: self.refuse_large(most)
                )
                self.said = ui.element("div").classes("mp-stack").props('role=status data-test="upload-said"')
        with ui.element("div").classes("mp-col"):
            self.shown = ui.element("div").classes("mp-col").props('data-test="line"')
        self.fill()

    def fill(self) -> None:
        """Fill the list."""
        self.list.clear()
        with self.list:
            for row in catalogue.line_rows(self.service):
                told = {"stations": row["stations"], "length": f"{row['length_m'] / 1000:.1f}"}
                words = _("{name} · {stations} stations · {length} km", name=row["name"], **told)
                self.entry(row, words, self.show)
        self.trainsets.clear()
        with self.trainsets:
            for row in catalogue.trainset_rows(self.service):
                mass_kg = row["loads_kg"][row["load"]]
                self.entry(row, f"{row['name']} · {mass_kg / 1000:.0f} t", self.show_trainset)

    def entry(self, row: dict[str, Any], words: str, show: Callable[[str], None]) -> None:
        """Place an entry of a list; an upload can be removed."""
        with ui.element("div").classes("mp-row items-center no-wrap"):
            button = ui.button(words, on_click=partial(show, row["id"]))
            button.props("flat no-caps dense").classes("grow mp-item")
            if row["uploaded"]:
                forget = parts.ActionButton(icon="delete", on_click=partial(self.forget, row["id"]))
                forget.props("flat dense round").props(
                    parts.prop_of("aria-label", _("Remove {name}", name=row["id"]))
                )

    def show(self, key: str) -> None:
        """Draw a line."""
        self.shown.clear()
        with self.shown:
            try:
                found = catalogue.line_out(self.service, key)
            except MetropilotError as error:
                parts.empty(describe(error))
                return
            with parts.card(
                found["name"],
                _(
                    "{stations} stations, {length} km · id {key}",
                    stations=found["stations"],
                    length=f"{found['length_m'] / 1000:.3f}",
                    key=key,
                ),
            ):
                parts.strip(_("Whole line"), line_strip(found))
                parts.plot(line_figure(found))
                self.edit_link("line", found)
            with parts.card(_("Sections")):
                rows = [
                    (
                        f"{s['origin']}–{s['destination']}",
                        number(s["length_m"], 0),
                        number(s["planned_forward_s"], 0),
                        number(s["planned_backward_s"], 0),
                    )
                    for s in found["sections"]
                ]
                columns = (_("section"), _("length (m)"), _("planned there (s)"), _("planned back (s)"))
                parts.table(columns, rows, right=range(1, 4), name=_("Sections"))
            self.notes(_("Notes"), found["notes"])
            self.notes(_("Read but unused"), found["unused"])
            self.notes(_("Sources"), [f"{block}: {text}" for block, text in found["source"].items()])

    @staticmethod
    def edit_link(kind: str, found: dict[str, Any]) -> None:
        """Place the links by which an entry is edited and driven."""
        words = _("Edit") if found["uploaded"] else _("Edit a copy")
        used = f"{kind}={found['id']}"
        shown = [(words, f"/edit?{used}"), (_("Drive"), f"/?{used}")]
        shown += [(_("Fit to logs"), f"/fit?{used}")] if kind == "trainset" else []
        parts.links([*shown, ("TOML", f"/api/{kind}s/{found['id']}/toml")])

    def show_trainset(self, key: str) -> None:
        """Draw a trainset."""
        self.shown.clear()
        with self.shown:
            try:
                found = catalogue.trainset_out(self.service, key)
                curves = effort_curves(catalogue.trainset(self.service, key))
            except MetropilotError as error:
                parts.empty(describe(error))
                return
            with parts.card(found["name"], f"{found['length_m']:.0f} m · id {key}"):
                parts.plot(effort_figure(curves)).props('data-test="effort"')
                rows = [(name, number(kg / 1000, 1)) for name, kg in found["loads_kg"].items()]
                parts.table((_("load"), _("mass (t)")), rows, right=(1,), name=_("Loads"))
                self.edit_link("trainset", found)

    @staticmethod
    def notes(title: str, texts: list[str]) -> None:
        """Show the notes of a file."""
        if texts:
            with parts.card(title):
                for text in texts:
                    ui.label(text).classes("mp-soft")

    async def upload(self, event: events.UploadEventArguments) -> None:
        """Upload a file; show its kind, or its error."""
        self.upload_in.reset()
        content = await event.file.read()
        try:
            row, found = await self.service.upload(event.file.name, content)
        except MetropilotError as error:
            self.refuse(error)
            return
        self.said.clear()
        with self.said:
            ui.label(
                _("✓ {kind} “{name}” taken as {id}", kind=retell(row.kind), name=row.name, id=row.id)
            ).classes("mp-pass")
            for note in found["notes"]:
                ui.label(retell(note)).classes("mp-soft")
        self.fill()
        if row.kind == "line":
            self.show(row.id)
        elif row.kind == "trainset":
            self.show_trainset(row.id)

    def refuse(self, error: MetropilotError) -> None:
        """Show the error of a file: field, value, unit and allowed values."""
        told = detail_of(error)
        self.said.clear()
        with self.said:
            parts.heading(_("This file cannot be used"))
            ui.label(retell(told["message"])).classes("mp-error")
            rows = [(_(name), str(told[name])) for name in WHERE if told[name] is not None]
            parts.table(("", ""), rows, name=_("What is wrong"))

    def refuse_large(self, most: str) -> None:
        """Show the error of a file that the browser refused to send."""
        self.said.clear()
        with self.said:
            ui.label(
                _("not taken: a .toml, .json or .safetensors file of at most {most}", most=most)
            ).classes("mp-error")

    def forget(self, key: str) -> None:
        """Remove an upload."""
        try:
            self.service.forget(key)
        except MetropilotError as error:
            self.refuse(error)
        self.fill()


def install(service: Service) -> None:
    """Register the page."""

    @ui.page("/lines", title="Lines · metropilot")
    async def lines(request: Request) -> None:
        with parts.frame(request, "/lines"):
            page = LinesPage(service)
            page.build()
            page.show("yizhuang")

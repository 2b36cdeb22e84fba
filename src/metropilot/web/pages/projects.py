"""Projects on the page Runs: choose, begin, describe, fill, export, import, remove."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import events, ui

from metropilot.web import projects
from metropilot.web.pages import frame as parts
from metropilot.web.pages.form import validate
from metropilot.web.schemas.requests import ProjectIn
from metropilot.web.service import Service
from metropilot.web.words.language import N_, _
from metropilot.web.words.said import retell

EVERY = N_("every run")


class ProjectCard:
    """Choice of a project, and its notes, lines and trainsets.

    Args:
        service: Service of the server.
        key: Project that is shown; None: every run.
        changed: Called when another one is.
    """

    def __init__(self, service: Service, key: str | None, changed: Callable[[], None]) -> None:
        self.service, self.changed = service, changed
        self.lost = None if key is None or key in {row.id for row in service.store.projects()} else key
        self.key = None if self.lost else key

    def names(self, nothing: str) -> dict[str, str]:
        """Options of a list of projects; the empty one stands for none."""
        return {"": nothing, **{row.id: row.name for row in self.service.store.projects()}}

    def build_choice(self, problem: parts.Problem) -> None:
        """Place the list of projects with its buttons; errors are shown where the page shows them."""
        self.problem = problem
        with problem.show_errors():
            if self.lost is not None:
                self.service.store.project(self.lost)
        with ui.element("div").classes("mp-row items-center"):
            self.choice = ui.select(self.names(_(EVERY)), value=self.key or "", label=_("Project"))
            self.choice.props("outlined dense options-dense").classes("mp-filter")
            self.choice.on_value_change(lambda event: self.choose(event.value))
            parts.ActionButton(_("New project"), on_click=self.begin).props('outline data-test="new-project"')
            parts.ActionButton(_("Import"), on_click=self.ask_archive).props('outline data-test="import"')

    def build(self) -> None:
        """Place the card of the chosen project."""
        self.place = ui.element("div").classes("mp-col")
        self.fill()

    def choose(self, key: str) -> None:
        """Show another project."""
        if (key or None) != self.key:
            self.key = key or None
            self.fill()
            self.changed()

    def show(self, key: str) -> None:
        """Show a project that is new in the list."""
        self.key = None
        self.choice.set_options(self.names(_(EVERY)), value=key)
        self.choose(key)

    def fill(self) -> None:
        """Show name, notes, lines and trainsets of the chosen project."""
        self.place.clear()
        if self.key is None:
            return
        found = projects.project_out(self.service, self.key)
        begun = _("Begun by {user}.", user=found["user"]) if found["user"] else ""
        with self.place, parts.card(found["name"], begun) as made:
            made.props('data-test="project"')
            self.told = parts.Problem()
            self.name = ui.input(_("Name of the project"), value=found["name"]).props(
                "outlined dense maxlength=80"
            )
            self.notes = ui.textarea(_("Notes"), value=found["notes"]).props("outlined dense autogrow")
            self.notes.props("debounce=300")
            for field in (self.name, self.notes):
                parts.for_users(field.classes("w-full").on("blur", self.keep))
            self.told.beside("name", self.name)
            self.told.beside("notes", self.notes)
            for upload in found["uploads"]:
                self.upload_row(upload)
            inside = {upload["id"] for upload in found["uploads"]}
            others = {
                row.id: f"{retell(row.kind)} · {row.name}"
                for row in self.service.store.uploads()
                if row.id not in inside
            }
            if others:
                add = ui.select(others, label=_("Add an own line, trainset, policy or log"))
                parts.for_users(add.props("outlined dense options-dense").classes("w-full"))
                add.on_value_change(lambda event: self.put(event.value, self.key))
            parts.links([(_("Export"), f"/api/projects/{self.key}/archive")])
            forget = parts.ActionButton(_("Remove project"), on_click=self.forget).props("flat dense no-caps")
            forget.tooltip(_("Its runs, lines and trainsets stay."))

    def upload_row(self, upload: dict[str, Any]) -> None:
        """Place a line, trainset, policy or log of the project."""
        kind, key = upload["kind"], upload["id"]
        with ui.element("div").classes("mp-row items-center no-wrap"):
            ui.label(f"{retell(kind)} · {upload['name']}").classes("grow")
            if kind in {"line", "trainset"}:
                parts.links([(_("Edit"), f"/edit?{kind}={key}"), (_("Drive"), f"/?{kind}={key}")])
            out = parts.ActionButton(icon="remove", on_click=partial(self.put, key, None)).props(
                "flat dense round"
            )
            words = _("Take {name} out of the project", name=upload["name"])
            out.props(parts.prop_of("aria-label", words))

    def put(self, upload: str, project: str | None) -> None:
        """File a line, trainset, policy or log in the project, or take it out."""
        with self.told.show_errors():
            projects.set_project(self.service, upload, project)
            self.fill()

    def keep(self) -> None:
        """Keep name and notes."""
        with self.told.show_errors():
            body = validate(ProjectIn, {"name": self.name.value or "", "notes": self.notes.value or ""})
            self.service.store.update_project(self.key or "", name=body.name, notes=body.notes)
            self.choice.set_options(self.names(_(EVERY)), value=self.key)

    def forget(self) -> None:
        """Remove the project; what it holds stays."""
        with self.problem.show_errors():
            self.service.store.forget_project(self.key or "")
            self.choice.set_options(self.names(_(EVERY)), value="")

    def begin(self) -> None:
        """Begin a project and show it."""
        with self.problem.show_errors():
            self.show(self.service.store.new_project(_("New project")).id)

    async def ask_archive(self) -> None:
        """Ask for an archive and show its project."""
        most = self.service.settings.archive_bytes
        with parts.question(_("Import a project")) as dialog:
            ui.label(
                _("An archive that Export made, up to {most} MB.", most=f"{most / 1000000.0:g}")
            ).classes("mp-soft")
            problem = parts.Problem()

            async def take(event: events.UploadEventArguments) -> None:
                with problem.show_errors():
                    row = await projects.read_archive(self.service, await event.file.read())
                    dialog.submit(row.id)

            def refuse() -> None:
                problem.label.text = _("not taken: a .zip file of at most {most} MB", most=f"{most / 1e6:g}")

            parts.upload_field(_("Choose an archive"), (".zip",), most, take, refuse)
            ui.button(_("Cancel"), on_click=dialog.close).props("flat")
        key = await dialog
        dialog.delete()
        if key is not None:
            self.show(key)

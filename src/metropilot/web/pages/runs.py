"""Runs: every run, live and past, in one list; and the list of live runs of the page Drive."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any
from urllib.parse import urlencode

from fastapi import Request
from nicegui import run, ui

from metropilot.web import catalogue, projects
from metropilot.web.errors import Refused
from metropilot.web.live.session import GOING, place_words
from metropilot.web.pages import frame as parts
from metropilot.web.pages.form import validate
from metropilot.web.pages.plots import difference_figure
from metropilot.web.pages.projects import ProjectCard
from metropilot.web.pages.tables import DataColumn, DataTable
from metropilot.web.schemas.requests import NameIn
from metropilot.web.service import ABANDONED_S, RESUMABLE, Service
from metropilot.web.store import JobRow
from metropilot.web.users import present_user
from metropilot.web.words.language import N_, _, ngettext
from metropilot.web.words.said import retell
from metropilot.web.words.tables import number

EVERY_S = 2.0
LISTED = 500
"""Newest jobs that the page lists."""
COLUMNS = (
    DataColumn("words", N_("Run"), kind="link"),
    DataColumn("kind", N_("Kind"), filtered=True, wide=True, said=True),
    DataColumn("state", N_("Status"), kind="styled"),
    DataColumn("status", N_("Stage"), filtered=True, wide=True, said=True),
    DataColumn("time_s", N_("Time (s)"), digits=1, wide=True),
    DataColumn("energy_kwh", N_("Energy (kWh)"), digits=2),
    DataColumn("gap_percent", N_("Gap (%)"), digits=2, wide=True),
    DataColumn("created", N_("Begun"), wide=True),
)
BY = DataColumn("user", N_("By"), filtered=True, wide=True)
"""Column of who began a run, where users have names."""
PAIRED = {
    "running_time_s": (N_("running time (s)"), 1.0, 1),
    "time_error_s": (N_("time error (s)"), 1.0, 2),
    "stopping_error_m": (N_("stopping error (cm)"), 100.0, 1),
    "energy_wheel_kwh": (N_("energy at the wheel (kWh)"), 1.0, 2),
    "energy_line_kwh": (N_("energy at the line (kWh)"), 1.0, 2),
    "optimality_gap_percent": (N_("above the optimum (%)"), 1.0, 2),
    "driver_gap_percent": (N_("lost by the driver (%)"), 1.0, 2),
    "max_speed_mps": (N_("highest speed (km/h)"), 3.6, 1),
    "max_jerk_mps3": (N_("largest jerk (m/s³)"), 1.0, 2),
    "coasting_distance_m": (N_("coasting (m)"), 1.0, 0),
    "regime_switches": (N_("changes of regime"), 1.0, 0),
    "interventions": (N_("interventions"), 1.0, 0),
}
"""KPIs of two runs side by side: words, scale, digits."""


class RunList:
    """Running and resumable live runs, refreshed while the page is open.

    Args:
        service: Service of the server.
        run: Id of the run of this page.
    """

    def __init__(self, service: Service, run: str | None) -> None:
        self.service = service
        self.run = run
        self.shown: list[tuple[Any, ...]] | None = None

    def build(self) -> None:
        """Place the list."""
        with parts.card(
            _("Live runs"),
            _("A run without a viewer for {minutes} min is stopped.", minutes=f"{ABANDONED_S / 60:g}"),
            late=True,
        ):
            self.problem = parts.Problem()
            self.rows = ui.element("div").classes("mp-stack").props('data-test="runs"')
        self.refresh()
        ui.timer(EVERY_S, self.refresh)

    def refresh(self) -> None:
        """Draw the rows anew where one has changed, else only the times."""
        found = self.service.live_runs()
        shown = [(row.id, row.status, row.words) for row in found]
        if shown != self.shown:
            self.shown = shown
            self.rows.clear()
            with self.rows:
                self.words = {row.id: self.row(row) for row in found}
                if not found:
                    parts.empty(_("No run is under way."))
        for row in found:
            self.words[row.id].text = self.state(row)

    def state(self, row: JobRow) -> str:
        """Describe the state of a run."""
        session = self.service.sessions.get(row.id)
        if session is None or session.over:
            return retell(f"{row.status}: {row.words}" if row.words else f"{row.status}; it can be resumed")
        known = session.known
        if session.waiting:
            return _("waits: {place}", place=retell(place_words(known.place)))
        said = [parts.clock(known.time_s), f"{known.pace:g} ×" if known.pace else _("paused")]
        said.append(_("{count} watching", count=session.viewers) if session.viewers else _("no viewer"))
        if known.lever is not None:
            said.append(_("lever: {holder}", holder=known.lever["holder"]))
        return " · ".join(said)

    def row(self, row: JobRow) -> ui.label:
        """Place the row of a run; return the label of its state."""
        name, path = row.name or retell(catalogue.describe_job(row)), catalogue.page_of(row)
        with ui.element("div").classes("mp-run").props(f'data-run="{row.id}" data-status="{row.status}"'):
            by = f" · {row.user}" if row.user else ""
            ui.label(name + by + (" " + _("(this one)") if row.id == self.run else ""))
            said = ui.label("").classes("mp-soft")
            with ui.element("div").classes("mp-links"):
                if row.status in GOING:
                    ui.link(_("Open"), path).props(parts.prop_of("aria-label", _("Open {name}", name=name)))
                    words = _("Stop") if row.status == "running" else _("Cancel")
                    self.button(words, name, partial(self.stop, row.id))
                else:
                    ui.link(_("Show"), path).props(parts.prop_of("aria-label", _("Show {name}", name=name)))
                    self.button(_("Resume"), name, partial(self.resume, row.id, path))
        return said

    @staticmethod
    def button(words: str, name: str, act: Callable[[], Awaitable[None]]) -> None:
        """Place a small button of a row."""
        made = parts.ActionButton(words, on_click=act).props("flat dense no-caps")
        made.props(parts.prop_of("aria-label", _("{action} {row}", action=words, row=name)))

    async def stop(self, run: str) -> None:
        """Stop a run, or take it out of the queue; it can be resumed."""
        with self.problem.show_errors():
            await self.service.session(run).stop()

    async def resume(self, run: str, path: str) -> None:
        """Resume a run and open it."""
        # Until it is ready the list may be drawn anew: this button, and what belongs to it, is gone by then.
        client = ui.context.client
        with self.problem.show_errors():
            await self.service.resume_live(run)
            client.open(path)


class RunsPage:
    """State of the page for one browser.

    Args:
        service: Service of the server.
        view: What a link shows: ``project``, ``find``, ``kind``, ``status``, and ``run`` and ``with`` for two
            runs against each other.
    """

    def __init__(self, service: Service, view: dict[str, str]) -> None:
        self.service = service
        self.view = view
        self.pair = tuple(view[name] for name in ("run", "with") if name in view)
        self.project = ProjectCard(service, view.get("project"), self.change)

    def build(self) -> None:
        """Place the list, and below it two runs against each other."""
        with ui.element("div").classes("mp-col mp-wide"):
            with parts.card(
                _("Runs"),
                _(
                    "Drives, comparisons, convoys, journeys, lines and learning runs of this server: a click "
                    "on a heading sorts, on a run opens it. Choose two drives of one section to compare them."
                ),
            ):
                self.problem = parts.Problem()
                self.project.build_choice(self.problem)
                actions = {N_("Name"): self.ask_name, N_("Stop"): self.stop, N_("Resume"): self.resume}
                self.list = DataTable(
                    _("Runs"),
                    (*COLUMNS, BY) if self.service.settings.names_users else COLUMNS,
                    sort="-created",
                    actions=actions,
                    selected=self.look_buttons,
                    changed=self.keep_view,
                )
                with ui.element("div").classes("mp-row items-center"):
                    self.compare_button = ui.button(_("Compare two"), on_click=self.compare)
                    self.compare_button.props('outline data-test="compare-two"')
                    self.delete_button = parts.ActionButton(_("Delete"), on_click=self.ask_delete)
                    self.delete_button.props('outline color=negative data-test="delete"')
                    self.move_button = parts.ActionButton(_("Move to project"), on_click=self.ask_project)
                    self.move_button.props('outline data-test="move"')
                    self.status = ui.label("").classes("mp-soft").props('aria-live=polite data-test="chosen"')
                self.list.build()
            self.project.build()
            self.result = ui.element("div").classes("mp-col").props('data-test="difference"')
        self.refresh()
        self.list.restore(self.view.get("find", ""), self.view)
        self.list.search.on_value_change(self.keep_view)
        self.look_buttons()
        ui.timer(EVERY_S, self.refresh)

    def refresh(self) -> None:
        """Show the jobs as they stand."""
        found = self.service.store.jobs(limit=LISTED, project=self.project.key)
        self.list.fill([self.row(row) for row in found])

    def change(self) -> None:
        """Show the runs of another project."""
        self.refresh()
        self.keep_view()

    def keep_view(self) -> None:
        """Keep what the page shows in its address."""
        filters = {name: str(field.value) for name, field in self.list.filters.items()}
        view = {"project": self.project.key or "", "find": str(self.list.search.value or ""), **filters}
        view |= dict(zip(("run", "with"), self.pair, strict=False))
        text = urlencode({name: value for name, value in view.items() if value})
        ui.run_javascript(
            f"history.replaceState(null, '', {json.dumps('/runs' + (f'?{text}' if text else ''))})"
        )

    def row(self, row: JobRow) -> dict[str, Any]:
        """A row of the list."""
        short = row.summary
        state = short.get("outcome") if row.status == "done" else row.status
        if row.status == "running" and row.kind != "live":
            state = f"{row.progress:.0%}"
        elif row.status not in {"done", "running"} and row.words:
            state = f"{row.status}: {row.words}"
        passed, mark = "", ""
        if short.get("success") is not None:
            passed = "mp-pass" if short["success"] else "mp-fail"
            mark = "✓ " if short["success"] else "✗ "
        actions = ["Name"] + (["Stop"] if row.status in GOING else [])
        if row.status in RESUMABLE or (row.status == "failed" and row.kind != "live"):
            actions.append("Resume")
        told = retell(catalogue.describe_job(row))
        return {
            "id": row.id,
            "words": f"{row.name} · {told}" if row.name else told,
            "link": catalogue.page_of(row),
            "kind": catalogue.KINDS[catalogue.kind_of(row)],
            "state": mark + retell(str(state or "done")),
            "status": row.status,
            "style": passed if row.status == "done" else "mp-fail" if row.status == "failed" else "",
            "created": row.created[:16].replace("T", " "),
            "user": row.user,
            "actions": actions if present_user().may_change else [],
            **{name: short.get(name) for name in ("time_s", "energy_kwh", "gap_percent")},
        }

    def look_buttons(self) -> None:
        """Enable what the chosen rows allow."""
        chosen = self.list.chosen
        self.compare_button.set_enabled(len(chosen) == len(("first", "second")))
        for button in (self.delete_button, self.move_button):
            button.set_enabled(bool(chosen))
        self.status.text = _("{count} chosen", count=len(chosen)) if chosen else ""

    async def ask_name(self, job: str) -> None:
        """Ask for the name of a run and keep it."""
        with self.problem.show_errors():
            row = self.service.store.job(job)
            with parts.question(_("Name of {run}", run=retell(catalogue.describe_job(row)))) as dialog:
                problem = parts.Problem()
                field = ui.input(_("Name"), value=row.name).props("outlined dense autofocus maxlength=80")
                problem.beside("name", field.classes("w-full"))

                def keep() -> None:
                    with problem.show_errors():
                        self.service.name_job(job, validate(NameIn, {"name": field.value or ""}).name)
                        dialog.close()

                field.on("keydown.enter", keep)
                with ui.element("div").classes("mp-row"):
                    ui.button(_("Keep"), on_click=keep).props("unelevated")
                    ui.button(_("Cancel"), on_click=dialog.close).props("flat")
            await dialog
            dialog.delete()
            self.refresh()

    def stop(self, job: str) -> None:
        """Stop a run."""
        with self.problem.show_errors():
            self.service.stop(job)
            self.refresh()

    async def resume(self, job: str) -> None:
        """Resume a run; a live one is opened."""
        client = ui.context.client
        with self.problem.show_errors():
            row = self.service.store.job(job)
            if row.kind == "live":
                await self.service.resume_live(job)
                client.open(catalogue.page_of(row))
            else:
                self.service.resume(job)
                self.refresh()

    async def ask_delete(self) -> None:
        """Ask, then delete the chosen runs."""
        chosen = self.list.chosen
        what = ngettext("{count} run", "{count} runs", len(chosen))
        with parts.question(_("Delete {what}?", what=what)) as dialog:
            ui.label(_("Files and results go with them; of a learning run its policy.")).classes("mp-soft")
            with ui.element("div").classes("mp-row"):
                sure = ui.button(_("Delete {what}", what=what), on_click=lambda: dialog.submit(True))
                sure.props('unelevated color=negative data-test="delete-sure"')
                ui.button(_("Cancel"), on_click=dialog.close).props("flat")
        if await dialog:
            with self.problem.show_errors():
                for job in chosen:
                    self.service.forget_job(job)
        dialog.delete()
        self.refresh()
        self.look_buttons()

    async def ask_project(self) -> None:
        """Ask for a project and move the chosen runs to it."""
        chosen = self.list.chosen
        with parts.question(_("Move to project")) as dialog:
            field = ui.select(
                self.project.names(_("none")), value=self.project.key or "", label=_("To project")
            )
            field.props("outlined dense options-dense").classes("w-full")
            with ui.element("div").classes("mp-row"):
                ui.button(_("Move"), on_click=lambda: dialog.submit(field.value)).props("unelevated")
                ui.button(_("Cancel"), on_click=dialog.close).props("flat")
        wanted = await dialog
        dialog.delete()
        if wanted is not None:
            with self.problem.show_errors():
                for job in chosen:
                    projects.set_project(self.service, job, wanted or None)
        self.refresh()

    async def compare(self) -> None:
        """Compare the two chosen runs."""
        self.pair = tuple(self.list.chosen)
        await self.show()

    async def show(self) -> None:
        """Show the two runs of the page against each other."""
        if not self.pair:
            return
        self.result.clear()
        with self.problem.show_errors():
            if len(self.pair) != len(("first", "second")):
                raise Refused("two runs are needed", 422, field="with", allowed="/runs?run=ID&with=ID")
            found: Any = await run.io_bound(catalogue.difference, self.service, *self.pair)
            rows = [self.service.store.job(job) for job in self.pair]
            with self.result, parts.card(_("Two runs")):
                names = self.names(rows)
                for key, row, name in zip("ab", rows, names, strict=True):
                    ui.link(f"{key}: {name}", catalogue.page_of(row)).classes("mp-soft")
                parts.plot(difference_figure(found)).props('data-test="difference-plot"')
                pair_table(found["kpis"])
            self.keep_view()
            ui.run_javascript(f"document.getElementById('c{self.result.id}').scrollIntoView()")

    @staticmethod
    def names(rows: list[JobRow]) -> list[str]:
        """Names of runs, or what they are."""
        return [row.name or retell(catalogue.describe_job(row)) for row in rows]


def pair_table(kpis: list[dict[str, Any]]) -> None:
    """Show the KPIs of two runs and their difference."""
    found = {pair["name"]: pair for pair in kpis}
    rows = []
    for name, (words, scale, digits) in PAIRED.items():
        pair = found.get(name)
        if pair is None:
            continue
        first, second = (None if pair[key] is None else scale * pair[key] for key in ("first", "second"))
        change = None if first is None or second is None else second - first
        rows.append((_(words), *(number(value, digits) for value in (first, second, change))))
    parts.table((_("KPI"), "a", "b", "b − a"), rows, right=(1, 2, 3), name=_("KPIs of two runs"))


def install(service: Service) -> None:
    """Register the page."""

    @ui.page("/runs", title="Runs · metropilot")
    async def runs(request: Request) -> None:
        with parts.frame(request, "/runs"):
            page = RunsPage(service, dict(request.query_params))
            page.build()
        await ui.context.client.connected()
        await page.show()

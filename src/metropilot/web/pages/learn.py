"""Learn: start, watch, stop and resume learning runs; tables of the studies."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from typing import Any

from fastapi import Request
from nicegui import run, ui

from metropilot.errors import MetropilotError
from metropilot.studies import PublishedStudy
from metropilot.web import catalogue
from metropilot.web.errors import Refused, error_of
from metropilot.web.live.session import GOING
from metropilot.web.pages import frame as parts
from metropilot.web.pages.form import driver_names, is_learned, number_field, validate
from metropilot.web.pages.plots import blank, history_figure
from metropilot.web.pages.strip import names
from metropilot.web.pages.tables import DataColumn, DataTable
from metropilot.web.schemas.requests import ExportIn, LearnIn, StudyIn
from metropilot.web.service import Service
from metropilot.web.store import JobRow
from metropilot.web.words.language import N_, _
from metropilot.web.words.said import retell
from metropilot.web.words.tables import number

POLL_S = 1.0


class LearnPage:
    """State of the page for one browser."""

    def __init__(self, service: Service, job: str | None) -> None:
        self.service = service
        self.job = job
        self.seen: object = None
        self.closed = False

    def build(self) -> None:
        """Build the fields on the left and the results on the right."""
        self.recipes = {row["driver"]: row for row in catalogue.recipe_rows()}
        with ui.element("div").classes("mp-col"):
            with parts.card(_("Learn a driver")):
                self.driver = ui.select(
                    list(self.recipes), value="ppo", label=_("Driver"), on_change=self.say_recipe
                )
                self.budget = ui.select(
                    {name: retell(name) for name in ("quick", "paper")},
                    value="quick",
                    label=_("Budget"),
                    on_change=self.say_recipe,
                )
                self.words = ui.label("").classes("mp-soft")
                lines = {row["id"]: row["name"] for row in catalogue.line_rows(self.service)}
                trainsets = {row["id"]: row["name"] for row in catalogue.trainset_rows(self.service)}
                self.site: dict[str, Any] = {
                    "line": ui.select(lines, label=_("Line"), clearable=True).props(
                        parts.prop_of("hint", _("Empty: that of the task"))
                    ),
                    "sections": ui.input(_("Sections")).props(
                        parts.prop_of("hint", _("ORIGIN-DESTINATION,...; empty: all of the line, both ways"))
                    ),
                    "trainset": ui.select(trainsets, label=_("Trainset"), clearable=True).props(
                        parts.prop_of("hint", _("Empty: that of the task"))
                    ),
                }
                self.steps = number_field(LearnIn, "steps", label=_("Environment steps"), step=50_000)
                self.seed = number_field(LearnIn, "seed", label=_("Seed"), step=1)
                self.problem = parts.Problem()
                fields = (
                    ("driver", self.driver),
                    ("budget", self.budget),
                    *self.site.items(),
                    ("steps", self.steps),
                    ("seed", self.seed),
                )
                for name, element in fields:
                    self.problem.beside(name, element.props("outlined dense options-dense"))
                self.steps.props('data-test="steps"')
                parts.ActionButton(_("Learn"), on_click=self.start).props('unelevated data-test="learn"')
            self.aboard = ExportForm(self.service)
            self.aboard.build()
            with parts.card(_("Studies"), _("Papers reproduced: published, reproduced and optimal values.")):
                self.studies()
        with ui.element("div").classes("mp-col"):
            with parts.card(_("Run")):
                with ui.element("div").classes("mp-row items-center"):
                    self.status = ui.label(_("No run chosen.")).classes("mp-soft grow")
                    self.status.props('aria-live=polite data-test="status"')
                    self.stop_button = parts.ActionButton(_("Stop"), on_click=self.stop).props(
                        'outline data-test="stop"'
                    )
                    self.resume_button = parts.ActionButton(_("Resume"), on_click=self.resume).props(
                        'outline data-test="resume"'
                    )
                self.drive_it = ui.link(_("Compare its policy with the optimum"), "/compare")
                self.drive_it.classes("mp-links").props('data-test="drive-it"').set_visibility(False)
                self.bar = ui.linear_progress(value=0, show_value=False).props("rounded")
                self.bar.props(parts.prop_of("aria-label", _("Progress")))
                self.plot = parts.plot(blank(560, _("Start a run, or choose one below."))).props(
                    'data-test="curves"'
                )
            with parts.card(_("Runs")):
                self.runs = ui.element("div").classes("w-full").props('data-test="runs"')
            self.tables = ui.element("div").classes("mp-col").props('data-test="study"')
        self.say_recipe()
        self.fill()
        self.look_buttons(None)

    def say_recipe(self) -> None:
        """Show the summary of the recipe and its steps."""
        row = self.recipes[self.driver.value]
        told = {"summary": retell(row["summary"]), "source": retell(row["source"]), "task": row["task"]}
        self.words.text = _("{summary} ({source}), task {task}", **told)
        self.steps.value = row[f"steps_{self.budget.value}"]

    def start(self) -> None:
        """Queue a learning run."""
        with self.problem.show_errors():
            values = {"driver": self.driver.value, "budget": self.budget.value}
            numbers = {"steps": self.steps.value, "seed": self.seed.value}
            values |= {name: field.value or None for name, field in self.site.items()}
            self.job = self.service.submit(validate(LearnIn, {**values, **numbers}))
            self.follow()

    def follow(self) -> None:
        """Follow the chosen job."""
        ui.run_javascript(f"history.replaceState(null, '', '/learn?job={self.job}')")
        self.seen = None
        self.look_once()

    def watch(self) -> None:
        """Refresh the page while it is open."""
        parts.refresh_while(lambda: not self.closed, POLL_S, self.look)

    async def look(self) -> None:
        """Show the chosen job; read in a thread."""
        if self.job is None:
            return
        found = await run.io_bound(self.read_job, self.job)
        if found is not None:
            self.show(*found)

    def look_once(self) -> None:
        """Show the chosen job at once."""
        if self.job is not None:
            self.show(*self.read_job(self.job))

    def read_job(self, job: str) -> tuple[JobRow | None, dict[str, Any]]:
        """Read a job and the history of its learning run."""
        try:
            row = self.service.store.job(job)
            return row, catalogue.history(self.service, row.run) if row.run else {}
        except MetropilotError:
            return None, {}

    def show(self, row: JobRow | None, columns: dict[str, Any]) -> None:
        """Show status, curves and list where something has changed."""
        if row is None:
            self.status.text = _("no such job")
            return
        steps = columns.get("steps", [])
        now = (row.id, row.status, row.words, len(steps))
        if now == self.seen:
            return
        self.seen = now
        name = row.run or row.id
        self.status.text = f"{name} · {retell(row.status)}" + (f" · {retell(row.words)}" if row.words else "")
        self.bar.value = row.progress
        waits = blank(560, _("The curves begin with the first evaluation."))
        self.plot.update_figure(history_figure(columns) if steps else waits)
        self.look_buttons(row.status)
        self.drive_it.set_visibility(row.run in self.service.policies())
        self.drive_it.props(f"href=/compare?driver=learned:policy={row.run}")
        self.fill()

    def look_buttons(self, status: str | None) -> None:
        """Enable the buttons that a status allows."""
        self.stop_button.set_enabled(status in GOING)
        self.resume_button.set_enabled(status in {"stopped", "interrupted", "failed"})

    def stop(self) -> None:
        """Stop at the next checkpoint."""
        with self.problem.show_errors():
            self.service.stop(self.job or "")
            self.status.text += " · " + _("stops at the next checkpoint")

    def resume(self) -> None:
        """Resume from the checkpoint."""
        with self.problem.show_errors():
            self.service.resume(self.job or "")
            self.look_once()

    def fill(self) -> None:
        """Fill the list of runs."""
        rows = self.service.store.jobs("learn", 30)
        self.runs.clear()
        with self.runs:
            if not rows:
                parts.empty(_("No learning run yet. Quick takes about two minutes on two free cores."))
                return
            with ui.element("div").classes("mp-stack"):
                for row in rows:
                    seed = row.request["seed"]
                    words = (
                        f"{row.run or row.id} · {retell(row.request['budget'])} · {retell(f'seed {seed}')}"
                    )
                    words += f" · {retell(row.status)}"
                    button = ui.button(words, on_click=partial(self.choose, row.id))
                    button.props("flat no-caps dense").classes("w-full mp-item")

    def choose(self, job: str) -> None:
        """Show another run."""
        self.job = job
        self.follow()

    def studies(self) -> None:
        """Place the list of studies."""
        rows = catalogue.study_rows(self.service)
        if not rows:
            parts.empty(_("No study is installed."))
        for row in rows:
            with ui.element("div").classes("mp-row items-center no-wrap"):
                ui.label(f"{row['id']}: {retell(row['title'])}").classes("mp-soft grow")
                go = ui.button(_("Show"), on_click=partial(self.show_study, row["id"])).props(
                    "flat dense no-caps"
                )
                go.props(parts.prop_of("aria-label", _("Show {name}", name=row["id"])))

    def show_study(self, key: str) -> None:
        """Show the published page of a study, and the table of the newest reproduction here."""
        self.tables.clear()
        with self.tables:
            with parts.card(key, _("Reproduced here")):
                try:
                    study_table(catalogue.study_table(self.service, key))
                except Refused:
                    going = [
                        job
                        for job in self.service.store.jobs("study")
                        if job.request["study"] == key and job.status in GOING
                    ]
                    words = _("Not reproduced here yet; quick takes about 2 min.")
                    parts.empty(retell(going[0].words or going[0].status) if going else words)
                again = parts.ActionButton(_("Reproduce (quick)"), on_click=lambda: self.reproduce(key))
                again.props("outline no-caps")
            with self.problem.show_errors():
                published_page(catalogue.study_page(key))
        ui.run_javascript(
            f"history.replaceState(null, '', '/learn?study={key}');"
            f"document.getElementById('c{self.tables.id}').scrollIntoView()"
        )

    def reproduce(self, key: str) -> None:
        """Queue a study."""
        with self.problem.show_errors():
            self.service.submit(StudyIn(study=key))
            self.show_study(key)


class ExportForm:
    """Form of an export of a learned driver as C or WebAssembly, with its download.

    Args:
        service: Service of the server.
    """

    def __init__(self, service: Service) -> None:
        self.service = service
        self.job = ""

    def build(self) -> None:
        """Place fields, button and status."""
        with parts.card(
            _("On a controller"), _("A learned driver under protection as C, or in a page of its own.")
        ):
            self.problem = parts.Problem()
            lines = {row["id"]: row["name"] for row in catalogue.line_rows(self.service)}
            trainsets = {row["id"]: row["name"] for row in catalogue.trainset_rows(self.service)}
            drivers = {name: words for name, words in driver_names(self.service).items() if is_learned(name)}
            stops = names(catalogue.line_out(self.service, "yizhuang")["stops"])
            self.fields: dict[str, Any] = {
                "driver": ui.select(drivers, value="ppo", label=_("Driver to export")),
                "line": ui.select(lines, value="yizhuang", label=_("Line"), on_change=self.change_line),
                "origin": ui.select(stops, value="RJ", label=_("From")),
                "destination": ui.select(stops, value="WYJ", label=_("To")),
                "trainset": ui.select(trainsets, value="dkz32", label=_("Trainset")),
                "to": ui.select({"c": "C", "wasm": _("WebAssembly and a page")}, value="c", label=_("As")),
                "number": ui.select(["double", "float"], value="double", label=_("Numbers")),
            }
            for name, field in self.fields.items():
                self.problem.beside(name, field.props("outlined dense options-dense").classes("w-full"))
            parts.ActionButton(_("Export"), on_click=self.start).props('unelevated data-test="export"')
            self.status = ui.label("").classes("mp-soft").props('aria-live=polite data-test="export-status"')
            self.files = ui.element("div")

    def change_line(self) -> None:
        """Offer the stations of the line."""
        stops = names(catalogue.line_out(self.service, self.fields["line"].value)["stops"])
        ends = list(stops)
        for name, end in (("origin", ends[0]), ("destination", ends[1])):
            self.fields[name].set_options(stops, value=end)

    def start(self) -> None:
        """Queue the export."""
        with self.problem.show_errors():
            values = {name: field.value for name, field in self.fields.items()}
            self.follow(self.service.submit(validate(ExportIn, values)))

    def follow(self, job: str) -> None:
        """Show the state of an export until it is over."""
        self.job, self.going = job, True
        self.files.clear()
        parts.refresh_while(lambda: self.going, POLL_S, self.look)

    def look(self) -> None:
        """Show the state, and the download once it is there."""
        with self.problem.show_errors():
            row = self.service.store.job(self.job)
            self.status.text = retell(f"{row.status}: {row.words}" if row.words else row.status)
            self.going = row.status in GOING
            if row.status == "done":
                with self.files:
                    parts.links([("run.zip", f"/api/jobs/{row.id}/files/run.zip")])
            elif row.error is not None:
                self.problem.show(error_of(row.error))
            return
        self.going = False


def published_page(found: PublishedStudy) -> None:
    """Show the published page of a study: verdicts, rows, figures."""
    with parts.card(retell(found.title), retell(found.written)):
        if found.verdicts:
            ui.label(retell(found.summary)).classes("mp-soft").props('data-test="verdict"')
            rows = []
            for row in found.verdicts:
                style = VERDICTS.get(row["verdict"], "")
                words = [
                    retell(row[name]) for name in ("claim", "unit", "published", "ours", "interval", "rival")
                ]
                rows.append((*words, (retell(row["verdict"]), style), retell(row["why"])))
            columns = (
                _("claim of the paper"),
                _("unit"),
                _("published"),
                _("ours"),
                _("interval"),
                _("simple rival"),
            )
            parts.table((*columns, _("verdict"), _("why")), rows, right=(2, 3, 4), name=_("Verdicts"))
        listed = DataTable(_("Published rows"), STUDY_ROWS)
        listed.build()
        listed.fill([{"id": k, **asdict(row)} for k, row in enumerate(found.rows)])
    if found.figures:
        with parts.card(_("Figures")):
            for figure in found.figures:
                ui.label(retell(figure.caption)).classes("mp-soft")
                picture = ui.element("img").classes("mp-picture")
                picture.props["src"] = f"/api/studies/{found.id}/figures/{figure.name}"
                picture.props["alt"] = retell(figure.caption)


def study_table(rows: list[dict[str, Any]]) -> None:
    """Show published, reproduced and optimal numbers."""
    cells = [
        (
            r["table"],
            r["case"],
            r["driver"],
            f"{r['kpi']} ({r['unit']})" if r["unit"] else r["kpi"],
            figures(r["published"]),
            figures(r["ours"]),
            "–"
            if r["low"] is None or r["low"] == r["high"]
            else f"{figures(r['low'])} … {figures(r['high'])}",
            figures(r["optimum"]),
        )
        for r in rows
    ]
    columns = (
        _("table"),
        _("case"),
        _("driver"),
        _("KPI"),
        _("published"),
        _("ours"),
        _("range"),
        _("optimum"),
    )
    parts.table(columns, cells, right=(4, 5, 6, 7), name=_("Published, reproduced, optimum"))


def figures(value: float | None) -> str:
    """Format a number with four significant digits."""
    return number(None) if value is None else f"{value:.4g}".replace("-", "−")


VERDICTS = {"beaten": "mp-pass", "matched": "mp-pass", "missed": "mp-fail"}
STUDY_ROWS = (
    DataColumn("table", N_("Table"), filtered=True, wide=True),
    DataColumn("case", N_("Case")),
    DataColumn("driver", N_("Driver"), filtered=True),
    DataColumn("kpi", N_("KPI"), filtered=True),
    DataColumn("unit", N_("Unit"), wide=True),
    DataColumn("published", N_("Published"), digits=3),
    DataColumn("ours", N_("Ours"), digits=3),
    DataColumn("low", N_("Smallest"), digits=3, wide=True),
    DataColumn("high", N_("Largest"), digits=3, wide=True),
    DataColumn("optimum", N_("Optimum"), digits=3, wide=True),
)


def install(service: Service) -> None:
    """Register the page."""

    @ui.page("/learn", title="Learn · metropilot")
    async def learn(
        request: Request, job: str | None = None, study: str | None = None, export: str | None = None
    ) -> None:
        with parts.frame(request, "/learn"):
            page = LearnPage(service, job)
            page.build()
            if export is not None:
                page.aboard.follow(export)
            if study is not None:
                page.show_study(study)
        await ui.context.client.connected()
        page.look_once()
        page.watch()

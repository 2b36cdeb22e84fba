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
from metropilot.web.pages.form import describe_driver, driver_names, number_field, validate
from metropilot.web.pages.frame import (
    ActionButton,
    Problem,
    card,
    empty,
    frame,
    links,
    number,
    refresh_while,
    table,
)
from metropilot.web.pages.plots import blank, history_figure
from metropilot.web.pages.strip import names
from metropilot.web.pages.tables import DataColumn, DataTable
from metropilot.web.schemas.requests import ExportIn, LearnIn, StudyIn
from metropilot.web.service import Service
from metropilot.web.store import JobRow

POLL_S = 1.0
GOING = ("queued", "running")


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
            with card("Learn a driver"):
                self.driver = ui.select(
                    list(self.recipes), value="ppo", label="Driver", on_change=self.say_recipe
                )
                self.budget = ui.select(
                    ["quick", "paper"], value="quick", label="Budget", on_change=self.say_recipe
                )
                self.words = ui.label("").classes("mp-soft")
                self.steps = number_field(LearnIn, "steps", label="Environment steps", step=50_000)
                self.seed = number_field(LearnIn, "seed", label="Seed", step=1)
                self.problem = Problem()
                fields = (
                    ("driver", self.driver),
                    ("budget", self.budget),
                    ("steps", self.steps),
                    ("seed", self.seed),
                )
                for name, element in fields:
                    self.problem.beside(name, element.props("outlined dense options-dense"))
                self.steps.props('data-test="steps"')
                ActionButton("Learn", on_click=self.start).props('unelevated data-test="learn"')
            self.aboard = ExportForm(self.service)
            self.aboard.build()
            with card("Studies", "Papers reproduced: published, reproduced and optimal values."):
                self.studies()
        with ui.element("div").classes("mp-col"):
            with card("Run"):
                with ui.element("div").classes("mp-row items-center"):
                    self.status = ui.label("No run chosen.").classes("mp-soft grow")
                    self.status.props('aria-live=polite data-test="status"')
                    self.stop_button = ActionButton("Stop", on_click=self.stop).props(
                        'outline data-test="stop"'
                    )
                    self.resume_button = ActionButton("Resume", on_click=self.resume).props(
                        'outline data-test="resume"'
                    )
                self.drive_it = ui.link("Compare its policy with the optimum", "/compare")
                self.drive_it.classes("mp-links").props('data-test="drive-it"').set_visibility(False)
                self.bar = ui.linear_progress(value=0, show_value=False).props(
                    'aria-label="Progress" rounded'
                )
                self.plot = (
                    ui.plotly(blank(560, "Start a run, or choose one below."))
                    .classes("mp-plot")
                    .props('data-test="curves"')
                )
            with card("Runs"):
                self.runs = ui.element("div").classes("w-full").props('data-test="runs"')
            self.tables = ui.element("div").classes("mp-col").props('data-test="study"')
        self.say_recipe()
        self.fill()
        self.look_buttons(None)

    def say_recipe(self) -> None:
        """Show the summary of the recipe and its steps."""
        row = self.recipes[self.driver.value]
        self.words.text = f"{row['summary']} ({row['source']}), task {row['task']}"
        self.steps.value = row[f"steps_{self.budget.value}"]

    def start(self) -> None:
        """Queue a learning run."""
        with self.problem.show_errors():
            values = {"driver": self.driver.value, "budget": self.budget.value}
            numbers = {"steps": self.steps.value, "seed": self.seed.value}
            self.job = self.service.submit(validate(LearnIn, {**values, **numbers}))
            self.follow()

    def follow(self) -> None:
        """Follow the chosen job."""
        ui.run_javascript(f"history.replaceState(null, '', '/learn?job={self.job}')")
        self.seen = None
        self.look_once()

    def watch(self) -> None:
        """Refresh the page while it is open."""
        refresh_while(lambda: not self.closed, POLL_S, self.look)

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
            self.status.text = "no such job"
            return
        steps = columns.get("steps", [])
        now = (row.id, row.status, row.words, len(steps))
        if now == self.seen:
            return
        self.seen = now
        name = row.run or row.id
        self.status.text = f"{name} · {row.status}" + (f" · {row.words}" if row.words else "")
        self.bar.value = row.progress
        waits = blank(560, "The curves begin with the first evaluation.")
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
            self.status.text += " · stops at the next checkpoint"

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
                empty("No learning run yet. Quick takes about two minutes on two free cores.")
                return
            with ui.element("div").classes("mp-stack"):
                for row in rows:
                    seed = row.request["seed"]
                    words = f"{row.run or row.id} · {row.request['budget']} · seed {seed} · {row.status}"
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
            empty("No study is installed.")
        for row in rows:
            with ui.element("div").classes("mp-row items-center no-wrap"):
                ui.label(f"{row['id']}: {row['title']}").classes("mp-soft grow")
                go = ui.button("Show", on_click=partial(self.show_study, row["id"])).props(
                    "flat dense no-caps"
                )
                go.props(f'aria-label="Show {row["id"]}"')

    def show_study(self, key: str) -> None:
        """Show the published page of a study, and the table of the newest reproduction here."""
        self.tables.clear()
        with self.tables:
            with card(key, "Reproduced here"):
                try:
                    study_table(catalogue.study_table(self.service, key))
                except Refused:
                    going = [
                        job
                        for job in self.service.store.jobs("study")
                        if job.request["study"] == key and job.status in GOING
                    ]
                    words = "Not reproduced here yet; quick takes about 2 min."
                    empty(going[0].words or going[0].status if going else words)
                again = ActionButton("Reproduce (quick)", on_click=lambda: self.reproduce(key))
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
        with card("On a controller", "A learned driver under protection as C, or in a page of its own."):
            self.problem = Problem()
            lines = {row["id"]: row["name"] for row in catalogue.line_rows(self.service)}
            trainsets = {row["id"]: row["name"] for row in catalogue.trainset_rows(self.service)}
            drivers = {
                name: words
                for name, words in driver_names(self.service).items()
                if name.startswith("learned:") or describe_driver(name).startswith("Learned")
            }
            stops = names(catalogue.line_out(self.service, "yizhuang")["stops"])
            self.fields: dict[str, Any] = {
                "driver": ui.select(drivers, value="ppo", label="Driver to export"),
                "line": ui.select(lines, value="yizhuang", label="Line", on_change=self.change_line),
                "origin": ui.select(stops, value="RJ", label="From"),
                "destination": ui.select(stops, value="WYJ", label="To"),
                "trainset": ui.select(trainsets, value="dkz32", label="Trainset"),
                "to": ui.select({"c": "C", "wasm": "WebAssembly and a page"}, value="c", label="As"),
                "number": ui.select(["double", "float"], value="double", label="Numbers"),
            }
            for name, field in self.fields.items():
                self.problem.beside(name, field.props("outlined dense options-dense").classes("w-full"))
            ActionButton("Export", on_click=self.start).props('unelevated data-test="export"')
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
        refresh_while(lambda: self.going, POLL_S, self.look)

    def look(self) -> None:
        """Show the state, and the download once it is there."""
        with self.problem.show_errors():
            row = self.service.store.job(self.job)
            self.status.text = f"{row.status}: {row.words}" if row.words else row.status
            self.going = row.status in GOING
            if row.status == "done":
                with self.files:
                    links([("run.zip", f"/api/jobs/{row.id}/files/run.zip")])
            elif row.error is not None:
                self.problem.show(error_of(row.error))
            return
        self.going = False


def published_page(found: PublishedStudy) -> None:
    """Show the published page of a study: verdicts, rows, figures."""
    with card(found.title, found.written):
        if found.verdicts:
            ui.label(found.summary).classes("mp-soft").props('data-test="verdict"')
            rows = []
            for row in found.verdicts:
                style = VERDICTS.get(row["verdict"], "")
                words = [row[name] for name in ("claim", "unit", "published", "ours", "interval", "rival")]
                rows.append((*words, (row["verdict"], style), row["why"]))
            columns = ("claim of the paper", "unit", "published", "ours", "interval", "simple rival")
            table((*columns, "verdict", "why"), rows, right=(2, 3, 4), name="Verdicts")
        listed = DataTable("Published rows", STUDY_ROWS)
        listed.build()
        listed.fill([{"id": k, **asdict(row)} for k, row in enumerate(found.rows)])
    if found.figures:
        with card("Figures"):
            for figure in found.figures:
                ui.label(figure.caption).classes("mp-soft")
                picture = ui.element("img").classes("mp-picture")
                picture.props["src"] = f"/api/studies/{found.id}/figures/{figure.name}"
                picture.props["alt"] = figure.caption


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
    columns = ("table", "case", "driver", "KPI", "published", "ours", "range", "optimum")
    table(columns, cells, right=(4, 5, 6, 7), name="Published, reproduced, optimum")


def figures(value: float | None) -> str:
    """Format a number with four significant digits."""
    return number(None) if value is None else f"{value:.4g}".replace("-", "−")


VERDICTS = {"beaten": "mp-pass", "matched": "mp-pass", "missed": "mp-fail"}
STUDY_ROWS = (
    DataColumn("table", "Table", filtered=True, wide=True),
    DataColumn("case", "Case"),
    DataColumn("driver", "Driver", filtered=True),
    DataColumn("kpi", "KPI", filtered=True),
    DataColumn("unit", "Unit", wide=True),
    DataColumn("published", "Published", digits=3),
    DataColumn("ours", "Ours", digits=3),
    DataColumn("low", "Smallest", digits=3, wide=True),
    DataColumn("high", "Largest", digits=3, wide=True),
    DataColumn("optimum", "Optimum", digits=3, wide=True),
)


def install(service: Service) -> None:
    """Register the page."""

    @ui.page("/learn", title="Learn · metropilot")
    async def learn(
        request: Request, job: str | None = None, study: str | None = None, export: str | None = None
    ) -> None:
        with frame(request, "/learn"):
            page = LearnPage(service, job)
            page.build()
            if export is not None:
                page.aboard.follow(export)
            if study is not None:
                page.show_study(study)
        await ui.context.client.connected()
        page.look_once()
        page.watch()

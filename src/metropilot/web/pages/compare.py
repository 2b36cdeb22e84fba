"""Compare: several drivers on one section, and the time-energy front."""

from __future__ import annotations

from typing import Any

from fastapi import Request
from nicegui import ui

from metropilot.errors import MetropilotError
from metropilot.evaluate import best_of
from metropilot.planning import excess_percent
from metropilot.units import J_PER_KWH
from metropilot.web import catalogue
from metropilot.web.errors import Refused
from metropilot.web.pages import form
from metropilot.web.pages import frame as parts
from metropilot.web.pages.plots import blank, compare_figure, front_figure
from metropilot.web.schemas.requests import CompareIn
from metropilot.web.service import Service
from metropilot.web.store import JobRow
from metropilot.web.words.language import N_, _
from metropilot.web.words.said import retell
from metropilot.web.words.tables import number

SHOWN = (
    ("time_error_s", N_("time (s)"), 1.0, 2),
    ("stopping_error_m", N_("stop (cm)"), 100.0, 1),
    ("energy_wheel_kwh", N_("wheel (kWh)"), 1.0, 2),
    ("energy_line_kwh", N_("line (kWh)"), 1.0, 2),
    ("optimality_gap_percent", N_("gap (%)"), 1.0, 2),
    ("trainset_gap_percent", N_("trainset (%)"), 1.0, 2),
    ("driver_gap_percent", N_("driver (%)"), 1.0, 2),
    ("max_jerk_mps3", N_("jerk (m/s³)"), 1.0, 2),
    ("comfort_huang2025", "Σ|Δu|", 1.0, 2),
    ("regime_switches", N_("switches"), 1.0, 0),
    ("interventions", N_("interventions"), 1.0, 0),
    ("decision_time_us_median", N_("decision (µs)"), 1.0, 0),
)
UNJUDGED = ("decision_time_us_median", "trainset_gap_percent")
POLL_S = 0.4


class ComparePage:
    """State of the page for one browser."""

    def __init__(self, service: Service, job: str | None, driver: str | None = None) -> None:
        self.service = service
        self.job = job
        self.driver = driver
        self.front: dict[str, Any] | None = None
        self.entries: list[dict[str, Any]] = []
        self.driven: dict[str, Any] = {}
        self.options: dict[str, Any] = {}
        self.wanted_s: float | None = None
        self.planning = False
        self.form = form.SectionForm(service, self.load_front, self.move_cursor)
        self.disturbances = form.DisturbanceForm()

    def build(self) -> None:
        """Build the fields on the left and the results on the right."""
        with ui.element("div").classes("mp-col"), parts.card(_("Run")):
            self.form.build()
            drivers = form.driver_names(self.service)
            wanted = ("optimal", "manual", "flat_out") if self.driver is None else ("optimal", self.driver)
            chosen = [name for name in wanted if name in drivers]
            self.drivers = ui.select(drivers, value=chosen, label=_("Drivers"), multiple=True)
            self.drivers.props("outlined dense options-dense use-chips")
            self.form.problem.beside("drivers", self.drivers).props('data-test="drivers"')
            self.form.problem.beside("driver", self.drivers)
            self.seeds = form.number_field(CompareIn, "seeds", label=_("Seeds of each driver"), step=1)
            self.form.problem.beside("seeds", self.seeds)
            self.disturbances.build(self.form.problem)
            with ui.element("div").classes("mp-row"):
                parts.ActionButton(_("Compare"), on_click=self.start).props('unelevated data-test="compare"')
                self.cancel = parts.ActionButton(_("Stop"), on_click=self.stop).props("outline")
            self.status = ui.label("").classes("mp-soft").props('aria-live=polite data-test="status"')
        with ui.element("div").classes("mp-col"):
            with parts.card(_("What the next second costs")):
                self.words = (
                    ui.label(_("Computing the front …")).classes("mp-soft").props('data-test="second"')
                )
                self.front_plot = parts.plot(blank(380))
                self.front_plot.props('data-test="front"')
            with parts.card(_("Drivers against each other")):
                self.result = ui.element("div").classes("mp-stack").props('data-test="result"')
                with self.result:
                    parts.empty(_("Choose drivers and press Compare."))

    async def load(self) -> None:
        """Load the form of the linked run, then the section; runs once the page is connected."""
        wrong = None
        try:
            if self.job:
                self.restore(self.service.store.job(self.job))
        except MetropilotError as error:
            wrong = error
        await self.form.load()
        if wrong is not None:
            self.form.problem.show(wrong)
        elif self.job:
            self.watch()

    def restore(self, row: JobRow) -> None:
        """Fill the form with the request of a comparison.

        Raises:
            MetropilotError: No comparison, or its line, station or trainset does not exist any more.
        """
        if row.kind != "compare":
            raise Refused(f"the job is a {row.kind}, no comparison", 404, field="id", value=row.id)
        body = row.request
        self.form.restore(body)
        self.disturbances.restore(body)
        self.seeds.value = body["seeds"]
        chosen = {
            name: form.driver_choice(
                self.service, self.drivers, name, body["options"] if name == body["driver"] else {}
            )
            for name in body["drivers"]
        }
        self.drivers.value = list(chosen.values())
        driver = chosen.get(body["driver"], body["driver"])
        self.options = {"driver": driver, "options": form.other_options(body["options"])}

    async def load_front(self) -> None:
        """Compute the front of the section."""
        with self.form.problem.show_errors():
            self.front = await self.service.front(self.form.plan_request(None))
            await self.move_cursor()

    def entries_on_front(self) -> list[dict[str, Any]]:
        """Drives of the section and objective of the front."""
        plain = {"objective": "wheel", "restrictions": []}
        here = {**plain, **self.form.kept, **self.form.values(), "time_s": self.driven.get("time_s")}
        same = all(self.driven.get(name) == value for name, value in here.items())
        return self.entries if same else []

    async def move_cursor(self) -> None:
        """Update the cursor on the front, at the time of the slider."""
        if self.front is None:
            return
        self.wanted_s = self.form.values()["time_s"]
        if self.planning:
            return
        self.planning = True
        try:
            while (now := self.wanted_s) is not None:
                self.wanted_s = None
                with self.form.problem.show_errors():
                    self.say_second(now, await self.service.plan(self.form.plan_request(now)))
        finally:
            self.planning = False

    def say_second(self, now: float, plan: dict[str, Any]) -> None:
        """Show the optimum at a running time, and its slope."""
        energy, second = plan["energy_j"] / J_PER_KWH, plan["second_w"] / 3600
        gap = max(100 * plan["certificate_gap"], 0.001)
        self.words.text = _(
            "At {time} s the optimum needs {energy} kWh at the wheel (certified within {gap} %). "
            "The next second saves {second} Wh, {share} %.",
            time=f"{now:.0f}",
            energy=f"{energy:.2f}",
            gap=f"{gap:.3f}",
            second=f"{second:.0f}",
            share=number(excess_percent(plan["energy_j"] + plan["second_w"], plan["energy_j"]), 1),
        )
        if self.front is not None:
            self.front_plot.update_figure(front_figure(self.front, (now, energy), self.entries_on_front()))

    async def start(self) -> None:
        """Queue the comparison."""
        with self.form.problem.show_errors():
            await self.form.wait_for_section()
            values = {**self.form.kept, **self.form.values(), **self.disturbances.values()}
            drivers = list(self.drivers.value or [])
            values |= {"drivers": drivers, "seeds": self.seeds.value, "driver": (drivers or ["optimal"])[0]}
            if self.form.linked and self.options.get("driver") in drivers:
                values |= self.options
            body = form.validate(CompareIn, values)
            self.job = self.service.submit(body)
            ui.run_javascript(f"history.replaceState(null, '', '/compare?job={self.job}')")
            self.watch()

    def watch(self) -> None:
        """Follow the job until it is over."""
        self.going = True
        self.status.text = _("queued")
        parts.refresh_while(lambda: self.going, POLL_S, self.look)

    async def look(self) -> None:
        """Show the progress of the job, or its result."""
        try:
            row = self.service.store.job(self.job or "")
        except MetropilotError as error:
            self.going = False
            self.form.problem.show(error)
            return
        said = {"queued": "queued", "running": f"{row.progress:.0%} · {row.words}", "done": "done"}
        self.status.text = retell(said.get(row.status, f"{row.status}: {row.words}"))
        if row.status in {"queued", "running"}:
            return
        self.going = False
        found = self.service.store.result(row.id) if row.status == "done" else None
        if found is not None:
            self.entries, self.driven = found["entries"], self.resolve(row.request)
            await self.show()

    def resolve(self, body: dict[str, Any]) -> dict[str, Any]:
        """Request with station codes and the name of the load, as in the form."""
        line = catalogue.line(self.service, body["line"])
        load = body["load"] or catalogue.trainset_out(self.service, body["trainset"])["load"]
        codes = {name: line.station(body[name]).code for name in ("origin", "destination")}
        return {**body, **codes, "load": load}

    async def show(self) -> None:
        """Show table and picture of the comparison."""
        self.result.clear()
        with self.result:
            ends = f"{self.driven['origin']} → {self.driven['destination']}"
            what = f"{self.driven['line']} {ends}, {self.driven['trainset']} {self.driven['load']}"
            ui.label(what).classes("mp-soft").props('data-test="driven"')
            compare_table(self.entries)
            parts.plot(compare_figure(self.entries)).props('data-test="picture"')
            names = ("comparison.json", "comparison.svg", "report.pdf", "run.zip")
            parts.links([(name, f"/api/jobs/{self.job}/files/{name}") for name in names])
        await self.move_cursor()

    def stop(self) -> None:
        """End the comparison."""
        if self.job:
            with self.form.problem.show_errors():
                self.service.stop(self.job)


def compare_table(entries: list[dict[str, Any]]) -> None:
    """Show a row for each driver; the best that met every requirement is bold in each column."""
    sound = [e for e in entries if e["successes"] == e["seeds"]]
    best = {}
    for name, _words, _factor, _digits in SHOWN:
        means = {e["driver"]: e["kpis"][name]["mean"] for e in sound if e["kpis"].get(name)}
        if name not in UNJUDGED and (found := best_of(means, name)) is not None:
            best[name] = found
    rows = []
    for entry in entries:
        cells: list[Any] = [entry["driver"], outcome(entry)]
        for name, _words, factor, digits in SHOWN:
            found = entry["kpis"].get(name)
            words = "–" if found is None else number(factor * found["mean"], digits)
            if found is not None and found["high"] > found["low"]:
                words += (
                    f" ({number(factor * found['low'], digits)} … {number(factor * found['high'], digits)})"
                )
            cells.append((words, "best") if best.get(name) == entry["driver"] else words)
        rows.append(cells)
    columns = (_("driver"), _("outcome"), *(_(words) for _name, words, _factor, _digits in SHOWN))
    parts.table(columns, rows, right=range(2, len(columns)), name=_("Comparison"))
    note = _(
        "Time and stop are errors; gap: energy above the optimum for the time achieved, split into what "
        "the trainset's actuation costs under protection and what the driver adds. "
        "Bold: best of the drivers that met every requirement."
    )
    seeds = all(e["seeds"] == 1 for e in entries)
    note += "" if seeds else " " + _("In brackets: 95 % interval over the seeds.")
    ui.label(note).classes("mp-soft")


def outcome(entry: dict[str, Any]) -> tuple[str, str]:
    """Outcome of the drives of one driver, and its style."""
    if entry["successes"] == entry["seeds"]:
        return (_("✓ on time"), "mp-pass")
    ended = entry.get("ended", entry["outcomes"])
    said = {retell(words): ended.count(words) for words in dict.fromkeys(ended)}
    return ("✗ " + ", ".join(f"{n} {w}" if entry["seeds"] > 1 else w for w, n in said.items()), "mp-fail")


def install(service: Service) -> None:
    """Register the page."""

    @ui.page("/compare", title="Compare · metropilot")
    async def compare(
        request: Request,
        job: str | None = None,
        driver: str | None = None,
        line: str | None = None,
        trainset: str | None = None,
    ) -> None:
        with parts.frame(request, "/compare"):
            page = ComparePage(service, job, driver)
            page.build()
        await ui.context.client.connected()
        with page.form.problem.show_errors():
            page.form.choose(line, trainset)
            await page.load()

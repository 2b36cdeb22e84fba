"""Line: a line in operation, its energy by driving and timetable beside its floor, over the headway."""

from __future__ import annotations

from typing import Any

from fastapi import Request
from nicegui import events, ui

from metropilot._schema import field_specs
from metropilot.errors import MetropilotError
from metropilot.operation import OperationOptions, saved_and_gap_percent
from metropilot.web import catalogue
from metropilot.web.errors import Refused, error_of
from metropilot.web.live.session import GOING
from metropilot.web.pages import frame as parts
from metropilot.web.pages.form import FoldedNumbers, loads, number_field, validate
from metropilot.web.pages.numbers import Slider
from metropilot.web.pages.plots import headways_figure, operation_figure
from metropilot.web.pages.running import RunningCard
from metropilot.web.schemas.requests import OperationIn
from metropilot.web.service import Service
from metropilot.web.store import JobRow
from metropilot.web.words.language import N_, _
from metropilot.web.words.said import retell
from metropilot.web.words.tables import number

POLL_S = 0.5
SHORTEST_S, LONGEST_S = 60, 900
"""Ends of the slider; the field beside it takes every headway."""
SWEEP_S = (90, 120, 180, 240, 300, 450, 600)
FIELDS = tuple(name for name in field_specs(OperationOptions) if name not in {"headway_s", "zones"})
LISTED = 300
"""Newest jobs among which those with the same settings are looked for."""
ROWS = (
    (N_("cruise and brake"), N_("plain, mean offset"), "cruise_kwh"),
    (N_("optimal driving"), N_("plain, mean offset"), "driving_only_kwh"),
    (N_("cruise and brake"), N_("best found"), "timetable_only_kwh"),
    (N_("optimal driving"), N_("best found"), "energy_kwh"),
    (N_("floor"), N_("any"), "floor_kwh"),
    (N_("floor, all received"), N_("any"), "all_received_floor_kwh"),
)


class OperationPage:
    """State of the page for one browser.

    Attributes:
        found: Jobs with a result and its values, by headway, for the settings of the form.
        results: Results of jobs that are over, as far as they were read.
        jobs: Jobs of this page that are not over.
        dragged: The one of them that the slider asked for last.
        drawn: What the curve over the headway shows.
        shown: Job that is shown.
        filling: True while the page itself changes its fields.
    """

    def __init__(self, service: Service, job: str | None, run: str | None = None) -> None:
        self.service = service
        self.running = RunningCard(service, run, self.running_values)
        self.job = job
        self.found: dict[int, tuple[str, dict[str, Any]]] = {}
        self.results: dict[str, dict[str, Any]] = {}
        self.jobs: list[str] = []
        self.dragged = ""
        self.drawn: object = None
        self.shown: tuple[str, int] | None = None
        self.filling = True

    def build(self) -> None:
        """Build the fields on the left and the results on the right."""
        lines = {row["id"]: row["name"] for row in catalogue.line_rows(self.service)}
        trainsets = {row["id"]: row["name"] for row in catalogue.trainset_rows(self.service)}
        self.feedings = catalogue.feeding_rows(self.service)
        with (
            ui.element("div").classes("mp-col"),
            parts.card(
                _("Line in operation"),
                _("All trains of a line: their energy, and the floor that none undercuts."),
            ),
        ):
            self.problem = parts.Problem()
            first = "dkz32" if "dkz32" in trainsets else next(iter(trainsets))
            fields: dict[str, ui.select] = {
                "line": ui.select(lines, value="yizhuang", label=_("Line"), on_change=self.change_line),
                "trainset": ui.select(
                    trainsets, value=first, label=_("Trainset"), on_change=self.change_trainset
                ),
                "load": ui.select(loads(self.service, first), label=_("Load"), on_change=self.change),
                "day": ui.select(
                    {"": _("One headway")}, value="", label=_("Timetable"), on_change=self.change
                ),
                "feeding": ui.select({"": _("Zones")}, value="", label=_("Feeding"), on_change=self.change),
            }
            fields["load"].value = next(iter(fields["load"].options))
            self.fields = fields
            for name, element in fields.items():
                self.problem.beside(name, element.props("outlined dense options-dense"))
            with ui.element("div").classes("mp-stack") as self.periodic:
                self.slider = Slider(
                    min=SHORTEST_S, max=LONGEST_S, step=5, value=180, on_change=self.drag
                ).props('label data-test="headway"')
                self.slider.props(parts.prop_of("aria-label", _("Headway in seconds")))
                self.slider.on("change", self.release)
                self.headway = number_field(OperationIn, "headway_s")
                # not on every change of its value: those that the slider makes come back late
                self.headway.on("change", self.type_headway)
                self.problem.beside("headway_s", self.headway)
            self.zones = number_field(OperationIn, "zones", on_change=self.change)
            self.problem.beside("zones", self.zones)
            self.more = FoldedNumbers(OperationIn, _("Dwells, windows, messages, losses"), FIELDS)
            self.more.build(self.problem, self.change)
            self.optimise = ui.checkbox(
                _("Search dwells and running times too (minutes)"), on_change=self.change
            )
            self.seed = number_field(OperationIn, "seed", label=_("Seed of the search"), step=1)
            self.problem.beside("seed", self.seed)
            self.seed.bind_visibility_from(self.optimise, "value")
            with ui.element("div").classes("mp-row"):
                parts.ActionButton(_("Compute"), on_click=self.start).props('unelevated data-test="compute"')
                self.sweep_button = parts.ActionButton(_("Sweep headways"), on_click=self.sweep).props(
                    'outline data-test="sweep"'
                )
                parts.ActionButton(_("Stop"), on_click=self.stop).props('outline data-test="stop"')
            self.status = ui.label("").classes("mp-soft").props('aria-live=polite data-test="status"')
        with ui.element("div").classes("mp-col"):
            with parts.card():
                self.result = ui.element("div").classes("mp-stack").props('data-test="result"')
            self.running.build()
            with parts.card(_("Over the headway")) as self.curve_card:
                self.curve = parts.plot(headways_figure({}, 180.0)).props('data-test="curve"')
        self.fill_names()

    def fill_names(self) -> None:
        """Offer the days and feedings of the line."""
        line = self.fields["line"].value
        found = catalogue.line(self.service, line)
        name, sections = found.id, len(found.stations) - 1
        usual = OperationIn.model_fields["zones"].get_default()
        self.zones.usual = self.zones.value = min(usual, sections)
        self.zones.props(parts.prop_of("hint", _("{least} to {most}", least=1, most=sections)))
        days = {row["id"]: row["name"] for row in catalogue.day_rows() if row["line"] == name}
        fed = {row["id"]: row["name"] for row in self.feedings if line in row["lines"]}
        self.fields["day"].set_options({"": _("One headway"), **days}, value="")
        self.fields["feeding"].set_options({"": _("Zones, no network"), **fed}, value="")
        self.running.fill_stations(line)

    def request(self, headway_s: float | None = None) -> OperationIn:
        """Request of the fields.

        Raises:
            InputError: A field is not allowed.
        """
        values = {name: element.value or None for name, element in self.fields.items()}
        values |= self.more.values() | {"zones": self.zones.value, "optimise": self.optimise.value}
        values |= {"seed": self.seed.value, "headway_s": headway_s or self.headway.value}
        return validate(OperationIn, values)

    def running_values(self) -> dict[str, Any]:
        """Fields of a running line; day, network and search are those of the computation only."""
        return self.request().model_dump(exclude={"day", "feeding", "optimise", "seed"})

    def change_line(self) -> None:
        """Offer what belongs to the line."""
        if not self.filling:
            with parts.set_quietly(self):
                self.fill_names()
            self.change()

    def change_trainset(self) -> None:
        """Offer the loads of the trainset."""
        if not self.filling:
            aboard = loads(self.service, self.fields["trainset"].value)
            with parts.set_quietly(self):
                self.fields["load"].set_options(aboard, value=next(iter(aboard)))
            self.change()

    def change(self) -> None:
        """Show what is computed for other settings."""
        if self.filling:
            return
        day = bool(self.fields["day"].value)
        for element in (self.periodic, self.sweep_button, self.curve_card):
            element.set_visibility(not day)
        with self.problem.show_errors():
            self.find()
            self.show()

    def drag(self) -> None:
        """Show the headway of the slider, if it is computed."""
        if not self.filling:
            with parts.set_quietly(self):
                self.headway.value = self.slider.value
            self.show()

    def type_headway(self) -> None:
        """Move the slider to the headway of the field."""
        if self.headway.number is not None:
            with parts.set_quietly(self):
                self.slider.value = min(max(self.headway.number, SHORTEST_S), LONGEST_S)
            self.show()

    def release(self, event: events.GenericEventArguments) -> None:
        """Compute the headway at which the slider was let go, once there is one result.

        One that was dragged to before and still waits is left out.
        """
        # the event is sooner here than the last change of the value, which is slowed down; the slider itself
        # may be further by now and is left where it is
        self.headway.value = event.args
        self.show()
        if not self.found:
            return
        if self.dragged in self.jobs and self.service.store.job(self.dragged).status == "queued":
            self.service.stop(self.dragged)
        before = set(self.jobs)
        self.start()
        self.dragged = next(iter(set(self.jobs) - before), "")

    def start(self) -> None:
        """Compute the headway or the day of the fields."""
        with self.problem.show_errors():
            self.submit(self.request())
            self.find()
            self.show()

    def sweep(self) -> None:
        """Compute all headways of the sweep."""
        with self.problem.show_errors():
            for headway_s in SWEEP_S:
                self.submit(self.request(headway_s))

    def submit(self, body: OperationIn) -> None:
        """Queue a job, unless the same was computed or is under way."""
        values = body.model_dump()
        same = [row for row in self.rows() if row.request == values]
        if any(row.status == "done" or row.id in self.jobs for row in same):
            return
        self.jobs.append(self.service.submit(body))
        self.watch()

    def rows(self) -> list[JobRow]:
        """Newest jobs of lines."""
        return self.service.store.jobs("line", LISTED)

    def find(self) -> None:
        """Find the results for the settings of the form, the newest of each headway."""
        wanted = self.request().model_dump()
        day = wanted["day"] is not None
        self.found = {}
        for row in self.rows():
            headway_s = 0 if day else row.request["headway_s"]
            same = {**row.request, "headway_s": wanted["headway_s"]} == wanted
            if not same or headway_s in self.found or row.status == "queued":
                continue
            found = self.results.get(row.id) or self.service.store.result(row.id)
            if found is not None:
                self.found[headway_s] = row.id, found
            if found is not None and row.status not in GOING:
                self.results[row.id] = found

    def watch(self) -> None:
        """Follow the jobs until they are over."""
        if len(self.jobs) == 1:
            parts.refresh_while(lambda: bool(self.jobs), POLL_S, self.look)

    def look(self) -> None:
        """Show the progress of the jobs, and their results."""
        going = _("queued")
        for job in list(self.jobs):
            try:
                row = self.service.store.job(job)
            except Refused as error:  # it was deleted
                self.jobs.remove(job)
                self.problem.show(error)
                continue
            if row.status not in GOING:
                self.jobs.remove(job)
                if row.status == "failed":
                    self.fail(row)
            elif row.status == "running":
                going = f"{self.name(row)}: {row.progress:.0%} · {retell(row.words)}"
                if len(self.jobs) > 1:
                    going += ", " + _("{count} more", count=len(self.jobs) - 1)
        self.status.text = going if self.jobs else ""
        try:
            self.find()
        except MetropilotError:
            return  # a field that is being typed
        self.show()

    def fail(self, row: JobRow) -> None:
        """Show why a job failed."""
        told = row.error or {"message": row.words}
        if len(self.jobs):
            ui.notify(f"{self.name(row)}: {retell(told['message'])}", type="warning")
        else:
            self.problem.show(error_of(told))

    @staticmethod
    def name(row: JobRow) -> str:
        """Name of what a job computes."""
        return row.request["day"] or _("every {headway} s", headway=row.request["headway_s"])

    def stop(self) -> None:
        """Stop every job of this page."""
        with self.problem.show_errors():
            for job in self.jobs:
                self.service.stop(job)

    def show(self) -> None:
        """Show the result of the headway or day of the fields."""
        day = bool(self.fields["day"].value)
        at = 0 if day else round(self.headway.number or 0)
        if not day:
            self.draw_curve(float(at))
        job, found = self.found.get(at, ("", None))
        now = job, 0 if found is None else len(found["files"])
        if now == self.shown and found is not None:
            return
        self.shown = now
        self.result.clear()
        with self.result:
            if found is None:
                what = _("This day is not computed for these settings. Press Compute.")
                if not day:
                    what = _(
                        "A headway of {headway} is not computed for these settings. Press Compute.",
                        headway=number(float(at), 0, "s"),
                    )
                parts.empty(what)
                return
            with_run = f"&run={self.running.run}" if self.running.run else ""
            ui.run_javascript(f"history.replaceState(null, '', '/line?job={job}{with_run}')")
            self.show_energies(found, day=day)
            parts.links([(name, f"/api/jobs/{job}/files/{name}") for name in self.files(found)])

    def draw_curve(self, headway_s: float) -> None:
        """Draw the energies over the headway, where they or the cursor have changed."""
        now = {h: job for h, (job, _) in self.found.items()}, headway_s
        if now != self.drawn:
            self.drawn = now
            energies = {h: found["energies"] for h, (_job, found) in self.found.items()}
            self.curve.update_figure(headways_figure(energies, headway_s))

    @staticmethod
    def files(found: dict[str, Any]) -> list[str]:
        """Names of the files of a result, and of all of them together."""
        return [*found["files"], "run.zip"] if found["files"] else []

    def show_energies(self, found: dict[str, Any], *, day: bool) -> None:
        """Show numbers, train graph and energies."""
        told, least = found["energies"], found["bottleneck"]
        unit = _("kWh a day") if day else _("kWh a round trip")
        parts.heading(
            told["day"]
            if day
            else _("{line}, every {headway} s", line=told["line"], headway=told["headway_s"])
        )
        network = told["feeding"].get("network")
        bounds = told["cruise_kwh"], told["floor_kwh"]
        items = [
            (_("energy"), number(told["energy_kwh"], 1, "kWh"), ""),
            (_("floor"), number(told["floor_kwh"], 1, "kWh"), ""),
            (_("gap"), number(told["gap_percent"], 2, "%"), ""),
            (_("saved by both"), number(saved_and_gap_percent(told["energy_kwh"], *bounds)[0], 1, "%"), ""),
            (_("trains"), str(told["fleet"]), ""),
            (
                (_("highest minute"), number(told["peak_minute_w"] / 1e6, 1, "MW"), "")
                if least is None
                else (_("technical headway"), number(least["headway_s"], 1, "s"), "")
            ),
        ]
        parts.reads(items)
        parts.plot(operation_figure(found["graph"], day=day)).props('data-test="graph"')
        rows = [
            (
                _(driving),
                _(timetable),
                number(told[name], 1),
                *(number(each, 2) for each in saved_and_gap_percent(told[name], *bounds)),
            )
            for driving, timetable, name in ROWS
            if name in told
        ]
        parts.table(
            (_("driving"), _("timetable"), unit, _("saved %"), _("gap %")),
            rows,
            right=(2, 3, 4),
            name=_("Energies"),
        )
        words = [
            _(
                "Of {returned} kWh that braking trains return, {unreceived} reach no other train.",
                returned=f"{told['returned_kwh']:.1f}",
                unreceived=f"{told['unreceived_kwh']:.1f}",
            )
        ]
        if least is not None:
            words.append(
                _(
                    "Least technical headway {headway} s, at {kind} {name}, {direction}.",
                    headway=f"{least['headway_s']:.1f}",
                    kind=retell(least["kind"]),
                    name=least["name"],
                    direction=retell(least["direction"]),
                )
            )
        if network is not None:
            words.append(
                _(
                    "Feeding {network}: {energy} kWh; rails lose {rails}, substations {substations}; lowest "
                    "voltage {voltage} V, peak of all substations {peak} MW.",
                    network=network["id"],
                    energy=f"{network['energy_kwh']:.1f}",
                    rails=f"{network['rail_loss_kwh']:.1f}",
                    substations=f"{network['substation_loss_kwh']:.1f}",
                    voltage=f"{network['lowest_v']:.0f}",
                    peak=f"{network['peak_w'] / 1e6:.1f}",
                )
            )
        ui.label(" ".join(words)).classes("mp-soft").props('data-test="words"')

    def load(self) -> None:
        """Fill the form with the linked job or run and follow it; runs once the page is connected."""
        lost = None
        try:
            row = self.running.load()
            if self.job:
                self.restore(self.service.store.job(self.job))
            elif row is not None:
                self.restore_service(row.request)
        except MetropilotError as error:
            lost = error
        self.filling = False
        self.change()
        if lost is not None:  # not before: what changes clears the errors
            self.problem.show(lost)

    def restore(self, row: JobRow) -> None:
        """Fill the form with the request of a job.

        Raises:
            MetropilotError: No job of a line, it failed, or its line or trainset does not exist any more.
        """
        if row.kind != "line":
            raise Refused(f"the job is a {row.kind}, no line in operation", 404, field="id", value=row.id)
        body = row.request
        self.restore_service(body)
        self.fields["day"].value, self.fields["feeding"].value = body["day"] or "", body["feeding"] or ""
        self.optimise.value, self.seed.value = body["optimise"], body["seed"]
        if row.status in GOING:
            self.jobs.append(row.id)
            self.watch()
        elif row.error is not None:
            raise error_of(row.error)

    def restore_service(self, body: dict[str, Any]) -> None:
        """Fill in line, trainset, headway and options.

        Raises:
            MetropilotError: The line or trainset does not exist any more.
        """
        catalogue.line(self.service, body["line"])
        aboard = loads(self.service, body["trainset"])
        self.fields["line"].value, self.fields["trainset"].value = body["line"], body["trainset"]
        self.fields["load"].set_options(aboard, value=body["load"] or next(iter(aboard)))
        self.fill_names()
        self.headway.value, self.zones.value = body["headway_s"], body["zones"]
        self.slider.value = min(max(body["headway_s"], SHORTEST_S), LONGEST_S)
        self.more.restore(body)


def install(service: Service) -> None:
    """Register the page."""

    @ui.page("/line", title="Line · metropilot")
    async def line(request: Request, job: str | None = None, run: str | None = None) -> None:
        with parts.frame(request, "/line"):
            page = OperationPage(service, job, run)
            page.build()
        await ui.context.client.connected()
        page.load()

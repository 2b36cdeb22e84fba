"""Drive: live run with timetable updates and manual driving."""

from __future__ import annotations

import json
import re
from collections.abc import Awaitable
from typing import Any

from fastapi import Request
from fastapi.responses import RedirectResponse
from nicegui import events, ui

from metropilot.errors import InputError, MetropilotError
from metropilot.units import J_PER_KWH, KMH_PER_MPS
from metropilot.web import catalogue, evidence
from metropilot.web.errors import Refused, error_of
from metropilot.web.live.session import Session
from metropilot.web.pages import form, plots
from metropilot.web.pages import frame as parts
from metropilot.web.pages.live_card import AbstractLiveCard
from metropilot.web.pages.moment import MomentSlider
from metropilot.web.pages.runs import RunList
from metropilot.web.pages.strip import line_strip, section_strip
from metropilot.web.schemas.requests import LiveIn, NewArrival, NewRestriction
from metropilot.web.service import RESUMABLE, Service
from metropilot.web.store import JobRow
from metropilot.web.words import tables
from metropilot.web.words.language import N_, _
from metropilot.web.words.said import retell

PACES = {1: N_("real time"), 2: "2 ×", 5: "5 ×", 10: "10 ×", 30: "30 ×"}
READS = (
    (N_("speed"), "–", "speed"),
    (N_("permitted"), "–", "permitted"),
    (N_("to the stop"), "–", "distance"),
    (N_("time"), "–", "time"),
    (N_("scheduled"), "–", "scheduled"),
    (N_("command"), "–", "command"),
    (N_("power at the line"), "–", "power"),
    (N_("energy at the wheel"), "–", "energy"),
    (N_("against the plan"), "–", "against"),
    (N_("protection"), "–", "level"),
)
STRONGEST = 3
"""Features of a decision that are shown."""
TAKEN = ("trajectory.csv", "kpis.json", "explanation.json", "profile.svg", "report.pdf", "run.zip")
KEYS = (
    ("M", N_("take")),
    ("↑ ↓", N_("10 % more, less")),
    ("0", N_("coast")),
    ("B", N_("full brake")),
    ("Esc", N_("give back")),
)


class DrivePage(AbstractLiveCard):
    """State of the page for one browser.

    Args:
        service: Service of the server.
        run: Id of the live run that a link names.
        of_campaign: Campaign and number of the row that a link names.

    Attributes:
        row: Stored row of that run, None without a link.
        lost: Error of a link that cannot be followed.
    """

    idle = N_("no run is under way; depart first")

    def __init__(self, service: Service, run: str | None, of_campaign: tuple[str, str] | None = None) -> None:
        self.service = service
        self.of_campaign = of_campaign
        self.row: JobRow | None = None
        self.lost: MetropilotError | None = None
        try:
            row = service.live_run(run) if run else None
            self.row = row
        except MetropilotError as error:
            self.lost = error
        self.run = None if self.row is None else self.row.id
        self.driver_options = form.DriverOptions()
        self.form = form.SectionForm(service, self.update_section, self.update_plan)
        self.disturbances = form.DisturbanceForm()
        self.wanted_s: float | None = None
        self.planning = False
        self.filling = False

    def build(self) -> None:
        """Build the fields on the left and the results on the right."""
        with ui.element("div").classes("mp-col"):
            with parts.card(_("Run")):
                self.form.build()
                drivers = form.driver_names(self.service)
                first = "optimal" if "optimal" in drivers else next(iter(drivers))
                self.driver = ui.select(drivers, value=first, label=_("Driver")).props(
                    "outlined dense options-dense"
                )
                self.form.problem.beside("driver", self.driver)
                self.driver.on_value_change(self.say_driver)
                self.driver_words = ui.label("").classes("mp-soft").props('data-test="driver-words"')
                self.driver_options.build(self.form.problem)
                self.say_driver()
                self.disturbances.build(self.form.problem, self.follow_plant)
                with ui.element("div").classes("mp-row"):
                    self.build_pace(PACES, 1).props("outlined dense")
                    parts.ActionButton(_("Depart"), icon="play_arrow", on_click=self.depart).props(
                        'unelevated data-test="depart"'
                    )
                    parts.ActionButton(_("Stop"), on_click=self.stop).props('outline data-test="stop"')
                self.departure = parts.Problem()
                self.departure.fields, self.departure.folds = (
                    self.form.problem.fields,
                    self.form.problem.folds,
                )
                self.departure.label.props('data-test="departure-problem"')
            self.build_news()
            RunList(self.service, self.run).build()
        with ui.element("div").classes("mp-col"):
            self.root = ui.element("section").classes("mp-card").props('data-test="live"')
            self.root.props(f"data-status={'none' if self.row is None else self.row.status}")
            with self.root, ui.element("div").classes("mp-stack"):
                self.build_head()
                self.strip = parts.strip(_("Section"))
                parts.reads(READS)
                self.lever()
                self.plot = parts.plot(plots.run_figure()).classes("mp-along")
                ends = f"'c{self.root.id}', {self.plot.id}"
                self.plot.on("plotly_relayout", js_handler=f"(e) => metropilot.drag({ends}, e)")
                self.plot.on("plotly_afterplot", js_handler=f"() => metropilot.arrival({ends})")
                self.root.on("mp-restriction", self.move_restriction, ["detail"])
                self.root.on("mp-arrival", self.move_arrival, ["detail"])
                self.moment = MomentSlider(self.root, self.plot)
                self.build_log(_("News"))
                self.result = ui.element("div").classes("mp-stack").props('data-test="result"')
            self.why = ui.element("div").classes("mp-col")
            with parts.card():
                self.map = parts.strip(_("Whole line"))
            self.root.on("mp-result", self.show_result, ["detail"])
            self.root.on("mp-end", self.show_end, ["detail"])

    def build_head(self) -> None:
        """Build the heading of the run: its status, pause, step, resume."""
        with ui.element("div").classes("mp-row items-center"):
            parts.heading(_("Live run"))
            status = ui.label(self.status_words()).classes("mp-soft")
            status.props('data-mp="status" aria-live=polite')
            ui.label("").classes("mp-soft").props('data-mp="pace"')
            with ui.element("div").classes("mp-paces"):
                pause = parts.ActionButton(_("Pause (space)"), on_click=self.pause)
                pause.props('outline dense data-mp="pause"')
                parts.ActionButton(_("Step 1 s"), on_click=self.step).props('outline dense data-test="step"')
            self.resume_button = parts.ActionButton(_("Resume"), icon="replay", on_click=self.resume)
            self.resume_button.props('outline dense data-test="resume"')
            self.resume_button.set_visibility(self.resumable())

    def say_driver(self) -> None:
        """Show what the chosen driver is, and its options."""
        self.driver_words.text = form.describe_driver(self.driver.value)
        self.driver_options.show(self.driver.value)

    def resumable(self) -> bool:
        """Tell whether the linked run is a live one that can be resumed."""
        return self.row is not None and self.row.kind == "live" and self.row.status in RESUMABLE

    def status_words(self) -> str:
        """Status of the linked run."""
        row = self.row
        if row is None:
            return _("not departed")
        return retell(f"{row.status}: {row.words}" if row.words else row.status)

    def lever(self) -> None:
        """Build the lever of manual driving."""
        with ui.element("div").classes("mp-row items-center"):
            button = parts.ActionButton(_("Take the lever (M)")).props('outline dense no-caps data-mp="take"')
            button.on("click", js_handler="() => metropilot.hand()")
            ui.label(_("the driver has it")).classes("mp-soft").props('data-mp="hand" aria-live=polite')
            with ui.element("div").classes("mp-soft gt-xs"):
                for key, words in KEYS:
                    ui.element("span").classes("mp-key").props["innerText"] = key
                    ui.element("span").props["innerText"] = f" {_(words)}  "
        with ui.element("div").classes("mp-lever"):
            ui.label(_("brake"))
            slider = ui.element("input").props('type=range min=-1 max=1 step=0.05 disabled data-mp="slider"')
            slider.props(parts.prop_of("aria-label", _("Lever")))
            slider.on("input", js_handler="(e) => metropilot.slide(e.target.value)")
            ui.label(_("power")).style("text-align:right")

    def build_news(self) -> None:
        """Build the fields of timetable updates."""
        with parts.card(
            _("During the run"), _("New arrival times and speed restrictions for the driver."), late=True
        ):
            self.news = parts.Problem()
            with ui.element("div").classes("mp-row"):
                self.arrival = form.number_field(
                    NewArrival, "scheduled_time_s", value=101, on_change=self.draw_arrival
                )
                self.news.beside("scheduled_time_s", self.arrival)
                parts.ActionButton(_("Tell"), on_click=self.tell_arrival).props(
                    'outline data-test="tell-arrival"'
                )
            with ui.element("div").classes("mp-row"):
                parts.ActionButton(_("10 s earlier"), on_click=lambda: self.shift(-10)).props(
                    "flat dense no-caps"
                )
                parts.ActionButton(_("10 s later"), on_click=lambda: self.shift(10)).props(
                    "flat dense no-caps"
                )
            with ui.element("div").classes("mp-row"):
                self.from_m = form.number_field(
                    NewRestriction, "from_m", value=700, on_change=self.draw_draft
                )
                self.to_m = form.number_field(NewRestriction, "to_m", value=900, on_change=self.draw_draft)
                self.kmh = form.number_field(NewRestriction, "limit_mps", value=40, on_change=self.draw_draft)
                for name, element in (("from_m", self.from_m), ("to_m", self.to_m), ("limit_mps", self.kmh)):
                    self.news.beside(name, element.props("outlined dense"))
            parts.ActionButton(_("Add speed restriction"), on_click=self.restrict).props(
                'outline data-test="restrict"'
            )

    async def start(self) -> None:
        """Load the form of the linked run, its section and its result; runs once the page is connected."""
        try:
            if self.row is not None:
                self.restore(self.row.request)
            elif self.of_campaign is not None:
                self.restore(self.row_request(*self.of_campaign))
        except MetropilotError as error:
            self.lost = error
        await self.form.load()
        session = self.session()
        if session is not None:
            self.attach(session)
        elif self.row is not None:
            found = self.service.store.result(self.row.id)
            if found is not None:
                self.plot.update_figure(plots.drive_figure(found))
                if self.form.section is not None:
                    self.moment.offer(found, self.form.section["length_m"])
                self.show_why(found)
                self.show_summary(self.row.id, found)
            if self.row.error is not None:
                self.departure.show(error_of(self.row.error))
        if self.lost is not None:
            self.departure.show(self.lost)

    def row_request(self, campaign: str, row: str) -> dict[str, Any]:
        """Request of a row of a campaign.

        Raises:
            MetropilotError: No such campaign or row.
        """
        if not re.fullmatch("[0-9]{1,9}", row):
            raise Refused("no such row", 404, field="row", value=row, allowed="a whole number")
        return evidence.row_request(self.service, campaign, int(row))

    def restore(self, body: dict[str, Any]) -> None:
        """Fill the form with the request of a run.

        Raises:
            InputError: Its line, station or trainset does not exist any more.
        """
        self.form.restore(body)
        with parts.set_quietly(self):
            self.disturbances.restore(body)
        self.driver.value = form.driver_choice(self.service, self.driver, body["driver"], body["options"])
        self.driver_options.show(self.driver.value, form.other_options(body["options"]))
        self.form.kept_words.text = form.describe_hidden(self.form.kept, {})
        session = self.session()
        pace = body.get("pace") if session is None else session.known.pace
        self.pace.value = pace if pace in PACES else self.pace.value

    async def update_section(self) -> None:
        """Draw the new section, except where a live run shows another."""
        self.map.content = line_strip(
            self.form.line, (self.form.origin_in.value, self.form.destination_in.value)
        )
        if self.form.section is not None and (self.live() is None or not self.strip.content):
            self.draw_section(self.form.section, self.form.trainset_in.value)
        if self.live() is None and self.form.section is not None:
            self.arrival.value = self.form.slider.value
            await self.update_plan()

    def draw_section(self, section: dict[str, Any], trainset: str) -> None:
        """Draw the section with its trainset and propose the ends of a restriction."""
        length = catalogue.trainset_out(self.service, trainset)["length_m"]
        self.strip.content = section_strip(section, length)
        end = section["length_m"]
        self.from_m.value, self.to_m.value = round(0.55 * end, -1), round(0.7 * end, -1)

    async def update_plan(self) -> None:
        """Show the plan of the latest time of the slider, while no run is live."""
        self.wanted_s = self.form.time_s
        if self.planning or self.live() is not None or self.form.section is None:
            return
        self.planning = True
        try:
            while (now := self.wanted_s) is not None:
                self.wanted_s = None
                with self.form.problem.show_errors():
                    plan = await self.service.plan(self.form.plan_request(now, self.disturbances.values()))
                    self.disturbances.say_plant(plan)
                    if self.live() is None and self.form.section is not None:
                        told = self.form.restrictions.values()
                        bounds = self.form.time_bounds_s
                        self.plot.update_figure(plots.plan_figure(self.form.section, plan, now, bounds, told))
                        self.moment.close()
                        self.arrival.value = now
        finally:
            self.planning = False

    def follow_plant(self) -> Awaitable[None] | None:
        """Plan anew for another true plant, except while the form is filled."""
        return None if self.filling else self.update_plan()

    async def depart(self) -> None:
        """Start a live run and watch it."""
        with self.departure.show_errors():
            section = await self.form.wait_for_section()
            values = {**self.form.kept, **self.form.values(), **self.disturbances.values()}
            values |= {"driver": self.driver.value, "pace": float(self.pace.value)}
            values |= {"options": self.driver_options.values()}
            body = form.validate(LiveIn, values)
            session = await self.go_live(body)
            self.draw_section(section, body.trainset)
            self.attach(session)

    async def resume(self) -> None:
        """Resume the run of the page."""
        with self.departure.show_errors():
            self.attach(await self.service.resume_live(self.run or ""))

    def attach(self, session: Session) -> None:
        """Connect the browser to the stream of a run."""
        self.result.clear()
        self.why.clear()
        self.news.clear()
        self.resume_button.set_visibility(False)
        self.arrival.value = self.scheduled_s(session)
        with self.result:
            ui.label(_("KPIs, passed and failed, when it has stopped.")).classes("mp-soft")
        ui.run_javascript(f"metropilot.live('c{self.root.id}', {session.id!r}, {self.plot.id})")
        self.draw_draft()

    @staticmethod
    def scheduled_s(session: Session) -> float | None:
        """Scheduled running time in force, s."""
        known = session.known.scheduled_time_s
        return session.request["time_s"] if known is None else known

    async def tell_arrival(self) -> None:
        """Send the arrival time of the field."""
        with self.news.show_errors():
            if self.arrival.value is None:
                raise InputError("a time is needed", field="scheduled_time_s", unit="s")
            body = form.validate(NewArrival, {"scheduled_time_s": self.arrival.value})
            await self.ask({"kind": "arrival", **body.model_dump()})

    async def shift(self, seconds: float) -> None:
        """Send an arrival time that is shifted from the one in force."""
        session = self.live()
        base = self.arrival.value if session is None else self.scheduled_s(session)
        self.arrival.value = (base or 0) + seconds
        await self.tell_arrival()

    def draw_draft(self) -> None:
        """Draw the restriction of the fields, which is not sent yet, on the plot of a live run."""
        place = [self.from_m.number, self.to_m.number, self.kmh.number]
        if None not in place:
            ui.run_javascript(f"metropilot.draft({json.dumps(place)})")

    def draw_arrival(self) -> None:
        """Draw the arrival time of the field, which is not sent yet, on the plot of a live run."""
        if self.live() is not None:
            ui.run_javascript(f"metropilot.arrive({json.dumps(self.arrival.number)})")

    def move_arrival(self, event: events.GenericEventArguments) -> None:
        """Write an arrival that was dragged on the plot into the field of a live run, or the form."""
        wanted = round(float(event.args["detail"]))
        if self.live() is not None:
            self.arrival.value = max(wanted, 1)
        else:
            least, most = self.form.time_bounds_s
            self.form.slider.value = min(max(wanted, least), most)

    async def move_restriction(self, event: events.GenericEventArguments) -> None:
        """Write a restriction that was dragged on the plot into its fields."""
        told = event.args["detail"]
        place = {name: float(told[name]) for name in ("from_m", "to_m", "limit_mps")}
        if told["row"] is None:
            self.from_m.value, self.to_m.value, self.kmh.value = place.values()
        else:
            await self.form.move_restriction(int(told["row"]), place)

    async def restrict(self) -> None:
        """Send the temporary speed restriction of the fields."""
        with self.news.show_errors():
            values = {
                "from_m": self.from_m.value,
                "to_m": self.to_m.value,
                "limit_mps": (self.kmh.value or 0) / KMH_PER_MPS,
            }
            body = form.validate(NewRestriction, values)
            await self.ask({"kind": "restriction", **body.model_dump()})

    async def change_pace(self) -> None:
        """Send the pace to the live run."""
        pace = float(self.pace.value)
        with self.departure.show_errors():
            session = self.session()
            if session is None or session.known.pace != pace:
                await self.send_pace(pace)

    async def pause(self) -> None:
        """Pause the run, or let it go on at the pace of the field."""
        with self.departure.show_errors():
            session = self.live()
            paused = session is not None and session.known.pace == 0
            await self.ask({"kind": "pace", "pace": float(self.pace.value) if paused else 0.0})

    async def step(self) -> None:
        """Pause the run and simulate a second of it."""
        with self.departure.show_errors():
            await self.ask({"kind": "step"})

    async def stop(self) -> None:
        """End the run."""
        with self.news.show_errors():
            await self.under_way().stop()

    def show_summary(self, run: str, found: dict[str, Any]) -> None:
        """Show requirements, KPIs and files of a run."""
        self.result.clear()
        with self.result:
            checks_table(found["checks"])
            kpis_table(found["kpis"])
            parts.links([(name, f"/api/jobs/{run}/files/{name}") for name in TAKEN])

    def show_end(self, event: events.GenericEventArguments) -> None:
        """Show the end of the run: a button to resume it, or the reason of its failure."""
        del event
        session = self.session()
        if session is None:
            return
        self.resume_button.set_visibility(session.known.status in RESUMABLE)
        if session.known.status == "failed":
            self.departure.show(session.failure())
        found = self.service.store.result(session.id)
        if found is not None:
            self.show_why(found)

    def show_why(self, found: dict[str, Any]) -> None:
        """Show the reasons of a finished run; one of an earlier version has none."""
        self.why.clear()
        if found.get("explanation") is not None:
            with self.why:
                explanation_card(found)


def explanation_card(driven: dict[str, Any]) -> None:
    """Show why a drive went as it did: regimes, what bound it, interventions, loss by regime."""
    told, kpis = driven["explanation"], driven["kpis"]
    with parts.card(_("Why does it drive so?")):
        ui.label(tables.explain_words(told, kpis)).classes("mp-soft").props('data-test="why"')
        with ui.element("div").classes("mp-links"):
            for regime, colour in plots.REGIME_COLOURS.items():
                ui.label(retell(regime)).classes("mp-swatch").style(f"--mp-swatch: {colour}")
        parts.plot(plots.explanation_figure(driven)).classes("mp-along").props('data-test="explanation"')
        parts.table(*tables.regime_table(told), right=(4, 5, 6), name=_("Regimes"))
        if told["interventions"]:
            parts.table(*tables.hit_table(told), right=(3, 4, 5), name=_("Interventions"))
        show_prices(told.get("prices", []))
        show_decisions(told.get("decisions", []))
        ui.label(
            _(
                "Trainset and driver: energy (kWh) lost in the regime against the optimal plan, to jerk "
                "limit, dead time, lag and protection, and to the driver; kinetic energy that is left counts "
                "as kept."
            )
        ).classes("mp-soft")


def show_prices(prices: list[dict[str, Any]]) -> None:
    """Show what a second more or less was worth at moments of a drive."""
    if not prices:
        return
    rows = [
        (
            tables.number(price["position_m"], 0),
            tables.number(price["time_s"], 1),
            tables.number(price["second_w"] / J_PER_KWH, 3),
            tables.number(price["later_j"] / J_PER_KWH, 3),
            _("not possible")
            if price["sooner_j"] is None
            else tables.number(price["sooner_j"] / J_PER_KWH, 3),
        )
        for price in prices
    ]
    columns = (
        _("place (m)"),
        _("time (s)"),
        _("price (kWh/s)"),
        _("+1 s saves (kWh)"),
        _("−1 s costs (kWh)"),
    )
    with ui.element("div").classes("mp-gridbox w-full").props("tabindex=0"):
        parts.table(columns, rows, right=range(5), name=_("Worth of a second"))
    ui.label(
        _(
            "Worth of a second: energy of the optimal plan from that position and speed to the stop, if it "
            "arrives a second later or sooner than the drive. While it can only coast and brake, a second "
            "more saves nothing."
        )
    ).classes("mp-soft")


def show_decisions(decisions: list[dict[str, Any]]) -> None:
    """Show the strongest features of a learned driver at moments of a drive."""
    if not decisions:
        return
    rows = [
        (
            tables.number(decision["position_m"], 0),
            tables.number(decision["time_s"], 1),
            tables.number(decision["output"] - decision["usual"], 2),
            "; ".join(
                f"{retell(share['words'])} {'+' * (share['share'] >= 0)}{tables.number(share['share'])}"
                for share in decision["shares"][:STRONGEST]
            ),
        )
        for decision in decisions
    ]
    columns = (_("place (m)"), _("time (s)"), _("in all"), _("strongest features"))
    with ui.element("div").classes("mp-gridbox w-full").props("tabindex=0"):
        parts.table(columns, rows, right=(0, 1, 2), name=_("Strongest features"))
    ui.label(
        _(
            "Strongest features of the learned driver: how far each speaks for {meaning} (negative: against "
            "it), compared with what the driver saw on the average of this drive.",
            meaning=retell(decisions[0]["meaning"]),
        )
    ).classes("mp-soft")


def checks_table(checks: list[dict[str, Any]]) -> None:
    """Show the requirements, passed or failed."""
    rows = [
        (*texts, (_("✓ passed"), "mp-pass") if passed else (_("✗ failed"), "mp-fail"))
        for *texts, passed in tables.check_rows(checks)
    ]
    parts.table((_("requirement"), _("measured"), _("allowed"), ""), rows, right=(1,), name=_("Requirements"))


def kpis_table(k: dict[str, Any]) -> None:
    """Show the main KPIs."""
    parts.table((_("KPI"), _("value"), ""), tables.translate_kpis(k), right=(1,), name=_("KPIs"))


def install(service: Service) -> None:
    """Register the page."""

    @ui.page("/", title="Drive · metropilot")
    async def drive(
        request: Request,
        run: str | None = None,
        line: str | None = None,
        trainset: str | None = None,
        campaign: str | None = None,
        row: str = "0",
    ) -> RedirectResponse | None:
        page = DrivePage(service, run, None if campaign is None else (campaign, row))
        if page.row is not None and not catalogue.page_of(page.row).startswith("/?"):
            return RedirectResponse(catalogue.page_of(page.row))
        with parts.frame(request, "/"):
            page.build()
        await ui.context.client.connected()
        with page.departure.show_errors():
            page.form.choose(line, trainset)
            await page.start()
        return None

"""Drive: a live run, told news on the way, taken over by hand."""

from __future__ import annotations

from typing import Any

from fastapi import Request
from nicegui import events, ui
from pydantic import ValidationError

from metropilot.errors import InputError, MetropilotError
from metropilot.web import catalogue
from metropilot.web.asked import LiveAsked, NewRestriction, PlanAsked
from metropilot.web.pages.form import DisturbanceForm, SectionForm, driver_names
from metropilot.web.pages.frame import Problem, card, frame, links, number, reads, table
from metropilot.web.pages.plots import planned_run, run_figure
from metropilot.web.pages.strip import line_strip, section_strip
from metropilot.web.refused import Refused
from metropilot.web.service import Service

PACES = {1: "real time", 2: "2 ×", 5: "5 ×", 10: "10 ×", 30: "30 ×"}
READS = (
    ("speed", "–", "speed"),
    ("permitted", "–", "permitted"),
    ("to the stop", "–", "distance"),
    ("time", "–", "time"),
    ("scheduled", "–", "scheduled"),
    ("command", "–", "command"),
    ("power at the line", "–", "power"),
    ("energy at the wheel", "–", "energy"),
    ("against the plan", "–", "against"),
    ("protection", "–", "level"),
)
KEYS = (("M", "take"), ("↑ ↓", "10 % more, less"), ("0", "coast"), ("B", "full brake"), ("Esc", "give back"))


def validated(kind: type[Any], values: dict[str, Any]) -> Any:  # noqa: ANN401 (the model's instance)
    """A request's body, refused in the API's words.

    Raises:
        InputError: A field is not allowed.
    """
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(first["msg"], field=str(first["loc"][0]), value=str(first["input"])) from None


class DrivePage:
    """The page's state for one browser."""

    def __init__(self, service: Service, run: str | None) -> None:
        self.service = service
        self.run = run if run in service.sessions else None
        self.form = SectionForm(service, self.section_changed, self.time_moved)
        self.disturbances = DisturbanceForm()
        self.wanted_s: float | None = None
        self.planning = False

    def build(self) -> None:
        """Left what is asked, right what happens."""
        with ui.element("div").classes("mp-col"):
            with card("Run"):
                self.form.build()
                drivers = driver_names()
                first = "optimal" if "optimal" in drivers else next(iter(drivers))
                self.driver = ui.select(drivers, value=first, label="Driver").props(
                    "outlined dense options-dense"
                )
                self.form.problem.beside("driver", self.driver)
                self.disturbances.build(self.form.problem)
                with ui.element("div").classes("mp-row"):
                    self.pace = ui.select(PACES, value=1, label="Pace", on_change=self.change_pace)
                    self.pace.props("outlined dense")
                    ui.button("Depart", icon="play_arrow", on_click=self.depart).props(
                        'unelevated data-test="depart"'
                    )
                    self.stop_button = ui.button("Stop", on_click=self.stop).props("outline")
            self.build_news()
        with ui.element("div").classes("mp-col"):
            with card():
                self.map = ui.html("").classes("mp-strip")
            self.root = ui.element("section").classes("mp-card").props('data-test="live" data-status="none"')
            with self.root, ui.element("div").classes("mp-stack"):
                with ui.element("div").classes("mp-row items-center"):
                    ui.label("Live run").classes("mp-h").props("role=heading aria-level=2")
                    ui.label("not departed").classes("mp-soft").props('data-mp="status" aria-live=polite')
                    ui.label("").classes("mp-soft").props('data-mp="pace"')
                self.strip = ui.html("").classes("mp-strip")
                reads(READS)
                self.lever()
                self.plot = ui.plotly(run_figure()).classes("mp-plot")
                ui.element("ul").classes("mp-log").props('data-mp="log" aria-live=polite aria-label="News"')
                self.result = ui.element("div").classes("mp-stack").props('data-test="result"')
            self.root.on("mp-result", self.show_result, ["detail"])

    def lever(self) -> None:
        """The lever: take it, move it, give it back."""
        with ui.element("div").classes("mp-row items-center"):
            button = ui.button("Take the lever (M)").props('outline dense no-caps data-mp="take"')
            button.on("click", js_handler="() => metropilot.hand()")
            ui.label("the driver has it").classes("mp-soft").props('data-mp="hand" aria-live=polite')
            with ui.element("div").classes("mp-soft gt-xs"):
                for key, words in KEYS:
                    ui.element("span").classes("mp-key").props["innerText"] = key
                    ui.element("span").props["innerText"] = f" {words}  "
        with ui.element("div").classes("mp-lever"):
            ui.label("brake")
            slider = ui.element("input").props(
                'type=range min=-1 max=1 step=0.05 value=0 disabled data-mp="slider" aria-label="Lever"'
            )
            slider.on("input", js_handler="(e) => metropilot.slide(e.target.value)")
            ui.label("power").style("text-align:right")

    def build_news(self) -> None:
        """What the driver can be told on the way."""
        with card("On the way", "What the driver is told while it drives.", late=True):
            self.news = Problem()
            with ui.element("div").classes("mp-row"):
                self.arrival = ui.number("Arrive after (s)", value=101, min=1, step=1).props("outlined dense")
                self.news.beside("scheduled_time_s", self.arrival)
                ui.button("Tell", on_click=self.tell_arrival).props('outline data-test="tell-arrival"')
            with ui.element("div").classes("mp-row"):
                ui.button("10 s earlier", on_click=lambda: self.shift(-10)).props("flat dense no-caps")
                ui.button("10 s later", on_click=lambda: self.shift(10)).props("flat dense no-caps")
            with ui.element("div").classes("mp-row"):
                self.from_m = ui.number("From (m)", value=700, min=0, step=50)
                self.to_m = ui.number("To (m)", value=900, min=0, step=50)
                self.kmh = ui.number("km/h", value=40, min=5, max=120, step=5)
                for name, element in (("from_m", self.from_m), ("to_m", self.to_m), ("limit_mps", self.kmh)):
                    self.news.beside(name, element.props("outlined dense"))
            ui.button("Drop the restriction", on_click=self.restrict).props('outline data-test="restrict"')

    async def start(self) -> None:
        """After the page is there: the section, and the run it came for."""
        await self.form.load()
        if self.run:
            await self.attach(self.run)

    async def section_changed(self) -> None:
        """Draw the track anew; a run that is watched keeps its own."""
        form = self.form
        self.map.content = line_strip(form.line, (form.origin_in.value, form.destination_in.value))
        if self.live() is None and form.section is not None:
            length = catalogue.trainset_out(self.service, form.trainset_in.value)["length_m"]
            self.strip.content = section_strip(form.section, length)
            self.arrival.value = form.slider.value
            end = form.section["length_m"]
            self.from_m.value, self.to_m.value = round(0.55 * end, -1), round(0.7 * end, -1)
            await self.time_moved()

    async def time_moved(self) -> None:
        """Show the plan for the time, while nothing runs; the latest time wins."""
        self.wanted_s = self.form.time_s
        if self.planning or self.live() is not None or self.form.section is None:
            return
        self.planning = True
        try:
            while (now := self.wanted_s) is not None:
                self.wanted_s = None
                with self.form.problem.watching():
                    plan = await self.service.plan(
                        PlanAsked.model_validate({**self.form.asked(), "time_s": now})
                    )
                    if self.live() is None and self.form.section is not None:
                        self.plot.update_figure(planned_run(self.form.section, plan))
                        self.arrival.value = now
        finally:
            self.planning = False

    def live(self) -> Any:  # noqa: ANN401 (a session or None)
        """The run that is watched, while it goes on."""
        session = self.service.sessions.get(self.run or "")
        return session if session is not None and not session.over else None

    async def depart(self) -> None:
        """Start a live run and watch it."""
        with self.form.problem.watching():
            if self.form.section is None:
                raise Refused("choose a section first", 422, field="origin")
            values = {**self.form.asked(), **self.disturbances.asked()}
            asked = validated(
                LiveAsked, {**values, "driver": self.driver.value, "pace": float(self.pace.value)}
            )
            if (before := self.live()) is not None:
                await before.ask({"kind": "stop"})
            session = await self.service.go_live(asked)
            self.run = session.id
            length = catalogue.trainset_out(self.service, asked.trainset)["length_m"]
            self.strip.content = section_strip(self.form.section, length)
            self.arrival.value = asked.time_s
            await self.attach(session.id)

    async def attach(self, run: str) -> None:
        """Let the browser watch a run."""
        self.result.clear()
        self.news.clear()
        with self.result:
            ui.label("KPIs, passed and failed, when it has stopped.").classes("mp-soft")
        ui.run_javascript(f"metropilot.live('c{self.root.id}', {run!r}, {self.plot.id})")

    async def ask(self, event: dict[str, Any]) -> None:
        """Tell the run something.

        Raises:
            MetropilotError: There is none, or it cannot be.
        """
        session = self.live()
        if session is None:
            raise Refused("no run is under way; depart first", 409)
        await session.ask(event)

    async def tell_arrival(self) -> None:
        """Arrive earlier or later."""
        with self.news.watching():
            if self.arrival.value is None:
                raise InputError("a time is needed", field="scheduled_time_s", unit="s")
            await self.ask({"kind": "arrival", "scheduled_time_s": float(self.arrival.value)})

    async def shift(self, seconds: float) -> None:
        """A little earlier or later than it is now."""
        self.arrival.value = (self.arrival.value or 0) + seconds
        await self.tell_arrival()

    async def restrict(self) -> None:
        """Drop a restriction on the track."""
        with self.news.watching():
            values = {
                "from_m": self.from_m.value,
                "to_m": self.to_m.value,
                "limit_mps": (self.kmh.value or 0) / 3.6,
            }
            asked = validated(NewRestriction, values)
            await self.ask({"kind": "restriction", **asked.model_dump()})

    async def change_pace(self) -> None:
        """Faster or slower, also on the way."""
        if (session := self.live()) is not None:
            await session.ask({"kind": "pace", "pace": float(self.pace.value)})

    async def stop(self) -> None:
        """End the run."""
        with self.news.watching():
            await self.ask({"kind": "stop"})

    def show_result(self, event: events.GenericEventArguments) -> None:
        """KPIs with pass and fail; taken from the store, not from the browser."""
        del event
        session = self.service.sessions.get(self.run or "")
        found = session.summary if session is not None else None
        if session is None or found is None:
            return
        self.result.clear()
        with self.result:
            checks_table(found["checks"])
            kpis_table(found["kpis"])
            names = ("trajectory.csv", "kpis.json", "profile.svg", "run.toml")
            links([(name, f"/api/jobs/{session.id}/files/{name}") for name in names])


def checks_table(checks: list[dict[str, Any]]) -> None:
    """The requirements, passed or failed."""
    rows = [
        (
            c["name"],
            c["value"],
            c["wanted"],
            ("✓ passed", "mp-pass") if c["passed"] else ("✗ failed", "mp-fail"),
        )
        for c in checks
    ]
    table(("requirement", "measured", "allowed", ""), rows, right=(1,), name="Requirements")


def kpis_table(k: dict[str, Any]) -> None:
    """The KPIs worth a line."""
    objective = "wheel" if k["energy_objective"] == "wheel" else "line"
    rows = (
        ("running time", number(k["running_time_s"], 1, "s"), f"scheduled {k['scheduled_time_s']:g} s"),
        ("energy at the wheel", number(k["energy_wheel_kwh"], 2, "kWh"), "traction"),
        (
            "energy at the line",
            number(k["energy_line_kwh"], 2, "kWh"),
            f"net of {k['energy_regenerated_kwh']:.2f} kWh recovered",
        ),
        (f"optimum at the {objective}", number(k["optimal_energy_kwh"], 2, "kWh"), "for the time achieved"),
        ("above the optimum", number(k["optimality_gap_percent"], 2, "%"), ""),
        ("highest speed", number(3.6 * k["max_speed_mps"], 1, "km/h"), ""),
        ("largest jerk", number(k["max_jerk_mps3"], 2, "m/s³"), k["comfort_band"]),
        ("coasting", number(k["coasting_distance_m"], 0, "m"), f"{k['regime_switches']} changes of regime"),
        ("decision time", number(k["decision_time_us_median"], 0, "µs"), "median"),
    )
    table(("KPI", "value", ""), rows, right=(1,), name="KPIs")


def install(service: Service) -> None:
    """Add the page."""

    @ui.page("/", title="Drive · metropilot")
    async def drive(request: Request, run: str | None = None) -> None:
        with frame(request, "/"):
            page = DrivePage(service, run)
            page.build()
        await ui.context.client.connected()
        try:
            await page.start()
        except MetropilotError as error:
            page.form.problem.show(error)

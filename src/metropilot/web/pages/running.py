"""Live train graph: a running line on the page Line, with delays that are injected and watched."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui

from metropilot.units import KMH_PER_MPS
from metropilot.web import catalogue
from metropilot.web.errors import Refused, error_of
from metropilot.web.live.line import DELAYS
from metropilot.web.pages import frame as parts
from metropilot.web.pages.form import names, number_field, validate
from metropilot.web.pages.live_card import AbstractLiveCard
from metropilot.web.pages.plots import finished_line_figure, running_figure
from metropilot.web.schemas.requests import NewHold, NewSlowSection, RunningLineIn
from metropilot.web.service import RESUMABLE, Service
from metropilot.web.store import JobRow
from metropilot.web.words.language import N_, _, translate_each
from metropilot.web.words.said import retell
from metropilot.web.words.tables import number

PACES = {1: N_("real time"), 5: "5 ×", 10: "10 ×", 30: "30 ×", 60: "60 ×", 0: N_("pause")}
READS = (
    (N_("time"), "–", "time"),
    (N_("trains"), "–", "trains"),
    (N_("late"), "–", "late"),
    (N_("latest"), "–", "worst"),
    (N_("energy"), "–", "energy"),
    (N_("above the floor"), "–", "gap"),
    (N_("waited for a train"), "–", "waits"),
    (N_("stopped behind one"), "–", "stops"),
)
WAYS = {"forward": N_("as the stations are listed"), "backward": N_("the other way")}


class RunningCard(AbstractLiveCard):
    """The card of the live train graph.

    Args:
        service: Service of the server.
        run: Id of the running line that a link names.
        request: Gives line, trainset, headway and options of the form.
    """

    idle = N_("no line is running; press Run")

    def __init__(self, service: Service, run: str | None, request: Callable[[], dict[str, Any]]) -> None:
        self.service, self.run, self.request = service, run, request

    def build(self) -> None:
        """Place the card."""
        self.root = ui.element("section").classes("mp-card").props('data-test="running" data-status="none"')
        with self.root, ui.element("div").classes("mp-stack"):
            with ui.element("div").classes("mp-row items-center"):
                parts.heading(_("Live train graph"))
                self.status = ui.label(_("not begun")).classes("mp-soft")
                self.status.props('data-mp="status" aria-live=polite')
                ui.label("").classes("mp-soft").props('data-mp="pace"')
            ui.label(
                _(
                    "All trains of the line, with headway and options of the form. Hold a train or slow a "
                    "section and watch the delay: trains keep the technical headway, late ones recover with "
                    "their reserves."
                )
            ).classes("mp-soft")
            self.problem = parts.Problem()
            self.problem.label.props('data-test="running-problem"')
            with ui.element("div").classes("mp-row items-center"):
                self.build_pace(PACES, 30).props("outlined dense options-dense").classes("mp-filter")
                parts.ActionButton(_("Run"), icon="play_arrow", on_click=self.start).props(
                    'unelevated data-test="run-line"'
                )
                parts.ActionButton(_("Stop"), on_click=self.stop).props('outline data-test="stop-line"')
                self.resume_button = parts.ActionButton(_("Resume"), icon="replay", on_click=self.resume)
                self.resume_button.props('outline data-test="resume-line"').set_visibility(False)
            self.build_events()
            parts.reads(READS)
            self.plot = parts.plot(running_figure()).props('data-test="running-graph"')
            self.build_log(_("News"))
            self.result = ui.element("div").props('data-test="running-result"')
        self.root.on("mp-result", self.show_result, ["detail"])

    def build_events(self) -> None:
        """Place the fields of what is injected."""
        with ui.element("div").classes("mp-row items-start"):
            self.station = ui.select({}, label=_("At station")).props("outlined dense options-dense")
            self.way = ui.select(translate_each(WAYS), value="forward", label=_("Direction")).props(
                "outlined dense options-dense"
            )
        with ui.element("div").classes("mp-row items-start"):
            self.hold_s = number_field(NewHold, "hold_s")
            parts.ActionButton(_("Hold the next train"), on_click=self.hold).props('outline data-test="hold"')
        with ui.element("div").classes("mp-row items-start"):
            self.limit = number_field(NewSlowSection, "limit_mps", value=25)
            self.lasts_s = number_field(NewSlowSection, "lasts_s")
            parts.ActionButton(_("Slow the section from there"), on_click=self.slow).props(
                'outline data-test="slow"'
            )
        for name, element in (
            ("station", self.station),
            ("hold_s", self.hold_s),
            ("limit_mps", self.limit),
            ("lasts_s", self.lasts_s),
        ):
            self.problem.beside(name, element.props("outlined dense"))

    def fill_stations(self, line: str) -> None:
        """Offer the stations of a line."""
        stops = names(catalogue.line_out(self.service, line)["stops"])
        kept = self.station.value if self.station.value in stops else list(stops)[len(stops) // 2]
        self.station.set_options(stops, value=kept)

    def load(self) -> JobRow | None:
        """Watch the linked running line, or show how it ended; return its row."""
        if not self.run:
            return None
        row = self.service.live_run(self.run)
        if catalogue.kind_of(row) != "running":
            raise Refused(f"the job is a {catalogue.KINDS[catalogue.kind_of(row)].lower()}", 404, field="run")
        self.root.props(f"data-status={row.status}")
        said = {"done": _("at its end"), "stopped": _("stopped; it can be resumed")}
        self.status.text = said.get(row.status) or retell(row.words or row.status)
        if row.id in self.service.sessions:
            self.attach(row.id)
        elif (found := self.service.store.result(row.id)) is not None:
            self.show_summary(row.id, found)
            if found.get("graph") is not None:
                self.plot.update_figure(finished_line_figure(found["graph"]))
        self.resume_button.set_visibility(row.status in RESUMABLE)
        if row.error is not None:
            self.problem.show(error_of(row.error))
        return row

    async def start(self) -> None:
        """Run the line of the form."""
        with self.problem.show_errors():
            body = validate(RunningLineIn, {**self.request(), "pace": float(self.pace.value or 0)})
            session = await self.go_live(body)
            self.fill_stations(body.line)
            self.attach(session.id)

    def attach(self, run: str) -> None:
        """Connect the browser to the stream."""
        self.result.clear()
        self.resume_button.set_visibility(False)
        ui.run_javascript(f"metropilotLine('c{self.root.id}', {run!r}, {self.plot.id})")

    async def resume(self) -> None:
        """Resume the line where it was."""
        with self.problem.show_errors():
            self.attach((await self.service.resume_live(self.run or "")).id)

    async def stop(self) -> None:
        """Stop the line; it can be resumed."""
        with self.problem.show_errors():
            await self.under_way().stop()
            self.resume_button.set_visibility(True)

    async def change_pace(self) -> None:
        """Send the pace to the running line, if there is one."""
        with self.problem.show_errors():
            await self.send_pace(float(self.pace.value or 0))

    def where(self) -> dict[str, Any]:
        """Station and direction of the fields."""
        return {"station": self.station.value, "backward": self.way.value == "backward"}

    async def hold(self) -> None:
        """Hold the next train that departs from the station."""
        with self.problem.show_errors():
            body = validate(NewHold, {**self.where(), "hold_s": self.hold_s.value or 0})
            await self.ask({"kind": "hold", **body.model_dump()})

    async def slow(self) -> None:
        """Slow the section that begins at the station."""
        with self.problem.show_errors():
            values = {"limit_mps": (self.limit.value or 0) / KMH_PER_MPS, "lasts_s": self.lasts_s.value or 0}
            body = validate(NewSlowSection, {**self.where(), **values}, limit_mps=KMH_PER_MPS)
            await self.ask({"kind": "slow", **body.model_dump()})

    def show_summary(self, run: str, found: dict[str, Any]) -> None:
        """Show energy, delays and recovery of a line at its end."""
        self.result.clear()
        with self.result:
            ui.label(describe_end(found)).classes("mp-soft")
            parts.links([(DELAYS, f"/api/jobs/{run}/files/{DELAYS}")])


def describe_end(found: dict[str, Any]) -> str:
    """Energy, delays and recovery of a running line, in words."""
    energy, gap = number(found["energy_kwh"], 0, "kWh"), number(found["gap_percent"], 2, "%")
    words = _(
        "{trains} trains in {minutes} min: {energy}, {gap} above the floor; at most {delay} s late, {waits} "
        "departures waited for the train ahead, {stops} trains were stopped behind one.",
        trains=found["trains"],
        minutes=f"{found['time_s'] / 60:.0f}",
        energy=energy,
        gap=gap,
        delay=number(found["largest_delay_s"], 0),
        waits=found["waits"],
        stops=found["stops"],
    )
    if found["disturbed_s"] is not None:
        after = found["recovered_s"]
        words += " " + (
            _("Not every train is on time again.")
            if after is None
            else _(
                "Every train was on time again {time} s after the last event.",
                time=f"{after - found['disturbed_s']:.0f}",
            )
        )
    return words

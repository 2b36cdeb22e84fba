"""Journey: a whole line with the running time reserve spread optimally."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

from fastapi import Request
from nicegui import ui

from metropilot.planning import excess_percent
from metropilot.units import J_PER_KWH
from metropilot.web import catalogue
from metropilot.web.pages import frame as parts
from metropilot.web.pages.form import loads, number_field, validate
from metropilot.web.pages.plots import blank, journey_figure, sections_figure
from metropilot.web.pages.strip import line_strip, names
from metropilot.web.schemas.requests import JourneyIn
from metropilot.web.service import Service
from metropilot.web.words.language import N_, _, translate_each
from metropilot.web.words.tables import number

WAYS = {"timetable": N_("Keep the timetable"), "optimum": N_("Let the optimum spread the reserve")}


class JourneyPage:
    """State of the page for one browser."""

    def __init__(self, service: Service, job: str | None = None) -> None:
        self.service = service
        self.job = job
        self.line = catalogue.line_out(service, "yizhuang")
        self.filling = False

    def build(self) -> None:
        """Build the fields on the left and the results on the right."""
        lines = {row["id"]: row["name"] for row in catalogue.line_rows(self.service)}
        trainsets = {row["id"]: row["name"] for row in catalogue.trainset_rows(self.service)}
        stops = names(self.line["stops"])
        ends = list(stops)
        with (
            ui.element("div").classes("mp-col"),
            parts.card(_("Journey"), _("Calls at every station on the way.")),
        ):
            self.problem = parts.Problem()
            fields: dict[str, Any] = {
                "line": ui.select(lines, value="yizhuang", label=_("Line"), on_change=self.update_stations),
                "origin": ui.select(stops, value=ends[0], label=_("From")),
                "destination": ui.select(stops, value=ends[-1], label=_("To")),
                "trainset": ui.select(
                    trainsets, value="dkz32", label=_("Trainset"), on_change=self.update_loads
                ),
                "load": ui.select(loads(self.service, "dkz32"), label=_("Load")),
            }
            fields["load"].value = next(iter(fields["load"].options))
            self.fields = fields
            for name, element in fields.items():
                self.problem.beside(name, element.props("outlined dense options-dense"))
            self.way = ui.radio(translate_each(WAYS), value="optimum").props("dense")
            self.total = number_field(
                JourneyIn, "total_s", label=_("Whole journey, dwells included (s)"), step=10
            )
            self.problem.beside("total_s", self.total).props('data-test="total"')
            self.problem.beside("journey", self.total)
            parts.ActionButton(_("Plan"), on_click=self.keep).props('unelevated data-test="plan"')
            self.status = ui.label("").classes("mp-soft").props("aria-live=polite")
        with ui.element("div").classes("mp-col"):
            with parts.card():
                self.map = parts.strip(_("Whole line"))
                self.summary = ui.element("div").props('data-test="summary"')
            with parts.card(_("Train graph")):
                self.graph = parts.plot(blank(460))
                self.graph.props('data-test="graph"')
            with parts.card(_("Sections")):
                self.bars = parts.plot(blank(400))
                self.rows = ui.element("div").classes("w-full").props('data-test="sections"')

    async def update_stations(self) -> None:
        """Update the stations of the line."""
        if self.filling:
            return
        self.line = catalogue.line_out(self.service, self.fields["line"].value)
        stops = names(self.line["stops"])
        ends = list(stops)
        self.fields["origin"].set_options(stops, value=ends[0])
        self.fields["destination"].set_options(stops, value=ends[-1])
        self.total.value = None
        await self.plan()

    def update_loads(self) -> None:
        """Update the loads of the trainset."""
        if self.filling:
            return
        found = loads(self.service, self.fields["trainset"].value)
        self.fields["load"].set_options(found, value=next(iter(found)))

    async def plan(self) -> None:
        """Plan the journey of the fields, without keeping it."""
        with self.problem.show_errors(), self.planning():
            self.show(await self.service.journey((await self.request()).model_dump()))

    async def keep(self) -> None:
        """Plan the journey of the fields and keep it among the runs."""
        with self.problem.show_errors(), self.planning():
            self.job = await self.service.keep_journey(await self.request())
            self.show(catalogue.result_of(self.service, self.job, ("journey",)), self.job)
            ui.run_javascript(f"history.replaceState(null, '', '/journey?job={self.job}')")

    @contextmanager
    def planning(self) -> Iterator[None]:
        """Say that a journey is being planned."""
        self.status.text = _("planning …")
        try:
            yield
        finally:
            self.status.text = ""

    async def request(self) -> JourneyIn:
        """Request of the fields; without a total time, that of the timetable.

        Raises:
            MetropilotError: A field is not allowed, or the timetable cannot be kept.
        """
        body = {name: element.value for name, element in self.fields.items()}
        free = self.way.value == "optimum"
        if free and self.total.value is None:
            kept = await self.service.journey(validate(JourneyIn, body).model_dump())
            self.total.value = round(kept["running_time_s"])
        return validate(JourneyIn, {**body, "total_s": self.total.value if free else None})

    async def start(self) -> None:
        """Show the linked journey, or plan that of the fields; runs once the page is connected."""
        if self.job is None:
            await self.plan()
            return
        with self.problem.show_errors():
            found = catalogue.result_of(self.service, self.job, ("journey",))
            self.restore(self.service.store.job(self.job).request)
            self.show(found, self.job)

    def restore(self, body: dict[str, Any]) -> None:
        """Fill the fields with the request of a journey.

        Raises:
            MetropilotError: Its line or trainset does not exist any more.
        """
        line = catalogue.line(self.service, body["line"])
        self.line = catalogue.line_out(self.service, body["line"])
        aboard = loads(self.service, body["trainset"])
        stops = names(self.line["stops"])
        ends = list(stops)
        origin, destination = (
            line.station(body[name]).code if body[name] else end
            for name, end in (("origin", ends[0]), ("destination", ends[-1]))
        )
        with parts.set_quietly(self):
            self.fields["line"].value, self.fields["trainset"].value = body["line"], body["trainset"]
        self.fields["origin"].set_options(stops, value=origin)
        self.fields["destination"].set_options(stops, value=destination)
        self.fields["load"].set_options(aboard, value=body["load"] or next(iter(aboard)))
        self.way.value = "timetable" if body["total_s"] is None else "optimum"
        self.total.value = body["total_s"]

    def show(self, found: dict[str, Any], job: str | None = None) -> None:
        """Show numbers and pictures of the journey."""
        ends = self.fields["origin"].value, self.fields["destination"].value
        self.map.content = line_strip(self.line, ends)
        planned_j = found["planned_energy_j"]
        change = None if planned_j is None else excess_percent(found["energy_j"], planned_j)
        minutes, seconds = divmod(round(found["running_time_s"]), 60)
        gap = excess_percent(found["energy_j"], found["bound_j"])
        self.summary.clear()
        with self.summary:
            parts.reads(
                (
                    (_("journey time"), f"{minutes} min {seconds:02d} s", ""),
                    (_("energy at the wheel"), f"{found['energy_j'] / J_PER_KWH:.1f} kWh", ""),
                    (_("against the timetable's times"), number(change, 2, "%"), ""),
                    (_("certified within"), number(None if gap is None else max(gap, 0.001), 3, "%"), ""),
                )
            )
        self.graph.update_figure(journey_figure(found))
        self.bars.update_figure(sections_figure(found))
        rows = [
            (
                f"{a['station']}–{b['station']}",
                parts.clock(b["arrival_s"]),
                number(b["running_time_s"], 1),
                number(b["minimum_running_time_s"], 1),
                number(b["running_time_s"] - b["minimum_running_time_s"], 1),
                number(b["energy_j"] / J_PER_KWH, 2),
            )
            for a, b in pairwise(found["calls"])
        ]
        columns = (
            _("section"),
            _("arrival (min:s)"),
            _("running (s)"),
            _("minimum (s)"),
            _("reserve (s)"),
            _("energy (kWh)"),
        )
        self.rows.clear()
        with self.rows:
            parts.table(columns, rows, right=range(1, 6), name=_("Sections"))
            if job is not None:
                parts.links([("report.pdf", f"/api/jobs/{job}/files/report.pdf")])


def install(service: Service) -> None:
    """Register the page."""

    @ui.page("/journey", title="Journey · metropilot")
    async def journey(request: Request, job: str | None = None) -> None:
        with parts.frame(request, "/journey"):
            page = JourneyPage(service, job)
            page.build()
        await ui.context.client.connected()
        await page.start()

"""Campaigns: leaderboard, robustness, trainsets and one's own; every row is opened as a run."""

from __future__ import annotations

import json
import tomllib
from functools import partial
from typing import Any

from fastapi import Request
from nicegui import run, ui

from metropilot._schema import field_specs
from metropilot.campaign import PUBLISHED, shipped_campaign_text, shipped_campaigns
from metropilot.drivers import DRIVERS
from metropilot.errors import InputError, MetropilotError
from metropilot.sim import Disturbance
from metropilot.web import catalogue, evidence
from metropilot.web.live.session import GOING
from metropilot.web.pages.form import validate
from metropilot.web.pages.frame import ActionButton, Problem, card, frame, links, prop_of
from metropilot.web.pages.numbers import NumberField, parse_number, split_list
from metropilot.web.pages.strip import names
from metropilot.web.pages.tables import DataColumn, DataTable
from metropilot.web.schemas.requests import CampaignIn
from metropilot.web.service import Service
from metropilot.web.words.language import N_, _, translate_each
from metropilot.web.words.said import retell

EVERY_S = 1.0
SHOWN_ROWS = 300
"""Rows shown at once."""
CELLS = (
    DataColumn("driver", N_("Driver"), filtered=True),
    DataColumn("disturbance", N_("Disturbance"), filtered=True, wide=True, said=True),
    DataColumn("runs", N_("Runs"), digits=0, wide=True),
    DataColumn("safe_percent", N_("Safe (%)"), digits=1, wide=True),
    DataColumn("success_percent", N_("On time (%)"), digits=1),
    DataColumn("gap_median", N_("Gap, median (%)"), digits=2),
    DataColumn("gap_95", N_("95th (%)"), digits=1, wide=True),
    DataColumn("gap_worst", N_("Worst (%)"), digits=1, wide=True),
    DataColumn("trainset_median", N_("Trainset (%)"), digits=2, wide=True),
    DataColumn("driver_median", N_("Driver (%)"), digits=2, wide=True),
    DataColumn("late_worst_s", N_("Time, worst (s)"), digits=2, wide=True),
    DataColumn("stop_worst_m", N_("Stop, worst (m)"), digits=3, wide=True),
    DataColumn("jerk_worst_mps3", N_("Jerk, worst (m/s³)"), digits=2, wide=True),
    DataColumn("intervened", N_("Intervened"), digits=0, wide=True),
    DataColumn("failed", N_("Failed"), digits=0, wide=True),
)
ROWS = (
    DataColumn("words", N_("Run"), kind="link"),
    DataColumn("driver", N_("Driver")),
    DataColumn("disturbance", N_("Disturbance"), wide=True, said=True),
    DataColumn("outcome", N_("Outcome"), kind="styled"),
    DataColumn("time_error_s", N_("Time error (s)"), digits=2, wide=True),
    DataColumn("stopping_error_m", N_("Stop (m)"), digits=3, wide=True),
    DataColumn("energy_wheel_kwh", N_("Energy (kWh)"), digits=2, wide=True),
    DataColumn("optimality_gap_percent", N_("Gap (%)"), digits=2),
    DataColumn("trainset_gap_percent", N_("Trainset (%)"), digits=2, wide=True),
    DataColumn("driver_gap_percent", N_("Driver (%)"), digits=2, wide=True),
    DataColumn("max_jerk_mps3", N_("Jerk (m/s³)"), digits=2, wide=True),
    DataColumn("interventions", N_("Interventions"), digits=0, wide=True),
)
SORTS = {
    "optimality_gap_percent": N_("largest gap"),
    "driver_gap_percent": N_("largest loss of the driver"),
    "time_error_s": N_("latest"),
    "stopping_error_m": N_("farthest beyond the stop"),
    "max_jerk_mps3": N_("largest jerk"),
    "interventions": N_("most interventions"),
    "energy_wheel_kwh": N_("most energy"),
    "row": N_("first row"),
}
OUTCOMES = {"": N_("every run"), "true": N_("on time"), "false": N_("not on time")}


class CampaignsPage:
    """State of the page for one browser.

    Args:
        service: Service of the server.
        campaign: Campaign of the link, None without one.
    """

    def __init__(self, service: Service, campaign: str | None) -> None:
        self.service = service
        self.campaign = campaign or PUBLISHED[0]
        self.seen: tuple[Any, ...] = ()

    def build(self) -> None:
        """Place the list and the form on the left, the campaign on the right."""
        with ui.element("div").classes("mp-col"):
            with card(_("Campaigns"), _("Published with their pages, and those of this server.")):
                self.list = ui.element("div").classes("mp-stack").props('data-test="campaigns"')
            self.declaration = CampaignForm(self.service, self.start)
            self.declaration.build()
        with ui.element("div").classes("mp-col"):
            with card():
                self.problem = Problem()
                self.title = ui.label("").classes("mp-h").props("role=heading aria-level=2")
                self.matrix = ui.label("").classes("mp-soft").props('data-test="matrix"')
                self.bar = ui.linear_progress(value=0, show_value=False)
                self.bar.props("rounded").props(prop_of("aria-label", _("Progress")))
                with ui.element("div").classes("mp-row items-center"):
                    self.stop_button = ActionButton(_("Stop"), on_click=self.stop).props("outline dense")
                    self.resume_button = ActionButton(_("Resume"), on_click=self.resume).props(
                        "outline dense"
                    )
                    self.state = ui.label("").classes("mp-soft").props('aria-live=polite data-test="state"')
                self.files = ui.element("div")
            with card(_("Drivers"), _("A driver and disturbance chosen here are those of the rows below.")):
                self.cells = DataTable(_("Drivers"), CELLS, changed=self.show_rows)
                self.cells.build()
            with card(
                _("Rows"), _("Each opens as a run, with its disturbance and seed, in the form of Drive.")
            ):
                with ui.element("div").classes("mp-row items-center"):
                    self.sort = ui.select(
                        translate_each(SORTS), value="optimality_gap_percent", label=_("First")
                    )
                    self.outcome = ui.select(translate_each(OUTCOMES), value="", label=_("Runs"))
                    for each in (self.sort, self.outcome):
                        each.props("outlined dense options-dense").on_value_change(self.show_rows)
                    self.count = ui.label("").classes("mp-soft").props('data-test="count"')
                self.rows = DataTable(_("Rows"), ROWS)
                self.rows.build()

    async def start_up(self) -> None:
        """Show the campaign of the link; runs once the page is connected."""
        await self.show()
        ui.timer(EVERY_S, self.refresh)

    def is_own(self) -> bool:
        """Tell whether the campaign is one of this server."""
        return self.campaign not in PUBLISHED

    def fill(self, found: list[dict[str, Any]]) -> None:
        """Fill the list of campaigns."""
        self.list.clear()
        with self.list:
            for row in found:
                words = retell(row["name"])
                if row["rows"]:
                    words += " · " + _("{count} rows", count=row["rows"])
                if row["status"] != "done":
                    words += f" · {retell(row['status'])}"
                button = ui.button(words, on_click=partial(self.choose, row["id"]))
                button.props("flat no-caps dense").classes("w-full mp-item")
                if row["id"] == self.campaign:
                    button.props("aria-current=true")

    async def choose(self, campaign: str) -> None:
        """Show another campaign."""
        self.campaign = campaign
        ui.run_javascript(f"history.replaceState(null, '', '/campaigns?campaign={campaign}')")
        for field in self.cells.filters.values():
            field.value = ""
        await self.show()

    async def refresh(self) -> None:
        """Show what has changed since the last look."""
        found = await run.io_bound(evidence.campaign_list, self.service)
        now = tuple((row["id"], row["status"], row["words"], row["name"]) for row in found or ())
        if now != self.seen:
            self.seen = now
            await self.show()

    async def show(self) -> None:
        """Show list, statistics and rows."""
        found: Any = await run.io_bound(evidence.campaign_list, self.service)
        self.fill(found)
        row = next((each for each in found if each["id"] == self.campaign), None)
        status = "" if row is None else row["status"]
        self.title.text = self.campaign if row is None else retell(row["name"])
        self.state.text = "" if row is None or not self.is_own() else retell(f"{status}: {row['words']}")
        self.bar.value = row["done"] / row["rows"] if row and row["rows"] else 0
        self.bar.set_visibility(self.is_own())
        self.stop_button.set_visibility(status in GOING)
        self.resume_button.set_visibility(status in {"stopped", "interrupted", "failed"})
        told: Any = {"cells": [], "matrix": "", "written": ""}
        with self.problem.show_errors():
            told = await run.io_bound(evidence.campaign_out, self.service, self.campaign)
        matrix, written = retell(told["matrix"]), retell(told["written"])
        self.matrix.text = _("{matrix}. {written}", matrix=matrix, written=written) if matrix else ""
        self.cells.fill([self.cell(each) for each in told["cells"]])
        self.files.clear()
        if self.is_own() and status == "done":
            with self.files:
                links([("results.parquet", f"/api/jobs/{self.campaign}/files/results.parquet")])
        await self.show_rows()

    @staticmethod
    def cell(row: dict[str, Any]) -> dict[str, Any]:
        """A row of the table of drivers."""
        shares = {
            "safe_percent": (row["safe"], row["driven"]),
            "success_percent": (row["successes"], row["possible"]),
        }
        percents = {name: 100 * hits / total if total else None for name, (hits, total) in shares.items()}
        return {**row, **percents, "id": f"{row['driver']} {row['disturbance']}"}

    async def show_rows(self) -> None:
        """Show the rows that the lists above let through."""
        wanted = {name: field.value for name, field in self.cells.filters.items() if field.value}
        if self.outcome.value:
            wanted["success"] = self.outcome.value
        order = {"sort": self.sort.value, "ascending": self.sort.value == "row", "limit": SHOWN_ROWS}
        try:
            found: Any = await run.io_bound(
                lambda: evidence.campaign_rows(self.service, self.campaign, wanted, **order)
            )
        except MetropilotError:
            found = {"count": 0, "rows": []}
        shown = min(found["count"], SHOWN_ROWS)
        self.count.text = _("{shown} of {count} rows", shown=shown, count=found["count"])
        self.rows.fill([self.row(each) for each in found["rows"]])

    def row(self, row: dict[str, Any]) -> dict[str, Any]:
        """A row of the table of rows."""
        late = row.get("actuation")
        trainset = row["trainset"] if late in {None, "own"} else f"{row['trainset']} ({retell(str(late))})"
        where = f"{row['line']} {row['origin']} – {row['destination']}"
        outcome = retell(row["outcome"]) + (f": {row['error']}" if row["error"] else "")
        return {
            **{column.name: row.get(column.name) for column in ROWS},
            "id": row["row"],
            "words": f"{where} · {trainset} {row['load']} · {retell(str(row['time']))}",
            "link": f"/?campaign={self.campaign}&row={row['row']}",
            "outcome": ("✓ " if row["success"] else "✗ ") + outcome,
            "style": "mp-pass" if row["success"] else "mp-fail",
        }

    async def start(self, body: CampaignIn) -> None:
        """Queue a campaign and show it."""
        await self.choose(self.service.submit(body))

    def stop(self) -> None:
        """Stop the campaign after the rows that are being computed."""
        with self.problem.show_errors():
            self.service.stop(self.campaign)
            self.state.text += " · " + _("stops after the rows that are being computed")

    async def resume(self) -> None:
        """Resume the campaign with the rows that are missing."""
        with self.problem.show_errors():
            self.service.resume(self.campaign)
            await self.show()


class CampaignForm:
    """Declaration of a campaign: fields that write its TOML file, which can be edited further.

    Args:
        service: Service of the server.
        start: Called with the declared campaign.
    """

    def __init__(self, service: Service, start: Any) -> None:  # noqa: ANN401 (an asynchronous function)
        self.service, self.start = service, start

    def build(self) -> None:
        """Place the fields and the file."""
        lines = {row["id"]: row["name"] for row in catalogue.line_rows(self.service)}
        trainsets = {row["id"]: row["name"] for row in catalogue.trainset_rows(self.service)}
        drivers = [name for name in DRIVERS.ids() if name != "learned"]
        said = _("The fields write the file below; more of it can be written there by hand.")
        with card(_("Declare"), said, late=True):
            self.problem = Problem()
            self.name = ui.input(_("Name"), value="mine", on_change=self.write)
            self.drivers = ui.select(drivers, value=["optimal", "manual"], label=_("Drivers"), multiple=True)
            self.line = ui.select(lines, value="yizhuang", label=_("Line"), on_change=self.change_line)
            self.origin = ui.select({}, label=_("From"))
            self.destination = ui.select({}, label=_("To"))
            self.trainset = ui.select(trainsets, value=["dkz32"], label=_("Trainsets"), multiple=True)
            self.loads = ui.input(_("Loads, separated by commas, or all"), value="AW2", on_change=self.write)
            self.times = ui.input(
                _("Times: planned, or over the minimum, separated by commas"),
                value="1.2",
                on_change=self.write,
            )
            self.seeds = NumberField(_("Seeds"), value=1, step=1, on_change=self.write)
            for field in (self.drivers, self.origin, self.destination, self.trainset):
                field.on_value_change(self.write)
            with ui.expansion(_("Disturbance")).props("dense").classes("mp-soft") as fold:
                ui.label(_("A number, or two separated by … to draw between.")).classes("mp-soft")
                self.drawn = {}
                for name, spec in field_specs(Disturbance).items():
                    if spec.label and spec.range is not None:
                        unit = f" ({spec.unit})" if spec.unit and spec.unit != "1" else ""
                        self.drawn[name] = ui.input(f"{_(spec.label)}{unit}", on_change=self.write)
            named = {"name": self.name, "matrix.drivers": self.drivers, "matrix.sections": self.line}
            named |= {
                "matrix.trainsets": self.trainset,
                "matrix.loads": self.loads,
                "matrix.times": self.times,
            }
            for key, field in {**named, "matrix.seeds": self.seeds}.items():
                self.problem.beside(key, field)
            for name, field in self.drawn.items():
                self.problem.beside(f"disturbance disturbed.{name}", field, fold)
            fields = (self.name, self.drivers, self.line, self.origin, self.destination, self.trainset)
            for field in (*fields, self.loads, self.times, self.seeds, *self.drawn.values()):
                field.props("outlined dense options-dense").classes("w-full")
            for field in (self.drivers, self.trainset):
                field.props("use-chips")
            shipped = ui.select(list(shipped_campaigns()), label=_("Start from a shipped one"))
            shipped.props("outlined dense options-dense").classes("w-full")
            shipped.on_value_change(lambda event: self.take(event.value))
            self.text = ui.textarea(_("Campaign (TOML)")).props("outlined dense autogrow")
            self.text.classes("w-full mp-code").props('data-test="toml"')
            ActionButton(_("Start"), icon="play_arrow", on_click=self.submit).props(
                'unelevated data-test="start"'
            )
        self.change_line()

    def change_line(self) -> None:
        """Offer the stations of the line; without ends every section both ways."""
        stops = names(catalogue.line_out(self.service, self.line.value)["stops"])
        for field in (self.origin, self.destination):
            field.set_options({"": _("every section, both ways"), **stops}, value="")
        self.write()

    def take(self, name: str) -> None:
        """Show the file of a shipped campaign."""
        self.text.value = shipped_campaign_text(name)

    def write(self) -> None:
        """Write the file of the fields."""
        section = self.line.value
        if self.origin.value and self.destination.value:
            section += f" {self.origin.value} {self.destination.value}"
        loads = split_list(str(self.loads.value or "all"))
        times = split_list(str(self.times.value or "planned"))
        lines = [
            f"name = {json.dumps(self.name.value or '')}",
            "",
            "[matrix]",
            f"drivers = {json.dumps(list(self.drivers.value or []))}",
            f"sections = {json.dumps([section])}",
            f"trainsets = {json.dumps(list(self.trainset.value or []))}",
            f"loads = {json.dumps('all' if loads == ['all'] else loads)}",
            f"times = [{', '.join(_number(word) for word in times)}]",
            f"seeds = {self.seeds.value or 1:.0f}",
        ]
        drawn = {name: str(field.value or "").strip() for name, field in self.drawn.items()}
        if any(drawn.values()):
            lines += ["", "[[disturbance]]", 'name = "disturbed"']
        for name, text in drawn.items():
            ends = [part.strip() for part in text.replace("...", "…").split("…") if part.strip()]
            if ends:
                words = ", ".join(_number(each) for each in ends)
                lines.append(f"{name} = {words if len(ends) == 1 else f'[{words}]'}")
        self.text.value = "\n".join(lines) + "\n"

    async def submit(self) -> None:
        """Start the campaign of the file."""
        with self.problem.show_errors():
            try:
                values = tomllib.loads(self.text.value or "")
            except (ValueError, RecursionError) as error:
                raise InputError(f"not TOML ({error})", field="campaign") from None
            await self.start(validate(CampaignIn, values))


def _number(text: str) -> str:
    """A number as TOML has it; anything else as text."""
    try:
        return repr(parse_number(text))
    except InputError:
        return json.dumps(text)


def install(service: Service) -> None:
    """Register the page."""

    @ui.page("/campaigns", title="Campaigns · metropilot")
    async def campaigns(request: Request, campaign: str | None = None) -> None:
        with frame(request, "/campaigns"):
            page = CampaignsPage(service, campaign)
            page.build()
        await ui.context.client.connected()
        await page.start_up()

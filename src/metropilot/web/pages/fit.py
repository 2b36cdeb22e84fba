"""Fit: a trainset from dropped logs, with intervals, residuals and what the logs cannot tell."""

from __future__ import annotations

from functools import partial
from typing import Any

from fastapi import Request
from nicegui import events, ui

from metropilot.errors import MetropilotError
from metropilot.fit import GROUPS
from metropilot.web import catalogue
from metropilot.web.errors import Refused, error_of
from metropilot.web.kinds import JOB_KINDS
from metropilot.web.live.session import GOING
from metropilot.web.pages import frame as parts
from metropilot.web.pages.document import describe
from metropilot.web.pages.form import loads, validate
from metropilot.web.pages.plots import residual_figure
from metropilot.web.pages.strip import names
from metropilot.web.schemas.requests import FitIn
from metropilot.web.service import Service
from metropilot.web.store import JobRow
from metropilot.web.words.language import N_, _, translate_each
from metropilot.web.words.said import retell
from metropilot.web.words.tables import number
from metropilot.web.work.plans import LOG

POLL_S = 0.5
LARGE = 1000.0
INPUTS = {"": N_("Command where logged"), "command": N_("Command"), "effort": N_("Effort at the wheel")}
FORMS = {
    "auto": N_("Three coefficients where the logs tell them"),
    "factor": N_("One factor"),
    "coefficients": N_("Three coefficients"),
}
WRAPPED = "white-space: normal; overflow-wrap: anywhere"
NEW = ""
"""Choice of a new entry to save in."""


class FitPage:
    """State of the page for one browser.

    Attributes:
        job: Job that is shown or followed.
        chosen: Ids of the logs that are ticked.
        going: True while the job is followed.
    """

    def __init__(self, service: Service, job: str | None, trainset: str | None) -> None:
        self.service = service
        self.job = job or ""
        self.trainset = trainset
        self.chosen: set[str] = set()
        self.going = False

    def build(self) -> None:
        """Build logs and fields on the left, the result on the right."""
        with ui.element("div").classes("mp-col"):
            most = f"{self.service.settings.log_bytes / 1e6:g} MB"
            with parts.card(
                _("Logs"),
                _("CSV with time, speed and command or effort, units in the header; {most}.", most=most),
            ):
                upload = ui.upload(
                    on_upload=self.upload,
                    on_rejected=lambda: self.say(
                        _("not taken: a .csv file of at most {most}", most=most), "mp-error"
                    ),
                    max_file_size=self.service.settings.log_bytes,
                    multiple=True,
                    auto_upload=True,
                    label=_("Choose or drop logs"),
                )
                self.upload_in = upload.props('accept=".csv" flat bordered').classes("w-full")
                self.said = ui.element("div").classes("mp-stack").props('role=status data-test="log-said"')
                self.logs = ui.element("div").classes("mp-stack mp-gridbox").props('data-test="logs"')
            self.build_fields()
        with ui.element("div").classes("mp-col"):
            self.result = ui.element("div").classes("mp-col").props('data-test="result"')
            with self.result, parts.card():
                parts.empty(_("Drop logs and fit: the parameters appear here with their intervals."))
        self.fill_logs()

    def build_fields(self) -> None:
        """Place the fields of the fit."""
        trainsets = {row["id"]: row["name"] for row in catalogue.trainset_rows(self.service)}
        lines = {"": _("Level, or a gradient column")}
        lines |= {row["id"]: row["name"] for row in catalogue.line_rows(self.service)}
        first = next(iter(trainsets)) if self.trainset not in trainsets else str(self.trainset)
        with parts.card(
            _("Fit a trainset"), _("Mass, service brake, resistance, dead time and lag from its logs.")
        ):
            self.problem = parts.Problem()
            self.fields: dict[str, Any] = {
                "trainset": ui.select(
                    trainsets, value=first, label=_("Begin from"), on_change=self.change_trainset
                ),
                "load": ui.select(loads(self.service, first), label=_("Load aboard in the logs")),
                "line": ui.select(lines, value="", label=_("Line of the logs"), on_change=self.change_line),
                "origin": ui.select({}, label=_("From")),
                "destination": ui.select({}, label=_("To")),
            }
            self.fields["load"].value = next(iter(self.fields["load"].options))
            with (
                ui.expansion(_("Input, resistance, kept parameters"))
                .props("dense")
                .classes("mp-soft") as fold
            ):
                self.fields["input"] = ui.select(
                    translate_each(INPUTS), value="", label=_("Input of the model")
                )
                self.fields["resistance"] = ui.select(
                    translate_each(FORMS), value="auto", label=_("Resistance")
                )
                self.keep = ui.select(
                    {name: retell(name) for name in GROUPS}, value=[], multiple=True, label=_("Not estimated")
                ).props("outlined dense options-dense use-chips")
            for name, field in self.fields.items():
                field.props("outlined dense options-dense").classes("w-full")
                self.problem.beside(name, field, fold if name in {"input", "resistance"} else None)
            self.problem.beside("keep", self.keep.classes("w-full"), fold)
            for name in ("origin", "destination"):
                self.fields[name].bind_visibility_from(self.fields["line"], "value", bool)
            with ui.element("div").classes("mp-row"):
                self.go = parts.ActionButton(_("Fit"), on_click=self.start).props(
                    'unelevated data-test="fit"'
                )
                self.stop_button = parts.ActionButton(_("Stop"), on_click=self.stop).props(
                    'outline data-test="stop"'
                )
            self.stop_button.set_visibility(False)
            self.status = ui.label("").classes("mp-soft").props('aria-live=polite data-test="status"')

    # ------------------------------------------------------------------------------------------ logs
    async def upload(self, event: events.UploadEventArguments) -> None:
        """Take a log and tick it, or show in one line why it cannot be used."""
        self.upload_in.reset()
        content = await event.file.read()
        try:
            row, found = await self.service.upload(event.file.name, content)
        except MetropilotError as error:
            self.say(f"✗ {error}", "mp-error")
            return
        self.chosen.add(row.id)
        self.say(f"✓ {row.name}: {retell('; '.join(found['notes']))}", "mp-pass")
        self.fill_logs()

    def say(self, words: str, style: str) -> None:
        """Add a line about an upload."""
        with self.said:
            ui.label(words).classes(style).style(WRAPPED)

    def fill_logs(self) -> None:
        """List the logs, the newest first."""
        self.logs.clear()
        rows = self.service.store.uploads(LOG)
        with self.logs:
            if not rows:
                parts.empty(_("No log yet. The trajectory.csv of a run is one."))
            for row in rows:
                with ui.element("div").classes("mp-row items-center no-wrap"):
                    tick = ui.checkbox(row.name, value=row.id in self.chosen).classes("grow")
                    tick.on_value_change(partial(self.tick, row.id))
                    forget = parts.ActionButton(icon="delete", on_click=partial(self.forget, row.id))
                    forget.props("flat dense round")
                    forget.props(parts.prop_of("aria-label", _("Remove {name}", name=row.name)))

    def tick(self, key: str, event: events.ValueChangeEventArguments) -> None:
        """Choose a log, or leave it out."""
        (self.chosen.add if event.value else self.chosen.discard)(key)

    def forget(self, key: str) -> None:
        """Remove a log."""
        self.chosen.discard(key)
        with self.problem.show_errors():
            self.service.forget(key)
        self.fill_logs()

    # ------------------------------------------------------------------------------------------ fields
    def change_trainset(self) -> None:
        """Offer the loads of the trainset."""
        aboard = loads(self.service, self.fields["trainset"].value)
        self.fields["load"].set_options(aboard, value=next(iter(aboard)))

    def change_line(self) -> None:
        """Offer the stations of the line."""
        line = self.fields["line"].value
        stops = names(catalogue.line_out(self.service, line)["stops"]) if line else {}
        ends = list(stops)[:2] if stops else [None, None]
        for name, end in zip(("origin", "destination"), ends, strict=True):
            self.fields[name].set_options(stops, value=end)

    def values(self) -> dict[str, Any]:
        """Request as the form has it."""
        told = {name: field.value or None for name, field in self.fields.items()}
        order = [row.id for row in self.service.store.uploads(LOG) if row.id in self.chosen]
        return told | {"logs": order[::-1], "keep": self.keep.value or []}

    # ------------------------------------------------------------------------------------------ job
    def start(self) -> None:
        """Queue the fit."""
        with self.problem.show_errors():
            if not self.chosen:
                raise Refused("no log is ticked", 422, field="logs", allowed="one or more")
            self.job = self.service.submit(validate(FitIn, self.values()))
            ui.run_javascript(f"history.replaceState(null, '', '/fit?job={self.job}')")
            self.follow()

    def stop(self) -> None:
        """Stop the fit."""
        with self.problem.show_errors():
            self.service.stop(self.job)

    def follow(self) -> None:
        """Show the job until it is over."""
        if not self.going:
            self.going = True
            parts.refresh_while(lambda: self.going, POLL_S, self.look)
        self.look()

    def look(self) -> None:
        """Show the state of the job, and its result once it is there."""
        with self.problem.show_errors():
            row = self.service.store.job(self.job)
            self.going = row.status in GOING
            self.status.text = f"{retell(row.words)} …" if row.status == "running" else retell(row.status)
            self.stop_button.set_visibility(self.going)
            self.go.set_enabled(not self.going)
            if row.status == "done":
                self.show(row, self.service.store.result(row.id))
            elif row.error is not None:
                self.show_refusal(error_of(row.error))
            return
        self.going = False

    def show_refusal(self, error: MetropilotError) -> None:
        """Show in one line what the logs do not determine."""
        self.result.clear()
        with self.result, parts.card(_("Not fitted")):
            ui.label(describe(error)).classes("mp-error").props('role=alert data-test="refusal"')

    def show(self, row: JobRow, found: dict[str, Any]) -> None:
        """Show parameters, remarks, residuals, files and where to save."""
        self.result.clear()
        with self.result:
            with parts.card():
                parts.heading(
                    _(
                        "{trainset}, load {load}, fitted to {logs}",
                        trainset=found["trainset"],
                        load=found["load"],
                        logs=", ".join(found["logs"]),
                    )
                )
                parts.reads(
                    [
                        (_("mass"), number(found["mass_kg"] / 1000, 1, "t"), ""),
                        (_("residuals"), number(found["residual_mps"], 3, "m/s"), ""),
                        (_("samples"), str(found["samples"]), ""),
                        (_("runs"), str(found["runs"]), ""),
                    ]
                )
                head = (_("parameter"), _("trainset"), _("estimate"), _("95 % interval"), _("unit"))
                for name, title in (("parameters", _("Parameters")), ("resistance", _("Resistance"))):
                    rows = [_cells(each) for each in found[name]]
                    parts.table(head, rows, right=(1, 2), name=title)
                self.show_remarks(found)
                files = [(name, f"/api/jobs/{row.id}/files/{name}") for name in JOB_KINDS["fit"].files]
                parts.links([*files, ("run.zip", f"/api/jobs/{row.id}/files/run.zip")])
            self.build_save(row)
            with parts.card(
                _("Residuals"), _("Measured and simulated speed; what remains; its autocorrelation.")
            ):
                drawn = residual_figure(found["residuals"], found["residual_mps"])
                parts.plot(drawn).props('data-test="residuals"')

    @staticmethod
    def show_remarks(found: dict[str, Any]) -> None:
        """Show what the logs do not tell."""
        with ui.element("div").classes("mp-stack").props('data-test="remarks"'):
            for words in found["ambiguities"]:
                ui.label(retell(words)).classes("mp-soft mp-notice")
            for words in found["notes"]:
                ui.label(retell(words)).classes("mp-soft")

    def build_save(self, row: JobRow) -> None:
        """Place the fields by which the fitted trainset is saved."""
        own = {each.id: each.name for each in self.service.store.uploads("trainset")}
        choices = {NEW: _("A new trainset")}
        choices |= {key: _("Next version of {name}", name=name) for key, name in own.items()}
        began = row.request["trainset"]
        with parts.card(_("Save the trainset")):
            with ui.element("div").classes("mp-row items-center"):
                self.target = ui.select(choices, value=began if began in own else NEW, label=_("Save as"))
                self.target.props("outlined dense options-dense").classes("grow")
                parts.ActionButton(_("Save"), on_click=self.save).props('unelevated data-test="save"')
            self.save_problem = parts.Problem()
            self.saved = ui.element("div").classes("mp-stack").props('role=status data-test="saved"')

    async def save(self) -> None:
        """Save the trainset; show where it can be used."""
        with self.save_problem.show_errors():
            key, version = await self.service.save_fit(self.job, self.target.value or None)
            self.saved.clear()
            with self.saved:
                words = _("✓ {name}, version {version}", name=version.name, version=version.number)
                ui.label(words).classes("mp-pass").style(WRAPPED)
                used = f"trainset={key}"
                targets = [(_("Edit"), "/edit"), (_("Drive"), "/"), (_("Compare"), "/compare")]
                shown = [(words, f"{path}?{used}") for words, path in targets]
                parts.links([*shown, ("TOML", f"/api/trainsets/{key}/toml?version={version.number}")])

    def load(self) -> None:
        """Fill the form with the linked job and follow it."""
        if not self.job:
            return
        with self.problem.show_errors():
            row = self.service.store.job(self.job)
            if row.kind != "fit":
                raise Refused(f"the job is a {row.kind}, no fit", 404, field="id", value=row.id)
            self.restore(row.request)
            self.follow()

    def restore(self, body: dict[str, Any]) -> None:
        """Fill the form with a request; a log or trainset that was removed since is left out."""
        self.chosen = set(body["logs"])
        self.fill_logs()
        for name in ("trainset", "line"):
            if (body[name] or "") in self.fields[name].options:
                self.fields[name].value = body[name] or ""
        for name in ("load", "origin", "destination"):
            if body[name] in self.fields[name].options:
                self.fields[name].value = body[name]
        self.fields["input"].value = body["input"] or ""
        self.fields["resistance"].value, self.keep.value = body["resistance"], body["keep"]


def _cells(p: dict[str, Any]) -> tuple[str, ...]:
    """Row of a parameter."""
    nominal, value, low, high = (_digits(p[name]) for name in ("nominal", "value", "low", "high"))
    interval = _("{low} to {high}", low=low, high=high) if p["estimated"] else _("kept")
    return retell(p["label"]), nominal, value, interval, p["unit"]


def _digits(value: float) -> str:
    """Format a number with four significant digits, without an exponent."""
    return f"{value:.0f}" if abs(value) >= LARGE else f"{value:.4g}"


def install(service: Service) -> None:
    """Register the page."""

    @ui.page("/fit", title="Fit · metropilot")
    async def fit(request: Request, job: str | None = None, trainset: str | None = None) -> None:
        with parts.frame(request, "/lines"):
            page = FitPage(service, job, trainset)
            page.build()
        await ui.context.client.connected()
        page.load()

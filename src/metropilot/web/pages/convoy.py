"""Convoy: live run of virtually coupled trainsets, with faults of the link."""

from __future__ import annotations

from typing import Any

from fastapi import Request
from nicegui import ui

from metropilot.convoy import FOLLOWERS
from metropilot.errors import MetropilotError
from metropilot.units import KINDS, KMH_PER_MPS
from metropilot.web import catalogue
from metropilot.web.errors import Refused
from metropilot.web.pages import form
from metropilot.web.pages import frame as parts
from metropilot.web.pages.drive import checks_table
from metropilot.web.pages.live_card import AbstractLiveCard
from metropilot.web.pages.plots import convoy_figure, finished_convoy_figure
from metropilot.web.pages.strip import section_strip
from metropilot.web.schemas.requests import ConvoyIn, NewLink
from metropilot.web.service import Service
from metropilot.web.store import JobRow, outcome_words
from metropilot.web.words.language import N_, _, translate_each
from metropilot.web.words.said import retell
from metropilot.web.words.tables import number

SLOW = 1.35
"""Least running time that is proposed, over the minimum: followers need room for their regulation."""
PACES = {1: N_("real time"), 2: "2 ×", 5: "5 ×", 10: "10 ×"}
GUARDS = {
    "coupled": N_("coupled: brakes controlled"),
    "independent": N_("independent: declared brakes"),
    "moving_block": N_("moving block"),
    "none": N_("none"),
}
READS = (
    (N_("time"), "–", "time"),
    (N_("speed of the head"), "–", "speed"),
    (N_("smallest gap now"), "–", "gap"),
    (N_("smallest gap so far"), "–", "least"),
    (N_("largest difference"), "–", "apart"),
    (N_("oldest message"), "–", "age"),
    (N_("link"), "–", "link"),
    (N_("protection"), "–", "level"),
)


class ConvoyPage(AbstractLiveCard):
    """State of the page for one browser."""

    idle = N_("no convoy is under way; depart first")

    def __init__(self, service: Service, run: str | None) -> None:
        self.service = service
        self.link_to = run
        self.run: str | None = None
        self.kept: dict[str, Any] = {}
        self.form = form.SectionForm(service, self.update_section, reserve=SLOW)
        self.world = form.DisturbanceForm()

    def build(self) -> None:
        """Build the fields on the left and the results on the right."""
        with ui.element("div").classes("mp-col"):
            with parts.card(_("Convoy")):
                self.form.build()
                problem = self.form.problem
                followers = list(FOLLOWERS.ids())
                with ui.element("div").classes("mp-row"):
                    self.count = form.number_field(ConvoyIn, "trainsets")
                    self.gap = form.number_field(ConvoyIn, "gap_m")
                with ui.element("div").classes("mp-row"):
                    self.head = ui.select(form.driver_names(self.service), value="optimal", label=_("Head"))
                    self.follower = ui.select(followers, value="follow_plan", label=_("Followers"))
                self.guard = ui.select(
                    translate_each(GUARDS), value="coupled", label=_("Protection relies on")
                )
                fields = (("trainsets", self.count), ("gap_m", self.gap), ("driver", self.head))
                for name, element in (*fields, ("follower", self.follower), ("guard", self.guard)):
                    problem.beside(name, element.props("outlined dense options-dense"))
                self.world.build(problem)
                with ui.element("div").classes("mp-row"):
                    self.build_pace(PACES, 2).props("outlined dense")
                    parts.ActionButton(_("Depart"), icon="play_arrow", on_click=self.depart).props(
                        'unelevated data-test="depart"'
                    )
                    parts.ActionButton(_("Stop"), on_click=self.stop).props("outline")
            self.build_link()
        with ui.element("div").classes("mp-col"):
            self.root = (
                ui.element("section").classes("mp-card").props('data-test="convoy" data-status="none"')
            )
            with self.root, ui.element("div").classes("mp-stack"):
                with ui.element("div").classes("mp-row items-center"):
                    parts.heading(_("Live convoy"))
                    self.status = ui.label(_("not departed")).classes("mp-soft")
                    self.status.props('data-mp="status" aria-live=polite')
                self.strip = parts.strip(_("Section"))
                parts.reads(READS)
                self.plot = parts.plot(convoy_figure())
                self.build_log(_("Events"))
                self.result = ui.element("div").classes("mp-stack").props('data-test="result"')
            self.root.on("mp-result", self.show_result, ["detail"])

    def build_link(self) -> None:
        """Build the fields of the link."""
        with parts.card(
            _("The link"), _("From each trainset to the one behind it; changes act at once."), late=True
        ):
            self.news = parts.Problem()
            with ui.element("div").classes("mp-row"):
                self.delay = form.number_field(NewLink, "delay_s")
                self.jitter = form.number_field(NewLink, "jitter_s")
                self.loss = form.number_field(NewLink, "loss", KINDS["share"]["%"])
                for name, element in (
                    ("delay_s", self.delay),
                    ("jitter_s", self.jitter),
                    ("loss", self.loss),
                ):
                    self.news.beside(name, element.props("outlined dense"))
                    self.form.problem.beside(f"link_{name}", element)
            self.silent = ui.switch(_("Silent: nothing arrives"), on_change=self.relink).props(
                'data-test="silent"'
            )
            parts.for_users(self.silent)
            with ui.element("div").classes("mp-row"):
                parts.ActionButton(_("Set the link"), on_click=self.relink).props(
                    'outline data-test="relink"'
                )
                brake = parts.ActionButton(_("Head: emergency brake"), on_click=self.brake).props(
                    "outline color=negative"
                )
                brake.props('data-test="emergency"')

    async def start(self) -> None:
        """Load the form of the linked run, then the section; runs once the page is connected."""
        row = None
        try:
            if self.link_to:
                row = self.service.store.job(self.link_to)
                self.restore(row)
        finally:
            await self.form.load()
        if row is None:
            return
        self.draw_section()
        if row.id in self.service.sessions:
            self.run = row.id
            self.attach(row.id, row.request["trainsets"])
        elif (found := self.service.store.result(row.id)) is not None:
            self.show_over(row, found)
        else:
            told = f"{row.status}; {row.words or 'its record was not kept'}"
            self.form.problem.label.text = f"{row.id}: {retell(told)}"

    def restore(self, row: JobRow) -> None:
        """Fill the form with the request of a convoy.

        Raises:
            MetropilotError: No convoy, or its line, station or trainset does not exist any more.
        """
        body = row.request
        if "follower" not in body:
            raise Refused(f"the job is a {row.kind}, no convoy", 404, field="id", value=row.id)
        self.form.restore(body)
        self.count.value, self.gap.value = body["trainsets"], body["gap_m"]
        self.head.value = form.driver_choice(self.service, self.head, body["driver"])
        self.follower.value, self.guard.value = body["follower"], body["guard"]
        self.world.restore(body)
        self.delay.value, self.jitter.value = body["link_delay_s"], body["link_jitter_s"]
        self.loss.value = 100 * body["link_loss"]
        session = self.service.sessions.get(row.id)
        pace = body["pace"] if session is None else session.known.pace
        self.pace.value = pace if pace in PACES else self.pace.value
        names = ("start_gap_m", "apart_m", "uncouple_at_m", "emergency_s", "disturbances", "options")
        self.kept = {name: body[name] for name in names} | {"behind": body.get("behind", [])}

    async def update_section(self) -> None:
        """Draw the section, with room for the convoy behind its origin."""
        if self.form.section is not None and self.live() is None:
            self.draw_section()

    def draw_section(self) -> None:
        """Draw the section and the convoy's room behind it."""
        if self.form.section is None:
            return
        length = catalogue.trainset_out(self.service, self.form.trainset_in.value)["length_m"]
        count, gap = int(self.count.number or 2), self.gap.number or 0.0
        self.strip.content = section_strip(self.form.section, 0.0, count * (length + gap))

    async def depart(self) -> None:
        """Start a convoy and watch it."""
        with self.form.problem.show_errors():
            await self.form.wait_for_section()
            body = form.validate(
                ConvoyIn,
                {
                    **self.form.values(),
                    "driver": self.head.value,
                    "trainsets": self.count.value,
                    "follower": self.follower.value,
                    "gap_m": self.gap.value,
                    "guard": self.guard.value,
                    "pace": float(self.pace.value or 1),
                    **self.world.values(),
                    **{f"link_{name}": value for name, value in self.link().items()},
                    **(self.kept if self.form.linked else {}),
                },
                link_loss=100.0,
            )
            session = await self.go_live(body)
            self.draw_section()
            self.attach(session.id, body.trainsets)

    def link(self) -> dict[str, float]:
        """Fields of the link."""
        loss = (self.loss.value or 0) / 100
        return {"delay_s": self.delay.value or 0.0, "jitter_s": self.jitter.value or 0.0, "loss": loss}

    def attach(self, run: str, count: int) -> None:
        """Connect the browser to the stream."""
        self.result.clear()
        with self.result:
            ui.label(_("KPIs of every trainset when all have stopped.")).classes("mp-soft")
        ui.run_javascript(f"metropilotConvoy('c{self.root.id}', {run!r}, {self.plot.id}, {count - 1})")

    async def relink(self) -> None:
        """Send the fields of the link."""
        with self.news.show_errors():
            body = form.validate(NewLink, {**self.link(), "silent": bool(self.silent.value)}, loss=100.0)
            await self.ask({"kind": "link", **body.model_dump()})

    async def brake(self) -> None:
        """Apply the emergency brake of the head."""
        with self.news.show_errors():
            await self.ask({"kind": "emergency"})

    async def change_pace(self) -> None:
        """Send the pace."""
        with self.news.show_errors():
            await self.send_pace(float(self.pace.value or 1))

    async def stop(self) -> None:
        """End the run."""
        with self.news.show_errors():
            await self.under_way().stop()

    def show_summary(self, run: str, found: dict[str, Any]) -> None:
        """Show requirements, KPIs and files of a convoy."""
        self.result.clear()
        with self.result:
            checks_table(found["checks"])
            members_table(found["kpis"]["trainsets"])
            if found["kpis"].get("joint_gap_percent") is not None:
                ui.label(joint_energy(found["kpis"]))
            names = ("trajectories.zip", "kpis.json", "convoy.svg")
            parts.links([(name, f"/api/jobs/{run}/files/{name}") for name in names])

    def show_over(self, row: JobRow, found: dict[str, Any]) -> None:
        """Show a stored convoy."""
        self.plot.update_figure(finished_convoy_figure(found))
        self.root.props(f"data-status={row.status}")
        self.status.text = _("all stopped")
        self.show_summary(row.id, found)


def member_outcome(member: dict[str, Any]) -> tuple[str, str]:
    """Outcome of one trainset with the requirements that it failed, and its style."""
    failed = member.get("failed", ())
    words = outcome_words(member["outcome"].replace("_", " "), failed)
    words = retell(words)
    return (f"✗ {words}", "mp-fail") if failed else (f"✓ {words}", "mp-pass")


def joint_energy(kpis: dict[str, Any]) -> str:
    """Energy of the convoy against its joint optimum, in words."""
    energy, optimum = number(kpis["energy_wheel_kwh"]), number(kpis["joint_optimal_energy_kwh"])
    above = number(kpis["joint_gap_percent"], 1)
    return _(
        "{energy} kWh at the wheel, {above} % above the joint optimum of {optimum} kWh",
        energy=energy,
        above=above,
        optimum=optimum,
    )


def members_table(trainsets: list[dict[str, Any]]) -> None:
    """Show a row for each trainset."""
    rows = [
        (
            _("head") if t["number"] == 1 else str(t["number"]),
            t["driver"],
            member_outcome(t),
            number(t["running_time_s"], 1),
            number(100 * t["stopping_error_m"], 1),
            number(t["max_jerk_mps3"], 2),
            number(t["energy_wheel_kwh"], 2),
            # convoys stored before these figures existed
            number(t.get("joint_energy_kwh"), 2),
            number(t["gap_min_m"], 2),
            number(t["gap_max_m"], 2),
            number(t.get("gap_error_m"), 2),
            number(
                None
                if t["speed_difference_max_mps"] is None
                else KMH_PER_MPS * t["speed_difference_max_mps"],
                2,
            ),
            str(t["interventions"]),
        )
        for t in trainsets
    ]
    columns = (
        _("trainset"),
        _("driver"),
        _("outcome"),
        _("time (s)"),
        _("stop (cm)"),
        _("jerk (m/s³)"),
        _("wheel (kWh)"),
        _("optimum (kWh)"),
        _("gap min (m)"),
        _("gap max (m)"),
        _("gap error (m)"),
        _("difference (km/h)"),
        _("interventions"),
    )
    parts.table(columns, rows, right=range(3, 13), name=_("Trainsets"))


def install(service: Service) -> None:
    """Register the page."""

    @ui.page("/convoy", title="Convoy · metropilot")
    async def convoy(request: Request, run: str | None = None) -> None:
        with parts.frame(request, "/convoy"):
            page = ConvoyPage(service, run)
            page.build()
        await ui.context.client.connected()
        try:
            await page.start()
        except MetropilotError as error:
            page.form.problem.show(error)

"""What is to be driven: line, section, trainset, load, time, and what goes differently than planned."""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from nicegui import ui

from metropilot.errors import MetropilotError
from metropilot.web import catalogue
from metropilot.web.asked import PlanAsked
from metropilot.web.pages.frame import Problem, number
from metropilot.web.pages.strip import names
from metropilot.web.service import Service

SLOWEST = 1.6
FIRST = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "trainset": "dkz32", "load": None}
Changed = Callable[[], Awaitable[None]]


class SectionForm:
    """The fields of a section and its time.

    Args:
        service: The server's work.
        changed: Called when section, trainset or bounds have changed.
        moved: Called when only the time has.
        first: What the fields hold at first, as a request has it; what is not named is as it always is.

    Attributes:
        problem: Where it says what is wrong.
        section: The section as it was last answered.
    """

    problem: Problem

    def __init__(
        self,
        service: Service,
        changed: Changed,
        moved: Changed | None = None,
        first: Mapping[str, Any] | None = None,
    ) -> None:
        self.service = service
        self.first = {**FIRST, **(first or {})}
        self.first_s: float | None = self.first.get("time_s")
        self.changed, self.moved = changed, moved
        self.section: dict[str, Any] | None = None
        self.line = catalogue.line_out(service, self.first["line"])
        self._filling = False

    @property
    def time_s(self) -> float:
        """The time the slider is at."""
        return float(self.slider.value or 0.0)

    def build(self) -> None:
        """Place the fields."""
        lines = {row["id"]: row["name"] for row in catalogue.line_rows(self.service)}
        trainsets = {row["id"]: row["name"] for row in catalogue.trainset_rows(self.service)}
        self.line_in = ui.select(lines, value=self.first["line"], label="Line", on_change=self._line_changed)
        stops = names(self.line["stops"])
        self.origin_in = ui.select(stops, value=self._code("origin"), label="From", on_change=self._refresh)
        self.destination_in = ui.select(
            stops, value=self._code("destination"), label="To", on_change=self._refresh
        )
        first = self.first["trainset"] if self.first["trainset"] in trainsets else next(iter(trainsets))
        with ui.element("div").classes("mp-row"):
            self.trainset_in = ui.select(
                trainsets, value=first, label="Trainset", on_change=self._trainset_changed
            )
            loads = self._loads(first)
            load = self.first["load"] if self.first["load"] in loads else next(iter(loads))
            self.load_in = ui.select(loads, value=load, label="Load", on_change=self._refresh)
        for element in (self.line_in, self.origin_in, self.destination_in, self.trainset_in, self.load_in):
            element.props("outlined dense options-dense")
        self.time_words = ui.label("Running time").classes("mp-soft")
        self.slider = ui.slider(min=60, max=160, step=1, value=101, on_change=self._time_moved)
        self.slider.props('label aria-label="Scheduled running time in seconds" data-test="time"')
        self.problem = Problem()
        fields = (("line", self.line_in), ("station", self.origin_in), ("origin", self.origin_in))
        for name, element in (*fields, ("destination", self.destination_in), ("trainset", self.trainset_in)):
            self.problem.beside(name, element)

    def asked(self) -> dict[str, Any]:
        """The fields of a request."""
        return {
            "line": self.line_in.value,
            "origin": self.origin_in.value,
            "destination": self.destination_in.value,
            "trainset": self.trainset_in.value,
            "load": self.load_in.value,
            "time_s": self.time_s,
        }

    async def load(self) -> None:
        """Ask for the section and bound the slider by its minimum running time."""
        self.problem.clear()
        asked = {**self.asked(), "time_s": None}
        try:
            self.section = await self.service.section(PlanAsked.model_validate(asked))
        except MetropilotError as error:
            self.section = None
            self.problem.show(error)
            return
        least = math.ceil(self.section["minimum_running_time_s"])
        most = math.ceil(SLOWEST * least)
        planned = self.first_s or self.section["planned_time_s"] or math.ceil(1.12 * least)
        least, most = min(least, math.floor(planned)), max(most, math.ceil(planned))
        self.first_s = None
        self._filling = True
        self.slider.props["min"], self.slider.props["max"] = least, most
        self.slider.value = min(max(planned, least), most)
        self._filling = False
        self._say_time()
        await self.changed()

    def _code(self, name: str) -> str:
        """The station a field holds at first, by its code; a request may have named it otherwise."""
        section = catalogue.line(self.service, self.first["line"]).section(
            self.first["origin"], self.first["destination"]
        )
        return getattr(section, name).code

    def _say_time(self) -> None:
        if self.section is None:
            return
        least, now = self.section["minimum_running_time_s"], self.time_s
        planned = self.section["planned_time_s"]
        timetable = f" · timetable {planned:g} s" if planned else ""
        self.time_words.text = (
            f"Running time {now:.0f} s · minimum {least:.1f} s · "
            f"reserve {number(100 * (now / least - 1), 0, '%')}{timetable}"
        )

    def _loads(self, trainset: str) -> dict[str, str]:
        loads = catalogue.trainset_out(self.service, trainset)["loads_kg"]
        return {name: f"{name} · {kg / 1000:.0f} t" for name, kg in loads.items()}

    async def _line_changed(self) -> None:
        self.line = catalogue.line_out(self.service, self.line_in.value)
        stops = names(self.line["stops"])
        self._filling = True
        codes = list(stops)
        self.origin_in.set_options(stops, value=codes[0])
        self.destination_in.set_options(stops, value=codes[1])
        self._filling = False
        await self.load()

    async def _trainset_changed(self) -> None:
        loads = self._loads(self.trainset_in.value)
        self._filling = True
        self.load_in.set_options(loads, value=next(iter(loads)))
        self._filling = False
        await self.load()

    async def _refresh(self) -> None:
        if not self._filling:
            await self.load()

    async def _time_moved(self) -> None:
        if self._filling:
            return
        self._say_time()
        if self.moved is not None:
            await self.moved()


class DisturbanceForm:
    """What goes differently than planned.

    Args:
        first: What the fields hold at first, as a request has it.
    """

    FIELDS = (
        ("mass_factor", "True mass / believed", 1.0, 0.5, 2.0, 0.05),
        ("resistance_factor", "True resistance / believed", 1.0, 0.0, 5.0, 0.1),
        ("delay_s", "Dead time on top (s)", 0.0, 0.0, 5.0, 0.1),
        ("lag_s", "Lag on top (s)", 0.0, 0.0, 5.0, 0.1),
        ("speed_noise_mps", "Speed noise, 1σ (m/s)", 0.0, 0.0, 1.0, 0.01),
        ("seed", "Seed", 0, 0, 2**31, 1),
    )

    def __init__(self, first: Mapping[str, Any] | None = None) -> None:
        self.first = first or {}

    def build(self, problem: Problem) -> None:
        """Place the fields, folded away while all is as planned."""
        self.inputs: dict[str, ui.number] = {}
        plain = {"ideal": False, **{name: value for name, _, value, *_ in self.FIELDS}}
        open_ = any(self.first.get(name, value) != value for name, value in plain.items())
        with (
            ui.expansion("What goes differently than planned", value=open_).props("dense").classes("mp-soft"),
            ui.element("div").classes("mp-stack"),
        ):
            for name, words, value, low, high, step in self.FIELDS:
                made = ui.number(words, value=self.first.get(name, value), min=low, max=high, step=step)
                self.inputs[name] = problem.beside(name, made.props("outlined dense"))
            self.ideal = ui.checkbox("Ideal actuation: no delay, lag or jerk limit")
            self.ideal.value = bool(self.first.get("ideal"))

    def asked(self) -> dict[str, Any]:
        """The fields of a request; an empty one is as planned."""
        plain = {name: value for name, _, value, *_ in self.FIELDS}
        given = {n: plain[n] if e.value is None else e.value for n, e in self.inputs.items()}
        return {**given, "seed": int(given["seed"]), "ideal": self.ideal.value}


def driver_names() -> dict[str, str]:
    """Drivers for a list to choose from."""
    return {row["id"]: row["id"] for row in catalogue.driver_rows()}

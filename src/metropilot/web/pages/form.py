"""Forms of a run: line, section, trainset, load, running time, disturbances."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, TypeVar

from nicegui import ui
from pydantic import BaseModel, ValidationError

from metropilot.errors import InputError, MetropilotError
from metropilot.evaluate import POLICY, parse_driver, run_fields
from metropilot.units import J_PER_KWH, KMH_PER_MPS, Unit
from metropilot.web import catalogue
from metropilot.web.errors import Refused, place_of, refusal_of
from metropilot.web.pages.frame import Problem, prop_of, set_quietly
from metropilot.web.pages.numbers import NumberField, Slider
from metropilot.web.pages.strip import names
from metropilot.web.schemas.requests import (
    DriveIn,
    NewRestriction,
    PlanIn,
    PlantPlanIn,
    RestrictionIn,
    spec_of,
)
from metropilot.web.service import Service
from metropilot.web.words.language import N_, _, translate_each
from metropilot.web.words.said import retell
from metropilot.web.words.tables import number

SLOWEST = 1.6
OBJECTIVES = {"wheel": N_("Energy at the wheel"), "line": N_("Energy at the line")}
COUNTLESS = 2.0**53
"""Upper bound from which on a range is shown without it (that of seeds)."""
POLICIES_SHOWN = 20
Changed = Callable[[], Awaitable[None]]
Body = TypeVar("Body", bound=BaseModel)


def describe_range(kind: type[BaseModel], name: str, scale: float = 1.0) -> str:
    """Describe the range of a number field of a request.

    Args:
        kind: Type of the request.
        name: Name of the field.
        scale: Displayed value over the field's (100 for percent of a share).
    """
    told = kind.model_json_schema()["properties"][name]
    told = told.get("anyOf", [told])[0]
    low = told.get("minimum", told.get("exclusiveMinimum"))
    high = told.get("maximum", told.get("exclusiveMaximum", math.inf))
    least, most = (f"{scale * bound:,.10g}".replace(",", " ") for bound in (low, high))
    least = least if "minimum" in told else _("above {least}", least=least)
    most = most if "maximum" in told else _("below {most}", most=most)
    if high < COUNTLESS:
        return _("{least} to {most}", least=least, most=most)
    return _("{least} or more", least=least) if "minimum" in told else least


def number_field(kind: type[BaseModel], name: str, unit: Unit | None = None, **more: Any) -> NumberField:  # noqa: ANN401
    """Place a number field that shows its range; a value out of range is refused, not clipped.

    Label, unit, step and first value are those of the declaration, where nothing else is given.

    Args:
        kind: Type of the request.
        name: Name of the field.
        unit: Unit of the displayed value, where it is not the declaration's.
        more: ``label``, ``value``, ``step``, ``on_change`` of NiceGUI.
    """
    spec = spec_of(kind, name)
    unit = unit or spec.shown_unit
    scale = 1.0 if unit is None else unit.denominator / unit.numerator
    field = kind.model_fields[name]
    declared = {
        "label": f"{_(spec.label)} ({unit.name})" if unit else _(spec.label),
        "value": None if field.is_required() else field.get_default(),
        "step": (unit.from_si(spec.step) if unit else spec.step) or None,
    }
    made = NumberField(**declared | more)
    made.usual = declared["value"]
    return made.props("outlined dense").props(prop_of("hint", describe_range(kind, name, scale)))


def validate(kind: type[Body], values: dict[str, Any], **scales: float) -> Body:
    """Validate a request; a refusal names the allowed range.

    Args:
        kind: Type of the request.
        values: Its fields.
        scales: Displayed values over those of fields, where not 1.

    Raises:
        InputError: A field is not allowed.
    """
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        found = error.errors()
        refused, name = refusal_of(found, values, kind), place_of(found[0], values)
        declared = isinstance(found[0].get("ctx", {}).get("error"), InputError)
        if is_bounded(kind, name) and (name in scales or not declared):
            scale, told = scales.get(name, 1.0), refused.value
            given = values.get(name)
            if scale != 1.0 and isinstance(given, float) and math.isfinite(given):
                told = given * scale
            allowed = describe_range(kind, name, scale)
            raise InputError(refused.message, field=name, value=told, allowed=allowed) from None
        raise refused from None


def is_bounded(kind: type[BaseModel], name: str) -> bool:
    """Tell whether a field of a request is a number with a least value."""
    told = kind.model_json_schema()["properties"].get(name, {})
    return bool({"minimum", "exclusiveMinimum"} & set(told.get("anyOf", [told])[0]))


class RestrictionForm:
    """Speed restrictions known before departure, or sent on the way; each a row of fields.

    Args:
        changed: Called when a restriction is added, changed or removed.
    """

    def __init__(self, changed: Callable[[], Any]) -> None:
        self.changed = changed
        self.rows: list[dict[str, NumberField]] = []

    def build(self) -> None:
        """Place the rows in a closed expansion."""
        self.fold = ui.expansion(_("Speed restrictions")).props("dense").classes("mp-soft")
        with self.fold, ui.element("div").classes("mp-stack"):
            self.place = ui.element("div").classes("mp-stack").props('data-test="restrictions"')
            more = ui.button(_("Add a restriction"), icon="add", on_click=self.add)
            more.props("flat dense no-caps")

    def add(self) -> Any:  # noqa: ANN401 (a page's answer)
        """Add a restriction behind the last one."""
        begin = max((row["to_m"].number or 0.0 for row in self.rows), default=400.0)
        self.place_row({"from_m": begin + 100.0, "to_m": begin + 200.0, "limit_mps": 40 / KMH_PER_MPS})
        return self.changed()

    def place_row(self, body: dict[str, Any]) -> None:
        """Place the fields of a restriction."""
        row: dict[str, NumberField] = {}
        with self.place, ui.element("div").classes("mp-row items-center") as shown:
            for name in ("from_m", "to_m", "limit_mps"):
                unit = spec_of(NewRestriction, name).shown_unit
                value = body[name] if unit is None else unit.from_si(float(body[name]))
                row[name] = number_field(NewRestriction, name, value=value, on_change=self.changed)
            row["at_s"] = number_field(
                RestrictionIn,
                "at_s",
                label=_("Sent after (s); empty: known before"),
                value=body.get("at_s"),
                step=1,
                on_change=self.changed,
            )
            remove = ui.button(icon="remove", on_click=lambda: self.remove(row, shown))
            remove.props("flat dense round").props(prop_of("aria-label", _("Remove this restriction")))
        self.rows.append(row)

    def remove(self, row: dict[str, NumberField], shown: ui.element) -> Any:  # noqa: ANN401 (a page's answer)
        """Remove a restriction."""
        self.rows.remove(row)
        shown.delete()
        return self.changed()

    def values(self) -> list[dict[str, float | None]]:
        """Restrictions for a request, in SI."""
        found = []
        for row in self.rows:
            given: dict[str, float | None] = {}
            for name, field in row.items():
                unit = spec_of(NewRestriction, name).shown_unit if name != "at_s" else None
                value = field.value
                given[name] = value if value is None or unit is None else unit.to_si(float(value))
            found.append(given)
        return found

    def move(self, k: int, place: dict[str, float]) -> None:
        """Write a restriction, as displayed, into the fields of a row."""
        for name, value in place.items():
            self.rows[k][name].value = value

    def restore(self, restrictions: list[dict[str, Any]]) -> None:
        """Fill in the restrictions of a request."""
        self.rows.clear()
        self.place.clear()
        for each in restrictions:
            self.place_row(each)
        if restrictions:
            self.fold.open()


class SectionForm:
    """Fields of a section and its running time.

    Args:
        service: Service of the server.
        changed: Called when section, trainset or bounds change.
        moved: Called when only the running time changes.
        reserve: Least running time that is proposed, over the minimum; 1: that of the timetable.

    Attributes:
        problem: Place of its errors.
        section: The section of the latest answer.
        linked: True while the fields are those of the linked run.
        kept: Values of that run without a field here: arrivals.
    """

    problem: Problem

    def __init__(
        self, service: Service, changed: Changed, moved: Changed | None = None, *, reserve: float = 1.0
    ) -> None:
        self.service = service
        self.changed, self.moved, self.reserve = changed, moved, reserve
        self._loading, self._loaded = 0, asyncio.Event()
        self._requests, self._proposing = 0, True
        self._refusal: MetropilotError | None = None
        self.section: dict[str, Any] | None = None
        self.line = catalogue.line_out(service, "yizhuang")
        self.linked = False
        self.kept: dict[str, Any] = {}
        self.filling = False
        self._restored_s: float | None = None

    @property
    def time_s(self) -> float:
        """Running time of the slider, s."""
        return float(self.slider.value or 0.0)

    @property
    def time_bounds_s(self) -> tuple[float, float]:
        """Least and greatest running time of the slider, s."""
        return self.slider.props["min"], self.slider.props["max"]

    def build(self) -> None:
        """Place the fields."""
        lines = {row["id"]: row["name"] for row in catalogue.line_rows(self.service)}
        trainsets = {row["id"]: row["name"] for row in catalogue.trainset_rows(self.service)}
        self.restrictions = RestrictionForm(self._replan)
        self.line_in = ui.select(lines, value="yizhuang", label=_("Line"), on_change=self._line_changed)
        stops = names(self.line["stops"])
        self.origin_in = ui.select(stops, value="RJ", label=_("From"), on_change=self._refresh)
        self.destination_in = ui.select(stops, value="WYJ", label=_("To"), on_change=self._refresh)
        first = "dkz32" if "dkz32" in trainsets else next(iter(trainsets))
        with ui.element("div").classes("mp-row"):
            self.trainset_in = ui.select(
                trainsets, value=first, label=_("Trainset"), on_change=self._trainset_changed
            )
            aboard = loads(self.service, first)
            self.load_in = ui.select(
                aboard, value=next(iter(aboard)), label=_("Load"), on_change=self._refresh
            )
        for element in (self.line_in, self.origin_in, self.destination_in, self.trainset_in, self.load_in):
            element.props("outlined dense options-dense")
        self.time_words = ui.label(_("Running time")).classes("mp-soft mp-two")
        self.slider = Slider(min=60, max=160, step=1, value=101, on_change=self._time_moved)
        self.slider.props('label data-test="time"')
        self.slider.props(prop_of("aria-label", _("Scheduled running time in seconds")))
        self.restrictions.build()
        self.objective = ui.select(
            translate_each(OBJECTIVES), value="wheel", label=_("Plans save"), on_change=self._replan
        )
        self.objective.props("outlined dense options-dense")
        self.kept_words = ui.label("").classes("mp-soft").props('data-test="kept"')
        self.problem = Problem()
        fields = (("line", self.line_in), ("station", self.origin_in), ("origin", self.origin_in))
        for name, element in (*fields, ("destination", self.destination_in), ("trainset", self.trainset_in)):
            self.problem.beside(name, element)

    def values(self) -> dict[str, Any]:
        """Values of the fields for a request."""
        return {
            "restrictions": self.restrictions.values(),
            "objective": self.objective.value,
            "line": self.line_in.value,
            "origin": self.origin_in.value,
            "destination": self.destination_in.value,
            "trainset": self.trainset_in.value,
            "load": self.load_in.value,
            "time_s": self.time_s,
        }

    def plan_request(
        self, time_s: float | None, disturbance: Mapping[str, Any] = MappingProxyType({})
    ) -> PlantPlanIn:
        """Plan request of the fields for a running time.

        Args:
            time_s: Running time.
            disturbance: Values of the true plant; others of a run are left out.

        Raises:
            InputError: A field is not allowed.
        """
        plant = {name: value for name, value in disturbance.items() if name in PlantPlanIn.model_fields}
        return validate(PlantPlanIn, {**self.values(), **plant, "time_s": time_s})

    def restore(self, body: dict[str, Any]) -> None:
        """Fill the fields with the request of a run; the page loads afterwards.

        Raises:
            InputError: Its line, station or trainset does not exist any more.
        """
        line = catalogue.line(self.service, body["line"])
        trainset = catalogue.trainset_out(self.service, body["trainset"])
        ends = [line.station(body[name]).code for name in ("origin", "destination")]
        self.line = catalogue.line_out(self.service, body["line"])
        stops = names(self.line["stops"])
        with set_quietly(self):
            if body["trainset"] not in self.trainset_in.options:  # another dead time, or a random one
                named: Any = self.trainset_in.options
                self.trainset_in.set_options({**named, body["trainset"]: body["trainset"]})
            self.line_in.value, self.trainset_in.value = body["line"], body["trainset"]
            self.origin_in.set_options(stops, value=ends[0])
            self.destination_in.set_options(stops, value=ends[1])
            self.load_in.set_options(
                loads(self.service, body["trainset"]), value=body["load"] or trainset["load"]
            )
            self._restored_s = body["time_s"]
            self.restrictions.restore(body.get("restrictions", []))
            self.objective.value = body.get("objective", "wheel")
        self.kept = {"arrivals": body["arrivals"]} if body.get("arrivals") else {}
        self.kept_words.text = describe_hidden(self.kept, body.get("options", {}))
        self.linked = True

    def choose(self, line: str | None, trainset: str | None) -> None:
        """Fill in a line or trainset that a link names; the page loads afterwards.

        Raises:
            Refused: No such line or trainset (404).
        """
        with set_quietly(self):
            if line is not None:
                self.line = catalogue.line_out(self.service, line)
                stops = names(self.line["stops"])
                self.line_in.value, codes = line, list(stops)
                self.origin_in.set_options(stops, value=codes[0])
                self.destination_in.set_options(stops, value=codes[1])
            if trainset is not None:
                aboard = loads(self.service, trainset)
                self.trainset_in.value = trainset
                self.load_in.set_options(aboard, value=next(iter(aboard)))

    async def wait_for_section(self) -> dict[str, Any]:
        """Wait until the section of the fields is there: a press of a button may come before it.

        Raises:
            MetropilotError: The fields are those of no section.
        """
        await self._loaded.wait()
        if self.section is None:
            raise self._refusal or Refused("choose a section first", 422, field="origin")
        return self.section

    async def load(self, *, same_time: bool = False) -> None:
        """Request the section and bound the slider by its minimum running time.

        Args:
            same_time: Leave the running time as it is, where it is possible; else propose one.
        """
        self._loaded.clear()
        self._loading += 1
        # until a section is there: what asks for the same time meanwhile has none that is the section's
        self._proposing = self._proposing or not same_time
        try:
            found = await self._request()
        finally:
            self._loading -= 1
            if not self._loading:
                self._loaded.set()
        if found:
            await self.changed()

    async def _request(self) -> bool:
        self.problem.clear()
        body = {**self.values(), "time_s": None}
        self._requests += 1
        request = self._requests
        found, refusal = None, None
        try:
            found = await self.service.section(validate(PlanIn, body))
        except MetropilotError as error:
            refusal = error
        if request != self._requests:  # the fields have changed meanwhile
            return False
        self.section, self._refusal = found, refusal
        if refusal is not None:
            self.problem.show(refusal)
        if self.section is None:
            return False
        least = math.ceil(self.section["minimum_running_time_s"])
        most = math.ceil(SLOWEST * least)
        slow = round(self.reserve * self.section["minimum_running_time_s"])
        proposed = max(self.section["planned_time_s"] or math.ceil(1.12 * least), slow)
        # the slider may have been moved while the section was computed
        planned = self._restored_s or (proposed if self._proposing else self.time_s)
        least, most = min(least, math.floor(planned)), max(most, math.ceil(planned))
        self._restored_s, self._proposing = None, False
        with set_quietly(self):
            self.slider.props["min"], self.slider.props["max"] = least, most
            self.slider.value = min(max(planned, least), most)
        self._say_time()
        return True

    def _say_time(self) -> None:
        if self.section is None:
            return
        least, now = self.section["minimum_running_time_s"], self.time_s
        planned = self.section["planned_time_s"]
        words = _(
            "Running time {now} s · minimum {least} s · reserve {reserve}",
            now=f"{now:.0f}",
            least=f"{least:.1f}",
            reserve=number(100 * (now / least - 1), 0, "%"),
        )
        timetable = _("timetable {planned} s", planned=f"{planned:g}") if planned else ""
        self.time_words.text = f"{words} · {timetable}" if timetable else words

    def _changed_by_hand(self) -> bool:
        """Tell whether the user changed a field; if so, forget the linked run."""
        if self.filling:
            return False
        self.linked, self.kept, self.kept_words.text = False, {}, ""
        return True

    def _line_changed(self) -> Awaitable[None] | None:
        if not self._changed_by_hand():
            return None
        self.line = catalogue.line_out(self.service, self.line_in.value)
        stops = names(self.line["stops"])
        codes = list(stops)
        with set_quietly(self):
            self.origin_in.set_options(stops, value=codes[0])
            self.destination_in.set_options(stops, value=codes[1])
        return self.load()

    def _trainset_changed(self) -> Awaitable[None] | None:
        if not self._changed_by_hand():
            return None
        found = loads(self.service, self.trainset_in.value)
        with set_quietly(self):
            self.load_in.set_options(found, value=next(iter(found)))
        return self.load()

    def _refresh(self) -> Awaitable[None] | None:
        return self.load() if self._changed_by_hand() else None

    def _replan(self) -> Awaitable[None] | None:
        # told at once, not when it is awaited: by then the form is filled
        return None if self.filling else self._load_at_same_time()

    async def _load_at_same_time(self) -> None:
        """Load the section anew with other restrictions, or another objective, at the same time."""
        await self.load(same_time=True)
        if self.section is not None and self.time_s < self.section["minimum_running_time_s"]:
            self.slider.value = math.ceil(self.section["minimum_running_time_s"])

    async def move_restriction(self, k: int, place: dict[str, float]) -> None:
        """Move a restriction known before departure, and plan anew; ``place`` is as displayed."""
        if k < len(self.restrictions.rows):
            with set_quietly(self):
                self.restrictions.move(k, place)
            self.restrictions.fold.open()
            await self._load_at_same_time()

    def _time_moved(self) -> Awaitable[None] | None:
        if self.filling:
            return None
        self._say_time()
        return None if self.moved is None else self.moved()


def loads(service: Service, trainset: str) -> dict[str, str]:
    """Options of a list of loads of a trainset."""
    found = catalogue.trainset_out(service, trainset)["loads_kg"]
    return {name: f"{name} · {kg / 1000:.0f} t" for name, kg in found.items()}


def describe_hidden(kept: dict[str, Any], options: dict[str, Any]) -> str:
    """Describe the values of a linked run without a field here, with the driver's options but its policy."""
    said = [
        _("arrive after {time} s, sent after {at} s", time=f"{a['scheduled_time_s']:g}", at=f"{a['at_s']:g}")
        for a in kept.get("arrivals", ())
    ]
    said += [f"{name} {value}" for name, value in other_options(options).items()]
    return _("Of the linked run: {values}.", values="; ".join(said)) if said else ""


class FoldedNumbers:
    """Number fields of a request in a closed expansion; an empty field has its default.

    Args:
        kind: Type of the request.
        title: Heading of the expansion.
        fields: Names of its fields.
    """

    def __init__(self, kind: type[BaseModel], title: str, fields: Sequence[str]) -> None:
        self.kind, self.title, self.fields = kind, title, tuple(fields)

    def build(self, problem: Problem, changed: Callable[[], Any] | None = None) -> None:
        """Place the fields."""
        self.inputs: dict[str, NumberField] = {}
        self.fold = ui.expansion(self.title).props("dense").classes("mp-soft")
        with self.fold, ui.element("div").classes("mp-stack") as self.stack:
            for name in self.fields:
                field = self.place(name, changed)
                self.inputs[name] = problem.beside(name, field, self.fold)

    def place(self, name: str, changed: Callable[[], Any] | None) -> NumberField:
        """Place a field."""
        return number_field(self.kind, name, on_change=changed)

    def defaults(self) -> dict[str, Any]:
        """Defaults of the fields."""
        return {name: self.kind.model_fields[name].get_default() for name in self.fields}

    def values(self) -> dict[str, Any]:
        """Values of the fields for a request."""
        plain = FoldedNumbers.defaults(self)
        return {n: plain[n] if e.value is None else e.value for n, e in self.inputs.items()}

    def restore(self, body: dict[str, Any]) -> None:
        """Fill the fields with a request; open the expansion if one is not the default."""
        plain = self.defaults()
        for name, element in self.inputs.items():
            element.value = body.get(name, plain[name])
        if self.values() != plain:
            self.fold.open()


SLIDERS = {
    "mass_factor": (0.7, 1.5, 0.01),
    "resistance_factor": (0.5, 2.0, 0.05),
    "delay_s": (0.0, 2.0, 0.05),
    "lag_s": (0.0, 2.0, 0.05),
}
"""Disturbances with a slider where a plan follows: least, greatest, step; the fields take more."""


class DisturbanceForm(FoldedNumbers):
    """Fields of the disturbance; where something follows their change, with sliders."""

    FIELDS = tuple(name for name, spec in run_fields().items() if spec.label and spec.range is not None)

    def __init__(self) -> None:
        super().__init__(DriveIn, _("Disturbances"), self.FIELDS)
        self.seed: int | None = None

    def build(self, problem: Problem, changed: Callable[[], Any] | None = None) -> None:
        """Place the fields, and that of an ideal trainset."""
        super().build(problem, changed)
        with self.stack:
            words = retell(run_fields()["ideal"].help.rstrip("."))
            self.ideal = ui.checkbox(words, on_change=changed)
            self.plant_words = ui.label("").classes("mp-soft").props('data-test="plant" aria-live=polite')

    def place(self, name: str, changed: Callable[[], Any] | None) -> NumberField:
        """Place a field, and the slider beside it."""
        if changed is None or name not in SLIDERS:
            return super().place(name, changed)
        least, most, step = SLIDERS[name]

        def slide() -> None:
            if field.number is None or slider.value != min(max(field.number, least), most):
                field.value = slider.value

        def follow() -> Any:  # noqa: ANN401 (a page's answer)
            if field.number is not None:
                slider.value = min(max(field.number, least), most)
            return changed()

        with ui.element("div").classes("mp-slid"):
            field = number_field(self.kind, name, on_change=follow)
            slider = Slider(min=least, max=most, step=step, value=field.value or least, on_change=slide)
            slider.props(prop_of("aria-label", _(spec_of(self.kind, name).label)))
        return field

    def say_plant(self, plan: dict[str, Any]) -> None:
        """Say what the true plant needs.

        Args:
            plan: Values of :class:`metropilot.web.schemas.responses.PlansOut`.
        """
        given = {name: value for name, value in self.values().items() if name in PlantPlanIn.model_fields}
        plain = {name: PlantPlanIn.model_fields[name].get_default() for name in given}
        if given == plain:
            self.plant_words.text = ""
        elif plan["plant"] is None:
            self.plant_words.text = _("The true plant cannot keep this running time under protection.")
        else:
            self.plant_words.text = _(
                "The true plant needs {energy} kWh at best, with its dead time, lag and jerk limit under "
                "protection; the plan is {planned} kWh.",
                energy=number(plan["plant"]["energy_j"] / J_PER_KWH, 2),
                planned=number(plan["energy_j"] / J_PER_KWH, 2),
            )

    def defaults(self) -> dict[str, Any]:
        """Values of the fields of a run without disturbance."""
        return super().defaults() | {"ideal": DriveIn.model_fields["ideal"].get_default()}

    def values(self) -> dict[str, Any]:
        """Values of the fields for a request."""
        found = super().values() | {"ideal": self.ideal.value}
        if self.seed is not None and self.inputs["seed"].value is None:
            found["seed"] = self.seed
        return found

    def restore(self, body: dict[str, Any]) -> None:
        """Fill the fields with the request of a run; open the expansion if there is a disturbance."""
        self.ideal.value = body.get("ideal", self.defaults()["ideal"])
        # a browser has no such integers: the field stays empty, which stands for the seed of the linked run
        self.seed = body["seed"] if body.get("seed", 0) >= COUNTLESS else None
        if self.seed is not None:
            words = _("empty: {seed}, that of the linked run", seed=self.seed)
            self.inputs["seed"].props(prop_of("hint", words))
            self.inputs["seed"].usual = None
        super().restore(body if self.seed is None else body | {"seed": None})


OWN, PUBLISHED, LEARNED = N_("Own"), N_("Published"), N_("Learned")
KINDS = (OWN, PUBLISHED, LEARNED)


def driver_kind(row: dict[str, Any]) -> str:
    """Kind of a driver: learned, of a paper, or own."""
    if POLICY in row["options"]:
        return LEARNED
    return OWN if row["source"].startswith("own") else PUBLISHED


def describe_driver(name: str) -> str:
    """One sentence about a driver: its kind, what it does, its source."""
    row = driver_row(name)
    if row is None:
        return ""
    told = {"summary": retell(row["summary"]), "source": retell(row["source"])}
    return _("{kind}: {summary} ({source})", kind=_(driver_kind(row)), **told)


def driver_row(name: str) -> dict[str, Any] | None:
    """Values of a driver, as a list of drivers has it; None if there is none of that id."""
    driver = parse_driver(name)[0]
    return next((each for each in catalogue.driver_rows() if each["id"] == driver), None)


class DriverOptions:
    """Fields of a driver's options in a closed expansion; those at their default are not sent."""

    def build(self, problem: Problem) -> None:
        """Place the expansion."""
        self.problem = problem
        self.fold = ui.expansion(_("Driver options")).props("dense").classes("mp-soft")
        with self.fold:
            self.place = ui.element("div").classes("mp-stack").props('data-test="driver-options"')
        self.problem.beside("set", self.fold)

    def show(self, name: str, given: dict[str, Any] | None = None) -> None:
        """Place the fields of a driver.

        Args:
            name: Driver, as a list of drivers has it.
            given: Options that differ from their defaults.
        """
        row = driver_row(name)
        self.plain = other_options({} if row is None else row["options"])
        values = self.plain | {key: value for key, value in (given or {}).items() if key in self.plain}
        self.inputs: dict[str, Any] = {}
        self.place.clear()
        self.fold.set_visibility(bool(self.plain))
        with self.place:
            for key, value in values.items():
                self.inputs[key] = self.field(key, value)
                if isinstance(self.inputs[key], NumberField):
                    self.inputs[key].usual = self.plain[key]
                for place in (f"set {key}", f"options.{key}"):
                    self.problem.beside(place, self.inputs[key], self.fold)
        if given:
            self.fold.open()

    @staticmethod
    def field(key: str, value: object) -> Any:  # noqa: ANN401 (any field of NiceGUI)
        """Place a field for a value of this kind."""
        label = key.replace("_", " ")
        if isinstance(value, bool):
            return ui.checkbox(label, value=value)
        if isinstance(value, int | float):
            return NumberField(label, value=value).props("outlined dense")
        return ui.input(label, value=str(value or "")).props("outlined dense")

    def values(self) -> dict[str, Any]:
        """Options for a request."""
        found = {}
        for key, field in self.inputs.items():
            value, plain = field.value, self.plain[key]
            if type(plain) is int and isinstance(value, float) and value.is_integer():
                value = int(value)
            if value not in {plain, "", None}:
                found[key] = value
        return found


def is_learned(name: str) -> bool:
    """Tell whether a driver of a list is a learned one."""
    row = driver_row(name)
    return row is not None and driver_kind(row) == LEARNED


def driver_names(service: Service | None = None) -> dict[str, str]:
    """Options of a list of drivers by kind, with learned and uploaded policies.

    Args:
        service: Service with the policies; None for none.
    """
    rows = sorted(catalogue.driver_rows(), key=lambda row: KINDS.index(driver_kind(row)))
    found = {row["id"]: row["id"] for row in rows}
    policies = [] if service is None else list(service.policies())[:POLICIES_SHOWN]
    if policies:
        found.pop("learned", None)
    return found | {f"learned:{POLICY}={key}": f"{retell('learned')} · {key}" for key in policies}


def driver_choice(
    service: Service, select: ui.select, name: str, options: dict[str, Any] | None = None
) -> str:
    """Entry of a list of drivers for a request; added to the list if it is missing."""
    driver, named = parse_driver(name)
    policy = ({**(options or {}), **named}).get(POLICY)
    found = f"{driver}:{POLICY}={policy}" if policy else driver
    if found not in select.options:
        select.set_options({**driver_names(service), found: f"{driver} · {policy}" if policy else driver})
    return found


def other_options(options: dict[str, Any]) -> dict[str, Any]:
    """Options of a driver without its policy, which :func:`driver_choice` shows."""
    return {name: value for name, value in options.items() if name != POLICY}

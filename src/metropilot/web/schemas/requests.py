"""Bodies of requests: bounded, typed, units in names. No field can name a file of the server."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, asdict, dataclass, fields, replace
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, create_model
from pydantic_core import CoreSchema, core_schema

from metropilot._schema import FieldSpec, Range, field_default, field_specs, field_type
from metropilot.campaign import CampaignFile
from metropilot.convoy import CONVOY_PERIOD_S, ConvoyRequest, Link
from metropilot.evaluate import POLICY, RunSpec, parse_driver, run_fields
from metropilot.fit import Group, Resistance, Source
from metropilot.operation import OperationOptions, SlowSection, TrainHold
from metropilot.railway import Restriction
from metropilot.sim import CONTROL_PERIOD_S, Disturbance, TimetableUpdate

Id = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$", examples=["yizhuang"])]
Word = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]{1,32}$")]
DriverName = Annotated[
    str,
    Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}(:policy=[A-Za-z0-9][A-Za-z0-9_-]{0,63})?$",
        examples=["optimal", "learned:policy=RUN"],
    ),
]
"""Id of a driver, with the learning run or upload that holds its policy."""
TrainsetKey = Annotated[
    str,
    Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}(@[0-9]{1,2}(\.[0-9]{1,6})?,[0-9]{1,2}(\.[0-9]{1,6})?)?$",
        examples=["dkz32", "dkz32@0.6,0.4"],
    ),
]
"""Id of a trainset, with the dead time and lag that it declares instead of its own, s."""
StationKey = Annotated[str, Field(min_length=1, max_length=80, examples=["RJ"])]
Seconds = Annotated[float, Field(gt=0, le=36_000, description="s")]
Option = bool | int | float | Id
RUN_FIELDS = run_fields()


class RequestBody(BaseModel):
    """Base of request bodies; refuses unknown fields and numbers that are not finite."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)


def example(**body: Any) -> ConfigDict:  # noqa: ANN401 (the fields of a body)
    """Configuration of a body with an example, which the description of the API shows."""
    return ConfigDict(json_schema_extra={"examples": [body]})


@dataclass(frozen=True)
class Checked:
    """Annotation that takes range, choices and description from a declared field.

    Attributes:
        name: Name of the field.
        spec: Its declaration.
    """

    name: str
    spec: FieldSpec

    def __get_pydantic_core_schema__(self, source: type, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Check a value of the annotated type."""
        return core_schema.no_info_after_validator_function(
            lambda value: self.spec.check(self.name, value), handler(source)
        )

    def __get_pydantic_json_schema__(self, core: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Add the allowed values and the description to the JSON schema."""
        spec = self.spec
        found = handler(core) | {
            "description": f"{spec.help.rstrip('.')}, {spec.unit}." if spec.unit else spec.help
        }
        if spec.choices:
            found["enum"] = list(spec.choices)
        if spec.range is not None:
            low = "exclusiveMinimum" if spec.range.above else "minimum"
            bounds = {low: spec.range.low, "maximum": spec.range.high}
            found |= {name: bound for name, bound in bounds.items() if abs(bound) != float("inf")}
        return found


def declared_fields(kind: type[Any], *left_out: str, prefix: str = "") -> dict[str, Any]:
    """Fields of a body for the declared fields of a dataclass.

    Null stands for infinity, which JSON does not have, and where None is the default.

    Args:
        kind: The dataclass.
        left_out: Fields without one.
        prefix: Prefix of their names.
    """
    found: dict[str, Any] = {}
    needed = {f.name for f in fields(kind) if f.default is MISSING and f.default_factory is MISSING}
    for name, spec in field_specs(kind).items():
        default, endless = field_default(kind, name), spec.range is not None and spec.range.infinite
        hint: Any = Annotated[field_type(kind, name), Checked(prefix + name, spec)]
        if name in needed - {*left_out}:
            found[prefix + name] = (hint, ...)
        elif name not in left_out:
            found[prefix + name] = (hint | None, None) if endless or default is None else (hint, default)
    return found


def spec_of(kind: type[BaseModel], name: str) -> FieldSpec:
    """Declaration of a field of a body; an empty one where the body declares it itself."""
    field = kind.model_fields[name]
    hints = (field.annotation, *get_args(field.annotation))
    metadata = [*field.metadata, *(item for hint in hints for item in getattr(hint, "__metadata__", ()))]
    return next((item.spec for item in metadata if isinstance(item, Checked)), FieldSpec())


DisturbanceIn = create_model("DisturbanceIn", __base__=RequestBody, **declared_fields(Disturbance))


UPDATE_FIELDS = field_specs(TimetableUpdate)
SentAt = Annotated[float, Checked("at_s", UPDATE_FIELDS["at_s"])]


class NewRestriction(create_model("RestrictionFields", __base__=RequestBody, **declared_fields(Restriction))):
    """A temporary speed restriction ahead, sent now."""

    model_config = example(from_m=700, to_m=900, limit_mps=10)


class RestrictionIn(NewRestriction):
    """A temporary speed restriction, sent ``at_s`` after departure, or known before it."""

    model_config = example(from_m=700, to_m=900, limit_mps=10, at_s=20)

    at_s: SentAt | None = None

    def restriction(self) -> Restriction:
        """Convert to :class:`metropilot.railway.Restriction`."""
        return Restriction(**self.model_dump(exclude={"at_s"}))


class NewArrival(RequestBody):
    """A new scheduled running time, sent now."""

    model_config = example(scheduled_time_s=115)

    scheduled_time_s: Annotated[float, Checked("scheduled_time_s", UPDATE_FIELDS["scheduled_time_s"])]


class ArrivalIn(NewArrival):
    """A new scheduled running time, sent ``at_s`` after departure."""

    model_config = example(scheduled_time_s=115, at_s=20)

    at_s: SentAt


class SectionIn(RequestBody):
    """A section, its trainset and its restrictions."""

    model_config = example(line="yizhuang", origin="RJ", destination="WYJ", trainset="dkz32")

    line: Id = "yizhuang"
    origin: StationKey = "RJ"
    destination: StationKey = "WYJ"
    trainset: TrainsetKey = "dkz32"
    load: Annotated[str, Field(max_length=32)] | None = None
    restrictions: Annotated[list[RestrictionIn], Field(max_length=20)] = []


class PlanIn(SectionIn):
    """A plan: the scheduled running time and the energy objective."""

    model_config = example(line="yizhuang", origin="RJ", destination="WYJ", time_s=101)

    time_s: Annotated[float, Checked("time_s", RUN_FIELDS["time_s"])] | None = None
    objective: Annotated[str, Checked("objective", RUN_FIELDS["objective"])] = "wheel"


class PlantPlanIn(PlanIn, DisturbanceIn):
    """A plan, and the disturbance of the true plant, for which a second one is made."""

    model_config = example(line="yizhuang", origin="RJ", destination="WYJ", time_s=101, mass_factor=1.2)


class DriveIn(PlanIn, DisturbanceIn):
    """A run: the plan's fields, the driver, the disturbance and timetable updates."""

    model_config = example(
        line="yizhuang", origin="RJ", destination="WYJ", time_s=101, driver="optimal", mass_factor=1.1
    )

    driver: DriverName = "optimal"
    options: dict[Word, Option] = {}
    arrivals: Annotated[list[ArrivalIn], Field(max_length=20)] = []
    dt_s: Annotated[float, Checked("dt_s", RUN_FIELDS["dt_s"])] = CONTROL_PERIOD_S
    seed: Annotated[int, Field(lt=2**63), Checked("seed", RUN_FIELDS["seed"])] = 0


class CompareIn(DriveIn):
    """Several drivers on one run."""

    model_config = example(
        line="yizhuang", origin="RJ", destination="WYJ", time_s=101, drivers=["optimal", "manual"]
    )

    drivers: Annotated[list[DriverName], Field(min_length=1, max_length=12)] = [
        "optimal",
        "manual",
        "flat_out",
    ]
    seeds: Annotated[int, Field(ge=1, le=50)] = 1


class JourneyIn(RequestBody):
    """A journey that calls at every station; with ``total_s`` its reserve is spread optimally."""

    model_config = example(line="yizhuang", total_s=1950)

    line: Id = "yizhuang"
    origin: StationKey | None = None
    destination: StationKey | None = None
    trainset: Id = "dkz32"
    load: Annotated[str, Field(max_length=32)] | None = None
    total_s: Seconds | None = None
    objective: Literal["wheel", "line"] = "wheel"


Name = Annotated[str, Field(max_length=80, pattern=r"^[^\x00-\x1f\x7f]*$")]
Notes = Annotated[str, Field(max_length=20_000)]


class NameIn(RequestBody):
    """A name of a job; empty removes it."""

    model_config = example(name="With the new timetable")

    name: Name


class FiledIn(RequestBody):
    """The project of a job or upload; null for none."""

    model_config = example(project=None)

    project: Id | None


class ProjectIn(RequestBody):
    """A project: its name and notes."""

    model_config = example(name="New timetable 2027", notes="")

    name: Annotated[Name, Field(min_length=1)]
    notes: Notes = ""


OperationFields = create_model("OperationFields", __base__=RequestBody, **declared_fields(OperationOptions))


class LineServiceIn(OperationFields):
    """A line with its trainset at a headway."""

    line: Id = "yizhuang"
    trainset: Id = "dkz32"
    load: Annotated[str, Field(max_length=32)] | None = None


class OperationIn(LineServiceIn):
    """A line in operation at a headway, or through a working day.

    ``optimise`` searches dwells and running times too, not only the offset of the directions.
    """

    model_config = example(line="yizhuang", headway_s=180, zones=4)

    day: Id | None = None
    feeding: Id | None = None
    optimise: bool = False
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0


class VersionIn(RequestBody):
    """The next version of a line or trainset: its TOML document, and the version that was edited."""

    model_config = example(toml='kind = "line" ...', version=1)

    toml: Annotated[str, Field(max_length=1_000_000)]
    version: Annotated[int, Field(ge=1, lt=2**31)]


class CampaignIn(CampaignFile):
    """A campaign of drives: the values of its TOML file, lines, trainsets and policies by id."""

    model_config = example(
        name="mass and resistance",
        matrix={"drivers": ["optimal", "manual"], "sections": ["yizhuang RJ WYJ"], "loads": ["AW2"]},
        disturbance=[{"name": "heavy", "mass_factor": [1.0, 1.2]}],
    )


class ExportIn(RequestBody):
    """A learned driver under protection as C for a controller, or as WebAssembly for a page."""

    model_config = example(driver="ppo", line="yizhuang", origin="RJ", destination="WYJ", to="c")

    driver: DriverName = "ppo"
    line: Id = "yizhuang"
    origin: StationKey | None = None
    destination: StationKey | None = None
    trainset: TrainsetKey = "dkz32"
    load: Annotated[str, Field(max_length=32)] | None = None
    to: Literal["c", "wasm"] = "c"
    number: Literal["double", "float"] = "double"


class FitIn(RequestBody):
    """A fit of a trainset to uploaded logs, as `metropilot fit`.

    The section is that of every log, for its gradients; without one a gradient column is read. ``input``: of
    the model; null: the command where every log has one. ``keep``: parameters that are not estimated.
    """

    model_config = example(
        logs=["upload-1a2b3c4d"], trainset="dkz32", line="yizhuang", origin="RJ", destination="WYJ"
    )

    logs: Annotated[list[Id], Field(min_length=1, max_length=50)]
    trainset: TrainsetKey = "dkz32"
    load: Annotated[str, Field(max_length=32)] | None = None
    line: Id | None = None
    origin: StationKey | None = None
    destination: StationKey | None = None
    input: Source | None = None
    keep: Annotated[list[Group], Field(max_length=5)] = []
    resistance: Resistance = "auto"


class FitSaveIn(RequestBody):
    """Place of a fitted trainset: the next version of an own trainset, or (null) a new entry."""

    model_config = example(upload=None)

    upload: Id | None = None


class LearnIn(RequestBody):
    """A learning run of a recipe; null stands for the recipe's own value.

    ``line``: its sections are learned instead of the task's, ``sections`` as ORIGIN-DESTINATION,..., or all
    of them, both ways. ``trainset``: instead of the task's, with ``load`` or each of its loads.
    """

    model_config = example(driver="ppo", budget="quick", line="yizhuang", sections="CQN-JHL")

    driver: Id = "ppo"
    budget: Literal["quick", "paper"] = "quick"
    task: Id | None = None
    line: Id | None = None
    sections: Annotated[str, Field(min_length=1, max_length=2_000)] | None = None
    trainset: TrainsetKey | None = None
    load: Annotated[str, Field(max_length=32)] | None = None
    steps: Annotated[int, Field(ge=1_000, le=50_000_000)] | None = None
    evaluations: Annotated[int, Field(ge=1, le=500)] | None = None
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 0


class StudyIn(RequestBody):
    """A study to reproduce; ``quick`` takes about two minutes, ``paper`` an hour."""

    model_config = example(study="lu2023", budget="quick")

    study: Id
    budget: Literal["quick", "paper"] = "quick"


class LiveIn(DriveIn):
    """A live run and its pace: 1 is real time, 0 pauses it."""

    model_config = example(line="yizhuang", origin="RJ", destination="WYJ", time_s=101, pace=10)

    pace: Annotated[float, Field(ge=0, le=100)] = 1.0


TRAINSETS = replace(field_specs(ConvoyRequest)["count"], range=Range(2, 6))
"""Trainsets of a live convoy: as many as a server drives in real time."""
ConvoySettingsIn = create_model(
    "ConvoySettingsIn",
    __base__=RequestBody,
    **declared_fields(ConvoyRequest, "count", "follower"),
    **declared_fields(Link, "silent_from_s", prefix="link_"),
)


class ConvoyIn(DriveIn, ConvoySettingsIn):
    """A live convoy: the head's run, the followers and the link between them.

    Its disturbance acts on every trainset, unless each has one of its own. ``behind``: trainsets of the
    followers, if not the head's; the last also stands for those after it.
    """

    model_config = example(line="yizhuang", origin="RJ", destination="WYJ", time_s=110, trainsets=3)

    dt_s: Annotated[float, Checked("dt_s", RUN_FIELDS["dt_s"])] = CONVOY_PERIOD_S
    trainsets: Annotated[int, Checked("trainsets", TRAINSETS)] = 3
    follower: Id = "follow_plan"
    behind: Annotated[list[Id], Field(max_length=5)] = []
    disturbances: Annotated[list[DisturbanceIn], Field(max_length=6)] = []  # pyright: ignore[reportInvalidTypeForm]
    pace: Annotated[float, Field(ge=0, le=20)] = 1.0


class RunningLineIn(LineServiceIn):
    """A line that runs live, all trains at once, and its pace; it ends after ``lasts_s``."""

    model_config = example(line="yizhuang", headway_s=180, pace=30, lasts_s=3600)

    lasts_s: Annotated[float, Field(ge=60, le=36_000, description="s")] = 7200.0
    pace: Annotated[float, Field(ge=0, le=100)] = 10.0


class NewHold(create_model("HoldFields", __base__=RequestBody, **declared_fields(TrainHold))):
    """Hold the next train of a running line that departs from a station."""

    model_config = example(station="RJ", hold_s=120)

    station: StationKey
    backward: bool = False


class NewSlowSection(create_model("SlowFields", __base__=RequestBody, **declared_fields(SlowSection))):
    """Restrict the speed of the section of a running line that begins at a station, for some time."""

    model_config = example(station="RJ", limit_mps=8, lasts_s=600)

    station: StationKey
    backward: bool = False


class NewLink(create_model("LinkIn", __base__=RequestBody, **declared_fields(Link, "silent_from_s"))):
    """New delay, jitter and loss of the link of a convoy."""

    model_config = example(delay_s=0.3, silent=False)

    silent: bool = False


class Lever(RequestBody):
    """Manual driving: a share of the effort, null to return the lever to the driver. Renew it within 3 s.

    The lever has one holder at a time, named here. Another holder is refused (409) unless ``take_over``
    is true.
    """

    model_config = example(share=0.5, holder="me")

    share: Annotated[float, Field(ge=-1, le=1)] | None
    holder: Word = "api"
    take_over: bool = False


class Pace(RequestBody):
    """Pace of a live run: 1 is real time, 0 pauses it."""

    model_config = example(pace=5)

    pace: Annotated[float, Field(ge=0, le=100)]


def request_of(body: DriveIn, path: Callable[[str, str], str]) -> RunSpec:
    """Convert to a run of :mod:`metropilot.evaluate`.

    Args:
        body: The body.
        path: Function from a kind (line, trainset, policy) and an id to a file.

    Raises:
        InputError: No policy of that id.
    """
    driver, named = parse_driver(body.driver)
    options = body.options | named
    if POLICY in options:
        options[POLICY] = path(POLICY, str(options[POLICY]))
    restrictions = [(item.restriction(), item.at_s) for item in body.restrictions]
    updates = [TimetableUpdate(at_s, restriction=r) for r, at_s in restrictions if at_s is not None]
    updates += [TimetableUpdate(a.at_s, scheduled_time_s=a.scheduled_time_s) for a in body.arrivals]
    given = body.model_dump(include=set(run_fields()) - {"restrictions", "arrivals"})
    spec = RunSpec.from_values(
        given
        | {"line": path("line", body.line), "trainset": path("trainset", body.trainset)}
        | {"driver": driver, "options": options}
    )
    return replace(
        spec,
        restrictions=tuple(r for r, at_s in restrictions if at_s is None),
        disturbance=replace(spec.disturbance, updates=tuple(updates)),
    )


def body_of(spec: RunSpec) -> DriveIn:
    """Body of a run whose line and trainset are named by ids."""
    disturbance = {name: getattr(spec.disturbance, name) for name in DisturbanceIn.model_fields}
    known = [(restriction, None) for restriction in spec.restrictions]
    updates = spec.disturbance.updates
    known += [(each.restriction, each.at_s) for each in updates if each.restriction is not None]
    arrivals = [each for each in updates if each.scheduled_time_s is not None]
    values = {f.name: getattr(spec, f.name) for f in fields(RunSpec) if f.name in DriveIn.model_fields}
    return DriveIn.model_validate(
        values
        | {name: None if value == float("inf") else value for name, value in disturbance.items()}
        | {"driver": spec.driver, "options": dict(spec.options), "trainset": str(spec.trainset)}
        | {"restrictions": [asdict(restriction) | {"at_s": at_s} for restriction, at_s in known]}
        | {"arrivals": [{"at_s": a.at_s, "scheduled_time_s": a.scheduled_time_s} for a in arrivals]}
    )

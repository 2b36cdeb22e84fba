"""TOML files of campaigns, shipped or own, validated by pydantic: an error names file and field in a line."""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import product
from math import prod
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model
from pydantic.fields import FieldInfo

from metropilot._io import read_text
from metropilot._schema import KIND_WORDS, check_name, convert, field_specs, field_type
from metropilot.campaign.declared import DRAWN, OWN, Campaign, DisturbanceCase
from metropilot.campaign.line_sweep import OPTIONS, ZONES, FeedingCase, LineSweep, Number
from metropilot.campaign.matrix import DRIVES, KINDS, LINE, AbstractCampaign
from metropilot.drivers import DRIVERS
from metropilot.errors import InputError, rename_fields
from metropilot.evaluate import is_file, make_driver, run_fields
from metropilot.operation import OperationOptions, divide_zones
from metropilot.railway import RESTRICTION_KMH, load_day, load_feeding, load_line, load_trainset
from metropilot.sim import CONTROL_PERIOD_S, Disturbance

Model = TypeVar("Model", bound=BaseModel)


class StrictModel(BaseModel):
    """Model without unknown keys, of values as TOML writes them: a text is no number, a number no truth."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class DrawnTrainsets(StrictModel):
    """Random trainsets: how many, and the seed."""

    drawn: Annotated[int, Field(ge=1, le=10**4)]
    seed: Annotated[int, Field(ge=0, lt=10**9)] = 0


LEAST, MOST = "least", "most"
"""The lightest and the heaviest load of any trainset."""


def read_values(path: Path) -> dict[str, Any]:
    """Values of a TOML file.

    Raises:
        InputError: Not readable, or not TOML.
    """
    try:
        return tomllib.loads(read_text(path, "campaign"))
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"not TOML ({error})", file=path, field="campaign") from None


def validate(path: Path, model: type[Model], values: dict[str, Any]) -> Model:
    """Values of a file as a model.

    Raises:
        InputError: A value cannot be used.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise _input_error(path, model, error) from None


SHOULD = "Input should be "
BRANCHES = {"float", "int", "str", "constrained-float", "function-before", DrawnTrainsets.__name__}
"""Names that pydantic gives the alternatives of a field: no part of its place in the file."""
WANTED = {
    "bool_type": KIND_WORDS[bool],
    "float_type": KIND_WORDS[float],
    "int_type": KIND_WORDS[int],
    "string_type": KIND_WORDS[str],
    "model_type": KIND_WORDS[dict],
    "list_type": "a list",
    "tuple_type": "a list of two",
}
"""What a value of the wrong kind should be, by pydantic's name of the error."""


def _locate(item: Mapping[str, Any]) -> str:
    """Dotted place of a validation error in the file."""
    words = [str(part) for part in item["loc"]]
    return ".".join(
        w for w in words if w not in BRANCHES and not w.startswith(("list[", "literal[", "tuple["))
    )


def _describe_wanted(item: Mapping[str, Any]) -> str | None:
    """Words for what a value should be, from its validation error; None where that says something else."""
    if item["msg"].startswith("Tuple should have"):
        return WANTED["tuple_type"]
    should = item["msg"].removeprefix(SHOULD) if item["msg"].startswith(SHOULD) else None
    return WANTED.get(item["type"], should)


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:  # noqa: ANN401 (any form of a type)
    """Models that a type names."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models_in(part)


def _keys_beside(model: type[BaseModel], place: Sequence[int | str]) -> dict[str, FieldInfo]:
    """Fields of the table that a place in a file lies in, by their keys there."""
    for part in place[:-1]:
        field = model.model_fields.get(str(part))
        model = next(_models_in(field.annotation), model) if field is not None else model
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _describe_kind(annotation: Any) -> str | None:  # noqa: ANN401 (any form of a type)
    """First kind of value of a type, in words; None where it has none."""
    if get_origin(annotation) is list:
        return WANTED["list_type"]
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return KIND_WORDS[dict]
    parts = map(_describe_kind, get_args(annotation))
    return KIND_WORDS.get(annotation) or next((words for words in parts if words), None)


def _key_error(path: Path, model: type[BaseModel], item: Mapping[str, Any]) -> InputError:
    """The error of a key that is unknown, with the keys there are, or of one that is missing."""
    *_, key = item["loc"]
    keys, where = _keys_beside(model, item["loc"]), {"file": path, "field": _locate(item)}
    if item["type"] == "missing":
        wanted = _describe_kind(keys[key].annotation) if key in keys else WANTED["tuple_type"]
        return InputError("missing", allowed=wanted, **where)
    try:
        check_name(str(key), keys, "key", **where)
    except InputError as error:
        return error
    raise AssertionError(key)


def _input_error(path: Path, model: type[BaseModel], error: ValidationError) -> InputError:
    """The first of the validation errors at the deepest field it names, with every alternative there."""
    found = error.errors()
    first = max(found, key=lambda item: (item["type"] == "extra_forbidden", len(item["loc"])))
    if first["type"] in {"missing", "extra_forbidden"}:
        return _key_error(path, model, first)
    field, message = _locate(first), first["msg"]
    if (told := _describe_wanted(first)) is not None:
        others = (_describe_wanted(item) for item in found if _locate(item) == field)
        message = SHOULD + " or ".join(dict.fromkeys([told, *(each for each in others if each)]))
    return InputError(message[:1].lower() + message[1:], file=path, field=field, value=str(first["input"]))


@contextmanager
def _of_field(path: Path, field: str) -> Iterator[None]:
    """Let errors inside name the file and the field of the campaign."""
    try:
        yield
    except InputError as error:
        raise error.at(file=path, field=field) from None


def keep_once(values: list[Any]) -> tuple[Any, ...]:
    """The values without repetitions, in their order."""
    return tuple(dict.fromkeys(values))


def list_trainsets(
    path: Path, wanted: list[str | DrawnTrainsets] | DrawnTrainsets, loads: list[str] | str
) -> tuple[tuple[str, str], ...]:
    """Trainset and load of each; ``least`` and ``most`` are the lightest and the heaviest of a trainset."""
    names: list[str] = []
    for item in wanted if isinstance(wanted, list) else [wanted]:
        numbers = range(1, item.drawn + 1) if isinstance(item, DrawnTrainsets) else ()
        names += [item] if isinstance(item, str) else [f"drawn-{item.seed}-{k}" for k in numbers]
    found = []
    for name in names:
        place = resolve_name(path, name)
        with _of_field(path, "matrix.trainsets"):
            trainset = load_trainset(place)
            masses = trainset.loads
            ends = {LEAST: min(masses, key=masses.__getitem__), MOST: max(masses, key=masses.__getitem__)}
            named = list(masses) if isinstance(loads, str) else loads
        told = [load if load in masses else ends.get(load, load) for load in named]
        with _of_field(path, "matrix.loads"):
            found += [(place, trainset.with_load(load).load) for load in told]
    return keep_once(found)


def resolve_name(path: Path, name: str) -> str:
    """A catalogue id unchanged; a file name relative to the folder of the campaign."""
    return str((path.parent / name).resolve()) if is_file(name) else name


UNSPECIFIC = ("learned",)
"""Drivers that need a policy file, and so are no part of ``all``."""
Share = Annotated[float, Field(ge=0, le=1)]
Spread = float | Annotated[tuple[float, float], Field(strict=False)]


Seconds = Annotated[float, Field(ge=0, le=5)]
Late = Annotated[tuple[Seconds, Seconds], Field(strict=False)]
"""A list of TOML; its items are strict."""


class CampaignRestriction(StrictModel):
    """A restriction: its ends as shares of the section, announced at a share of the scheduled time."""

    start: Annotated[float, Field(alias="from", ge=0, lt=1)]
    end: Annotated[float, Field(alias="to", gt=0, le=1)]
    kmh: Annotated[float, Field(ge=RESTRICTION_KMH[0], le=RESTRICTION_KMH[1])]
    announced: Share | None = None


class CampaignArrival(StrictModel):
    """A new running time over the scheduled one, announced at a share of that."""

    factor: Annotated[float, Field(ge=0.5, le=3)]
    announced: Share


_RANGES: dict[str, Any] = dict.fromkeys(DRAWN, (Spread | None, None))
CampaignRanges = create_model("CampaignRanges", __base__=StrictModel, **_RANGES)


class CampaignDisturbance(CampaignRanges):
    """A disturbance: numbers, or intervals to draw from, and what is announced."""

    name: Annotated[str, Field(min_length=1)]
    ideal: bool = False
    restriction: CampaignRestriction | None = None
    arrival: CampaignArrival | None = None
    actuation: Late | None = None


class CampaignMatrix(StrictModel):
    """The axes of a campaign."""

    drivers: Annotated[list[str], Field(min_length=1)] | Literal["all"]
    sections: Annotated[list[str], Field(min_length=1)]
    trainsets: Annotated[list[str | DrawnTrainsets], Field(min_length=1)] | DrawnTrainsets = Field(["dkz32"])
    actuation: Annotated[list[Literal["own"] | Late], Field(min_length=1)] = Field(["own"])
    periods: Annotated[list[float], Field(min_length=1)] | None = None
    sample: Annotated[int, Field(ge=1, le=10**9)] | None = None
    loads: Annotated[list[str], Field(min_length=1)] | Literal["all"] = "all"
    times: Annotated[list[Literal["planned"] | Annotated[float, Field(ge=1, le=10)]], Field(min_length=1)] = (
        Field(["planned"])
    )
    seeds: Annotated[int, Field(ge=1, le=10**9)] = 1
    first_seed: Annotated[int, Field(ge=0, lt=2**63)] = 0


class CampaignFile(StrictModel):
    """A campaign of drives as its TOML file has it."""

    name: Annotated[str, Field(min_length=1)]
    objective: Literal["wheel", "line"] = "wheel"
    dt_s: float = CONTROL_PERIOD_S
    engine: Literal["host", "compiled"] = "host"
    matrix: CampaignMatrix
    disturbance: list[CampaignDisturbance] = Field([CampaignDisturbance(name="nominal")])


def campaign_from_toml(path: Path) -> AbstractCampaign:
    """Read a campaign.

    Raises:
        InputError: Not readable, or something in it cannot be used.
    """
    return campaign_from_values(path, read_values(path))


def campaign_from_values(path: Path, values: dict[str, Any]) -> AbstractCampaign:
    """Read the values of a campaign's file.

    Args:
        path: The file, for errors; names of files are relative to its folder.
        values: Its values.

    Raises:
        InputError: Something in it cannot be used, or it has too many rows.
    """
    campaign = _read_any(path, values)
    _check_rows(path, campaign)
    return campaign


def _check_rows(path: Path, campaign: AbstractCampaign) -> None:
    """Refuse a matrix that would never end, and takes minutes to be laid out.

    Raises:
        InputError: It has too many rows.
    """
    if campaign.rows > campaign.most_rows:
        allowed = f"at most {campaign.most_rows}"
        allowed += "; set matrix.sample" if isinstance(campaign, Campaign) else ""
        raise InputError("too many rows", file=path, field="matrix", value=campaign.rows, allowed=allowed)


def _read_any(path: Path, values: dict[str, Any]) -> AbstractCampaign:
    """Read the values of a campaign of any kind, of any size.

    Raises:
        InputError: Something in it cannot be used.
    """
    values = dict(values)
    kind = values.pop("kind", DRIVES)
    with rename_fields({"kind": "kind"}, path):
        KINDS.row(str(kind))
    if "stations" in values:
        raise InputError("describes a line, not a campaign", file=path, allowed="a file of a campaign")
    if kind == LINE:
        return sweep_from_values(path, values)
    found = validate(path, CampaignFile, values)
    with rename_fields({"dt_s": "dt_s"}, path):
        run_fields()["dt_s"].check("dt_s", found.dt_s)
    periods = _periods(path, found)
    names = [item.name for item in found.disturbance]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError("named twice", file=path, field="disturbance.name", value=twice)
    campaign = Campaign(
        name=found.name,
        drivers=_drivers(path, found.matrix.drivers),
        sections=_sections(path, found.matrix.sections),
        trainsets=list_trainsets(path, found.matrix.trainsets, found.matrix.loads),
        times=keep_once(found.matrix.times),
        disturbances=tuple(_disturbance(path, item) for item in found.disturbance),
        seeds=found.matrix.seeds,
        first_seed=found.matrix.first_seed,
        objective=found.objective,
        dt_s=periods[0],
        engine=found.engine,
        actuations=tuple(None if late == OWN else late for late in keep_once(found.matrix.actuation)),
        periods=periods if len(periods) > 1 else (),
        sample=found.matrix.sample,
    )
    if not campaign.rows:
        empty = next(name for name, values in vars(campaign).items() if values == ())
        raise InputError("nothing to drive: the list is empty", file=path, field=empty)
    return campaign


def _periods(path: Path, found: CampaignFile) -> tuple[float, ...]:
    """Control periods of the matrix, or the one of the campaign."""
    if found.matrix.periods is None:
        return (found.dt_s,)
    if "dt_s" in found.model_fields_set:
        raise InputError("excludes matrix.periods", file=path, field="dt_s", value=found.dt_s)
    with rename_fields({"dt_s": "matrix.periods"}, path):
        for period in found.matrix.periods:
            run_fields()["dt_s"].check("dt_s", period)
    return keep_once(found.matrix.periods)


def _drivers(path: Path, wanted: list[str] | str) -> tuple[str, ...]:
    if isinstance(wanted, str):
        return tuple(name for name in DRIVERS.ids() if name not in UNSPECIFIC)
    with _of_field(path, "matrix.drivers"):
        for name in wanted:
            make_driver(name)
    return keep_once(wanted)


def _sections(path: Path, wanted: list[str]) -> tuple[tuple[str, str, str], ...]:
    """``LINE``: each of its sections both ways; ``LINE ORIGIN DESTINATION``: one."""
    found = []
    for text in wanted:
        try:
            words = shlex.split(text)
        except ValueError:
            words = []
        with _of_field(path, "matrix.sections"):
            line_id = resolve_name(path, words[0]) if words else ""
            line = load_line(line_id) if words else None
            if line is None or len(words) not in (1, 3):
                raise InputError("not a section", value=text, allowed="LINE, or LINE ORIGIN DESTINATION")
            both = line.sections(), line.sections(backward=True)
            cuts = [line.section(*words[1:])] if len(words) == 3 else [cut for each in both for cut in each]
        found += [(line_id, cut.origin.code, cut.destination.code) for cut in cuts]
    return keep_once(found)


def _disturbance(path: Path, item: CampaignDisturbance) -> DisturbanceCase:
    ranges, specs = {}, field_specs(Disturbance)
    for name in DRAWN:
        given = getattr(item, name)
        if given is None:
            continue
        low, high = given if isinstance(given, tuple) else (given, given)
        field = f"disturbance {item.name}.{name}"
        with _of_field(path, field):
            for value in (low, high):
                specs[name].check(name, value)
            if low > high:
                raise InputError("ends before it begins", value=f"{low:g} to {high:g}")
        ranges[name] = (float(low), float(high))
    if item.ideal and item.actuation is not None:
        field = f"disturbance {item.name}.actuation"
        raise InputError("excludes ideal actuation", file=path, field=field, value=str(item.actuation))
    limit, arrival = item.restriction, item.arrival
    if limit is not None and limit.start >= limit.end:
        raise InputError("ends before it begins", file=path, field=f"disturbance {item.name}.restriction")
    return DisturbanceCase(
        name=item.name,
        ideal=item.ideal,
        ranges=ranges,
        restriction=None if limit is None else (limit.start, limit.end, limit.kmh, limit.announced),
        arrival=None if arrival is None else (arrival.factor, arrival.announced),
        actuation=item.actuation,
    )


Whole = Annotated[int, Field(ge=0, lt=2**53)]


class _SweepMatrix(StrictModel):
    lines: Annotated[list[str], Field(min_length=1)]
    headways: list[int] = Field([])
    days: list[str] = Field([])
    trainsets: Annotated[list[str | DrawnTrainsets], Field(min_length=1)] | DrawnTrainsets = Field(["dkz32"])
    loads: Annotated[list[str], Field(min_length=1)] | Annotated[str, Field(pattern="^all$")] = "all"
    feedings: Annotated[list[int | str], Field(min_length=1)] = Field([ZONES])


class _SweepFile(StrictModel):
    name: Annotated[str, Field(min_length=1)]
    optimise: bool = False
    sharp: bool = False
    seed: Whole = 0
    driver: str | None = None
    runs: Annotated[int, Field(ge=1, le=100)] = 1
    scatter: list[Annotated[float, Field(gt=0, le=300)]] = Field([])
    matrix: _SweepMatrix
    operation: dict[str, Any] = Field({})


def sweep_from_values(path: Path, values: dict[str, Any]) -> LineSweep:
    """Read a sweep from the values of its file.

    Raises:
        InputError: Something in it cannot be used.
    """
    found = validate(path, _SweepFile, values)
    matrix = found.matrix
    lines = keep_once([resolve_name(path, each) for each in matrix.lines])
    options = _options(path, found.operation)
    days = keep_once([resolve_name(path, each) for each in matrix.days])
    sweep = LineSweep(
        name=found.name,
        services=(*keep_once(matrix.headways), *days),
        lines=lines,
        trainsets=list_trainsets(path, matrix.trainsets, matrix.loads),
        feedings=keep_once([_feeding(path, each) for each in matrix.feedings]),
        options=options,
        optimise=found.optimise,
        sharp=found.sharp,
        seed=found.seed,
        driver=found.driver,
        runs=found.runs,
        scatter_s=keep_once(found.scatter),
    )
    if not sweep.services:
        raise InputError("neither a headway nor a day", file=path, field="matrix.headways")
    if found.driver is not None:
        with _of_field(path, "driver"):
            make_driver(found.driver)
    if found.sharp and days:
        raise InputError("a day has no sharp floor", file=path, field="sharp", allowed="without matrix.days")
    _check_lines(path, sweep)
    return sweep


def _options(path: Path, given: Mapping[str, Any]) -> tuple[dict[str, Number], ...]:
    """All combinations of the fields of an operation, each a value or a list of them."""
    axes: list[list[tuple[str, Number]]] = []
    for name, value in given.items():
        field = f"operation.{name}"
        with _of_field(path, field):
            check_name(name, OPTIONS, "key", field=field)
            kind, spec = field_type(OperationOptions, name), field_specs(OperationOptions)[name]
            given_values = value if isinstance(value, list) else [value]
            checked = [
                spec.check(name, convert(name, one, kind, spec.describe_allowed())) for one in given_values
            ]
            axes.append([(name, one) for one in keep_once(checked)])
            if not axes[-1]:
                raise InputError("the list is empty")
    if (count := prod(map(len, axes))) > LineSweep.most_rows:
        allowed = f"at most {LineSweep.most_rows}"
        raise InputError("too many rows", file=path, field="operation", value=count, allowed=allowed)
    combined = tuple(dict(each) for each in product(*axes))
    for each in combined:
        try:
            OperationOptions(**each)  # pyright: ignore[reportArgumentType] (checked above)
        except InputError as error:
            raise error.at(file=path, field=f"operation.{error.field}") from None
    return combined


def _feeding(path: Path, given: int | str) -> FeedingCase:
    """A number of zones, or ``NETWORK``, or ``NETWORK ZONES``."""
    if isinstance(given, int):
        return FeedingCase(given)
    try:
        network, *zones = shlex.split(given)
        (number,) = [int(each) for each in zones] or [ZONES]
    except ValueError:
        allowed = "a number of zones, NETWORK, or NETWORK ZONES"
        raise InputError(
            "not a feeding", file=path, field="matrix.feedings", value=given, allowed=allowed
        ) from None
    return FeedingCase(number, resolve_name(path, network))


def _check_lines(path: Path, sweep: LineSweep) -> None:
    """Refuse feedings, days and headways that do not fit the lines."""
    with _of_field(path, "matrix.lines"):
        lines = [load_line(each) for each in sweep.lines]
    with _of_field(path, "matrix.headways"):
        for service in sweep.services:
            if isinstance(service, int):
                OperationOptions(headway_s=service)
    with _of_field(path, "matrix.feedings"):
        for line, feeding in product(lines, sweep.feedings):
            divide_zones(line, feeding.zones)
            if feeding.network is not None:
                load_feeding(feeding.network).check_line(line)
            if sweep.sharp and feeding.zones != len(line.stations) - 1:
                allowed = f"{len(line.stations) - 1}, one for each section of {line.id}"
                words = "a floor is sharpened where each section is a zone"
                raise InputError(words, value=feeding.zones, allowed=allowed)
    with _of_field(path, "matrix.days"):
        for line, service in product(lines, sweep.services):
            if isinstance(service, str):
                load_day(service).check_line(line)


FOLDER = Path(__file__).parent / "files"


def shipped_campaigns() -> tuple[str, ...]:
    """Names of the campaigns that ship."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def shipped_campaign_text(name: str) -> str:
    """File of a campaign that ships.

    Raises:
        InputError: No such campaign.
    """
    if name not in shipped_campaigns():
        allowed = ", ".join(shipped_campaigns())
        raise InputError("no such campaign", field="campaign", value=name, allowed=allowed)
    return (FOLDER / f"{name}.toml").read_text(encoding="utf-8")


def read_campaign(
    name_or_path: str, drivers: str | None = None, sample: int | None = None
) -> AbstractCampaign:
    """A campaign by the name of one that ships, or by its file.

    Args:
        name_or_path: Name of a campaign that ships, or path of a TOML file.
        drivers: Drivers to run instead of the file's own, separated by commas.
        sample: Size of the sample instead of the file's own; 0: the whole matrix.

    Raises:
        InputError: No such campaign, or something in it cannot be used.
    """
    path = FOLDER / f"{name_or_path}.toml" if name_or_path in shipped_campaigns() else Path(name_or_path)
    if not path.exists():
        allowed = f"a TOML file, or one of {', '.join(shipped_campaigns())}"
        raise InputError("no such campaign", field="campaign", value=name_or_path, allowed=allowed)
    campaign = _read_any(path, read_values(path))
    if not isinstance(campaign, Campaign):
        _check_rows(path, campaign)
        for field, value in {"drivers": drivers, "sample": sample}.items():
            if value is not None:
                raise InputError("only for a campaign of drives", file=path, field=field, value=value)
        return campaign
    if sample is not None:
        if sample < 0:
            raise InputError("out of range", field="sample", value=sample, allowed=">= 0")
        campaign = replace(campaign, sample=sample or None)
    if drivers is not None:
        campaign = replace(campaign, drivers=_named_drivers(drivers))
    _check_rows(path, campaign)
    return campaign


def _named_drivers(drivers: str) -> tuple[str, ...]:
    """Drivers of a list with commas.

    Raises:
        InputError: None, or one that there is not.
    """
    names = tuple(dict.fromkeys(word.strip() for word in drivers.split(",") if word.strip()))
    if not names:
        raise InputError("no driver given", field="drivers", value=drivers)
    for name in names:
        make_driver(name)
    return names

"""TOML files of campaigns, shipped or own, validated by pydantic: an error names file and field in a line."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, create_model

from metropilot._schema import field_specs
from metropilot.campaign.declared import DRAWN, OWN, Campaign, DisturbanceCase
from metropilot.campaign.line_sweep import sweep_from_values
from metropilot.campaign.matrix import DRIVES, KINDS, LINE, AbstractCampaign
from metropilot.campaign.toml_file import (
    DrawnTrainsets,
    StrictModel,
    add_place,
    keep_once,
    list_trainsets,
    read_values,
    resolve_name,
    validate,
)
from metropilot.drivers import DRIVERS
from metropilot.errors import InputError, rename_fields
from metropilot.evaluate import make_driver, run_fields
from metropilot.railway import RESTRICTION_KMH, load_line
from metropilot.sim import CONTROL_PERIOD_S, Disturbance

ALL = "all"
UNSPECIFIC = ("learned",)
"""Drivers that need a policy file, and so are no part of ``all``."""
Share = Annotated[float, Field(ge=0, le=1)]
Spread = float | tuple[float, float]


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
    actuation: tuple[Annotated[float, Field(ge=0, le=5)], Annotated[float, Field(ge=0, le=5)]] | None = None


Seconds = Annotated[float, Field(ge=0, le=5)]
Late = tuple[Seconds, Seconds]


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
        InputError: Something in it cannot be used.
    """
    values = dict(values)
    kind = values.pop("kind", DRIVES)
    with rename_fields({"kind": "kind"}, path):
        KINDS.row(str(kind))
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
    for name in wanted:
        try:
            make_driver(name)
        except InputError as error:
            raise add_place(path, "matrix.drivers", error) from None
    return keep_once(wanted)


def _sections(path: Path, wanted: list[str]) -> tuple[tuple[str, str, str], ...]:
    """``LINE``: each of its sections both ways; ``LINE ORIGIN DESTINATION``: one."""
    found = []
    for text in wanted:
        line_id, *stations = _words(path, text)
        line_id = resolve_name(path, line_id)
        try:
            line = load_line(line_id)
            if not stations:
                cuts = [*line.sections(), *line.sections(backward=True)]
            elif len(stations) == 2:
                cuts = [line.section(*stations)]
            else:
                raise InputError("not a section", value=text, allowed="LINE, or LINE ORIGIN DESTINATION")
        except InputError as error:
            raise add_place(path, "matrix.sections", error) from None
        found += [(line_id, cut.origin.code, cut.destination.code) for cut in cuts]
    return keep_once(found)


def _words(path: Path, text: str) -> list[str]:
    try:
        words = shlex.split(text)
    except ValueError:
        words = []
    if not words:
        allowed = "LINE, or LINE ORIGIN DESTINATION"
        raise InputError("not a section", file=path, field="matrix.sections", value=text, allowed=allowed)
    return words


def _disturbance(path: Path, item: CampaignDisturbance) -> DisturbanceCase:
    ranges, specs = {}, field_specs(Disturbance)
    for name in DRAWN:
        given = getattr(item, name)
        if given is None:
            continue
        low, high = given if isinstance(given, tuple) else (given, given)
        field = f"disturbance {item.name}.{name}"
        try:
            for value in (low, high):
                specs[name].check(name, value)
        except InputError as error:
            raise add_place(path, field, error) from None
        if low > high:
            raise InputError("ends before it begins", file=path, field=field, value=f"{low:g} to {high:g}")
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
    from metropilot.campaign.reading import campaign_from_toml
    from metropilot.evaluate import make_driver

    path = FOLDER / f"{name_or_path}.toml" if name_or_path in shipped_campaigns() else Path(name_or_path)
    if not path.exists():
        allowed = f"a TOML file, or one of {', '.join(shipped_campaigns())}"
        raise InputError("no such campaign", field="campaign", value=name_or_path, allowed=allowed)
    campaign = campaign_from_toml(path)
    if not isinstance(campaign, Campaign):
        for field, value in {"drivers": drivers, "sample": sample}.items():
            if value is not None:
                raise InputError("only for a campaign of drives", file=path, field=field, value=value)
        return campaign
    if sample is not None:
        if sample < 0:
            raise InputError("out of range", field="sample", value=sample, allowed=">= 0")
        campaign = replace(campaign, sample=sample or None)
    if drivers is None:
        return campaign
    names = tuple(dict.fromkeys(word.strip() for word in drivers.split(",") if word.strip()))
    if not names:
        raise InputError("no driver given", field="drivers", value=drivers)
    for name in names:
        make_driver(name)
    return replace(campaign, drivers=names)

"""Request of a convoy: the run of the head, and its followers."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any

from metropilot._io import read_text
from metropilot._schema import FieldSpec, check_fields, convert, declare, field_specs, from_table
from metropilot.convoy.drivers import FOLLOWERS, AbstractFollower
from metropilot.convoy.model import (
    CONVOY_PERIOD_S,
    LEADER_SHARE,
    TRAINSETS,
    Convoy,
    ConvoySettings,
    Link,
    member_bounds,
)
from metropilot.convoy.rollout import ConvoyDrive, DrivenHead, drive_convoy
from metropilot.errors import InputError, rename_fields
from metropilot.evaluate import (
    RunSpec,
    is_file,
    locate_files,
    locate_policy,
    make_driver,
    run_fields,
    with_options,
)
from metropilot.planning import joint_minimum_running_time
from metropilot.railway import load_trainset
from metropilot.sim import Disturbance, Run


@dataclass(frozen=True)
class ConvoyRequest(ConvoySettings):
    """All inputs of the run of a convoy; command line, HTTP and `run.json` take its fields from here.

    Without disturbances of its own every trainset has that of the head's run.

    Attributes:
        head: Run of the head: line, stations, time, trainset and load, driver, disturbance, period and seed.
        count: Number of trainsets.
        follower: Id of the driver of the followers.
        options: Its options.
        emergency_s: Time at which the head makes an emergency brake (infinite: never).
        behind: Trainsets of the followers, front to back, as ``trainset`` of the head's run; the last also
            stands for those after it; empty: that of the head.
    """

    head: RunSpec
    count: int = field(default=2, metadata={FieldSpec: TRAINSETS})
    follower: str = declare(
        "follow_plan", "Driver of the followers; see `metropilot drivers --followers`.", option="driver"
    )
    options: Mapping[str, Any] = field(default_factory=dict)
    emergency_s: float = declare(
        float("inf"),
        "When the head makes an emergency brake.",
        unit="s",
        low=0.0,
        infinite=True,
        option="head-emergency",
    )

    behind: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_fields(self)
        if len(self.behind) >= self.count:
            raise InputError(
                "more trainsets than followers",
                field="behind",
                value=len(self.behind),
                allowed=f"at most {self.count - 1}",
            )

    @classmethod
    def from_values(cls, values: Mapping[str, Any], head: RunSpec | None = None) -> ConvoyRequest:
        """Make the request from plain values as in `run.json`.

        Args:
            values: By the names of the fields; ``head`` as :meth:`metropilot.evaluate.RunSpec.from_values`
                takes it, ``link`` and each of ``disturbances`` by the names of their own fields. What is not
                given, or None, has its default; ``dt_s`` that of a convoy.
            head: Run of the head instead of that in the values, with its own period.

        Raises:
            InputError: An unknown key, one of the wrong kind, or a value outside its range.
        """
        given = {key: value for key, value in values.items() if value is not None}
        if head is None:
            told = {key: value for key, value in given.pop("head", {}).items() if value is not None}
            head = RunSpec.from_values({"dt_s": CONVOY_PERIOD_S} | told)
        with rename_fields({name: f"link_{name}" for name in field_specs(Link)} | {Link.__name__: "link"}):
            link = from_table(Link, given.pop("link", {}))
        own, tables = [], given.pop("disturbances", [])
        if not isinstance(tables, list | tuple):
            words = "wrong kind of value"
            raise InputError(words, field="disturbances", value=str(tables), allowed="a list of tables")
        for k, each in enumerate(tables):
            names = {name: f"disturbances.{k}.{name}" for name in field_specs(Disturbance)}
            with rename_fields(names | {Disturbance.__name__: f"disturbances.{k}"}):
                own.append(from_table(Disturbance, each))
        options = dict(given.pop("options", {}))
        behind = tuple(convert("behind", given.pop("behind", []), list))
        more = {"head": head, "link": link, "options": options, "disturbances": tuple(own), "behind": behind}
        return from_table(cls, given, **more)

    def convoy(self) -> Convoy:
        """The convoy.

        Raises:
            InputError: Something in the request cannot be used.
        """
        shared = {f.name: getattr(self, f.name) for f in fields(ConvoySettings)}
        updates = self.head.disturbance.updates
        shared["disturbances"] = tuple(
            replace(each, updates=updates) for each in self.disturbances or (self.head.disturbance,)
        )
        with rename_fields({"trainset": "behind"}):
            found = tuple(load_trainset(key) for key in self.behind) or (self.head.loaded_trainset(),)
        found += found[-1:] * (self.count - 1 - len(found))
        return Convoy(
            section=self.head.section(),
            trainsets=(self.head.loaded_trainset(), *found),
            dt=self.head.dt_s,
            **shared,
        )

    def run(self, convoy: Convoy) -> Run:
        """The run of the head; limits hold until the last trainset has cleared them.

        Raises:
            Infeasible: The time is below the convoy's minimum running time, which the message names.
        """
        section, trainset = convoy.leader()
        if convoy.guard == "coupled":
            trainset = replace(trainset, traction=trainset.traction.scale(LEADER_SHARE))
        coupled = convoy.coupled_trainsets()
        trainsets, offsets_m = zip((trainset, 0.0), *coupled, strict=True)
        fastest_s = joint_minimum_running_time(section, trainsets, offsets_m, limits_extended=True)
        alone = self.head.run(fastest_s, "minimum running time of the convoy")
        longer_m = convoy.cleared_after_m
        updates = tuple(
            each
            if each.restriction is None
            else replace(each, restriction=replace(each.restriction, to_m=each.restriction.to_m + longer_m))
            for each in alone.disturbance.updates
        )
        disturbance = replace(convoy.disturbance(0), updates=updates)
        # Protection of the head relies on a controlled emergency brake, and so must its driver.
        bounds = member_bounds(convoy, 0) if convoy.guard == "coupled" else None
        return replace(
            alone, section=section, trainset=trainset, disturbance=disturbance, coupled=coupled, bounds=bounds
        )

    def scheduled_time_s(self, convoy: Convoy) -> float:
        """Scheduled running time of the head after every new arrival time."""
        run = self.run(convoy)
        told = [run.scheduled_time_s, *(each.scheduled_time_s for each in run.disturbance.updates)]
        return [time_s for time_s in told if time_s is not None][-1]

    def driven_head(self, convoy: Convoy) -> DrivenHead:
        """Make the head and its driver.

        Raises:
            InputError: No such driver, no such option.
            Infeasible: The head's driver cannot meet the scheduled time.
        """
        driver = make_driver(self.head.driver, self.head.options)
        share = LEADER_SHARE if convoy.guard == "coupled" else 1.0
        return DrivenHead(self.run(convoy), driver, self.emergency_s, share)

    def make_follower(self) -> AbstractFollower:
        """Make the driver of the followers.

        Raises:
            InputError: No such follower, or no such option of it.
        """
        with rename_fields({"driver": "follower"}):
            return with_options(FOLLOWERS.get(self.follower), self.options)

    def drive(self, convoy: Convoy | None = None, follower: AbstractFollower | None = None) -> ConvoyDrive:
        """Drive the convoy.

        Args:
            convoy: The convoy, if it exists already.
            follower: The driver of the followers, if it exists already.
        """
        convoy, follower = convoy or self.convoy(), follower or self.make_follower()
        return drive_convoy(convoy, self.driven_head(convoy), follower, self.head.seed)

    def values(self) -> dict[str, Any]:
        """The request as plain values, without those that are None or infinite."""
        own = {name: getattr(self, name) for name in (*field_specs(type(self)), "options")}
        given = [
            {name: getattr(each, name) for name in field_specs(Disturbance)} for each in self.disturbances
        ]
        values = own | {"head": self.head.values(), "link": asdict(self.link), "disturbances": given}
        values |= {"behind": list(self.behind)} if self.behind else {}
        return _finite(values)


def convoy_from_json(path: Path) -> ConvoyRequest:
    """Read a convoy back from the `run.json` of its folder; paths in it count from that folder.

    Raises:
        InputError: Not readable, not a `run.json`, an unknown key (the nearest one is named) or a value of
            the wrong kind or outside its range.
    """
    try:
        table = json.loads(read_text(path, "from"))["run"]
    except InputError:
        raise
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        reason = 'no object "run"' if isinstance(error, KeyError | TypeError) else str(error)
        raise InputError(f"not a run.json of a convoy ({reason})", file=path, field="from") from None
    if not isinstance(table, dict) or not isinstance(table.get("head"), dict):
        raise InputError('not a run.json of a convoy (no "head" in "run")', file=path, field="from")
    with in_run_json(path, table):
        request = ConvoyRequest.from_values(table)
    options = locate_policy(request.options, path.parent)
    behind = tuple(str(path.parent / key) if is_file(key) else key for key in request.behind)
    return replace(request, head=locate_files(request.head, path.parent), options=options, behind=behind)


def in_run_json(path: Path, table: Mapping[str, Any] | None = None) -> AbstractContextManager[None]:
    """Let errors about a convoy that was read from a `run.json` name the file and the key in it."""
    table = table or {}

    def keys(kind: type, given: object) -> Iterable[str]:
        return *field_specs(kind), *(given if isinstance(given, Mapping) else ())

    own = {*field_specs(ConvoyRequest), *table} - {"head"}
    names = {key: f"run.head.{key}" for key in (*run_fields(), *table.get("head", ()))}
    names |= {key: f"run.{key}" for key in own}
    names |= {f"link_{key}": f"run.link.{key}" for key in keys(Link, table.get("link"))}
    disturbances = table.get("disturbances")
    for k, each in enumerate(disturbances if isinstance(disturbances, list) else ()):
        names[f"disturbances.{k}"] = f"run.disturbances.{k}"
        names |= {f"disturbances.{k}.{key}": f"run.disturbances.{k}.{key}" for key in keys(Disturbance, each)}
    return rename_fields(names | {"set": "run.options"}, path)


def _finite(value: Any) -> Any:  # noqa: ANN401 (plain values)
    """A tree of plain values without None and infinity, which JSON does not have."""
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items() if v is not None and v != float("inf")}
    return [_finite(v) for v in value] if isinstance(value, list) else value

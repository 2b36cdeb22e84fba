"""Request of a run: one declaration for the command line, `run.toml`, the HTTP API and campaigns."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from inspect import signature
from pathlib import Path
from typing import Any, get_args, get_type_hints

from metropilot._io import read_text
from metropilot._schema import CheckedFields, FieldSpec, check_name, convert, declare, field_specs, field_type
from metropilot.drivers import DRIVERS
from metropilot.errors import InputError, rename_fields
from metropilot.planning import Objective
from metropilot.railway import Restriction, Section, Trainset, load_line, load_trainset, parse_trainset
from metropilot.sim import CONTROL_PERIOD_S, AbstractDriver, Disturbance, Run, TimetableUpdate
from metropilot.units import KINDS

SPEED_UNIT = KINDS["speed"]["km/h"]
NUMBER = r"\d+(?:\.\d*)?(?:[eE][+-]?\d+)?"
RESTRICTION = re.compile(rf"({NUMBER})-({NUMBER})@({NUMBER})(?:@({NUMBER}))?")
ARRIVAL = re.compile(rf"({NUMBER})@({NUMBER})")
OBJECTIVES: tuple[str, ...] = get_args(Objective)
FILES = ("line", "trainset")
POLICY = "policy"
"""The option of a driver that names a file, or a learning run."""


@dataclass(frozen=True)
class RunSpec(CheckedFields):
    """All inputs of a run.

    Attributes:
        line: Catalogue id or path.
        origin: Code or name of the station of departure.
        destination: Code or name of the station of arrival.
        time_s: Scheduled running time; None takes the line's planned time.
        trainset: Catalogue id or path.
        load: Load aboard; None takes the trainset's first.
        driver: Driver id.
        options: Options of the driver.
        disturbance: Differences from the data of driver and planner, announced updates included.
        restrictions: Temporary speed restrictions that are known before departure.
        objective: Energy the optimum minimises.
        dt_s: Control period.
        seed: Seed of all random draws.
    """

    line: str = declare(MISSING, "Line: catalogue id or path to a .toml or .json file.")
    origin: str = declare(MISSING, "Station of departure: code or name.")
    destination: str = declare(MISSING, "Station of arrival: code or name.")
    time_s: float | None = declare(
        None,
        "Running time; the line's planned time if not given.",
        unit="s",
        low=0.0,
        above=True,
        option="time",
    )
    trainset: str = declare(
        "dkz32",
        "Trainset: catalogue id or path; ID:LOAD names its load, ID@DELAY,LAG another dead time and lag.",
    )
    load: str | None = declare(None, "Load aboard, e.g. AW2.")
    driver: str = declare("optimal", "Driver id; see `metropilot drivers`.")
    options: Mapping[str, Any] = field(
        default_factory=dict,
        metadata={FieldSpec: FieldSpec("Option of the driver; repeatable.", option="set", form="NAME=VALUE")},
    )
    disturbance: Disturbance = field(default_factory=Disturbance)
    restrictions: tuple[Restriction, ...] = declare(
        (),
        "Temporary speed restriction, m from the origin and 5 to 400 km/h; @T: announced T s after "
        "departure.",
        option="restriction",
        form="FROM-TO@KMH[@T]",
    )
    objective: Objective = declare("wheel", "Energy to minimise: wheel or line.", choices=OBJECTIVES)
    dt_s: float = field(
        default=CONTROL_PERIOD_S,
        metadata={FieldSpec: replace(field_specs(Run)["dt"], option="dt", label="Control period", step=0.05)},
    )
    seed: int = declare(0, "Seed of everything random.", low=0, high=2**63 - 1, label="Seed", step=1.0)

    @classmethod
    def from_values(cls, values: Mapping[str, Any]) -> RunSpec:
        """Make the request from plain values as in `run.toml`; restrictions and arrivals are texts.

        Args:
            values: By the keys of :func:`run_fields`; a key that is not given, or None, has its default.

        Raises:
            InputError: An unknown key (the nearest one is named), a missing one, a value of the wrong kind or
                outside its range.
        """
        given, specs = {}, run_fields()
        for key, value in values.items():
            check_name(key, specs, "key", field=key)
            if value is not None:
                given[key] = convert(key, value, key_type(key), specs[key].describe_allowed())
        for key in ("line", "origin", "destination"):
            if key not in given:
                raise InputError("missing", field=key, allowed="text")
        texts = [parse_restriction(text) for text in given.pop("restrictions", ())]
        updates = [item for item in texts if isinstance(item, TimetableUpdate)]
        updates += [parse_arrival(text) for text in given.pop("arrivals", ())]
        own = {key: given.pop(key) for key in field_specs(Disturbance) if key in given}
        return cls(
            **given,
            disturbance=Disturbance(**own, updates=tuple(updates)),
            restrictions=tuple(item for item in texts if isinstance(item, Restriction)),
        )

    def values(self) -> dict[str, Any]:
        """The run as plain values, for TOML and JSON; what is None is left out."""
        updates = self.disturbance.updates
        found: dict[str, Any] = {}
        for key in run_fields():
            if key == "restrictions":
                known = [_restriction_text(item) for item in self.restrictions]
                found[key] = known + [
                    _restriction_text(u.restriction, u.at_s) for u in updates if u.restriction
                ]
            elif key == "arrivals":
                found[key] = [
                    f"{_short(u.scheduled_time_s)}@{_short(u.at_s)}"
                    for u in updates
                    if u.scheduled_time_s is not None
                ]
            else:
                found[key] = getattr(self if hasattr(self, key) else self.disturbance, key)
        found["options"] = dict(self.options)
        return {key: value for key, value in found.items() if value is not None}

    def loaded_trainset(self) -> Trainset:
        """The nominal trainset with its load."""
        return load_trainset(self.trainset, self.load)

    def section(self) -> Section:
        """The section with every restriction known before departure."""
        section = line_section = self.open_section()
        with rename_fields({"restriction": "restrictions"}):
            for restriction in self.restrictions:
                section = section.with_restriction(line_section.check_restriction(restriction))
        return section

    def open_section(self) -> Section:
        """The section without temporary restrictions."""
        return load_line(self.line).section(self.origin, self.destination)

    def run(self, fastest_s: float | None = None, what: str = "minimum running time") -> Run:
        """The run.

        Args:
            fastest_s: Minimum running time of the open section, where it is known already.
            what: Name of that minimum in an error.

        Raises:
            InputError: Something in it cannot be used.
            Infeasible: The scheduled time is below the minimum running time, which the message names. A
                temporary restriction that costs more than the reserve is no such case: the run will be late.
        """
        section, open_section, trainset = self.section(), self.open_section(), self.loaded_trainset()
        time_s = self.time_s if self.time_s is not None else section.planned_time_s
        if time_s is None:
            words = f"the line plans no running time for {section.name}; give one"
            raise InputError(words, field="time_s", allowed="> 0 s")
        updates = tuple(sorted(self.disturbance.updates, key=lambda update: update.at_s))
        with rename_fields({"restriction": "restrictions"}):
            for update in updates:
                if update.restriction is not None:
                    open_section.check_restriction(update.restriction)
        disturbance = replace(self.disturbance, updates=updates)
        run = Run(section, trainset, time_s, disturbance, self.dt_s, self.seed)
        # planning loads the solver; options are declared without it
        from metropilot.planning import LONGEST_RATIO, check_running_time, minimum_running_time

        fastest = fastest_s or minimum_running_time(open_section, trainset)
        check_running_time(time_s, fastest, what)
        for update in updates:
            if update.scheduled_time_s is not None and update.scheduled_time_s > LONGEST_RATIO * fastest:
                check_running_time(update.scheduled_time_s, fastest, field="arrivals")
        return run

    def make_driver(self) -> AbstractDriver:
        """Make the driver; a driver with the option ``objective`` gets that of the run.

        Raises:
            InputError: No such driver, or no such option of it.
        """
        told = dict(self.options)
        driver_id, _ = parse_driver(self.driver)
        if driver_id in DRIVERS and "objective" in option_defaults(DRIVERS.get(driver_id)):
            told.setdefault("objective", self.objective)
        return make_driver(self.driver, told)

    def resolve(self) -> RunSpec:
        """The same run with station codes, load and time filled in, and options separated from the driver."""
        section, trainset = self.section(), self.loaded_trainset()
        time_s = self.time_s if self.time_s is not None else section.planned_time_s
        origin, destination = section.origin.code, section.destination.code
        trainset_id = self.trainset.removesuffix(f":{trainset.load}")
        driver_id, named = parse_driver(self.driver)
        return replace(
            self,
            driver=driver_id,
            options=named | dict(self.options),
            origin=origin,
            destination=destination,
            time_s=time_s,
            trainset=trainset_id,
            load=trainset.load,
        )


def run_fields() -> dict[str, FieldSpec]:
    """Every key of a run in `run.toml`, with its declaration."""
    own, disturbance = field_specs(RunSpec), field_specs(Disturbance)
    arrivals = FieldSpec(
        "New running time of S s, announced T s after departure.", option="arrive", form="S@T"
    )
    late = ("restrictions", "objective", "dt_s", "seed")
    first = {key: spec for key, spec in own.items() if key not in late}
    last = {"restrictions": own["restrictions"], "arrivals": arrivals}
    return first | disturbance | last | {key: own[key] for key in late[1:]}


def key_type(key: str) -> type:
    """The type of a run's key: ``float``, ``int``, ``bool``, ``str``, ``dict`` or ``list`` (of texts)."""
    given: dict[str, type] = {"restrictions": list, "arrivals": list, "options": dict}
    return given.get(key) or field_type(RunSpec if key in field_specs(RunSpec) else Disturbance, key)


def parse_restriction(text: str) -> Restriction | TimetableUpdate:
    """``FROM-TO@KMH``: known before departure; ``FROM-TO@KMH@T``: announced T s after it.

    Raises:
        InputError: Not of that form, or of a speed below 5 or above 400 km/h.
    """
    match = RESTRICTION.fullmatch(text.replace(" ", ""))
    if match is None:
        raise InputError(
            "not a restriction",
            field="restrictions",
            value=text,
            allowed="FROM-TO@KMH or FROM-TO@KMH@T, e.g. 400-600@40 or 400-600@40@30 (m, m, km/h, s)",
        )
    start, end, kmh = (float(x) for x in match.groups()[:3])
    with rename_fields(
        dict.fromkeys((*field_specs(Restriction), *field_specs(TimetableUpdate)), "restrictions")
    ):
        restriction = Restriction(start, end, SPEED_UNIT.to_si(kmh))
        return restriction if match[4] is None else TimetableUpdate(float(match[4]), restriction=restriction)


def parse_arrival(text: str) -> TimetableUpdate:
    """``S@T``: from T s after departure the scheduled running time is S.

    Raises:
        InputError: Not of that form.
    """
    match = ARRIVAL.fullmatch(text.replace(" ", ""))
    if match is None or float(match[1]) <= float(match[2]):
        raise InputError(
            "not a new running time",
            field="arrivals",
            value=text,
            allowed="S@T with S later than T, e.g. 116@30: arrive after 116 s, sent after 30 s",
        )
    with rename_fields(dict.fromkeys(field_specs(TimetableUpdate), "arrivals")):
        return TimetableUpdate(float(match[2]), scheduled_time_s=float(match[1]))


def _restriction_text(restriction: Restriction, at_s: float | None = None) -> str:
    """Inverse of :func:`parse_restriction`."""
    start, end, kmh = restriction.from_m, restriction.to_m, SPEED_UNIT.from_si(restriction.limit_mps)
    return f"{_short(start)}-{_short(end)}@{_short(kmh)}" + ("" if at_s is None else f"@{_short(at_s)}")


def _short(number: float) -> str:
    """A number with all its digits, without a trailing ``.0``."""
    return repr(float(number)).removesuffix(".0")


def is_file(key: str) -> bool:
    """True if a line or trainset is given by a path and not by a catalogue id."""
    return parse_trainset(key).is_file


def run_from_toml(path: Path) -> RunSpec:
    """Read a run back from a `run.toml`; paths in it count from its own folder.

    Raises:
        InputError: Not readable, not a `run.toml`, an unknown key (the nearest one is named) or a value of
            the wrong kind.
    """
    try:
        table = tomllib.loads(read_text(path, "from"))["run"]
    except InputError:
        raise
    except (ValueError, KeyError, RecursionError) as error:
        reason = "no table [run]" if isinstance(error, KeyError) else str(error)
        raise InputError(f"not a run.toml ({reason})", file=path, field="from") from None
    if not isinstance(table, dict):
        raise InputError("not a run.toml (no table [run])", file=path, field="from")
    with in_run_toml(path, *table):
        spec = RunSpec.from_values(table)
    return locate_files(spec, path.parent)


def locate_files(spec: RunSpec, folder: Path) -> RunSpec:
    """The same run with line, trainset and policy files found from a folder."""
    places: dict[str, Any] = {k: str(folder / v) for k in FILES if is_file(v := getattr(spec, k))}
    return replace(spec, **places, options=locate_policy(spec.options, folder))


def locate_policy(options: Mapping[str, Any], folder: Path) -> Mapping[str, Any]:
    """Options of a driver with its policy file found from a folder, or a learning run of that id."""
    policy = options.get(POLICY)
    if not isinstance(policy, str) or not policy:
        return options
    from metropilot.policy import policy_path

    near = folder / policy
    meant = near if near.exists() else policy_path(policy)
    return {**options, POLICY: str(meant if meant.exists() else near)}


def in_run_toml(path: Path, *keys: str) -> AbstractContextManager[None]:
    """Let errors about a run that was read from a `run.toml` name the file and the key in it."""
    return rename_fields({key: f"run.{key}" for key in (*run_fields(), *keys)} | {"set": "run.options"}, path)


def option_class(driver: type[Any]) -> type[Any] | None:
    """The dataclass a driver takes as its argument ``options``; None if it takes none."""
    if "options" not in signature(driver.__init__).parameters:
        return None
    hint = get_type_hints(driver.__init__)["options"]
    return next(
        (kind for kind in (hint, *get_args(hint)) if isinstance(kind, type) and is_dataclass(kind)), None
    )


def option_defaults(driver: type[Any]) -> dict[str, Any]:
    """The options of a driver with their default values."""
    kind = option_class(driver)
    if kind is None:
        return {}
    return {f.name: f.default for f in fields(kind) if f.default is not MISSING}


def parse_option(text: str) -> tuple[str, Any]:
    """Parse ``NAME=VALUE``; the value becomes a number or a truth value if it has that form.

    Raises:
        InputError: Not of that form.
    """
    name, equals, value = text.partition("=")
    if not (equals and name.isidentifier()):
        raise InputError("not an option of a driver", field="set", value=text, allowed="NAME=VALUE")
    if value.lower() in {"true", "false"}:
        return name, value.lower() == "true"
    for kind in (int, float):
        try:
            return name, kind(value)
        except ValueError:
            continue
    return name, value


def parse_driver(text: str) -> tuple[str, dict[str, Any]]:
    """Parse ``ID`` or ``ID:NAME=VALUE:NAME=VALUE``: a driver with options in one word.

    Raises:
        InputError: The text after the colon is not an option.
    """
    driver_id, *options = re.split(r":(?=\w+=)", text)
    driver_id, colon, rest = driver_id.partition(":")
    if colon:
        raise InputError("not an option of a driver", field="driver", value=rest, allowed="ID:NAME=VALUE")
    return driver_id, dict(map(parse_option, options))


def make_driver(driver_id: str, options: Mapping[str, Any] | None = None) -> AbstractDriver:
    """Make a driver by id with some of its options; the error of an unknown name gives the nearest one.

    Args:
        driver_id: Id in the registry, or ``ID:NAME=VALUE``.
        options: Fields of the driver's options dataclass.

    Raises:
        InputError: No such driver, no such option of it, or a value of the wrong kind.
    """
    driver_id, named = parse_driver(driver_id)
    return with_options(DRIVERS.get(driver_id), named | dict(options or {}))


def with_options(driver: type[Any], options: Mapping[str, Any]) -> Any:  # noqa: ANN401 (a driver or follower)
    """Make a driver or follower with some of its options.

    Args:
        driver: Its class.
        options: Fields of its options dataclass.

    Raises:
        InputError: No such option of it, or a value of the wrong kind.
    """
    if not options:
        return driver()
    kind, defaults = option_class(driver), option_defaults(driver)
    if kind is None:
        raise InputError(f"{driver.id} takes no options", field="set", value=next(iter(options)))
    values = {}
    for name, value in options.items():
        check_name(name, defaults, f"option of {driver.id}", field="set", value=name)
        default = defaults[name]
        values[name] = value if default is None else convert(f"set {name}", value, type(default))
    with rename_fields({name: f"set {name}" for name in values}):
        made = kind(**values)
    return driver(options=made)

"""Lines, trainsets and journeys by catalogue id or from a file."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

from metropilot._io import read_text
from metropilot.errors import InputError
from metropilot.railway.day import ServiceDay
from metropilot.railway.drawn import NAME as DRAWN_NAME
from metropilot.railway.drawn import drawn_trainset
from metropilot.railway.feeding import Feeding
from metropilot.railway.formats.reader import Node, nearest
from metropilot.railway.formats.toml import line_document, read_journey, read_line, toml_text
from metropilot.railway.formats.toml_day import read_day
from metropilot.railway.formats.toml_feeding import read_feeding
from metropilot.railway.formats.toml_trainset import read_trainset, trainset_document
from metropilot.railway.formats.ttobench import read_ttobench
from metropilot.railway.journey import Journey, planned_journey
from metropilot.railway.line import Line
from metropilot.railway.trainset import COMMAND_TIME, Trainset

Catalogued = Line | Trainset | Journey | Feeding | ServiceDay
"""Whatever a file describes."""
T = TypeVar("T", Line, Trainset, Journey, Feeding, ServiceDay)

_READERS: dict[str, Callable[[Node], Catalogued]] = {
    "line": read_line,
    "trainset": read_trainset,
    "journey": read_journey,
    "feeding": read_feeding,
    "day": read_day,
}


_KINDS = {"line": Line, "trainset": Trainset, "journey": Journey, "feeding": Feeding, "day": ServiceDay}


def import_file(path: str | Path) -> Catalogued:
    """Read a line, a trainset, a journey, a feeding or a day from a file: metropilot's TOML or TTOBench JSON.

    Args:
        path: A file ending in ``.toml`` or ``.json``.

    Raises:
        InputError: The file cannot be read, is of neither format, or is malformed: one line that names the
            file, the field, the value, its unit and what is allowed.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in {".toml", ".json"}:
        raise InputError("unknown kind of file", file=path, allowed="a file ending in .toml or .json")
    text = read_text(path)
    if kind == ".json":
        return read_ttobench(Node(_parse(path, text, _json, "JSON"), path), path.stem)
    return parse_document(text, path)


def parse_document(text: str, file: object) -> Catalogued:
    """Read a line, a trainset, a journey, a feeding or a day from the text of a TOML document.

    Args:
        text: The document.
        file: Its name in errors.

    Raises:
        InputError: It is malformed: one line that names the field, the value, its unit and what is allowed.
    """
    root = Node(_parse(file, text, tomllib.loads, "TOML"), file)
    kind = root.text("kind", allowed=", ".join(_READERS))
    if kind not in _READERS:
        raise root.fail(f"unknown kind{nearest(kind, list(_READERS))}", "kind", kind, ", ".join(_READERS))
    return _READERS[kind](root)


def _json(text: str) -> object:
    def refuse(name: str) -> float:
        raise ValueError(f"{name} is not a number JSON knows")

    found = json.loads(text, parse_constant=refuse)
    if "\\u" in text:
        # Half a surrogate pair can be escaped, but no file can hold it.
        try:
            json.dumps(found, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise ValueError("text must be proper Unicode, without lone surrogates") from None
    return found


def _parse(file: object, text: str, parse: Callable[[str], object], name: str) -> dict[str, Any]:
    try:
        data = parse(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid {name} ({error})", file=file, allowed=f"a {name} document") from error
    if not isinstance(data, dict):
        raise InputError(f"not a {name} object", file=file, allowed=f"a {name} object at the top")
    return data


def list_lines() -> tuple[str, ...]:
    """Ids of the lines in the catalogue."""
    return _ids("lines")


def list_trainsets() -> tuple[str, ...]:
    """Ids of the trainsets in the catalogue."""
    return _ids("trainsets")


def list_feedings() -> tuple[str, ...]:
    """Ids of the feedings in the catalogue."""
    return _ids("feedings")


def list_days() -> tuple[str, ...]:
    """Ids of the working days in the catalogue."""
    return _ids("days")


@lru_cache
def _ids(folder: str) -> tuple[str, ...]:
    names = (entry.name for entry in (files("metropilot.railway") / "catalogue" / folder).iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml")))


@lru_cache
def _from_catalogue(folder: str, key: str) -> Catalogued:
    return parse_document(_catalogue_text(folder, key), f"catalogue/{folder}/{key}.toml")


def _catalogue_text(folder: str, key: str) -> str:
    return (files("metropilot.railway") / "catalogue" / folder / f"{key}.toml").read_text(encoding="utf-8")


def _load(key: str | Path, folder: str, what: str, kind: type[T]) -> T:
    if str(key).lower().endswith((".toml", ".json")):
        found = import_file(key)
        if not isinstance(found, kind):
            other = next(name for name, of in _KINDS.items() if isinstance(found, of))
            raise InputError(f"describes a {other}, not a {what}", file=key, allowed=f"a file of a {what}")
        return found
    ids = _ids(folder)
    if str(key) in ids:
        found = _from_catalogue(folder, str(key))
        if isinstance(found, kind):
            return found
    forms = f"; {KEY_WORDS}" if kind is Trainset else ""
    raise InputError(
        f"unknown {what}{nearest(str(key), ids)}",
        field=what,
        value=str(key),
        allowed=", ".join(ids) + ", or a path ending in .toml or .json" + forms,
    )


def load_line(id_or_path: str | Path) -> Line:
    """A line of the catalogue, or of a file.

    Args:
        id_or_path: A catalogue id, or a path ending in ``.toml`` (metropilot) or ``.json`` (TTOBench track).

    Raises:
        InputError: No such id (the catalogue is listed), or the file is not usable.
    """
    return _load(id_or_path, "lines", "line", Line)


def load_feeding(id_or_path: str | Path) -> Feeding:
    """The DC feeding of a line, of the catalogue or of a file.

    Args:
        id_or_path: A catalogue id, or a path ending in ``.toml``.

    Raises:
        InputError: No such id (the catalogue is listed), or the file is not usable.
    """
    return _load(id_or_path, "feedings", "feeding", Feeding)


def load_day(id_or_path: str | Path) -> ServiceDay:
    """A working day of a line, of the catalogue or of a file.

    Args:
        id_or_path: A catalogue id, or a path ending in ``.toml``.

    Raises:
        InputError: No such id (the catalogue is listed), or the file is not usable.
    """
    return _load(id_or_path, "days", "day", ServiceDay)


def document_text(kind: Literal["line", "trainset"], id_or_path: str | Path) -> str:
    """TOML document of a line or trainset, as it stands in its file where that is one.

    Args:
        kind: Kind of the entry.
        id_or_path: As :func:`load_line` and :func:`load_trainset` take it.

    Raises:
        InputError: No such id, or the file is not usable.
    """
    key = str(id_or_path)
    if key.lower().endswith(".toml"):
        return read_text(Path(key))
    if key in _ids(f"{kind}s"):
        return _catalogue_text(f"{kind}s", key)
    found = load_line(key) if kind == "line" else load_trainset(key)
    return toml_text(line_document(found) if isinstance(found, Line) else trainset_document(found))


def copied_key(key: str, stem: str) -> str:
    """Key of a line or trainset whose file is copied by another name; a catalogue's unchanged.

    Args:
        key: As :func:`load_line` and :func:`load_trainset` take it.
        stem: Name of the copy without its ending.
    """
    parts = parse_trainset(key)
    return str(parts._replace(id=stem + Path(parts.id).suffix.lower())) if parts.is_file else key


def copy_input(folder: Path, key: str, stem: str) -> str:
    """Copy the file of a line or trainset into a folder; returns its new key, a catalogue's unchanged.

    Args:
        folder: The folder.
        key: As :func:`load_line` and :func:`load_trainset` take it.
        stem: Name of the copy without its ending.
    """
    copied = copied_key(key, stem)
    if parse_trainset(key).is_file:
        shutil.copyfile(parse_trainset(key).id, folder / parse_trainset(copied).id)
    return copied


class TrainsetKey(NamedTuple):
    """Key of a trainset, ``ID[@DELAY,LAG][:LOAD]``, in its parts; ``str`` joins them.

    Attributes:
        id: A catalogue id, ``drawn-SEED-NUMBER``, or a path ending in ``.toml`` or ``.json``.
        actuation: Dead time and lag that the trainset declares instead of its own, s; None: its own.
        load: The load aboard; None: the trainset's first.
    """

    id: str
    actuation: tuple[float, float] | None = None
    load: str | None = None

    @property
    def is_file(self) -> bool:
        """True if the id is a path."""
        return self.id.lower().endswith((".toml", ".json"))

    @property
    def is_named(self) -> bool:
        """True if the id is one of the catalogue, or of a random trainset."""
        return self.id in list_trainsets() or DRAWN_NAME.fullmatch(self.id) is not None

    def __str__(self) -> str:
        """The key as text."""
        late = "" if self.actuation is None else "@{:.12g},{:.12g}".format(*self.actuation)
        return f"{self.id}{late}" + ("" if self.load is None else f":{self.load}")


NUMBER = r"\d+(?:\.\d*)?"
LATE = re.compile(rf"({NUMBER}),({NUMBER})")
KEY = re.compile(
    r"(?P<id>.+?\.(?:toml|json)|[\w-]+)(?:@(?P<late>[^@:/\\]*))?(?::(?P<load>.*))?", re.IGNORECASE
)
KEY_WORDS = "drawn-SEED-NUMBER is a random one; ID@DELAY,LAG declares another dead time and lag, s"


def parse_trainset(key: str | Path) -> TrainsetKey:
    """Take the key of a trainset apart; one that names nothing is an id as a whole.

    Args:
        key: As :func:`load_trainset` takes it.

    Raises:
        InputError: What stands for a dead time and a lag is none, or one that no trainset has.
    """
    text = str(key)
    match = KEY.fullmatch(text)
    plain = TrainsetKey(text if match is None else match["id"])
    if match is None or not (plain.is_file or plain.is_named):
        return TrainsetKey(text)
    late = None
    if match["late"] is not None:
        allowed = f"ID@DELAY,LAG, each 0 to {COMMAND_TIME.high:g} s"
        numbers = LATE.fullmatch(match["late"])
        if numbers is None:
            raise InputError("not a dead time and a lag", field="trainset", value=text, allowed=allowed)
        late = (float(numbers[1]), float(numbers[2]))
        for name, value in zip(("dead time", "lag"), late, strict=True):
            if not value <= COMMAND_TIME.high:
                raise InputError(f"{name} out of range", field="trainset", value=text, allowed=allowed)
    return TrainsetKey(match["id"], late, match["load"])


def load_trainset(id_or_path: str | Path, load: str | None = None) -> Trainset:
    """A trainset of the catalogue, of a file, or drawn at random, with one of its loads aboard.

    Args:
        id_or_path: A catalogue id or a path, as for :func:`load_line`, or ``drawn-SEED-NUMBER`` for a random
            one; ``ID:LOAD`` names the load as well, and ``ID@DELAY,LAG`` declares another dead time and lag
            than its own, in seconds.
        load: The load, e.g. ``AW2``, where ``id_or_path`` names no other.

    Raises:
        InputError: No such id or load, two different loads, or the file is not usable.
    """
    key = parse_trainset(id_or_path)
    if None not in (load, key.load) and load != key.load:
        raise InputError("the load is given twice", field="load", value=load, allowed=f"{key.load}, or none")
    drawn = DRAWN_NAME.fullmatch(key.id)
    if drawn is not None:
        trainset = drawn_trainset(int(drawn[1]), int(drawn[2]))
    else:
        trainset = _load(key.id, "trainsets", "trainset", Trainset)
        trainset.check_masses(key.id)
    load = key.load if load is None else load
    if key.actuation is not None:
        delay_s, lag_s = key.actuation
        trainset = replace(
            trainset,
            id=str(key._replace(id=trainset.id, load=None)),
            actuation=replace(trainset.actuation, delay_s=delay_s, lag_s=lag_s),
        )
    if key.load is not None and key.load not in trainset.loads:
        loads = ", ".join(trainset.loads)
        raise InputError("unknown load", field="trainset", value=str(id_or_path), allowed=loads)
    return trainset if load is None else trainset.with_load(load)


def load_journey(id_or_path: str | Path) -> Journey:
    """A journey from a file, or the planned timetable of a line of the catalogue.

    Args:
        id_or_path: A path ending in ``.toml`` (metropilot) or ``.json`` (TTOBench journey), or
            ``LINE-forward`` or ``LINE-backward`` for a line of the catalogue with planned times.

    Raises:
        InputError: No such id (they are listed), or the file is not usable.
    """
    key = str(id_or_path)
    if key.lower().endswith((".toml", ".json")):
        return _load(key, "", "journey", Journey)
    ids = [f"{line}-{way}" for line in list_lines() for way in ("forward", "backward")]
    if key not in ids:
        raise InputError(
            f"unknown journey{nearest(key, ids)}",
            field="journey",
            value=key,
            allowed=", ".join(ids) + ", or a path ending in .toml or .json",
        )
    line, _, way = key.rpartition("-")
    return planned_journey(load_line(line), backward=way == "backward")

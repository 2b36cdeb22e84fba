"""A request as the table ``run`` of a `run.toml`, written and read."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from metropilot._io import read_text
from metropilot.errors import InputError, renamed
from metropilot.evaluate.request import Request
from metropilot.policy import policy_path

NAMES = tuple(f.name for f in fields(Request))
FILES = ("line", "trainset")
POLICY = "policy"
"""The option of a driver that names a file, or a learning run."""
KINDS: Mapping[str, tuple[type, ...]] = {
    "options": (dict,),
    "ideal": (bool,),
    "seed": (int,),
    "restrictions": (list,),
    "arrivals": (list,),
    **dict.fromkeys(
        (
            "time_s",
            "mass_factor",
            "resistance_factor",
            "delay_s",
            "lag_s",
            "speed_noise_mps",
            "headwind_mps",
            "adhesion",
            "dt_s",
        ),
        (float, int),
    ),
}
"""What a field may hold; one that is not named is text."""


def is_file(key: str) -> bool:
    """Whether a line or trainset is named by a path and not by a catalogue id."""
    return key.lower().endswith((".toml", ".json"))


def to_table(request: Request) -> dict[str, Any]:
    """The request as a TOML table; what is None is left out."""
    values = {name: getattr(request, name) for name in NAMES}
    plain = {key: list(v) if isinstance(v, tuple) else v for key, v in values.items()}
    plain["options"] = dict(request.options)
    return {key: value for key, value in plain.items() if value is not None}


def request_from_toml(path: Path) -> Request:
    """Read the request back from a `run.toml`; paths in it count from its own folder.

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
    values = {key: _checked(path, key, value) for key, value in table.items()}
    for name in ("line", "origin", "destination"):
        if name not in values:
            raise InputError("missing", file=path, field=f"run.{name}", allowed="text")
    for name in FILES:
        if name in values and is_file(values[name]):
            values[name] = str(path.parent / values[name])
    policy = values.get("options", {}).get(POLICY)
    if isinstance(policy, str) and policy:
        near = path.parent / policy
        meant = near if near.exists() else policy_path(policy)
        values["options"] = {**values["options"], POLICY: str(meant if meant.exists() else near)}
    with in_run_toml(path):
        return Request(**values)


def in_run_toml(path: Path) -> AbstractContextManager[None]:
    """Complaints about a request that was read from this `run.toml` name the file and the key in it."""
    return renamed({name: f"run.{name}" for name in NAMES} | {"set": "run.options"}, path)


def _checked(path: Path, key: str, value: Any) -> Any:  # noqa: ANN401 (whatever TOML holds)
    """The value as the field wants it."""
    if key not in NAMES:
        near = get_close_matches(key, NAMES, 1)
        hint = f", did you mean {near[0]}?" if near else ""
        raise InputError(f"unknown key{hint}", file=path, field=f"run.{key}", allowed=", ".join(NAMES))
    kinds = KINDS.get(key, (str,))
    texts = isinstance(value, list) and all(isinstance(item, str) for item in value)
    if type(value) not in kinds or (kinds == (list,) and not texts):
        allowed = {
            dict: "a table",
            list: "a list of texts",
            bool: "true or false",
            int: "a whole number",
            str: "text",
        }
        words = allowed.get(kinds[0], "a number")
        raise InputError(
            "wrong kind of value", file=path, field=f"run.{key}", value=str(value), allowed=words
        )
    if isinstance(value, list):
        return tuple(value)
    return _number(path, key, value) if kinds == (float, int) else value


def _number(path: Path, key: str, value: float | int) -> float:
    """A whole number may have more digits than a float has room for."""
    try:
        return float(value)
    except OverflowError:
        raise InputError("out of range", file=path, field=f"run.{key}", allowed="a number") from None

"""Configurations from plain values and back, as they stand in TOML and JSON.

``config_from_mapping("ppo", {"clip": 0.1})``; an unknown key is an error that names the nearest one.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from typing import Any, Literal, get_args, get_origin, get_type_hints

from metropilot.errors import InputError
from metropilot.learn.config import CONFIGS
from metropilot.learn.config_base import AbstractConfig
from metropilot.learn.schedules import Scheduled, read_schedule

LARGEST = 10**18


def config_from_mapping(algorithm: str, values: Mapping[str, Any], *, file: object = None) -> AbstractConfig:
    """A learner's configuration from plain values, as they stand in TOML or JSON.

    Args:
        algorithm: ``ddpg dqn naf ppo sac tabular``.
        values: Fields by name; whatever is missing keeps its default.
        file: Named in error messages.

    Raises:
        InputError: An algorithm or key that does not exist (the nearest is named), a wrong type or range.
    """
    if algorithm not in CONFIGS:
        known = ", ".join(sorted(CONFIGS))
        raise InputError("unknown algorithm", file=file, field="algorithm", value=algorithm, allowed=known)
    try:
        return change_config(CONFIGS[algorithm](), values)
    except InputError as error:
        if file is None:
            raise
        story = {"field": error.field, "value": error.value, "allowed": error.allowed}
        raise InputError(error.message, file=file, **story) from None


def change_config(config: AbstractConfig, values: Mapping[str, Any]) -> AbstractConfig:
    """A configuration with some of its fields set from plain values.

    Raises:
        InputError: A key that does not exist (the nearest is named), a wrong type or range.
    """
    every = get_type_hints(type(config))
    hints = {field.name: every[field.name] for field in fields(config)}
    return replace(config, **{key: _read(key, value, hints) for key, value in values.items()})


def config_to_mapping(config: AbstractConfig) -> dict[str, Any]:
    """Every field as a plain value, None left out; :func:`config_from_mapping` reads it back."""
    plain = {key: value for key, value in asdict(config).items() if value is not None}
    return {key: list(value) if isinstance(value, tuple) else value for key, value in plain.items()}


def _read(key: str, value: Any, hints: Mapping[str, Any]) -> Any:
    """One value as the type of its field."""
    if key not in hints:
        near = difflib.get_close_matches(key, hints, n=1, cutoff=0.0)[0]
        raise InputError(f"unknown key, the nearest is {near!r}", field=str(key))
    if not _countable(value):
        raise InputError("out of range", field=key, allowed=f"whole numbers below {LARGEST:.0e}")
    return _convert(key, value, hints[key])


def _countable(value: Any) -> bool:
    """Tell if every whole number in a value has a float; larger ones than that no learner counts to."""
    todo = [value]
    while todo:
        found = todo.pop()
        if isinstance(found, Mapping | list | tuple):
            todo += found.values() if isinstance(found, Mapping) else found
        elif isinstance(found, int) and abs(found) > LARGEST:
            return False
    return True


def _convert(key: str, value: Any, hint: Any) -> Any:
    """A value if it is of the type, lists as tuples and whole numbers as floats where such are wanted."""
    if hint == Scheduled:
        return read_schedule(key, value)
    if get_origin(hint) is tuple:
        items = value if isinstance(value, list | tuple) else [value]
        return tuple(_convert(key, item, get_args(hint)[0]) for item in items)
    if get_origin(hint) is Literal:
        kind, fits = "one of " + ", ".join(get_args(hint)), value in get_args(hint)
    elif hint is bool:
        kind, fits = "true or false", isinstance(value, bool)
    elif hint is int:
        kind, fits = "a whole number", isinstance(value, int) and not isinstance(value, bool)
    else:
        if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
            return float(value)
        optional = hint == float | None
        kind, fits = "a number" + (" or nothing" if optional else ""), optional and value is None
    if not fits:
        raise InputError("wrong type or choice", field=key, value=repr(value), allowed=kind)
    return value

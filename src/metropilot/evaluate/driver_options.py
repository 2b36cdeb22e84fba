"""Drivers and their options by name, for the command line and `run.toml`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from difflib import get_close_matches
from inspect import signature
from typing import Any, get_args, get_type_hints

from metropilot.drivers import DRIVERS
from metropilot.errors import InputError
from metropilot.sim import AbstractDriver


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
    options = named | dict(options or {})
    return with_options(DRIVERS.get(driver_id), options or {})


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
        _check_name(name, tuple(defaults), f"option of {driver.id}", "set")
        values[name] = _like(defaults[name], name, value)
    return driver(options=kind(**values))


def _check_name(name: str, names: tuple[str, ...], what: str, where: str) -> None:
    if name not in names:
        near = get_close_matches(name, names, 1)
        hint = f", did you mean {near[0]}?" if near else ""
        raise InputError(f"unknown {what}{hint}", field=where, value=name, allowed=", ".join(names))


def _like(default: Any, name: str, value: Any) -> Any:  # noqa: ANN401 (whatever an option holds)
    """Convert a value to the type of the default; a whole number is accepted as a float."""
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if default is not None and type(value) is not type(default):
        kinds = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}
        allowed = kinds.get(type(default), type(default).__name__)
        raise InputError("wrong kind of value", field=f"set {name}", value=str(value), allowed=allowed)
    return value

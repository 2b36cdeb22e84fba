"""Drivers and their options by name, for the command line and `run.toml`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from inspect import signature
from typing import Any, get_args, get_type_hints

from metropilot._schema import check_name, convert
from metropilot.drivers import DRIVERS
from metropilot.errors import InputError, rename_fields
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
        check_name(name, defaults, f"option of {driver.id}", field="set", value=name)
        default = defaults[name]
        values[name] = value if default is None else convert(f"set {name}", value, type(default))
    with rename_fields({name: f"set {name}" for name in values}):
        made = kind(**values)
    return driver(options=made)

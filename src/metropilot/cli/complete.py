"""Shell completion; each list of words is read on use."""

from __future__ import annotations

import os
from collections.abc import Iterable

import typer

VARIABLE = "_METROPILOT_COMPLETE"
"""Environment variable that a shell's completion script sets."""


def words_to_complete() -> list[str]:
    """Words of the command line under completion, without the program's name."""
    if VARIABLE not in os.environ:
        return []
    line = os.environ.get("COMP_WORDS") or os.environ.get("_TYPER_COMPLETE_ARGS", "")
    return line.split()[1:]


def lines(incomplete: str) -> list[str]:
    """Ids of lines."""
    from metropilot.railway import list_lines

    return _match(list_lines(), incomplete)


def trainsets(incomplete: str) -> list[str]:
    """Ids of trainsets."""
    from metropilot.railway import list_trainsets

    return _match(list_trainsets(), incomplete)


def stations(ctx: typer.Context, incomplete: str) -> list[str]:
    """Codes of the line's stations."""
    from metropilot.errors import InputError
    from metropilot.railway import load_line

    try:
        found = load_line(str(ctx.params.get("line") or "")).stations
    except InputError:
        return []
    return [s.code for s in found if s.code.lower().startswith(incomplete.lower())]


def drivers(incomplete: str) -> list[str]:
    """Ids of drivers, the last of several separated by commas."""
    from metropilot.drivers import DRIVERS

    done, comma, last = incomplete.rpartition(",")
    return [f"{done}{comma}{key}" for key in _match(DRIVERS.ids(), last)]


def followers(incomplete: str) -> list[str]:
    """Ids of the drivers of followers."""
    from metropilot.convoy import FOLLOWERS

    return _match(FOLLOWERS.ids(), incomplete)


def showable(incomplete: str) -> list[str]:
    """Ids of everything that `metropilot show` accepts."""
    kinds = (lines, trainsets, drivers, followers)
    return list(dict.fromkeys(key for kind in kinds for key in kind(incomplete)))


def studies(incomplete: str) -> list[str]:
    """Ids of studies."""
    from metropilot.studies import STUDIES

    return _match(STUDIES.ids(), incomplete)


def _match(keys: Iterable[str], incomplete: str) -> list[str]:
    return [key for key in keys if key.startswith(incomplete)]

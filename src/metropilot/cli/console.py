"""What goes to the screen: tables, JSON, progress."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from metropilot.evaluate import Check

Item = TypeVar("Item")
NOTHING = "–"


def console() -> Console:
    """The output; 120 columns wide where it is not a terminal. Text is shown as it is, brackets included."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 120, highlight=False, markup=False, emoji=False)


def print_json(values: object) -> None:
    """One JSON document on the output."""
    from metropilot.evaluate import to_json

    sys.stdout.write(to_json(values) + "\n")


def table(
    title: str, columns: Sequence[str], rows: Iterable[Sequence[Any]], *, right: Iterable[int] = ()
) -> Table:
    """A table; the columns numbered in ``right`` are set flush right."""
    from rich import box
    from rich.table import Table

    made = Table(
        title=title or None, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False
    )
    flush = set(right)
    for index, name in enumerate(columns):
        made.add_column(name, justify="right" if index in flush else "left", overflow="fold")
    for row in rows:
        made.add_row(*(printable(cell) if isinstance(cell, str) else cell for cell in row))
    return made


def requirements(checks: Iterable[Check]) -> Table:
    """What was required, passed or failed."""
    rows = [(c.name, c.value, c.wanted, "✓" if c.passed else "✗ FAILED") for c in checks]
    return table("", ("requirement", "measured", "allowed", ""), rows, right=(1,))


def printable(text: str) -> str:
    """The text without what a terminal would obey or cannot show; line ends stay."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def heading(out: Console, title: str, lines: Iterable[str]) -> None:
    """A bold heading and its lines, indented; nothing where there are no lines."""
    from rich.padding import Padding

    lines = list(lines)
    if not lines:
        return
    out.print()
    out.print(title, style="bold")
    for line in lines:
        out.print(Padding(line, (0, 0, 0, 2)))


def citations(out: Console, title: str, source: Mapping[str, str]) -> None:
    """Where each block of data comes from."""
    heading(out, title, [f"{block}: {text}" for block, text in source.items()])


@contextmanager
def working(what: str) -> Iterator[None]:
    """Show on a terminal's error stream that something is going on."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


def progress(items: Sequence[Item], what: str) -> Iterator[Item]:
    """The items, one by one, with a progress bar on a terminal's error stream."""
    if not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import track

    yield from track(items, what, console=Console(stderr=True), transient=True)


def number(value: float | None, digits: int = 2, unit: str = "") -> str:
    """A number with its unit, or a dash where there is none."""
    if value is None:
        return NOTHING
    return f"{value:.{digits}f}" + (f" {unit}" if unit else "")

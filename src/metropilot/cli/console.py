"""Screen output: tables, JSON, progress."""

from __future__ import annotations

import os
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
USUAL_WIDTH = 120


def console() -> Console:
    """Console of the output at its width. Text is printed without markup, brackets included."""
    from rich.console import Console

    return Console(width=screen_width(), highlight=False, markup=False, emoji=False)


def screen_width() -> int | None:
    """Columns of the output: ``COLUMNS``, or 120 where it is not a terminal (None: ask the terminal)."""
    told = os.environ.get("COLUMNS", "")
    if told.isascii() and told.isdigit() and int(told) > 0:
        return int(told)
    return None if sys.stdout.isatty() else USUAL_WIDTH


def print_json(values: object) -> None:
    """Print one JSON document."""
    from metropilot._io import to_json

    sys.stdout.write(to_json(values) + "\n")


def table(
    title: str,
    columns: Sequence[str],
    rows: Iterable[Sequence[Any]],
    *,
    right: Iterable[int] = (),
    spare: Sequence[str] = (),
) -> Table:
    """Table that fits the output: lines break between words, never inside.

    Args:
        title: Title; empty: none.
        columns: Headings of the columns.
        rows: Cells, text or rich renderables.
        right: Indices of the right-aligned columns.
        spare: Headings of columns that may be left out on a narrow screen, in this order.
    """
    from rich import box
    from rich.table import Table

    shown = [[printable(cell) if isinstance(cell, str) else cell for cell in row] for row in rows]
    cells = [[name, *(row[k] for row in shown)] for k, name in enumerate(columns)]
    kept, widths, tight = _fit_columns(columns, cells, spare)
    made = Table(
        title=title or None,
        title_justify="left",
        title_style="bold",
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0) if tight else (0, 1),
        caption_justify="left",
    )
    left_out = [name for k, name in enumerate(columns) if k not in kept]
    if left_out:
        made.caption = f"left out at this width: {', '.join(left_out)}"
    flush = set(right)
    for k, width in zip(kept, widths, strict=True):
        made.add_column(columns[k], justify="right" if k in flush else "left", overflow="fold", width=width)
    for row in shown:
        made.add_row(*(row[k] for k in kept))
    return made


def _fit_columns(
    columns: Sequence[str], cells: Sequence[Sequence[Any]], spare: Sequence[str]
) -> tuple[list[int], list[int], bool]:
    """Columns that fit the output, their widths, and if the padding is reduced."""
    from rich.cells import cell_len

    room = console().width
    lines = [[line for cell in column for line in str(cell).split("\n")] for column in cells]
    full = [max(map(cell_len, column)) for column in lines]
    # A word that takes half of the output (a path) is folded after all.
    words = [
        min(max((cell_len(word) for line in column for word in line.split()), default=0), max(room // 2, 1))
        for column in lines
    ]
    kept, leave = list(range(len(columns))), [columns.index(name) for name in spare]
    while True:
        for tight, between in ((False, 3 * len(kept) - 1), (True, 2 * len(kept))):
            free = room - between - sum(words[k] for k in kept)
            if free >= 0 and (tight or sum(full[k] for k in kept) + between <= room or not leave):
                return kept, _widen(free, [words[k] for k in kept], [full[k] for k in kept]), tight
        if not leave:
            return kept, [words[k] for k in kept], True
        kept.remove(leave.pop(0))


def _widen(free: int, least: Sequence[int], full: Sequence[int]) -> list[int]:
    """Widen from the least to the full widths, always the narrowest column first."""
    widths = list(least)
    while free > 0 and (short := [k for k, width in enumerate(widths) if width < full[k]]):
        widths[min(short, key=lambda k: widths[k])] += 1
        free -= 1
    return widths


def requirements(checks: Iterable[Check]) -> Table:
    """Requirements with passed or failed."""
    rows = [(c.name, c.value, c.wanted, "✓" if c.passed else "✗ FAILED") for c in checks]
    return table("", ("requirement", "measured", "allowed", ""), rows, right=(1,))


def printable(text: str) -> str:
    """Remove terminal control sequences and characters that cannot be shown; keep line ends."""
    return "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)


def heading(out: Console, title: str, lines: Iterable[str]) -> None:
    """Print a bold heading and its lines, indented; nothing without lines."""
    from rich.padding import Padding

    lines = list(lines)
    if not lines:
        return
    out.print()
    out.print(title, style="bold")
    for line in lines:
        out.print(Padding(line, (0, 0, 0, 2)))


def citations(out: Console, source: Mapping[str, str]) -> None:
    """Sources of the blocks of data."""
    heading(out, "sources", [f"{block}: {text}" for block, text in source.items()])


@contextmanager
def show_activity(what: str) -> Iterator[None]:
    """Show an activity indicator on a terminal's error stream."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


def progress(items: Sequence[Item], what: str) -> Iterator[Item]:
    """Iterate over the items with a progress bar on a terminal's error stream."""
    if not sys.stderr.isatty():
        yield from items
        return
    from rich.console import Console
    from rich.progress import track

    yield from track(items, what, console=Console(stderr=True), transient=True)


def number(value: float | None, digits: int = 2, unit: str = "") -> str:
    """Format a number with its unit; None becomes a dash."""
    if value is None:
        return NOTHING
    return f"{value:.{digits}f}" + (f" {unit}" if unit else "")

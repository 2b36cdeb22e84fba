"""Trainsets an hour in convoys, headways of sections and stations: parts of the page on convoys.

python -m benchmarks.capacity --write docs/convoy.md
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.beside_optimum import table
from benchmarks.report import circumstances, write_section
from metropilot.convoy import Capacity, ServiceOptions, line_capacity, write_capacity
from metropilot.railway import load_line, load_trainset

LINE, TRAINSETS = "yizhuang", ("dkz32", "cheng2023")
PLATFORM_M = 260.0
"""Length of two `dkz32` with the gap between them."""
PICTURE = "dkz32"
LOAD, BLOCK_M = "AW2", 300.0
SERVICES = {
    "moving block, fresh": ServiceOptions(age_s=0.0),
    "train to train, 0.36 s": ServiceOptions(age_s=0.36),
    "CBTC, 2.4 s": ServiceOptions(),
    f"blocks of {BLOCK_M:g} m": ServiceOptions(block_m=BLOCK_M),
    "two blocks": ServiceOptions(blocks=2),
    "one block": ServiceOptions(blocks=1),
}
"""Services whose headways are compared place by place."""


def lines_of(name: str, rows: list[Capacity]) -> list[list[str]]:
    """One line for each platform and number of trainsets, both guards beside each other."""
    pairs: dict[tuple[float | None, int], dict[str, Capacity]] = {}
    for row in rows:
        pairs.setdefault((row.platform_m, row.count), {})[row.guard] = row
    lines = []
    for (platform_m, count), pair in pairs.items():
        block, independent = pair["moving_block"], pair["independent"]
        lines.append(
            [
                f"`{name}`",
                "its length" if platform_m is None else f"{platform_m:g} m",
                f"{count}",
                f"{block.convoy_m:.0f}",
                f"{block.stops_at_platform}",
                f"{block.journey_s / 60.0:.1f}",
                f"{block.trainsets_per_h:.0f} ({block.headway_s:.0f} s)",
                f"{independent.trainsets_per_h:.0f} ({independent.headway_s:.0f} s)",
                f"{block.plain_per_h:.0f}",
                block.bottleneck,
            ]
        )
    return lines


def measure(name: str) -> list[Capacity]:
    """Platforms as long as each convoy, then of ``PLATFORM_M``."""
    sections, trainset = load_line(LINE).sections(), load_trainset(name)
    services = (ServiceOptions(), ServiceOptions(platform_m=PLATFORM_M))
    return [row for each in services for row in line_capacity(sections, trainset, options=each)]


def measure_places() -> dict[str, Capacity]:
    """The last row, a moving or a fixed block, of single trainsets in each service."""
    sections, trainset = load_line(LINE).sections(), load_trainset(PICTURE, LOAD)
    return {
        name: line_capacity(sections, trainset, (1,), ("moving_block",), options)[-1]
        for name, options in SERVICES.items()
    }


def describe_places(found: dict[str, Capacity], about: str) -> str:
    """Headways of every station, and the longest of a section on the way."""
    columns = {
        name: {each.name: each.headway_s for each in row.blocking.places if each.kind == "station"}
        | {"on the way": max((p.headway_s for p in row.blocking.places if p.kind == "section"), default=0.0)}
        for name, row in found.items()
        if row.blocking is not None
    }
    places = list(next(iter(columns.values())))
    lines = [[place, *(f"{of[place]:.1f}" for of in columns.values())] for place in places]
    lines.append(["least headway", *(f"{row.headway_s:.1f}" for row in found.values())])
    written = (
        f"Written by `python -m benchmarks.capacity --write docs/convoy.md`: line `{LINE}` forward, "
        f"`{PICTURE}` {LOAD} alone, dwell 30 s, running time 5 % over the minimum; seconds; {about}."
    )
    return "\n".join([written, "", table(("place", *columns), lines)])


def main() -> None:
    """Compute everything; print the part of the page or write it with its picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    page = parser.parse_args().write
    found = {name: measure(name) for name in TRAINSETS}
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items())
    service = ServiceOptions()
    below = (
        f"dwell {service.dwell_s:g} s, running time {100 * service.reserve:g} % over the minimum, "
        f"messages {service.age_s:g} s old"
    )
    heads = ("trainset", "platform", "convoy", "length m", "stops at each", "journey min")
    heads = (*heads, "moving block, trainsets/h", "independent, trainsets/h", "plain line/h", "nearest")
    lines = [line for name, rows in found.items() for line in lines_of(name, rows)]
    written = (
        f"Written by `python -m benchmarks.capacity --write docs/convoy.md`: line `{LINE}` forward, every "
        f"stop, {below}, nothing random (no seed); {about}."
    )
    text = "\n".join([written, "", table(heads, lines, words=2)])
    write_section(page, "capacity", text)
    places = measure_places()
    write_section(page, "headway", describe_places(places, about))
    if page is None:
        return
    title = f"{LINE}, {PICTURE} {load_trainset(PICTURE).load}, trainsets an hour"
    blocks = f"{LINE}, {PICTURE} {LOAD}, blocks of at most {BLOCK_M:g} m"
    pictures = {
        "capacity": (found[PICTURE], title),
        "fixed_block": ([places[f"blocks of {BLOCK_M:g} m"]], blocks),
    }
    for name, (rows, headline) in pictures.items():
        with TemporaryDirectory() as scratch:
            write_capacity(Path(scratch), rows, headline, below)
            shutil.copy(Path(scratch) / f"{name}.png", page.parent / "images" / f"{name}.png")


if __name__ == "__main__":
    main()

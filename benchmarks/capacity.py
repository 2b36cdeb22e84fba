"""Trainsets an hour in convoys: the table and the picture of the page on convoys.

python -m benchmarks.capacity --write docs/convoy.md
"""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.beside_optimum import table
from benchmarks.report import circumstances, write_section
from metropilot.convoy import Capacity, ServiceOptions, line_capacity, write_capacity
from metropilot.railway import load_line, load_trainset

LINE, TRAINSETS = "yizhuang", ("dkz32", "cheng2023")
PLATFORM_M = 260.0
"""Length of two `dkz32` with the gap between them."""
PICTURE = "dkz32"


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


def main() -> None:
    """Compute everything; print the part of the page or write it with its picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    page = parser.parse_args().write
    found = {name: measure(name) for name in TRAINSETS}
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items())
    service = ServiceOptions()
    below = f"dwell {service.dwell_s:g} s, running time {100 * service.reserve:g} % over the minimum"
    heads = ("trainset", "platform", "convoy", "length m", "stops at each", "journey min")
    heads = (*heads, "moving block, trainsets/h", "independent, trainsets/h", "plain line/h", "nearest")
    lines = [line for name, rows in found.items() for line in lines_of(name, rows)]
    written = (
        f"Written by `python -m benchmarks.capacity --write docs/convoy.md`: line `{LINE}` forward, every "
        f"stop, {below}, nothing random (no seed); {about}."
    )
    text = "\n".join([written, "", table(heads, lines, words=2)])
    write_section(page, "capacity", text)
    if page is None:
        return
    folder = page.parent / "images"
    title = f"{LINE}, {PICTURE} {load_trainset(PICTURE).load}, trainsets an hour"
    write_capacity(folder, found[PICTURE], title, below)
    (folder / "capacity.json").unlink()
    (folder / "capacity.svg").unlink()


if __name__ == "__main__":
    main()

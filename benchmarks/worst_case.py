"""Protection's worst case: ``python -m benchmarks.worst_case --steps 1e8 --write docs/safety.md``.

CMA-ES varies commands, start, plant, wind, slip and errors of measurement in many places at once, and tries
to get a trainset over its limit, beyond the end of its authority, or into the trainset ahead; random search
gets as many attacks. Ends with 1, saying how to see it again, if either succeeds.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from tests.protection.convoy_search import Convoys
from tests.protection.hostile import bare, ideal, real
from tests.protection.optimiser import Worst
from tests.protection.search import STEPS as RUN_STEPS
from tests.protection.search import Field, places

from benchmarks.report import circumstances, replace_section
from metropilot.convoy import ATTACKED_HEADS
from metropilot.convoy import AttackCampaign as ConvoyCampaign

POPULATION = 32
MOST_PLACES = 24
Hunter = Callable[[int, int], tuple[Worst, Worst]]
"""Search so many places with a seed: what CMA-ES found, what random search found."""


@dataclass(frozen=True)
class Kind:
    """One kind of attack.

    Attributes:
        name: What is attacked.
        unit: Of the margin.
        share: Share of all steps it gets.
        run_steps: Supervised steps of one attack.
        generations: Generations of each search.
        hunter: Makes what searches.
    """

    name: str
    unit: str
    share: float
    run_steps: int
    generations: int
    hunter: Callable[[int], Hunter]


@dataclass(frozen=True)
class Result:
    """Result of a kind: smallest margins left (negative: violated), and the steps of CMA-ES."""

    kind: str
    unit: str
    places: int
    steps: int
    margin: float
    random_margin: float
    seconds: float


def on_line(build: Callable, authority: bool) -> Callable[[int], Hunter]:
    """Searches over sections and random profiles, without the service curve, on which no claim depends."""

    def ready(generations: int) -> Hunter:
        field = Field(build(mutate=bare))

        def search(count: int, seed: int) -> tuple[Worst, Worst]:
            where = places(build(mutate=bare, seed=seed), count, authority)
            found = field.search(where, POPULATION, generations, seed)
            return found, field.scatter(where, POPULATION, generations, seed + 1)

        return search

    return ready


def in_convoy(guard: str, count: int) -> Callable[[int], Hunter]:
    """Searches behind recorded heads that make an emergency brake."""

    def ready(generations: int) -> Hunter:
        convoys = Convoys(ConvoyCampaign(guard=guard, count=count))  # pyright: ignore[reportArgumentType]

        def search(places: int, seed: int) -> tuple[Worst, Worst]:
            rows = (np.arange(places) + seed) % ATTACKED_HEADS
            found = convoys.search(rows, POPULATION, generations, seed)
            return found, convoys.scatter(rows, POPULATION, generations, seed + 1)

        return search

    return ready


KINDS = (
    Kind("limit, ideal actuation", "m/s", 0.46, RUN_STEPS, 100, on_line(ideal, False)),
    Kind("end of authority, ideal actuation", "m", 0.46, RUN_STEPS, 100, on_line(ideal, True)),
    Kind("limit, widest bounds", "m/s", 0.015, RUN_STEPS, 100, on_line(real, False)),
    Kind("end of authority, widest bounds", "m", 0.015, RUN_STEPS, 100, on_line(real, True)),
    Kind("convoy of 2, `coupled`", "m", 0.025, 2 * 170, 100, in_convoy("coupled", 2)),
    Kind("convoy of 2, `independent`", "m", 0.025, 2 * 170, 100, in_convoy("independent", 2)),
)


def run(kind: Kind, steps: float, seed: int) -> Result:
    """One kind in rounds of new places, until it has had its share of the steps."""
    hunter, began = kind.hunter(kind.generations), time.monotonic()
    each = POPULATION * kind.generations * kind.run_steps
    left, done, margin, random_margin = max(round(kind.share * steps / each), 1), 0, np.inf, np.inf
    count = left
    while left > 0:
        now = min(left, MOST_PLACES)
        found, scattered = hunter(now, seed + done)
        margin = min(margin, -float(found.value.max()))
        random_margin = min(random_margin, -float(scattered.value.max()))
        worst = int(found.value.argmax())
        print(
            f"{kind.name}: places {done} to {done + now}, margin {margin:.4g} {kind.unit} at place "
            f"{done + worst} (seed {seed}), random search {random_margin:.4g}",
            flush=True,
        )
        left, done = left - now, done + now
    seconds = round(time.monotonic() - began)
    return Result(kind.name, kind.unit, count, count * each, margin, random_margin, seconds)


def table(results: list[Result], seed: int, about: dict[str, str]) -> str:
    """The table of the page."""
    heading = ("what is attacked", "places", "supervised steps", "margin left by random search", "by CMA-ES")
    lines = ["| " + " | ".join(heading) + " |", "|---|---:|---:|---:|---:|"]
    lines += [
        f"| {r.kind} | {r.places} | {r.steps:,} | {r.random_margin:.2g} {r.unit} | {r.margin:.2g} {r.unit} |"
        for r in results
    ]
    steps, seconds = sum(r.steps for r in results), sum(r.seconds for r in results)
    found = (
        f"{violations(results)} kinds of attack exceeded a bound"
        if violations(results)
        else "none exceeded a bound"
    )
    lines += [
        "",
        f"{steps:,} supervised steps by CMA-ES and as many by random search: {found}.",
        "",
        f"Seed {seed}, {seconds / 60:.0f} minutes; " + ", ".join(about.values()) + ".",
    ]
    return "\n".join(lines)


def violations(results: list[Result]) -> int:
    """Kinds in which an attack exceeded a bound; a gap of 0 is a contact, a margin of 0 none."""
    return sum(not min(r.margin, r.random_margin) >= 0.0 for r in results)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=float, default=1e7, help="supervised steps by the optimiser")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    parser.add_argument("--only", default="", help="kinds whose name holds this")
    options = parser.parse_args()
    about = circumstances(("jax", "cmaes"))
    results = [run(kind, options.steps, options.seed) for kind in KINDS if options.only in kind.name]
    text = table(results, options.seed, about)
    if options.write:
        options.write.write_text(replace_section(options.write.read_text(), "worst_case", text))
    print(text)
    print(json.dumps([asdict(result) for result in results]))
    raise SystemExit(1 if violations(results) else 0)


if __name__ == "__main__":
    main()

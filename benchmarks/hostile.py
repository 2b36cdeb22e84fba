"""A long hostile campaign against protection: ``python -m benchmarks.hostile --steps 1e8``.

Rounds of the campaign that the tests run for a million steps, each with new plants, restrictions, starts and
attacks, in turn with the widest bounds and ideal, each with and without the service curve. It stops at the
first speed above a limit and says how to see it again. ``benchmarks.worst_case`` looks for the worst instead.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import replace

from tests.protection.hostile import Campaign, bare, fight, ideal, real

STEPS = 2000
LANES = 40
KINDS: dict[str, Callable[..., Campaign]] = {
    "widest": real,
    "widest, no service curve": lambda **changes: real(mutate=bare, **changes),
    "ideal": ideal,
    "ideal, no service curve": lambda **changes: ideal(mutate=bare, **changes),
}


def campaign(steps: float, seed: int) -> dict[str, object]:
    """Fight until so many steps are done, or one was too fast."""
    total = {"steps": 0, "over_steps": 0, "interventions": 0, "emergencies": 0, "invalid": 0}
    worst, began, round_number = -float("inf"), time.monotonic(), 0
    while total["steps"] < steps and total["over_steps"] == 0:
        kind = list(KINDS)[round_number % len(KINDS)]
        fought = replace(KINDS[kind](seed=seed + round_number), steps=STEPS, lanes=LANES)
        tally = fight(fought)
        total = {name: total[name] + getattr(tally, name) for name in total}
        worst = max(worst, tally.over_mps)
        print(f"{total['steps']:.3e} steps, worst {worst:+.4f} m/s, {kind} seed {fought.seed}", flush=True)
        round_number += 1
    seconds = round(time.monotonic() - began)
    return {**total, "worst_over_mps": worst, "rounds": round_number, "seed": seed, "seconds": seconds}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=float, default=1e7)
    parser.add_argument("--seed", type=int, default=1000)
    options = parser.parse_args()
    result = campaign(options.steps, options.seed)
    print(json.dumps(result))
    raise SystemExit(1 if result["over_steps"] else 0)


if __name__ == "__main__":
    main()

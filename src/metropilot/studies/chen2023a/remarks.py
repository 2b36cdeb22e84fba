"""What a reader must know: what was found, in sentences made from the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from metropilot.studies.chen2023a.learners import NAMES
from metropilot.studies.chen2023a.measures import final
from metropilot.studies.chen2023a.published import CONVERGED_AT, PPO_EPISODES, THRESHOLD_S
from metropilot.studies.chen2023a.rows import convergences

if TYPE_CHECKING:
    from metropilot.studies.chen2023a.measures import Course

Courses = Mapping[str, Sequence["Course"]]


def remarks(learned: Courses, changed: Courses) -> list[str]:
    """Findings, every one with its numbers.

    Args:
        learned: The three learners' seeds.
        changed: The ablations' seeds; may be empty.
    """
    found = [_converged(name, mine) for name, mine in learned.items()]
    found.append(_lags(learned))
    found.append(_order(learned))
    if changed:
        found.append(_ablation(changed))
    return found


def _converged(name: str, mine: Sequence[Course]) -> str:
    """When one learner converged, next to the claim."""
    at = [a for a in convergences(mine, "learning") if a is not None]
    said = f"around episode {CONVERGED_AT[name]:,.0f}" if name in CONVERGED_AT else f"not by {PPO_EPISODES:,}"
    when = f"; median {np.median(at):,.0f} episodes" if at else ""
    times = [final(one.driving["running_time_s"]) for one in mine]
    return (
        f"{NAMES[name]}: {len(at)} of {len(mine)} seeds converged by the rule below{when} "
        f"(the paper: {said}). The policy itself runs {np.median(times):.1f} s at the end "
        f"({sum(t <= THRESHOLD_S for t in times)} of {len(mine)} within {THRESHOLD_S:g} s)."
    )


def _lags(learned: Courses) -> str:
    """Whether plain PPO lags behind the scaled one."""
    share = {
        name: np.mean([a is not None for a in convergences(learned[name], "learning")]) for name in learned
    }
    at = {
        name: np.median([np.inf if a is None else a for a in convergences(learned[name], "learning")])
        for name in learned
    }
    if share["ppo_scaled"] > share["ppo"] or at["ppo_scaled"] < 0.7 * at["ppo"]:
        return "Reward scaling helps here, as the paper says: plain PPO converges later or on fewer seeds."
    return "The paper's claim that plain PPO lags does not show here once both are tuned with equal care."


def _order(learned: Courses) -> str:
    """The order in energy of the policies."""
    energy = {n: float(np.median([final(o.driving["energy_kwh"]) for o in m])) for n, m in learned.items()}
    order = sorted(energy, key=lambda name: -energy[name])
    words = ", ".join(f"{NAMES[name]} {energy[name]:.1f} kWh" for name in order)
    return (
        f"Energy of the policies themselves, most first: {words}. The paper has DDPG far above PPO with "
        "reward scaling, and plain PPO lowest because it is late."
    )


def _ablation(changed: Courses) -> str:
    """What scaling changes by what else is switched on."""
    parts = []
    for name in changed:
        if name.endswith(", plain"):
            what = name.removesuffix(", plain")
            plain, scaled = (
                np.median([final(o.driving["return"]) for o in changed[f"{what}, {kind}"]])
                for kind in ("plain", "scaled")
            )
            parts.append(f"{what}: {plain:.0f} plain, {scaled:.0f} scaled")
    return (
        "What scaling can change: dividing the rewards by one number leaves normalised advantages as they "
        "are, so it reaches the actor only through the critic, whose error it makes of size one, and through "
        "the common bound on the gradient. Final return of the policy with one thing changed at a time: "
        f"{'; '.join(parts)}."
    )

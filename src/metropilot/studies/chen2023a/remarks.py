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
    from metropilot.studies.chen2023a.measures import DriveCourse

Courses = Mapping[str, Sequence["DriveCourse"]]
KINDS = ("learning", "driving")
"""Episodes with exploration, and drives without."""


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


def _converged(name: str, mine: Sequence[DriveCourse]) -> str:
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
    """Whether plain PPO lags behind the scaled one: how many converge, and where the policies end."""
    share, late = {}, {}
    for name in ("ppo", "ppo_scaled"):
        mine = learned[name]
        share[name] = [float(np.mean([at is not None for at in convergences(mine, kind)])) for kind in KINDS]
        late[name] = float(np.median([final(one.driving["running_time_s"]) for one in mine]))
    numbers = ", ".join(
        f"{NAMES[name]} converges on {100 * share[name][0]:.0f} % of the seeds with exploration and on "
        f"{100 * share[name][1]:.0f} % without, and its median policy ends at {late[name]:.1f} s"
        for name in share
    )
    best = [
        f"{sum(float(np.max(one.driving['return'])) > 0.0 for one in learned[name])} of {len(learned[name])} "
        f"({NAMES[name]})"
        for name in share
    ]
    ahead = share["ppo_scaled"] >= share["ppo"] and late["ppo"] > THRESHOLD_S >= late["ppo_scaled"]
    word = "lags, as the paper says" if ahead else "does not clearly lag, other than the paper says"
    return (
        f"Plain PPO {word}: {numbers}. What the least energy asks for is to arrive just within "
        f"{THRESHOLD_S:g} s; a policy that learns to save steps over that edge now and then, and its return "
        f"falls by nearly 200 at once. Policies that kept it at their best evaluation: {', '.join(best)}."
    )


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

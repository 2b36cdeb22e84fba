"""Learning curves of every seed, and their numbers beside the paper's statements about figures 5 to 19."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray

from metropilot._typing import Array, Float
from metropilot.env import episode_of, starts
from metropilot.studies.chen2023a import setting
from metropilot.studies.learning import SeedResult, drive_to_end
from metropilot.studies.report import ReportRow, make_row
from metropilot.units import J_PER_KWH

if TYPE_CHECKING:
    from metropilot.planning import Optima

Values = Float[ndarray, " chunks"]

CONSTANT, CONSTANTS = "constant command", 96
"""Driver without learning, and the number of commands from 0.05 to 1 that are tried."""
COAST, COAST_COMMANDS, COAST_PLACES = "command, then coasting", 13, 221
"""Driver without learning; commands from 0.4 to 1 and places from 50 to 600 m that are tried."""
CLOSE = 0.1
"""A return is near the final one when it differs by at most this share of it."""
KEPT = 0.95
"""Share of the later chunks in which the rule must hold; the paper, too, tolerates single jumps."""
LAST = 0.1
"""Final values are medians over this last share of the chunks."""


@dataclass(frozen=True, eq=False)
class DriveCourse:
    """Measures of one learning run, one value per chunk between evaluations.

    Attributes:
        episodes: Number of episodes ended so far.
        loss: Mean loss, as the learner minimises it.
        learning: Means over the episodes, with exploration, that ended in the chunk: ``return``,
            ``running_time_s`` (episodes that never arrive count with the time until they were stopped),
            ``energy_kwh``, ``impact_mps3``. NaN where no episode ended.
        driving: The same for the policy's run from standstill without exploration, and
            ``stopping_error_m``, ``arrived``.
    """

    episodes: Values
    loss: Values
    learning: Mapping[str, Values]
    driving: Mapping[str, Values]


def course(result: SeedResult) -> DriveCourse:
    """Extract the measures of one run from its history."""
    history = result.history
    seconds = history["length"] * setting.DECISION_S
    learning = {
        "return": history["return"],
        "running_time_s": seconds,
        "energy_kwh": -history["term.energy"],
        "impact_mps3": -history["term.comfort"] / setting.COMFORT / seconds,
    }
    names = ("running_time_s", "energy_kwh", "impact_mps3", "stopping_error_m", "arrived")
    driving = {name: history[f"evaluation.{name}"] for name in names}
    driving["return"] = history["evaluation.score"]
    return DriveCourse(np.cumsum(history["episodes"]), history["loss"], learning, driving)


def find_convergence(episodes: Values, running_time_s: Values, returned: Values) -> float | None:
    """Episodes after which a run has converged; None: never.

    Converged: from then on, in 95 % of the chunks, the running time is at most 88 s and the return within
    10 % of the final one (median of the last tenth).

    Args:
        episodes: Number of episodes ended so far.
        running_time_s: Running time in each chunk; NaN meets no bound.
        returned: Return of each chunk.
    """
    final = float(np.nanmedian(returned[-last_chunks(len(returned)) :]))
    good = (running_time_s <= setting.THRESHOLD_S) & (np.abs(returned - final) <= CLOSE * abs(final))
    later = np.cumsum(good[::-1])[::-1] / np.arange(len(good), 0, -1)
    holds = good & (later >= KEPT)
    if not good[-last_chunks(len(good)) :].mean() >= KEPT or not holds.any():
        return None
    return float(episodes[int(np.argmax(holds))])


def last_chunks(chunks: int) -> int:
    """Number of chunks in the last tenth."""
    return max(1, round(LAST * chunks))


def final(values: Values) -> float:
    """Median over the last tenth of the chunks."""
    return float(np.nanmedian(values[-last_chunks(len(values)) :]))


def band(
    courses: Sequence[DriveCourse], values: Sequence[Values], grid: ndarray
) -> tuple[ndarray, ndarray, ndarray]:
    """Smallest, median and largest over the seeds on a common grid of episodes.

    Args:
        courses: One course per seed.
        values: One measure per seed.
        grid: Numbers of episodes. Shape (G,).
    """
    rows = []
    for one, measure in zip(courses, values, strict=True):
        there = np.isfinite(measure)
        rows.append(np.interp(grid, one.episodes[there], measure[there]) if there.any() else grid * np.nan)
    stacked = np.stack(rows)
    return np.nanmin(stacked, axis=0), np.nanmedian(stacked, axis=0), np.nanmax(stacked, axis=0)


Courses = Mapping[str, Sequence[DriveCourse]]
Bound = Callable[[float], "float | None"]
AFTER = 4000.0
"""The paper judges the running time from this episode on."""
SHARE, EPISODES_KPI = "share of seeds converged", "episodes to converge (of those that did)"
MOST_ENERGY, HIGHEST_IMPACT = "place in energy, 1 is most", "place in impact rate, 1 is highest"
ABOVE = "above the optimum in the same running time"
LEARNING, DRIVING = "episodes with exploration", "the policy itself"
KINDS = ((LEARNING, "learning"), (DRIVING, "driving"))
REWARD, LOSS, TIME = "Figures 5 to 7: reward", "Figures 8 to 10: loss", "Figures 11 to 13: running time"
ENERGY, IMPACT = "Figures 14 to 16: energy at the wheel", "Figures 17 to 19: mean impact rate"
ORDER, STOP = "The order of the three", "Stopping error (the paper gives none)"


@dataclass(frozen=True, eq=False)
class LeastEnergy:
    """Certified least energy at a running time, kWh; None outside the computed front."""

    optima: Optima

    def __call__(self, time_s: float) -> float | None:
        """Look up the least energy at one running time."""
        found = float(self.optima.at(np.zeros(1, int), np.array([time_s]))[0]) / J_PER_KWH
        return found if np.isfinite(found) else None


def paper_rows(courses: Courses, least: Bound) -> list[ReportRow]:
    """Rows that answer the figures of the paper.

    Args:
        courses: One course per seed, by learner.
        least: Certified least energy at a running time.
    """
    rows = [*reward_rows(courses), *loss_rows(courses), *time_rows(courses), *energy_rows(courses, least)]
    return [*rows, *impact_rows(courses), *order_rows(courses), *stop_rows(courses)]


def reward_rows(courses: Courses) -> Iterator[ReportRow]:
    """Convergence of each learner: share of seeds, episodes, final return."""
    for case, kind in KINDS:
        for name, mine in courses.items():
            at = find_convergences(mine, kind)
            said = setting.CONVERGED[name] if case == LEARNING else None
            share = float(np.mean([a is not None for a in at]))
            yield make_row(REWARD, case, name, SHARE, "", [share], said)
            when = setting.CONVERGED_AT.get(name) if case == LEARNING else None
            row = ReportRow(REWARD, case, name, EPISODES_KPI, "episodes", when)
            yield row.with_values(there) if (there := [a for a in at if a is not None]) else row
            returns = [final(getattr(one, kind)["return"]) for one in mine]
            yield make_row(REWARD, case, name, "final return", "", returns)


def rule_rows(least: Bound) -> Iterator[ReportRow]:
    """Rows of the simplest drivers of the task, tuned on it and with the same assists.

    A constant command, and a constant command up to a place from which the trainset coasts.

    Args:
        least: Certified least energy at a running time.
    """
    import jax
    import jax.numpy as jnp

    task = setting.make_assisted()
    begin = task.begin(jax.tree.map(lambda x: x[0], starts([0], [setting.PRESCRIBED_S])))
    decisions, key = setting.longest_decisions(task), jax.random.key(0)

    def run(rule: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        command, place_km = rule

        def decide(observation: Array, _: Array) -> Array:
            asked = setting.ACTION.coast + (setting.ACTION.full - setting.ACTION.coast) * command
            return jnp.where(observation[0] < place_km, asked, 0.0)[None]

        state, returned = drive_to_end(task, decide, begin, key, decisions)
        end = episode_of(task, state)
        return returned, end.running_time_s, end.wheel_j / J_PER_KWH

    commands, ever = jnp.linspace(0.05, 1.0, CONSTANTS), jnp.full(CONSTANTS, jnp.inf)
    grid = [
        jnp.ravel(x)
        for x in jnp.meshgrid(jnp.linspace(0.4, 1.0, COAST_COMMANDS), jnp.linspace(0.05, 0.6, COAST_PLACES))
    ]
    search = jax.jit(partial(jax.lax.map, run, batch_size=CONSTANTS))
    for name, rules in ((CONSTANT, (commands, ever)), (COAST, tuple(grid))):
        returned, times, energies = search(rules)
        best = int(jnp.argmax(returned))
        time_s, energy_kwh = float(times[best]), float(energies[best])
        yield ReportRow(REWARD, DRIVING, name, "final return", "", ours=float(returned[best]))
        yield ReportRow(REWARD, DRIVING, name, "command", "", ours=float(rules[0][best]))
        if name == COAST:
            yield ReportRow(REWARD, DRIVING, name, "coasts from", "m", ours=1000.0 * float(rules[1][best]))
        yield ReportRow(TIME, DRIVING, name, "final running time", "s", ours=time_s)
        yield ReportRow(ENERGY, DRIVING, name, "final energy", "kWh", ours=energy_kwh, optimum=least(time_s))
        if bound := least(time_s):
            yield ReportRow(ENERGY, DRIVING, name, ABOVE, "%", ours=100.0 * (energy_kwh / bound - 1.0))


def find_convergences(mine: Sequence[DriveCourse], kind: str) -> list[float | None]:
    """Number of episodes to convergence for each seed; None: not converged."""
    parts = [(one.episodes, getattr(one, kind)) for one in mine]
    return [find_convergence(episodes, part["running_time_s"], part["return"]) for episodes, part in parts]


def loss_rows(courses: Courses) -> Iterator[ReportRow]:
    """Size of the loss at the beginning and at the end of learning."""
    for name, mine in courses.items():
        tenths = [max(1, one.loss.size // 10) for one in mine]
        first = [one.loss[:count] for one, count in zip(mine, tenths, strict=True)]
        last = [one.loss[-count:] for one, count in zip(mine, tenths, strict=True)]
        for case, losses in (("first", first), ("last", last)):
            sizes = [float(np.nanmedian(np.abs(loss))) for loss in losses]
            yield make_row(LOSS, f"{case} tenth of the learning", name, "median size of the loss", "", sizes)


def time_rows(courses: Courses) -> Iterator[ReportRow]:
    """Final running time, and the share of later chunks within 88 s."""
    for case, kind in KINDS:
        for name, mine in courses.items():
            times = [final(getattr(one, kind)["running_time_s"]) for one in mine]
            yield make_row(TIME, case, name, "final running time", "s", times)
            # of shorter runs their second half
            after = min(AFTER, *(0.5 * float(one.episodes[-1]) for one in mine))
            late = [one.episodes > after for one in mine]
            later = [getattr(one, kind)["running_time_s"][k] for one, k in zip(mine, late, strict=True)]
            shares = [float(np.mean(times <= setting.THRESHOLD_S)) for times in later]
            words = f"share of chunks after {after:.0f} episodes within {setting.THRESHOLD_S:g} s"
            yield make_row(TIME, case, name, words, "", shares)


def arriving(courses: Sequence[DriveCourse]) -> list[DriveCourse]:
    """Those whose policy arrives at the end: the others save energy by standing still."""
    return [one for one in courses if final(one.driving["arrived"]) > 0.5]


def energy_rows(courses: Courses, least: Bound) -> Iterator[ReportRow]:
    """Final energy of the policy beside the certified optimum in the same running time."""
    for name, mine in courses.items():
        arrived = arriving(mine)
        used = [final(one.driving["energy_kwh"]) for one in arrived]
        known = [b for one in arrived if (b := least(final(one.driving["running_time_s"]))) is not None]
        optimum = float(np.median(known)) if known else None
        row = ReportRow(ENERGY, DRIVING, name, "final energy", "kWh", optimum=optimum)
        yield row.with_values(used) if used else row
        row, gaps = ReportRow(ENERGY, DRIVING, name, ABOVE, "%"), find_gaps(mine, least)
        yield row.with_values(gaps) if gaps else row
    for name, mine in courses.items():
        used = [final(one.learning["energy_kwh"]) for one in mine]
        yield make_row(ENERGY, LEARNING, name, "final energy", "kWh", used)


def impact_rows(courses: Courses) -> Iterator[ReportRow]:
    """Final mean impact rate."""
    for case, kind in KINDS:
        for name, mine in courses.items():
            values = [final(getattr(one, kind)["impact_mps3"]) for one in mine]
            yield make_row(IMPACT, case, name, "final mean impact rate", "m/s³", values)


def order_rows(courses: Courses) -> Iterator[ReportRow]:
    """Place of each learner's median: 1 uses most energy, or has the highest impact rate."""
    for kpi, order in (("energy_kwh", setting.ENERGY_ORDER), ("impact_mps3", setting.IMPACT_ORDER)):
        for case, kind in KINDS:
            size = {
                name: float(np.median([final(getattr(one, kind)[kpi]) for one in mine]))
                for name, mine in courses.items()
            }
            ours = sorted(size, key=lambda name: -size[name])
            words = MOST_ENERGY if kpi == "energy_kwh" else HIGHEST_IMPACT
            for name in courses:
                said = order.index(name) + 1.0 if case == LEARNING and name in order else None
                yield make_row(ORDER, case, name, words, "", [ours.index(name) + 1.0], said)


def stop_rows(courses: Courses) -> Iterator[ReportRow]:
    """Final stopping error."""
    for name, mine in courses.items():
        errors = [final(one.driving["stopping_error_m"]) for one in mine]
        yield make_row(STOP, DRIVING, name, "final stopping error", "m", errors)


def outcome_rows(table: str, courses: Courses, least: Bound) -> Iterator[ReportRow]:
    """Convergence, final return, running time and energy of learners or variants beyond the paper."""
    for case, mine in courses.items():
        driver = next((name for name in ("ddpg", "td3") if name in case), "ppo")
        driver = "ppo_scaled" if "scaled" in case else driver
        at = find_convergences(mine, "learning")
        row = partial(make_row, table, case, driver)
        yield row(SHARE, "", [float(np.mean([a is not None for a in at]))])
        yield row("final return of the policy itself", "", [final(one.driving["return"]) for one in mine])
        yield row("final running time", "s", [final(one.driving["running_time_s"]) for one in mine])
        if gaps := find_gaps(mine, least):
            yield row(ABOVE, "%", gaps)


def find_gaps(mine: Sequence[DriveCourse], least: Bound) -> list[float]:
    """Energy of the final policies that arrive above the optimum in their running time, %."""
    arrived = arriving(mine)
    used = [final(one.driving["energy_kwh"]) for one in arrived]
    best = [least(final(one.driving["running_time_s"])) for one in arrived]
    return [100.0 * (e / b - 1.0) for e, b in zip(used, best, strict=True) if b is not None]

"""Compared controllers and their rows: tables 1, 3 and 4, margins, other references."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from metropilot.control import CHENG2023_GAINS, Errors, Gains, incremental_pid
from metropilot.studies.cheng2023 import neural_pid, residual
from metropilot.studies.cheng2023.fuzzy_pid import ASSUMED_UNIVERSES, Universes, step_fuzzy_pid
from metropilot.studies.cheng2023.law import PAPER_LAW, TrackingLaw
from metropilot.studies.cheng2023.setting import KPIS, NAMES, TABLE_1, optimal_kwh
from metropilot.studies.cheng2023.tracking import TrackingController, TrackingKpis
from metropilot.studies.report import ReportRow, make_row

Start = tuple[TrackingController, Any]
"""A controller and its memory at the start."""
NO_ERRORS = Errors(0.0, 0.0)
POSITION_PID = "pid with position, tuned"
"""The strongest simple rival: constant gains on speed and position error, tuned by the same search."""
TUNED_POSITION_PID: Mapping[str, float] = MappingProxyType(
    {"kp": 4.93636, "ki": 1.41958, "kd": 1.35521, "position_per_s": 6.67608}
)
"""Result of the search over 1,200 runs with seed 0 (:func:`.tuning.tune_driver`)."""
FED_PID = "pid with position and feed-forward, tuned"
"""The same beside the command that the reference takes of the nominal plant."""
TUNED_FED_PID: Mapping[str, float] = MappingProxyType(
    {"kp": 3.25418, "ki": 1.49557, "kd": 0.76323, "position_per_s": 1.32424}
)
"""Result of the same search at 1.5 times the resistance: at the nominal one nothing is left to correct."""
RESIDUAL = "ddpg_pid, residual"
"""DDPG that corrects that PID."""
LEARNED = ("ddpg_pid", RESIDUAL)


@dataclass(frozen=True)
class ComparedController:
    """One controller of the comparison.

    Attributes:
        driver: Id of the driver, followed by ``tuned`` if its parameters come from the search.
        published: Driver of the published numbers beside it; empty: none.
        of_seed: Maps a seed to the controller.
    """

    driver: str
    published: str
    of_seed: Callable[[int], Start]


def pid_control(gains: Gains) -> Start:
    """PID with fixed gains."""
    return lambda memory, seen: incremental_pid(seen.command, gains, seen.error_mps, memory), NO_ERRORS


def position_pid_control(gains: Gains, position_per_s: Any) -> Start:  # noqa: ANN401 (arrays)
    """PID with fixed gains on the speed error plus the position error at a rate.

    Args:
        gains: Gains.
        position_per_s: Speed error that a metre of position error counts as, 1/s.
    """

    def control(memory: Errors, seen: Any) -> tuple[Any, Errors]:  # noqa: ANN401 (arrays)
        error = seen.error_mps + position_per_s * seen.distance_m
        return incremental_pid(seen.command, gains, error, memory)

    return control, NO_ERRORS


def fed_pid_control(placed: residual.PlacedGains) -> Start:
    """PID with fixed gains on speed and position error, beside feed-forward."""
    return lambda memory, seen: residual.step_fed_pid(placed, seen, memory), NO_ERRORS


def fuzzy_control(gains: Gains, universes: Universes) -> Start:
    """PID with gains changed by fuzzy rules."""

    def control(memory: Errors, seen: Any) -> tuple[Any, Errors]:  # noqa: ANN401 (arrays)
        return step_fuzzy_pid(seen.command, seen.error_mps, memory, universes, gains)

    return control, NO_ERRORS


def neural_control(gains: Gains, rates: neural_pid.LearningRates, seed: int) -> Start:
    """PID with gains from a network that learns online."""
    return partial(neural_pid.step_neural_pid, rates=rates), neural_pid.fresh_network(seed, gains)


def policy_control(law: TrackingLaw, policy: Callable[[Any], Any]) -> Start:
    """A law whose parameters a policy sets."""
    return lambda memory, seen: law.drive(policy, seen, memory), NO_ERRORS


def controllers_to_compare(
    tuned: Mapping[str, Mapping[str, float]],
    policies: Mapping[int, Callable[[Any], Any]],
    corrections: Mapping[int, Callable[[Any], Any]],
) -> tuple[ComparedController, ...]:
    """Controllers of the comparison.

    Args:
        tuned: Parameters found by the search, by driver and name.
        policies: One policy per seed that sets gains.
        corrections: One per seed that corrects the PID beside feed-forward that they were learned with.
    """
    corrected = residual.residual_law(residual.placed_gains(TUNED_FED_PID))
    by_hand, p, f, n = CHENG2023_GAINS, tuned["pid"], tuned["fuzzy_pid"], tuned["neural_pid"]
    placed = tuned[POSITION_PID]
    universes = Universes(f["error_mps"], f["change_mps"], f["kp_span"], f["ki_span"], f["kd_span"])
    rates = neural_pid.LearningRates(n["learning_rate"], n["momentum"], n["error_mps"])
    of_position = position_pid_control(_gains(placed), placed["position_per_s"])
    return (
        ComparedController("pid", "pid", lambda _: pid_control(by_hand)),
        ComparedController("pid tuned", "", lambda _: pid_control(_gains(p))),
        ComparedController(POSITION_PID, "", lambda _: of_position),
        ComparedController(FED_PID, "", lambda _: fed_pid_control(residual.placed_gains(tuned[FED_PID]))),
        ComparedController("fuzzy_pid", "fuzzy_pid", lambda _: fuzzy_control(by_hand, ASSUMED_UNIVERSES)),
        ComparedController("fuzzy_pid tuned", "", lambda _: fuzzy_control(_gains(f), universes)),
        ComparedController(
            "neural_pid", "neural_pid", partial(neural_control, by_hand, neural_pid.TEXTBOOK_RATES)
        ),
        ComparedController("neural_pid tuned", "", partial(neural_control, _gains(n), rates)),
        ComparedController("ddpg_pid", "ddpg_pid", lambda seed: policy_control(PAPER_LAW, policies[seed])),
        ComparedController(RESIDUAL, "ddpg_pid", lambda seed: policy_control(corrected, corrections[seed])),
    )


def _gains(values: Mapping[str, float]) -> Gains:
    return Gains(values["kp"], values["ki"], values["kd"])


Measured = Mapping[tuple[str, int], Sequence[TrackingKpis]]
"""KPIs of each driver in each scenario, one entry per seed."""


def values(found: Iterable[TrackingKpis], field: str) -> list[float]:
    """One KPI of every seed."""
    return [float(getattr(kpis, field)) for kpis in found]


def median(found: Iterable[TrackingKpis], field: str) -> float:
    """The median of one KPI over the seeds."""
    return float(np.median(values(found, field)))


def optimum(field: str, scenario: int) -> float | None:
    """Best possible value of a KPI; known for the energy only."""
    return optimal_kwh(scenario) if field == "energy_kwh" else None


def table_1(measured: Measured, published: Mapping[str, str]) -> list[ReportRow]:
    """Rows of table 1: every driver in the base scenario."""
    rows = []
    for driver, whose in published.items():
        numbers = TABLE_1.get(whose, (None,) * len(KPIS))
        for (field, words, unit), number in zip(KPIS, numbers, strict=True):
            place, each = ("Table 1", NAMES[1], driver), values(measured[driver, 1], field)
            rows.append(make_row(*place, words, unit, each, number, optimum(field, 1)))
    return rows


def other_scenarios(
    table: str, published: Mapping[int, Sequence[float]], measured: Measured, *, average: bool = False
) -> list[ReportRow]:
    """Rows of tables 3 and 4: DDPG-PID and the tuned PIDs in other scenarios, without new learning.

    Args:
        table: Name of the table.
        published: Numbers of DDPG-PID by scenario.
        measured: KPIs.
        average: Averages over the run instead of totals, as in table 4.
    """
    rows = []
    for scenario, numbers in published.items():
        for driver in ("ddpg_pid", RESIDUAL, "pid tuned", POSITION_PID, FED_PID):
            found = measured[driver, scenario]
            for (field, words, unit), number in zip(KPIS, numbers, strict=True):
                each = values(found, field)
                if average:
                    words = words.replace("total", "average")  # noqa: PLW2901
                    if field.endswith(("total_mps", "total_m")):
                        each = [v / float(k.periods) for v, k in zip(each, found, strict=True)]
                said, best = number if driver in LEARNED else None, optimum(field, scenario)
                rows.append(make_row(table, NAMES[scenario], driver, words, unit, each, said, best))
    return rows


def margins(measured: Measured) -> list[ReportRow]:
    """Rows of the margins of DDPG-PID: reduction of total speed and position error, percent."""
    rows = []
    published = {
        ("speed_total_mps", "pid"): 85.5,
        ("speed_total_mps", "fuzzy_pid"): 49.5,
        ("speed_total_mps", "neural_pid"): 44.5,
        ("position_total_m", "pid"): 78.9,
        ("position_total_m", "fuzzy_pid"): 41.0,
        ("position_total_m", "neural_pid"): 38.5,
    }
    ours = measured["ddpg_pid", 1]
    others = dict.fromkeys(driver for driver, scenario in measured if scenario == 1 and driver != "ddpg_pid")
    for field, words in (
        ("speed_total_mps", "total speed error"),
        ("position_total_m", "total position error"),
    ):
        for other in others:
            against = median(measured[other, 1], field)
            less = [100.0 * (1.0 - value / against) for value in values(ours, field)]
            place, said = ("Margins of ddpg_pid", NAMES[1], other), published.get((field, other))
            rows.append(make_row(*place, f"less {words} than this driver", "%", less, said))
    return rows

"""The controllers that are compared, as the tracking loop takes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from metropilot.control.incremental_pid import CHENG2023_GAINS, Errors, Gains, incremental_pid
from metropilot.drivers.ddpg_pid import ddpg_pid
from metropilot.drivers.fuzzy_pid import ASSUMED, Universes, fuzzy_pid
from metropilot.drivers.neural_pid import TEXTBOOK, LearningRates, fresh_network, neural_pid
from metropilot.evaluate.tracking import Control

Start = tuple[Control, Any]
"""A controller and its memory at the start."""
NO_ERRORS = Errors(0.0, 0.0)


@dataclass(frozen=True)
class Contestant:
    """One controller of the comparison.

    Attributes:
        driver: Id of the driver, with ``tuned`` behind it where its parameters were searched for.
        published: Whose published numbers stand beside it; empty for nobody's.
        of_seed: The controller for a seed.
    """

    driver: str
    published: str
    of_seed: Callable[[int], Start]


def pid(gains: Gains) -> Start:
    """Fixed gains."""

    def control(memory: Errors, seen: Any) -> tuple[Any, Errors]:  # noqa: ANN401 (arrays)
        return incremental_pid(seen.command, gains, seen.error_mps, memory)

    return control, NO_ERRORS


def fuzzy(gains: Gains, universes: Universes) -> Start:
    """Gains moved by rules."""

    def control(memory: Errors, seen: Any) -> tuple[Any, Errors]:  # noqa: ANN401 (arrays)
        return fuzzy_pid(seen.command, seen.error_mps, memory, universes, gains)

    return control, NO_ERRORS


def neural(gains: Gains, rates: LearningRates, seed: int) -> Start:
    """Gains from a network that learns online."""

    def control(memory: Any, seen: Any) -> tuple[Any, Any]:  # noqa: ANN401 (arrays)
        return neural_pid(memory, seen, rates)

    return control, fresh_network(seed, gains)


def learned(policy: Callable[[Any], Any]) -> Start:
    """Gains from a policy."""

    def control(memory: Errors, seen: Any) -> tuple[Any, Errors]:  # noqa: ANN401 (arrays)
        return ddpg_pid(policy, seen, memory)

    return control, NO_ERRORS


def contestants(
    tuned: Mapping[str, Mapping[str, float]], policies: Mapping[int, Callable[[Any], Any]]
) -> tuple[Contestant, ...]:
    """Everybody who is compared.

    Args:
        tuned: What the search found, by driver and parameter.
        policies: One a seed.
    """
    by_hand, p, f, n = CHENG2023_GAINS, tuned["pid"], tuned["fuzzy_pid"], tuned["neural_pid"]
    universes = Universes(f["error_mps"], f["change_mps"], f["kp_span"], f["ki_span"], f["kd_span"])
    rates = LearningRates(n["learning_rate"], n["momentum"], n["error_mps"])
    return (
        Contestant("pid", "pid", lambda seed: pid(by_hand)),  # noqa: ARG005 (nothing random)
        Contestant("pid tuned", "", lambda seed: pid(_gains(p))),  # noqa: ARG005 (nothing random)
        Contestant("fuzzy_pid", "fuzzy_pid", lambda seed: fuzzy(by_hand, ASSUMED)),  # noqa: ARG005
        Contestant("fuzzy_pid tuned", "", lambda seed: fuzzy(_gains(f), universes)),  # noqa: ARG005
        Contestant("neural_pid", "neural_pid", lambda seed: neural(by_hand, TEXTBOOK, seed)),
        Contestant("neural_pid tuned", "", lambda seed: neural(_gains(n), rates, seed)),
        Contestant("ddpg_pid", "ddpg_pid", lambda seed: learned(policies[seed])),
    )


def _gains(values: Mapping[str, float]) -> Gains:
    return Gains(values["kp"], values["ki"], values["kd"])

"""What protection is told to expect of the plant in a run."""

from __future__ import annotations

from dataclasses import replace

from metropilot.protection import Bounds
from metropilot.task.run import NOISE_CUT, Run

MASS = (0.9, 1.1)
"""Scatter of the mass about the load aboard, which the trainset weighs; a scenario beyond it widens it."""


def declared_bounds(run: Run) -> Bounds:
    """Protection's bounds in a run: its usual scatter, widened where the scenario goes further.

    Drivers that keep clear of interventions and the host that supervises them read the same bounds here.
    """
    scenario = run.scenario
    bounds = Bounds.of(
        scenario.believed(run.trainset),
        run.dt,
        extra_delay_s=scenario.extra_delay_s,
        extra_lag_s=scenario.extra_lag_s,
        speed_error_mps=NOISE_CUT * scenario.speed_noise_mps,
    )
    return replace(
        bounds,
        mass=_holding(MASS, scenario.mass_factor),
        resistance=_holding(bounds.resistance, scenario.resistance_factor),
    )


def _holding(interval: tuple[float, float], value: float) -> tuple[float, float]:
    return min(interval[0], value), max(interval[1], value)

"""Bounds on the plant that are declared to protection for a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metropilot.physics import brake_available_n, vehicle_arrays
from metropilot.protection import Bounds
from metropilot.railway import Trainset
from metropilot.sim.disturbance import NOISE_CUT
from metropilot.sim.run import Run

MASS_SCATTER = (0.9, 1.1)
"""Scatter of the mass about the load aboard, which the trainset weighs; a larger disturbance widens it."""


def declared_bounds(run: Run) -> Bounds:
    """Protection's bounds in a run: its usual scatter, widened where the disturbance exceeds it.

    Drivers that avoid interventions and the host loop that supervises them use the same bounds.
    """
    if run.bounds is not None:
        return run.bounds
    disturbance = run.disturbance
    bounds = Bounds.of(
        disturbance.nominal(run.trainset),
        run.dt,
        extra_delay_s=disturbance.delay_s,
        extra_lag_s=disturbance.lag_s,
        speed_error_mps=NOISE_CUT * disturbance.speed_noise_mps,
    )
    resistance = _widen(bounds.resistance, disturbance.resistance_factor)
    if disturbance.headwind_mps != 0.0:
        resistance = _widen(resistance, *_resistance_ratios(run))
    share = bounds.service_share
    if np.isfinite(disturbance.adhesion) or disturbance.brake_factor < 1.0:
        share = min(share, _braking_share(run))
    return replace(
        bounds, mass=_widen(MASS_SCATTER, disturbance.mass_factor), resistance=resistance, service_share=share
    )


def _resistance_ratios(run: Run) -> tuple[float, float]:
    """Least and largest true running resistance over the nominal one, at any speed."""
    known, actual = _nominal(run), run.disturbance.true_plant(run.trainset)
    speed = np.linspace(0.0, known.max_speed_mps, 65)
    powers = np.stack([np.ones_like(speed), speed, speed * speed])
    true_n, nominal_n = (np.array(t.davis.newtons(t.mass_kg)) @ powers for t in (actual, known))
    # a trainset without running resistance would divide by zero
    ratio = true_n / np.maximum(nominal_n, 1e-6)
    return max(float(ratio.min()), 0.0), float(ratio.max())


def _braking_share(run: Run) -> float:
    """Least ratio of true to nominal service braking force over all speeds."""
    known, actual = (vehicle_arrays(t) for t in (_nominal(run), run.disturbance.true_plant(run.trainset)))
    speeds = np.linspace(0.0, float(known.max_speed_mps), 65)
    return float(np.min(brake_available_n(actual, speeds) / brake_available_n(known, speeds)))


def _nominal(run: Run) -> Trainset:
    return run.disturbance.nominal(run.trainset)


def _widen(interval: tuple[float, float], *values: float) -> tuple[float, float]:
    return min(interval[0], *values), max(interval[1], *values)

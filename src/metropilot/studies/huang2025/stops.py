"""Repeated station stops with a brake whose gain is off: what the heuristic online algorithm learns."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from metropilot.drivers.eitoe import Eitoe, EitoeOptions
from metropilot.sim import Rollout
from metropilot.studies.huang2025.published import BEYOND, BY_ID
from metropilot.studies.huang2025.setting import run_of
from metropilot.studies.report import ReportRow

GAINS = (0.7, 1.0, 1.3)
STOPS = 11
NOISE_MPS = 0.02


class Stops(NamedTuple):
    """Stops one after another with the same brake.

    Attributes:
        gain: True over believed braking force.
        error_m: Where the head stood minus the stop, one a stop.
        learned: The gain known after each.
        time_s: Running time of each.
        interventions: Spells of protection in all of them.
    """

    gain: float
    error_m: list[float]
    learned: list[float]
    time_s: list[float]
    interventions: int


def repeated_stops(gain: float, noise_mps: float = NOISE_MPS, stops: int = STOPS) -> Stops:
    """Drive case 1 again and again; what was learned of the brake is kept from stop to stop.

    Args:
        gain: True over believed braking force.
        noise_mps: Standard deviation of the measured speed.
        stops: How often.
    """
    driver, hoa = Eitoe(EitoeOptions(brake_known=False)), None
    errors, learned, times, overruled = [], [], [], 0
    for seed in range(stops):
        run = run_of(BY_ID["101"], seed)
        scenario = replace(run.scenario, brake_factor=gain, speed_noise_mps=noise_mps)
        rollout = Rollout(replace(run, scenario=scenario), driver)
        if hoa is not None:
            rollout.memory = rollout.memory._replace(hoa=hoa)
        while rollout.outcome is None:
            rollout.advance()
        found = rollout.drive()
        hoa = rollout.memory.hoa.next_stop()
        errors.append(float(found.trajectory.position_m[-1]) - found.section.length_m)
        learned.append(hoa.gain)
        times.append(found.running_time_s)
        overruled += found.interventions
    return Stops(gain, errors, learned, times, overruled)


def stop_rows(found: list[Stops]) -> Iterator[ReportRow]:
    """The first stop with an unknown brake, and the one after ten."""
    for one in found:
        case = (
            f"brake {100 * (one.gain - 1):+.0f} %, 101 s" if one.gain != 1.0 else "brake as believed, 101 s"
        )
        place = (f"{BEYOND}: station stops that learn the brake", case, "eitoe")
        yield ReportRow(*place, "first stop: stopping error", "m").measured([abs(one.error_m[0])])
        yield ReportRow(*place, f"stop {len(one.error_m)}: stopping error", "m").measured(
            [abs(one.error_m[-1])]
        )
        yield ReportRow(*place, "all stops: stopping error", "m").measured(np.abs(one.error_m))
        yield ReportRow(*place, "gain learned at the first stop", "", optimum=one.gain).measured(
            one.learned[:1]
        )
        yield ReportRow(*place, "running time", "s").measured(one.time_s)
        yield ReportRow(*place, "interventions of protection", "").measured([float(one.interventions)])

"""Measures of a trajectory: pure functions, each with its definition and source."""

from __future__ import annotations

import numpy as np

from metropilot.sim import COASTING, STANDSTILL, Trajectory

CHENG2023_WINDOW_S = 2.0
COMFORT_BANDS = (
    (0.315, "not uncomfortable"),
    (0.63, "a little uncomfortable"),
    (1.0, "fairly uncomfortable"),
    (1.6, "uncomfortable"),
    (2.5, "very uncomfortable"),
)


def command_variation(trajectory: Trajectory) -> float:
    """Comfort index ``Ic``: the sum of ``|u(i+1) - u(i)|`` over the control intervals of the run.

    The command counts as 0 before departure and after the stop, so 0 -> 0.6 -> 0 -> -1 -> 0 measures 3.2.
    Source: Huang25 eqs. 10 and 11 (given in words; the ends at 0 are assumed).
    """
    return float(np.abs(np.diff(trajectory.command[:-1], prepend=0.0, append=0.0)).sum())


def window_jerk(trajectory: Trajectory) -> float:
    """The largest change of acceleration between two moments at most two seconds apart.

    Source: Cheng23, text on Table 1: "the maximum acceleration rate over the time span of 2 s". It is a
    change over a window and no derivative, though the paper prints it in m/s^3.
    """
    time, accel = trajectory.time_s, trajectory.acceleration_mps2
    # The margin keeps the row exactly one window later, whose time is rounded.
    last = np.searchsorted(time, time + CHENG2023_WINDOW_S + 1e-9, side="right")
    windows = np.stack([np.arange(time.size), last], axis=1).ravel()
    # ``reduceat`` takes no index beyond the end; every second result is that of a gap between windows.
    closed = np.append(accel, accel[-1:])
    high, low = (extreme.reduceat(closed, windows)[::2] for extreme in (np.maximum, np.minimum))
    return float((high - low).max())


def max_jerk(trajectory: Trajectory) -> float:
    """The largest change of acceleration from one control period to the next over that period, m/s^3.

    Departure and the stop itself count: the last row holds the drop from the last braking rate to nothing.
    """
    return float(np.abs(trajectory.jerk_mps3).max())


def stopping_jerk(trajectory: Trajectory) -> float:
    """Jerk at the final stop: the last braking rate over the control period, m/s^3."""
    return float(abs(trajectory.jerk_mps3[-1]))


def regime_switches(trajectory: Trajectory) -> int:
    """Number of changes of the driving regime (power, cruise, coast, brake) in motion."""
    moving = trajectory.phase[trajectory.phase != STANDSTILL]
    return int((moving[1:] != moving[:-1]).sum())


def coasting_distance_m(trajectory: Trajectory) -> float:
    """Distance covered without effort, m (Huang25 reports it for every method)."""
    moved = np.diff(trajectory.position_m)
    return float(moved[trajectory.phase[:-1] == COASTING].sum())


def motion_energy_jpkg(trajectory: Trajectory) -> float:
    """Huang25's energy index ``sum |a| v dt``, J per kg (eqs. 8 and 9 as reconstructed from its numbers).

    With the acceleration held over a step it is ``|a|`` times the distance covered, exactly.
    """
    return float((np.abs(trajectory.acceleration_mps2[:-1]) * np.diff(trajectory.position_m)).sum())


def effort_energy_j(trajectory: Trajectory) -> float:
    """Work of traction and of all brakes at the wheel, J (Lu23 eq. 16 counts ``|f dx|`` for both)."""
    effort = trajectory.traction_n + trajectory.electric_brake_n + trajectory.friction_brake_n
    return float((effort[:-1] * np.diff(trajectory.position_m)).sum())


def rms_acceleration(trajectory: Trajectory) -> float:
    """Root mean square of the longitudinal acceleration over the run, m/s^2.

    Without the frequency weighting of ISO 2631-1, which needs the vibration spectrum of the vehicle.
    """
    duration = trajectory.duration_s
    return float(np.sqrt((trajectory.acceleration_mps2**2 * duration).sum() / max(duration.sum(), 1e-9)))


def comfort_band(acceleration_mps2: float) -> str:
    """The mildest band of the ISO 2631-1 scale that still holds the value (Lu23 Table 1; bands overlap)."""
    for upper, words in COMFORT_BANDS:
        if acceleration_mps2 <= upper:
            return words
    return "extremely uncomfortable"


def comfort_band_shares(trajectory: Trajectory) -> dict[str, float]:
    """Share of the running time whose acceleration lies in each band of the ISO 2631-1 scale (Lu23 Table 1).

    The paper's bands overlap; an acceleration counts for the mildest that holds it. The shares sum to 1.
    """
    duration = trajectory.duration_s
    bands = [comfort_band(float(abs(a))) for a in trajectory.acceleration_mps2]
    names = [*(words for _, words in COMFORT_BANDS), "extremely uncomfortable"]
    total = max(float(duration.sum()), 1e-9)
    return {name: float(duration[[band == name for band in bands]].sum()) / total for name in names}

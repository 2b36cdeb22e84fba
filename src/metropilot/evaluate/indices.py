"""The five evaluation indices of Huang25 (eqs. 5 to 13), measured on a drive.

Equations 5, 7 and 13 are given there in words; 8, 9 and 11 were lost in print and are taken as its published
numbers have them: with ``E = M sum |a| v dt`` a drive with one peak measures its squared peak speed, and the
published 19.49 m/s and 380 J/kg of EITOE are exactly that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from metropilot.evaluate.measures import motion_energy_jpkg
from metropilot.sim import OVERSPEED_MPS, PUNCTUALITY_S, STOP_TOLERANCE_M, Drive, Outcome

STEADY_MPS2 = 1e-9
"""Changes of the rate below this are rounding."""


class Indices(NamedTuple):
    """The indices of one drive.

    Attributes:
        safe: ``Is``, 1 when the speed never exceeded the limit (eq. 5).
        on_time: ``It``, 1 when the running time is within 3 s of the planned one (eqs. 6 and 7).
        energy_jpkg: ``Ie``, energy per unit mass (eqs. 8 and 9).
        comfort_mps2: ``Ic``, sum of the changes of the rate ``u`` (eqs. 10 and 11); smaller is better.
        parked: ``Ip``, 1 when the head stands within 0.3 m of the stop (eqs. 12 and 13).
    """

    safe: int
    on_time: int
    energy_jpkg: float
    comfort_mps2: float
    parked: int

    @property
    def met(self) -> bool:
        """True if the three binary indices are met."""
        return bool(self.safe and self.on_time and self.parked)


def indices_of(drive: Drive) -> Indices:
    """The five indices of a drive."""
    t = drive.trajectory
    arrived = drive.outcome in (Outcome.ARRIVED, Outcome.OVERSPEED)
    effort = t.traction_n - t.electric_brake_n - t.friction_brake_n
    return Indices(
        safe=safety_index(drive.max_overspeed_mps),
        on_time=punctuality_index(drive.running_time_s, drive.scheduled_time_s) if arrived else 0,
        energy_jpkg=motion_energy_jpkg(t),
        comfort_mps2=comfort_index(effort[:-1] / drive.trainset.mass_kg),
        parked=parking_index(float(t.position_m[-1]), drive.section.length_m),
    )


def safety_index(max_overspeed_mps: float) -> int:
    """``Is`` (Huang25 eq. 5): 1 when the largest excess over the limit is none, else 0."""
    return int(max_overspeed_mps <= OVERSPEED_MPS)


def punctuality_index(running_time_s: float, planned_time_s: float) -> int:
    """``It`` (Huang25 eqs. 6 and 7): 1 when ``|Ta - Tp|`` is at most 3 s, else 0."""
    return int(abs(running_time_s - planned_time_s) <= PUNCTUALITY_S)


def comfort_index(rate_mps2: Float[ndarray, " steps"], threshold_mps2: float = 0.0) -> float:
    """``Ic`` (Huang25 eqs. 10 and 11): the sum of ``|u(i+1) - u(i)|`` over the run, m/s^2.

    ``u`` is the rate of traction (above 0) and braking (below 0), which the paper keeps within 1 m/s^2: wheel
    effort over mass. It is 0 before departure and after the stop, so 0 -> 0.6 -> 0 -> -1 -> 0 measures 3.2.

    Args:
        rate_mps2: ``u`` of each control interval. Shape (steps,).
        threshold_mps2: Changes up to this size do not count.
    """
    change = np.abs(np.diff(rate_mps2, prepend=0.0, append=0.0))
    return float(change[change > max(threshold_mps2, STEADY_MPS2)].sum())


def parking_index(position_m: float, stop_m: float) -> int:
    """``Ip`` (Huang25 eqs. 12 and 13): 1 when the head stands at most 0.3 m from the stop, else 0."""
    return int(abs(position_m - stop_m) <= STOP_TOLERANCE_M)

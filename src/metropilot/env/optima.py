"""What each drive could have cost: optimal energy over running time, tabulated for every case of a task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.interpolate import PchipInterpolator

from metropilot.planning import PlanOptions, time_energy_front
from metropilot.railway import Section, Trainset

RATIOS = (1.01, 1.03, 1.06, 1.1, 1.15, 1.2, 1.3, 1.4, 1.6)


@dataclass(frozen=True)
class Optima:
    """Optimal traction energy at the wheel of every case.

    Attributes:
        time_s: Running times, increasing. Shape (C, P).
        energy_j: Optimal energy at each. Shape (C, P).
    """

    time_s: Float[ndarray, "cases points"]
    energy_j: Float[ndarray, "cases points"]

    def at(self, case: ndarray, time_s: ndarray) -> ndarray:
        """Optimal energy of drives by case and running time, J; NaN outside the tabulated times.

        Args:
            case: Row of each. Shape (N,).
            time_s: Running time of each. Shape (N,).
        """
        found = np.full(np.shape(time_s), np.nan)
        for row in np.unique(case):
            mine = case == row
            curve = PchipInterpolator(self.time_s[row], self.energy_j[row], extrapolate=False)
            found[mine] = curve(np.asarray(time_s, float)[mine])
        return found

    def gap(self, case: ndarray, time_s: ndarray, wheel_j: ndarray) -> ndarray:
        """Share by which drives used more than the optimum at the same running time."""
        return wheel_j / self.at(case, time_s) - 1.0


def optima_of(
    cases: Sequence[tuple[Section, Trainset]],
    ratios: Sequence[float] = RATIOS,
    options: PlanOptions | None = None,
) -> Optima:
    """Solve every case at several running times (half a second a case).

    Args:
        cases: A task's ``config.cases``.
        ratios: Running times over the minimum of the case, increasing.
        options: See :class:`metropilot.planning.PlanOptions`.
    """
    from metropilot.planning import minimum_running_time

    fronts = []
    for section, trainset in cases:
        minimum = minimum_running_time(section, trainset)
        fronts.append(time_energy_front(section, trainset, [minimum * ratio for ratio in ratios], options))
    return Optima(
        time_s=np.stack([front.time_s for front in fronts]),
        energy_j=np.stack([np.minimum.accumulate(front.energy_j) for front in fronts]),
    )

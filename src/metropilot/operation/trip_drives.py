"""Trips of a line as a driver drives them under protection."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from metropilot.errors import Infeasible
from metropilot.evaluate import make_driver
from metropilot.operation.line_service import LineOperation, Profiles
from metropilot.operation.power import PowerProfile, profile_of_trajectory
from metropilot.sim import Outcome, Run, drive


class TripDrives:
    """Powers of trips as a driver drives them, each run driven when it is first asked for.

    They depend on neither headway nor zones: one of them does for a line at all headways.

    Args:
        operation: Line in operation.
        driver: Driver id.
        seeds: Seeds of the runs, one or more.

    Raises:
        InputError: No such driver.
    """

    def __init__(self, operation: LineOperation, driver: str, seeds: Sequence[int] = (0,)) -> None:
        self.operation, self.driver, self.seeds = operation, driver, tuple(seeds)
        self._acting = make_driver(driver)
        self._found: dict[tuple[int, int, int], PowerProfile] = {}

    def profiles(self, times_s: Sequence[Iterable[int]] | None = None) -> list[Profiles]:
        """Power of every trip by its running time, once for each seed.

        Args:
            times_s: Running times of each trip; None: the planned one.

        Raises:
            Infeasible: A run does not arrive.
        """
        times_s = times_s or [(trip.planned_s,) for trip in self.operation.trips]
        return [
            [{time_s: self._drive(k, time_s, seed) for time_s in times} for k, times in enumerate(times_s)]
            for seed in self.seeds
        ]

    def _drive(self, trip: int, time_s: int, seed: int) -> PowerProfile:
        key = trip, time_s, seed
        if key not in self._found:
            section = self.operation.trips[trip].section
            done = drive(Run(section, self.operation.trainset, float(time_s), seed=seed), self._acting)
            if done.outcome is not Outcome.ARRIVED:
                raise Infeasible(
                    f"{self.driver} does not arrive, {section.name} in {time_s} s, seed {seed}",
                    field="driver",
                    value=done.outcome.value,
                    allowed="arrived",
                )
            self._found[key] = profile_of_trajectory(done.trajectory, self.operation.silent)
        return self._found[key]

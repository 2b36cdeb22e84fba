"""Two registered drivers and one of your own on the same run.

python examples/compare_drivers.py
"""

from dataclasses import replace

import numpy as np

from metropilot.evaluate import RunSpec, kpis_of, make_driver, optimum_of
from metropilot.sim import AbstractDriver, Observation, Run, drive


class Coaster(AbstractDriver):
    """Full power up to a speed, then coasting, then a brake at a constant rate."""

    id = "coaster"
    summary = "power, coast, brake"
    source = "example"

    def init(self, run: Run) -> str:  # noqa: ARG002 (this driver needs nothing of the run)
        """Begin with full power."""
        return "power"

    def act(self, memory: str, observation: Observation) -> tuple[float, str]:
        """The command for the coming control period."""
        left_m = observation.section.length_m - observation.position_m
        if observation.speed_mps > np.sqrt(2 * 0.65 * max(left_m, 0.0)):
            return -0.75, "brake"
        ceiling_mps = min(17.5, observation.permitted_mps - 1.5)
        if memory == "power" and (observation.speed_mps < ceiling_mps or observation.position_m < 240):
            return min(1.0, max(0.0, ceiling_mps - observation.speed_mps)), "power"
        return (0.15, "coast") if observation.speed_mps < 3.0 else (0.0, "coast")


def main() -> None:
    request = RunSpec("yizhuang", "RJ", "WYJ", time_s=101.0)
    for driver in (make_driver("optimal"), make_driver("manual"), Coaster()):
        driven = drive(replace(request.run(), seed=1), driver)
        kpis = kpis_of(driven, optimum_of(driven))
        ended = f"{kpis.outcome} after {kpis.running_time_s:.1f} s"
        best = kpis.optimal_energy_kwh or float("nan")
        print(f"{driver.id:8} {ended}: {kpis.energy_wheel_kwh:.2f} kWh, optimum {best:.2f} kWh")


if __name__ == "__main__":
    main()

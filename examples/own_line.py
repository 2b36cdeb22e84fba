"""A line made from arrays, without a file, and the energy that a second of running time costs on it.

python examples/own_line.py
"""

import numpy as np

from metropilot.planning import time_energy_front
from metropilot.railway import Line, Station, Steps, load_trainset

KMH = 1 / 3.6


def main() -> None:
    line = Line(
        id="hill",
        name="Over the hill",
        stations=(Station("A", "Valley", 0.0), Station("B", "Meadow", 1800.0)),
        limit_mps=Steps(np.array([0.0, 300.0, 1500.0]), np.array([60.0, 80.0, 60.0]) * KMH),
        gradient_permil=Steps(np.array([0.0, 400.0, 900.0, 1400.0]), np.array([0.0, 20.0, -20.0, 0.0])),
    )
    trainset = load_trainset("dkz32")
    front = time_energy_front(line.section("A", "B"), trainset)
    print(f"minimum running time {front.minimum_s:.1f} s")
    for time_s, energy_j, second_w in zip(front.time_s, front.energy_j, front.second_w, strict=True):
        print(
            f"{time_s:6.1f} s  {energy_j / 3.6e6:6.2f} kWh  one more second saves {second_w / 1000:5.0f} kJ"
        )


if __name__ == "__main__":
    main()

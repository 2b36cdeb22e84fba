"""Sections that tests declare by limits and gradients."""

from collections.abc import Mapping

import numpy as np

from metropilot.railway import Line, Section, Station, Steps


def section_of(length_m: float, limits_kmh: Mapping[float, float], permil: Mapping[float, float]) -> Section:
    """A section from limits and gradients by the position from which they hold."""
    line = Line(
        id="odd",
        name="odd",
        stations=(Station("A", "Alpha", 0.0), Station("B", "Beta", length_m)),
        limit_mps=Steps(np.array([*limits_kmh], float), np.array([*limits_kmh.values()]) / 3.6),
        gradient_permil=Steps(np.array([*permil], float), np.array([*permil.values()], float)),
    )
    return line.section("A", "B")


def fall_of(length_m: float) -> Section:
    """A section that falls by 38 permil all the way, with a limit of 54 km/h."""
    return section_of(length_m, {-300.0: 54.0}, {-300.0: -38.0})

"""Piecewise descriptions along a line: the one shape every track quantity is given in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.errors import InputError


def _freeze(values: object) -> ndarray:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class Steps:
    """A piecewise-constant profile: ``value[k]`` holds from ``from_m[k]`` to the next break.

    The first value also holds before the first break and the last one after the last.

    Attributes:
        from_m: Start of each piece, strictly increasing, m. Shape (K,).
        value: The value of each piece, in the unit of its owner. Shape (K,).
    """

    from_m: Float[ndarray, " pieces"]
    value: Float[ndarray, " pieces"]

    def __post_init__(self) -> None:
        object.__setattr__(self, "from_m", _freeze(self.from_m))
        object.__setattr__(self, "value", _freeze(self.value))
        if self.from_m.ndim != 1 or self.from_m.shape != self.value.shape or self.from_m.size == 0:
            raise InputError("a profile needs one position for each value", allowed="at least one piece")
        if not (np.isfinite(self.from_m).all() and np.isfinite(self.value).all()):
            raise InputError("a profile holds a number that is not finite", allowed="finite numbers")
        if (np.diff(self.from_m) <= 0).any():
            worst = int(np.argmin(np.diff(self.from_m)))
            raise InputError(
                "positions of a profile must increase",
                value=float(self.from_m[worst + 1]),
                unit="m",
                allowed=f"greater than {self.from_m[worst]:g} m",
            )

    def __eq__(self, other: object) -> bool:
        """Equal when both arrays are."""
        if not isinstance(other, Steps):
            return NotImplemented
        return np.array_equal(self.from_m, other.from_m) and np.array_equal(self.value, other.value)

    __hash__ = None  # type: ignore[assignment]

    def at(self, position_m: Float[ndarray, "..."] | float) -> Float[ndarray, "..."]:
        """The value that holds at each position (right-continuous)."""
        index = np.searchsorted(self.from_m, np.asarray(position_m, dtype=np.float64), side="right") - 1
        return np.asarray(self.value[np.maximum(index, 0)])

    def integral(self, position_m: Float[ndarray, "..."] | float) -> Float[ndarray, "..."]:
        """The integral of the profile from its first break to each position."""
        position = np.asarray(position_m, dtype=np.float64)
        if self.from_m.size == 1:
            return np.asarray(self.value[0] * (position - self.from_m[0]))
        whole = np.concatenate([[0.0], np.cumsum(np.diff(self.from_m) * self.value[:-1])])
        index = np.clip(np.searchsorted(self.from_m, position, side="right") - 1, 0, None)
        return np.asarray(whole[index] + self.value[index] * (position - self.from_m[index]))

    def window(self, start_m: float, end_m: float) -> Steps:
        """The pieces that matter between two positions, the first moved to ``start_m``."""
        inside = (self.from_m > start_m) & (self.from_m < end_m)
        return Steps(
            np.concatenate([[start_m], self.from_m[inside]]),
            np.concatenate([[float(self.at(start_m))], self.value[inside]]),
        )

    def mirror(self, origin_m: float, sign: float = 1.0) -> Steps:
        """The profile in the opposite direction of travel, position 0 at ``origin_m``.

        Args:
            origin_m: The position that becomes 0; positions grow against the profile's direction.
            sign: Factor on the values: -1 for a gradient, 1 for anything without a direction.
        """
        first = np.array([-np.inf])
        edges = np.concatenate([first, origin_m - self.from_m[:0:-1]])
        if edges.size == 1:
            edges = np.array([origin_m - self.from_m[0] - 1.0])
        else:
            edges[0] = edges[1] - 1.0
        return Steps(edges, sign * self.value[::-1])

    def shift(self, origin_m: float) -> Steps:
        """The same profile with position 0 at ``origin_m``."""
        return Steps(self.from_m - origin_m, self.value)

    def lower(self, from_m: float, to_m: float, value: float) -> Steps:
        """The profile with everything between two positions at most ``value``."""
        edges = np.unique(np.concatenate([self.from_m, [from_m, to_m]]))
        values = self.at(edges)
        inside = (edges >= from_m) & (edges < to_m)
        return Steps(edges, np.where(inside, np.minimum(values, value), values))

"""Effort curves: the traction or braking force a trainset has at each speed."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy import ndarray

from metropilot._typing import Float
from metropilot.errors import InputError


@dataclass(frozen=True)
class EffortPiece:
    """One piece of an effort curve: ``min(cap, h/v + c0 + c1 v + c2 v^2 + c3 v^3)``, never below zero.

    Attributes:
        from_mps: Speed at which the piece begins, m/s; it ends where the next begins.
        polynomial: Coefficients ``(c0, c1, c2, c3)`` in N, N/(m/s), N/(m/s)^2, N/(m/s)^3.
        power_w: Numerator ``h`` of the hyperbola, W.
        cap_n: Upper bound, N (infinite: none).
    """

    from_mps: float
    polynomial: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    power_w: float = 0.0
    cap_n: float = float("inf")


@dataclass(frozen=True)
class EffortCurve:
    """A force over speed, given as pieces by increasing speed, the first from standstill.

    A table is a curve of linear pieces; a force/power hyperbola is one piece with a cap.
    """

    pieces: tuple[EffortPiece, ...]

    def __post_init__(self) -> None:
        if not self.pieces:
            raise InputError("an effort curve needs at least one piece")
        starts = [p.from_mps for p in self.pieces]
        if starts[0] != 0.0 or any(b <= a for a, b in pairwise(starts)):
            raise InputError(
                "the pieces of an effort curve must begin at 0 and increase", value=starts[0], unit="m/s"
            )

    def at(self, speed_mps: Float[ndarray, "..."] | float) -> Float[ndarray, "..."]:
        """Force at each speed, N (the railway layer's own float64 look-up, for drawing and for checks)."""
        speed = np.atleast_1d(np.asarray(speed_mps, dtype=np.float64))
        starts = np.array([p.from_mps for p in self.pieces])
        index = np.clip(np.searchsorted(starts, speed, side="right") - 1, 0, None)
        coefficients = np.array([p.polynomial for p in self.pieces])[index]
        power = np.array([p.power_w for p in self.pieces])[index]
        cap = np.array([p.cap_n for p in self.pieces])[index]
        powers = speed[..., None] ** np.arange(4)
        value = power / np.maximum(speed, 1e-6) + (coefficients * powers).sum(axis=-1)
        return np.clip(value, 0.0, cap).reshape(np.shape(speed_mps))

    def scale(self, factor: float) -> EffortCurve:
        """The same curve with every force multiplied."""
        return EffortCurve(
            tuple(
                EffortPiece(
                    p.from_mps,
                    (
                        p.polynomial[0] * factor,
                        p.polynomial[1] * factor,
                        p.polynomial[2] * factor,
                        p.polynomial[3] * factor,
                    ),
                    p.power_w * factor,
                    p.cap_n * factor,
                )
                for p in self.pieces
            )
        )

    @classmethod
    def constant(cls, force_n: float) -> EffortCurve:
        """The same force at every speed."""
        return cls((EffortPiece(0.0, (force_n, 0.0, 0.0, 0.0)),))

    @classmethod
    def force_power(cls, force_n: float, power_w: float) -> EffortCurve:
        """``min(force, power / v)``."""
        return cls((EffortPiece(0.0, power_w=power_w, cap_n=force_n),))

    @classmethod
    def table(cls, speed_mps: Float[ndarray, " points"], force_n: Float[ndarray, " points"]) -> EffortCurve:
        """Linear between the points, constant after the last."""
        speed, force = np.asarray(speed_mps, float), np.asarray(force_n, float)
        slopes = np.append(np.diff(force) / np.diff(speed), 0.0)
        return cls(
            tuple(
                EffortPiece(float(v), (float(f - s * v), float(s), 0.0, 0.0))
                for v, f, s in zip(speed, force, slopes, strict=True)
            )
        )


@dataclass(frozen=True, eq=False)
class Efficiency:
    """Share of the power that arrives, constant or a map over speed and effort.

    Attributes:
        speed_mps: Speeds of the map, increasing, m/s. Shape (S,). One entry: constant over speed.
        effort_share: Share of the available effort, increasing, in [0, 1]. Shape (E,).
        value: Efficiency in (0, 1], bilinear between the points, held outside. Shape (S, E).
    """

    speed_mps: Float[ndarray, " speeds"]
    effort_share: Float[ndarray, " shares"]
    value: Float[ndarray, "speeds shares"]

    def __post_init__(self) -> None:
        for name in ("speed_mps", "effort_share", "value"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        if self.value.shape != (self.speed_mps.size, self.effort_share.size):
            raise InputError("an efficiency map needs one row per speed and one column per effort share")
        wrong = self.value[~((self.value > 0) & (self.value <= 1))]
        if wrong.size:
            raise InputError("efficiency out of range", value=float(wrong[0]), allowed="> 0 and <= 1")

    def __eq__(self, other: object) -> bool:
        """Equal when all three arrays are."""
        if not isinstance(other, Efficiency):
            return NotImplemented
        names = ("speed_mps", "effort_share", "value")
        return all(np.array_equal(getattr(self, n), getattr(other, n)) for n in names)

    def __hash__(self) -> int:
        """Consistent with equality."""
        return hash((self.speed_mps.tobytes(), self.effort_share.tobytes(), self.value.tobytes()))

    @classmethod
    def constant(cls, value: float) -> Efficiency:
        """The same efficiency everywhere."""
        return cls(np.zeros(1), np.zeros(1), np.array([[value]]))

    @property
    def is_constant(self) -> bool:
        """True if speed and effort do not matter."""
        return self.value.size == 1

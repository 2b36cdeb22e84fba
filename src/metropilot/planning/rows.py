"""Rows of a sparse cone programme, collected whole blocks at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy import ndarray


@dataclass
class ConstraintRows:
    """Sparse rows ``A x <= / = b`` being collected, whole blocks at a time."""

    row: list[ndarray] = field(default_factory=list)
    col: list[ndarray] = field(default_factory=list)
    val: list[ndarray] = field(default_factory=list)
    rhs: list[ndarray] = field(default_factory=list)
    count: int = 0

    def add(self, terms: Sequence[tuple[ndarray, ndarray | float]], rhs: ndarray | float, size: int) -> None:
        """``size`` rows; each term is (column of each row, coefficient of each row)."""
        rows = self.count + np.arange(size)
        for col, val in terms:
            self.row.append(rows)
            self.col.append(np.broadcast_to(col, (size,)))
            self.val.append(np.broadcast_to(np.asarray(val, np.float64), (size,)))
        self.rhs.append(np.broadcast_to(np.asarray(rhs, np.float64), (size,)))
        self.count += size

    def add_cones(
        self, triples: list[list[tuple[ndarray, float]]], rhs: list[ndarray | float], size: int
    ) -> None:
        """``size`` second-order cones of three rows each: ``b - A x`` of the first >= norm of the others."""
        for part, (terms, constant) in enumerate(zip(triples, rhs, strict=True)):
            rows = self.count + 3 * np.arange(size) + part
            for col, val in terms:
                self.row.append(rows)
                self.col.append(col)
                self.val.append(np.full(size, val))
            if part == 0:
                self.rhs.append(np.zeros(3 * size))
            self.rhs[-1][part::3] = constant
        self.count += 3 * size

    def add_sum(self, terms: Sequence[tuple[ndarray, ndarray | float]], rhs: float) -> int:
        """One row over many columns; returns its number."""
        for col, val in terms:
            self.row.append(np.full(col.size, self.count))
            self.col.append(col.astype(int))
            self.val.append(np.broadcast_to(np.asarray(val, np.float64), col.shape))
        self.rhs.append(np.array([rhs]))
        self.count += 1
        return self.count - 1

"""Numbers that change while a driver learns: rates, exploration, entropy bonus, importance exponent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

from metropilot.errors import InputError

Shape = Literal["linear", "exponential", "cosine"]
SHAPES: tuple[Shape, ...] = ("linear", "exponential", "cosine")


@dataclass(frozen=True)
class Schedule:
    """From ``start`` to ``end`` over a share of the learning, then constant.

    Attributes:
        start: Value at the beginning.
        end: Value from ``over`` on.
        over: Share of the whole learning, in (0, 1].
        shape: Curve from one to the other; ``exponential`` needs both above zero.
    """

    start: float
    end: float
    over: float = 1.0
    shape: Shape = "linear"

    def __post_init__(self) -> None:
        """Refuse what cannot be followed."""
        if not 0.0 < self.over <= 1.0:
            raise InputError(
                "share out of range", field="over", value=self.over, allowed="above 0, at most 1"
            )
        if self.shape not in SHAPES:
            raise InputError("unknown shape", field="shape", value=self.shape, allowed=", ".join(SHAPES))
        if self.shape == "exponential" and min(self.start, self.end) <= 0.0:
            ends = f"{self.start} to {self.end}"
            raise InputError("an exponential schedule stays above zero", field="start, end", value=ends)

    def at(self, progress: Any) -> Any:
        """The value at a share of the learning (a JAX scalar or a number). Shape ()."""
        import jax.numpy as jnp

        share = jnp.clip(jnp.asarray(progress, jnp.float32) / self.over, 0.0, 1.0)
        if self.shape == "exponential":
            return self.start * (self.end / self.start) ** share
        if self.shape == "cosine":
            share = 0.5 * (1.0 - jnp.cos(jnp.pi * share))
        return self.start + (self.end - self.start) * share


Scheduled = float | Schedule


def value_at(number: Scheduled, progress: Any) -> Any:
    """A number or a schedule at a share of the learning."""
    return number.at(progress) if isinstance(number, Schedule) else number


def highest(number: Scheduled | int) -> float | int:
    """The larger of both ends."""
    return max(number.start, number.end) if isinstance(number, Schedule) else number


def read_schedule(field: str, value: Any) -> Scheduled:
    """A number, or a table ``{start, end, over, shape}``, as it stands in a file.

    Raises:
        InputError: It is neither.
    """
    if isinstance(value, Schedule):
        return value
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    names = {f.name for f in fields(Schedule)}
    if not isinstance(value, Mapping) or not {"start", "end"} <= set(value) <= names:
        allowed = "a number or a table with start, end, over, shape"
        raise InputError("not a schedule", field=field, value=repr(value), allowed=allowed)
    for name in ("start", "end", "over"):
        if isinstance(value.get(name, 1.0), bool | str) or not isinstance(value.get(name, 1.0), int | float):
            raise InputError(
                "not a number", field=f"{field}.{name}", value=repr(value[name]), allowed="a number"
            )
    over, shape = float(value.get("over", 1.0)), value.get("shape", "linear")
    return Schedule(float(value["start"]), float(value["end"]), over, shape)

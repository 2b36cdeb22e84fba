"""What a policy was told and what its actions meant: all a driver needs to run it where it did not learn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

from metropilot.errors import InputError
from metropilot.task.actions import ACTIONS, AbstractAction
from metropilot.task.assist import Assists
from metropilot.task.observers import FEATURES


@dataclass(frozen=True)
class Perception:
    """Between a policy and a trainset; plain values, so that it goes into a policy's file.

    Attributes:
        features: Names of the features in the observation, in order.
        action: What an action means.
        assists: What is done for the policy.
        period_s: Time between two decisions.
        spacing_m: Distance between the nodes of the curves it sees.
        mean_mass_kg: Mass that the feature ``load`` is relative to.
    """

    features: tuple[str, ...]
    action: AbstractAction
    assists: Assists
    period_s: float
    spacing_m: float
    mean_mass_kg: float

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        kind = next(name for name, kind in ACTIONS.items() if type(self.action) is kind)
        action: Any = self.action
        return {
            "features": list(self.features),
            "action": {"kind": kind} | asdict(action),
            "assists": asdict(self.assists),
            "period_s": self.period_s,
            "spacing_m": self.spacing_m,
            "mean_mass_kg": self.mean_mass_kg,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Perception:
        """The inverse of :meth:`as_dict`.

        Raises:
            InputError: Something is missing, unknown or out of range.
        """
        expected = {f.name for f in fields(cls)}
        if set(values) != expected:
            wrong = ", ".join(sorted(set(values) ^ expected))
            raise InputError("fields missing or unknown", field="perception", value=wrong)
        unknown = [name for name in values["features"] if name not in FEATURES]
        if unknown or not values["features"]:
            raise InputError(
                "unknown feature", field="features", value=str(unknown), allowed=", ".join(FEATURES)
            )
        for name, low, high in (
            ("period_s", 0.01, 10.0),
            ("spacing_m", 0.1, 50.0),
            ("mean_mass_kg", 1e3, 1e8),
        ):
            if not (isinstance(values[name], int | float) and low <= values[name] <= high):
                raise InputError(
                    "out of range", field=name, value=values[name], allowed=f"{low:g} to {high:g}"
                )
        action = dict(values["action"])
        kind = action.pop("kind", None)
        if kind not in ACTIONS:
            raise InputError("unknown action", field="action", value=str(kind), allowed=", ".join(ACTIONS))
        return cls(
            features=tuple(values["features"]),
            action=_made(ACTIONS[kind], action, "action"),
            assists=_made(Assists, values["assists"], "assists"),
            period_s=float(values["period_s"]),
            spacing_m=float(values["spacing_m"]),
            mean_mass_kg=float(values["mean_mass_kg"]),
        )


def _made(kind: Any, values: Mapping[str, Any], field: str) -> Any:  # noqa: ANN401 (a dataclass of any kind)
    """A dataclass from plain values of the types of its defaults."""
    defaults = asdict(kind())
    given = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
    for name, value in given.items():
        if name not in defaults or type(value) is not type(defaults[name]):
            raise InputError("unknown or of the wrong kind", field=f"{field}.{name}", value=str(value))
    return kind(**given)

"""Interface of a policy: features, action, assists and periods with which any driver can run it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from types import MappingProxyType
from typing import Any

from metropilot._schema import check_name
from metropilot.env.actions import ACTIONS, AbstractAction
from metropilot.env.assists import Assists
from metropilot.env.features import FEATURES
from metropilot.errors import InputError

RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"period_s": (0.01, 10.0), "spacing_m": (0.5, 50.0), "mean_mass_kg": (1e3, 1e8)}
)
MOST_ENTRIES = 1024
MOST_SHOWN = 80
LARGEST = 1e9


@dataclass(frozen=True)
class PolicyInterface:
    """Interface between a policy and a trainset; plain values, stored in the policy's file.

    Attributes:
        features: Names of the features in the observation, in order.
        action: Kind of action.
        assists: Assists of the policy.
        period_s: Time between two decisions.
        spacing_m: Distance between the nodes of the curves in its features.
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
        action: Any = self.action
        return {
            "features": list(self.features),
            "action": {"kind": self.action.kind} | _plain(asdict(action)),
            "assists": asdict(self.assists),
            "period_s": self.period_s,
            "spacing_m": self.spacing_m,
            "mean_mass_kg": self.mean_mass_kg,
        }

    @classmethod
    def from_dict(cls, values: object, *, file: object = None) -> PolicyInterface:
        """Build an interface from the values of :meth:`as_dict`; every value is checked.

        Args:
            values: Plain values, as they stand in JSON.
            file: Named in error messages.

        Raises:
            InputError: Something is missing, unknown, of the wrong kind or out of range.
        """
        try:
            return _read(values)
        except InputError as error:
            raise error.at(file=file) from None


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    """Replace tuples by lists, as JSON has them."""
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}


def _read(values: object) -> PolicyInterface:
    """Build an interface with every value checked."""
    expected = {f.name for f in fields(PolicyInterface)}
    if not isinstance(values, Mapping) or set(values) != expected:
        wrong = sorted(map(str, set(values) ^ expected)) if isinstance(values, Mapping) else [repr(values)]
        shown, allowed = ", ".join(wrong)[:MOST_SHOWN], ", ".join(sorted(expected))
        raise InputError("fields missing or unknown", field="perception", value=shown, allowed=allowed)
    for name, (low, high) in RANGES.items():
        value = values[name]
        if type(value) not in {int, float} or not low <= value <= high:
            shown, allowed = _excerpt(value), f"{low:g} to {high:g}"
            raise InputError("out of range", field=f"perception.{name}", value=shown, allowed=allowed)
    action = values["action"]
    kind = action.get("kind") if isinstance(action, Mapping) else None
    if not isinstance(kind, str) or kind not in ACTIONS:
        known = ", ".join(ACTIONS)
        raise InputError("unknown action", field="perception.action", value=_excerpt(kind), allowed=known)
    rest = {name: value for name, value in action.items() if name != "kind"}
    return PolicyInterface(
        features=_features(values["features"]),
        action=_make(ACTIONS.get(kind), rest, "perception.action"),
        assists=_make(Assists, values["assists"], "perception.assists"),
        **{name: float(values[name]) for name in RANGES},
    )


def _features(values: object) -> tuple[str, ...]:
    """Check that every name is that of a feature and occurs once."""
    if not isinstance(values, list | tuple):
        raise InputError("not a list", field="perception.features", value=_excerpt(values))
    names: list[Any] = list(values)
    unknown = [name for name in names if not isinstance(name, str) or name not in FEATURES]
    if unknown or not names or len(set(names)) < len(names):
        words = "unknown feature" if unknown else "a feature given twice" if names else "no features"
        shown = _excerpt(unknown[0] if unknown else names)
        raise InputError(words, field="perception.features", value=shown, allowed=", ".join(FEATURES))
    return tuple(names)


def _make(kind: Any, values: object, field: str) -> Any:  # noqa: ANN401 (a dataclass of any kind)
    """Build a dataclass from plain values of the types of its defaults."""
    standard = kind()
    given = dict(values) if isinstance(values, Mapping) else {_excerpt(values): None}
    names = [f.name for f in fields(kind)]
    for name in given:
        check_name(str(name), names, "field", field=field, value=_excerpt(name))
    return kind(
        **{name: _like(getattr(standard, name), value, f"{field}.{name}") for name, value in given.items()}
    )


def _like(default: object, value: object, field: str) -> Any:  # noqa: ANN401 (whatever a field holds)
    """Convert a value to the type of the default; integers count as floats, lists as tuples."""
    if isinstance(default, tuple) and isinstance(value, list | tuple) and len(value) <= MOST_ENTRIES:
        if value and default:
            return tuple(_like(default[0], entry, field) for entry in value)
    elif isinstance(default, float) and isinstance(value, int | float) and not isinstance(value, bool):
        if abs(value) <= LARGEST:
            return float(value)
    elif type(value) is type(default) and not isinstance(default, tuple):
        return value
    kinds = {float: "a finite number", int: "a whole number", bool: "true or false", str: "text"}
    allowed = kinds.get(type(default), f"a list of 1 to {MOST_ENTRIES}")
    raise InputError("of the wrong kind", field=field, value=_excerpt(value), allowed=allowed)


def _excerpt(value: object) -> str:
    """First characters of a value, for an error message."""
    return (value if isinstance(value, str) else repr(value))[:MOST_SHOWN]

"""Refusals with an HTTP status, and errors as plain values. Light to import."""

from __future__ import annotations

import json
from typing import Any

from metropilot.errors import InputError

FIELDS = ("file", "field", "value", "unit", "allowed")


class Refused(InputError):
    """Refusal of a valid request that cannot be met now, with its HTTP status."""

    def __init__(
        self,
        message: str,
        status: int,
        *,
        field: str | None = None,
        value: object = None,
        allowed: str | None = None,
    ) -> None:
        super().__init__(message, field=field, value=value, allowed=allowed)
        self.status = status

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle with the status."""
        return Refused, (self.message, self.status), self.__dict__


def detail_of(error: Exception) -> dict[str, Any]:
    """Convert an error to plain values."""
    message = error.message if isinstance(error, InputError) else str(error)
    return {"message": message, **{name: plain(getattr(error, name, None)) for name in FIELDS}}


def plain(value: Any) -> Any:  # noqa: ANN401 (whatever was sent)
    """Convert a value for JSON; a long one is cut."""
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else str(value)  # noqa: PLR0124
    if not isinstance(value, str):
        try:
            value = json.dumps(value, default=str)
        except (TypeError, ValueError):
            value = str(value)
    return value.encode("utf-8", "replace").decode()[:200]

"""The exceptions metropilot raises at its edges.

``MetropilotError``
 ├── ``InputError``       a file, field, number, unit, station or option is not usable (exit code 2)
 │    └── ``Infeasible``  the input is well formed but physics or time does not allow it
 └── ``SolverError``      a solver stopped without an answer (never the user's fault)
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

_LONGEST = 600
"""Characters of one part of a complaint; the list of what is allowed is ours, and shown whole."""
_LONGEST_VALUE = 200
"""Characters of a value: a path may be as long."""


class MetropilotError(Exception):
    """Base of every exception metropilot raises on purpose."""


class InputError(MetropilotError, ValueError):
    """Input that cannot be used: one line that says what, where, and what is allowed.

    Args:
        message: Message in words.
        file: The file or catalogue entry it stands in.
        field: The field (dotted path), option or argument.
        value: The offending value as given.
        unit: The unit the value was read in.
        allowed: The allowed range, kind or list of values, in words.
    """

    def __init__(
        self,
        message: str,
        *,
        file: object = None,
        field: str | None = None,
        value: object = None,
        unit: str | None = None,
        allowed: str | None = None,
    ) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.field = field
        self.value = value
        self.unit = unit
        self.allowed = allowed
        super().__init__(self.line())

    def at(self, *, file: object = None, field: str | None = None) -> InputError:
        """The same complaint with another file or field; what is None stays."""
        return type(self)(
            self.message,
            file=self.file if file is None else file,
            field=self.field if field is None else field,
            value=self.value,
            unit=self.unit,
            allowed=self.allowed,
        )

    def line(self) -> str:
        """The whole story on one line: ``file: field: message: value unit (allowed: ...)``.

        What came from a file is cut where it is long; a character no terminal should be sent is escaped.
        """
        head = ": ".join(_cut(part) for part in (self.file, self.field, self.message) if part)
        if self.value is not None:
            shown = repr(self.value) if isinstance(self.value, str) else str(self.value)
            head += ": " + _cut(shown, _LONGEST_VALUE)
            if self.unit and self.unit != "1":
                head += f" {self.unit}"
        if self.allowed:
            head += f" (allowed: {self.allowed})"
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(head.split()))


def _cut(text: str, longest: int = _LONGEST) -> str:
    return text if len(text) <= longest else f"{text[: longest - 50]} ... {text[-40:]}"


@contextmanager
def rename_fields(names: Mapping[str, str], file: object = None) -> Iterator[None]:
    """Rename the fields of errors raised inside to the names the user wrote.

    Args:
        names: From a field's name inside to its name outside; errors of other fields, and those of a
            file of their own, pass as they are.
        file: The file in which the outer names stand.
    """
    try:
        yield
    except InputError as error:
        outer = names.get(error.field or "")
        if error.file is not None or outer is None:
            raise
        raise error.at(file=file, field=outer) from error


class Infeasible(InputError):
    """No drive can meet the request; the message names the bound that forbids it."""


class SolverError(MetropilotError, RuntimeError):
    """A solver stopped without an answer."""

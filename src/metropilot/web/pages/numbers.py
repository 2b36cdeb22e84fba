"""Numbers as a person types, pastes or slides them."""

from __future__ import annotations

import math
import re
from contextlib import suppress
from typing import Any
from unicodedata import normalize

from nicegui import events, ui

from metropilot.errors import InputError
from metropilot.web.words.language import _
from metropilot.web.words.said import retell

MARKS = str.maketrans({"−": "-", "。": "."})
"""Signs of keyboards and spreadsheets that stand for others, beside those of full width."""
GAPS = re.compile(r"(?<=\d)[ '’](?=\d{3})")
"""Gaps between thousands."""
AMBIGUOUS = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
GROUPED = {mark: re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:\{mark}\d{{3}})+") for mark in ".,"}


def parse_number(text: str) -> float | None:
    """Read a number with either decimal mark, and with or without separators of thousands.

    Args:
        text: Such as ``1.5``, ``1,5``, ``1,234.5``, ``1.234,5``, ``1 234``.

    Returns:
        The number; None of an empty text.

    Raises:
        InputError: No number, or one that may be another: ``1,234``.
    """
    plain = GAPS.sub("", normalize("NFKC", text).strip().translate(MARKS))
    if not plain:
        return None
    if AMBIGUOUS.fullmatch(plain):
        allowed = f"{plain.replace(',', '')} or {plain.replace(',', '.')}"
        raise InputError("thousands or decimals", value=text, allowed=allowed)
    try:
        found = math.nan if "_" in plain else float(_with_point(plain))
    except ValueError:
        found = math.nan
    if not math.isfinite(found):
        raise InputError("not a number", value=text)
    return found


def _with_point(plain: str) -> str:
    """Write a number with a point, without separators of thousands."""
    last = max(plain.rfind("."), plain.rfind(","))
    if last < 0:
        return plain
    mark = plain[last]
    other = "," if mark == "." else "."
    whole, rest = plain[:last], plain[last + 1 :]
    if mark in whole:  # separators only
        return re.sub(r"[.,]", "", plain) if GROUPED[mark].fullmatch(plain) else plain
    if other in whole:
        whole = whole.replace(other, "") if GROUPED[other].fullmatch(whole) else "?"
    return f"{whole}.{rest}"


def split_list(text: str) -> list[str]:
    """Split a text at its semicolons, or, where there is none, at its commas; empty parts are left out."""
    parts = text.split(";" if ";" in text else ",")
    return [part.strip() for part in parts if part.strip()]


class NumberField(ui.number):
    """Field of a number, in which either decimal mark may be typed.

    A field of the browser's own kind drops a comma where its language has a point: 1,5 would become 15. What
    is no number is the value NaN, which every request refuses.
    """

    def __init__(self, *args: Any, **values: Any) -> None:  # noqa: ANN401 (those of a number field)
        self.typed = ""
        self.usual: float | None = None
        super().__init__(*args, **values)
        self.props("type=text inputmode=decimal role=spinbutton autocomplete=off")

    @property
    def number(self) -> float | None:
        """Number of the field; None where there is none."""
        return None if self.value is None or math.isnan(self.value) else float(self.value)

    def refusal(self, value: Any) -> str | None:  # noqa: ANN401 (a number, whole or not)
        """Say in one line why what is typed cannot be used; None if it can."""
        if value is None or not math.isnan(value):
            return None
        try:
            parse_number(self.typed)
        except InputError as error:
            allowed = retell(error.allowed or "1.5, 1,5")
            return _("{message} (allowed: {allowed})", message=retell(error.message), allowed=allowed)
        return None

    def sanitize(self) -> None:
        """Bound the number when the field is left; what is no number stays to be mended.

        An empty field shows the number that it stands for.
        """
        if self.value is None and self.usual is not None:
            self.value = self.usual
        elif self.number is not None:
            super().sanitize()

    def _handle_value_change(self, value: Any) -> None:  # noqa: ANN401 (as in its base)
        super()._handle_value_change(value)
        self.error = self.refusal(value)

    def _event_args_to_value(self, e: events.GenericEventArguments) -> float | None:
        self.typed = str(e.args or "")
        try:
            return parse_number(self.typed)
        except InputError:
            return math.nan

    def _value_to_model_value(self, value: Any) -> Any:  # noqa: ANN401 (as in its base)
        # what the server answers while somebody types is the text that is typed, not its number so far
        with suppress(InputError):
            if self.typed and parse_number(self.typed) == value:
                return self.typed
        return self.typed if value is not None and math.isnan(value) else super()._value_to_model_value(value)


class Slider(ui.slider):
    """Slider whose place is the browser's; the server moves it only where something else changes the value.

    NiceGUI's own is moved by what the server answers. An answer to a former value then comes while somebody
    presses a key again, and takes the slider back: the next press begins there, and a step is lost.
    """

    LOOPBACK = False

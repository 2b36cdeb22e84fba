"""TOML text with tables of numbers one row to a line, which the general writers spread over many."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

_WIDTH = 110
_BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(document: Mapping[str, Any]) -> str:
    """A document as TOML: plain values first, then one block per table.

    Args:
        document: Texts, booleans, numbers, lists and tables of them, tables one level deep as blocks.
    """
    lines = [f"{_key(k)} = {_value(v)}" for k, v in document.items() if not isinstance(v, Mapping)]
    for name, block in document.items():
        if isinstance(block, Mapping):
            lines += ["", f"[{_key(name)}]", *(f"{_key(k)} = {_value(v)}" for k, v in block.items())]
    return "\n".join(lines) + "\n"


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else _text(key)


def _text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _number(value: float) -> str:
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    if math.isnan(value):
        return "nan"
    whole = value == int(value) and abs(value) < 1e15 and not (value == 0 and math.copysign(1.0, value) < 0)
    return str(int(value)) if whole else repr(value)


def _value(value: object) -> str:
    match value:
        case bool():
            text = "true" if value else "false"
        case int():
            text = str(value)
        case float():
            text = _number(value)
        case str():
            text = _text(value)
        case Mapping():
            inner = ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items())
            text = f"{{ {inner} }}" if inner else "{}"
        case list() | tuple():
            text = _list(value)
        case _:
            raise TypeError(f"TOML has no place for {type(value).__name__}")
    return text


def _list(value: Sequence[object]) -> str:
    items = [_value(item) for item in value]
    flat = "[" + ", ".join(items) + "]"
    nested = any(isinstance(item, (Mapping, list, tuple)) for item in value)
    if not nested and len(flat) <= _WIDTH:
        return flat
    return "[\n" + "".join(f"  {item},\n" for item in items) + "]"

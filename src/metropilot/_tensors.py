"""Reading safetensors that may be damaged or hostile: everything is checked, nothing executed.

A file is eight bytes with the length of a JSON header, the header, and the numbers. Memory is bounded by the
limits given, not by what the file claims.
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from metropilot._io import atomic_write
from metropilot.errors import InputError

KEY = "metropilot"
MAX_HEADER = 1 << 20
MAX_NUMBERS = 1 << 40
DTYPES = {
    "F32": np.float32,
    "F64": np.float64,
    "I32": np.int32,
    "I64": np.int64,
    "U32": np.uint32,
    "BOOL": np.bool_,
}


def read_tensors(path: Path, max_bytes: int) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """The arrays of a file and its metadata.

    Args:
        path: The file.
        max_bytes: Refuse anything larger.

    Raises:
        InputError: The file cannot be read, is too large, damaged, or not ours.
    """
    data = _content(path, max_bytes)
    header, start = _header(path, data)
    metadata = _metadata(path, header.pop("__metadata__", None))
    body = memoryview(data)[start:]
    spans, arrays = [], {}
    for name, entry in header.items():
        dtype, shape, begin, end = _entry(path, name, entry, len(body))
        spans.append((begin, end))
        arrays[name] = np.frombuffer(body[begin:end], dtype).reshape(shape).copy()
    reached = 0
    for begin, end in sorted(spans):
        if begin != reached:
            raise InputError("numbers overlap or have gaps", file=path)
        reached = end
    if reached != len(body):
        raise InputError(
            "numbers are missing or left over", file=path, value=len(body), allowed=f"{reached} bytes"
        )
    return arrays, metadata


def write_tensors(path: Path, arrays: dict[str, np.ndarray], metadata: dict[str, Any]) -> None:
    """Write arrays and metadata, whole or not at all; equal input gives equal bytes.

    Args:
        path: File to write.
        arrays: By name, of the types in :data:`DTYPES`.
        metadata: Plain values; one JSON string under one key, because several keys have no fixed order.

    Raises:
        InputError: The file cannot be written.
    """
    from safetensors import SafetensorError
    from safetensors.numpy import save_file

    text = json.dumps(metadata, sort_keys=True, separators=(",", ":"), allow_nan=False)
    whole = {name: np.asarray(array, order="C") for name, array in arrays.items()}

    def write(partial: Path) -> None:
        try:
            save_file(whole, partial, {KEY: text})
        except SafetensorError as error:
            raise OSError(0, str(error)) from None

    atomic_write(path, write)


def _content(path: Path, max_bytes: int) -> bytes:
    """Content of the file; of a device or a pipe, nothing."""
    try:
        if path.exists() and not path.is_file():
            raise OSError(0, "not a file")
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            data = file.read(min(size, max_bytes) + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("cannot read the file", file=path, value=reason) from None
    if size > max_bytes or len(data) > size:
        raise InputError("too large", file=path, value=size, unit="bytes", allowed=f"at most {max_bytes}")
    return data


def _header(path: Path, data: bytes) -> tuple[dict[str, Any], int]:
    """The header and where the numbers begin."""
    length = int.from_bytes(data[:8], "little") if len(data) >= 8 else -1
    if not 2 <= length <= min(MAX_HEADER, len(data) - 8):
        raise InputError("not a safetensors file, or cut short", file=path)
    header = _json(path, data[8 : 8 + length])
    if not isinstance(header, dict):
        raise InputError("not a safetensors file", file=path)
    return header, 8 + length


def _metadata(path: Path, found: object) -> dict[str, Any]:
    """Our metadata."""
    text = found.get(KEY) if isinstance(found, dict) else None
    metadata = _json(path, text.encode(errors="surrogatepass")) if isinstance(text, str) else None
    if not isinstance(metadata, dict):
        raise InputError("has no metropilot metadata", file=path)
    return metadata


def _json(path: Path, text: bytes) -> object:
    """JSON, or one line that says it is not."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        raise InputError("its header is damaged", file=path) from None


def _entry(path: Path, name: str, entry: object, size: int) -> tuple[type, tuple[int, ...], int, int]:
    """Type, shape and place of one array, checked against the file's size."""
    problem = InputError("array is damaged", file=path, field=name[:100])
    if not isinstance(entry, dict) or entry.get("dtype") not in tuple(DTYPES):
        raise problem
    shape, offsets = _counts(entry.get("shape")), _counts(entry.get("data_offsets"))
    if shape is None or offsets is None or len(offsets) != 2 or len(shape) > 32:
        raise problem
    dtype, (begin, end) = DTYPES[entry["dtype"]], offsets
    if math.prod(max(n, 1) for n in shape) > MAX_NUMBERS:
        raise problem
    if not begin <= end <= size or math.prod(shape) * np.dtype(dtype).itemsize != end - begin:
        raise problem
    return dtype, tuple(shape), begin, end


def _counts(values: object) -> list[int] | None:
    """A list of whole numbers that are not negative, or None if it is not one."""
    if isinstance(values, list) and all(type(value) is int and value >= 0 for value in values):
        return values
    return None

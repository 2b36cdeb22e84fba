"""TensorBoard event files, written by hand: a chain of records, each one protobuf ``Event``.

A record is its length (uint64), a masked CRC-32C of that, the event, and a masked CRC-32C of the event. Of
``Event`` the fields wall_time (1, double), step (2, varint), file_version (3, string) and summary (5) are
used; a summary's value has tag (1) and simple_value (2, float).
"""

from __future__ import annotations

import os
import socket
import struct
import time
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import TracebackType


@cache
def _table() -> tuple[int, ...]:
    """CRC-32C (Castagnoli) of every byte."""
    rows = []
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = (value >> 1) ^ (0x82F63B78 if value & 1 else 0)
        rows.append(value)
    return tuple(rows)


def masked_crc(data: bytes) -> int:
    """CRC-32C, rotated and shifted as TensorFlow's records want it."""
    table, crc = _table(), 0xFFFFFFFF
    for byte in data:
        crc = table[(crc ^ byte) & 0xFF] ^ (crc >> 8)
    crc ^= 0xFFFFFFFF
    return (((crc >> 15) | (crc << 17)) + 0xA282EAD8) & 0xFFFFFFFF


def _varint(number: int) -> bytes:
    out = bytearray()
    while number > 0x7F:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*out, number])


def _chunk(field: int, data: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(data)) + data


def _event(wall_time: float, rest: bytes) -> bytes:
    event = b"\x09" + struct.pack("<d", wall_time) + rest
    length = struct.pack("<Q", len(event))
    return length + struct.pack("<I", masked_crc(length)) + event + struct.pack("<I", masked_crc(event))


class EventWriter:
    """Scalars for TensorBoard; a context manager.

    Args:
        folder: Folder of the event file; made if it is not there.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        name = f"events.out.tfevents.{time.time():.0f}.{socket.gethostname()}.{os.getpid()}.metropilot"
        self.path = folder / name
        self._file = self.path.open("ab")
        self._file.write(_event(time.time(), _chunk(3, b"brain.Event:2")))

    def write(self, step: int, numbers: Mapping[str, float]) -> None:
        """Write one value of each measure.

        Args:
            step: Environment steps so far.
            numbers: By tag.
        """
        values = (
            _chunk(1, tag.encode()) + b"\x15" + struct.pack("<f", value) for tag, value in numbers.items()
        )
        summary = b"".join(_chunk(1, value) for value in values)
        self._file.write(_event(time.time(), b"\x10" + _varint(step) + _chunk(5, summary)))
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> "EventWriter":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

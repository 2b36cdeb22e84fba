"""Reading a text file somebody gives us: no more of it than a description can have, and never from a pipe."""

from __future__ import annotations

import os
from pathlib import Path

from metropilot.errors import InputError

MOST_BYTES = 32 << 20


def file_text(path: Path, field: str | None = None) -> str:
    """The text of a file.

    Args:
        path: The file.
        field: The option or argument that names it, for the error.

    Raises:
        InputError: It cannot be read, is a device or a pipe, is larger than 32 MiB, or is not UTF-8.
    """
    try:
        if path.exists() and not path.is_file():
            raise OSError(0, "not a file")
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            data = file.read(MOST_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"cannot be read ({reason})", file=path, field=field, allowed="a readable file"
        ) from None
    if len(data) > MOST_BYTES:
        allowed = f"at most {MOST_BYTES}"
        raise InputError("too large", file=path, field=field, value=size, unit="bytes", allowed=allowed)
    try:
        return data.decode("utf-8").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise InputError("not UTF-8 text", file=path, field=field, allowed="UTF-8") from None

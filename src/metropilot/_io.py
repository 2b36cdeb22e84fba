"""Files, folders, locks and databases that survive a process killed at any moment.

Everything that metropilot keeps is written here: a file by :func:`atomic_write`, a folder of results by
:func:`fill_folder`, plain values that take long to compute by :func:`load_or_compute`. Two processes exclude
each other by :func:`hold_lock`, and share rows by :func:`open_database`.
"""

from __future__ import annotations

import json
import math
import os
import secrets
import shutil
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

from metropilot.errors import InputError

MAX_TEXT_BYTES = 32 << 20
"""Most that :func:`read_text` reads: no line, trainset or campaign needs more."""
DATABASE_TIMEOUT_S = 30.0
"""Longest wait for another process's transaction."""
RESULTS = (
    *("trajectory.csv", "comparison.json", "convoy.svg", "line.json", "day.json"),
    *("checkpoint.safetensors", "history.parquet"),
)
"""One file of each kind of results, of those that share a name: ``run.toml``, ``kpis.json``, pictures."""
LOCK_ATTEMPTS = 20
LOCK_PAUSE_S = 0.05
"""Asking whether a lock is held takes it for a moment, so one refusal does not mean that it is held."""


def atomic_write(path: Path, write: Callable[[Path], object]) -> None:
    """Write a file beside its destination, force it to the disk, and move it there.

    Whatever happens meanwhile (Ctrl-C, kill -9, a power cut), ``path`` is the old file or the new one.

    Args:
        path: Destination; its folder is made.
        write: Writes the file it is given.

    Raises:
        InputError: The file cannot be written.
    """
    # a name of its own: others may write the same file at the same time
    partial = path.with_name(f".{path.name}.{secrets.token_hex(4)}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(partial)
        _sync(partial)
        partial.replace(path)
        if os.name == "posix":
            _sync(path.parent)
    except OSError as error:
        raise InputError("cannot write the file", file=path, value=error.strerror) from None
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def read_text(path: Path, field: str | None = None) -> str:
    """Read a text file that a user names: never a pipe, and never more than a description can need.

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
            data = file.read(MAX_TEXT_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"cannot be read ({reason})", file=path, field=field, allowed="a readable file"
        ) from None
    if len(data) > MAX_TEXT_BYTES:
        allowed = f"at most {MAX_TEXT_BYTES}"
        raise InputError("too large", file=path, field=field, value=size, unit="bytes", allowed=allowed)
    try:
        return data.decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError:
        raise InputError("not UTF-8 text", file=path, field=field, allowed="UTF-8") from None


def _sync(path: Path) -> None:
    """Force what was written to the disk (a folder: its entries)."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def fill_folder(folder: Path) -> Iterator[Path]:
    """Scratch folder whose files move into ``folder`` together, once all of them are written.

    The files are written beside their destination and renamed over it one by one, so that an earlier result
    is whole until a new one is, whatever goes wrong while drawing or writing. ``run.toml`` moves last.

    Raises:
        InputError: The folder cannot be made or written.
    """
    scratch = None
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            scratch = Path(tempfile.mkdtemp(prefix=".metropilot-", dir=folder))
        except OSError as error:
            raise InputError(
                "cannot write to the folder", file=folder, field="out", value=error.strerror
            ) from None
        try:
            yield scratch
            for path in sorted(scratch.iterdir(), key=lambda p: p.name == "run.toml"):
                path.replace(folder / path.name)
        except OSError as error:
            place = error.filename2 or error.filename or folder
            raise InputError("cannot write the file", file=place, value=error.strerror) from None
    finally:
        if scratch is not None:
            shutil.rmtree(scratch, ignore_errors=True)


def check_writable(folder: Path, result: str | None = None) -> None:
    """Find out before a long computation whether its results can be written.

    Args:
        folder: Folder for them.
        result: Of ``RESULTS``: the file among them that stands for their kind; None: no other kind has
            files of their names.

    Raises:
        InputError: The folder cannot be made or written, or holds results of another kind.
    """
    others = [] if result is None else [name for name in RESULTS if (folder / name).exists()]
    if others and result not in others:
        raise InputError(
            "the folder holds results of another kind",
            file=folder,
            field="out",
            value=others[0],
            allowed="another folder",
        )
    with fill_folder(folder):
        pass


def to_json(values: object) -> str:
    """JSON text that can be written as UTF-8; a number that is not finite becomes null."""

    def plain(value: object) -> object:
        if isinstance(value, Mapping):
            return {str(key): plain(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [plain(item) for item in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    text = json.dumps(plain(values), indent=2, ensure_ascii=False, allow_nan=False)
    return text.encode(errors="backslashreplace").decode()


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write a JSON object; a number that is not finite becomes null."""
    path.write_text(to_json(values) + "\n", encoding="utf-8")


def encode_parquet(columns: Mapping[str, str], rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Encode rows as a Parquet file with these columns in this order; the same rows give the same bytes."""
    import duckdb

    with tempfile.TemporaryDirectory(prefix="metropilot-") as folder:
        source, target = Path(folder) / "rows.json", Path(folder) / "rows.parquet"
        source.write_text(
            "".join(json.dumps({n: _plain_cell(r.get(n)) for n in columns}) + "\n" for r in rows)
        )
        kinds = ", ".join(f"'{name}': '{kind}'" for name, kind in columns.items())
        with duckdb.connect(config={"threads": 1}) as database:
            database.execute(
                f"COPY (SELECT * FROM read_json('{source}', format='newline_delimited', "
                f"columns={{{kinds}}})) TO '{target}' (FORMAT parquet, COMPRESSION zstd)"
            )
        return target.read_bytes()


def _plain_cell(value: object) -> object:
    """A value for JSON: NumPy scalars as Python numbers, infinity and NaN as None."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if hasattr(value, "item"):
        value = value.item()  # pyright: ignore[reportAttributeAccessIssue]
    if isinstance(value, float) and value in (float("inf"), float("-inf")):
        return None
    return None if value != value else value  # noqa: PLR0124 (NaN)


def load_or_compute(path: Path, identity: Mapping[str, Any], compute: Callable[[], Any]) -> Any:  # noqa: ANN401 (whatever JSON holds)
    """Value that JSON can hold: from its file if that is of the same identity, else computed and written.

    Args:
        path: NAME.json.
        identity: Plain values that determine the result; where one differs from the file's, it is computed.
        compute: Computes the value.

    Raises:
        InputError: The file cannot be written.
    """
    wanted = json.loads(json.dumps(dict(identity)))
    try:
        found = json.loads(path.read_text())
        if found["about"] == wanted:
            return found["value"]
    except (OSError, ValueError, KeyError, TypeError):
        pass
    value = compute()
    atomic_write(path, lambda partial: partial.write_text(json.dumps({"about": wanted, "value": value})))
    return value


@contextmanager
def hold_lock(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, which ends with its process, however that ends.

    The lock is on the folder itself: nothing is left behind.

    Raises:
        InputError: Another process holds it.
    """
    for _ in range(LOCK_ATTEMPTS):
        descriptor = _lock(folder)
        if descriptor is not None:
            break
        time.sleep(LOCK_PAUSE_S)
    else:
        raise InputError("another process is learning in this folder", file=folder, field="resume")
    try:
        yield
    finally:
        if descriptor >= 0:
            os.close(descriptor)


def is_locked(folder: Path) -> bool:
    """True if a process holds a folder's lock, or folders cannot be locked here."""
    if os.name != "posix":
        return True
    try:
        descriptor = _lock(folder)
    except OSError:
        return False
    if descriptor is None or descriptor < 0:
        return True
    os.close(descriptor)
    return False


def _lock(folder: Path) -> int | None:
    """Descriptor that holds the lock; None where another does, -1 where there are no such locks."""
    if os.name != "posix":
        return -1
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return None
    except OSError:
        os.close(descriptor)
        return -1
    return descriptor


@contextmanager
def open_database(path: Path) -> Iterator[sqlite3.Connection]:
    """SQLite file in one transaction, shared by any number of processes; its folder is made.

    Raises:
        sqlite3.DatabaseError: The file is damaged.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with closing(sqlite3.connect(path, timeout=DATABASE_TIMEOUT_S)) as database, database:
        database.execute("PRAGMA journal_mode = WAL")
        yield database

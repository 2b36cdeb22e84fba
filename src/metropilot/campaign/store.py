"""Folder of a campaign: shards written atomically, and a list of those done; safe against ``kill -9``.

A shard consists of two Parquet files. Each is written to a temporary file and renamed; then a line with its
number, rows and checksum is appended to the list and synced to disk. After a crash in between, a file without
its line is written again with the same bits; an incomplete line is ignored.
"""

from __future__ import annotations

import json
import os
import re
from hashlib import sha256
from pathlib import Path

from metropilot._io import atomic_write
from metropilot.campaign.matrix import AbstractCampaign, Piece, Shard, from_text
from metropilot.errors import InputError

ABOUT_FILE, DONE_FILE = "campaign.json", "done.txt"
LINE = re.compile(r"[0-9A-Za-z_.:=-]{1,80} [0-9]{1,9} [0-9]{1,9} [0-9]{1,18} [0-9a-f]+")
PARTS_FOLDER, TIMINGS_FOLDER = "parts", "timings"


class CampaignStore:
    """A campaign's folder, written by one process.

    Args:
        folder: Created if missing; a campaign with the same cells in it is resumed, also with other
            groups.
        campaign: The campaign.

    Raises:
        InputError: The folder cannot be written, or holds another campaign.
    """

    def __init__(self, folder: Path, campaign: AbstractCampaign) -> None:
        self.folder, self.campaign = folder, campaign
        about = folder / ABOUT_FILE
        try:
            for name in (PARTS_FOLDER, TIMINGS_FOLDER):
                (folder / name).mkdir(parents=True, exist_ok=True)
            files = (self._check(about) if about.exists() else {}) | dict(campaign.group_files)
            values = {"digest": campaign.digest, "campaign": json.loads(campaign.text)}
            values |= {"files": files} if files else {}
            if not about.exists() or json.loads(about.read_text()) != values:
                atomic_write(about, lambda partial: partial.write_text(json.dumps(values, indent=1)))
        except OSError as error:
            raise InputError(
                "cannot write to the folder", file=folder, field="out", value=error.strerror
            ) from None

    def _check(self, about: Path) -> dict[str, str]:
        """Refuse the folder of another campaign; return the files of its groups, each with its content."""
        files: dict[str, str] = {}
        try:
            told = json.loads(about.read_text())
            found, files = told["digest"], dict(told.get("files", {}))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            found = "unreadable"
        if found != self.campaign.digest:
            raise InputError(
                "the folder holds another campaign",
                file=self.folder,
                field="out",
                value=found,
                allowed=f"an empty folder, or one of campaign {self.campaign.digest}",
            )
        for name, content in self.campaign.group_files.items():
            if files.get(name, content) != content:
                raise InputError(
                    "a file has changed since the folder was begun",
                    file=self.folder,
                    field="out",
                    value=name,
                    allowed="an empty folder, or the file as it was",
                )
        return files

    def finished_shards(self) -> dict[Piece, str]:
        """Shards that are done, each with its checksum: listed, with a file of the listed size."""
        path, found = self.folder / DONE_FILE, {}
        text = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
        lines = text.splitlines(keepends=True)
        pieces = {(key_of(piece.group), piece.chunk): piece for piece in self.campaign.pieces()}
        for line in lines:
            words = line.split()
            if not line.endswith("\n") or len(words) != 5 or not words[1].isdigit():
                continue
            piece, rows, size, checksum = pieces.get((words[0], int(words[1]))), *words[2:]
            if piece is None or rows != str(len(self.campaign.shard(piece))):
                continue
            part = self.part(piece)
            if part.exists() and str(part.stat().st_size) == size and self.timing(piece).exists():
                found[piece] = checksum
        return found

    def finished_rows(self) -> int:
        """Number of rows of the shards that are done."""
        return sum(len(self.campaign.shard(piece)) for piece in self.finished_shards())

    def part(self, piece: Piece) -> Path:
        """Path of the results of a shard."""
        return self.folder / PARTS_FOLDER / key_of(piece.group) / f"{piece.chunk:06d}.parquet"

    def timing(self, piece: Piece) -> Path:
        """Path of the timings of a shard."""
        return self.folder / TIMINGS_FOLDER / key_of(piece.group) / f"{piece.chunk:06d}.parquet"

    def keep(self, shard: Shard) -> None:
        """Write a shard, then its line in the list.

        Raises:
            InputError: It cannot be written.
        """
        try:
            piece = shard.piece
            atomic_write(self.timing(piece), lambda partial: partial.write_bytes(shard.timings))
            atomic_write(self.part(piece), lambda partial: partial.write_bytes(shard.results))
            checksum = sha256(shard.results).hexdigest()[:16]
            path = self.folder / DONE_FILE
            torn = _torn(path)
            words = (key_of(piece.group), piece.chunk, shard.rows, len(shard.results), checksum)
            with path.open("a") as file:
                file.write("\n" * torn + " ".join(map(str, words)) + "\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise InputError(
                "cannot write the shard", file=self.folder, field="out", value=error.strerror
            ) from None

    def checksum(self) -> str:
        """One checksum of all results in the order of the rows; the same for every pool of workers."""
        done = self.finished_shards()
        words = (
            f"{piece.group} {piece.chunk} {done[piece]}" for piece in self.campaign.pieces() if piece in done
        )
        return sha256("\n".join(words).encode()).hexdigest()[:16]


def _torn(path: Path) -> bool:
    """True if a list ends in the middle of a line; reads its last byte only."""
    if not path.exists() or path.stat().st_size == 0:
        return False
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read(1) != b"\n"


def key_of(group: str) -> str:
    """Name of the folder of a group."""
    plain = "".join(letter if letter.isalnum() or letter == "_" else "-" for letter in group)[:40]
    return plain if plain == group else f"{plain}-{sha256(group.encode()).hexdigest()[:8]}"


def campaign_of_folder(folder: Path) -> AbstractCampaign:
    """The campaign of a folder.

    Raises:
        InputError: Not the folder of a campaign.
    """
    try:
        found = json.loads((folder / ABOUT_FILE).read_text())
        campaign = from_text(json.dumps(found["campaign"]))
        known = campaign.rows > 0 and found["digest"] == campaign.digest
        whole = known and len(set(campaign.groups)) == len(campaign.groups)
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        campaign, whole = None, False
    if campaign is None or not whole:
        raise InputError("not the folder of a campaign", file=folder, field="campaign")
    return campaign

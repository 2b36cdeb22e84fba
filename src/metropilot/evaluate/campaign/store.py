"""The folder of a campaign: shards written whole, and a list of those done; kill -9 loses or doubles nothing.

A shard arrives as two Parquet files. Each is written beside its place and renamed into it; then a line with
its number, rows and checksum goes to the end of the list and to the disk. Killed in between, a file without
its line is written again, over itself, with the same bits; a torn line counts for nothing.
"""

from __future__ import annotations

import json
import os
import re
from hashlib import sha256
from pathlib import Path

from metropilot.errors import InputError
from metropilot.evaluate.campaign.declared import Campaign, from_text
from metropilot.evaluate.campaign.rows import Shard
from metropilot.railway.whole_file import write_whole

ABOUT, DONE = "campaign.json", "done.txt"
LINE = re.compile(r"[0-9]{1,9} [0-9]{1,9} [0-9]{1,18} [0-9a-f]+")
PARTS, TIMINGS = "parts", "timings"


class Store:
    """A campaign's folder, written by one process.

    Args:
        folder: Made if it is not there; one with the same campaign in it is gone on with.
        campaign: What it is for.

    Raises:
        InputError: The folder cannot be written, or holds another campaign.
    """

    def __init__(self, folder: Path, campaign: Campaign) -> None:
        self.folder, self.campaign = folder, campaign
        about = folder / ABOUT
        try:
            for name in (PARTS, TIMINGS):
                (folder / name).mkdir(parents=True, exist_ok=True)
            if about.exists():
                self._check(about)
            else:
                values = {"digest": campaign.digest, "campaign": json.loads(campaign.text)}
                write_whole(about, lambda partial: partial.write_text(json.dumps(values, indent=1)))
        except OSError as error:
            raise InputError(
                "cannot write to the folder", file=folder, field="out", value=error.strerror
            ) from None

    def _check(self, about: Path) -> None:
        try:
            found = json.loads(about.read_text())["digest"]
        except (ValueError, KeyError, TypeError, RecursionError):
            found = "unreadable"
        if found != self.campaign.digest:
            raise InputError(
                "the folder holds another campaign",
                file=self.folder,
                field="out",
                value=found,
                allowed=f"an empty folder, or one of campaign {self.campaign.digest}",
            )

    def done(self) -> dict[int, str]:
        """Shards that are done, each with its checksum: listed, and their file as long as it was then."""
        path, found = self.folder / DONE, {}
        text = path.read_text(encoding="utf-8", errors="replace") if path.exists() else ""
        lines = text.splitlines(keepends=True)
        for line in lines:
            words = line.split()
            if not line.endswith("\n") or not LINE.fullmatch(line.strip()):
                continue
            number, rows, size, checksum = int(words[0]), int(words[1]), int(words[2]), words[3]
            part = self.part(number)
            whole = part.exists() and part.stat().st_size == size and self.timing(number).exists()
            if number < self.campaign.shards and rows == len(self.campaign.shard(number)) and whole:
                found[number] = checksum
        return found

    def part(self, number: int) -> Path:
        """Where the results of a shard are."""
        return self.folder / PARTS / f"{number:06d}.parquet"

    def timing(self, number: int) -> Path:
        """Where its timings are."""
        return self.folder / TIMINGS / f"{number:06d}.parquet"

    def keep(self, shard: Shard) -> None:
        """Write a shard, and then its line.

        Raises:
            InputError: The disk does not take it.
        """
        try:
            write_whole(self.timing(shard.number), lambda partial: partial.write_bytes(shard.timings))
            write_whole(self.part(shard.number), lambda partial: partial.write_bytes(shard.results))
            checksum = sha256(shard.results).hexdigest()[:16]
            path = self.folder / DONE
            torn = path.exists() and path.stat().st_size > 0 and not path.read_bytes().endswith(b"\n")
            with path.open("a") as file:
                file.write("\n" * torn + f"{shard.number} {shard.rows} {len(shard.results)} {checksum}\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise InputError(
                "cannot write the shard", file=self.folder, field="out", value=error.strerror
            ) from None

    def checksum(self) -> str:
        """One checksum of all results, in the order of the rows; the same whoever drove them."""
        done = self.done()
        return sha256(" ".join(f"{k} {done[k]}" for k in sorted(done)).encode()).hexdigest()[:16]


def stored_campaign(folder: Path) -> Campaign:
    """The campaign a folder is of.

    Raises:
        InputError: It is of none.
    """
    try:
        found = json.loads((folder / ABOUT).read_text())
        campaign = from_text(json.dumps(found["campaign"]))
        whole = campaign.rows > 0 and found["digest"] == campaign.digest
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        campaign, whole = None, False
    if campaign is None or not whole:
        raise InputError("not the folder of a campaign", file=folder, field="campaign")
    return campaign

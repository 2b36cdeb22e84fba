"""Campaigns of drives: declared by values of their files, computed shard by shard, read row by row."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from metropilot._io import atomic_write
from metropilot.campaign import (
    AbstractCampaign,
    CampaignProgress,
    CampaignRows,
    CampaignStore,
    campaign_from_values,
    collect_parts,
    restore_rows,
    rows_of_folder,
    run_campaign,
)
from metropilot.errors import InputError
from metropilot.evaluate import POLICY, parse_driver
from metropilot.web.store import JobStore
from metropilot.web.work.drives import folder_of

DECLARED = Path("campaign")
"""Name of the file in errors."""
ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}(@[0-9.]{1,8},[0-9.]{1,8})?")
LONGEST = {
    "drivers": 40,
    "sections": 200,
    "trainsets": 100,
    "loads": 20,
    "times": 20,
    "periods": 10,
    "actuation": 20,
}
"""Entries of each list of a matrix at most."""
DRAWN = 1000
"""Random trainsets at most."""
FOLDER = "rows"
"""Folder of the shards within that of the job."""
RESULTS = "results.parquet"


def file_values(values: dict[str, Any], path: Callable[[str, str], str]) -> dict[str, Any]:
    """Values of a campaign's file from those of a request.

    Args:
        values: The request.
        path: Function from a kind (line, trainset, policy) and an id to a file, or the id itself.

    Raises:
        InputError: A list is too long, a name is no id, or there is no such policy.
    """
    matrix = dict(values["matrix"])
    for name, most in LONGEST.items():
        if isinstance(matrix.get(name), list | tuple) and len(matrix[name]) > most:
            told = {"value": len(matrix[name]), "allowed": f"at most {most}"}
            raise InputError("too many", field=f"matrix.{name}", **told)
    if isinstance(matrix["drivers"], list | tuple):
        matrix["drivers"] = [_driver(name, path) for name in matrix["drivers"]]
    matrix["sections"] = [_section(text, path) for text in matrix["sections"]]
    trainsets = matrix.get("trainsets", ["dkz32"])
    trainsets = trainsets if isinstance(trainsets, list | tuple) else [trainsets]
    matrix["trainsets"] = [_trainset(each, path) for each in trainsets]
    return {**values, "matrix": matrix}


def _id(text: str, field: str) -> str:
    if not ID.fullmatch(text):
        raise InputError("not an id", field=field, value=text[:80], allowed="the id of an entry, no file")
    return text


def _driver(text: str, path: Callable[[str, str], str]) -> str:
    driver, options = parse_driver(text)
    _id(driver, "matrix.drivers")
    if POLICY in options:
        options[POLICY] = path(POLICY, _id(str(options[POLICY]), "matrix.drivers"))
    return ":".join([driver, *(f"{name}={value}" for name, value in options.items())])


def _section(text: str, path: Callable[[str, str], str]) -> str:
    try:
        line, *stations = shlex.split(text)
    except ValueError:
        allowed = "LINE, or LINE ORIGIN DESTINATION"
        raise InputError("not a section", field="matrix.sections", value=text[:80], allowed=allowed) from None
    return shlex.join([path("line", _id(line, "matrix.sections")), *stations])


def _trainset(each: Any, path: Callable[[str, str], str]) -> Any:  # noqa: ANN401 (an id, or a number to draw)
    if isinstance(each, str):
        return path("trainset", _id(each, "matrix.trainsets"))
    if each["drawn"] > DRAWN:
        told = {"value": each["drawn"], "allowed": f"at most {DRAWN}"}
        raise InputError("too many", field="matrix.trainsets.drawn", **told)
    return each


def read_declared(values: dict[str, Any], most: int) -> AbstractCampaign:
    """Read a campaign from the values of its file.

    Args:
        values: From :func:`file_values`.
        most: Rows at most.

    Raises:
        InputError: Something in it cannot be used, or it has too many rows.
    """
    campaign = campaign_from_values(DECLARED, values)
    if campaign.rows > most:
        allowed = f"at most {most}; set matrix.sample"
        raise InputError("too many rows", field="matrix", value=campaign.rows, allowed=allowed)
    return campaign


def campaign_job(root: str, job: str, values: dict[str, Any]) -> dict[str, Any]:
    """Compute the rows that the job's folder does not hold yet, until it is asked to stop."""
    store, folder = JobStore(Path(root)), folder_of(root, job)
    campaign = campaign_from_values(DECLARED, values)
    done = CampaignStore(folder / FOLDER, campaign).finished_rows()
    store.begin(job, f"{done} of {campaign.rows} rows", done / campaign.rows)

    def say(progress: CampaignProgress) -> None:
        words = f"{progress.rows} of {progress.total} rows"
        store.update(job, progress=progress.rows / progress.total, words=words)
        if store.stop_requested(job):
            raise KeyboardInterrupt

    told = {"campaign": campaign.name, "rows": campaign.rows}
    try:
        done = run_campaign(campaign, folder / FOLDER, workers=1, say=say).rows
    except KeyboardInterrupt:
        return told | {"stopped": True, "done": round(store.job(job).progress * campaign.rows)}
    _collect(root, folder, campaign)
    return told | {"stopped": False, "done": done}


def _collect(root: str, folder: Path, campaign: AbstractCampaign) -> None:
    """Write the rows of a whole campaign as one file each, the second without paths."""
    collect_parts(folder / FOLDER)
    shown = CampaignRows(folder / FOLDER, campaign)
    atomic_write(folder / RESULTS, lambda partial: shown.write(partial, {f"{root}/": ""}))


def archived_rows(folder: Path, values: dict[str, Any], ids: Mapping[str, str], *, whole: bool) -> bytes:
    """Rows of a campaign as one file, files by their ids.

    Args:
        folder: Folder of the job.
        values: The campaign, from :func:`file_values`.
        ids: Ids by file.
        whole: True if every row is computed; if not, a campaign whose lines or trainsets are others now has
            no rows to go on from.

    Raises:
        InputError: Nothing is computed, or a line, trainset or policy is there no more.
    """
    found = rows_of_folder(folder / FOLDER)
    if not whole and found.campaign.digest != campaign_from_values(DECLARED, values).digest:
        raise InputError("lines or trainsets were changed", field="campaign", value=found.campaign.name)
    names = {path: key for path, key in ids.items() if path in found.campaign.text}
    with TemporaryDirectory(prefix="metropilot-") as scratch:
        found.write(Path(scratch) / RESULTS, names)
        return (Path(scratch) / RESULTS).read_bytes()


def restore_job(root: str, job: str, values: dict[str, Any], ids: Mapping[str, str]) -> None:
    """Make the folder of a campaign from the file of :func:`archived_rows` in it.

    Args:
        root: Folder of the server's data.
        job: Id of the job.
        values: The campaign, from :func:`file_values`.
        ids: Files by the ids in the rows.

    Raises:
        InputError: The file is not of this campaign.
    """
    folder, campaign = folder_of(root, job), campaign_from_values(DECLARED, values)
    rows = folder / RESULTS
    count = restore_rows(campaign, folder / FOLDER, rows, ids)
    rows.unlink()
    if count == campaign.rows:
        _collect(root, folder, campaign)


def plain_rows(rows: list[dict[str, Any]], ids: Mapping[str, str]) -> list[dict[str, Any]]:
    """Rows for JSON: files by their ids, and no number that is not finite."""

    def plain(value: Any) -> Any:  # noqa: ANN401 (a cell)
        if isinstance(value, float) and not math.isfinite(value):
            return None
        if isinstance(value, str) and "/" in value:
            for path, key in ids.items():
                value = value.replace(path, key)
        return value

    return [{name: plain(value) for name, value in row.items()} for row in rows]

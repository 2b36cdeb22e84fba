"""Runner of a campaign: drives the shards that its folder does not hold yet."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import metropilot
from metropilot.campaign.declared import Campaign
from metropilot.campaign.pools import drive_locally, drive_on_cluster
from metropilot.campaign.rows import peak_memory_mb
from metropilot.campaign.store import CampaignStore
from metropilot.errors import InputError


class CampaignProgress(NamedTuple):
    """Progress of a campaign.

    Attributes:
        rows: Rows done, those of earlier calls included.
        total: Number of rows.
        driven: Rows done in this call.
        seconds: Duration of this call so far.
        memory_mb: Largest memory of the collecting process so far.
    """

    rows: int
    total: int
    driven: int
    seconds: float
    memory_mb: float


def run_campaign(
    campaign: Campaign,
    folder: Path,
    workers: int = 2,
    cluster: str | None = None,
    say: Callable[[CampaignProgress], object] = lambda progress: None,  # noqa: ARG005 (silent)
) -> CampaignProgress:
    """Drive every row that the folder does not hold yet.

    Args:
        campaign: The matrix.
        folder: Folder of the shards; a campaign in it is resumed.
        workers: Processes on this machine.
        cluster: Address of a Ray cluster, ``local`` to start one here; None: processes of this machine.
        say: Callback after each shard.

    Returns:
        The last progress.

    Raises:
        InputError: The folder holds another campaign, cannot be written, or there is no such cluster.
        WorkersDied: Workers died repeatedly.
    """
    if workers < 1:
        raise InputError("out of range", field="workers", value=workers, allowed=">= 1")
    store, began, driven = CampaignStore(folder, campaign), perf_counter(), 0
    done = store.done()
    rows = sum(len(campaign.shard(piece)) for piece in done)
    todo = [piece for piece in campaign.pieces() if piece not in done]
    progress = CampaignProgress(rows, campaign.rows, 0, 0.0, peak_memory_mb())
    if not todo:
        return progress
    if cluster is None:
        shards = drive_locally(campaign.text, todo, workers)
    else:
        shards = drive_on_cluster(campaign.text, todo, workers, cluster)
    for shard in shards:
        if shard.version != metropilot.__version__:
            raise InputError(
                "a worker has another version of metropilot",
                field="cluster",
                value=shard.version,
                allowed=metropilot.__version__,
            )
        store.keep(shard)
        driven += shard.rows
        progress = CampaignProgress(
            rows + driven, campaign.rows, driven, perf_counter() - began, peak_memory_mb()
        )
        say(progress)
    return progress

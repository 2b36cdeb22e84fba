"""A campaign from the first shard to the last, gone on with wherever it was left."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import metropilot
from metropilot.campaign.declared import Campaign
from metropilot.campaign.pools import on_a_cluster, on_this_machine, own_memory_mb
from metropilot.campaign.store import CampaignStore
from metropilot.errors import InputError


class CampaignProgress(NamedTuple):
    """How far a campaign is.

    Attributes:
        rows: Rows done, those of earlier sittings included.
        total: All of them.
        driven: Rows done in this sitting.
        seconds: Spent in this sitting.
        memory_mb: Largest memory of the process that collects, so far.
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
        folder: Where shards are kept; the same folder is gone on with.
        workers: Processes on this machine.
        cluster: Address of a Ray cluster, ``local`` for one begun here; None: processes of this machine.
        say: Called after each shard.

    Returns:
        The last progress.

    Raises:
        InputError: The folder holds another campaign, cannot be written, or there is no such cluster.
        WorkersDied: Workers died again and again.
    """
    if workers < 1:
        raise InputError("out of range", field="workers", value=workers, allowed=">= 1")
    store, began, driven = CampaignStore(folder, campaign), perf_counter(), 0
    done = store.done()
    rows = sum(len(campaign.shard(piece)) for piece in done)
    todo = [piece for piece in campaign.pieces() if piece not in done]
    progress = CampaignProgress(rows, campaign.rows, 0, 0.0, own_memory_mb())
    if not todo:
        return progress
    if cluster is None:
        shards = on_this_machine(campaign.text, todo, workers)
    else:
        shards = on_a_cluster(campaign.text, todo, workers, cluster)
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
            rows + driven, campaign.rows, driven, perf_counter() - began, own_memory_mb()
        )
        say(progress)
    return progress

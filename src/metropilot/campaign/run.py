"""Runner of a campaign: a pool of workers computes the shards that its folder does not hold yet."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import metropilot
from metropilot._processes import ONE_THREAD, environment
from metropilot.campaign.matrix import AbstractCampaign, Piece, Shard, compute_shard, peak_memory_mb
from metropilot.campaign.store import CampaignStore
from metropilot.errors import InputError, MetropilotError

RETRIES = 3
LOCAL = "local"
AHEAD = 2
"""Shards in flight for each worker."""


class WorkersDied(MetropilotError, RuntimeError):
    """Workers died repeatedly; finished shards are kept."""


def drive_locally(text: str, shards: Sequence[Piece], workers: int) -> Iterator[Shard]:
    """Compute shards in processes of this machine, each on one thread; one that dies is replaced.

    Args:
        text: The campaign.
        shards: Shards to compute.
        workers: Number of processes.

    Raises:
        WorkersDied: Processes died ``RETRIES`` times without a shard in between.
    """
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    left, deaths = dict.fromkeys(shards), 0
    while left:
        with environment(ONE_THREAD):
            pool: Any = Parallel(
                n_jobs=max(min(workers, len(left)), 1),
                backend="loky",
                return_as="generator_unordered",
                batch_size=1,  # pyright: ignore[reportArgumentType]
                pre_dispatch=f"{AHEAD} * n_jobs",
            )
            driven = pool(delayed(compute_shard)(text, piece) for piece in tuple(left))
            try:
                for shard in driven:
                    del left[shard.piece]
                    deaths = 0
                    yield shard
            except TerminatedWorkerError:
                deaths += 1
                if deaths > RETRIES:
                    raise WorkersDied(
                        f"workers died {deaths} times; finished shards are kept, the same command resumes"
                    ) from None


def drive_on_cluster(text: str, shards: Sequence[Piece], workers: int, address: str) -> Iterator[Shard]:
    """Compute shards on a Ray cluster; a shard whose worker dies is computed again by another.

    Args:
        text: The campaign.
        shards: Shards to compute.
        workers: Processes, if the cluster is started here.
        address: Address of a running cluster, or ``local`` to start one on this machine.

    Raises:
        InputError: Ray is not installed, or the cluster cannot be reached.
        WorkersDied: The workers of a shard died repeatedly.
    """
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise InputError(
            "Ray is not installed", field="cluster", value=address, allowed="pip install 'metropilot[ray]'"
        ) from None
    begin: dict[str, Any] = {"address": address}
    if address == LOCAL:
        begin = {"address": "local", "num_cpus": workers, "include_dashboard": False}
    with environment({**ONE_THREAD, "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0"}):
        try:
            ray.init(
                **begin,
                log_to_driver=False,
                logging_level="ERROR",
                configure_logging=True,
                runtime_env={"env_vars": ONE_THREAD},
            )
        except (ConnectionError, RuntimeError, ValueError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(f"no such cluster ({reason})", field="cluster", value=address) from None
    try:
        yield from _from_ray(ray, text, shards)
    finally:
        ray.shutdown()


def _from_ray(ray: Any, text: str, shards: Sequence[Piece]) -> Iterator[Shard]:  # noqa: ANN401 (the module)
    remote = ray.remote(num_cpus=1, max_retries=RETRIES)(compute_shard)
    campaign = ray.put(text)
    ahead = AHEAD * max(int(ray.cluster_resources().get("CPU", 1)), 1)
    waiting, coming = list(reversed(shards)), {}
    while waiting or coming:
        while waiting and len(coming) < ahead:
            piece = waiting.pop()
            coming[remote.remote(campaign, piece)] = piece
        ready, _ = ray.wait(list(coming), num_returns=1)
        for reference in ready:
            del coming[reference]
            try:
                yield Shard(*ray.get(reference))
            except ray.exceptions.WorkerCrashedError as error:
                raise WorkersDied(f"{error}; finished shards are kept, the same command resumes") from None


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
    campaign: AbstractCampaign,
    folder: Path,
    workers: int = 2,
    cluster: str | None = None,
    say: Callable[[CampaignProgress], object] = lambda progress: None,  # noqa: ARG005 (silent)
) -> CampaignProgress:
    """Compute every row that the folder does not hold yet.

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
    done = store.finished_shards()
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

"""Where shards are driven: processes of this machine (joblib, loky), or a Ray cluster.

Both hand shards over as they come, in any order; what is in a shard does not depend on them. Few shards are
on their way at a time, so that memory stays flat however long the campaign is.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from typing import Any

from metropilot._processes import ONE_THREAD, environment
from metropilot.campaign.declared import Piece
from metropilot.campaign.rows import Shard, drive_shard
from metropilot.errors import InputError, MetropilotError

RETRIES = 3
LOCAL = "local"
AHEAD = 2
"""Shards on their way for each worker."""


class WorkersDied(MetropilotError, RuntimeError):
    """Workers died again and again; what is done is kept."""


def on_this_machine(text: str, shards: Sequence[Piece], workers: int) -> Iterator[Shard]:
    """Drive shards in processes of this machine, each on one thread; one that dies is replaced.

    Args:
        text: The campaign.
        shards: Which of its shards.
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
            driven = pool(delayed(drive_shard)(text, piece) for piece in tuple(left))
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


def on_a_cluster(text: str, shards: Sequence[Piece], workers: int, address: str) -> Iterator[Shard]:
    """Drive shards on a Ray cluster; a shard whose worker dies is driven again by another.

    Args:
        text: The campaign.
        shards: Which of its shards.
        workers: Processes, where the cluster is begun here.
        address: Of a running cluster, or ``local`` to begin one on this machine.

    Raises:
        InputError: Ray is not installed, or the cluster is not there.
        WorkersDied: A shard's workers died again and again.
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
    remote = ray.remote(num_cpus=1, max_retries=RETRIES)(drive_shard)
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


def own_memory_mb() -> float:
    """Largest resident memory of this process so far, MB."""
    import resource

    scale = 1024.0 * 1024.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / scale

"""Files of demonstrations: random sections shared out among processes, every few in a file of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metropilot._tensors import read_tensors, write_tensors
from metropilot.env import domain_sample
from metropilot.errors import InputError, MetropilotError
from metropilot.learn.imitation.demonstrations import (
    Demonstrations,
    collect_demonstrations,
    concatenate_demonstrations,
)

SHARD = 50
"""Random sections in one file."""
MAX_BYTES = 1 << 30
ATTEMPT = 1 << 32
"""Offset of a section's number in the seed of its demonstrations: apart from the section's own numbers."""


@dataclass(frozen=True)
class DemonstrationSet:
    """Specification of a set of demonstrations.

    Attributes:
        seed: Of everything random.
        worlds: Number of sampled lines with their trainsets.
        plans: Plans of each.
        states: States along each plan.
        folder: Folder of the files.
    """

    seed: int
    worlds: int
    plans: int
    states: int
    folder: Path

    @property
    def shards(self) -> int:
        """Number of files."""
        return -(-self.worlds // SHARD)

    def path(self, shard: int) -> Path:
        """File of one shard; its name holds the whole specification, so that no other is taken for it."""
        key = f"{self.seed}-{self.worlds}-{self.plans}-{self.states}"
        return self.folder / f"lessons-{key}-{shard:03}.safetensors"


def collect_missing(dataset: DemonstrationSet, on_shard: Callable[[int], object]) -> None:
    """Collect missing demonstrations on all cores.

    Args:
        dataset: Specification of the demonstrations.
        on_shard: Called with the number of files there are, whenever there is one more.

    Raises:
        InputError: A file cannot be written.
    """
    from joblib import Parallel, cpu_count, delayed

    missing = [k for k in range(dataset.shards) if not dataset.path(k).exists()]
    there = dataset.shards - len(missing)
    jobs = (delayed(collect_shard)(dataset, shard) for shard in missing)
    pool = Parallel(n_jobs=min(cpu_count(), max(len(missing), 1)), return_as="generator_unordered")
    for _ in pool(jobs) if missing else ():
        there += 1
        on_shard(there)


def collect_shard(dataset: DemonstrationSet, shard: int) -> None:
    """Collect the demonstrations of one file and write it."""
    found, numbers = [], []
    for number in range(shard * SHARD, min((shard + 1) * SHARD, dataset.worlds)):
        random = np.random.default_rng([dataset.seed, number + ATTEMPT])
        try:
            demonstrations = collect_demonstrations(
                domain_sample(dataset.seed, number), random, dataset.plans, dataset.states
            )
        except MetropilotError:
            continue  # a section that cannot be driven: too steep for its trainset
        found.append(demonstrations)
        numbers.append(np.full(demonstrations.begins.shape[0], number))
    whole, path = concatenate_demonstrations(found), dataset.path(shard)

    write_tensors(path, whole._asdict() | {"numbers": np.concatenate(numbers)}, {})


def load_demonstrations(dataset: DemonstrationSet) -> tuple[Demonstrations, np.ndarray]:
    """Load all demonstrations, and the number of the section in which each drive begins.

    Raises:
        InputError: A file is missing or damaged.
    """
    parts = list(_read(dataset))
    whole = Demonstrations(
        *(np.concatenate(part) for part in zip(*(demonstrations for demonstrations, _ in parts), strict=True))
    )
    return whole, np.concatenate([numbers for _, numbers in parts])


def _read(dataset: DemonstrationSet) -> Iterator[tuple[Demonstrations, np.ndarray]]:
    for shard in range(dataset.shards):
        path = dataset.path(shard)
        try:
            found, _ = read_tensors(path, MAX_BYTES)
            yield Demonstrations(*(found[name] for name in Demonstrations._fields)), found["numbers"]
        except (InputError, KeyError):
            raise InputError("demonstrations are missing or damaged; remove the file", file=path) from None

"""Gathering lessons: worlds shared out among processes, every few kept in a file of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from metropilot._tensors import read_tensors, write_tensors
from metropilot.env import domain_sample
from metropilot.errors import InputError, MetropilotError
from metropilot.learn.imitation.lessons import Demonstrations, collect_demonstrations, joined

SHARD = 50
"""Worlds to a file."""
MAX_BYTES = 1 << 30
ATTEMPT = 1 << 32
"""Added to a world's number: what its lessons are drawn from."""


@dataclass(frozen=True)
class Gathering:
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
        """A file of lessons; what it holds is in its name, so that no other is taken for it."""
        told = f"{self.seed}-{self.worlds}-{self.plans}-{self.states}"
        return self.folder / f"lessons-{told}-{shard:03}.safetensors"


def gather(gathering: Gathering, on_shard: Callable[[int], object]) -> None:
    """Gather what is missing, on every core there is.

    Args:
        gathering: Specification of the demonstrations.
        on_shard: Called with the number of files there are, whenever there is one more.

    Raises:
        InputError: A file cannot be written.
    """
    from joblib import Parallel, cpu_count, delayed

    missing = [k for k in range(gathering.shards) if not gathering.path(k).exists()]
    there = gathering.shards - len(missing)
    jobs = (delayed(gather_shard)(gathering, shard) for shard in missing)
    pool = Parallel(n_jobs=min(cpu_count(), max(len(missing), 1)), return_as="generator_unordered")
    for _ in pool(jobs) if missing else ():
        there += 1
        on_shard(there)


def gather_shard(gathering: Gathering, shard: int) -> None:
    """The lessons of one file's worlds."""
    found, numbers = [], []
    for number in range(shard * SHARD, min((shard + 1) * SHARD, gathering.worlds)):
        random = np.random.default_rng([gathering.seed, number + ATTEMPT])
        try:
            lessons = collect_demonstrations(
                domain_sample(gathering.seed, number), random, gathering.plans, gathering.states
            )
        except MetropilotError:
            continue  # a world that cannot be driven: too steep for its trainset
        found.append(lessons)
        numbers.append(np.full(lessons.begins.shape[0], number))
    whole, path = joined(found), gathering.path(shard)

    write_tensors(path, whole._asdict() | {"numbers": np.concatenate(numbers)}, {})


def gathered(gathering: Gathering) -> tuple[Demonstrations, np.ndarray]:
    """All lessons, and the number of the world that each place to begin at is in.

    Raises:
        InputError: A file is missing or damaged.
    """
    parts = list(_read(gathering))
    whole = Demonstrations(
        *(np.concatenate(part) for part in zip(*(lessons for lessons, _ in parts), strict=True))
    )
    return whole, np.concatenate([numbers for _, numbers in parts])


def _read(gathering: Gathering) -> Iterator[tuple[Demonstrations, np.ndarray]]:
    for shard in range(gathering.shards):
        path = gathering.path(shard)
        try:
            found, _ = read_tensors(path, MAX_BYTES)
            yield Demonstrations(*(found[name] for name in Demonstrations._fields)), found["numbers"]
        except (InputError, KeyError):
            raise InputError("demonstrations are missing or damaged; remove the file", file=path) from None

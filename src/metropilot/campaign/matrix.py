"""Campaigns of any kind: numbered rows in shards, which one runner computes and one folder keeps."""

from __future__ import annotations

import json
import resource
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import metropilot
from metropilot._io import encode_parquet
from metropilot._registry import Registry, RegistryRow
from metropilot.errors import Infeasible, MetropilotError
from metropilot.railway import parse_trainset

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

FAILED, INFEASIBLE = "failed", "infeasible"
"""Outcomes of a row that ended with an error, and of one that nobody could do as it was asked."""
DRIVES, LINE = "drives", "line"
CellRow = tuple[dict[str, Any], dict[str, Any]]
"""Result and timing of a row."""


class Piece(NamedTuple):
    """A shard: rows that are computed and stored together.

    Attributes:
        group: Group of the rows, each with a folder of its own: of drives the driver, options included.
        chunk: Number of the shard among those of the group.
    """

    group: str
    chunk: int


class Shard(NamedTuple):
    """A finished shard, as a worker returns it.

    Attributes:
        piece: Identity of the shard.
        rows: Number of rows.
        results: Parquet file of the results.
        timings: Parquet file of the timings.
        version: Version of metropilot of the worker.
    """

    piece: Piece
    rows: int
    results: bytes
    timings: bytes
    version: str


class AbstractCampaign(ABC):
    """A matrix: groups of cells, each cell of each group one row.

    Groups are no part of the identity of a folder: more of them go on with it.
    """

    kind: ClassVar[str]
    """Id in :data:`KINDS`."""
    group_column: ClassVar[str]
    """Column of the results that names the group."""
    most_rows: ClassVar[int]
    """Most rows of a campaign: more would take months."""
    name: str

    @property
    @abstractmethod
    def groups(self) -> tuple[str, ...]:
        """Names of the groups, in the order of their rows."""

    @property
    @abstractmethod
    def cells(self) -> int:
        """Number of rows of one group."""

    @property
    @abstractmethod
    def text(self) -> str:
        """The whole campaign as JSON, keys sorted."""

    @property
    @abstractmethod
    def identity(self) -> str:
        """The same without what may be added to a folder."""

    @property
    @abstractmethod
    def group_files(self) -> Mapping[str, str]:
        """Groups that name a file, each with its content: no part of the identity, and yet it must stay."""

    @property
    @abstractmethod
    def columns(self) -> Mapping[str, str]:
        """Columns of the results: the same bits on every machine and in every order of the rows."""

    @property
    @abstractmethod
    def timing_columns(self) -> Mapping[str, str]:
        """Columns of measured times, in a file of their own because they are not reproducible."""

    @property
    @abstractmethod
    def matrix_words(self) -> str:
        """Axes with their sizes, for a page."""

    @abstractmethod
    def shard_rows(self, group: str) -> int:
        """Number of rows in a shard of a group; depends on nothing but group and cells."""

    @abstractmethod
    def compute_rows(self, rows: range) -> list[CellRow]:
        """Results and timings of the rows of a shard."""

    @abstractmethod
    def statistics(self, database: DuckDBPyConnection | None) -> dict[str, Any]:
        """Summary of the view ``runs``; empty lists where there is none."""

    @abstractmethod
    def succeeds(self, summary: Mapping[str, Any]) -> bool:
        """True if every row came out well."""

    @abstractmethod
    def report_parts(self, folder: Path, summary: Mapping[str, Any]) -> list[str]:
        """Parts of the report after its head, as HTML."""

    @abstractmethod
    def page_parts(self, folder: Path, summary: Mapping[str, Any], written: str) -> list[str]:
        """Lines of a page of the documentation, as Markdown.

        Args:
            folder: The campaign's folder.
            summary: Its summary.
            written: Command that writes the page, and when and where it did.
        """

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.groups) * self.cells

    def pieces(self) -> tuple[Piece, ...]:
        """All shards. Each is of one group, so that adding a group keeps the shards of the others."""
        counts = [(name, -(-self.cells // self.shard_rows(name))) for name in self.groups]
        return tuple(Piece(name, chunk) for name, count in counts for chunk in range(count))

    def shard(self, piece: Piece) -> range:
        """The rows of a shard."""
        size = self.shard_rows(piece.group)
        first, base = piece.chunk * size, self.groups.index(piece.group) * self.cells
        return range(base + first, base + min(first + size, self.cells))

    @property
    def digest(self) -> str:
        """Identifier of the campaign: the same for the same cells, whatever the groups."""
        return sha256(self.identity.encode()).hexdigest()[:16]


KINDS: Registry[type[AbstractCampaign]] = Registry(
    "kind of campaign",
    {
        DRIVES: RegistryRow("metropilot.campaign.declared:Campaign", "runs of drivers"),
        LINE: RegistryRow("metropilot.campaign.line_sweep:LineSweep", "lines in operation"),
    },
    "kind",
)


def content_key(key: str) -> str:
    """A line or trainset as seeds and folders know it: by its id, or by the content of its file.

    The same file in another place is therefore the same, and a file that was changed is not.

    Args:
        key: Id, or path of a file; of a trainset with the actuation it declares.
    """
    named = parse_trainset(key)
    if not named.is_file or not Path(named.id).is_file():
        return key
    return str(named._replace(id=digest_of(Path(named.id))))


def digest_of(path: Path) -> str:
    """Identifier of a file's content."""
    return sha256(path.read_bytes()).hexdigest()[:16]


def from_text(text: str) -> AbstractCampaign:
    """The campaign of :attr:`AbstractCampaign.text`.

    Raises:
        ValueError: The text does not describe a campaign.
    """
    from pydantic import TypeAdapter

    values = json.loads(text)
    kind = values.pop("kind", DRIVES) if isinstance(values, dict) else None
    if kind not in KINDS.ids():
        raise ValueError("not a campaign")
    return TypeAdapter(KINDS.get(kind)).validate_json(json.dumps(values))


def compute_shard(text: str, piece: Piece) -> Shard:
    """Compute a shard of the campaign that ``text`` describes.

    Args:
        text: :attr:`AbstractCampaign.text`.
        piece: Shard to compute.
    """
    campaign, piece = from_text(text), Piece(*piece)
    found = campaign.compute_rows(campaign.shard(piece))
    results = encode_parquet(campaign.columns, [result for result, _ in found])
    timings = encode_parquet(campaign.timing_columns, [timing for _, timing in found])
    return Shard(piece, len(found), results, timings, metropilot.__version__)


@contextmanager
def capture_errors(result: dict[str, Any]) -> Iterator[None]:
    """Record an exception of the block as the result, so that one failing row does not stop a campaign."""
    try:
        yield
    except Infeasible as error:
        result |= {"outcome": INFEASIBLE, "error": error.line()}
    except MetropilotError as error:
        result |= {"outcome": FAILED, "error": str(error)}
    except Exception as error:  # noqa: BLE001 (whatever it is)
        result |= {"outcome": FAILED, "error": f"{type(error).__name__}: {error}"}


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far, MB."""
    # getrusage counts bytes on macOS and KiB on Linux.
    scale = 1024.0 * 1024.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / scale


def count_axes(sizes: Sequence[tuple[str, int]]) -> str:
    """Axes of a matrix in words, with their sizes; those with one value are left out."""
    return " × ".join(f"{count} {name}" for name, count in sizes if count > 1) or "one case"

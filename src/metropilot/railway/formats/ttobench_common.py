"""TTOBench JSON: what tracks, trains and journeys share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metropilot.railway.formats.ranges import Range
from metropilot.railway.formats.reader import Node


class Metadata:
    """The metadata of a TTOBench document: id, whom to cite, and what to keep.

    Args:
        root: The whole document.
        stem: The id where the document has none.
    """

    def __init__(self, root: Node, stem: str) -> None:
        node = root.optional("metadata")
        self.id = node.text("id", stem) if node else stem
        self.track = node.text("associated track", "") if node else ""
        self.rest: dict[str, Any] = leftovers(node) if node else {}
        cited = [str(self.rest.get(k, "")) for k in ("library version", "created by", "license")]
        self.citation = ", ".join(part for part in (cited[0] or "TTOBench", self.id, *cited[1:]) if part)


def leftovers(node: Node) -> dict[str, Any]:
    """The keys of a table that nothing has read."""
    return {key: value for key, value in node.data.items() if not node.was_read(key)}


def kept(root: Node, metadata: Metadata, blocks: Mapping[str, Node | None]) -> dict[str, Any]:
    """Everything of a document that the object has no place for: what is written back on export."""
    extra: dict[str, Any] = {"metadata": metadata.rest} if metadata.rest else {}
    for name, block in blocks.items():
        rest = leftovers(block) if block else {}
        if rest:
            extra[name] = rest
    return extra | leftovers(root)


def scalar(root: Node, key: str, kind: str, bounds: Range, default: float | None = None) -> float:
    """A number that has a table of its own: ``"mass": {"unit": "kg", "value": 278000}``."""
    if key not in root and default is not None:
        return default
    return root.table(key).quantity("value", kind, bounds)

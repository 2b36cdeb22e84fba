"""What every file in metropilot's own TOML shares: header, blocks with their sources, and leftovers."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from metropilot.errors import InputError
from metropilot.railway.formats.reader import Node
from metropilot.railway.journey import Journey
from metropilot.railway.line import Line
from metropilot.railway.trainset import Trainset

T = TypeVar("T")


def located(error: InputError, file: object, unit: str | None = None) -> InputError:
    """The same complaint with the file it is about."""
    return error.at(file=file, unit=error.unit or unit)


class Document:
    """The root of a TOML document: reads header and blocks and refuses what nobody asked for.

    Args:
        root: The whole document.
    """

    def __init__(self, root: Node) -> None:
        self.root = root
        self._blocks: list[Node] = []
        self.source: dict[str, str] = {}
        root.get("kind")
        self.header: dict[str, Any] = {
            "id": root.text("id"),
            "notes": root.texts("notes"),
            "unused": root.texts("unused"),
            "extra": self._extra(),
        }

    def _extra(self) -> dict[str, Any]:
        text = self.root.text("extra", "{}")
        try:
            extra = json.loads(text)
        except (ValueError, RecursionError):
            extra = None
        if not isinstance(extra, dict):
            raise self.root.fail("must be a JSON object", "extra", text, "a JSON object as text")
        return extra

    def optional(self, name: str) -> Node | None:
        """A block that may be missing; its ``source`` is taken note of."""
        block = self.root.optional(name)
        if block is not None:
            self._blocks.append(block)
            source = block.text("source", "")
            if source:
                self.source[name] = source
        return block

    def block(self, name: str) -> Node:
        """A block that must be there."""
        self.root.need(name, "a table")
        block = self.optional(name)
        if block is None:
            raise self.root.fail("missing", name, allowed="a table")
        return block

    def build(self, make: Callable[..., T], **fields: object) -> T:
        """Close every table and make the object, naming the file in whatever its own checks say.

        Raises:
            InputError: An unknown key, or data that does not fit together.
        """
        sources = self.root.optional("sources")
        for key in sources.data if sources else ():
            self.source[key] = sources.text(key) if sources else ""
        for block in self._blocks:
            block.close()
        self.root.close()
        try:
            return make(**self.header, **fields, source=self.source)
        except InputError as error:
            raise located(error, self.root.file) from error


def header(kind: str, thing: Line | Trainset | Journey, **more: str) -> dict[str, Any]:
    """The header of a document, without what is empty."""
    document: dict[str, Any] = {"kind": kind, "id": thing.id, **more}
    for key in ("notes", "unused"):
        if getattr(thing, key):
            document[key] = list(getattr(thing, key))
    if thing.extra:
        document["extra"] = json.dumps(thing.extra)
    return document


def with_sources(document: dict[str, Any], source: Mapping[str, str]) -> dict[str, Any]:
    """The document with each source in its block, and those without a block in ``sources``."""
    rest = {}
    for name, text in source.items():
        if isinstance(document.get(name), dict):
            document[name] = {"source": text, **document[name]}
        else:
            rest[name] = text
    if rest:
        document["sources"] = rest
    return document

"""Records of the catalogue: the parts that all of them keep of the file they were read from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from metropilot.errors import InputError
from metropilot.units import tidy


@dataclass(frozen=True, kw_only=True)
class CatalogueRecord:
    """Contents of a file of the catalogue.

    Attributes:
        source: Citation of each block of data, by block name.
        notes: Corrections and remarks worth showing to a user.
        extra: Keys of the source file that metropilot does not use, kept for writing back.
        unused: Names of the blocks of the file that were read but have no effect.
    """

    source: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)
    unused: tuple[str, ...] = ()


def check_positions(block: str, positions_m: Sequence[float]) -> None:
    """Refuse positions along a line, those of a block of a file, that do not increase.

    Raises:
        InputError: Naming the entry, its position and what is allowed.
    """
    for index, (before, after) in enumerate(pairwise(positions_m), start=1):
        if not after > before:
            raise InputError(
                "must increase",
                field=f"{block}[{index}].position",
                value=tidy(after),
                unit="m",
                allowed=f"> {before:g} m",
            )

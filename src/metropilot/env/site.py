"""Line and trainset of a task that is learned elsewhere than on its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from metropilot._schema import CheckedFields, declare
from metropilot.errors import InputError
from metropilot.railway import (
    Section,
    Trainset,
    copied_key,
    copy_input,
    load_line,
    load_trainset,
    parse_trainset,
)

LINE, SECTION, TRAINSET = "yizhuang", "RJ-WYJ", "dkz32"
"""Line, section and trainset of a task that is given no other."""
FILES = ("line", "trainset")
"""Fields of a site that may name a file."""


@dataclass(frozen=True)
class TaskSite(CheckedFields):
    """Line and trainset to learn on instead of a task's own; what is None stays the task's.

    Attributes:
        line: Catalogue id or path.
        sections: ``ORIGIN-DESTINATION,...``; None: all of the line, both ways.
        trainset: Catalogue id or path.
        load: Load aboard; None: each of the trainset's loads.
    """

    line: str | None = declare(None, "Line to learn on instead of the task's: catalogue id or path.")
    sections: str | None = declare(
        None, "Its sections to learn on; all, both ways, if not given.", form="ORIGIN-DESTINATION,..."
    )
    trainset: str | None = declare(
        None, "Trainset to learn with instead of the task's: catalogue id or path, ID@DELAY,LAG."
    )
    load: str | None = declare(None, "Load aboard; every load of the trainset if not given.")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sections is not None and self.line is None:
            raise InputError(
                "sections of no line", field="sections", value=self.sections, allowed="beside a line"
            )

    def loaded_sections(self) -> tuple[Section, ...]:
        """The sections.

        Raises:
            InputError: No such line, station or section.
        """
        if self.line is None:
            return load_line(LINE).select_sections(SECTION)
        return load_line(self.line).select_sections(self.sections)

    def loaded_trainsets(self) -> tuple[Trainset, ...]:
        """The trainset with each of its loads, or with the one that is given.

        Raises:
            InputError: No such trainset or load.
        """
        key = self.trainset or TRAINSET
        loaded = load_trainset(key, self.load)
        if self.load or parse_trainset(key).load or not loaded.loads:
            return (loaded,)
        return tuple(loaded.with_load(load) for load in loaded.loads)

    def values(self) -> dict[str, str]:
        """Values that are given, by name."""
        return {name: value for name, value in vars(self).items() if value is not None}

    def copy_files(self, folder: Path) -> None:
        """Copy its files into a folder, where :meth:`as_copied` names them."""
        for name in FILES:
            if name in self.values():
                copy_input(folder, self.values()[name], name)

    def as_copied(self) -> TaskSite:
        """The same site with the names that copies of its files have."""
        given = self.values().items()
        return replace(self, **{name: copied_key(value, name) for name, value in given if name in FILES})

    def in_folder(self, folder: Path) -> TaskSite:
        """The same site with the copies of its files in a folder, whatever place it names."""
        copies = self.as_copied().values().items()
        found = {name: key for name, key in copies if name in FILES and parse_trainset(key).is_file}
        return replace(self, **{name: str(folder / key) for name, key in found.items()})

    @staticmethod
    def copy_names() -> tuple[str, ...]:
        """Names that copies of files can have."""
        return tuple(f"{name}{ending}" for name in FILES for ending in (".toml", ".json"))

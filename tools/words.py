"""Gather the texts of the console into its catalogue and compile it for gettext.

Texts are found in the sources by Babel, and in what the library declares: labels of fields, one-sentence
descriptions of drivers, recipes and studies. Translations stay; texts that are gone are left out; new ones
wait for a translation, in ``src/metropilot/web/words/zh/LC_MESSAGES/metropilot.po``.

    python tools/words.py
"""

import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path

from babel.messages import Catalog
from babel.messages.extract import extract_from_dir
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po, write_po
from pydantic import BaseModel

from metropilot._schema import field_specs
from metropilot.drivers import DRIVERS
from metropilot.evaluate import run_fields
from metropilot.learn import RECIPES
from metropilot.sim import Disturbance
from metropilot.studies import STUDIES
from metropilot.web.schemas import requests
from metropilot.web.words.language import DOMAIN, ENGLISH, FOLDER, LANGUAGES

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / "src" / "metropilot" / "web"
KEYWORDS = {"_": None, "N_": None, "gettext": None, "ngettext": (1, 2)}
DECLARED = "declared"
WRITTEN = datetime(2026, 11, 25, tzinfo=UTC)
"""Date in the header: a real one would change the file at every call."""


def declared() -> Iterator[str]:
    """Yield the texts that the library declares and the pages show."""
    for kind in vars(requests).values():
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from (requests.spec_of(kind, name).label for name in kind.model_fields)
    yield from (spec.label for spec in field_specs(Disturbance).values())
    yield run_fields()["ideal"].help.rstrip(".")
    for registry in (DRIVERS, RECIPES, STUDIES):
        yield from (row.summary for row in registry.rows().values())


def gather(language: str) -> Catalog:
    """Gather every text, without translations."""
    made = Catalog(language, domain=DOMAIN, project=DOMAIN, version="0", fuzzy=False)
    made.creation_date = made.revision_date = WRITTEN
    found = extract_from_dir(SOURCES, [("**.py", "python")], keywords=KEYWORDS)
    for name, _line, message, _comments, _context in found:
        if message:
            made.add(message, locations=[((SOURCES / name).relative_to(ROOT).as_posix(), 0)])
    for message in declared():
        if message:
            made.add(message, locations=[(DECLARED, 0)])
    return made


def path_of(language: str, suffix: str) -> Path:
    """File of a catalogue."""
    return FOLDER / language / "LC_MESSAGES" / f"{DOMAIN}{suffix}"


def read(language: str) -> Catalog:
    """Read a catalogue; an empty one where there is none yet."""
    path = path_of(language, ".po")
    if not path.exists():
        return Catalog(language)
    with path.open("rb") as file:
        return read_po(file, language, DOMAIN)


def update(language: str) -> Catalog:
    """Gather every text, with the translations that there are."""
    made, known = gather(language), read(language)
    for message in made:
        if message.id and message.id in known:
            message.string = known[message.id].string
    return made


def po_bytes(catalogue: Catalog) -> bytes:
    """Write a catalogue as text."""
    made = BytesIO()
    write_po(made, catalogue, width=110, sort_by_file=True, include_lineno=False, omit_header=False)
    return made.getvalue()


def mo_bytes(catalogue: Catalog) -> bytes:
    """Compile a catalogue."""
    made = BytesIO()
    write_mo(made, catalogue)
    return made.getvalue()


def main() -> int:
    """Write the catalogue of every language; return 1 if a text waits for its translation."""
    waiting = 0
    for language in LANGUAGES:
        if language == ENGLISH:
            continue
        made = update(language)
        path_of(language, ".po").write_bytes(po_bytes(made))
        path_of(language, ".mo").write_bytes(mo_bytes(made))
        empty = [message.id for message in made if message.id and not message.string]
        waiting += len(empty)
        print(f"{language}: {len(made)} texts, {len(empty)} without a translation")
        for message in empty:
            print(f"  {message!r}")
    return 1 if waiting else 0


if __name__ == "__main__":
    sys.exit(main())

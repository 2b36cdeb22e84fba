"""Gather the texts of the console into its catalogue and compile it for gettext.

Texts are found in the sources by Babel, in the errors that the library raises, and in what it declares:
labels of fields, one-sentence descriptions of drivers, recipes and studies, claims and captions. Translations
stay; texts that are gone are left out; new ones wait for a translation, in
``src/metropilot/web/words/zh/LC_MESSAGES/metropilot.po``.

    python tools/words.py
"""

import ast
import sys
from collections.abc import Iterator
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path

from babel.messages import Catalog
from babel.messages.extract import extract_from_dir
from babel.messages.mofile import write_mo
from babel.messages.pofile import read_po, write_po

from metropilot.web import LANGUAGES, declared_texts

ROOT = Path(__file__).resolve().parent.parent
SOURCES = ROOT / "src" / "metropilot" / "web"
FOLDER = SOURCES / "words"
DOMAIN, ENGLISH = "metropilot", "en"
KEYWORDS = {"_": None, "N_": None, "gettext": None, "ngettext": (1, 2)}
DECLARED, REFUSED = "declared", "src/metropilot/web/words/refusals.py"
REFUSALS = {"InputError", "Infeasible", "Refused", "SolverError", "fail"}
ELSEWHERE = (
    "cli/",
    "env/adapters/",
    "campaign/run.py",
    "campaign/store.py",
    "learn/export.py",
    "studies/",
    "web/settings.py",
)
"""Places whose refusals no page shows: the command line, Ray, ONNX, Gymnasium, the start of the server."""
AUTHORS = "The metropilot authors"
HEADER = """\
# Texts of the console: written by `make words`, which keeps the translations that are filled in here.
#"""
WRITTEN = datetime(2026, 11, 25, tzinfo=UTC)
"""Date in the header: a real one would change the file at every call."""


def refused_texts() -> Iterator[str]:
    """Yield the texts of errors that a page can show, where they stand in the call."""
    library = ROOT / "src" / "metropilot"
    for path in sorted(library.rglob("*.py")):
        if path.relative_to(library).as_posix().startswith(ELSEWHERE):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and node.args):
                continue
            if getattr(node.func, "id", getattr(node.func, "attr", None)) in REFUSALS:
                first = node.args[0]
                parts = (first.body, first.orelse) if isinstance(first, ast.IfExp) else (first,)
                told = (part.value for part in parts if isinstance(part, ast.Constant))
                yield from (text for text in told if isinstance(text, str))


def gather(language: str) -> Catalog:
    """Gather every text, without translations."""
    known = {"domain": DOMAIN, "project": DOMAIN, "version": "0", "fuzzy": False}
    known |= {"header_comment": HEADER, "last_translator": AUTHORS, "language_team": AUTHORS}
    made = Catalog(language, msgid_bugs_address=AUTHORS, **known)
    made.creation_date = made.revision_date = WRITTEN
    found = extract_from_dir(SOURCES, [("**.py", "python")], keywords=KEYWORDS)
    for name, _line, message, _comments, _context in found:
        if message:
            made.add(message, locations=[((SOURCES / name).relative_to(ROOT).as_posix(), 0)])
    for place, messages in ((DECLARED, declared_texts()), (REFUSED, refused_texts())):
        for message in messages:
            made.add(message, locations=[(place, 0)])
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

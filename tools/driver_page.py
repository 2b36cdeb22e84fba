"""Write the tables of docs/drivers.md: every driver, its source, and where its deviations stand.

A test fails when the page and the registries differ.

    python tools/driver_page.py
"""

import re
from pathlib import Path

from metropilot.convoy import FOLLOWERS
from metropilot.drivers import DRIVERS

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "drivers.md"
STUDIES = {
    "Cheng23": "cheng2023",
    "Lu23": "lu2023",
    "Huang25": "huang2025",
    "Zhou et al. 2020": "huang2025",
    "Chen23a": "chen2023a",
    "Chen23b": "chen2023b",
}
"""Words in a driver's source, and the study whose page lists the deviations from it."""
TABLES = {"drivers": DRIVERS, "followers": FOLLOWERS}


def deviations(source: str) -> str:
    """Links to the pages that list the deviations from a source."""
    found = dict.fromkeys(study for words, study in STUDIES.items() if words in source)
    links = [f"[{study}](studies/{study}.md#deviations-from-the-paper)" for study in found]
    return ", ".join(links) or "–"


def table(name: str) -> str:
    """The table of one registry."""
    registry = TABLES[name]
    rows = ["| id | what it does | source | deviations |", "|---|---|---|---|"]
    for driver_id, row in registry.rows().items():
        rows.append(f"| `{driver_id}` | {row.summary} | {row.source} | {deviations(row.source)} |")
    return "\n".join(rows)


def page(text: str) -> str:
    """The page with its tables as the registries have them."""
    for name in TABLES:
        begin, end = f"<!-- table: {name} -->", f"<!-- end: {name} -->"
        block = re.compile(re.escape(begin) + ".*?" + re.escape(end), re.DOTALL)
        text = block.sub(lambda _, b=begin, e=end, n=name: f"{b}\n{table(n)}\n{e}", text)
    return text


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text()))

"""Pages of the studies are those of this code: rows without random numbers are computed again."""

import csv
from pathlib import Path

import pytest

from metropilot.studies import STUDIES, Order, reproduce

DOCS = Path(__file__).parents[2] / "docs" / "studies"
WRITTEN = sorted(path.parent.name for path in DOCS.glob("*/rows.csv"))
CLOSE, LEAST = 1e-3, 1e-6
"""Share by which a row may differ, and difference that counts as none."""


def read_rows(study):
    """Rows of a page that every seed agrees on, by table, case, driver and quantity.

    Drivers tuned by a search are left out: the page searches again, the quick study takes what is shipped.
    """
    with (DOCS / study / "rows.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    same = [row for row in rows if row["ours"] and row["low"] == row["high"] and "tuned" not in row["driver"]]
    return {tuple(row[k] for k in ("table", "case", "driver", "kpi")): float(row["ours"]) for row in same}


def test_a_page_with_rows_is_there():
    assert "cheng2023" in WRITTEN


@pytest.mark.parametrize("study", WRITTEN)
def test_deterministic_rows_of_a_page_are_those_of_this_code(study, tmp_path):
    written, fixed_rows = read_rows(study), STUDIES.get(study).fixed_rows
    rows = reproduce(study, Order(tmp_path)).rows if fixed_rows is None else fixed_rows()
    found = {(row.table, row.case, row.driver, row.kpi): row.ours for row in rows}
    compared = [key for key in written if key in found]
    assert len(compared) > (30 if fixed_rows is None else 5)
    stale = {
        key: (written[key], found[key])
        for key in compared
        if found[key] != pytest.approx(written[key], rel=CLOSE, abs=LEAST)
    }
    assert not stale, (
        f"written again by: metropilot reproduce {study} --budget paper --write-docs docs/studies"
    )

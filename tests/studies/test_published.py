"""Published pages of the studies are read back whole."""

import pytest

from metropilot.errors import InputError
from metropilot.studies import STUDIES, published_study


@pytest.mark.parametrize("study", STUDIES.ids())
def test_a_page_is_read_back(study):
    found = published_study(study)
    assert found.written.startswith(f"Written by `metropilot reproduce {study}")
    assert len(found.rows) > 50
    assert found.figures
    assert all(figure.path.stat().st_size > 1000 and figure.caption for figure in found.figures)
    for row in found.rows:
        assert row.case
        assert row.driver
        if None not in (row.low, row.ours, row.high):
            assert row.low <= row.ours <= row.high
    if found.verdicts:
        for word in ("beaten", "matched", "missed"):
            count = sum(row["verdict"] == word for row in found.verdicts)
            assert (f"{count} {word}" in found.summary.lower()) == (count > 0)


def test_rows_without_a_file_are_those_of_the_page(monkeypatch):
    whole = published_study("lu2023")

    def without(name):
        if name.endswith("rows.csv"):
            raise InputError("not published")
        return real(name)

    from metropilot.studies import page

    real = page.published_file
    monkeypatch.setattr(page, "published_file", without)
    rows = {(r.table, r.case, r.driver, r.kpi): r for r in published_study("lu2023").rows}
    compared = 0
    for row in whole.rows:
        other = rows.get((row.table, row.case, row.driver, row.kpi))
        if other is None:
            continue
        compared += 1
        if row.ours is None:
            assert other.ours is None
        else:
            assert other.ours == pytest.approx(row.ours, rel=0.01, abs=6e-4)
    assert compared > 50


def test_a_study_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="unknown study"):
        published_study("../lu2023")

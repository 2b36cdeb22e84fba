"""Published pages of the studies are read back whole."""

import importlib

import pytest

from metropilot.errors import InputError
from metropilot.studies import STUDIES, judge_claims, published_study
from metropilot.studies.page import verdict_numbers


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


@pytest.mark.parametrize("study", STUDIES.ids())
def test_verdicts_of_a_page_are_those_of_its_rows(study):
    claims = importlib.import_module(f"metropilot.studies.{study}.study").CLAIMS
    found = published_study(study)
    verdicts = judge_claims(claims, found.rows)
    shown = [(row["claim"], row["ours"], row["rival"], row["verdict"], row["why"]) for row in found.verdicts]
    numbers = [verdict_numbers(verdict) for verdict in verdicts]
    assert shown == [
        (verdict.claim, ours, rival, verdict.verdict, verdict.why)
        for verdict, (_, ours, _, rival) in zip(verdicts, numbers, strict=True)
    ]


def test_a_study_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="unknown study"):
        published_study("../lu2023")

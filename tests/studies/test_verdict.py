"""Verdicts of a study: intervals, rivals, judgements, and their table on the page."""

import json
from dataclasses import replace

import numpy as np
import pytest

from metropilot.studies import STUDIES, Claim, ReportRow, StudyReport, judge_claims
from metropilot.studies.page import study_page
from metropilot.studies.verdict import difference_p, judge_claim, median_interval, sum_up_rivals


def rows(
    published: float | None = 10.0, ours=(7.0, 8.0, 9.0, 7.5, 8.5, 8.2, 7.9), rival=(6.0,)
) -> list[ReportRow]:
    return [
        ReportRow("T", "c", "learned", "error", "m", published).with_values(ours),
        ReportRow("T", "c", "tuned", "error", "m").with_values(rival),
        ReportRow("T", "c", "crude", "error", "m").with_values([50.0]),
    ]


CLAIM = Claim("it tracks", "learned", "error", "c", rivals=("crude", "tuned"))


def test_the_interval_holds_the_median_and_shrinks_with_the_seeds():
    random = np.random.default_rng(3)
    few, many = random.normal(size=8), random.normal(size=200)
    for values in (few, many):
        low, high = median_interval(values.tolist())
        assert values.min() <= low <= np.median(values) <= high <= values.max()
    assert np.diff(median_interval(many.tolist())) < np.diff(median_interval(few.tolist()))
    assert median_interval([2.0]) == (2.0, 2.0)


def test_the_interval_covers_the_true_median():
    random, inside = np.random.default_rng(0), 0
    for k in range(100):
        low, high = median_interval(random.normal(size=15).tolist(), seed=k)
        inside += low <= 0.0 <= high
    assert 85 <= inside <= 100


def test_a_difference_is_told_from_chance():
    random = np.random.default_rng(1)
    a, b = random.normal(size=12).tolist(), random.normal(size=12).tolist()
    assert difference_p(a, b) == pytest.approx(0.5, abs=0.45)
    assert difference_p(a, [value + 3.0 for value in b]) == pytest.approx(0.0, abs=0.001)
    assert difference_p(a, [5.0]) == pytest.approx(0.0, abs=0.001)
    assert difference_p([1.0, 2.0], b) is None


@pytest.mark.parametrize(
    ("published", "aim", "verdict"),
    [
        (10.0, "low", "beaten"),
        (8.0, "low", "matched"),
        (5.0, "low", "missed"),
        (10.0, "high", "missed"),
        (5.0, "high", "beaten"),
        (10.0, "same", "missed"),
        (8.1, "same", "matched"),
    ],
)
def test_a_claim_is_judged_against_the_published_number(published, aim, verdict):
    found = judge_claim(Claim("it tracks", "learned", "error", "c", aim), rows(published))
    assert (found.verdict, found.ours, found.published) == (verdict, 8.0, published)


@pytest.mark.parametrize(("published", "verdict"), [(11.0, "beaten"), (8.9, "missed"), (8.0, "matched")])
def test_an_arrival_nearer_to_its_time_than_the_published_one_beats_it(published, verdict):
    """An arrival 0.3 s after its time was "missed" beside a published one 2 s before it."""
    found = judge_claim(Claim("on time", "learned", "error", "c", "same", target=9.0), rows(published))
    assert (found.verdict, found.why) == (verdict, "aimed at: 9 m")


def test_the_strongest_rival_stands_beside_and_says_if_it_wins():
    found = judge_claim(CLAIM, rows())
    assert found.rival is not None
    assert (found.rival.driver, found.rival.value) == ("tuned", 6.0)
    assert found.why.startswith("worse than tuned (p = 0.0")
    assert "better than tuned" in judge_claim(CLAIM, rows(rival=(20.0,))).why
    assert "not distinguishable" in judge_claim(CLAIM, rows(rival=(8.05,))).why


def test_a_rival_of_the_published_value_itself_is_judged_by_its_distance():
    near = judge_claim(Claim("as much", "learned", "error", "c", "same", ("tuned",)), rows(10.0))
    assert near.why.startswith("better than tuned")
    far = judge_claim(Claim("as much", "learned", "error", "c", "same", ("tuned",)), rows(6.1))
    assert far.why.startswith("worse than tuned")


def test_what_was_not_measured_cannot_be_tested():
    absent = judge_claim(Claim("it tracks", "nobody", "error", "c"), rows())
    assert (absent.verdict, absent.ours) == ("cannot be tested", None)
    reason = judge_claim(Claim("it tracks", "learned", "error", "c", untestable="no data"), rows())
    assert (reason.verdict, reason.why) == ("cannot be tested", "no data")
    unprinted = judge_claim(CLAIM, rows(published=None))
    assert unprinted.verdict == "cannot be tested"
    assert unprinted.why.startswith("no number is printed; worse than tuned")


@pytest.mark.parametrize(
    ("p", "verdict", "why"),
    [
        (0.042, "beaten", "p = 0.042"),
        (0.05, "cannot be tested", "the difference may be chance (p = 0.05)"),
        (None, "cannot be tested", "too few seeds for a test"),
    ],
)
def test_a_claim_that_compares_two_learners_needs_more_than_chance(p, verdict, why):
    claim = Claim("it learns faster than the other", "learned", "error", "c", chance="p of the error")
    compared = [*rows(), ReportRow("T", "c", "learned", "p of the error", "", ours=p)]
    found = judge_claim(claim, compared)
    assert (found.verdict, found.why, found.ours) == (verdict, why, 8.0)
    assert judge_claim(claim, rows()).verdict == "cannot be tested"


def test_the_page_begins_with_the_verdicts():
    report = StudyReport(7, rows(), claims=[CLAIM], remarks=["A finding."], title="T")
    page = study_page(STUDIES.get("cheng2023"), report)
    assert page.index("## Verdicts") < page.index("## Findings") < page.index("## T\n")
    assert "1 beaten." in page
    assert "| it tracks | m | 10.00 | 8.00 | " in page
    (verdict,) = json.loads(json.dumps(report.as_dict()))["verdicts"]
    assert set(verdict) == {
        "claim", "kpi", "unit", "published", "ours", "low", "high", "rival", "verdict", "why"
    }  # fmt: skip


@pytest.mark.parametrize("study_id", list(STUDIES))
def test_claims_name_rows_and_are_whole_sentences(study_id):
    import importlib

    claims = importlib.import_module(f"metropilot.studies.{study_id}.study").CLAIMS
    assert len(claims) >= 3
    assert len({(c.driver, c.kpi, c.case, c.table) for c in claims}) == len(claims)
    assert judge_claims(claims, [])[0].verdict == "cannot be tested"


def test_what_learning_adds_is_said_of_tested_claims_alone():
    ours = tuple(np.linspace(7.0, 9.0, 10))
    worse = judge_claim(CLAIM, rows(ours=ours))
    better = judge_claim(CLAIM, rows(ours=ours, rival=(9.5,)))
    untested = judge_claim(CLAIM, rows(ours=(7.0, 8.0), rival=(9.5,)))
    assert [verdict.rival.ours_is for verdict in (worse, better) if verdict.rival] == ["worse", "better"]
    assert sum_up_rivals([worse, untested]).startswith("**Learning adds nothing**")
    assert "better in 0, worse in 1" in sum_up_rivals([worse, untested])
    assert "or not tested in 1 of 2 claims" in sum_up_rivals([worse, untested])
    assert sum_up_rivals([better, better, worse]).startswith("**Learning adds**")
    assert sum_up_rivals([better, worse]).startswith("**Learning adds little**")
    assert sum_up_rivals([judge_claim(replace(CLAIM, rivals=()), rows())]) == ""

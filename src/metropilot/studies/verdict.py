"""Verdicts of a study: each claim of the paper, ours with its interval, the strongest simple rival."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from metropilot.evaluate import bootstrap
from metropilot.studies.report import ReportRow

Judgement = Literal["beaten", "matched", "missed", "cannot be tested"]
Aim = Literal["low", "high", "same"]
Standing = Literal["better", "worse", "same", "unsure"]
SIGNIFICANCE = 0.05
ROUNDING = 0.005
"""Half a unit of the last digit that the papers print, and the share by which values count as equal."""


@dataclass(frozen=True)
class Claim:
    """A claim of the paper, and the rows of the report that decide it.

    Attributes:
        words: The claim, as a sentence.
        driver: Driver whose row is judged.
        kpi: The row's quantity.
        case: The row's case.
        aim: Whether a low or a high value is good, or the published value itself.
        rivals: Drivers without learning, whose best row of the same case and quantity is the rival.
        table: The row's table; empty: any.
        untestable: Reason for which the claim cannot be tested; empty: it can.
        rounding: Difference from the published value that counts as none; None: ``ROUNDING``.
        chance: Quantity of the same driver and case that holds the p of the claim, where the claim compares
            two learners itself; empty: it does not.
        target: Value that the paper itself aimed at, as a scheduled time, where the nearer one is the better;
            None: ``aim`` says it.
    """

    words: str
    driver: str
    kpi: str
    case: str
    aim: Aim = "low"
    rivals: tuple[str, ...] = ()
    table: str = ""
    untestable: str = ""
    rounding: float | None = None
    chance: str = ""
    target: float | None = None


@dataclass(frozen=True)
class Rival:
    """Best of the simple drivers on the quantity of a claim.

    Attributes:
        driver: Its id.
        value: Its median over the seeds.
        p: Two-sided probability of so large a difference from ours by chance; None: too few seeds.
        ours_is: Our value beside it: better, worse or same, or unsure where that may be chance.
    """

    driver: str
    value: float
    p: float | None
    ours_is: Standing


@dataclass(frozen=True)
class ClaimVerdict:
    """Judgement of one claim.

    Attributes:
        claim: The claim, as a sentence.
        kpi: The quantity.
        unit: Its unit.
        published: The paper's number; None where it gives none.
        ours: Median over the seeds; None where it cannot be tested.
        low: Lower end of the 95 % bootstrap interval of the median.
        high: Its upper end.
        rival: The strongest simple rival; None: there is none.
        verdict: beaten, matched or missed against the published number, or cannot be tested.
        why: The reason, and how the rival does.
    """

    claim: str
    kpi: str
    unit: str
    published: float | None
    ours: float | None
    low: float | None
    high: float | None
    rival: Rival | None
    verdict: Judgement
    why: str

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)


def median_interval(values: Sequence[float], seed: int = 0) -> tuple[float, float]:
    """The 95 % bootstrap interval of the median (percentile method); the value itself where all agree.

    Args:
        values: One value per seed.
        seed: Seed of the resampling.
    """
    found = bootstrap(np.asarray(values, np.float64), np.median, seed)
    return found.low, found.high


def difference_p(ours: Sequence[float], other: Sequence[float]) -> float | None:
    """Two-sided p of a difference: Mann-Whitney, or Wilcoxon where the other has one value; None if too few.

    Args:
        ours: One value per seed.
        other: One value per seed; a driver without random numbers repeats its value.
    """
    from scipy.stats import mannwhitneyu, wilcoxon

    a, b = (np.asarray(values, np.float64) for values in (ours, other))
    if a.size < 5 or np.ptp(a) == 0.0:
        return None
    if np.ptp(b) == 0.0:
        return float(np.asarray(wilcoxon(a - b[0]))[1]) if np.any(a != b[0]) else 1.0
    return float(mannwhitneyu(a, b).pvalue)


def judge_claims(claims: Iterable[Claim], rows: Sequence[ReportRow]) -> list[ClaimVerdict]:
    """Judge every claim by the rows of a report.

    Args:
        claims: The claims.
        rows: Every row of the report.
    """
    return [judge_claim(claim, rows) for claim in claims]


def judge_claim(claim: Claim, rows: Sequence[ReportRow]) -> ClaimVerdict:
    """Judge one claim by the rows of a report."""
    row = find_row(claim, claim.driver, rows)
    if row is None or row.ours is None or claim.untestable:
        unmeasured = "not measured with this budget" if row is None else "too few runs reach it for a median"
        reason = claim.untestable or unmeasured
        unit, published = ("", None) if row is None else (row.unit, row.published)
        return ClaimVerdict(
            claim.words, claim.kpi, unit, published, None, None, None, None, "cannot be tested", reason
        )
    low, high = median_interval(row.values or (row.ours,))
    rival = find_rival(claim, row, rows)
    judgement = _against_published(claim, row, low, high)
    why = _rival_words(claim, rival)
    if claim.target is not None:
        why = f"aimed at: {claim.target:g} {row.unit}; {why}".rstrip("; ")
    if claim.chance:
        chance = find_row(replace(claim, kpi=claim.chance), claim.driver, rows)
        judgement, why = _judge_chance(judgement, None if chance is None else chance.ours)
    if row.published is None:
        why = f"no number is printed; {why}"
    return ClaimVerdict(
        claim.words, claim.kpi, row.unit, row.published, row.ours, low, high, rival, judgement, why
    )


def find_row(claim: Claim, driver: str, rows: Sequence[ReportRow]) -> ReportRow | None:
    """Row of a driver on the quantity of a claim; None if there is none."""
    wanted = (driver, claim.kpi, claim.case)
    for row in rows:
        if (row.driver, row.kpi, row.case) == wanted and claim.table in ("", row.table):
            return row
    return None


def find_rival(claim: Claim, row: ReportRow, rows: Sequence[ReportRow]) -> Rival | None:
    """The best of the simple drivers on the quantity of a claim; None if none was measured."""
    found = [(name, find_row(claim, name, rows)) for name in claim.rivals]
    known = [
        (name, other, other.ours) for name, other in found if other is not None and other.ours is not None
    ]
    if not known:
        return None

    name, other, value = min(known, key=lambda one: _loss(claim, row.published, one[2]))
    middle = row.ours or 0.0
    p = difference_p(row.values or (middle,), other.values or (value,))
    ahead = _loss(claim, row.published, middle) < _loss(claim, row.published, value)
    ours_is: Standing = "better" if ahead else "worse"
    if value == middle:
        ours_is = "same"
    elif p is not None and p >= SIGNIFICANCE:
        ours_is = "unsure"
    return Rival(name, value, p, ours_is)


def _against_published(claim: Claim, row: ReportRow, low: float, high: float) -> Judgement:
    """Beaten, matched or missed: the interval of the median against the printed number."""
    published = row.published
    if published is None or row.ours is None:
        return "cannot be tested"
    near = claim.rounding if claim.rounding is not None else max(ROUNDING, ROUNDING * abs(published))
    if low - near <= published <= high + near:
        return "matched"
    better = _loss(claim, published, row.ours) < _loss(claim, published, published)
    return "beaten" if better else "missed"


def _judge_chance(judgement: Judgement, p: float | None) -> tuple[Judgement, str]:
    """Withdraw the judgement of a comparison of two learners whose difference may be chance; and why."""
    if p is None:
        return "cannot be tested", "too few seeds for a test"
    if p >= SIGNIFICANCE:
        return "cannot be tested", f"the difference may be chance (p = {p:.2g})"
    return judgement, f"p = {p:.2g}"


def _loss(claim: Claim, published: float | None, value: float) -> float:
    """Badness of a value: less is better."""
    if claim.target is not None:
        return abs(value - claim.target)
    if claim.aim == "same":
        return abs(value - (published or 0.0))
    return value if claim.aim == "low" else -value


def _rival_words(claim: Claim, rival: Rival | None) -> str:
    """Comparison with the strongest simple rival, as a sentence."""
    if rival is None:
        return "no simple rival measured" if claim.rivals else ""
    if rival.ours_is == "same":
        return f"{rival.driver} does the same"
    sure = "too few seeds for a test" if rival.p is None else f"p = {rival.p:.2g}"
    if rival.ours_is == "unsure":
        return f"not distinguishable from {rival.driver} ({sure})"
    return f"{rival.ours_is} than {rival.driver} ({sure})"


def sum_up_rivals(verdicts: Sequence[ClaimVerdict]) -> str:
    """Sum up, as a sentence, how learning does beside the strongest simple rivals; empty without rivals."""
    rivals = [verdict.rival for verdict in verdicts if verdict.rival]
    if not rivals:
        return ""
    found = [rival.ours_is for rival in rivals if rival.p is not None]
    better, worse = found.count("better"), found.count("worse")
    open_ = len(rivals) - better - worse
    verb = "adds nothing" if not better else "adds" if better > worse else "adds little"
    return (
        f"**Learning {verb}**: beside the strongest simple rival it is better in {better}, worse in {worse}, "
        f"and the same, not distinguishable or not tested in {open_} of {len(rivals)} claims."
    )


def count_verdicts(verdicts: Sequence[ClaimVerdict]) -> str:
    """Number of claims by judgement, as words."""
    order: tuple[Judgement, ...] = ("beaten", "matched", "missed", "cannot be tested")
    counts = [(sum(v.verdict == name for v in verdicts), name) for name in order]
    return ", ".join(f"{count} {name}" for count, name in counts if count)

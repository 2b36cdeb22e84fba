"""Report of a study: rows of published, reproduced and optimal values, figures, deviations from the paper."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from metropilot.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Drawing

    from metropilot.learn import RunRecord
    from metropilot.studies.verdict import Claim, ClaimVerdict


RECORDED = ("task", "algorithm", "seed", "steps", "seconds", "machine", "created", "commit_id")
"""Fields of a learning run's record that a report prints."""


@dataclass(frozen=True)
class ReportRow:
    """One number of a study.

    Attributes:
        table: Table or figure of the paper it belongs to; "beyond the paper" where the paper has none.
        case: The run: scheduled time, scenario, reference.
        driver: Driver id.
        kpi: The quantity measured, in words.
        unit: Its unit; empty for a count or ratio.
        published: The paper's number; None where it gives none.
        ours: Median over the seeds; None where nothing could be measured.
        low: Smallest over the seeds.
        high: Largest over the seeds.
        optimum: Best value that is physically possible; None where there is no such bound.
        values: Value of every seed; empty where nothing is random.
    """

    table: str
    case: str
    driver: str
    kpi: str
    unit: str
    published: float | None = None
    ours: float | None = None
    low: float | None = None
    high: float | None = None
    optimum: float | None = None
    values: tuple[float, ...] = ()

    def with_values(self, values: Iterable[float]) -> ReportRow:
        """The same row with the median and range of one value per seed.

        Raises:
            InputError: No value, or one that is not finite.
        """
        found = np.asarray(list(values), np.float64)
        if found.size == 0 or not np.isfinite(found).all():
            raise InputError("not measured", field=f"{self.case} {self.driver} {self.kpi}", value=found)
        low, middle, high = (float(v) for v in (found.min(), np.median(found), found.max()))
        each = tuple(float(value) for value in found)
        return replace(self, ours=middle, low=low, high=high, values=each)


def make_row(
    table: str,
    case: str,
    driver: str,
    kpi: str,
    unit: str,
    values: Iterable[float],
    published: float | None = None,
    optimum: float | None = None,
) -> ReportRow:
    """A row with the median and range of one value per seed; see :class:`ReportRow`.

    Raises:
        InputError: No value, or one that is not finite.
    """
    return ReportRow(table, case, driver, kpi, unit, published, optimum=optimum).with_values(values)


def paragraphs(text: str) -> tuple[str, ...]:
    """Paragraphs of a text, each on one line."""
    return tuple(" ".join(part.split()) for part in text.strip().split("\n\n"))


@dataclass(frozen=True)
class Figure:
    """One figure.

    Attributes:
        name: File name without ending, unique in the study.
        caption: Content, and the figure of the paper that it answers.
        draw: Draws the figure; called inside the house style, only when a folder is written.
    """

    name: str
    caption: str
    draw: Callable[[], Drawing]


@dataclass(frozen=True)
class PrintedSetting:
    """One setting of a paper beside that of its study.

    Attributes:
        name: What is set.
        printed: The paper's setting.
        ours: The study's.
        settled: What a run of the printed settings takes, and why, where the paper is ambiguous or silent;
            empty: what is printed.
    """

    name: str
    printed: str
    ours: str
    settled: str = ""


@dataclass(frozen=True)
class LiteralRow:
    """One number three times: the paper's, the study's, and that of a run of the paper's own settings.

    Attributes:
        case: The run.
        driver: Driver id.
        kpi: The quantity measured, in words.
        unit: Its unit; empty for a count or ratio.
        published: The paper's number; None where it gives none.
        ours: The study's own; None where it has no such row.
        as_printed: Median over the seeds under the printed settings; None where nothing could be measured.
        low: Smallest over the seeds.
        high: Largest over the seeds.
        values: Value of every seed.
    """

    case: str
    driver: str
    kpi: str
    unit: str
    published: float | None
    ours: float | None
    as_printed: float | None
    low: float | None = None
    high: float | None = None
    values: tuple[float, ...] = ()


@dataclass(frozen=True)
class LiteralReport:
    """Results of a study's run of the printed settings.

    Attributes:
        settings: The settings.
        rows: Every number.
        remarks: What was cut short, and findings.
    """

    settings: Sequence[PrintedSetting]
    rows: Sequence[LiteralRow]
    remarks: Sequence[str] = ()

    def deviations(self) -> list[str]:
        """Every ambiguity that was settled, as a sentence."""
        return [f"As printed, {one.name}: {one.settled}" for one in self.settings if one.settled]


def compare_rows(literal: Iterable[ReportRow], ours: Iterable[ReportRow]) -> list[LiteralRow]:
    """Rows of the printed settings, each beside the study's row of its table, case, driver and quantity."""

    def key(row: ReportRow) -> tuple[str, str, str, str]:
        return row.table, row.case, row.driver, row.kpi

    known = {key(row): row for row in ours}
    found = []
    for row in literal:
        other = known.get(key(row))
        published = row.published if other is None or row.published is not None else other.published
        ours_too = None if other is None else other.ours
        numbers = (published, ours_too, row.ours, row.low, row.high, row.values)
        found.append(LiteralRow(row.case, row.driver, row.kpi, row.unit, *numbers))
    return found


@dataclass(frozen=True)
class StudyReport:
    """Results of a study and their provenance.

    Attributes:
        seeds: Number of seeds.
        rows: Every number.
        figures: Every figure.
        deviations: Departures from the paper and their reasons, one sentence or two each.
        remarks: Findings: claims of the paper that were not reached, and the reasons.
        claims: Claims of the paper that the rows decide.
        study: Its id.
        title: Its heading.
        budget: quick or paper.
        seconds: Wall time.
        circumstances: Machine, date, commit, versions.
        learning: Records of the learning runs behind the rows.
        as_printed: Results of the paper's own settings; None where they were not asked for.
    """

    seeds: int
    rows: Sequence[ReportRow]
    figures: Sequence[Figure] = ()
    deviations: Sequence[str] = ()
    remarks: Sequence[str] = ()
    claims: Sequence[Claim] = ()
    study: str = ""
    title: str = ""
    budget: str = ""
    seconds: float = 0.0
    circumstances: dict[str, str] = field(default_factory=dict)
    learning: Sequence[RunRecord] = ()
    as_printed: LiteralReport | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON: ``study, budget, seeds, seconds, rows`` first."""
        return {
            "study": self.study,
            "budget": self.budget,
            "seeds": self.seeds,
            "seconds": round(self.seconds, 1),
            "verdicts": [verdict.as_dict() for verdict in self.verdicts],
            "rows": [asdict(row) for row in self.rows],
            "as_printed": None if self.as_printed is None else asdict(self.as_printed),
            "figures": [{"name": f.name, "caption": f.caption} for f in self.figures],
            "deviations": list(self.deviations),
            "remarks": list(self.remarks),
            "circumstances": dict(self.circumstances),
            "learning": [
                {name: getattr(record, name) for name in RECORDED} | {"config": dict(record.config)}
                for record in self.learning
            ],
        }

    @cached_property
    def verdicts(self) -> list[ClaimVerdict]:
        """Judgement of every claim."""
        from metropilot.studies.verdict import judge_claims

        return judge_claims(self.claims, self.rows)

    def tables(self) -> dict[str, list[ReportRow]]:
        """Rows by table, in the order they came."""
        found: dict[str, list[ReportRow]] = {}
        for row in self.rows:
            found.setdefault(row.table, []).append(row)
        return found

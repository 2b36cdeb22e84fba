"""Papers reproduced: declarations, published numbers, tables of published, reproduced and optimal values."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metropilot._lazy import lazy_door

if TYPE_CHECKING:
    from metropilot.studies.learning import LearnJob, SeedResult, learn_seeds
    from metropilot.studies.page import row_numbers, study_page, write_docs, write_report
    from metropilot.studies.registry import STUDIES, reproduce
    from metropilot.studies.report import Figure, ReportRow, StudyReport
    from metropilot.studies.study import BUDGETS, Order, Study, check_budget

__all__ = [
    "BUDGETS",
    "STUDIES",
    "Figure",
    "LearnJob",
    "Order",
    "ReportRow",
    "SeedResult",
    "Study",
    "StudyReport",
    "check_budget",
    "learn_seeds",
    "reproduce",
    "row_numbers",
    "study_page",
    "write_docs",
    "write_report",
]

__getattr__, __dir__ = lazy_door(
    __name__,
    {
        "learning": ("LearnJob", "SeedResult", "learn_seeds"),
        "page": ("row_numbers", "study_page", "write_docs", "write_report"),
        "registry": ("STUDIES", "reproduce"),
        "report": ("Figure", "ReportRow", "StudyReport"),
        "study": ("BUDGETS", "Order", "Study", "check_budget"),
    },
)

"""Papers reproduced: declarations, published numbers, and tables of published, reproduced and optimal values.

The door is lazy: listing the studies imports none of them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from metropilot.studies.learning import LearnJob, SeedResult, learn_seeds
    from metropilot.studies.page import page, write_docs, write_report
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
    "page",
    "reproduce",
    "write_docs",
    "write_report",
]

_HOME = {
    "BUDGETS": "study",
    "Figure": "report",
    "LearnJob": "learning",
    "Order": "study",
    "StudyReport": "report",
    "ReportRow": "report",
    "SeedResult": "learning",
    "Study": "study",
    "check_budget": "study",
    "learn_seeds": "learning",
    "page": "page",
    "write_docs": "page",
    "write_report": "page",
}


def __getattr__(name: str) -> Any:  # noqa: ANN401 (whatever the door offers)
    """Import a name from its private file on first use (PEP 562)."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME.get(name, 'registry')}"), name)

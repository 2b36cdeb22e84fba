"""Drives measured: the host loop, trajectories, KPIs, comparisons, pictures and the folder of a run."""

from metropilot.evaluate.compare import Entry, Interval, Job, best, compare, jobs
from metropilot.evaluate.driver_options import make_driver, option_defaults
from metropilot.evaluate.folder import (
    comparison_json,
    write_comparison,
    write_run,
)
from metropilot.evaluate.kpis import Check, Kpis, checks, kpis_of, outcome_words, verdict
from metropilot.evaluate.optimum import Objective, Optimum, optimum_of
from metropilot.evaluate.request import Request
from metropilot.evaluate.request_file import request_from_toml

__all__ = [
    "Check",
    "Entry",
    "Interval",
    "Job",
    "Kpis",
    "Objective",
    "Optimum",
    "Request",
    "best",
    "checks",
    "compare",
    "comparison_json",
    "jobs",
    "kpis_of",
    "make_driver",
    "optimum_of",
    "option_defaults",
    "outcome_words",
    "request_from_toml",
    "verdict",
    "write_comparison",
    "write_run",
]

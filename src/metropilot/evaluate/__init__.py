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
from metropilot.evaluate.run_spec import POLICY, RunSpec, is_file, key_type, run_fields, run_from_toml

__all__ = [
    "POLICY",
    "Check",
    "Entry",
    "Interval",
    "Job",
    "Kpis",
    "Objective",
    "Optimum",
    "RunSpec",
    "best",
    "checks",
    "compare",
    "comparison_json",
    "is_file",
    "jobs",
    "key_type",
    "kpis_of",
    "make_driver",
    "optimum_of",
    "option_defaults",
    "outcome_words",
    "run_fields",
    "run_from_toml",
    "verdict",
    "write_comparison",
    "write_run",
]

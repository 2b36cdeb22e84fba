"""Permitted speed, and the supervisor that keeps every driver within the limits."""

from metropilot.protection.bounds import Bounds
from metropilot.protection.braking import permitted_before_service, permitted_braking
from metropilot.protection.curves import protect
from metropilot.protection.separation import PairBounds, Separation, TrainAhead, separate
from metropilot.protection.supervisor import approach_margin, permitted_speed, spare_gap, supervise
from metropilot.protection.types import LEVELS, Memory, Protection, Rates, Verdict, at_start

__all__ = [
    "LEVELS",
    "Bounds",
    "Memory",
    "PairBounds",
    "Protection",
    "Rates",
    "Separation",
    "TrainAhead",
    "Verdict",
    "approach_margin",
    "at_start",
    "permitted_before_service",
    "permitted_braking",
    "permitted_speed",
    "protect",
    "separate",
    "spare_gap",
    "supervise",
]

"""Permitted speed, and the supervisor that keeps every driver within the limits."""

from metropilot.protection.bounds import Bounds
from metropilot.protection.braking import permitted_before_service, permitted_braking
from metropilot.protection.curves import protect
from metropilot.protection.separation import Ahead, PairBounds, Separation, separate
from metropilot.protection.supervisor import approach_margin, permitted_speed, spare_gap, supervise
from metropilot.protection.types import LEVELS, Memory, Protection, Verdict, at_start

__all__ = [
    "LEVELS",
    "Ahead",
    "Bounds",
    "Memory",
    "PairBounds",
    "Protection",
    "Separation",
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

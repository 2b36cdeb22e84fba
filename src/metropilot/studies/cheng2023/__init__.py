"""Cheng et al. 2023: tracking a reference with a PID whose gains are learned."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metropilot._lazy import lazy_door

if TYPE_CHECKING:
    from metropilot.studies.cheng2023.setting import course

__all__ = ["course"]

__getattr__, __dir__ = lazy_door(
    __name__,
    {
        "setting": ("course",),
    },
)

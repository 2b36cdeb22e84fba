"""Every kind of action by name, as the file of a policy names it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from metropilot.env.actions import (
    AbstractAction,
    CommandAction,
    GainsAction,
    IncrementAction,
    NotchAction,
    NotchForceAction,
    RegimeAction,
)
from metropilot.env.expert_action import ExpertAction, ExpertChoiceAction

ACTIONS: Mapping[str, type[AbstractAction]] = MappingProxyType(
    {
        "command": CommandAction,
        "regime": RegimeAction,
        "increment": IncrementAction,
        "notches": NotchAction,
        "notch_forces": NotchForceAction,
        "gains": GainsAction,
        "expert": ExpertAction,
        "expert_choice": ExpertChoiceAction,
    }
)

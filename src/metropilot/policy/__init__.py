"""Learned policies: one file each, run without JAX."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metropilot._lazy import lazy_door

if TYPE_CHECKING:
    from metropilot.policy.file import load_policy, save_policy, shipped_policy
    from metropilot.policy.loaded import (
        POLICY_FILE,
        GuardedPolicy,
        LoadedPolicy,
        load_driving_policy,
        policy_path,
    )
    from metropilot.policy.networks import Activation, Params, dueling, forward
    from metropilot.policy.policy import (
        NORMALISED_RANGE,
        Policy,
        PolicySpec,
        act,
        choose_action,
        network_output,
        normalise,
        only_policy,
        table_cell,
    )

__all__ = [
    "NORMALISED_RANGE",
    "POLICY_FILE",
    "Activation",
    "GuardedPolicy",
    "LoadedPolicy",
    "Params",
    "Policy",
    "PolicySpec",
    "act",
    "choose_action",
    "dueling",
    "forward",
    "load_driving_policy",
    "load_policy",
    "network_output",
    "normalise",
    "only_policy",
    "policy_path",
    "save_policy",
    "shipped_policy",
    "table_cell",
]

__getattr__, __dir__ = lazy_door(
    __name__,
    {
        "file": ("load_policy", "save_policy", "shipped_policy"),
        "policy": (
            "NORMALISED_RANGE",
            "Policy",
            "PolicySpec",
            "act",
            "choose_action",
            "network_output",
            "normalise",
            "only_policy",
            "table_cell",
        ),
        "loaded": ("GuardedPolicy", "LoadedPolicy", "POLICY_FILE", "load_driving_policy", "policy_path"),
        "networks": ("Activation", "Params", "dueling", "forward"),
    },
)

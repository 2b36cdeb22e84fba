"""Learned policies: one file each, run without JAX."""

from __future__ import annotations

from typing import TYPE_CHECKING

from metropilot._lazy import lazy_door

if TYPE_CHECKING:
    from metropilot.policy.file import load_policy, save_policy, shipped_policy
    from metropilot.policy.guarded import (
        POLICY_FILE,
        GuardedPolicy,
        LoadedPolicy,
        load_driving_policy,
        policy_path,
    )
    from metropilot.policy.networks import (
        NORMALISED_RANGE,
        Activation,
        Params,
        Policy,
        PolicySpec,
        act,
        choose_action,
        dueling,
        forward,
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
        "guarded": ("GuardedPolicy", "LoadedPolicy", "POLICY_FILE", "load_driving_policy", "policy_path"),
        "networks": (
            "Activation",
            "NORMALISED_RANGE",
            "Params",
            "Policy",
            "PolicySpec",
            "act",
            "choose_action",
            "dueling",
            "forward",
            "network_output",
            "normalise",
            "only_policy",
            "table_cell",
        ),
    },
)

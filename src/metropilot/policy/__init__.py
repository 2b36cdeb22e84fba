"""Learned policies: one file each, run without JAX."""

from metropilot.policy.file import load_policy, save_policy, shipped_policy
from metropilot.policy.policy import Policy, PolicySpec, act

__all__ = [
    "Policy",
    "PolicySpec",
    "act",
    "load_policy",
    "save_policy",
    "shipped_policy",
]

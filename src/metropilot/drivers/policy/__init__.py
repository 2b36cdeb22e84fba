"""What runs a learned policy, without JAX: networks as functions, the policy, its file."""

from metropilot.drivers.policy.policy import Policy, PolicySpec, act
from metropilot.drivers.policy.policy_file import load_policy, save_policy

__all__ = ["Policy", "PolicySpec", "act", "load_policy", "save_policy"]

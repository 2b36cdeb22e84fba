"""Where :func:`write_whole` is for those who learn; it lives with the policy file, further left."""

from metropilot.drivers.policy.files import write_whole

__all__ = ["write_whole"]

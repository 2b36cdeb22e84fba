"""The driving tasks as Gymnasium environments; importing this registers their ids. Needs the extra ``rl``."""

from metropilot.env.adapters.gymnasium import DriveEnv, DriveVectorEnv, environment_id

__all__ = ["DriveEnv", "DriveVectorEnv", "environment_id"]

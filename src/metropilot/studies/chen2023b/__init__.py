"""Chen et al. 2023 (Actuators): train tracking in virtual coupling with SAC-PID, against DDPG-PID."""

from metropilot.studies.chen2023b.reproduce import STUDY

__all__ = ["STUDY"]

"""Drivers that learn: DQN, PPO, DDPG, SAC, NAF and tabular Q-learning, each run one compiled program."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

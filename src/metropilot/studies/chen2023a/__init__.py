"""Chen et al. 2023: PPO with reward scaling, PPO and DDPG drive one section by position and speed."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

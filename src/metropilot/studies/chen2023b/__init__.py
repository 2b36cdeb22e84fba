"""Chen et al. 2023 (Actuators): train tracking in virtual coupling with SAC-PID, against DDPG-PID."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

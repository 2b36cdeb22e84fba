"""Lu and Liu 2023: driving by twelve notches, learned by improved DQN."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""The driving problem as a functional environment: features, actions, rewards, assists."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Web console and HTTP API in one process; loads nothing from a network. Needs the extra ``web``."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Supervised drivers outside Python: one C99 source of the same functions, and WebAssembly of it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

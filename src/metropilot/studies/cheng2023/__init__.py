"""Cheng et al. 2023: tracking a reference with a PID whose gains are learned."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Huang et al. 2025: an expert system, and PPO inside it, against manual driving, ITOR and STON."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

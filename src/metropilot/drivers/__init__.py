"""Drivers: anything that gives the command, one file each; listing them imports none of those files."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Calibration of a trainset from logs of runs: reading, maximum likelihood, intervals, report."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Control laws on the nominal plant: estimation, station stop, ceiling, coasting, incremental PID."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""One control period after another: a run, its disturbance, the host loop, its outcome and trajectory."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

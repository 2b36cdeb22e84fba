"""Lines, trainsets and journeys: schema, loaders and catalogue. NumPy only, never JAX."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

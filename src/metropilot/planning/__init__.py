"""Plans: flat out, energy-optimal with a certificate, journeys, and what a second costs."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""A line in operation: electric power of all trains, feeding zones, floor, periodic timetables."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

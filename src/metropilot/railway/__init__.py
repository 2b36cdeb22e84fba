"""Lines, trainsets and journeys: schema, loaders and catalogue. NumPy only, never JAX."""

from metropilot.railway.effort import Efficiency, EffortCurve, EffortPiece
from metropilot.railway.journey import Journey, TimingPoint
from metropilot.railway.library import import_file, list_lines, list_trainsets, load_line, load_trainset
from metropilot.railway.line import Curve, Line, Restriction, Section, Station, Tunnel
from metropilot.railway.profile import Steps
from metropilot.railway.trainset import Actuation, Couplers, Davis, SafeBraking, Trainset

__all__ = [
    "Actuation",
    "Couplers",
    "Curve",
    "Davis",
    "Efficiency",
    "EffortCurve",
    "EffortPiece",
    "Journey",
    "Line",
    "Restriction",
    "SafeBraking",
    "Section",
    "Station",
    "Steps",
    "TimingPoint",
    "Trainset",
    "Tunnel",
    "import_file",
    "list_lines",
    "list_trainsets",
    "load_line",
    "load_trainset",
]

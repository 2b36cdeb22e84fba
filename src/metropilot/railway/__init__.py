"""Lines, trainsets and journeys: schema, loaders and catalogue. NumPy only, never JAX."""

from metropilot.railway.effort import Efficiency, EffortCurve, EffortPiece
from metropilot.railway.formats.toml import write_journey, write_line
from metropilot.railway.formats.toml_trainset import write_trainset
from metropilot.railway.formats.ttobench_write import export_ttobench
from metropilot.railway.journey import Journey, TimingPoint, planned_journey
from metropilot.railway.library import (
    import_file,
    list_lines,
    list_trainsets,
    load_journey,
    load_line,
    load_trainset,
)
from metropilot.railway.line import RESTRICTION_KMH, Curve, Line, Restriction, Section, Station, Tunnel
from metropilot.railway.profile import Steps
from metropilot.railway.trainset import Actuation, Couplers, Davis, SafeBraking, Trainset

__all__ = [
    "RESTRICTION_KMH",
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
    "export_ttobench",
    "import_file",
    "list_lines",
    "list_trainsets",
    "load_journey",
    "load_line",
    "load_trainset",
    "planned_journey",
    "write_journey",
    "write_line",
    "write_trainset",
]

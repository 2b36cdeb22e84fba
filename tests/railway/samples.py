"""Small documents that these tests read, break and mutate; made up, but shaped like real ones."""

import copy
from typing import Any

LINE = """
kind = "line"
id = "toy"
name = "Toy line"

[stations]
unit = "km"
source = "made up"
list = [
  { code = "A", name = "Alpha", position = 0 },
  { code = "B", name = "Beta Square", position = 1.5, pinyin = "Beita" },
  { code = "C", name = "Beta Park", position = 2.5 },
]

[speed_limits]
units = { from = "m", speed = "km/h" }
values = [[0, 50], [300, 80], [2400, 60]]

[gradients]
units = { from = "m", gradient = "permil", altitude = "m" }
altitude = 12
values = [[0, 0], [400, 10], [900, -5], [2000, 0]]

[curves]
units = { from = "m", radius = "m" }
values = [[100, 400], [300, 0], [700, -800], [900, 0]]

[tunnels]
units = { from = "m", length = "m", cross_section = "m^2" }
values = [[200, 300, 24]]

[timetable]
unit = "s"
forward = [110, 80]
backward = [112, 81]
dwell = [30]

[movement_authority]
units = { distance = "m", release_speed = "km/h" }
distance = 5
release_speed = 10
"""

TRAINSET = """
kind = "trainset"
id = "toy"
name = "Toy trainset"

[mass]
units = { loads = "t", rotating_fraction = "%" }
loads = { empty = 200, full = 300 }
load = "empty"
rotating_fraction = 6

[body]
units = { length = "m", max_speed = "km/h" }
length = 120
max_speed = 80

[resistance]
units = { davis = "N/kN", speed = "km/h" }
davis = [2, 0.05, 0.002]
curve_formula = "600/r"

[traction]
units = { speed = "km/h", force = "kN", power = "kW" }
pieces = [{ from = 0, polynomial = [200] }, { from = 36, power = 2000, cap = 200 }]

[electric_brake]
units = { speed = "km/h", force = "kN" }
table = [[0, 180], [40, 180], [80, 90]]

[limits]
units = { max_acceleration = "m/s^2", max_deceleration = "m/s^2" }
max_acceleration = 1
max_deceleration = 1.1

[energy]
units = { traction = "%", braking = "1", receptivity = "1", auxiliary = "kW" }
traction = 88
braking = 0.9
receptivity = 0.7
auxiliary = 100

[protection]
units = { emergency_deceleration = "m/s^2", service_deceleration = "m/s^2", reaction = "s" }
emergency_deceleration = 1.2
service_deceleration = 1
reaction = 0.3

[notches]
unit = "kN"
levels = { three = [-100, 0, 100] }
"""

FEEDING = """
kind = "feeding"
id = "toy"
name = "Toy feeding"
line = "toy"

[substations]
units = { position = "km", no_load_voltage = "V", resistance = "mohm" }
source = "made up"
no_load_voltage = 850
resistance = 20
list = [
  { name = "A", position = 0 },
  { name = "B", position = 1.5, resistance = 8 },
]

[inverters]
units = { voltage = "V", resistance = "ohm" }
voltage = 870
resistance = 0.04
at = ["B"]

[rails]
units = { conductor = "mohm/km", running = "ohm/km" }
conductor = 8
running = 0.018

[trains]
units = { max_current = "kA", reduced_below = "V", cut_off = "V", squeezed_above = "V", max_voltage = "V" }
max_current = 6
reduced_below = 550
cut_off = 500
squeezed_above = 875
max_voltage = 900
"""

DAY = """
kind = "day"
id = "toy"
name = "Toy day"
line = "toy"

[periods]
units = { headway = "min", dwell = "s" }
source = "made up"
list = [
  { name = "early", from = "05:30", to = "06:00", headway = 10 },
  { name = "late", from = "23:15:30", to = "25:00", headway = 20, dwell = 45 },
]

[trains]
units = { longest_wait = "min" }
fleet = 3
longest_wait = 5
"""

JOURNEY = """
kind = "journey"
id = "toy"
line = "toy"

[timing_points]
units = { position = "km", time = "min", speed = "km/h" }
list = [
  { position = 0, earliest = 0, latest = 0, fastest = 0 },
  { position = 1.5, latest = 2, slowest = 10, fastest = 36 },
  { position = 2.5, earliest = 3, latest = 4, fastest = 0 },
]
"""


def _meta(name: str, version: str = "TTOBench v1.5", **more: str) -> dict[str, Any]:
    return {"id": name, "created by": "nobody", "library version": version, "license": "none", **more}


_TRACK = {
    "metadata": _meta("toy_track"),
    "altitude": {"unit": "km", "value": 0.2},
    "stops": {"unit": "km", "values": [0.0, 1.25, 3.0]},
    "speed limits": {"units": {"position": "km", "velocity": "m/s"}, "values": [[0.0, 15], [0.5, 20]]},
    "gradients": {"units": {"position": "m", "slope": "permil"}, "values": [[0.0, 0.0], [700.0, -8.5]]},
    "curvatures": {
        "units": {"position": "m", "radius at start": "m", "radius at end": "km"},
        "values": [
            [0.0, "infinity", "infinity"],
            [100.0, "infinity", 0.5],
            [150.0, 500.0, 0.5],
            [400.0, -300, "-0.3"],
        ],
    },
    "tunnels": {
        "units": {"position": "m", "length": "m", "cross section": "m^2"},
        "values": [[900.0, 250.0, 40.0]],
    },
    "ETCS braking data": {"M_NVAVADH": {"unit": "-", "value": 0}},
    "platforms": {"unit": "m", "values": [120, 120, 120]},
}

_TRAIN = {
    "metadata": _meta("toy_train", description="for tests"),
    "num seats": {"unit": "-", "value": 300},
    "num coaches": {"unit": "-", "value": 4},
    "length": {"unit": "km", "value": 0.08},
    "mass": {"unit": "t", "value": 160},
    "rho": {"unit": "%", "value": 8},
    "max traction power": {"unit": "MW", "value": 2.5},
    "max reg braking power": {"unit": "kW", "value": 2000.0},
    "max traction force": {"unit": "kN", "value": 190.0},
    "max reg braking force": {"unit": "N", "value": 150000.0},
    "max pn braking force": {"unit": "kN", "value": 160.0},
    "max deceleration": {"unit": "m/s^2", "value": 1.1},
    "max speed": {"unit": "km/h", "value": 120},
    "rolling resistance r0": {"unit": "kN", "value": 2.0},
    "rolling resistance r1": {"unit": "kN/(km/h)", "value": 0.018},
    "rolling resistance r2": {"unit": "N/(m/s)^2", "value": 9.0},
    "efficiency traction": {"unit": "%", "value": 88.0},
    "efficiency reg brake": {"unit": "-", "value": 0.85},
    "tunnel resistance": {
        "units": {"cross section": "m^2", "coefficient": "kN/(km/h)^2"},
        "values": [[24, 0.001], [40, 0.0005]],
    },
    "ETCS braking data": {
        "A_brake_emergency": {
            "units": {"velocity": "km/h", "deceleration": "m/s^2"},
            "values": [[0, 1.2], [80, 1.0]],
        },
        "A_brake_service": {
            "units": {"velocity": "m/s", "deceleration": "m/s^2"},
            "values": [[0, 0.8], [20, 0.7]],
        },
        "K_dry_rst": {"unit": "-", "value": 0.9},
        "K_wet_rst": {"unit": "-", "value": 0.8},
        "T_traction": {"unit": "s", "value": 0.5},
        "T_be": {"unit": "s", "value": 2},
        "T_bs": {"unit": "s", "value": 3},
        "v_uncertainty": {"unit": "%", "value": 3},
    },
}

_JOURNEY = {
    "metadata": _meta("toy_journey", **{"associated track": "toy_track"}),
    "timing points": {
        "units": {
            "position": "km",
            "lower time constraint": "s",
            "upper time constraint": "min",
            "lower speed constraint": "km/h",
            "upper speed constraint": "km/h",
        },
        "values": [[0, 0, 0, 0, 0], [1.25, None, 2, 18, None], [3.0, 150, 3, 0, 0]],
    },
}


def track() -> dict[str, Any]:
    """A TTOBench track with every block, two units for the same quantity, and one block nobody knows."""
    return copy.deepcopy(_TRACK)


def train() -> dict[str, Any]:
    """A TTOBench train with every block."""
    return copy.deepcopy(_TRAIN)


def journey() -> dict[str, Any]:
    """A TTOBench journey with empty cells."""
    return copy.deepcopy(_JOURNEY)

"""Every malformed file gives one line: file, field, value, unit, allowed range."""

import json

import pytest
from tests.railway import samples

from metropilot.errors import InputError
from metropilot.railway import import_file, load_line, load_trainset, write_trainset

# (what to replace, by what, field, value shown or None, unit or None, beginning of what is allowed)
LINE = [
    ('kind = "line"\n', "", "kind", None, None, "line, trainset, journey"),
    ('kind = "line"', 'kind = "lien"', "kind", "lien", None, "line, trainset, journey"),
    ('id = "toy"\n', "", "id", None, None, "text"),
    ('id = "toy"', "id = 3", "id", "3", None, "text"),
    ('id = "toy"', 'id = " "', "id", None, None, "text"),
    ('id = "toy"', 'id = "toy line"', "id", "toy line", None, "letters, digits"),
    ('id = "toy"', 'id = "x\\nall:"', "id", r"x\nall:", None, "letters, digits"),
    ('id = "toy"', 'id = "../x"', "id", "../x", None, "letters, digits"),
    ('code = "B"', 'code = "B*/"', "stations.list[1].code", "B*/", None, "text without quotation marks"),
    ('code = "B"', 'code = "B\\\\"', "stations.list[1].code", "B", None, "text without quotation marks"),
    ('code = "B"', 'code = "B\\nC"', "stations.list[1].code", r"B\nC", None, "text without quotation marks"),
    ('name = "Toy line"', 'nam = "Toy line"', "name", None, None, "text"),
    ('name = "Toy line"', 'name = "Toy"\nnotse = []', "notse", None, None, "extra, gradients"),
    ('name = "Toy line"', 'name = "Toy"\nnotes = [1]', "notes[0]", "1", None, "text"),
    ('name = "Toy line"', 'name = "Toy"\nextra = "[1"', "extra", "[1", None, "a JSON object"),
    ('unit = "km"\n', "", "stations.unit", None, None, "length in m, km"),
    ('unit = "km"', 'unit = "mi"', "stations.unit", "mi", None, "length in m, km"),
    ('unit = "km"', "unit = 4", "stations.unit", "4", None, "length in m, km"),
    ('code = "B", ', "", "stations.list[1].code", None, None, "text"),
    ('code = "C"', 'code = "B"', "stations[2].code", "B", None, "a code of its own"),
    ('code = "C"', 'code = "b"', "stations[2].code", "b", None, "a code of its own"),
    ("position = 1.5", "position = 2.5", "stations.list[2].position", "2.5", "km", "> 2.5 km"),
    ("position = 1.5", "position = nan", "stations.list[1].position", "nan", "km", "a finite number of km"),
    ("position = 1.5", "position = inf", "stations.list[1].position", "inf", "km", "a finite number of km"),
    ("position = 1.5", 'position = "1"', "stations.list[1].position", "1", "km", "a finite number of km"),
    ("position = 1.5", "position = true", "stations.list[1].position", "True", "km", "a finite number of km"),
    ("position = 1.5, ", "", "stations.list[1].position", None, None, "a number of km"),
    ("position = 1.5", "posiiton = 1.5", "stations.list[1].position", None, None, "a number of km"),
    ('pinyin = "Beita"', 'pinjin = "x"', "stations.list[1].pinjin", "pinyin", None, "code, local_name"),
    ("position = 0 }", "position = -1 }", "stations.list[0].position", "-1000", "m", ">= 0 m"),
    ('{ code = "A", name = "Alpha", position = 0 }', "3", "stations.list[0]", "3", None, "{ code, name"),
    ("[speed_limits]", "[speed_limit]", "speed_limits", None, None, "a table"),
    ('speed = "km/h" }', 'speed = "kmh" }', "speed_limits.units.speed", "kmh", None, "speed in m/s, km/h"),
    (', speed = "km/h" }', "}", "speed_limits.units.speed", None, None, "speed in m/s, km/h"),
    ('"km/h" }', '"km/h", sped = "m" }', "speed_limits.units.sped", "speed", None, "from, speed"),
    ("[300, 80]", "[300, -80]", "speed_limits.values[1].speed", "-80", "km/h", "> 0 km/h and <= 540 km/h"),
    ("[300, 80]", "[300, 0]", "speed_limits.values[1].speed", "0", "km/h", "> 0 km/h"),
    ("[300, 80]", "[300, 1e308]", "speed_limits.values[1].speed", "1e+308", "km/h", "> 0 km/h"),
    ("[300, 80]", f"[300, {'9' * 400}]", "speed_limits.values[1].speed", "999", "km/h", "> 0 km/h"),
    ("[300, 80]", "[300]", "speed_limits.values[1]", "[300]", None, "a list of 2: from, speed"),
    ("[300, 80]", "300", "speed_limits.values[1]", "300", None, "a list of 2"),
    ("[300, 80]", "[3000, 80]", "speed_limits.values[2].from", "2400", "m", "> 3000 m"),
    ("[[0, 50], [300, 80], [2400, 60]]", "[]", "speed_limits.values", None, None, "at least one row"),
    ("[[0, 50], [300, 80], [2400, 60]]", "7", "speed_limits.values", "7", None, "a list"),
    ("[[0, 50]", "[[50, 50]", "stations.list[0].position", "0", "m", ">= 50 m"),
    ("[400, 10]", "[400, 200]", "gradients.values[1].gradient", "200", "permil", "-150 to 150 permil"),
    ("[400, 10]", "[400, nan]", "gradients.values[1].gradient", "nan", "permil", "-150 to 150 permil"),
    ("altitude = 12", 'altitude = "high"', "gradients.altitude", "high", "m", "a finite number of m"),
    ("[100, 400]", "[100, 5]", "curves.values[0].radius", "5 m", None, "a radius of 10 m or more"),
    ("[200, 300, 24]", "[200, -300, 24]", "tunnels.values[0].length", "-300", "m", "> 0 m"),
    ("[[200, 300, 24]]", "[[200, 300, 24], [499, 10, 24]]", "tunnels[1].from", "499", "m", ">= 500 m"),
    (
        'radius = "m" }\nvalues = [[100, 400], [300, 0], [700, -800], [900, 0]]',
        'curvature = "1/m" }\nvalues = [[100, 0, 0.002], [1e9, 0, 0]]',
        "curves[0].from",
        "100 to 1e+09",
        "m",
        "at most 120000 m",
    ),
    (
        "forward = [110, 80]",
        "forward = [110]",
        "timetable.forward",
        "1",
        None,
        "2, one for each section",
    ),
    ("forward = [110, 80]", "forward = [110, 0]", "timetable.forward[1]", "0", "s", "> 0 s"),
    (
        "forward = [110, 80]",
        "forward = [1e300, 80]",
        "timetable.forward[0]",
        "1e+300",
        "s",
        "> 0 s and <= 86400 s",
    ),
    (
        "dwell = [30]",
        "dwell = [30, 30]",
        "timetable.dwell",
        "2",
        None,
        "1, one for each station on the way",
    ),
    ("dwell = [30]", "dwell = 30", "timetable.dwell", "30", None, "a list in brackets, [ ]"),
    ('unit = "s"', 'unit = "days"', "timetable.unit", "days", None, "time in s, min, h"),
    ("distance = 5", "distance = -1", "movement_authority.distance", "-1", "m", "0 to 300 m"),
    ("distance = 5", "length = 5", "movement_authority.length", None, None, "distance, release_speed"),
    ("speed = 10", "speed = 0", "movement_authority.release_speed", "0", "km/h", "3 to 40 km/h"),
]
TRAINSET = [
    ("full = 300", "full = -300", "mass.loads.full", "-300", "t", "> 0 t"),
    ("loads = { empty = 200, full = 300 }", "loads = {}", "mass.loads", None, None, "name = mass in t"),
    ('load = "empty"', 'load = "fuel"', "mass.load", "fuel", None, "empty, full"),
    (
        "rotating_fraction = 6",
        "rotating_fraction = 106",
        "mass.rotating_fraction",
        "106",
        "%",
        "0 to 100 %",
    ),
    ("max_speed = 80\n", "", "body.max_speed", None, None, "> 0 km/h"),
    ("max_speed = 80", "max_speed = inf", "body.max_speed", "inf", "km/h", "> 0 km/h and <= 540 km/h"),
    ('davis = "N/kN"', 'davis = "lbf"', "resistance.units.davis", "lbf", None, "force in N, kN"),
    ('davis = "N/kN"', 'davis = "N/lb"', "resistance.units.davis", "N/lb", None, "specific force in N/kg"),
    (
        "davis = [2, 0.05, 0.002]",
        "davis = [2, 0.05]",
        "resistance.davis",
        "[2, 0.05]",
        None,
        "three coefficients",
    ),
    ("davis = [2, 0.05", "davis = [2, -0.05", "resistance.davis[1]", "-0.05", "N/kN", ">= 0 N/kN"),
    ('curve_formula = "600/r"', 'curve_formula = "x"', "resistance.curve_formula", "x", None, "none, 600/r"),
    ("from = 0, polynomial", "from = 1, polynomial", "traction.pieces[0].from", "0.277778 m/s", None, "0"),
    ("from = 36, power", "from = -36, power", "traction.pieces[1].from", "-36", "km/h", ">= 0 km/h"),
    ("from = 36, power", "form = 36, power", "traction.pieces[1].from", None, None, "a number of km/h"),
    (
        "polynomial = [200]",
        "polynomial = [1, 2, 3, 4, 5]",
        "traction.pieces[0].polynomial",
        "[1, 2",
        None,
        "up to four coefficients",
    ),
    ("power = 2000, ", "", "traction.pieces[1].polynomial", None, None, "polynomial, power or both"),
    (
        "[[0, 180], [40, 180], [80, 90]]",
        "[[0, 180], [40, 180], [20, 90]]",
        "table[2].speed",
        "20",
        "km/h",
        "> 40",
    ),
    ("[[0, 180], [40, 180], [80, 90]]", "[]", "electric_brake.table", None, None, "rows by increasing speed"),
    (
        "table = [[0, 180]",
        "force = 3\ntable = [[0, 180]",
        "electric_brake.force",
        None,
        None,
        "one of: pieces",
    ),
    (
        "max_deceleration = 1.1",
        "max_deceleration = 0",
        "limits.max_deceleration",
        "0",
        "m/s^2",
        "0.01 to 10 m/s^2, or inf",
    ),
    (
        "max_acceleration = 1",
        "max_acceleration = 1e9",
        "limits.max_acceleration",
        "1000000000",
        "m/s^2",
        "0.01",
    ),
    (
        "[energy]",
        '[actuation]\nunits = { lag = "s" }\nlag = 30\n[energy]',
        "actuation.lag",
        "30",
        "s",
        "0 to 5 s",
    ),
    (
        "[energy]",
        '[actuation]\nunits = { jerk_limit = "m/s^3" }\njerk_limit = 0.001\n[energy]',
        "actuation.jerk_limit",
        "0.001",
        "m/s^3",
        "0.05 to 100 m/s^3, or inf",
    ),
    (
        "max_deceleration = 1.1",
        "max_decelaration = 1",
        "limits.max_decelaration",
        "max_deceleration",
        None,
        "adhesion",
    ),
    ("traction = 88", "traction = 880", "energy.traction", "880", "%", "> 0 % and <= 100 %"),
    ("reaction = 0.3", "reaction = -0.3", "protection.reaction", "-0.3", "s", "0 to 30 s"),
    ("[-100, 0, 100]", "[-100, 100, 0]", "notches.levels.three[2]", "0", "kN", "> 100 kN"),
    ("[-100, 0, 100]", "[]", "notches.levels.three", None, None, "forces"),
]
JOURNEY = [
    ("position = 1.5, ", "", "timing_points.list[1].position", None, None, "a position"),
    ("latest = 2,", "latest = -2,", "timing_points.list[1].latest", "-2", "min", ">= 0 min"),
    ("position = 2.5", "position = 1", "timing_points[2].position", "1000", "m", ">= 1500 m"),
    ("fastest = 36", "fastest = 5", "timing_points[1].fastest", "1.38889", "m/s", ">= 2.77778 m/s"),
    ("latest = 4", "latest = 1", "timing_points[2].latest", "60", "s", ">= 180 s"),
    ("slowest = 10", "slowst = 10", "timing_points.list[1].slowst", "slowest", None, "earliest, fastest"),
]
FEEDING = [
    ("resistance = 20", "resistance = -20", "substations.resistance", "-20", "mohm", "1e-05 to 100000 mohm"),
    (
        "resistance = 8 ",
        "resistance = 0 ",
        "substations.list[1].resistance",
        "0",
        "mohm",
        "1e-05 to 100000 mohm",
    ),
    ("position = 1.5", "position = 0", "substations[1].position", "0", "m", "> 0 m"),
    ('at = ["B"]', 'at = ["C"]', "inverters.at[0]", "C", None, "A, B"),
    ('at = ["B"]', "", "inverters.at", None, None, "names of substations"),
    ("voltage = 870", "voltage = 840", "inverters.voltage", "840", "V", "above the no-load voltage, 850 V"),
    ("running = 0.018", "running = -1", "rails.running", "-1", "ohm/km", "0 to 1000 ohm/km"),
    ("cut_off = 500", "cut_off = 560", "reduced_below_v", "550", "V", "between 560 and 850 V"),
    ("max_current = 6", "max_curent = 6", "trains.max_curent", "max_current", None, "cut_off"),
    ('max_current = "kA", ', "", "trains.units.max_current", None, None, "current in A, kA"),
]
DAY = [
    ('from = "05:30"', 'from = "5h30"', "periods.list[0].from", "5h30", None, "HH:MM or HH:MM:SS"),
    ('from = "05:30", ', "", "periods.list[0].from", None, None, "HH:MM"),
    ('to = "06:00"', 'to = "05:00"', "periods.list[0].to", "05:00:00", None, "after 05:30:00"),
    ('to = "06:00"', 'to = "23:30"', "periods.list[1].from", "23:15:30", None, "23:30:00 or later"),
    ('to = "25:00"', 'to = "37:00"', "periods.list[1].to", "37:00", None, "00:00:00 to 36:00:00"),
    ("headway = 10 ", "headway = 0.1 ", "periods.list[0].headway", "0.1", "min", "0.166667 to 120 min"),
    (
        "headway = 10 ",
        "headway = 0.51 ",
        "periods.list[0].headway",
        "0.51",
        None,
        "a whole number of seconds",
    ),
    ('headway = "min", ', "", "periods.list[0].units.headway", None, None, "time in s, min, h"),
    ("dwell = 45", "dwel = 45", "periods.list[1].dwel", "dwell", None, "dwell, from"),
    ("fleet = 3", "fleet = 2.5", "trains.fleet", "2.5", None, "a whole number"),
    ("fleet = 3", "fleet = 0", "trains.fleet", "0", None, "1 to 10000"),
]
CASES = [
    *((samples.LINE, *case) for case in LINE),
    *((samples.TRAINSET, *case) for case in TRAINSET),
    *((samples.JOURNEY, *case) for case in JOURNEY),
    *((samples.FEEDING, *case) for case in FEEDING),
    *((samples.DAY, *case) for case in DAY),
]


def complaint(path):
    """The one line that a user sees."""
    with pytest.raises(InputError) as caught:
        import_file(path)
    line = caught.value.line()
    assert line == str(caught.value)
    assert "\n" not in line
    assert line.startswith(str(path))
    return line


@pytest.mark.parametrize(
    ("text", "old", "new", "field", "value", "unit", "allowed"),
    CASES,
    ids=[f"{case[3]}-{k}" for k, case in enumerate(CASES)],
)
def test_toml(tmp_path, text, old, new, field, value, unit, allowed):
    assert old in text
    path = tmp_path / "broken.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    line = complaint(path)
    assert f"{field}: " in line
    assert f"(allowed: {allowed}" in line or allowed in line.partition("(allowed: ")[2]
    if value is not None:
        assert value in line.partition(f"{field}: ")[2].partition("(allowed: ")[0]
    if unit is not None:
        assert f" {unit} (allowed: " in line


def put(document, path, value):
    *parents, last = path
    for key in parents:
        document = document[key]
    if value is KeyError:
        del document[last]
    else:
        document[last] = value


@pytest.mark.parametrize(
    ("document", "path", "value", "words"),
    [
        (samples.track, ["stops", "unit"], "mile", ["stops.unit", "'mile'", "length in m, km"]),
        (samples.track, ["stops", "unit"], KeyError, ["stops.unit: missing unit"]),
        (samples.track, ["stops", "values"], [0, 3, 2], ["stops.values[2]", "2 km", "> 3 km"]),
        (samples.track, ["stops", "values"], [0], ["stations", "at least 2"]),
        (samples.track, ["stops", "values", 1], -4, ["stops.values[1]", "-4 km", ">= 0 km"]),
        (samples.track, ["stops", "values", 1], "x", ["stops.values[1]: must be a number", "km"]),
        (samples.track, ["stops"], KeyError, ["stops: missing"]),
        (samples.track, ["stops"], [0, 1], ["stops: must be a table"]),
        (samples.track, ["speed limits"], KeyError, ["speed limits: missing"]),
        (
            samples.track,
            ["speed limits", "units", "velocity"],
            "mph",
            ["speed limits.units.velocity", "km/h"],
        ),
        (
            samples.track,
            ["speed limits", "values", 1],
            [0.5],
            ["speed limits.values[1]", "position, velocity"],
        ),
        (samples.track, ["speed limits", "values", 1, 0], 0, ["speed limits.values[1].position", "> 0 km"]),
        (samples.track, ["speed limits", "values", 0, 0], 0.2, ["stops.values[0]", ">= 200 m"]),
        (samples.track, ["gradients", "units", "slope"], "deg", ["gradients.units.slope", "permil"]),
        (
            samples.track,
            ["curvatures", "values", 1, 2],
            "round",
            ["curvatures.values[1].radius at end", "km"],
        ),
        (samples.track, ["curvatures", "values", 1, 2], "nan", ["curvatures.values[1].radius at end", "km"]),
        (
            samples.track,
            ["curvatures", "values", 2, 1],
            3,
            ["curvatures.values[2].radius at start", "10 m or more"],
        ),
        (samples.track, ["tunnels", "values", 0, 2], 0, ["tunnels.values[0].cross section", "> 0 m^2"]),
        (samples.track, ["metadata", "id"], 7, ["metadata.id: must be text"]),
        (samples.train, ["mass"], KeyError, ["mass: missing"]),
        (samples.train, ["mass", "value"], -1, ["mass.value", "-1 t", "> 0 t"]),
        (samples.train, ["mass", "value"], KeyError, ["mass.value: missing"]),
        (samples.train, ["mass", "unit"], KeyError, ["mass.unit: missing unit"]),
        (samples.train, ["mass"], 160, ["mass: must be a table"]),
        (samples.train, ["rho", "value"], 800, ["rho.value", "800 %", "0 to 100 %"]),
        (samples.train, ["max speed", "unit"], "knots", ["max speed.unit", "m/s, km/h"]),
        (samples.train, ["efficiency traction", "value"], 0, ["efficiency traction.value", "> 0 %"]),
        (samples.train, ["num coaches", "value"], 2.5, ["num coaches.value: must be whole", "2.5"]),
        (samples.train, ["rolling resistance r2", "unit"], "N", ["rolling resistance r2.unit", "N/(m/s)^2"]),
        (
            samples.train,
            ["tunnel resistance", "values", 1, 0],
            24,
            ["tunnel resistance.values[1].cross", "> 24"],
        ),
        (
            samples.train,
            ["ETCS braking data", "A_brake_emergency", "values"],
            [],
            ["ETCS braking data.A_brake_emergency.values: needs at least one row"],
        ),
        (
            samples.train,
            ["ETCS braking data", "T_be", "value"],
            None,
            ["ETCS braking data.T_be.value: missing"],
        ),
        (samples.journey, ["timing points", "values"], [[0, 0, 0, 0, 0]], ["timing_points", "at least 2"]),
        (samples.journey, ["timing points", "values", 1, 0], None, ["timing points.values[1].position"]),
        (
            samples.journey,
            ["timing points", "values", 2, 1],
            -1,
            ["timing points.values[2].lower time", ">= 0 s"],
        ),
        (
            samples.journey,
            ["timing points", "units", "position"],
            "ft",
            ["timing points.units.position", "m, km"],
        ),
        (samples.journey, ["timing points", "values", 2, 0], 1, ["timing_points[2].position", ">= 1250 m"]),
    ],
)
def test_json(tmp_path, document, path, value, words):
    data = document()
    put(data, path, value)
    file = tmp_path / "broken.json"
    file.write_text(json.dumps(data))
    line = complaint(file)
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.toml", b"kind = ", "not valid TOML"),
        ("a.toml", b"\xff\xfe", "not UTF-8"),
        ("a.toml", b"\xef\xbb\xbfx = 1", "missing"),
        ("a.json", b'{"stops": NaN}', "not valid JSON"),
        ("a.json", b'{"stops": Infinity}', "not valid JSON"),
        ("a.json", b"[1, 2]", "not a JSON object"),
        ("a.json", b"{}", "neither a track, a train nor a journey"),
        ("a.json", b"[" * 100_000, "not valid JSON"),
        ("a.toml", b"x = " + b"[" * 100_000, "not valid TOML"),
        ("a.json", b'{"metadata": {"id": "\\ud800"}, "stops": {}, "speed limits": {}}', "proper Unicode"),
        ("a.csv", b"1,2", "a file ending in .toml or .json"),
        ("missing.toml", None, "cannot be read"),
    ],
)
def test_what_is_no_document_at_all(tmp_path, name, content, words):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    assert words in complaint(path)


def test_tunnels_may_touch_and_the_first_row_holds_before_it(tmp_path):
    path = tmp_path / "line.toml"
    path.write_text(samples.LINE.replace("[[200, 300, 24]]", "[[200, 300, 24], [500, 10, 40]]"))
    line = load_line(path)
    assert [tunnel.from_m for tunnel in line.tunnels] == [200.0, 500.0]
    assert line.limit_mps.at(-150.0) == line.limit_mps.at(0.0) == pytest.approx(50 / 3.6)


def test_a_folder_is_no_file(tmp_path):
    (tmp_path / "folder.toml").mkdir()
    assert "cannot be read" in complaint(tmp_path / "folder.toml")


def test_a_file_of_another_kind_is_said_to_be_one(tmp_path):
    path = tmp_path / "train.json"
    path.write_text(json.dumps(samples.train()))
    with pytest.raises(InputError, match="describes a trainset, not a line"):
        load_line(path)


def test_a_trainset_whose_mass_has_the_wrong_unit_is_not_driven(tmp_path):
    """Its look-ahead filled the memory of the machine."""
    path = tmp_path / "kg.toml"
    write_trainset(load_trainset("dkz32"), path)
    text = path.read_text(encoding="utf-8")
    assert 'loads = "t"' in text
    path.write_text(text.replace('loads = "t"', 'loads = "kg"', 1), encoding="utf-8")
    with pytest.raises(InputError, match=r"mass.loads.AW0: lighter than its traction allows.*>= 20300 kg"):
        load_trainset(path)

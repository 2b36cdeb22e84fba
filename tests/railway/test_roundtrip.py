"""Written files read back equal; a broken one gives nothing but an InputError."""

import json
import math
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.railway import samples

from metropilot.errors import InputError
from metropilot.railway import (
    Actuation,
    Couplers,
    Curve,
    Davis,
    Efficiency,
    EffortCurve,
    EffortPiece,
    Journey,
    Line,
    SafeBraking,
    Station,
    Steps,
    TimingPoint,
    Trainset,
    Tunnel,
    export_ttobench,
    import_file,
    list_lines,
    list_trainsets,
    load_journey,
    load_line,
    load_trainset,
    write_journey,
    write_line,
    write_trainset,
)

# beartype draws at random which items of a collection it checks, also while Hypothesis builds an example.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")

WRITERS = {Line: write_line, Trainset: write_trainset, Journey: write_journey}
words = st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
names = words.filter(lambda text: text.strip())
sources = st.dictionaries(names, names, max_size=3)
scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | words
ids = st.from_regex(r"\w[\w.@,+-]{0,11}", fullmatch=True)
extras = st.dictionaries(words, st.lists(scalars, max_size=3) | scalars, max_size=3)
codes = st.text("ABCDEFGHIJKLMNOPQRSTUVWXYZ", min_size=1, max_size=4)


def positive(high=1e6):
    return st.floats(0.001, high)


@st.composite
def positions(draw, count, first=0.0):
    gaps = draw(st.lists(st.floats(0.5, 5000.0), min_size=count, max_size=count))
    return [first, *(float(v) for v in first + np.cumsum(gaps))][:count] or [first]


@st.composite
def profiles(draw, values):
    count = draw(st.integers(1, 6))
    return Steps(
        np.array(draw(positions(count, -10.0))),
        np.array(draw(st.lists(values, min_size=count, max_size=count))),
    )


@st.composite
def lines(draw):
    count = draw(st.integers(2, 5))
    stops = draw(st.lists(codes, min_size=count, max_size=count, unique=True))
    bends = st.floats(-0.05, 0.05)
    times = st.lists(positive(9999.0), min_size=count - 1, max_size=count - 1).map(tuple)
    curve_count = draw(st.integers(0, 3))
    return Line(
        id=draw(ids),
        name=draw(names),
        stations=tuple(
            Station(code, draw(names), at, draw(st.just("") | names), draw(st.just("") | names))
            for code, at in zip(stops, draw(positions(count)), strict=True)
        ),
        limit_mps=draw(profiles(st.floats(0.1, 120.0) | st.sampled_from([50 / 3.6, 80 / 3.6]))),
        gradient_permil=draw(profiles(st.floats(-40.0, 40.0))),
        curves=tuple(
            Curve(at, draw(bends), draw(bends)) for at in draw(positions(curve_count))[:curve_count]
        ),
        tunnels=draw(st.sampled_from([(), (Tunnel(5.0, 100.0, 24.5),)])),
        altitude_m=draw(st.floats(-400.0, 5000.0)),
        planned_forward_s=draw(st.just(()) | times),
        planned_backward_s=draw(st.just(()) | times),
        dwell_s=draw(st.just(()) | st.just((30.0,) * (count - 2))),
        source=draw(sources),
        notes=tuple(draw(st.lists(words, max_size=2))),
        extra=draw(extras),
        unused=tuple(draw(st.lists(words, max_size=2))),
    )


@st.composite
def curves_of_effort(draw):
    starts = [0.0, *sorted(draw(st.sets(st.floats(0.1, 40.0), max_size=3)))]
    terms = st.floats(-1e5, 1e5)
    return EffortCurve(
        tuple(
            EffortPiece(
                start,
                (draw(terms), draw(terms), draw(terms), draw(terms)),
                draw(st.floats(0.0, 5e6)),
                draw(st.just(math.inf) | positive()),
            )
            for start in starts
        )
    )


@st.composite
def efficiencies(draw):
    if draw(st.booleans()):
        return Efficiency.constant(draw(st.floats(0.01, 1.0)))
    value = draw(st.lists(st.floats(0.01, 1.0), min_size=4, max_size=4))
    return Efficiency(
        np.array([0.0, draw(positive(40.0))]), np.array([0.25, 1.0]), np.array(value).reshape(2, 2)
    )


@st.composite
def trainsets(draw):
    loads = draw(
        st.dictionaries(words, positive(1e6), min_size=1, max_size=3).filter(lambda d: any(map(str.strip, d)))
    )
    bound = st.just(math.inf) | st.floats(0.1, 3.0)
    not_negative = st.floats(0.0, 1e5)
    return Trainset(
        id=draw(ids),
        name=draw(names),
        loads=loads,
        load=next(name for name in loads if name.strip()),
        davis=Davis(draw(not_negative), draw(not_negative), draw(not_negative), draw(st.booleans())),
        traction=draw(curves_of_effort()),
        electric_brake=draw(curves_of_effort()),
        length_m=draw(not_negative),
        rotating_fraction=draw(st.floats(0.0, 1.0)),
        curve_formula=draw(st.sampled_from(["none", "600/r", "6.3/(r-55)"])),
        tunnel_n_per_mps2=draw(st.sampled_from([(), ((24.0, 12.5), (40.0, 6.1))])),
        friction_brake_n=draw(not_negative),
        service_deceleration_mps2=draw(bound),
        max_acceleration_mps2=draw(bound),
        max_deceleration_mps2=draw(bound),
        max_speed_mps=draw(st.floats(1.0, 140.0)),
        efficiency_traction=draw(efficiencies()),
        efficiency_braking=draw(efficiencies()),
        receptivity=draw(st.floats(0.0, 1.0)),
        auxiliary_w=draw(not_negative),
        actuation=Actuation(draw(st.floats(0, 2)), draw(st.floats(0, 2)), draw(bound)),
        adhesion=draw(bound),
        safe_braking=SafeBraking(draw(st.floats(0.1, 3.0)), draw(positive(3.0)), 0.5, 0.25, draw(bound)),
        couplers=Couplers(draw(st.integers(1, 12)), draw(positive(1e9)), draw(not_negative)),
        notches=draw(
            st.dictionaries(words, st.sets(st.integers(-(10**6), 10**6), min_size=1, max_size=3).map(_levels))
        ),
        gravity_mps2=draw(st.floats(9.7, 9.9)),
        source=draw(sources),
        notes=tuple(draw(st.lists(words, max_size=2))),
        extra=draw(extras),
    )


def _levels(forces):
    return tuple(float(force) for force in sorted(forces))


@st.composite
def journeys(draw):
    count = draw(st.integers(2, 5))
    speeds = st.none() | st.floats(10.0, 40.0)
    points = [
        TimingPoint(
            at,
            draw(st.none() | st.just(60.0 * k)),
            draw(st.none() | st.just(60.0 * k + 5)),
            3.0,
            draw(speeds),
        )
        for k, at in enumerate(draw(positions(count)))
    ]
    if draw(st.booleans()):
        points = [
            TimingPoint(-p.position_m, *(p.earliest_s, p.latest_s, None, p.fastest_mps)) for p in points
        ]
    return Journey(
        draw(ids), draw(st.just("") | names), tuple(points), source=draw(sources), extra=draw(extras)
    )


def through_toml(thing):
    with tempfile.TemporaryDirectory() as folder:
        path = WRITERS[type(thing)](thing, Path(folder) / "file.toml")
        return import_file(path)


@settings(max_examples=60)
@given(thing=lines() | trainsets() | journeys())
def test_toml_reads_back_what_it_wrote(thing):
    assert through_toml(thing) == thing


@pytest.mark.parametrize(
    "thing",
    [
        *(load_line(key) for key in list_lines()),
        *(load_trainset(key) for key in list_trainsets()),
        load_journey("yizhuang-forward"),
        load_journey("yizhuang-backward"),
    ],
    ids=lambda thing: thing.id,
)
def test_the_catalogue_reads_back(thing):
    assert through_toml(thing) == thing


@pytest.mark.parametrize(
    "text", [samples.LINE, samples.TRAINSET, samples.JOURNEY], ids=["line", "trainset", "journey"]
)
def test_other_units_read_back(tmp_path, text):
    path = tmp_path / "sample.toml"
    path.write_text(text, encoding="utf-8")
    thing = import_file(path)
    assert through_toml(thing) == thing


@settings(max_examples=40)
@given(line=lines())
def test_ttobench_keeps_the_track(line):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "line.json"
        export_ttobench(line, path)
        back = load_line(path)
    assert (back.limit_mps, back.gradient_permil, back.tunnels) == (
        line.limit_mps,
        line.gradient_permil,
        line.tunnels,
    )
    assert [s.position_m for s in back.stations] == [s.position_m for s in line.stations]
    for ours, theirs in zip(line.curves, back.curves, strict=True):
        assert theirs.curvature_start_per_m == pytest.approx(
            ours.curvature_start_per_m, rel=1e-15, abs=1e-300
        )


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write the file"):
        write_line(load_line("yizhuang"), tmp_path / "file" / "line.toml")
    with pytest.raises(InputError, match=r"ending in \.toml"):
        write_line(load_line("yizhuang"), tmp_path / "line.txt")


anything = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.sampled_from(["m", "km/h", "infinity", "-", "%", 10**400, 1e300]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=4,
)


def spots(value, path=()):
    """Every place inside a document."""
    yield path
    children = (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    )
    for key, child in children:
        yield from spots(child, (*path, key))


@pytest.mark.parametrize("document", [samples.track, samples.train, samples.journey])
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_mutated_json_gives_an_object_or_one_line(document, data, tmp_path):
    mutated = document()
    for _ in range(data.draw(st.integers(1, 2))):
        path = data.draw(st.sampled_from([p for p in spots(mutated) if p]))
        parent = mutated
        for key in path[:-1]:
            parent = parent[key]
        if data.draw(st.booleans()):
            del parent[path[-1]]
        else:
            parent[path[-1]] = data.draw(anything)
    file = tmp_path / "mutated.json"
    file.write_text(json.dumps(mutated), encoding="utf-8")
    read_or_complain(file)


@pytest.mark.parametrize(
    "text", [samples.LINE, samples.TRAINSET, samples.JOURNEY], ids=["line", "trainset", "journey"]
)
@settings(max_examples=250, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_mutated_toml_gives_an_object_or_one_line(text, data, tmp_path):
    start = data.draw(st.integers(0, len(text) - 1))
    length = data.draw(st.integers(0, 12))
    pool = [
        "nan",
        "inf",
        "-1",
        "1e999",
        "[]",
        "{}",
        '""',
        "true",
        "0",
        "[[",
        "\n",
        '"km"',
        "1979-05-27",
        "x = 1\n",
    ]
    inserted = data.draw(st.sampled_from(pool) | st.text(max_size=4))
    file = tmp_path / "mutated.toml"
    file.write_text(
        text[:start] + inserted + text[start + length :], encoding="utf-8", errors="replace", newline=""
    )
    read_or_complain(file)


def read_or_complain(file):
    """Only InputError, of one line, may come out; what can be read must come back from a file of our own."""
    try:
        thing = import_file(file)
    except InputError as error:
        line = error.line()
    else:
        line = str(file)
        assert through_toml(thing) == thing
    assert line.startswith(str(file))
    assert "\n" not in line

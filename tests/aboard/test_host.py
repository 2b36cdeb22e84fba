"""A driver that is plain Python drives in C as it does there, to the last bit."""

import ctypes
import json
import shutil
import sys
import types
from dataclasses import replace

import numpy as np
import pytest
from tests.aboard.test_emit import compile_c, header
from tests.commands import answer as run_command

from metropilot.aboard import (
    branching,
    compile_driver,
    drive_compiled,
    exportable,
    trace_driver,
    write_driver,
)
from metropilot.aboard.branching import BranchTracer
from metropilot.aboard.emit import emit_body
from metropilot.aboard.graph import Graph, drop_unused
from metropilot.aboard.tables import Tables
from metropilot.drivers import DRIVERS, LearnedDriver
from metropilot.errors import InputError
from metropilot.physics import double_precision, repeat
from metropilot.policy import load_driving_policy, shipped_policy
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Observation, Rollout, Run

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
NEAR_M = 1e-9


@pytest.fixture(scope="module", params=["pid", "eitoe", "eitop"])
def executable(request, tmp_path_factory):
    section = load_line("yizhuang").section("RJ", "WYJ")
    driver = DRIVERS.get(request.param)()
    program = trace_driver(request.param, driver, [section], load_trainset("dkz32", "AW2"))
    folder = tmp_path_factory.mktemp(request.param)
    write_driver(program, folder)
    return compile_driver(program, folder, options=("-O0",))


def test_a_drive_is_that_of_python(executable):
    program = executable.program
    (section,) = program.sections
    run = drive_compiled(executable, 0, section.planned_time_s)
    rollout = Rollout(Run(section, program.trainset, section.planned_time_s), program.driver)
    for state in run.states:
        rollout.advance()
        assert abs(state.plant.position_m - rollout.state.plant.position_m) < NEAR_M
    assert rollout.outcome is not None
    assert rollout.state.outcome == run.states[-1].outcome
    assert not any(answer.level for answer in run.supervised)


def test_news_of_the_timetable_are_followed_as_in_python(executable):
    """Half way the run gets longer; ``pid`` keeps to the reference that it was written with."""
    program = executable.program
    (section,) = program.sections
    executable.init(0)
    rollout = Rollout(Run(section, program.trainset, section.planned_time_s), program.driver)
    kept = program.driver.init(Run(section, program.trainset, section.planned_time_s))
    for _ in range(300):
        plant = rollout.state.plant
        later = section.planned_time_s + (15.0 if plant.time_s > 40.0 else 0.0)
        values = plant.time_s, plant.position_m, rollout.state.measured_mps, plant.acceleration_mps2, later
        measured = [float(each) for each in values]
        share, kept = program.driver.act(kept, Observation(*measured, np.nan, section))
        answer = executable.step(*measured)
        assert answer.level == 0
        assert answer.share == pytest.approx(share, abs=1e-12)
        rollout.advance()


def test_a_lost_measurement_is_no_memory(executable):
    executable.init(0)
    for k in range(30):
        executable.step(0.2 * k, 0.02 * k * k, 0.2 * k, 1.0, 105.0)
    memory = bytes(executable.state.policy)
    for lost in range(5):
        values = [6.0, 18.0, 6.0, 1.0, 105.0]
        values[lost] = np.nan
        answer = executable.step(*values)
        assert bytes(executable.state.policy) == memory
        assert answer.emergency or answer.share == -1.0


def test_numbers_out_of_range_break_nothing(executable):
    rng = np.random.default_rng(5)
    extreme = [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e12, -1e-300, 0.0, 50.0, 1e6]
    executable.init(0)
    for _ in range(500):
        answer = executable.step(*rng.choice(extreme, 5))
        assert -1.0 <= answer.share <= 1.0
        assert 0 <= answer.level <= 3


# ------------------------------------------------------------------------------------------------ branches
SOURCE = """
import math
import numpy as np
from metropilot.physics import repeat

KNOTS = [0.0, 1.0, 4.0, 9.0, 16.0]


def interpolate(values, x):
    if x <= 0.0:
        return values[0]
    if x >= len(values) - 1:
        return values[-1]
    k = int(x)
    return values[k] + (values[k + 1] - values[k]) * (x - k)


def early(x, y):
    for bound in (-1.0, 0.5, 2.0):
        if x < bound and y > 0.0:
            return bound
    return x if y > x else -y


def least(x, y):
    return min(x, y, 0.25) + max(x, -y) + math.sqrt(abs(x)) + float(int(y)) + math.ceil(x)


def arrays(x, y):
    values = np.array([1.0, -2.0, 3.0]) * x
    values[1] += y
    values[2:] = 0.5
    best = int(values.argmin())
    worse = np.where(values > y, values, y)
    return worse[best] + values.sum() + (1.0 if (values > 0.0).all() else 0.0)


def chained(x, y):
    both = 0.0 < x < 2.0 and not y < 0.0 or x == y
    return round(x) + round(2.5 * y) if both else x // 1.0 + x % 1.0


def weigh(weights, x, pair, row):
    if x > pair[0]:
        return weights[0] * x + row.sum(), (pair[1], x), row * x
    return weights[1] - row[1], (x, 2.0), row + pair[1]


TABLE = np.arange(15.0).reshape(3, 5) ** 2


def looked_up(x, y):
    table, k = TABLE, min(max(int(x), 0), 2)
    row, ends = table[k, 1:-1], table[k, -1] - y * table[k, -4]
    return ends + table[-1, k] + row[-1] + row.sum()


def calls(x, y):
    row = np.array([1.0, -2.0, 3.0]) * y
    first, pair, after = weigh((2.0, 3.0), x, (y, 1.0), row)
    second, other, last = weigh((2.0, 3.0), first, pair, after)
    third = weigh((2.0, 3.0), -1.0, other, last)[0] if second > 0.0 else 0.5
    fourth = weigh((5.0, 4.0), x, other, 0.5 * row)[0]
    return first + second * third - fourth + last.max()
"""
POINTS = [
    (x, y) for x in (-1.5, -0.5, 0.0, 0.3, 0.5, 1.0, 1.7, 2.5, 7.0) for y in (-2.0, 0.0, 0.2, 0.6, 1.0, 3.4)
]


@pytest.fixture(scope="module")
def branches():
    module = types.ModuleType("branches_of_a_test")
    exec(SOURCE, module.__dict__)
    return module


@pytest.mark.parametrize("name", ["interpolate", "early", "least", "arrays", "chained", "looked_up", "calls"])
def test_every_way_through_a_function_is_in_the_graph(tmp_path, monkeypatch, branches, name):
    monkeypatch.setattr(branching, "SHARED", {"weigh": (0,)})
    function = getattr(branches, name)

    def call(x, y):
        return function(branches.KNOTS, x) if name == "interpolate" else function(x, y)

    constants = branches.KNOTS, branches.TABLE
    with double_precision():
        tracer = BranchTracer(np.float64)
        x, y = (tracer.input((), np.dtype(np.float64), k) for k in range(2))
        branches.KNOTS, branches.TABLE = map(tracer.constant, constants)
        with tracer.apply_to([branches, sys.modules[repeat.__module__]]):
            found = tracer.run(lambda: call(x, y), name)
        branches.KNOTS, branches.TABLE = constants
        graph = Graph([x.node, y.node], [found.node], drop_unused(tracer.nodes, [found.node]))
        tables = Tables()
        body = "\n".join(emit_body(graph, ["x", "y"], ["out"], tables))
    head = "double call(double x, double y)"
    text = f"{head};\n{head}\n{{\n    double out; (void)x; (void)y;\n{body}\n    return out;\n}}\n"
    library = compile_c(tmp_path, header(text, tables) + text)
    compute = library.call
    compute.restype, compute.argtypes = ctypes.c_double, [ctypes.c_double] * 2
    for x_, y_ in POINTS:
        assert compute(x_, y_) == float(call(x_, y_)), (x_, y_)
    if name == "calls":
        # once for each of its constants
        written = "\n".join(tables.lines)
        assert written.count("static void f") == 2
        assert body.count("f0(") == 3
        assert body.count("f1(") == 1
    # and the module is as it was
    assert "min" not in vars(branches)


def test_what_cannot_be_joined_is_refused(branches):
    with double_precision():
        tracer = BranchTracer(np.float64)
        x = tracer.input((), np.dtype(np.float64), 0)
        with tracer.apply_to([branches]), pytest.raises(InputError, match="one thing or another"):
            tracer.run(lambda: None if x > 0.0 else 1.0, "either")
        with pytest.raises(InputError, match="looks up arrays"):
            _ = tracer.constant(branches.TABLE)[None, tracer.input((), np.dtype(np.int32), 1)]
        with tracer.apply_to([branches]), pytest.raises(InputError, match="too many branches"):
            tracer.run(lambda: sum(k if x > k else 0.0 for k in range(40)), "many")


# -------------------------------------------------------------------------------------------------- command
def test_the_command_writes_a_driver_of_the_host(tmp_path):
    out = tmp_path / "eitoe"
    arguments = (
        "export",
        "eitoe",
        "--to",
        "c",
        "--line",
        "yizhuang",
        "--sections",
        "RJ-WYJ",
        "--out",
        str(out),
    )
    code, said, error = run_command([*arguments, "--json"])
    assert error == ""
    assert code == 0
    report = json.loads(said)
    assert report["sections"] == ["RJ-WYJ"]
    assert report["policy"] is None
    assert (out / "eitoe.c").is_file()


def test_a_driver_that_plans_on_the_way_is_refused(tmp_path):
    arguments = ("export", "mpc", "--to", "c", "--line", "yizhuang", "--out", str(tmp_path / "x"))
    code, _, said = run_command(list(arguments))
    assert code == 2
    assert "plans or searches as it drives" in said
    assert "pid" in said
    assert {"pid", "eitoe", "eitop", "generalist", "ppo"} <= set(exportable())
    assert not {"mpc", "optimal", "itor", "ddpg_pid", "fuzzy_pid"} & set(exportable())


LATE = "dkz32@0.5,0.35"


def late_run():
    """A run with a dead time of two and a half periods, and a lag."""
    section = load_line("yizhuang").section("RJ", "WYJ")
    return Run(section, load_trainset(LATE, "AW2"), section.planned_time_s)


def test_a_learned_driver_keeps_its_tables_aboard_a_late_trainset():
    """On the nominal plant it needs no others: the commands are those of the driver that may build them."""
    loaded, run = load_driving_policy(shipped_policy("ppo")), late_run()
    driver = LearnedDriver(loaded.policy.policy, loaded.interface)
    aboard = driver.aboard(np.float64)
    assert driver.estimates_plant(run)
    assert not driver.estimates_plant(replace(run, trainset=load_trainset("dkz32")))
    rollout, kept = Rollout(run, driver), aboard.init(run)
    for _ in range(120):
        plant = rollout.state.plant
        measured = plant.time_s, plant.position_m, rollout.state.measured_mps, plant.acceleration_mps2
        given = Observation(*map(float, measured), run.scheduled_time_s, np.nan, run.section)
        share, kept = aboard.act(kept, given)
        assert share == rollout.advance().command
    # the host builds others where the plant is another one, and a controller cannot
    other = kept.monitor.estimate.bank._replace(parameters=0.8 * kept.monitor.estimate.bank.parameters)
    monitor = kept.monitor._replace(estimate=kept.monitor.estimate._replace(bank=other))
    assert aboard.act(kept._replace(monitor=monitor), given)[1].rows is kept.rows


@pytest.mark.parametrize("name", ["ppo", "generalist"])
def test_a_learned_driver_aboard_a_late_trainset_drives_as_in_python(tmp_path, name):
    """Its estimate, the prediction, the careful stop and the command that protection admits."""
    run = late_run()
    loaded = load_driving_policy(shipped_policy(name))
    program = trace_driver(name, loaded, [run.section], run.trainset)
    write_driver(program, tmp_path)
    driver = compile_driver(program, tmp_path, options=("-O0",))
    driven = drive_compiled(driver, 0, run.scheduled_time_s)
    rollout = Rollout(run, program.driver)
    for state in driven.states:
        rollout.advance()
        assert abs(state.plant.position_m - rollout.state.plant.position_m) < NEAR_M
    assert rollout.state.outcome == driven.states[-1].outcome
    assert not any(answer.level for answer in driven.supervised)


def test_commands_on_their_way_are_reckoned_with_as_in_python(tmp_path):
    """Dead time and lag: prediction, the command that protection admits, and its memory."""
    trainset = load_trainset("dkz32@0.4,0.2", "AW2")
    section = load_line("yizhuang").section("RJ", "WYJ")
    program = trace_driver("eitoe", DRIVERS.get("eitoe")(), [section], trainset)
    assert np.size(program.memory.supervision.recent) > 1
    write_driver(program, tmp_path)
    driver = compile_driver(program, tmp_path, options=("-O0",))
    run = drive_compiled(driver, 0, section.planned_time_s)
    rollout = Rollout(Run(section, trainset, section.planned_time_s), program.driver)
    for state in run.states:
        rollout.advance()
        assert abs(state.plant.position_m - rollout.state.plant.position_m) < NEAR_M
    assert rollout.state.outcome == run.states[-1].outcome

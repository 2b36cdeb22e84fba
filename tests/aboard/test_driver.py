"""A driver in C, its protection included, drives as it does in Python, hostile commands and all."""

import ctypes
import json
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from metropilot.aboard import compile_driver, drive_compiled, trace_driver, write_driver
from metropilot.aboard.source import driver_texts
from metropilot.drivers import LearnedDriver
from metropilot.physics import Command
from metropilot.policy import Policy, in_precision, load_driving_policy, shipped_policy
from metropilot.protection import at_start, protect, supervise
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Rollout, Run

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
NEAR_M = 1e-9


@pytest.fixture(scope="module")
def ppo():
    return load_driving_policy(shipped_policy("ppo"))


@pytest.fixture(scope="module")
def sources(ppo, tmp_path_factory):
    line, folder = load_line("yizhuang"), tmp_path_factory.mktemp("aboard")
    sections = [line.section("RJ", "WYJ"), line.section("XC", "XHM")]
    program = trace_driver("ppo", ppo, sections, load_trainset("dkz32", "AW2"))
    return program, folder, write_driver(program, folder)


@pytest.fixture(scope="module")
def driver(sources):
    program, folder, _ = sources
    return compile_driver(program, folder, options=("-O1",))


def test_a_drive_is_that_of_python(driver, ppo):
    """Position by position; both networks in double precision, as sums in single depend on their order."""
    policy = ppo.policy.policy
    exact = Policy(policy.spec, in_precision(policy.params, np.float64))
    for number, section in enumerate(driver.program.sections):
        scheduled_s = section.planned_time_s
        run = drive_compiled(driver, number, scheduled_s)
        rollout = Rollout(
            Run(section, driver.program.trainset, scheduled_s), LearnedDriver(exact, ppo.interface)
        )
        for state in run.states:
            rollout.advance()
            assert abs(state.plant.position_m - rollout.state.plant.position_m) < NEAR_M
        assert rollout.outcome is not None
        assert rollout.state.outcome == run.states[-1].outcome
        assert not any(answer.level for answer in run.supervised)


COMMANDS = (1.0, 0.3, -1.0, np.nan, np.inf, -np.inf, 7.0, -1.5, 1e-300)


def test_protection_gives_the_same_verdict_on_every_command(driver):
    """Random places and speeds, hostile commands, lost measurements, the memory carried along."""
    program = driver.program
    rng = np.random.default_rng(20)
    levels = set()
    for number, section in enumerate(program.sections):
        guard = protect(section, program.trainset, program.bounds)
        driver.init(number)
        memory = at_start(guard)
        for _ in range(1500):
            position = rng.uniform(-80.0, section.length_m + 600.0)
            speed = rng.choice(
                [0.0, rng.uniform(0.0, 26.0), float(np.interp(position, *permitted_of(guard)))]
            )
            if rng.random() < 0.03:
                position, speed = rng.choice([np.nan, np.inf, -np.inf, 3.0, -3.0, -300.0], 2)
            share, asked = rng.choice([*COMMANDS, rng.uniform(-1.0, 1.0)]), bool(rng.random() < 0.02)
            with np.errstate(all="ignore"):
                command, memory, verdict = supervise(
                    guard, memory, float(position), float(speed), Command(float(share), asked)
                )
            found = driver.supervise(float(position), float(speed), float(share), emergency=asked)
            levels.add(found.level)
            assert (found.level, found.emergency, found.valid) == (
                verdict.level,
                command.emergency,
                verdict.valid,
            )
            assert found.share == command.share
            assert found.permitted_mps == pytest.approx(verdict.permitted_mps, abs=1e-12)
            assert driver.state.protection.interventions == memory.interventions
            assert driver.state.protection.acceleration_mps2 == memory.acceleration_mps2
    assert levels == {0, 1, 2, 3}


def permitted_of(guard):
    at = float(guard.start_m) + float(guard.spacing_m) * np.arange(guard.permitted_mps.size)
    return at, guard.permitted_mps


def test_a_lost_measurement_brings_the_emergency_brake_and_is_forgotten(driver):
    driver.init(0)
    for k in range(40):
        before = driver.step(0.2 * k, 0.02 * k * k, 0.2 * k, 1.0, 105.0)
    assert not before.emergency
    memory = bytes(driver.state.policy)
    for lost in range(4):
        values = [8.0, 33.0, 8.0, 1.0, 105.0]
        values[lost] = np.nan
        answer = driver.step(*values)
        assert bytes(driver.state.policy) == memory
        if lost in {1, 2}:
            assert answer.emergency
        else:
            assert answer.share == -1.0
    driver.init(0)
    assert driver.step(0.0, 0.0, 0.0, 0.0, 105.0).share > 0.0


def test_numbers_out_of_range_break_nothing(driver):
    """The answer is a command for any measurement; sanitizers watch the same in tools/aboard.py."""
    rng = np.random.default_rng(5)
    extreme = [np.nan, np.inf, -np.inf, 1e300, -1e300, 1e12, -1e-300, 0.0, 50.0, 1e6]
    driver.init(1)
    for _ in range(3000):
        answer = driver.step(*rng.choice(extreme, 5))
        assert -1.0 <= answer.share <= 1.0
        assert 0 <= answer.level <= 3


@pytest.mark.parametrize("period_s", [0.4, 0.5, 0.6])
def test_single_precision_decides_when_double_does(tmp_path, ppo, period_s):
    """Times in single precision are rounded by some microseconds, before a decision is due or behind it."""
    from dataclasses import replace

    often = replace(ppo, interface=replace(ppo.interface, period_s=period_s))
    line = load_line("yizhuang")
    program = trace_driver("ppo", often, [line.section("RJ", "WYJ")], load_trainset("dkz32"), number="float")
    write_driver(program, tmp_path)
    single = compile_driver(program, tmp_path, options=("-O1",))
    single.init(0)
    decided, time_s = 0, 0.0
    for k in range(1500):
        single.step(time_s, 20.0, 5.0, 0.1, 400.0)
        decided = int((k + 0.01) * 0.2 / period_s) + 1 if 0.2 * k > decided * period_s - 0.01 else decided
        assert single.state.policy.decided == decided
        time_s += 0.2


def test_there_is_no_other_section(driver):
    state = bytes(driver.state)
    for number in (-1, 2):
        with pytest.raises(Exception, match="no such section"):
            driver.init(number)
    assert bytes(driver.state) == state


class Spec(ctypes.Structure):
    _fields_ = [(name, ctypes.c_int) for name in ("brake", "power", "ats", "b67", "cars")]


class Vehicle(ctypes.Structure):
    _fields_ = [
        ("location_m", ctypes.c_double),
        ("speed_kmh", ctypes.c_float),
        ("time_ms", ctypes.c_int),
        *((name, ctypes.c_float) for name in ("bc", "mr", "er", "bp", "sap", "current")),
    ]


class Beacon(ctypes.Structure):
    _fields_ = [
        ("type", ctypes.c_int),
        ("signal", ctypes.c_int),
        ("distance_m", ctypes.c_float),
        ("optional", ctypes.c_int),
    ]


class Handles(ctypes.Structure):
    _fields_ = [(name, ctypes.c_int) for name in ("brake", "power", "reverser", "constant_speed")]


def test_the_plugin_drives_a_simulator(sources):
    """A crude vehicle of ten notches: it leaves, keeps the limit by hand at full power, and brakes."""
    program, folder, _ = sources
    done = subprocess.run(["make", "plugin"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    plugin = ctypes.CDLL(str(folder / "ats.so"))
    plugin.Elapse.restype = Handles
    panel = (ctypes.c_int * 256)()
    plugin.Load()
    assert plugin.GetPluginVersion() == 0x00020000
    plugin.SetVehicleSpec(Spec(10, 10, 1, 7, 6))
    plugin.Initialize(0)
    plugin.SetBeaconData(Beacon(300, 0, 0.0, 1))
    top_mps = max(program.sections[1].limit_mps.value)

    def drive(seconds):
        position_m, speed_mps, fastest_mps, notches = 5000.0, 0.0, 0.0, set()
        plugin.DoorClose()
        for frame in range(30 * seconds):
            state = Vehicle(position_m, 3.6 * speed_mps, 3_600_000 + frame * 1000 // 30)
            handles = plugin.Elapse(state, panel, panel)
            notches.add((handles.power, handles.brake))
            share = -1.2 if handles.brake > 10 else handles.power / 10 - handles.brake / 10
            speed_mps = max(speed_mps + 0.9 * share / 30, 0.0)
            position_m += speed_mps / 30
            fastest_mps = max(fastest_mps, speed_mps)
        plugin.DoorOpen()
        return position_m - 5000.0, fastest_mps, notches

    gone_m, _, notches = drive(40)
    assert gone_m > 150.0
    assert panel[200] == 1
    assert len(notches) > 2
    plugin.KeyDown(0)
    plugin.SetPower(10)
    gone_m, fastest_mps, notches = drive(90)
    assert panel[200] == 0
    assert 0.8 * top_mps < fastest_mps <= top_mps
    assert any(power < 10 for power, _ in notches)
    assert plugin.Elapse(Vehicle(0.0, 0.0, 0), panel, panel).power == 10


def test_the_makefile_builds_the_example_and_checks_the_vectors(sources):
    _, folder, report = sources
    assert report.sections == ("RJ-WYJ", "XC-XHM")
    done = subprocess.run(
        ["make", "check", "example"], cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert f"{report.vectors} periods, 0 wrong" in done.stdout
    drive = subprocess.run(["./example", "1"], cwd=folder, capture_output=True, text=True, check=False)
    assert drive.returncode == 0
    assert drive.stdout.startswith("XC to XHM")
    assert "0 of" in drive.stdout.splitlines()[-1]
    assert subprocess.run(["./example", "9"], cwd=folder, capture_output=True, check=False).returncode == 2
    # a changed vector must fail
    text = (folder / "vectors.csv").read_text().splitlines()
    row = text[60].split(",")
    row[6] = "0.123"
    (folder / "vectors.csv").write_text("\n".join([*text[:60], ",".join(row), *text[61:]]))
    wrong = subprocess.run(["./vectors"], cwd=folder, capture_output=True, text=True, check=False)
    assert wrong.returncode == 1
    assert " 1 wrong" in wrong.stdout


@pytest.mark.parametrize("trainset", ["dkz32", "dkz32@0.4,0.2"])
def test_generalist_has_a_form_in_c(trainset):
    policy = load_driving_policy(shipped_policy("generalist"))
    section = load_line("yizhuang").section("RJ", "WYJ")
    program = trace_driver("generalist", policy, [section], load_trainset(trainset), number="double")
    texts, _ = driver_texts(program)
    assert "generalist_step(" in texts["generalist.c"]


def test_no_name_leaves_its_comment_string_or_element(sources):
    program, _, _ = sources
    evil = 'x\nall: ; touch pwned\n*/ $(touch pwned) \\ "; </script><b>&\u2028'
    section = program.sections[0]
    station = replace(section.origin, code=evil, name=evil)
    named = replace(
        program,
        name=evil,
        trainset=replace(program.trainset, id=evil),
        sections=(replace(section, line_id=evil, origin=station), *program.sections[1:]),
    )
    (usual, _), (texts, _) = (driver_texts(each, door=True) for each in (program, named))
    assert "?/ ?(touch pwned)" in texts["Makefile"]
    for text, like in zip(texts.values(), usual.values(), strict=True):
        # json.dumps escapes the quotes of a station's name, which stands in a string of JavaScript
        told = text.replace(json.dumps(evil).replace("<", "\\u003c"), '""')
        for mark in ("\n", "/*", "$(", "</", "<b", "\u2028", "&", "\\"):
            assert told.count(mark) == like.count(mark), (mark, text)

"""Drivers from policy files: what is shipped, what is somebody else's, and what is refused."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest

from metropilot.convoy import FOLLOWERS
from metropilot.drivers import DRIVERS, shipped
from metropilot.drivers.learned import LearnedDriver
from metropilot.env import ACTIONS, PolicyInterface, task_config
from metropilot.errors import InputError
from metropilot.evaluate import (
    RunSpec,
    kpis_of,
    make_driver,
    optimum_of,
    run_from_toml,
    write_run_toml,
)
from metropilot.planning import minimum_running_time
from metropilot.policy import (
    Policy,
    PolicySpec,
    load_driving_policy,
    load_policy,
    save_policy,
    shipped_policy,
)
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Disturbance, Run, drive, register

INTERFACE = task_config("drive").interface
SIZE = 14
"""Numbers in the observation of the task ``drive``."""


def policy_of(seed=0, size=SIZE, **fields):
    spec = replace(PolicySpec("clip", size, 1, (8,), "tanh", 1), **fields)
    rng = np.random.default_rng(seed)
    params = {name: 0.3 * rng.normal(size=s).astype(np.float32) for name, s in spec.shapes().items()}
    if "policy.1.bias" in params:
        params["policy.1.bias"] += np.float32(0.6)
    return Policy(spec, params)


def file_of(folder, policy=None, interface=INTERFACE, **changes):
    path = folder / "mine.safetensors"
    told = interface.as_dict() | changes if interface else {}
    save_policy(path, policy or policy_of(), {"perception": told} if interface else {})
    return path


def run_of(section=("yizhuang", "RJ", "WYJ"), trainset="dkz32", time_s=110.0, **fields):
    line, a, b = section
    return Run(load_line(line).section(a, b), load_trainset(trainset), time_s, Disturbance(**fields))


def test_a_file_drives_as_the_policy_in_it(tmp_path):
    policy = policy_of()
    path = file_of(tmp_path, policy)
    run = run_of(ideal=True)
    direct = drive(run, LearnedDriver(policy, INTERFACE)).trajectory
    driven = drive(run, make_driver("learned", {"policy": str(path)})).trajectory
    np.testing.assert_array_equal(driven.command, direct.command)
    assert np.ptp(direct.command) > 0.5
    path.rename(tmp_path / "policy.safetensors")
    assert make_driver(f"learned:policy={tmp_path}").loaded_policy.interface == INTERFACE


@pytest.mark.parametrize("name", ["drive", "drive_notches", "drive_increment", "chen2023a"])
def test_perception_survives_json(name):
    interface = task_config(name).interface
    assert PolicyInterface.from_dict(json.loads(json.dumps(interface.as_dict()))) == interface


def test_every_action_survives_json():
    for kind in map(ACTIONS.get, ACTIONS):
        interface = replace(INTERFACE, action=kind())
        assert PolicyInterface.from_dict(json.loads(json.dumps(interface.as_dict()))) == interface


REGIME = {"kind": "regime", "coast": 0.2, "full": 0.8}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"features": ["speed", "colour"]}, "perception.features: unknown feature: 'colour'"),
        ({"features": "speed"}, "perception.features: not a list: 'speed'"),
        ({"features": [["speed"]]}, "unknown feature"),
        ({"features": []}, "no features"),
        ({"features": ["speed", "speed"]}, "twice"),
        ({"action": {"kind": "os.system"}}, "perception.action: unknown action: 'os.system'"),
        ({"action": None}, "unknown action"),
        ({"action": {"kind": ["regime"]}}, "unknown action"),
        ({"action": REGIME | {"cost": 0.1}}, "unknown field, did you mean coast"),
        ({"action": REGIME | {"coast": "0.1"}}, "perception.action.coast: of the wrong kind"),
        ({"action": REGIME | {"coast": 10**400}}, "of the wrong kind"),
        ({"action": REGIME | {"coast": 0.9}}, "full: out of range"),
        ({"action": {"kind": "increment", "rate_per_s": -1.0}}, "rate_per_s: out of range"),
        ({"action": {"kind": "gains", "low": [0.0, 0.1], "high": [1.0, 1.0]}}, "low: out of range"),
        ({"action": {"kind": "gains", "low": [0.1], "high": [1.0, 1.0]}}, "not a range of two gains"),
        ({"action": {"kind": "notches", "notches": [0.0] * 5000}}, "a list of 1 to"),
        ({"action": {"kind": "notches"}}, "not the action's"),
        ({"assists": {"stop": 1}}, "perception.assists.stop: of the wrong kind"),
        ({"assists": []}, "unknown field"),
        ({"assists": {"release": 0.0}}, "release: out of range: '?0.0'? .allowed: 0.1 to 1"),
        ({"assists": {"stop_use": -1.0}}, "stop_use: out of range"),
        ({"assists": {"stop_mps2": 99.0}}, "stop_mps2: out of range"),
        ({"assists": {"margin_mps": -5.0}}, "margin_mps: out of range"),
        ({"period_s": 0}, "perception.period_s: out of range: '0'"),
        ({"period_s": True}, "perception.period_s: out of range"),
        ({"spacing_m": 1e-9}, "perception.spacing_m: out of range"),
        ({"mean_mass_kg": None}, "perception.mean_mass_kg: out of range"),
        ({"colour": 1}, "perception: fields missing or unknown: 'colour'"),
    ],
)
def test_a_file_that_says_what_cannot_be_driven_is_refused(tmp_path, changes, words):
    path = file_of(tmp_path, **changes)
    with pytest.raises(InputError, match=words) as error:
        load_driving_policy(path)
    assert str(error.value).startswith(str(path))
    assert len(str(error.value)) < 600


def test_a_file_without_perception_is_refused(tmp_path):
    with pytest.raises(InputError, match="does not say what the policy sees"):
        load_driving_policy(file_of(tmp_path, interface=None))


def test_features_that_do_not_fit_the_network_are_refused_when_driving(tmp_path):
    path = file_of(tmp_path, policy_of(size=SIZE + 1))
    with pytest.raises(InputError, match=rf"mine.safetensors: perception.features: .*: {SIZE} "):
        drive(run_of(), make_driver("learned", {"policy": str(path)}))


@pytest.mark.parametrize("output", ["clip", "argmax"])
def test_an_answer_that_is_not_a_number_never_becomes_a_command(tmp_path, output):
    notches = task_config("drive_notches").interface
    policy = policy_of(
        output=output, activation="relu", **({} if output == "clip" else {"actions": 9, "width": 9})
    )
    for name, value in policy.params.items():
        policy.params[name] = np.full_like(value, 3e38)
    path = file_of(tmp_path, policy, INTERFACE if output == "clip" else notches)
    with pytest.raises(InputError, match="answers what is not a number"):
        drive(run_of(), make_driver("learned", {"policy": str(path)}))


def test_devices_pipes_and_large_files_are_refused(tmp_path):
    large = tmp_path / "large.safetensors"
    with large.open("wb") as file:
        file.truncate(1 << 40)
    os.mkfifo(tmp_path / "pipe")
    for path, words in ((large, "too large"), (tmp_path / "pipe", "not a file"), ("/dev/zero", "not a file")):
        with pytest.raises(InputError, match=words):
            load_driving_policy(path)
    with pytest.raises(InputError, match="No such file"):
        load_driving_policy(tmp_path / "nowhere")


def test_learned_needs_a_policy():
    with pytest.raises(InputError, match="--set policy=PATH"):
        drive(run_of(), make_driver("learned"))


def test_a_shipped_driver_takes_another_file(tmp_path):
    other = file_of(tmp_path).rename(tmp_path / "other.safetensors")
    assert make_driver("ppo", {"policy": str(other)}).loaded_policy.path == other


def test_a_registered_driver_is_listed_and_made(monkeypatch):
    monkeypatch.setattr(DRIVERS, "_rows", DRIVERS.rows())

    @register
    class Mine(shipped.AbstractShippedDriver):
        id, summary, source = "mine", "Learned somewhere", "test"

    assert (DRIVERS.row("mine").summary, DRIVERS.row("mine").source) == ("Learned somewhere", "test")
    assert isinstance(make_driver("mine"), Mine)
    with pytest.raises(InputError, match="unknown driver, did you mean mine"):
        DRIVERS.get("min")


SHIPPED = [key for key in DRIVERS.ids() if issubclass(DRIVERS.get(key), shipped.AbstractShippedDriver)]


@pytest.mark.parametrize(
    "path", sorted(shipped_policy("any").parent.glob("*.safetensors")), ids=lambda path: path.stem
)
def test_shipped_policies_belong_to_a_driver_and_say_where_they_come_from(path):
    assert path.stem in {*DRIVERS.ids(), *FOLLOWERS.ids()}
    _, about = load_policy(path)
    assert {"task", "algorithm", "seed", "config", "kpis", "provenance"} <= set(about)
    told = about["provenance"]
    assert {"command", "commit", "date", "machine"} <= set(told)
    assert "/" not in told["command"]
    assert path.stat().st_size < 1_000_000


@pytest.mark.parametrize(
    ("section", "trainset"),
    [(("yizhuang", "SJZ", "XC"), "dkz32:AW3"), (("yizhuang", "RJ", "WYJ"), "cheng2023")],
)
@pytest.mark.parametrize("driver_id", [None, *SHIPPED])
def test_what_was_not_learned_for_is_driven_too(tmp_path, section, trainset, driver_id):
    options = {"policy": str(file_of(tmp_path))} if driver_id is None else {}
    done = drive(run_of(section, trainset, 200.0), make_driver(driver_id or "learned", options))
    assert np.isfinite(done.trajectory.command).all()
    assert done.outcome.value in {"arrived", "out_of_time", "stalled"}
    limit = done.trajectory.limit_mps
    assert (done.trajectory.speed_mps <= limit + 1e-6).all()


def test_a_policy_goes_with_the_run_it_drove(tmp_path):
    path = file_of(tmp_path)
    request = RunSpec("yizhuang", "RJ", "WYJ", 110.0, driver=f"learned:policy={path}")
    out = tmp_path / "out"
    out.mkdir()
    write_run_toml(out, request)
    path.unlink()
    moved = out.rename(tmp_path / "elsewhere")
    again = run_from_toml(moved / "run.toml")
    assert again.driver == "learned"
    assert again.make_driver().loaded_policy.interface == INTERFACE


@pytest.mark.parametrize("driver", ["generalist", "ppo"])
@pytest.mark.parametrize(("origin", "destination", "load"), [("RJ", "WYJ", "AW0"), ("WYJ", "WHY", "AW3")])
def test_the_stand_jerks_no_more_than_the_trainset_may(driver, origin, destination, load):
    request = RunSpec("yizhuang", origin, destination, time_s=110.0, driver=driver, load=load)
    driven = drive(request.run(), request.make_driver())
    change = np.abs(np.diff(driven.trajectory.acceleration_mps2)).max()
    assert change / driven.run.dt <= driven.run.trainset.actuation.jerk_limit_mps3 * (1 + 1e-6)
    assert abs(driven.trajectory.position_m[-1] - driven.run.section.length_m) < 0.01


@pytest.mark.parametrize("trainset", ["cn_beijing_subway", "ch_stadler_kiss_sbb", "dkz32"])
def test_on_a_long_fall_generalist_does_not_brake_away_what_it_powered(trainset):
    """From the start it is all down: a tenth of a metre per second too much there is braked away below."""
    section, load = load_line("yizhuang").section("XHM", "JG"), load_trainset(trainset)
    time_s = round(1.35 * minimum_running_time(section, load), 1)
    driven = drive(Run(section, load, time_s), make_driver("generalist"))
    assert driven.running_time_s == pytest.approx(time_s, abs=1.0)
    kpis = kpis_of(driven, optimum_of(driven))
    assert kpis.driver_gap_percent < 10.0

"""Everything metropilot reads from a file, as functions of bytes, with real files to begin from.

Whatever the bytes, a target returns or raises a :class:`MetropilotError` of one line that can be printed.
:func:`check` is that claim.
"""

import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from tests.railway import samples

from metropilot.errors import MetropilotError

LONGEST_LINE = 4000
CAMPAIGN = """
name = "mine"
[matrix]
drivers = ["flat_out", "pid"]
sections = ["yizhuang RJ WYJ", "lu2023"]
loads = ["AW2"]
times = ["planned", 1.2]
seeds = 2
[[disturbance]]
name = "heavy"
mass_factor = [1.0, 1.2]
lag_s = 0.1
restriction = { from = 0.4, to = 0.6, kmh = 40, announced = 0.3 }
arrival = { factor = 1.1, announced = 0.2 }
"""
RUN = """
[run]
line = "yizhuang"
origin = "RJ"
destination = "WYJ"
time_s = 101.0
trainset = "dkz32"
load = "AW2"
driver = "pid"
ideal = false
mass_factor = 1.1
delay_s = 0.1
restrictions = ["400-600@40", "100-200@40@30"]
arrivals = ["116@30"]
seed = 3
[run.options]
objective = "wheel"
[made_with]
metropilot = "0.1.0"
"""
LEARNED = """
id = "r"
algorithm = "ppo"
task = "drive"
seed = 3
status = "done"
created = "2026-01-01T00:00:00+00:00"
seconds = 1.5
steps = 100
score = 0.5
commit_id = ""
driver = "ppo"
[config]
steps = 100
hidden = [8, 8]
[about]
[versions]
jax = "0.10"
[kpis]
score = 0.5
"""


@dataclass(frozen=True)
class Target:
    """One kind of file.

    Attributes:
        kind: Its format, for :func:`tests.fuzz.mutate.damaged`.
        name: What the file is called.
        seeds: Makes the real files.
        read: Reads the file and touches what it gave.
    """

    kind: str
    name: str
    seeds: Callable[[], list[bytes]]
    read: Callable[[Path], object]


def _read_railway(path: Path) -> None:
    """Read a file; one that is accepted is written and read again, a feeding or a day is checked."""
    from metropilot.railway import (
        Feeding,
        Line,
        ServiceDay,
        Trainset,
        import_file,
        write_journey,
        write_line,
        write_trainset,
    )

    found = import_file(path)
    again = path.with_name("again.toml")
    if isinstance(found, Feeding):
        assert 0 < found.ohm_per_m < np.inf
        assert all(0 < each.resistance_ohm < np.inf for each in found.substations)
        return
    if isinstance(found, ServiceDay):
        assert all(0 <= each.from_s < each.to_s and each.headway_s >= 10 for each in found.periods)
        return
    if isinstance(found, Line):
        for section in (*found.sections(), *found.sections(backward=True)):
            assert 0 < section.length_m < 1e6
            at = np.linspace(0.0, section.length_m, 5)
            assert (section.limit_mps.at(at) > 0).all()
            assert np.isfinite(section.gradient_permil.at(at)).all()
        write_line(found, again)
    elif isinstance(found, Trainset):
        assert 0 < found.mass_kg <= found.effective_mass_kg < np.inf
        for curve in (found.traction, found.electric_brake):
            force = curve.at(np.linspace(0.0, found.max_speed_mps, 5))
            assert (np.isfinite(force) & (force >= 0)).all()
        write_trainset(found, again)
    else:
        steps = {np.sign(b.position_m - a.position_m) for a, b in pairwise(found.points)}
        assert steps <= {0, 1} or steps <= {0, -1}
        write_journey(found, again)
    assert import_file(again) == found, "it reads back as something else"


def _read_policy(path: Path) -> None:
    from metropilot.policy import load_driving_policy

    loaded = load_driving_policy(path)
    size = loaded.policy.policy.spec.observation_size
    for observation in (np.zeros(size, np.float32), np.full(size, 3e4, np.float32)):
        action = loaded.policy(observation)
        assert np.isfinite(np.asarray(action)).all()


def _read_checkpoint(path: Path) -> None:
    from metropilot.learn import load_checkpoint

    wanted = {"weights": np.zeros((3, 4), np.float32), "step": np.zeros((), np.int32)}
    state, history, about = load_checkpoint(path, wanted)
    assert {k: (v.shape, v.dtype) for k, v in state.items()} == {
        k: (v.shape, v.dtype) for k, v in wanted.items()
    }
    assert all(isinstance(column, np.ndarray) for column in history.values())
    assert isinstance(about, dict)


def _read_run(path: Path) -> None:
    import tomli_w

    from metropilot.evaluate import run_from_toml

    resolved = run_from_toml(path).resolve()
    section = resolved.section()
    assert 0 < section.length_m < 1e6
    assert (section.limit_mps.value > 0).all()
    assert all(item.at_s >= 0 for item in resolved.disturbance.updates)
    text = tomli_w.dumps({"run": resolved.values()})
    path.write_text(text)
    again = tomli_w.dumps({"run": run_from_toml(path).resolve().values()})
    assert again == text, "it reads back as something else"


def _read_campaign(path: Path) -> None:
    from metropilot.campaign import campaign_from_toml

    _drivable(campaign_from_toml(path))


def _read_stored_campaign(path: Path) -> None:
    from metropilot.campaign import campaign_of_folder

    _drivable(campaign_of_folder(path.parent))


def _drivable(campaign) -> None:
    """Its shards hold its rows, and each row is a case."""
    assert campaign.rows > 0
    if campaign.rows < 10_000:
        rows = [row for piece in campaign.pieces() for row in campaign.shard(piece)]
        assert rows == list(range(campaign.rows))
        assert campaign.case(rows[-1]).driver == campaign.drivers[-1]


def _read_done(path: Path) -> None:
    from metropilot.campaign import CampaignStore

    campaign = _campaign()
    store = CampaignStore(path.parent, campaign)
    first = next(iter(campaign.pieces()))
    for file in (store.part(first), store.timing(first)):
        file.parent.mkdir(parents=True, exist_ok=True)
    store.part(first).write_bytes(b"x" * 10)
    store.timing(first).touch()
    assert set(store.finished_shards()) <= set(campaign.pieces())


def _read_trajectory(path: Path) -> None:
    from metropilot.sim import Trajectory

    found = Trajectory.read(path)
    columns = vars(found)
    assert {column.shape for column in columns.values()} == {(len(found),)}
    assert len(found) > 0
    assert all(column.dtype == np.float64 for name, column in columns.items() if name != "phase")
    found.write(path)
    again = vars(Trajectory.read(path))
    for name, column in columns.items():
        assert np.array_equal(again[name], column, equal_nan=name != "phase"), name


def _read_record(path: Path) -> None:
    from metropilot.learn import INDEX_FILE, RunStore, config_to_mapping, record_of

    record = record_of(path.parent)
    assert record.status in {"running", "interrupted", "done", "failed"}
    store = RunStore(path.parent.parent)
    (store.root / INDEX_FILE).unlink(missing_ok=True)
    assert [found.id for found in store.find("")] == [record.id], "the index of runs does not take it"
    assert config_to_mapping(record.configuration())


def _show(path: Path) -> None:
    from contextlib import redirect_stdout
    from io import StringIO

    from metropilot.cli.show import show_run

    for name, text in (("run.toml", RUN), ("kpis.json", '{"outcome": "arrived"}')):
        if name != path.name:
            (path.parent / name).write_text(text)
    for as_json in (True, False):
        with redirect_stdout(StringIO()) as said:
            show_run(path.parent, as_json=as_json)
        said.getvalue().encode()
        if as_json:
            assert isinstance(json.loads(said.getvalue()), dict)


@cache
def _campaign():
    from metropilot.campaign import Campaign

    return Campaign("small", ("flat_out",), (("yizhuang", "WHY", "YZQ"),), (("dkz32", "AW2"),), (1.2,))


def _campaigns() -> list[bytes]:
    campaign = _campaign()
    return [json.dumps({"digest": campaign.digest, "campaign": json.loads(campaign.text)}).encode()]


def _journeys() -> list[bytes]:
    return [json.dumps(made()).encode() for made in (samples.track, samples.train, samples.journey)]


def _policies() -> list[bytes]:
    from metropilot.policy import shipped_policy

    return [shipped_policy(name).read_bytes() for name in ("eitop", "stod", "ppo")]


def _checkpoints() -> list[bytes]:
    from safetensors.numpy import save

    arrays = {"state['weights']": np.ones((3, 4), np.float32), "state['step']": np.zeros((), np.int32)}
    arrays["history.steps"] = np.arange(3.0)
    return [save(arrays, {"metropilot": json.dumps({"format": 1, "about": {"seed": 1}})})]


def _trajectories() -> list[bytes]:
    from metropilot.sim import Trajectory

    names = tuple(Trajectory.__annotations__)
    rows = [[*(str(0.5 * k + column) for column in range(len(names) - 1)), "coast"] for k in range(4)]
    return ["\n".join(",".join(row) for row in [list(names), *rows]).encode()]


def _catalogue() -> list[bytes]:
    return [
        text.encode()
        for text in (samples.LINE, samples.TRAINSET, samples.JOURNEY, samples.FEEDING, samples.DAY)
    ]


def _texts(*texts: str) -> Callable[[], list[bytes]]:
    return lambda: [text.encode() for text in texts]


TARGETS = {
    "toml": Target("toml", "thing.toml", _catalogue, _read_railway),
    "ttobench": Target("json", "thing.json", _journeys, _read_railway),
    "policy": Target("safetensors", "policy.safetensors", _policies, _read_policy),
    "checkpoint": Target("safetensors", "checkpoint.safetensors", _checkpoints, _read_checkpoint),
    "run": Target("toml", "run.toml", _texts(RUN), _read_run),
    "record": Target("toml", "r/run.toml", _texts(LEARNED), _read_record),
    "campaign": Target("toml", "campaign.toml", _texts(CAMPAIGN), _read_campaign),
    "stored_campaign": Target("json", "campaign.json", _campaigns, _read_stored_campaign),
    "done": Target(
        "text",
        "done.txt",
        _texts("flat_out 0 1 10 abcdef\n", "optimal 0 1 10 ab\nppo 1 2 30 cd\n"),
        _read_done,
    ),
    "trajectory": Target("csv", "trajectory.csv", _trajectories, _read_trajectory),
    "show_kpis": Target(
        "json", "kpis.json", _texts('{"outcome": "arrived", "mass_kg": 1.5, "a": []}'), _show
    ),
    "show_run": Target("toml", "run.toml", _texts(RUN), _show),
}


@cache
def place(name: str) -> Path:
    """File of a target, in memory where the machine can; gone with the process."""
    ram = Path("/dev/shm")
    folder = tempfile.TemporaryDirectory(prefix="metropilot-fuzz-", dir=ram if ram.is_dir() else None)
    _KEPT.append(folder)
    path = Path(folder.name) / TARGETS[name].name
    path.parent.mkdir(exist_ok=True)
    return path


_KEPT: list[object] = []


def check(name: str, data: bytes) -> bool:
    """Read the bytes; whether they were accepted.

    Raises:
        AssertionError: What came out is no single line.
        Exception: What came out is none of our errors.
    """
    path = place(name)
    path.write_bytes(data)
    try:
        TARGETS[name].read(path)
    except MetropilotError as error:
        line = error.line() if hasattr(error, "line") else str(error)
        assert line.strip(), "an error that says nothing"
        assert "\n" not in line, line
        assert len(line) <= LONGEST_LINE, len(line)
        line.encode()
        return False
    return True

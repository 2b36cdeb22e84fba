"""A changed file gives one error line or something usable; inputs that once broke a loader are replayed."""

import os
from pathlib import Path
from random import Random

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.fuzz.mutate import damaged
from tests.fuzz.targets import TARGETS, check
from tests.railway import samples

from metropilot.campaign import campaign_from_toml
from metropilot.env import task_config
from metropilot.errors import InputError
from metropilot.evaluate import RunSpec, make_driver, run_from_toml
from metropilot.policy import Policy, PolicySpec, save_policy
from metropilot.railway import import_file, load_line
from metropilot.sim import drive

SIZE = 14
"""Numbers in the observation of the tasks."""
CORPUS = Path(__file__).with_name("corpus")
KEPT = sorted(path for path in CORPUS.glob("*/*") if path.is_file())
# beartype draws at random which items of a collection it checks.
pytestmark = pytest.mark.filterwarnings("ignore:Do not use the `random` module inside strategies")


@pytest.mark.parametrize("name", TARGETS)
def test_real_files_are_read(name):
    assert all(check(name, data) for data in TARGETS[name].seeds())


@pytest.mark.parametrize("name", TARGETS)
@settings(max_examples=40, suppress_health_check=list(HealthCheck))
@given(number=st.integers(0, 2**32 - 1), again=st.booleans())
def test_damaged_files_are_one_line(name, number, again):
    target, random = TARGETS[name], Random(number)
    data = damaged(random.choice(target.seeds()), target.kind, random)
    check(name, damaged(data, target.kind, random) if again else data)


@pytest.mark.parametrize("path", KEPT, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_what_once_broke_a_loader(path):
    check(path.parent.name, path.read_bytes())


def test_the_corpus_is_of_targets_that_there_are():
    assert len(KEPT) >= 10
    assert {path.parent.name for path in KEPT} <= set(TARGETS)


def test_a_section_no_grid_can_hold_is_refused(tmp_path):
    """A line file may say what it likes; a run of a million kilometres would fill the memory."""
    path = tmp_path / "far.toml"
    path.write_text(samples.LINE.replace("position = 2.5", "position = 1e6"))
    line = load_line(path)
    assert line.section("A", "B").length_m == 1500.0
    with pytest.raises(InputError, match="the section is too long: 'B-C"):
        line.section("B", "C")


@pytest.mark.parametrize("read", [import_file, run_from_toml, campaign_from_toml])
def test_pipes_and_files_without_end_are_refused(tmp_path, read):
    pipe, large = tmp_path / "pipe.toml", tmp_path / "large.toml"
    os.mkfifo(pipe)
    with large.open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match="not a file"):
        read(pipe)
    with pytest.raises(InputError, match="too large: 1099511627776 bytes"):
        read(large)


@pytest.mark.parametrize("task", ["drive", "drive_notches"])
def test_weights_that_mean_harm_stay_under_protection(tmp_path, task):
    """Weights of a stranger, far out of any learned range and all for power: protection has the last word."""
    interface = task_config(task).interface
    space, rng, scale = interface.action.space, np.random.default_rng(1), 1e3
    output, width = ("argmax", space.count) if space.discrete else ("clip", 1)
    spec = PolicySpec(output, SIZE, width if space.discrete else 1, (8,), "tanh", width)
    params = {n: (scale * rng.normal(size=s)).astype(np.float32) for n, s in spec.shapes().items()}
    params["policy.1.bias"] = np.linspace(1.0, 2.0, width).astype(np.float32) * np.float32(100 * scale)
    path = tmp_path / "theirs.safetensors"
    save_policy(path, Policy(spec, params), {"perception": interface.as_dict()})
    done = drive(RunSpec("yizhuang", "RJ", "WYJ", 110.0).run(), make_driver("learned", {"policy": str(path)}))
    seen = done.trajectory
    assert (seen.speed_mps <= seen.limit_mps + 1e-9).all()
    assert np.isfinite(seen.speed_mps).all()
    assert seen.speed_mps.max() > 15.0, "they asked for power all the way"
    assert seen.position_m[-1] < 1500.0

"""A disk that takes no more: one line, and what was there is kept. A limit on size plays the full disk."""

import errno
import json
import resource
import signal
from contextlib import contextmanager

import numpy as np
import pytest

from metropilot._io import fill_folder, write_json
from metropilot.errors import InputError
from metropilot.evaluate import RunSpec, kpis_of, write_run
from metropilot.learn import read_history, write_history
from metropilot.policy import Policy, PolicySpec, load_policy, save_policy
from metropilot.railway import load_line, write_line
from metropilot.sim import drive

ROOM = 4096
SPEC = PolicySpec("clip", 14, 1, (64, 64), "tanh", 1)


@contextmanager
def full_disk():
    """No file of this process gets larger than a page."""
    before, told = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, told)


def policy_of(value):
    return Policy(SPEC, {name: np.full(shape, value, np.float32) for name, shape in SPEC.shapes().items()})


def put_policy(path, k):
    save_policy(path, policy_of(k), {"k": k})


def put_history(path, k):
    write_history(path, {"a": np.random.default_rng(k).normal(size=4000)})


def put_line(path, k):
    line = load_line("yizhuang")
    write_line(line if k == 0 else type(line)(**{**vars(line), "notes": (f"{k} " * 4000,)}), path)


def put_folder(path, k):
    with fill_folder(path.parent) as scratch:
        write_json(scratch / path.name, {"k": k, "much": [k] * 4000})


WRITERS = {
    "policy.safetensors": (put_policy, lambda path: load_policy(path)[1]["k"] == 0),
    "history.parquet": (put_history, lambda path: read_history(path)["a"].size == 4000),
    "line.toml": (put_line, lambda path: load_line(path) == load_line("yizhuang")),
    "kpis.json": (put_folder, lambda path: json.loads(path.read_text())["k"] == 0),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_one_line_and_keeps_what_was_there(tmp_path, name):
    write, whole = WRITERS[name]
    write(tmp_path / name, 0)
    before = (tmp_path / name).read_bytes()
    with full_disk(), pytest.raises(InputError) as error:
        write(tmp_path / name, 1)
    assert "\n" not in error.value.line()
    assert (tmp_path / name).read_bytes() == before
    assert whole(tmp_path / name)
    write(tmp_path / name, 0)
    assert [path.name for path in tmp_path.iterdir()] == [name], "nothing half written is left"


def test_a_drive_onto_a_full_disk_keeps_the_earlier_one(tmp_path):
    request = RunSpec("yizhuang", "RJ", "WYJ", 110.0, driver="flat_out")
    done = drive(request.run(), request.make_driver())
    kpis = kpis_of(done, None)
    write_run(tmp_path, request, done, kpis, None)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    with full_disk(), pytest.raises(InputError, match="cannot write") as error:
        write_run(tmp_path, request, done, kpis, None)
    assert error.value.value in {None, *(str(v) for v in errno.errorcode.values()), "File too large"}
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before

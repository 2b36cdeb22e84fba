"""Policies, histories, event files and run folders on disk; damaged ones are refused in one line."""

import json
import sqlite3
import struct
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.learn.problems import DoubleIntegrator

from metropilot._io import atomic_write
from metropilot.errors import InputError
from metropilot.learn import (
    PPOConfig,
    RunRequest,
    RunStore,
    TrainingOptions,
    learn_run,
    read_history,
    write_history,
)
from metropilot.learn.run_store import settle_status
from metropilot.learn.tensorboard import EventWriter, masked_crc
from metropilot.policy import Policy, PolicySpec, load_driving_policy, load_policy, save_policy

SPEC = PolicySpec("clip", 3, 1, (4,), "tanh", 1, normalised=True)


def policy(seed=0):
    rng = np.random.default_rng(seed)
    params = {name: rng.normal(size=shape).astype(np.float32) for name, shape in SPEC.shapes().items()}
    return Policy(SPEC, params)


def test_a_policy_comes_back_as_it_went_and_bytes_repeat(tmp_path):
    save_policy(tmp_path / "a.safetensors", policy(), {"seed": 3, "kpis": {"energy_wheel_kwh": 9.5}})
    save_policy(tmp_path / "b.safetensors", policy(), {"kpis": {"energy_wheel_kwh": 9.5}, "seed": 3})
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    loaded, about = load_policy(tmp_path / "a.safetensors")
    assert loaded.spec == SPEC
    assert about["seed"] == 3
    x = np.float32([0.1, -2.0, 3.0])
    np.testing.assert_array_equal(loaded(x), policy()(x))
    # safetensors' own reader agrees with ours
    from safetensors.numpy import load_file

    theirs = load_file(tmp_path / "a.safetensors")
    assert theirs.keys() == loaded.params.keys()
    np.testing.assert_array_equal(theirs["policy.0.weight"], loaded.params["policy.0.weight"])


def rewritten(data, change):
    """The file with its header changed."""
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    about = json.loads(header["__metadata__"]["metropilot"])
    header, about = change(header, about) or (header, about)
    header["__metadata__"] = {"metropilot": json.dumps(about)}
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data[8 + length :]


def put(*path, value):
    def change(header, about):
        place = {"header": header, "about": about}
        for name in path[:-1]:
            place = place[name]
        place[path[-1]] = value

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (put("about", "format", value=2), "format: unknown format: 2 (allowed: 1)"),
        (put("about", "policy", value=None), "does not describe its policy"),
        (put("about", "policy", "output", value="exec"), "output: unknown choice"),
        (put("about", "policy", "normalised", value=1), "normalised: not true or false"),
        (
            put("about", "policy", "hidden", value=[10**9]),
            "hidden: out of range: '1000000000' (allowed: 1 to 16384)",
        ),
        (put("about", "policy", "hidden", value=[4, 4]), "policy.2.bias: array is missing"),
        (put("about", "policy", "hidden", value=[5]), "array has the wrong shape or type"),
        (put("about", "policy", "hidden", value=[True]), "hidden: out of range"),
        (put("about", "policy", "more", value=1), "does not describe its policy"),
        (put("header", "policy.0.bias", "dtype", value="F8"), "policy.0.bias: array is damaged"),
        (put("header", "policy.0.bias", "shape", value=[10**18]), "policy.0.bias: array is damaged"),
        (put("header", "policy.0.bias", "shape", value=[-4]), "policy.0.bias: array is damaged"),
        (put("header", "policy.0.bias", "data_offsets", value=[0, 16]), "overlap or have gaps"),
        (
            put("header", "policy.0.bias", "data_offsets", value=[0, 1 << 40]),
            "policy.0.bias: array is damaged",
        ),
        (put("header", "extra", value=3), "extra: array is damaged"),
    ],
)
def test_a_changed_policy_file_is_refused_in_one_line(tmp_path, change, words):
    path = tmp_path / "p.safetensors"
    save_policy(path, policy(), {})
    path.write_bytes(rewritten(path.read_bytes(), change))
    with pytest.raises(InputError) as error:
        load_policy(path)
    assert words in str(error.value)
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


@given(data=st.binary(max_size=64), cut=st.integers(0, 600), at=st.integers(0, 600))
def test_random_damage_never_escapes_as_anything_else(tmp_path_factory, data, cut, at):
    path = tmp_path_factory.mktemp("damage") / "p.safetensors"
    save_policy(path, policy(), {"a": 1})
    whole = path.read_bytes()
    path.write_bytes((whole[:at] + data + whole[at:])[: len(whole) + len(data) - cut])
    said, found = str(path), policy()
    try:
        found, _ = load_policy(path)
    except InputError as error:
        said = str(error)
    assert said.startswith(str(path))
    assert "\n" not in said
    # Damage that hit nothing but numbers, or nothing: what is read can be driven.
    assert found.spec == policy().spec
    assert all(np.isfinite(value).all() for value in found.params.values())


def test_policies_that_cannot_be_driven_are_not_written(tmp_path):
    bad = policy()
    bad.params["policy.0.bias"][0] = np.nan
    with pytest.raises(InputError, match="not finite"):
        save_policy(tmp_path / "p.safetensors", bad, {})
    with pytest.raises(InputError, match="cannot read the file"):
        load_policy(tmp_path / "p.safetensors")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write the file"):
        save_policy(tmp_path / "file" / "p.safetensors", policy(), {})


def test_history_survives_with_its_gaps(tmp_path):
    path = tmp_path / "it's a history.parquet"
    write_history(path, {"steps": np.arange(3.0), "term.energy": np.asarray([1.0, np.nan, -3.0])})
    back = read_history(path)
    assert list(back) == ["steps", "term.energy"]
    np.testing.assert_array_equal(back["term.energy"], [1.0, np.nan, -3.0])
    path.write_text("no")
    with pytest.raises(InputError, match="cannot read the history"):
        read_history(path)


def test_event_files_are_records_with_checksums(tmp_path):
    # Known: the CRC-32C of "123456789" is 0xE3069283; masked as TensorFlow does.
    crc = 0xE3069283
    assert masked_crc(b"123456789") == (((crc >> 15 | crc << 17) & 0xFFFFFFFF) + 0xA282EAD8) & 0xFFFFFFFF
    with EventWriter(tmp_path / "events") as writer:
        writer.write(300, {"return": 1.5})
    data, events = writer.path.read_bytes(), []
    while data:
        (length,) = struct.unpack("<Q", data[:8])
        assert struct.unpack("<I", data[8:12])[0] == masked_crc(data[:8])
        event = data[12 : 12 + length]
        assert struct.unpack("<I", data[12 + length : 16 + length])[0] == masked_crc(event)
        events.append(event)
        data = data[16 + length :]
    assert b"brain.Event:2" in events[0]
    # step 300 as a varint; summary value: tag "return", float 1.5
    assert b"\x10\xac\x02" in events[1]
    assert b"\x0a\x06return\x15" + struct.pack("<f", 1.5) in events[1]


CONFIG = PPOConfig(
    steps=128,
    environments=4,
    rollout=16,
    minibatches=1,
    epochs=1,
    evaluations=2,
    evaluation_steps=5,
    evaluation_episodes=2,
    hidden=(8,),
)
REQUEST = RunRequest(
    CONFIG, DoubleIntegrator(), "integrator", seed=4, about={"line": "none"}, tensorboard=True
)


def test_a_run_leaves_everything_needed_to_show_resume_and_drive_it(tmp_path):
    store = RunStore(tmp_path / "runs")
    assert store.find("") == []

    def interrupt(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        learn_run(store, REQUEST, TrainingOptions(on_progress=interrupt))
    (stopped,) = store.find("interrupted")
    record, learned = learn_run(store, REQUEST, resume=stopped.id)
    _, other = learn_run(store, REQUEST)
    np.testing.assert_array_equal(
        learned.policy.params["policy.0.weight"], other.policy.params["policy.0.weight"]
    )
    assert record.status == "done"
    assert record.score == pytest.approx(learned.score)
    assert store.show(record.id) == record
    assert record.configuration() == CONFIG
    folder = store.folder(record.id)
    names = {path.name for path in folder.iterdir() if not path.name.startswith("events")}
    assert names == {"run.toml", "history.parquet", "policy.safetensors", "checkpoint.safetensors"}
    assert read_history(folder / "history.parquet")["steps"].tolist() == [64.0, 128.0]
    loaded, about = load_policy(folder / "policy.safetensors")
    assert about["provenance"]["run"] == record.id
    assert about["task"] == {"line": "none", "name": "integrator"}
    np.testing.assert_array_equal(loaded.params["policy.0.weight"], learned.policy.params["policy.0.weight"])
    # A run cannot go on with another configuration, and is not spoiled by the attempt.
    with pytest.raises(InputError, match=r"config\.gamma"):
        learn_run(
            store,
            RunRequest(PPOConfig(**vars(CONFIG) | {"gamma": 0.5}), REQUEST.task, "integrator", 4),
            None,
            record.id,
        )
    assert store.show(record.id).status == "done"


def test_a_run_that_was_interrupted_shows_the_policy_kept_and_has_none_yet(tmp_path):
    scores = iter([1.0, 3.0, 2.0, 0.0])

    def evaluate(params, key):
        score = jax.pure_callback(lambda: np.float32(next(scores)), jax.ShapeDtypeStruct((), np.float32))
        return {"score": score, "safe_share": 0.1 * score}

    def interrupt(progress):
        if progress.chunk == 3:
            raise KeyboardInterrupt

    store, config = RunStore(tmp_path / "runs"), replace(CONFIG, evaluations=4, steps=256)
    with pytest.raises(KeyboardInterrupt):
        learn_run(store, replace(REQUEST, config=config), TrainingOptions(evaluate, interrupt))
    (stopped,) = store.find("interrupted")
    assert stopped.score == 3.0
    assert stopped.kpis == pytest.approx({"safe_share": 0.3}), "those of the best, not of the last"
    folder = store.folder(stopped.id)
    with pytest.raises(InputError, match=f"no policy yet: 'interrupted' .*--resume {folder}"):
        load_driving_policy(folder)
    with pytest.raises(InputError, match="cannot read the file"):
        load_driving_policy(tmp_path)


def test_a_run_that_ends_while_it_is_looked_at_stays_done(tmp_path):
    store = RunStore(tmp_path / "runs")
    running = store.create(CONFIG, "integrator", 4, {})
    store.update(running, status="done", score=1.5)
    # read before the process ended, looked at after it
    found = settle_status(store, running)
    assert (found.status, found.score) == ("done", 1.5)
    assert store.show(running.id).status == "done"


def test_a_run_is_forgotten_beside_one_that_learns(tmp_path):
    store = RunStore(tmp_path / "runs")
    gone, kept = (store.create(CONFIG, "integrator", seed, {}, id=f"run-{seed}") for seed in (1, 2))
    with sqlite3.connect(tmp_path / "runs" / "index.sqlite") as reader:
        reader.execute("BEGIN")
        assert reader.execute("SELECT count(*) FROM runs").fetchone() == (2,)
        store.forget(gone.id)
    assert [record.id for record in store.find("")] == [kept.id]
    assert not store.folder(gone.id).exists()


def test_several_may_write_one_file_at_once(tmp_path):
    """Each writes a file of its own, and one after the other takes the place."""
    path, texts = tmp_path / "report.md", [f"{k}" * 20_000 for k in range(4)]

    def write(text):
        for _ in range(20):
            atomic_write(path, lambda partial: partial.write_text(text))

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(write, texts))
    assert path.read_text() in texts
    assert [each.name for each in tmp_path.iterdir()] == ["report.md"]


def test_a_run_goes_on_from_a_checkpoint_with_other_columns(tmp_path):
    from safetensors import safe_open
    from safetensors.numpy import save_file

    def interrupt(progress):
        raise KeyboardInterrupt

    store = RunStore(tmp_path / "runs")
    with pytest.raises(KeyboardInterrupt):
        learn_run(store, REQUEST, TrainingOptions(on_progress=interrupt))
    (stopped,) = store.find("interrupted")
    path = store.folder(stopped.id) / "checkpoint.safetensors"
    with safe_open(path, "numpy") as file:
        tensors, metadata = {name: file.get_tensor(name) for name in file.keys()}, file.metadata()  # noqa: SIM118
    tensors["history.gone"] = tensors.pop("history.entropy")
    save_file(tensors, path, metadata)
    record, learned = learn_run(store, REQUEST, resume=stopped.id)
    history = read_history(store.folder(record.id) / "history.parquet")
    assert np.isnan(history["entropy"]).tolist() == [True, False]
    assert np.isnan(history["gone"]).tolist() == [False, True]
    assert learned.history["steps"].tolist() == [64.0, 128.0]


def test_the_index_finds_and_is_made_anew(tmp_path):
    store = RunStore(tmp_path)
    a = store.create(CONFIG, "rongjing", 1, {"section": "RJ_WYJ"})
    b = store.create(CONFIG, "convoy", 2, {"section": "RJXWYJ"})
    store.update(b, status="done", score=-1.0, steps=128)
    assert {record.id for record in store.find("")} == {a.id, b.id}
    assert [record.id for record in store.find("convoy done")] == [b.id]
    assert [record.id for record in store.find("RJ_WYJ")] == [a.id]
    assert store.find("RJ_WYJ convoy") == []
    assert store.find("50%") == []
    with pytest.raises(InputError, match="several runs begin so"):
        store.show("ppo-")
    with pytest.raises(InputError, match=r"no such run: 'x'"):
        store.show("x")
    with sqlite3.connect(tmp_path / "index.sqlite") as database:
        assert database.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    database.close()
    (tmp_path / "index.sqlite").write_bytes(b"this is not a database, it is a sentence" * 50)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "run.toml").write_text("id = ")
    assert {record.id for record in store.find("")} == {a.id, b.id}
    assert store.show(b.id).score == -1.0
    assert jax.devices()

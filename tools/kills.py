"""Kill -9 at random moments, again and again, and look at what is left: `python tools/kills.py`.

Three kinds of work, each in a process of its own that is killed a random time after it began:

- ``learning``: a learning run, gone on with after each kill until it is done; its policy is then that of a
  run nobody disturbed, bit for bit;
- ``campaign``: a campaign in the same way (driven by the process that keeps its shards); its results are
  then those of an undisturbed one, bit for bit;
- ``files``: plain writes without end (a policy, also as ONNX, a history, a line, the record of a run and the
  index of runs, the folders of a drive and of a comparison with their pictures); after each kill each of them
  is absent or one of the whole versions written.

Only a kill that met the process at work counts.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import random
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

LONGEST_S = 5.0
"""Within it, everything is written at least once."""
PICTURES = 20
"""Drawing takes as long as so many rounds of everything else."""
ROOT = Path(__file__).resolve().parents[1]
CAMPAIGN = """
name = "mine"
[matrix]
drivers = ["flat_out"]
sections = ["yizhuang RJ WYJ"]
loads = ["AW2"]
times = [1.2]
seeds = 20
[[disturbance]]
name = "noisy"
speed_noise_mps = 0.05
"""


def learn_small(place: Path) -> None:
    """Learn a small policy, from the checkpoint where there is one."""
    from tests.learn.problems import DoubleIntegrator

    from metropilot.learn import PPOConfig, TrainingOptions, learn_in_chunks
    from metropilot.policy import save_policy

    config = PPOConfig(
        steps=19_200,
        environments=4,
        rollout=16,
        minibatches=1,
        epochs=1,
        evaluations=300,
        evaluation_steps=5,
        evaluation_episodes=2,
        hidden=(8,),
    )
    checkpoint = place / "checkpoint.safetensors"
    sitting = TrainingOptions(checkpoint=checkpoint, resume=checkpoint.exists())
    learned = learn_in_chunks(config, DoubleIntegrator(), 7, sitting)
    save_policy(place / "result", learned.policy, {"seed": 7})


def campaign(place: Path) -> None:
    """Drive a small campaign, from where its folder left it."""
    from metropilot.campaign import CampaignStore, campaign_from_toml, collect_parts, compute_shard

    told = place / "mine.toml"
    told.write_text(CAMPAIGN)
    declared = campaign_from_toml(told)
    store = CampaignStore(place / "out", declared)
    done = store.finished_shards()
    for piece in declared.pieces():
        if piece not in done:
            store.keep(compute_shard(declared.text, piece))
    collect_parts(place / "out")
    (place / "out" / "results.parquet").replace(place / "result")


@cache
def make_drive() -> tuple[Any, Any]:
    """A drive that is written again and again: what was asked for, and what came of it."""
    from metropilot.evaluate import Entry, RunSpec, kpis_of
    from metropilot.sim import drive

    request = RunSpec("yizhuang", "RJ", "WYJ", 110.0, driver="flat_out")
    done = drive(request.run(), request.make_driver())
    return request, Entry("flat_out", (done,), (kpis_of(done, None),), None)


def files(place: Path) -> None:
    """Write one version after the other of everything, without end."""
    import numpy as np

    from metropilot.evaluate import write_comparison, write_run
    from metropilot.learn import PPOConfig, RunStore, export_onnx, write_history
    from metropilot.policy import Policy, PolicySpec, save_policy
    from metropilot.railway import load_line, write_line

    line, store = load_line("yizhuang"), RunStore(place / "runs")
    spec = PolicySpec("clip", 14, 1, (64, 64), "tanh", 1)
    for k in itertools.count():
        params = {n: np.full(s, k % 50, np.float32) for n, s in spec.shapes().items()}
        save_policy(place / "policy.safetensors", Policy(spec, params), {"k": k})
        write_history(place / "history.parquet", {"a": np.full(2000, float(k))})
        write_line(line, place / "line.toml")
        store.update(store.create(PPOConfig(), "drive", k, {}), status="done", steps=k)
        export_onnx(Policy(spec, params), place / "policy.onnx", about={"k": k}, probes=10)
        if k % PICTURES == 0:
            request, entry = make_drive()
            write_run(place / "drive", request, entry.drives[0], entry.kpis[0], None)
            write_comparison(place / "compare", request, [entry])


def look_at_files(place: Path) -> None:
    """Every file is absent or whole.

    Raises:
        AssertionError: One is neither.
    """
    import numpy as np

    from metropilot.learn import RunStore, read_history
    from metropilot.policy import load_policy
    from metropilot.railway import load_line

    if (place / "policy.safetensors").exists():
        policy, about = load_policy(place / "policy.safetensors")
        same(all((np.asarray(p) == about["k"] % 50).all() for p in policy.params.values()), "policy")
    if (place / "history.parquet").exists():
        column = read_history(place / "history.parquet")["a"]
        same(column.size == 2000 and np.ptp(column) == 0, "history")
    if (place / "line.toml").exists():
        same(load_line(place / "line.toml") == load_line("yizhuang"), "line")
    if (place / "policy.onnx").exists():
        import onnxruntime

        session = onnxruntime.InferenceSession(place / "policy.onnx", providers=["CPUExecutionProvider"])
        same(session.get_modelmeta().custom_metadata_map["k"].isdigit(), "policy.onnx")
    for folder in (place / "drive", place / "compare"):
        look_at_folder(folder)
    store = RunStore(place / "runs")
    for record in store.find(""):
        same(record.status in {"running", "interrupted", "done"}, "record")
        same(record.status != "done" or record.steps == record.seed, "record")


def look_at_folder(folder: Path) -> None:
    """Every file of a drive's or comparison's folder is absent or whole.

    Raises:
        AssertionError: One is neither.
    """
    from metropilot.evaluate import run_from_toml
    from metropilot.sim import Trajectory

    request, entry = make_drive()
    for path in folder.glob("*"):
        if path.suffix == ".json":
            same(bool(json.loads(path.read_text())), path.name)
        elif path.suffix == ".csv":
            same(len(Trajectory.read(path)) == len(entry.drives[0].trajectory), path.name)
        elif path.suffix == ".toml":
            same(run_from_toml(path) == request.resolve(), path.name)
        elif path.suffix in {".png", ".svg"}:
            end = b"IEND\xaeB`\x82" if path.suffix == ".png" else b"</svg>"
            same(path.read_bytes().rstrip().endswith(end), path.name)


def same(whole: bool, what: str) -> None:
    """Say what is not as it should be."""
    if not whole:
        raise AssertionError(f"{what} is neither absent nor whole")


def kill_after(work: Callable[[Path], None], place: Path, after_s: float | None) -> bool:
    """Do the work in a process of its own, killed after a time; whether the kill met it at work."""
    child = os.fork()
    if child == 0:
        try:
            work(place)
        except BaseException as error:  # noqa: BLE001 (of a child nobody else would hear)
            print(f"{work.__name__}: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
            os._exit(1)
        os._exit(0)
    end = None if after_s is None else time.monotonic() + after_s
    while end is None or time.monotonic() < end:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            if status:
                raise SystemExit(f"{work.__name__}: ended with {status}")
            return False
        time.sleep(0.002)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return True


def check_resuming(
    work: Callable[[Path], None], wanted: int, chance: random.Random, folder: Path
) -> dict[str, Any]:
    """Runs of resumable work, each killed again and again until done and compared with an undisturbed one."""

    def place(number: int) -> Path:
        made = folder / f"{work.__name__}-{number}"
        made.mkdir(parents=True, exist_ok=True)
        return made

    kill_after(work, place(0), None)
    began = time.monotonic()
    kill_after(work, place(1), None)
    takes = time.monotonic() - began
    result = sha256((place(0) / "result").read_bytes()).hexdigest()
    same(result == sha256((place(1) / "result").read_bytes()).hexdigest(), "the undisturbed result")
    kills, runs = 0, 0
    while kills < wanted:
        runs += 1
        here = place(1 + runs)
        while kill_after(work, here, chance.uniform(0.0, takes)):
            kills += 1
        same(sha256((here / "result").read_bytes()).hexdigest() == result, "the result of an interrupted run")
    seconds = round(takes, 1)
    return {
        "work": work.__name__,
        "undisturbed_s": seconds,
        "kills": kills,
        "runs resumed to the end": runs,
        "results that differ": 0,
    }


def check_writes(wanted: int, chance: random.Random, folder: Path) -> dict[str, Any]:
    """Kills among plain writes, and what is left looked at after each."""
    place, kills = folder / "files", 0
    place.mkdir()
    while kills < wanted:
        kills += kill_after(files, place, chance.uniform(0.0, LONGEST_S))
        kill_after(look_at_files, place, None)
    left = [str(p.relative_to(place)) for p in place.rglob("*") if p.name.endswith(".partial")]
    return {"work": "files", "kills": kills, "looks": kills, "broken": 0, "partial files left": len(left)}


def main() -> None:
    """Kill, look, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--files", type=int, default=120)
    parser.add_argument("--campaign", type=int, default=50)
    parser.add_argument("--learning", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    told = parser.parse_args()
    sys.path[:0] = [str(ROOT / "src"), str(ROOT)]
    # Imported here once: a fork is at work at once. No program of JAX is run before a fork.
    import duckdb  # noqa: F401
    import matplotlib.figure  # noqa: F401
    import onnxruntime  # noqa: F401

    import metropilot.learn  # noqa: F401
    from metropilot.evaluate import draw_speed, front_figure  # noqa: F401

    chance = random.Random(told.seed)
    with tempfile.TemporaryDirectory(prefix="metropilot-kills-") as name:
        folder = Path(name)
        os.environ["METROPILOT_HOME"] = str(folder / "home")
        make_drive()
        rows = []
        for row in (
            lambda: check_writes(told.files, chance, folder),
            lambda: check_resuming(campaign, told.campaign, chance, folder),
            lambda: check_resuming(learn_small, told.learning, chance, folder),
        ):
            rows.append(row())
            print(json.dumps(rows[-1]), flush=True)
    print(f"{sum(row['kills'] for row in rows)} kills, every artefact whole or absent, every result the same")


if __name__ == "__main__":
    main()

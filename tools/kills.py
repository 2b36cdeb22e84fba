"""Kill -9 at random moments, again and again, and look at what is left: `python tools/kills.py`.

Three kinds of work, each in a process of its own that is killed a random time after it began:

- ``learning``: a learning run, gone on with after each kill until it is done; its policy is then that of a
  run nobody disturbed, bit for bit;
- ``campaign``: a campaign in the same way (driven by the process that keeps its shards); its results are
  then those of an undisturbed one, bit for bit;
- ``files``: plain writes without end (a drive's folder, a policy, a history, a line, the record of a run and
  the index of runs); after each kill each of them is absent or one of the whole versions written.

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
from hashlib import sha256
from pathlib import Path
from typing import Any

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


def learning(place: Path) -> None:
    """Learn a small policy, from the checkpoint where there is one."""
    from tests.learn.problems import DoubleIntegrator

    from metropilot.drivers.policy import save_policy
    from metropilot.learn import PPOConfig, Sitting, learn_in_chunks

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
    sitting = Sitting(checkpoint=checkpoint, resume=checkpoint.exists())
    learned = learn_in_chunks(config, DoubleIntegrator(), 7, sitting)
    save_policy(place / "result", learned.policy, {"seed": 7})


def campaign(place: Path) -> None:
    """Drive a small campaign, from where its folder left it."""
    from metropilot.evaluate.campaign.reading import campaign_from_toml
    from metropilot.evaluate.campaign.rows import drive_shard
    from metropilot.evaluate.campaign.store import Store
    from metropilot.evaluate.campaign.summary import collect

    told = place / "mine.toml"
    told.write_text(CAMPAIGN)
    declared = campaign_from_toml(told)
    store = Store(place / "out", declared)
    done = store.done()
    for piece in declared.pieces():
        if piece not in done:
            store.keep(drive_shard(declared.text, piece))
    collect(place / "out")
    (place / "out" / "results.parquet").replace(place / "result")


def files(place: Path) -> None:
    """Write one version after the other of everything, without end."""
    import numpy as np

    from metropilot.drivers.policy import Policy, PolicySpec, save_policy
    from metropilot.evaluate.folder import filled, write_json
    from metropilot.learn import PPOConfig
    from metropilot.learn.history import write_history
    from metropilot.learn.runs import RunStore
    from metropilot.railway import load_line, write_line

    line, store = load_line("yizhuang"), RunStore(place / "runs")
    spec = PolicySpec("clip", 14, 1, (64, 64), "tanh", 1)
    for k in itertools.count():
        params = {n: np.full(s, k % 50, np.float32) for n, s in spec.shapes().items()}
        save_policy(place / "policy.safetensors", Policy(spec, params), {"k": k})
        write_history(place / "history.parquet", {"a": np.full(2000, float(k))})
        write_line(line, place / "line.toml")
        store.update(store.create(PPOConfig(), "drive", k, {}), status="done", steps=k)
        with filled(place / "drive") as scratch:
            for name in ("a.json", "b.json"):
                write_json(scratch / name, {"k": k, "much": list(range(3000))})


def look_at_files(place: Path) -> None:
    """Every file is absent or whole.

    Raises:
        AssertionError: One is neither.
    """
    import numpy as np

    from metropilot.drivers.policy import load_policy
    from metropilot.learn.history import read_history
    from metropilot.learn.runs import RunStore
    from metropilot.railway import load_line

    if (place / "policy.safetensors").exists():
        policy, about = load_policy(place / "policy.safetensors")
        same(all((np.asarray(p) == about["k"] % 50).all() for p in policy.params.values()), "policy")
    if (place / "history.parquet").exists():
        column = read_history(place / "history.parquet")["a"]
        same(column.size == 2000 and np.ptp(column) == 0, "history")
    if (place / "line.toml").exists():
        same(load_line(place / "line.toml") == load_line("yizhuang"), "line")
    for name in ("a.json", "b.json"):
        if (place / "drive" / name).exists():
            found = json.loads((place / "drive" / name).read_text())
            same(len(found["much"]) == 3000, name)
    store = RunStore(place / "runs")
    for record in store.recent():
        same(record.status in {"running", "interrupted", "done"}, "record")
        same(record.status != "done" or record.steps == record.seed, "record")


def same(whole: bool, what: str) -> None:
    """Say what is not as it should be."""
    if not whole:
        raise AssertionError(f"{what} is neither absent nor whole")


def killed(work: Callable[[Path], None], place: Path, after_s: float | None) -> bool:
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


def resumed(work: Callable[[Path], None], wanted: int, chance: random.Random, folder: Path) -> dict[str, Any]:
    """Runs of resumable work, each killed again and again until done and compared with an undisturbed one."""

    def place(number: int) -> Path:
        made = folder / f"{work.__name__}-{number}"
        made.mkdir(parents=True, exist_ok=True)
        return made

    killed(work, place(0), None)
    began = time.monotonic()
    killed(work, place(1), None)
    takes = time.monotonic() - began
    result = sha256((place(0) / "result").read_bytes()).hexdigest()
    same(result == sha256((place(1) / "result").read_bytes()).hexdigest(), "the undisturbed result")
    kills, runs = 0, 0
    while kills < wanted:
        runs += 1
        here = place(1 + runs)
        while killed(work, here, chance.uniform(0.0, takes)):
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


def written(wanted: int, chance: random.Random, folder: Path) -> dict[str, Any]:
    """Kills among plain writes, and what is left looked at after each."""
    place, kills = folder / "files", 0
    place.mkdir()
    while kills < wanted:
        kills += killed(files, place, chance.uniform(0.0, 1.5))
        killed(look_at_files, place, None)
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

    import metropilot.evaluate
    import metropilot.learn  # noqa: F401

    chance = random.Random(told.seed)
    with tempfile.TemporaryDirectory(prefix="metropilot-kills-") as name:
        folder = Path(name)
        os.environ["METROPILOT_HOME"] = str(folder / "home")
        rows = []
        for row in (
            lambda: written(told.files, chance, folder),
            lambda: resumed(campaign, told.campaign, chance, folder),
            lambda: resumed(learning, told.learning, chance, folder),
        ):
            rows.append(row())
            print(json.dumps(rows[-1]), flush=True)
    print(f"{sum(row['kills'] for row in rows)} kills, every artefact whole or absent, every result the same")


if __name__ == "__main__":
    main()

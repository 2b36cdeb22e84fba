"""Remove each guard of protection in turn and see which test notices.

    python tools/mutate_guards.py --write docs/safety.md      # all of them, half an hour
    python tools/mutate_guards.py --only latch                # those whose name holds this

The source is copied, one line of the copy is changed, and the tests named for the guard run against the copy;
if they pass, all tests of protection do. A guard whose removal no test notices is a test that is missing.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SUPERVISOR, PREDICT, CURVES, GROUND, SEPARATION, BOUNDS = (
    f"protection/{name}.py" for name in ("supervisor", "predict", "curves", "ground", "separation", "bounds")
)
BY_NAME = "test_supervisor.py"
DUELS = "test_mutations.py"
PAIRS = "test_separation.py"
LAWS = "test_curves.py"
HOSTILE = "test_hostile.py"
WORST = "test_worst_case.py"
ALL = (BY_NAME, LAWS, PAIRS, "test_guards.py", DUELS, "test_permitted.py", WORST, HOSTILE)


@dataclass(frozen=True)
class Guard:
    """One guard, and how to remove it.

    Attributes:
        name: What it guards against.
        hazard: Number of the hazard in the safety argument.
        file: Where it stands, below the package.
        old: Source that holds it; occurs once.
        new: The same without it.
        tests: Test files that should notice, the likeliest first.
    """

    name: str
    hazard: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...] = (DUELS,)


GUARDS = (
    Guard(
        "every command is checked",
        "H1",
        SUPERVISOR,
        "    level = unless(passes, 0, _milder,",
        "    level = unless(passes | True, 0, _milder,",
        (BY_NAME,),
    ),
    Guard(
        "the emergency brake must be in time, whatever the plant",
        "H1",
        SUPERVISOR,
        "margin_mps) & self._in_time(self.worst, share, margin_mps)",
        "margin_mps)",
    ),
    Guard(
        "a traction cut-off must do, or it is not enough",
        "H1",
        SUPERVISOR,
        "return check.xp.where(check.passes(cut, none), 1, brake)",
        "return check.xp.where(check.passes(cut, none) | True, 1, brake)",
        (HOSTILE,),
    ),
    Guard(
        "a service brake must do, or the emergency brake acts",
        "H1",
        SUPERVISOR,
        "return 1 if check.passes(cut, none) else 2 if check.emergency(none - 1.0, none) else 3",
        "return 1 if check.passes(cut, none) else 2",
        (BY_NAME,),
    ),
    Guard(
        "the last level is the emergency brake",
        "H1",
        SUPERVISOR,
        "emergency = (level == 3) | (memory",
        "emergency = (memory",
        (BY_NAME,),
    ),
    Guard(
        "service brake before emergency brake",
        "spares",
        SUPERVISOR,
        "self._in_time(self.usual, share, margin_mps) & self",
        "self",
        (BY_NAME,),
    ),
    Guard(
        "a command that is no number is a full brake",
        "H2",
        SUPERVISOR,
        'xp.where(xp.abs(command.share) < float("inf"), xp.clip(command.share, -1.0, 1.0), full)',
        "xp.clip(command.share, -1.0, 1.0)",
        (BY_NAME,),
    ),
    Guard(
        "a command out of range is clipped",
        "H2",
        SUPERVISOR,
        "xp.clip(command.share, -1.0, 1.0), full)",
        "command.share, full)",
        (BY_NAME,),
    ),
    Guard(
        "a position that is no number",
        "H3",
        SUPERVISOR,
        "self.measured = known & moving",
        "self.measured = moving",
        (BY_NAME,),
    ),
    Guard(
        "a speed that is no number",
        "H3",
        SUPERVISOR,
        "self.measured = known & moving",
        "self.measured = known",
        (BY_NAME,),
    ),
    Guard(
        "error of the measured speed",
        "H3",
        SUPERVISOR,
        "speed = self.speed_mps + brake.rates.speed_error_mps + margin_mps",
        "speed = self.speed_mps + margin_mps",
    ),
    Guard(
        "error of the measured position",
        "H3",
        CURVES,
        "    if bounds.position_error_m > 0:\n",
        "    if bounds.position_error_m > 1e9:\n",
    ),
    Guard(
        "more room before a command passes again",
        "H4",
        SUPERVISOR,
        "margin = xp.where(memory.level > 0, RELEASE_MPS, 0.0)",
        "margin = xp.where(memory.level > 0, 0.0, 0.0)",
        (BY_NAME,),
    ),
    Guard(
        "commands on their way through the dead time",
        "H4",
        SUPERVISOR,
        "newest = self.xp.maximum(share, self.older)",
        "newest = share",
    ),
    Guard(
        "what the lag has left of older commands",
        "H4",
        SUPERVISOR,
        "return newest + self.xp.maximum(self.memory.share - newest, 0.0) * self.protection.fading.share",
        "return newest",
    ),
    Guard(
        "what the jerk limit has left of the last acceleration",
        "H4",
        SUPERVISOR,
        "acting = self.xp.maximum(acceleration(brake.forces, self.kept(share)), self.fading)",
        "acting = acceleration(brake.forces, self.kept(share))",
    ),
    Guard(
        "the acceleration remembered is the largest there may be",
        "H4",
        SUPERVISOR,
        "return kept, self.xp.maximum(acceleration(self.worst.forces, kept), self.fading)",
        "return kept, acceleration(self.worst.forces, kept)",
    ),
    Guard(
        "the emergency brake stays on until standstill",
        "H6",
        SUPERVISOR,
        "| (memory.emergency & moving) |",
        "|",
        (BY_NAME,),
    ),
    Guard(
        "the driver may ask for the emergency brake",
        "H6",
        SUPERVISOR,
        "(memory.emergency & moving) | command.emergency",
        "(memory.emergency & moving)",
        (BY_NAME,),
    ),
    Guard(
        "one period passes before the next decision",
        "H5",
        BOUNDS,
        "return self.dt_s * (1 + ceil(",
        "return self.dt_s * (0 + ceil(",
    ),
    Guard(
        "dead time of the emergency brake",
        "H5",
        BOUNDS,
        "return self.dt_s * (1 + ceil(self.emergency_reaction_s / self.dt_s - 1e-3))",
        "return self.dt_s",
    ),
    Guard(
        "build-up of the emergency brake",
        "H5",
        CURVES,
        "        jerk_mps3=min(bounds.emergency_jerk_mps3, AT_ONCE_MPS3),\n",
        "        jerk_mps3=AT_ONCE_MPS3,\n",
    ),
    Guard(
        "a trainset lighter than told gains more",
        "H5",
        PREDICT,
        "lightest = rates.mass_low * vehicle",
        "lightest = vehicle",
    ),
    Guard(
        "a trainset heavier than told brakes less",
        "H5",
        PREDICT,
        "heaviest = rates.mass_high * vehicle",
        "heaviest = vehicle",
    ),
    Guard(
        "a service brake weaker than told",
        "H5",
        PREDICT,
        "hold = rates.service_share * xp",
        "hold = xp",
    ),
    Guard(
        "resistance that is not certain",
        "H5",
        PREDICT,
        "coast = pull_mps2 - rates.resistance_low * davis",
        "coast = pull_mps2 - davis",
    ),
    Guard(
        "traction at the worse of two speeds",
        "H5",
        PREDICT,
        "push = xp.maximum(slow.traction_n, quick.traction_n) / lightest",
        "push = quick.traction_n / lightest",
    ),
    Guard(
        "brake at the worse of two speeds",
        "H5",
        PREDICT,
        "xp.minimum(slow.brake_n, quick.brake_n) / heaviest",
        "slow.brake_n / heaviest",
    ),
    Guard(
        "gradient during the reaction",
        "H7",
        SUPERVISOR,
        "pull = self.xp.maximum(pulls[self.node], pulls[self.node + 1])",
        "pull = 0.0 * pulls[self.node]",
    ),
    Guard(
        "gradient of the next node too",
        "H7",
        SUPERVISOR,
        "pull = self.xp.maximum(pulls[self.node], pulls[self.node + 1])",
        "pull = pulls[self.node]",
    ),
    Guard(
        "gradient as far as the prediction reaches",
        "H7",
        CURVES,
        "pull = sliding_max(field.pull_mps2, before, reach)",
        "pull = sliding_max(field.pull_mps2, before, 1)",
        (DUELS, LAWS),
    ),
    Guard(
        "gradient that still counts from behind",
        "H7",
        CURVES,
        "    before = int(np.ceil(_memory_m(bounds, top, field.pull_mps2) / spacing_m))\n",
        "    before = 0\n",
    ),
    Guard(
        "gradient in the braking curve",
        "H7",
        CURVES,
        "rate = bounds.emergency_mps2 - sliding_max(field.pull_mps2, before, 1)[:-1]",
        "rate = bounds.emergency_mps2 + 0.0 * sliding_max(field.pull_mps2, before, 1)[:-1]",
        (LAWS,),
    ),
    Guard(
        "gradient changes between nodes",
        "H7",
        GROUND,
        "    kinks = np.concatenate([breaks, breaks + trainset.length_m])\n",
        "    kinks = breaks[:0]\n",
    ),
    Guard(
        "limits between nodes",
        "H8",
        GROUND,
        "    for step in range(1, int((high - low).max()) + 1):\n",
        "    for step in range(1, 1):\n",
        (LAWS, DUELS),
    ),
    Guard(
        "a limit holds until the tail has cleared it",
        "H8",
        GROUND,
        "restrictive_profile(section, trainset.length_m, trainset",
        "restrictive_profile(section, 0.0, trainset",
        (LAWS,),
    ),
    Guard(
        "the lower of two limits at a node",
        "H8",
        CURVES,
        "np.minimum(np.append(ceiling[0], ceiling), np.append(ceiling, 0.0))",
        "np.append(ceiling, 0.0)",
        (LAWS,),
    ),
    Guard(
        "every point on the way, not only the last",
        "H8",
        PREDICT,
        "    return xp.all(cells & (full",
        "    return xp.all(cells[..., -1:] & (full",
    ),
    Guard(
        "what lies between two nodes of the prediction",
        "H8",
        PREDICT,
        "xp.minimum(room[..., left], room[..., right]) >= bulge",
        "xp.minimum(room[..., left], room[..., right]) >= 0.0",
        (BY_NAME,),
    ),
    Guard(
        "a prediction that leaves the window is refused",
        "H8",
        PREDICT,
        "xp.all(cells & (full <= distance_m[..., -1:]), axis=-1)",
        "xp.all(cells, axis=-1)",
    ),
    Guard(
        "end of the movement authority",
        "H9",
        GROUND,
        "return ceiling if stop_at_m is None else np.where(nodes[1:] > stop_at_m, 0.0, ceiling)",
        "return ceiling",
        (BY_NAME,),
    ),
    Guard(
        "the map ends in a stop",
        "H9",
        CURVES,
        "np.append(ceiling, 0.0)) ** 2",
        "np.append(ceiling, ceiling[-1])) ** 2",
        (LAWS,),
    ),
    Guard(
        "rounding of the number type",
        "H10",
        CURVES,
        "np.maximum(_emergency_curve(field, bounds, before) - rounding, 0.0)",
        "np.maximum(_emergency_curve(field, bounds, before), 0.0)",
        (LAWS,),
    ),
    Guard(
        "the trainset ahead is looked at",
        "H11",
        SUPERVISOR,
        "        if self.ahead is None:\n",
        "        if True:\n",
        (PAIRS,),
    ),
    Guard(
        "margin never to be used up",
        "H11",
        SUPERVISOR,
        ">= bounds.margin_m + rooms * bounds.room_m",
        ">= rooms * bounds.room_m",
        (PAIRS,),
    ),
    Guard(
        "age of the last message",
        "H11",
        SEPARATION,
        "gaps = ahead.rear_m - position_m + travelled(leader, times + ahead.age_s) -",
        "gaps = ahead.rear_m - position_m + travelled(leader, times) -",
        (PAIRS,),
    ),
    Guard(
        "the trainset ahead may brake from its message on",
        "H11",
        SEPARATION,
        "bounds.leader_jerk_mps3, bounds.leader_mps2)\n",
        "bounds.leader_jerk_mps3, 0.5 * bounds.leader_mps2)\n",
        (PAIRS,),
    ),
    Guard(
        "its fall has a period's head start",
        "H11",
        SEPARATION,
        "worst = ahead.acceleration_mps2 - bounds.leader_jerk_mps3 * bounds.period_s",
        "worst = ahead.acceleration_mps2 - 0.0 * bounds.period_s",
        (PAIRS,),
    ),
    Guard(
        "the follower's brake may give less",
        "H11",
        SEPARATION,
        "held = held_mps2 - pair.scatter_mps2",
        "held = held_mps2",
        (PAIRS,),
    ),
    Guard(
        "every moment until both stand, not only the last",
        "H11",
        SEPARATION,
        "times = join.concatenate([NODES.astype(late.dtype) * building, late])",
        "times = late",
        (PAIRS,),
    ),
    Guard(
        "what the gap dips between two moments",
        "H11",
        SEPARATION,
        "return gaps.min() - dip",
        "return gaps.min() - 0.0 * dip",
        (PAIRS,),
    ),
    Guard(
        "a follower's brake that does not hold is refused",
        "H11",
        SEPARATION,
        "    if held < SLOWEST_MPS2:\n",
        "    if held < -1e9:\n",
        (PAIRS,),
    ),
)


@dataclass(frozen=True)
class Mutant:
    """What became of one guard's removal.

    Attributes:
        guard: The guard.
        noticed: First test that failed; empty: none did.
        seconds: How long it took.
    """

    guard: Guard
    noticed: str
    seconds: float


def removed(source: str, guard: Guard) -> str:
    """A module's source without the guard.

    Raises:
        ValueError: The source that holds it does not occur exactly once.
    """
    if source.count(guard.old) != 1:
        raise ValueError(f"{guard.name}: {source.count(guard.old)} times in {guard.file}, wanted once")
    return source.replace(guard.old, guard.new)


def mutated(guard: Guard) -> Mutant:
    """Remove one guard from a copy of the package and run its tests against that."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="metropilot-guard-") as folder:
        copy = Path(folder, "src")
        shutil.copytree(ROOT / "src", copy, ignore=shutil.ignore_patterns("__pycache__"))
        path = copy / "metropilot" / guard.file
        path.write_text(removed(path.read_text(), guard))
        rest = tuple(name for name in ALL if name not in guard.tests)
        noticed = tried(copy, guard.tests) or tried(copy, rest)
    return Mutant(guard, noticed, time.monotonic() - began)


def tried(source: Path, files: tuple[str, ...]) -> str:
    """The first test that fails against this source; empty: none."""
    tests = [f"tests/protection/{name}" for name in files if (ROOT / "tests/protection" / name).exists()]
    paths = os.pathsep.join([str(source), str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--no-header", *tests],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": paths, "HYPOTHESIS_STORAGE_DIRECTORY": str(source)},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode == 0:
        return ""
    found = re.search(
        r"^(?:FAILED|ERROR) tests/protection/(\S+?\.py(?:::\w+)?(?:\[.*?\])?)(?: - |$)",
        done.stdout,
        re.MULTILINE,
    )
    if not found:
        raise RuntimeError(done.stdout[-2000:] + done.stderr[-2000:])
    return found[1]


def table(mutants: list[Mutant]) -> str:
    """The table of the page."""
    lines = ["| hazard | guard removed | in | first test that fails |", "|---|---|---|---|"]
    lines += [
        f"| {m.guard.hazard} | {m.guard.name} | `{m.guard.file}` | "
        + (f"`{m.noticed}`" if m.noticed else "**none**")
        + " |"
        for m in mutants
    ]
    survived = sum(not mutant.noticed for mutant in mutants)
    lines += ["", f"{len(mutants)} guards removed, {len(mutants) - survived} noticed, {survived} survived."]
    return "\n".join(lines)


def main() -> None:
    """Run the guards asked for, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", default="", help="guards whose name holds this")
    parser.add_argument("--write", type=Path, metavar="PAGE")
    options = parser.parse_args()
    mutants = []
    for guard in GUARDS:
        if options.only in guard.name:
            mutants.append(mutated(guard))
            print(
                f"{guard.name}: {mutants[-1].noticed or 'SURVIVED'} ({mutants[-1].seconds:.0f} s)", flush=True
            )
    text = table(mutants)
    if options.write:
        sys.path.insert(0, str(ROOT))
        from benchmarks.report import written

        options.write.write_text(written(options.write.read_text(), "mutate_guards", text))
    print(text)
    raise SystemExit(any(not mutant.noticed for mutant in mutants))


if __name__ == "__main__":
    main()

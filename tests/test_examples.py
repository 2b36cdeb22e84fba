"""Every script under examples/ runs."""

import subprocess
import sys
from pathlib import Path

import pytest

# Examples that need what we do not install: run where it happens to be there.
NEEDS = {"learn_with_stable_baselines3": "stable_baselines3"}
FOLDER = Path(__file__).resolve().parent.parent / "examples"


@pytest.mark.parametrize("script", sorted(FOLDER.glob("*.py")), ids=lambda path: path.stem)
def test_example_runs(script, tmp_path):
    if script.stem in NEEDS:
        pytest.importorskip(NEEDS[script.stem])
    done = subprocess.run(
        [sys.executable, "-W", "error", script], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") >= 3

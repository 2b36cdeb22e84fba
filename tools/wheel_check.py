"""Build the wheel, install it into an empty environment and drive with it from another folder.

    python tools/wheel_check.py            # dependencies lent by this environment
    python tools/wheel_check.py --alone    # dependencies downloaded, as by a user's `pip install`

Every file of the package but its byte code must be in the wheel; nothing is imported from the source tree.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import sysconfig
import tempfile
import venv
from collections.abc import Sequence
from pathlib import Path
from zipfile import ZipFile

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "metropilot"
RUN = ("yizhuang", "RJ", "WYJ", "--time", "101")
# What a user does first; each must end with its exit code, and say so on the output.
COMMANDS = (
    (("lines", "--json"), 0),
    (("drivers", "--json"), 0),
    (
        (
            "drive",
            "yizhuang",
            "RJ",
            "WYJ",
            "--time",
            "101",
            "--driver",
            "optimal",
            "--out",
            "first",
            "--json",
        ),
        0,
    ),
    (("drive", "--from", "first/run.toml", "--json"), 0),
    (("drive", *RUN, "--driver", "ppo", "--json"), 0),
    (("convoy", *RUN[:-1], "110", "--trainsets", "2", "--json"), 0),
    (("studies", "--json"), 0),
    (("drive", "nowhere", "A", "B", "--json"), 2),
)


def run_clean(command: Sequence[object], folder: Path, code: int = 0) -> str:
    """Run a command without anything of this environment in its way.

    Raises:
        SystemExit: It ended otherwise.
    """
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV", "METROPILOT"))}
    told = {**kept, "METROPILOT_HOME": str(folder / "home"), "JAX_PLATFORMS": "cpu"}
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=folder, env=told, capture_output=True, text=True, check=False)
    if done.returncode != code or "Traceback" in done.stderr:
        raise SystemExit(
            f"{' '.join(words)}: exit {done.returncode}\n{done.stdout[-1000:]}\n{done.stderr[-3000:]}"
        )
    return done.stdout


def build(folder: Path) -> Path:
    """The wheel, built from the source tree, with every file of the package in it."""
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    run_clean([*pip, "wheel", "--no-deps", "--wheel-dir", folder / "dist", ROOT], folder)
    (wheel,) = (folder / "dist").glob("*.whl")
    wanted = {
        f"metropilot/{path.relative_to(PACKAGE).as_posix()}"
        for path in PACKAGE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    with ZipFile(wheel) as archive:
        found = set(archive.namelist())
    if missing := sorted(wanted - found):
        raise SystemExit(f"not in the wheel: {', '.join(missing[:10])}")
    strange = [name for name in found if not name.startswith(("metropilot/", "metropilot-"))]
    if strange:
        raise SystemExit(f"does not belong into the wheel: {', '.join(strange[:10])}")
    return wheel


def install(wheel: Path, folder: Path, *, alone: bool) -> Path:
    """Folder of the environment's programs, the wheel installed, its dependencies lent or downloaded."""
    place = folder / "env"
    venv.create(place, with_pip=True)
    programs = place / "bin"
    pip = [programs / "python", "-m", "pip", "--quiet", "--disable-pip-version-check", "install"]
    if alone:
        run_clean([*pip, "--constraint", ROOT / "constraints.txt", wheel], folder)
    else:
        run_clean([*pip, "--no-deps", wheel], folder)
        site = run_clean(
            [programs / "python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], folder
        )
        Path(site.strip(), "lent.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return programs


def main() -> None:
    """Build, install, drive."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--alone", action="store_true", help="download the dependencies")
    told = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="metropilot-wheel-") as name:
        folder = Path(name)
        programs = install(build(folder), folder, alone=told.alone)
        where = run_clean(
            [programs / "python", "-c", "import metropilot; print(metropilot.__file__)"], folder
        )
        if not Path(where.strip()).is_relative_to(folder):
            raise SystemExit(f"not what was installed: {where}")
        for arguments, code in COMMANDS:
            answer = json.loads(run_clean([programs / "metropilot", *arguments], folder, code))
            print(f"metropilot {' '.join(arguments)}: exit {code}, {len(answer)} entries", flush=True)
        picture = folder / "first" / "profile.png"
        if not picture.stat().st_size:
            raise SystemExit("the picture of the drive is empty")
    print("the wheel drives by itself")


if __name__ == "__main__":
    main()

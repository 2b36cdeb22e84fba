"""The folder a run leaves behind, and how it gets there without losing an earlier one."""

from __future__ import annotations

import json
import math
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from platform import python_version
from subprocess import DEVNULL, SubprocessError, run
from typing import Any

from metropilot.errors import InputError
from metropilot.evaluate.compare import Entry
from metropilot.evaluate.kpis import Kpis
from metropilot.evaluate.optimum import Optimum
from metropilot.evaluate.request import Request
from metropilot.evaluate.request_file import FILES, POLICY, is_file, to_table
from metropilot.policy.loaded import policy_path
from metropilot.sim.rollout import Drive

PACKAGES = ("clarabel", "numpy", "scipy", "matplotlib", "jax")


@contextmanager
def filled(folder: Path) -> Iterator[Path]:
    """A scratch folder whose files move into ``folder`` together, once all of them are written.

    The files are written beside their destination and renamed over it one by one, so that an earlier result
    is whole until a new one is, whatever goes wrong while drawing or writing.

    Raises:
        InputError: The folder cannot be made or written.
    """
    scratch = None
    try:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            scratch = Path(tempfile.mkdtemp(prefix=".metropilot-", dir=folder))
        except OSError as error:
            raise InputError(
                "cannot write to the folder", file=folder, field="out", value=error.strerror
            ) from None
        try:
            yield scratch
            for path in sorted(scratch.iterdir(), key=lambda p: p.name == "run.toml"):
                path.replace(folder / path.name)
        except OSError as error:
            place = error.filename2 or error.filename or folder
            raise InputError("cannot write the file", file=place, value=error.strerror) from None
    finally:
        if scratch is not None:
            shutil.rmtree(scratch, ignore_errors=True)


def check_writable(folder: Path) -> None:
    """Find out before a long computation whether its results can be written.

    Raises:
        InputError: The folder cannot be made or written.
    """
    with filled(folder):
        pass


def write_run(folder: Path, request: Request, drive: Drive, kpis: Kpis, optimum: Optimum | None) -> None:
    """Write `trajectory.csv`, `kpis.json`, `profile.svg`, `profile.png` and `run.toml`.

    Args:
        folder: Where to; made if it is not there.
        request: What was asked for.
        drive: What came of it.
        kpis: Its KPIs.
        optimum: The plan it is compared with.

    Raises:
        InputError: The folder cannot be made or written.
    """
    from metropilot.evaluate.picture import profile_figure
    from metropilot.evaluate.style import save

    with filled(folder) as scratch:
        drive.trajectory.write(scratch / "trajectory.csv")
        write_json(scratch / "kpis.json", kpis.as_dict())
        save(profile_figure(drive, kpis, optimum), scratch / "profile")
        write_run_toml(scratch, request)


def write_comparison(folder: Path, request: Request, entries: Sequence[Entry]) -> None:
    """Write `comparison.json`, `comparison.svg`, `comparison.png` and `run.toml` of the first driver.

    Args:
        folder: Where to; made if it is not there.
        request: What was asked for.
        entries: What came of it.

    Raises:
        InputError: The folder cannot be made or written.
    """
    from metropilot.evaluate.gallery import comparison_figure
    from metropilot.evaluate.style import save

    with filled(folder) as scratch:
        write_json(scratch / "comparison.json", comparison_json(request, entries))
        save(comparison_figure(entries), scratch / "comparison")
        write_run_toml(scratch, request)


def comparison_json(request: Request, entries: Sequence[Entry]) -> dict[str, Any]:
    """A comparison as plain values: per driver every seed's KPIs, and mean and interval of each number."""
    first = entries[0].kpis[0].as_dict()
    names = [
        key
        for key, value in first.items()
        if isinstance(value, int | float | None) and not isinstance(value, bool)
    ]
    drivers = []
    for entry in entries:
        spread = {name: found._asdict() if (found := entry.interval(name)) else None for name in names}
        runs = [{"seed": d.run.seed, **k.as_dict()} for d, k in zip(entry.drives, entry.kpis, strict=True)]
        drivers.append({"driver": entry.driver, "successes": entry.successes, "kpis": spread, "runs": runs})
    return {"run": to_table(request.resolved()), "drivers": drivers}


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write a JSON object; a number that is not finite becomes null."""
    path.write_text(to_json(values) + "\n", encoding="utf-8")


def to_json(values: object) -> str:
    """JSON text that can be written as UTF-8; a number that is not finite becomes null."""

    def plain(value: object) -> object:
        if isinstance(value, Mapping):
            return {str(key): plain(item) for key, item in value.items()}
        if isinstance(value, list | tuple):
            return [plain(item) for item in value]
        return None if isinstance(value, float) and not math.isfinite(value) else value

    text = json.dumps(plain(values), indent=2, ensure_ascii=False, allow_nan=False)
    return text.encode(errors="backslashreplace").decode()


def write_run_toml(folder: Path, request: Request) -> None:
    """Write `run.toml` and, beside it, the line, trainset and policy files it was read from."""
    import tomli_w

    table = {"run": to_table(carried(folder, request.resolved())), "made_with": provenance()}
    head = "# Drive it again: metropilot drive --from run.toml\n\n"
    (folder / "run.toml").write_text(head + tomli_w.dumps(table), encoding="utf-8")


def carried(folder: Path, request: Request) -> Request:
    """The same request with the line, trainset and policy files copied into a folder and named there."""
    for kind in FILES:
        source = Path(getattr(request, kind))
        if is_file(source.name):
            name = f"{kind}{source.suffix.lower()}"
            shutil.copyfile(source, folder / name)
            request = replace(request, **{kind: name})
    if request.options.get(POLICY):
        source = policy_path(request.options[POLICY])
        shutil.copyfile(source, folder / source.name)
        request = replace(request, options={**request.options, POLICY: source.name})
    return request


def provenance() -> dict[str, str]:
    """Versions of metropilot, Python and what numbers depend on, and the commit where there is one."""
    found = {"metropilot": _version("metropilot"), "python": python_version()}
    found |= {name: _version(name) for name in PACKAGES}
    if commit := _commit():
        found["commit"] = commit
    return {name: text for name, text in found.items() if text}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _commit() -> str:
    """The commit of the source checkout, with ``+`` when files differ from it; empty outside a checkout."""
    root = Path(__file__).resolve().parents[3]
    if not (root / ".git").exists():
        return ""
    try:
        git = ["git", "-C", str(root)]
        said = run(
            [*git, "describe", "--always", "--abbrev=40", "--dirty=+", "--exclude=*"],
            capture_output=True,
            text=True,
            stdin=DEVNULL,
            check=True,
            timeout=5,
        )
    except (OSError, SubprocessError):
        return ""
    return said.stdout.strip()

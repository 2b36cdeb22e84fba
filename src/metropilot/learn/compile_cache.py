"""Compiled programs kept in the user's cache folder, so that learning again does not compile again.

A program of another JAX, another compiler or another processor is never taken: the folder's name says what it
was made by. ``METROPILOT_COMPILE_CACHE=0`` switches the cache off; any other value is the folder to use.
"""

from __future__ import annotations

import hashlib
import os
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

from metropilot._dirs import cache_folder

SWITCH = "METROPILOT_COMPILE_CACHE"
OFF = frozenset({"0", "off", "no", "false"})
LEAST_SECONDS = 0.3
"""Programs that compile faster than this are not worth a file."""
MOST_BYTES = 1 << 30
"""The least recently used programs go when the folder gets larger."""


@cache
def keep_compiled() -> Path | None:
    """Have JAX keep compiled programs from now on; a folder that somebody has already chosen is left.

    Returns:
        The folder; None where the cache is switched off or cannot be written.
    """
    import jax

    setting = os.environ.get(SWITCH, "")
    if setting.lower() in OFF - {""}:
        return None
    chosen = jax.config.values["jax_compilation_cache_dir"]
    if chosen:
        return Path(chosen)
    folder = (Path(setting) if setting else cache_folder() / "compiled") / compiler_id()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", LEAST_SECONDS)
    trim_cache(folder)
    return folder


def trim_cache(folder: Path) -> None:
    """Delete the files that were not used for longest until the folder is small enough."""
    try:
        found = [(path, path.stat()) for path in folder.iterdir() if path.is_file()]
        size = sum(stat.st_size for _, stat in found)
        for path, stat in sorted(found, key=lambda item: max(item[1].st_atime, item[1].st_mtime)):
            if size <= MOST_BYTES:
                return
            path.unlink(missing_ok=True)
            size -= stat.st_size
    except OSError:
        return


def compiler_id() -> str:
    """Folder name for compiled programs, of all they depend on: versions, processor, compiler flags."""
    flags = "\n".join([_processor(), os.environ.get("XLA_FLAGS", ""), platform.machine()])
    digest = hashlib.sha256(flags.encode()).hexdigest()[:12]
    return f"jax-{version('jax')}-jaxlib-{version('jaxlib')}-{digest}"


def _processor() -> str:
    """Model and instruction sets of the processor."""
    path = Path("/proc/cpuinfo")
    lines = path.read_text().splitlines() if path.exists() else [platform.processor()]
    kept = ("model name", "flags", "Features", "CPU part")
    return "\n".join(sorted({line for line in lines if not path.exists() or line.startswith(kept)}))

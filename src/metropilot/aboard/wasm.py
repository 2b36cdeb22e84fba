"""WebAssembly of a generated source: module, JavaScript door, and a page that needs no server."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from base64 import b64encode
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from metropilot.errors import InputError

OPTIONS = ("-target", "wasm32-wasi", "-mexec-model=reactor", "-std=c99", "-O2", "-ffp-contract=off")
"""Options of zig: a module without imports, its functions those of the door."""


def find_zig() -> tuple[str, ...]:
    """Command of zig's C compiler: of the path, or of the package ziglang.

    Raises:
        InputError: There is neither.
    """
    if shutil.which("zig"):
        return ("zig", "cc")
    if find_spec("ziglang"):
        return (sys.executable, "-m", "ziglang", "cc")
    raise InputError(
        "needs a compiler for WebAssembly", field="to", value="wasm", allowed="pip install ziglang"
    )


def compile_wasm(folder: Path, name: str, compiler: Sequence[str]) -> None:
    """Compile the sources of a folder and put module and door into the page ``NAME.html``.

    Args:
        folder: Folder with the texts of :func:`metropilot.aboard.source.driver_texts`, door included.
        name: Name of the driver's files.
        compiler: Command of the compiler.

    Raises:
        InputError: The compiler refuses the sources.
    """
    sources = (f"{name}.c", "plant.c", "door.c")
    command = [*compiler, *OPTIONS, *sources, "-Wl,--strip-all", "-o", f"{name}.wasm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    if done.returncode:
        raise InputError("the compiler refuses the source", file=folder / sources[0], value=done.stderr[:200])
    module = b64encode((folder / f"{name}.wasm").read_bytes()).decode()
    door = (folder / "door.mjs").rename(folder / f"{name}.mjs").read_text(encoding="utf-8")
    page = folder / "drive.html"
    # in the page there is nothing to export to
    inside = {"DOOR": re.sub(r"^export ", "", door, flags=re.MULTILINE), "WASM": module}
    text = re.sub("@(DOOR|WASM)@", lambda match: inside[match[1]], page.read_text(encoding="utf-8"))
    page.rename(folder / f"{name}.html").write_text(text, encoding="utf-8")

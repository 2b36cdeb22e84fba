"""Many commands in one program that stays: `metropilot` lines as a user types them, without a start each.

A start takes a second and more (imports, JAX, first compilation), and tests and documentation have some 150
command lines. Functions are not type-checked here, as in a user's program. What is about the process itself
(signals, exit of the interpreter, its environment) is tested with programs of their own.
"""

import atexit
import io
import json
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from pathlib import Path
from typing import NamedTuple


class Said(NamedTuple):
    """Answer of a command."""

    code: int
    out: str
    err: str


def answer(arguments):
    """Run one command in this process."""
    from metropilot.cli import main

    streams = [io.TextIOWrapper(io.BytesIO(), "utf-8", write_through=True) for _ in range(2)]
    with redirect_stdout(streams[0]), redirect_stderr(streams[1]):
        try:
            main(arguments)
        except SystemExit as stop:
            code = stop.code or 0
    return Said(code, *(stream.buffer.getvalue().decode() for stream in streams))


def run(*arguments, cwd, columns=None):
    """Run one command in the program that stays.

    Args:
        arguments: Words after `metropilot`.
        cwd: Its working folder.
        columns: Width of its output; None: as of one that is no terminal.
    """
    process = _program()
    asked = {"arguments": [*map(str, arguments)], "cwd": str(cwd), "columns": columns}
    process.stdin.write(json.dumps(asked) + "\n")
    process.stdin.flush()
    line = process.stdout.readline()
    assert line, f"the program ended at {asked}"
    return Said(*json.loads(line))


@cache
def _program():
    environment = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    command, pipe = [sys.executable, Path(__file__)], subprocess.PIPE
    process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment)
    atexit.register(process.communicate)
    return process


def serve():
    """Answer the commands that come on standard input, one a line."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what a library writes past Python's streams must not stand among the answers
    for line in sys.stdin:
        asked = json.loads(line)
        os.chdir(asked["cwd"])
        os.environ.pop("COLUMNS", None)
        if asked["columns"]:
            os.environ["COLUMNS"] = str(asked["columns"])
        answers.write(json.dumps(answer(asked["arguments"])) + "\n")
        answers.flush()
        os.chdir("/")  # the folder may go


if __name__ == "__main__":
    serve()

"""A list of commands, one after the other, by somebody whom permissions bind: for test_read_only.py.

Root writes anywhere; before it begins, this program gives up the two rights that let it.
"""

import ctypes
import io
import json
import os
import sys
from contextlib import redirect_stderr, redirect_stdout

PR_CAPBSET_DROP, CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH = 24, 1, 2


def obey():
    """Begin this program again without those rights."""
    if os.geteuid() != 0 or os.environ.get("OBEYS"):
        return
    prctl = ctypes.CDLL(None, use_errno=True).prctl
    for right in (CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH):
        if prctl(PR_CAPBSET_DROP, right, 0, 0, 0):
            sys.exit(f"rights cannot be given up: {os.strerror(ctypes.get_errno())}")
    os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, "OBEYS": "1"})


def answers(commands):
    """Exit code and error stream of each."""
    from metropilot.cli import main

    for command in commands:
        code, err = None, io.StringIO()
        with redirect_stderr(err), redirect_stdout(io.StringIO()):
            try:
                main(command)
            except SystemExit as stop:
                code = stop.code or 0
        yield {"code": code, "err": err.getvalue()}


if __name__ == "__main__":
    obey()
    json.dump(list(answers(json.loads(sys.stdin.read()))), sys.stdout)

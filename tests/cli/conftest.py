"""The command line in this process and as a user's program."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests import commands
from tests.commands import Said

from metropilot.cli import main

# As wide as an output that is no terminal, whatever runs the tests says.
os.environ.pop("COLUMNS", None)


@pytest.fixture
def metropilot(capsys):
    """Run one command in this process (faster than a program of its own)."""

    def run(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main([str(a) for a in arguments])
        return Said(stop.value.code or 0, *capsys.readouterr())

    return run


@pytest.fixture
def program(tmp_path):
    """Run one command as a program, as a user does."""

    def run(*arguments, **more):
        command = [Path(sys.executable).with_name("metropilot"), *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, **more)
        return Said(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture
def typed(tmp_path):
    """Run one command as a user types it, in the program that stays."""

    def run(*arguments, **more):
        return commands.run(*arguments, cwd=tmp_path, **more)

    return run

"""Every learning process has a core of its own, as long as there are some."""

import os
import subprocess
import sys

import pytest

CODE = """
import os, sys
from metropilot._processes import own_core
print(own_core(), sorted(os.sched_getaffinity(0)), flush=True)
sys.stdin.read()
"""


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be chosen here")
def test_no_two_processes_share_a_core(tmp_path):
    before = sorted(os.sched_getaffinity(0))
    environment = os.environ | {"METROPILOT_HOME": str(tmp_path)}
    command = [sys.executable, "-c", CODE]

    def start():
        pipe = subprocess.PIPE
        process = subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True)
        return process, process.stdout.readline().strip()

    some = [start() for _ in range(min(len(before), 2))]
    try:
        assert [said for _, said in some] == [f"{core} [{core}]" for core in before[:2]]
        some[0][0].communicate()
        again, said = start()
        some.append((again, said))
        assert said == f"{before[0]} [{before[0]}]", "a core is free again when its process has ended"
        if len(before) == 2:
            some.append(start())
            assert some[-1][1] == f"None {before}"
    finally:
        for process, _ in some:
            process.kill()
            process.communicate()

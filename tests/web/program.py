"""A server for the tests of a process: the program a user starts, on a free port, with its own data."""

import re
import subprocess
import sys
import time
from pathlib import Path

import httpx

PROGRAM = Path(sys.executable).with_name("metropilot")


class Server:
    """`metropilot serve` as a program."""

    def __init__(self, data, *more):
        self.data = data
        command = [PROGRAM, "serve", "--port", "0", "--data", data, *map(str, more)]
        self.log = (data / "server.log").open("w+")
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=self.log, text=True)
        line = self.process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+", line)
        assert found, (line, (data / "server.log").read_text())
        self.url = found[0]
        self.client = httpx.Client(base_url=self.url, timeout=120.0)
        for _ in range(200):
            try:
                self.client.get("/api/health")
                break
            except httpx.TransportError:
                assert self.process.poll() is None, (data / "server.log").read_text()
                time.sleep(0.1)

    def get(self, path, code=200, **more):
        answer = self.client.get(path, **more)
        assert answer.status_code == code, answer.text
        return answer.json()

    def post(self, path, body=None, code=200):
        answer = self.client.post(path, json=body)
        assert answer.status_code == code, answer.text
        return answer.json()

    def wait(self, job, *, until=("done",), seconds=240):
        """Until a job has come so far."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            row = self.get(f"/api/jobs/{job}")
            if row["status"] in until:
                return row
            assert row["status"] in {"queued", "running"}, row
            time.sleep(0.1)
        raise AssertionError(row)

    def kill(self):
        """As if the power went."""
        self.process.kill()
        self.close()

    def close(self):
        self.client.close()
        self.process.terminate()
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
        self.process.stdout.close()
        self.log.close()

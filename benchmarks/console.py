"""The console under viewers: ``python -m benchmarks.console [--viewers 50] [--pace 1] [--seconds 30]``.

Starts the server as a program, a live run on it, and so many viewers who read the stream in another process,
one of them so slow that it hardly reads at all. Says how far the run fell behind its clock, and how late rows
came to the viewers after the first of them saw them.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from urllib.request import Request, urlopen

import numpy as np

RUN = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101.0}


def ask(url: str, body: dict[str, object] | None = None) -> dict[str, object]:
    """A call of the API."""
    data = None if body is None else json.dumps(body).encode()
    request = Request(url, data, {"Content-Type": "application/json"})
    with urlopen(request, timeout=60) as answer:
        return json.load(answer)


async def watch(
    host: str, port: int, live: str, until: float, *, slow: bool = False
) -> list[tuple[int, float]]:
    """The steps a viewer saw, and when it saw them."""
    limit = 1 << 12 if slow else 1 << 20
    reader, writer = await asyncio.open_connection(host, port, limit=limit)
    writer.write(f"GET /api/live/{live}/stream HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
    seen, rest = [], b""
    while (left := until - time.monotonic()) > 0:
        try:
            chunk = await asyncio.wait_for(reader.read(256 if slow else 1 << 16), left)
        except TimeoutError:
            break
        if not chunk:
            break
        if slow:
            await asyncio.sleep(0.5)
            continue
        *lines, rest = (rest + chunk).split(b"\n")
        now = time.monotonic()
        seen += [(json.loads(t[6:])["rows"][-1][-1], now) for t in lines if t.startswith(b'data: {"rows":[[')]
    writer.close()
    return seen


async def viewers(url: str, live: str, count: int, seconds: float) -> list[list[tuple[int, float]]]:
    """All of them at once."""
    host, port = url.removeprefix("http://").split(":")
    until = time.monotonic() + seconds
    watching = [watch(host, int(port), live, until, slow=0 < k == count - 1) for k in range(count)]
    return await asyncio.gather(*watching)


def measure(url: str, server: int, count: int, pace: float, seconds: float) -> dict[str, object]:
    """One live run under so many viewers."""
    live = str(ask(f"{url}/api/live", {**RUN, "pace": pace})["id"])
    began = cpu_s(server)
    seen = asyncio.run(viewers(url, live, count, seconds))[: count - 1 or 1]
    used = cpu_s(server) - began
    known = ask(f"{url}/api/live/{live}")
    if known["status"] == "running":
        ask(f"{url}/api/live/{live}/stop", {})
    first: dict[int, float] = {}
    for step, at in (item for viewer in seen for item in viewer):
        first[step] = min(first.get(step, at), at)
    late = np.array([at - first[step] for viewer in seen for step, at in viewer if step != min(first)])
    steps = sorted(first)[1:]
    clock = np.array([first[s] for s in steps])
    drift = (clock - clock[0]) - (np.array(steps) - steps[0]) * 0.2 / pace
    return {
        "viewers": count,
        "pace": pace,
        "seconds": seconds,
        "rows": len(steps),
        "behind_at_end_s": known["behind_s"],
        "drift_s_worst": round(float(drift.max()), 3),
        "drift_s_median": round(float(np.median(drift)), 3),
        "late_s_median": round(float(np.median(late)), 4),
        "late_s_99_percent": round(float(np.quantile(late, 0.99)), 4),
        "server_core_share": round(used / seconds, 3),
        "load_average": os.getloadavg()[0],
    }


def cpu_s(process: int) -> float:
    """Processor time of a process so far (Linux)."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--viewers", type=int, default=50)
    parser.add_argument("--pace", type=float, default=1.0)
    parser.add_argument("--seconds", type=float, default=30.0)
    given = parser.parse_args()
    program = [Path(sys.executable).with_name("metropilot"), "serve", "--port", "0"]
    with tempfile.TemporaryDirectory() as data:
        server = subprocess.Popen([*program, "--data", data], stdout=subprocess.PIPE, text=True)
        try:
            url = re.search(r"http://[\d.:]+", server.stdout.readline() if server.stdout else "")
            if url is None:
                sys.exit("the server did not start")
            for _ in range(300):
                try:
                    ask(f"{url[0]}/api/health")
                    break
                except OSError:
                    time.sleep(0.1)
            for count in (1, given.viewers):
                print(json.dumps(measure(url[0], server.pid, count, given.pace, given.seconds)), flush=True)
        finally:
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()

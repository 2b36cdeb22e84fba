"""Drive, compare and download over HTTP with the typed client.

python examples/drive_over_http.py [URL]; without the address of a server it starts one for itself.
"""

import re
import subprocess
import sys
import tempfile
import time
import urllib.error
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from client.metropilot_client import ApiError, Client, CompareIn, DriveIn, PlantPlanIn

PLAN: PlantPlanIn = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101.0}


@contextmanager
def serve() -> Iterator[str]:
    program = Path(sys.executable).with_name("metropilot")
    with tempfile.TemporaryDirectory() as data:
        command = [program, "serve", "--port", "0", "--data", data]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        with server:
            try:
                assert server.stdout is not None
                found = re.search(r"http://[\d.:]+", server.stdout.readline())
                assert found is not None
                yield found[0]
            finally:
                server.terminate()


def connect(url: str) -> Client:
    client = Client(url)
    for _ in range(1200):
        try:
            client.server.health()
            break
        except urllib.error.URLError:
            time.sleep(0.1)
    return client


def work(client: Client) -> None:
    plan = client.planning.plan(PLAN)
    print(f"optimal: {plan['energy_j'] / 3.6e6:.2f} kWh, next second saves {plan['second_w'] / 1000:.0f} kJ")

    run: DriveIn = {**PLAN, "driver": "optimal", "mass_factor": 1.1}
    job = client.wait(client.jobs.drive(run)["id"])
    driven = client.jobs.drive_result(job["id"])
    print(f"{driven['driver']}: {driven['kpis']['energy_wheel_kwh']:.2f} kWh, success {driven['success']}")

    compared: CompareIn = {**PLAN, "drivers": ["optimal", "manual", "flat_out"]}
    job = client.wait(client.jobs.compare(compared)["id"])
    for entry in client.jobs.compare_result(job["id"])["entries"]:
        energy = entry["kpis"]["energy_wheel_kwh"]
        print(f"  {entry['driver']:9} {entry['successes']} of {entry['seeds']}", end="")
        print(f"  {energy['mean']:.2f} kWh" if energy is not None else "")

    picture = Path("comparison.png")
    picture.write_bytes(client.jobs.file(job["id"], picture.name))
    print(f"{picture}: {picture.stat().st_size} bytes")

    try:
        client.planning.plan({**PLAN, "time_s": 50.0})
    except ApiError as error:
        print(f"refused: {error}")


def main() -> None:
    if len(sys.argv) > 1:
        work(connect(sys.argv[1]))
        return
    with serve() as url:
        work(connect(url))


if __name__ == "__main__":
    main()

"""The console in use: pages, edits, viewers of a live run, a large project, ten users at work.

``python -m benchmarks.console [--minutes 10] [--write docs/benchmarks.md]``

The server is started as a program with a folder of its own. The pages are timed in headless Chromium, the
viewers read the stream of a live run in another process (one so slow that it hardly reads at all), the users
write and read over HTTP with a token each.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from benchmarks.report import Benchmark, Row, run

RUN = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101.0}
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
VIEWERS, PACE, WATCHED_S = 50, 2.0, 30.0
"""Viewers of a live run, its pace (10 rows a second) and how long they watch."""
RUNS, RUN_BYTES = 200, 100_000
"""Runs of the large project, and the result of each."""
USERS = 10
VISITS, EDITS = 5, 15
MINUTES = {"at work": 10.0}


# ------------------------------------------------------------------------------------------------ server
@contextmanager
def console(folder: Path) -> Iterator[tuple[str, int, list[str]]]:
    """A server with named users; its address, process and their tokens."""
    tokens = [f"{k:020d}" for k in range(USERS)]
    users = folder / "users.txt"
    users.write_text("".join(f"user{k} = {token}, user\n" for k, token in enumerate(tokens)))
    program = [Path(sys.executable).with_name("metropilot"), "serve", "--port", "0", "--data", folder]
    command = [*program, "--users", users, "--user-jobs", "1000"]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        found = re.search(r"http://[\d.:]+", server.stdout.readline() if server.stdout else "")
        if found is None:
            sys.exit("the server did not start")
        for _ in range(300):
            try:
                client(found[0], tokens[0]).get("/api/health")
                break
            except httpx.TransportError:
                time.sleep(0.1)
        yield found[0], server.pid, tokens
    finally:
        server.terminate()
        server.wait()


def client(url: str, token: str) -> httpx.Client:
    """A program of a user."""
    return httpx.Client(base_url=url, headers={"Authorization": f"Bearer {token}"}, timeout=120.0)


def resident_mb(process: int) -> float:
    """Memory of a process and those that it started (Linux)."""
    children: dict[int, list[int]] = {}
    pages: dict[int, int] = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            pages[int(entry.name)] = int((entry / "statm").read_text().split()[1])
        except (OSError, IndexError):
            continue
        children.setdefault(int(fields[1]), []).append(int(entry.name))
    todo, total = [process], 0
    while todo:
        at = todo.pop()
        total += pages.get(at, 0)
        todo += children.get(at, [])
    return total * os.sysconf("SC_PAGE_SIZE") / 1e6


# ------------------------------------------------------------------------------------------------ pages
EFFECT = """() => {
  const plan = () => {
    const plot = document.querySelector('[data-test=live] .js-plotly-plot');
    return JSON.stringify(plot.data?.[2].y);
  };
  window.effects = [];
  document.addEventListener('keydown', () => {
    const began = performance.now(), before = plan();
    const look = () => {
      if (plan() === before) requestAnimationFrame(look);
      else window.effects.push(performance.now() - began);
    };
    requestAnimationFrame(look);
  }, true);
}"""
"""Time from a key on the slider of the running time to another plan on the plot, frame by frame."""


def browse(url: str, token: str, project: str) -> dict[str, list[float]]:
    """Times of pages in a browser, s: first page, large project, and the effect of an edit."""
    from playwright.sync_api import sync_playwright

    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        sys.exit("no browser on this machine: install Debian's chromium")
    found: dict[str, list[float]] = {"first": [], "project": [], "edit": []}
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        for visit in range(VISITS):
            context = browser.new_context(viewport={"width": 1440, "height": 900})
            page = context.new_page()
            context.add_cookies([{"name": "metropilot_token", "value": token, "url": url}])
            began = time.perf_counter()
            page.goto(url)
            page.locator('[data-test="depart"]').wait_for()
            page.get_by_text("minimum 83.3 s").wait_for()
            found["first"].append(time.perf_counter() - began)
            drawn = "document.querySelector('[data-test=live] .js-plotly-plot')?.data?.[2].y.length > 50"
            page.wait_for_function(drawn)
            if visit == 0:
                found["edit"] = edit(page)
            began = time.perf_counter()
            page.goto(f"{url}/runs?project={project}")
            rows = f"document.querySelectorAll('[aria-label=Runs] tbody tr').length >= {RUNS}"
            page.wait_for_function(rows)
            found["project"].append(time.perf_counter() - began)
            context.close()
        browser.close()
    return found


def edit(page: Any) -> list[float]:  # noqa: ANN401 (a page of Playwright)
    """Times from a key on the slider to the new plan, s."""
    page.wait_for_timeout(2000)
    page.evaluate(EFFECT)
    page.locator(".q-slider").first.locator(".q-slider__thumb, [tabindex]").first.focus()
    for k in range(EDITS):
        page.keyboard.press("ArrowRight")
        page.wait_for_function(f"window.effects.length > {k}")
        page.wait_for_timeout(200)
    return [each / 1000.0 for each in page.evaluate("window.effects")]


def fill_project(folder: Path) -> str:
    """A project of many runs with large results; return its id. The server is not there yet."""
    from metropilot.web import Service, Settings

    store = Service(Settings(data=folder)).store
    project = store.new_project("Large").id
    padding = [round(k * 0.1234, 4) for k in range(RUN_BYTES // 9)]
    for k in range(RUNS):
        job = store.new_job("drive", {**RUN, "time_s": 100.0 + k, "driver": "optimal", "options": {}})
        kpis = {"outcome": "arrived", "running_time_s": 101.0, "energy_wheel_kwh": 14.0 + 0.01 * k}
        result = {"kpis": kpis | {"optimality_gap_percent": 1.0}, "success": True, "speed_mps": padding}
        store.update(job, status="done", progress=1.0, result=result)
        store.set_project(job, project)
    return project


# ------------------------------------------------------------------------------------------------ viewers
async def watch(
    url: str, token: str, live: str, until: float, *, slow: bool = False
) -> list[tuple[int, float]]:
    """The steps a viewer saw, and when it saw them."""
    host, port = url.removeprefix("http://").split(":")
    limit = 1 << 12 if slow else 1 << 20
    reader, writer = await asyncio.open_connection(host, int(port), limit=limit)
    head = f"GET /api/live/{live}/stream HTTP/1.1\r\nHost: {host}:{port}\r\n"
    head += f"Authorization: Bearer {token}\r\n\r\n"
    writer.write(head.encode())
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


def look_on(url: str, token: str) -> dict[str, float]:
    """Delay of rows at each of the viewers after the first of them saw them, s, and their rate, Hz."""
    with client(url, token) as api:
        live = api.post("/api/live", json={**RUN, "pace": PACE}).json()["id"]

        async def every() -> list[list[tuple[int, float]]]:
            until = time.monotonic() + WATCHED_S
            each = [watch(url, token, live, until, slow=k == VIEWERS - 1) for k in range(VIEWERS)]
            return await asyncio.gather(*each)

        seen = asyncio.run(every())[:-1]
        behind = api.get(f"/api/live/{live}").json()["behind_s"]
        api.post(f"/api/live/{live}/stop")
    first: dict[int, float] = {}
    for step, at in (item for viewer in seen for item in viewer):
        first[step] = min(first.get(step, at), at)
    late = np.array([at - first[step] for viewer in seen for step, at in viewer if step != min(first)])
    return {
        "rate": (len(first) - 1) / (max(first.values()) - min(first.values())),
        "p99": float(np.quantile(late, 0.99)),
        "behind": float(behind),
    }


# ------------------------------------------------------------------------------------------------ users
@dataclass
class Work:
    """Requests of a user, answers of 500 and more, confirmed writes, and what is lost of them."""

    requests: int = 0
    errors: int = 0
    writes: int = 0
    lost: int = 0
    times_s: list[float] = field(default_factory=list)


def work(url: str, token: str, until: float, told: Work, line: str) -> None:
    """A user at work: a project with notes, an own line in versions, drives, plans, lists."""
    with client(url, token) as api:

        def ask(method: str, path: str, **more: Any) -> httpx.Response:  # noqa: ANN401 (as httpx)
            began = time.perf_counter()
            answer = api.request(method, path, **more)
            told.times_s.append(time.perf_counter() - began)
            told.requests += 1
            told.errors += answer.status_code >= 500
            return answer

        project = ask("POST", "/api/projects", json={"name": "mine"}).json()["id"]
        upload = ask("POST", "/api/uploads", files={"file": ("line.toml", line.encode())}).json()["id"]
        notes, version, jobs = "", 1, []
        turn = 0
        while time.monotonic() < until:
            turn += 1
            notes = f"turn {turn}"
            ask("PUT", f"/api/projects/{project}", json={"name": "mine", "notes": notes}).raise_for_status()
            told.writes += 1
            if turn % 5 == 0:
                text = line + f"\n# version {version + 1}\n"
                saved = ask("PUT", f"/api/uploads/{upload}", json={"toml": text, "version": version})
                told.writes += saved.status_code == 200
                version = saved.json().get("number", version)
            if turn % 10 == 1:
                body = {**RUN, "time_s": 100.0 + turn % 40, "driver": "flat_out"}
                answer = ask("POST", "/api/jobs/drive", json=body)
                if answer.status_code == 202:
                    jobs.append(answer.json()["id"])
                    told.writes += 1
            ask("POST", "/api/plan", json=RUN)
            ask("GET", "/api/jobs?limit=50")
            ask("GET", f"/api/projects/{project}")
            time.sleep(0.2)
        told.lost += ask("GET", f"/api/projects/{project}").json()["notes"] != notes
        told.lost += len(ask("GET", f"/api/uploads/{upload}/versions").json()) != version
        told.lost += sum(ask("GET", f"/api/jobs/{job}").status_code != 200 for job in jobs)


def at_work(url: str, process: int, tokens: list[str], minutes: float) -> tuple[Work, float, float]:
    """All users at once: what they did together, memory after half of the time and at the end, MB."""
    with client(url, tokens[0]) as api:
        line = api.get("/api/lines/yizhuang/toml").text
    until = time.monotonic() + 60.0 * minutes
    each = [Work() for _ in tokens]
    threads = [
        threading.Thread(target=work, args=(url, token, until, told, line))
        for token, told in zip(tokens, each, strict=True)
    ]
    for thread in threads:
        thread.start()
    time.sleep(30.0 * minutes)
    early = resident_mb(process)
    while time.monotonic() < until - 1.0:
        time.sleep(0.5)
    late = resident_mb(process)
    for thread in threads:
        thread.join()
    whole = Work(times_s=[at for told in each for at in told.times_s])
    for name in ("requests", "errors", "writes", "lost"):
        setattr(whole, name, sum(getattr(told, name) for told in each))
    return whole, early, late


def measure() -> list[Row]:
    """All of it on one server."""
    minutes = MINUTES["at work"]
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        project = fill_project(folder)
        with console(folder) as (url, process, tokens):
            pages = browse(url, tokens[0], project)
            viewed = look_on(url, tokens[0])
            done, early, late = at_work(url, process, tokens, minutes)
    edits = sorted(pages["edit"])
    return [
        Row(
            "first page, to the section with its minimum running time",
            statistics.median(pages["first"]),
            "s",
            target="1.5 s",
        ),
        Row(
            "edit of the running time, to the plan drawn: median",
            1000.0 * statistics.median(edits),
            "ms",
            target="150 ms",
        ),
        Row("the same: slowest", 1000.0 * edits[-1], "ms"),
        Row(
            f"project of {RUNS} runs and 20 MB of results opened",
            statistics.median(pages["project"]),
            "s",
            target="1 s",
        ),
        Row(f"live run: rows a second to each of {VIEWERS} viewers", viewed["rate"], "Hz", target="10 Hz"),
        Row(
            "the same: a row after the first viewer had it, p99",
            1000.0 * viewed["p99"],
            "ms",
            target="100 ms",
        ),
        Row("the same: the run behind its clock", viewed["behind"], "s"),
        Row(f"{USERS} users, {minutes:g} min: requests", done.requests, ""),
        Row("the same: answers of 500 and more", done.errors, "", target="0"),
        Row("the same: confirmed writes", done.writes, ""),
        Row("the same: writes lost", done.lost, "", target="0"),
        Row("the same: answer, median", 1000.0 * statistics.median(done.times_s), "ms"),
        Row("the same: answer, p99", 1000.0 * float(np.quantile(done.times_s, 0.99)), "ms"),
        Row("the same: memory after half of the time", early, "MB"),
        Row("the same: memory at the end", late, "MB", late / early, "flat"),
    ]


BENCHMARK = Benchmark(
    name="console",
    title="Console",
    packages=("metropilot", "nicegui", "fastapi", "uvicorn", "playwright"),
    measure=measure,
    note="Server, browser, viewers and users on the same machine. Pages in headless Chromium, each visit "
    f"with an empty cache, median of {VISITS}; the edit is a key on the slider of the running time, {EDITS} "
    "times, until another plan is in the plot, seen from within the page. One of the viewers reads so "
    "slowly that it hardly reads at all. Each user writes notes and versions of an own line, starts drives, "
    "asks for plans and lists, with 0.2 s between the rounds; at the end every confirmed write is looked "
    "for. Memory is that of the server with its workers.",
)


if __name__ == "__main__":
    given = sys.argv[1:]
    if "--minutes" in given:
        at = given.index("--minutes")
        MINUTES["at work"] = float(given[at + 1])
        del given[at : at + 2]
    run([BENCHMARK], given)

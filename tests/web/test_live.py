"""Live runs over HTTP: watched, told news, taken over, resumed after the server died."""

import asyncio
import json
import signal
import time
from io import BytesIO
from itertools import pairwise
from zipfile import ZipFile

import pytest
from tests.web.program import Server

from metropilot.web import Settings
from metropilot.web.schemas.requests import LiveIn
from metropilot.web.service import Service

SECTION = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101}


WATCH_S = 120.0
"""Longest wait of a test for an event of a live run; the longest run takes some 40 s."""


def watch(server, live, *, until=lambda kind, data: kind == "end", after=None):
    """The events of a live run up to one; fails where it does not come in time."""
    end = time.monotonic() + WATCH_S
    headers = {} if after is None else {"Last-Event-ID": str(after)}
    seen, kind, number = [], "", 0
    with server.client.stream("GET", f"/api/live/{live}/stream", headers=headers, timeout=60) as answer:
        for line in answer.iter_lines():
            # A quiet stream sends a comment every 15 s, so that the client's timeout never fires.
            assert time.monotonic() < end, f"{live}: not seen within {WATCH_S:g} s, last {seen[-1:]}"
            name, _, value = line.partition(": ")
            if name == "id":
                number = int(value)
            elif name == "event":
                kind = value
            elif name == "data":
                data = json.loads(value)
                seen.append((number, kind, data))
                if until(kind, data):
                    return seen
    return seen


def rows(seen):
    return [row for _, kind, data in seen if kind == "rows" for row in data["rows"]]


def says_returned(kind, data):
    """True if an event says that the driver has the lever."""
    return kind == "event" and "returned to the driver" in data["words"]


def watch_for(metres):
    return lambda kind, data: kind == "rows" and any(row[1] > metres for row in data["rows"])


def pace(server, live, value):
    """While tests talk a run waits: on a busy machine talking takes long."""
    server.post(f"/api/live/{live}/pace", {"pace": value})


def test_a_live_run_is_told_news_and_arrives(server):
    live = server.post("/api/live", {**SECTION, "pace": 5}, code=201)["id"]
    seen = watch(server, live, until=watch_for(150))
    pace(server, live, 0)
    at = server.post(f"/api/live/{live}/arrival", {"scheduled_time_s": 125})["at_s"]
    assert 5 < at < 60
    server.post(f"/api/live/{live}/restriction", {"from_m": 900, "to_m": 1000, "limit_mps": 12})
    near = server.post(f"/api/live/{live}/restriction", {"from_m": 1, "to_m": 9, "limit_mps": 3}, code=422)
    assert near["error"]["field"] == "from_m"
    late = server.post(f"/api/live/{live}/arrival", {"scheduled_time_s": 1}, code=422)
    assert "passed" in late["error"]["message"]
    pace(server, live, 30)
    rest = watch(server, live, after=seen[-1][0])
    assert rest[0][0] == seen[-1][0] + 1
    words = [data["words"] for _, kind, data in rest if kind == "event"]
    assert any("new arrival time, later" in text for text in words)
    assert any("restriction" in text for text in words)
    result = next(data for _, kind, data in rest if kind == "result")
    assert result["kpis"]["outcome"] == "arrived"
    assert result["kpis"]["running_time_s"] == pytest.approx(125, abs=3)
    slow = [row[2] for row in rows(rest) if 900 < row[1] < 1000]
    assert max(slow) <= 12.0
    steps = [row[-1] for row in rows(seen) + rows(rest)]
    assert steps == list(range(1, len(steps) + 1))
    assert server.get(f"/api/jobs/{live}/drive")["kpis"]["outcome"] == "arrived"


def test_a_run_is_stepped_second_by_second(server):
    live = server.post("/api/live", {**SECTION, "pace": 5}, code=201)["id"]
    seen = watch(server, live, until=watch_for(20))
    server.post(f"/api/live/{live}/arrival", {"scheduled_time_s": 110})
    ends = [server.post(f"/api/live/{live}/step", {})["at_s"] for _ in range(3)]
    assert ends[1:] == pytest.approx([ends[0] + 1, ends[0] + 2], abs=1e-6)
    known = server.get(f"/api/live/{live}")
    assert (known["pace"], known["time_s"]) == (0, pytest.approx(ends[2]))
    pace(server, live, 100)
    rest = watch(server, live, after=seen[-1][0])
    at = [row[0] for row in rows(seen) + rows(rest)][:-1]  # the last one ends where the trainset stands
    assert [b - a for a, b in pairwise(at)] == pytest.approx([at[0]] * (len(at) - 1), abs=1e-3)
    assert rest[-1][2] == {"status": "done"}
    assert "over" in server.post(f"/api/live/{live}/step", {}, code=409)["error"]["message"]


def test_a_hand_that_lets_go_gives_the_lever_back(server):
    live = server.post("/api/live", {**SECTION, "pace": 1}, code=201)["id"]
    server.post(f"/api/live/{live}/lever", {"share": 1.0})
    given = watch(server, live, until=says_returned)
    assert any(row[5] == 1.0 for row in rows(given))
    taken, back = (data["time_s"] for _, kind, data in given if kind == "event")
    assert back - taken == pytest.approx(3.0, abs=1.0)
    server.post(f"/api/live/{live}/stop")
    assert watch(server, live)[-1][2] == {"status": "stopped"}
    assert server.post(f"/api/live/{live}/pace", {"pace": 2}, code=409)["error"]["message"]


def test_the_lever_has_one_holder(server):
    live = server.post("/api/live", {**SECTION, "pace": 0}, code=201)["id"]
    lever = f"/api/live/{live}/lever"
    server.post(lever, {"share": 0.5, "holder": "tab-1"})
    assert server.get(f"/api/live/{live}")["lever"] == {"holder": "tab-1", "since_s": 0.0}
    for body in ({"share": -1.0, "holder": "tab-2"}, {"share": None, "holder": "tab-2"}, {"share": 0.5}):
        error = server.post(lever, body, code=409)["error"]
        assert error["message"] == "the lever is held by tab-1 since 0.0 s after departure"
        assert error["field"] == "holder"
        assert "take_over" in error["allowed"]
    server.post(lever, {"share": -1.0, "holder": "tab-2", "take_over": True})
    assert server.post(lever, {"share": 0.5, "holder": "tab-1"}, code=409)["error"]["value"] == "tab-1"
    seen = watch(server, live, until=says_returned)
    assert [data["words"] for _, kind, data in seen if kind == "event"] == [
        "the lever is taken by hand by tab-1",
        "the lever is taken over from tab-1 by tab-2",
        "the lever is returned to the driver",
    ], "a run that waits takes the lever from whoever is gone as well"
    assert server.get(f"/api/live/{live}")["lever"] is None
    server.post(f"/api/live/{live}/stop")


def test_a_run_that_cannot_start_has_failed_and_says_why(server):
    slow = {"driver": "mpc", "restrictions": [{"from_m": 0, "to_m": 1200, "limit_mps": 1.4}]}
    error = server.post("/api/live", {**SECTION, **slow}, code=422)["error"]
    assert error["field"] == "time_s"
    job = server.get("/api/jobs", params={"kind": "live", "limit": 1})[0]
    assert job["status"] == "failed"
    assert job["words"] == job["error"]["message"] == error["message"]
    told = server.get(f"/api/live/{job['id']}")
    assert (told["status"], told["error"]["message"]) == ("failed", error["message"])
    assert watch(server, job["id"])[-1][2] == {"status": "failed", "message": error["message"]}
    server.post(f"/api/live/{job['id']}/resume", code=409)


def test_a_run_that_is_stopped_goes_on_where_it_was(server):
    live = server.post("/api/live", {**SECTION, "pace": 10}, code=201)["id"]
    watch(server, live, until=watch_for(100))
    server.post(f"/api/live/{live}/lever", {"share": -0.2})
    at = server.post(f"/api/jobs/{live}/stop")
    ended = watch(server, live)
    assert ended[-1][2] == {"status": "stopped"}
    at = rows(ended)[-1]
    again = server.post(f"/api/live/{live}/resume", code=201)
    assert again["status"] == "running"
    pace(server, live, 0)
    assert server.get(f"/api/live/{live}")["time_s"] == pytest.approx(at[0], abs=1.0)
    words = [data["words"] for _, kind, data in watch_now(server, live) if kind == "event"]
    assert words == ["the lever is taken by hand by api", "the lever is returned to the driver"]
    server.post(f"/api/live/{live}/stop")


def watch_now(server, live):
    """Events so far of a run that waits."""
    return watch(server, live, until=lambda kind, data: kind == "rows" and data["pace"] == 0)


def test_what_nobody_watches_is_stopped_and_can_be_resumed(tmp_path, monkeypatch):
    async def story():
        service = Service(Settings(data=tmp_path, live_runs=1))
        asked = LiveIn.model_validate({**SECTION, "pace": 0})
        left = await service.go_live(asked)
        monkeypatch.setattr("metropilot.web.service.ABANDONED_S", 0.3)
        watcher = left.listen()
        await anext(watcher)
        await asyncio.sleep(0.4)
        second = await service.go_live(asked)
        assert (second.known.status, second.known.place) == ("queued", 1), "a run that is watched stays"
        await watcher.aclose()
        await asyncio.sleep(0.4)
        assert second.waiting, "one that waits needs no viewer"
        await service.stop_abandoned()
        await second.wait_ready()
        row = service.store.job(left.id)
        assert (row.status, row.words) == ("stopped", "no viewer for 0.3 s; it can be resumed")
        assert [r.id for r in service.live_runs()] == [second.id, left.id]
        await second.stop()
        again = await service.resume_live(left.id)
        assert (again.id, again.over) == (left.id, False)
        await again.stop()
        await service.close()

    asyncio.run(story())


def test_a_run_with_pace_0_does_not_move(server):
    live = server.post("/api/live", {**SECTION, "pace": 0}, code=201)
    assert (live["status"], live["place"], live["time_s"]) == ("running", None, 0)
    time.sleep(0.3)
    assert server.get(f"/api/live/{live['id']}")["time_s"] == 0
    server.post(f"/api/live/{live['id']}/stop")
    watch(server, live["id"])


def test_runs_beyond_capacity_wait_in_a_queue_and_start_by_themselves(server):
    begun = [server.post("/api/live", {**SECTION, "pace": 0}, code=201) for _ in range(7)]
    assert [run["status"] for run in begun] == ["running"] * 4 + ["queued"] * 3
    assert [run["place"] for run in begun] == [None] * 4 + [1, 2, 3]
    lives = [run["id"] for run in begun]
    health = server.get("/api/health")
    assert (health["live_runs"], health["live_runs_waiting"]) == (4, 3)
    refused = server.post(f"/api/live/{lives[5]}/pace", {"pace": 1}, code=409)["error"]
    assert refused["message"] == "the run waits, place 2 in the queue"
    words = {row["id"]: row["words"] for row in server.get("/api/jobs?kind=live&status=queued")}
    assert words == {live: f"place {k} in the queue" for k, live in enumerate(lives[4:], 1)}
    server.post(f"/api/live/{lives[4]}/stop")  # out of the queue
    assert server.get(f"/api/jobs/{lives[4]}")["words"] == "not started"
    assert [server.get(f"/api/live/{live}")["place"] for live in lives[5:]] == [1, 2]
    server.post(f"/api/live/{lives[0]}/stop")
    seen = watch(server, lives[5], until=lambda kind, data: kind == "scene")
    assert [(kind, data) for _, kind, data in seen[:-1]] == [("place", {"place": k}) for k in (2, 1)]
    assert server.get(f"/api/live/{lives[6]}")["place"] == 1
    resumed = server.post(f"/api/live/{lives[4]}/resume", code=201)
    assert (resumed["status"], resumed["place"]) == ("queued", 2)
    for live in (lives[6], lives[4], *lives[1:4], lives[5]):
        server.post(f"/api/live/{live}/stop")
        watch(server, live)


def test_a_convoy_keeps_apart_when_its_head_brakes(server):
    asked = {**SECTION, "time_s": 120, "trainsets": 2, "pace": 10}
    live = server.post("/api/convoys", asked, code=201)["id"]
    seen = watch(server, live, until=lambda kind, data: kind == "rows" and data["rows"][-1][0] > 15)
    pace(server, live, 0)
    server.post(f"/api/live/{live}/link", {"loss": 0.5, "delay_s": 0.3})
    server.post(f"/api/live/{live}/emergency")
    assert (
        server.post(f"/api/live/{live}/arrival", {"scheduled_time_s": 500}, code=422)["error"]["field"]
        == "kind"
    )
    pace(server, live, 10)
    rest = watch(server, live, after=seen[-1][0])
    words = [data["words"] for _, kind, data in rest if kind == "event"]
    assert words == ["link: 0.3 s late, 0 s uneven, 50 % lost", "the head makes an emergency brake"]
    result = next(data for _, kind, data in rest if kind == "result")
    assert result["kpis"]["contacts"] == 0
    assert 0 < result["kpis"]["gap_min_m"] < 5.93
    rows = {row["name"]: row["passed"] for row in result["checks"]}
    assert {name for name, passed in rows.items() if not passed} == set(result["kpis"]["failed"])
    assert {"stops at the mark", "on time", "jerk", "no contact"} <= set(rows)
    assert result["success"] == all(rows.values())
    server.wait(live)
    archive = server.client.get(f"/api/jobs/{live}/files/trajectories.zip").content
    with ZipFile(BytesIO(archive)) as files:
        assert files.namelist() == ["trajectory-1.csv", "trajectory-2.csv"]
        for name in files.namelist():
            text = files.read(name).decode()
            assert text.startswith("time_s,position_m")
            assert text == server.client.get(f"/api/jobs/{live}/files/{name}").text
    server.get(f"/api/jobs/{live}/files/trajectory-3.csv", code=404)


def test_runs_survive_the_server(tmp_path):
    first = Server(tmp_path)
    live = first.post("/api/live", {**SECTION, "pace": 10}, code=201)["id"]
    watch(first, live, until=watch_for(100))
    first.post(f"/api/live/{live}/arrival", {"scheduled_time_s": 120})
    seen = watch(first, live, until=watch_for(400))
    pace(first, live, 1)
    job = first.post("/api/jobs/compare", {**SECTION, "seeds": 50}, code=202)["id"]
    others = [first.post("/api/live", {**SECTION, "pace": 0}, code=201)["id"] for _ in range(4)]
    assert first.get(f"/api/live/{others[3]}")["place"] == 1
    first.kill()
    again = Server(tmp_path)
    try:
        assert again.get(f"/api/jobs/{live}")["status"] == "interrupted"
        assert again.get(f"/api/jobs/{job}")["status"] == "interrupted"
        waited = again.get(f"/api/jobs/{others[3]}")
        assert waited["status"] == "interrupted"
        assert waited["words"] == "not started: the server was restarted; it can be resumed"
        assert not again.get(f"/api/jobs/{others[0]}")["words"].startswith("not started")
        assert again.post(f"/api/live/{others[3]}/resume", code=201)["status"] == "running"
        again.post(f"/api/live/{live}/resume", code=201)
        replayed = rows(watch(again, live))
        before = rows(seen)
        common = min(len(before), 80)
        assert [row[:4] for row in replayed[:common]] == [row[:4] for row in before[:common]]
        assert again.get(f"/api/jobs/{live}/drive")["kpis"]["running_time_s"] == pytest.approx(120, abs=3)
        assert again.post(f"/api/jobs/{job}/resume", code=202)["status"] in {"queued", "running"}
        again.post(f"/api/jobs/{job}/stop")
    finally:
        again.close()


@pytest.mark.parametrize("seconds", [0.05, 0.5])
def test_two_ctrl_c_end_a_server_as_one_does(tmp_path, seconds):
    served = Server(tmp_path)
    served.process.send_signal(signal.SIGINT)
    time.sleep(seconds)
    served.process.send_signal(signal.SIGINT)
    assert served.process.wait(20) == 0
    assert "Traceback" not in (tmp_path / "server.log").read_text()
    served.close()

"""The list of jobs: find, sort, name, compare two, delete; a journey that is kept; a folder of before."""

import json
import sqlite3

import pytest
from tests.web.test_api import SECTION, refusal_of

from metropilot.web.store import JobStore


@pytest.fixture(scope="module")
def driven(server):
    """Two drives of one section, by manual driving and flat out."""
    bodies = [{**SECTION, "time_s": 101, "driver": name} for name in ("manual", "flat_out")]
    found = [server.post("/api/jobs/drive", body, code=202)["id"] for body in bodies]
    for job in found:
        server.wait(job)
    return found


def test_jobs_are_found_sorted_and_named(server, driven):
    slow, fast = driven
    rows = server.get("/api/jobs?kind=drive&status=done&sort=time_s&ascending=true")
    times = [row["summary"]["time_s"] for row in rows]
    assert times == sorted(times)
    assert [row["id"] for row in rows if row["id"] in driven] == [fast, slow]
    fed = {row["id"]: row["summary"] for row in rows}
    result = server.get(f"/api/jobs/{slow}/drive")
    assert fed[slow]["energy_kwh"] == result["kpis"]["energy_wheel_kwh"]
    assert fed[fast]["success"] is False
    assert "arrived: " in fed[fast]["outcome"]
    named = server.client.patch(f"/api/jobs/{slow}", json={"name": " 100 % by hand_1 "}).json()
    assert named["name"] == "100 % by hand_1"
    assert [row["id"] for row in server.get("/api/jobs", params={"text": "100 % BY hand_"})] == [slow]
    assert server.get("/api/jobs", params={"text": "100 _ by"}) == []
    first = server.get("/api/jobs?limit=1")[0]["id"]
    assert server.get("/api/jobs?limit=1&offset=1")[0]["id"] != first
    refusal_of(server.get("/api/jobs?sort=words", code=422), "sort")
    refusal_of(server.client.patch(f"/api/jobs/{slow}", json={"name": "a\nb"}).json(), "name")
    refusal_of(server.client.patch("/api/jobs/nobody", json={"name": "a"}).json(), "id")


def test_two_drives_of_one_section_are_compared(server, driven):
    slow, fast = driven
    found = server.get(f"/api/jobs/{slow}/difference/{fast}")
    assert found["drivers"] == ["manual", "flat_out"]
    late = [b - a for a, b in zip(*found["time_s"], strict=True)]
    kpis = {pair["name"]: pair for pair in found["kpis"]}
    pair = kpis["running_time_s"]
    assert late[-1] == pytest.approx(pair["second"] - pair["first"], abs=0.5)
    assert late[-1] < -5
    assert all(b >= a - 0.5 for a, b in zip(*found["speed_mps"], strict=True))
    used = [row[-1] for row in found["energy_wheel_j"]]
    assert used[1] - used[0] == pytest.approx(
        3.6e6 * (kpis["energy_wheel_kwh"]["second"] - kpis["energy_wheel_kwh"]["first"]), rel=1e-3
    )
    body = {**SECTION, "origin": "WYJ", "destination": "RJ", "driver": "flat_out"}
    other = server.post("/api/jobs/drive", body, code=202)["id"]
    refusal_of(server.get(f"/api/jobs/{other}/difference/{fast}", code=404), "id")
    server.wait(other)
    error = refusal_of(server.get(f"/api/jobs/{slow}/difference/{other}", code=422), "other_id")
    assert (error["value"], error["allowed"]) == ("yizhuang WYJ – RJ", "yizhuang RJ – WYJ")


def test_a_journey_is_kept(server):
    asked = {"line": "yizhuang", "total_s": 1950}
    row = server.post("/api/jobs/journey", asked, code=201)
    assert (row["kind"], row["status"]) == ("journey", "done")
    found = server.get(f"/api/jobs/{row['id']}/journey")
    assert found["running_time_s"] == pytest.approx(1950, abs=0.1)
    assert row["summary"]["energy_kwh"] == pytest.approx(found["energy_j"] / 3.6e6)
    before = len(server.get("/api/jobs?kind=journey"))
    server.post("/api/jobs/journey", {**asked, "total_s": 600}, code=422)
    assert len(server.get("/api/jobs?kind=journey")) == before


def test_a_deleted_job_is_gone_with_its_files(server):
    live = server.post("/api/live", {**SECTION, "time_s": 101, "pace": 0}, code=201)["id"]
    error = refusal_of(server.client.delete(f"/api/jobs/{live}").json(), "id")
    assert "stop it first" in error["message"]
    server.post(f"/api/live/{live}/stop")
    job = server.post("/api/jobs/drive", {**SECTION, "driver": "flat_out"}, code=202)["id"]
    server.wait(job)
    folder = server.data / "jobs" / job
    assert (folder / "trajectory.csv").exists()
    for each in (live, job):
        answer = server.client.delete(f"/api/jobs/{each}")
        assert answer.status_code == 204, answer.text
        refusal_of(server.get(f"/api/jobs/{each}", code=404), "id")
    assert not folder.exists()
    refusal_of(server.get(f"/api/jobs/{job}/files/kpis.json", code=404), "id")


def test_a_folder_of_before_gets_names_and_summaries(tmp_path):
    with sqlite3.connect(tmp_path / "console.sqlite") as database:
        database.execute(
            "CREATE TABLE jobs (id TEXT PRIMARY KEY, kind TEXT NOT NULL, status TEXT NOT NULL, "
            "asked TEXT NOT NULL, created TEXT NOT NULL, progress REAL NOT NULL DEFAULT 0, "
            "words TEXT NOT NULL DEFAULT '', run TEXT, stop INTEGER NOT NULL DEFAULT 0, error TEXT, "
            "result TEXT)"
        )
        kpis = {"outcome": "arrived", "running_time_s": 99.0, "energy_wheel_kwh": 9.0}
        values = [json.dumps({"line": "yizhuang"}), json.dumps({"success": True, "kpis": kpis})]
        sql = "INSERT INTO jobs (id, kind, status, asked, created, result) "
        sql += "VALUES ('a', 'drive', 'done', ?, 'x', ?)"
        database.execute(sql, values)
        database.execute(
            "INSERT INTO jobs (id, kind, status, asked, created) VALUES ('b', 'drive', 'failed', '{}', 'y')"
        )
    JobStore(tmp_path)
    store = JobStore(tmp_path)
    first, second = store.jobs(sort="energy_kwh", ascending=True)
    assert (first.id, first.summary["energy_kwh"], first.summary["outcome"]) == ("a", 9.0, "arrived")
    assert (second.id, second.summary, second.name) == ("b", {}, "")

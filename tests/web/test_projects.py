"""Projects: filled, exported, imported on another server, and archives that are refused in one line."""

import io
import json
import stat
import time
import zipfile

import pytest
from tests.web.program import Server
from tests.web.test_api import SECTION, refusal_of

from metropilot.web.pages.plots import finished_line_figure


def pack(entries):
    """An archive of (name or ZipInfo, content)."""
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in entries:
            archive.writestr(name, content)
    return made.getvalue()


def send(server, content, code):
    answer = server.client.post("/api/projects/archive", files={"file": ("project.zip", content)})
    assert answer.status_code == code, answer.text
    return answer.json()


@pytest.fixture(scope="module")
def filled(server):
    """A project with a drive on an own line of two versions, a journey, a stopped live run; its archive."""
    text = server.client.get("/api/lines/yizhuang/toml").text
    line = server.client.post("/api/uploads", files={"file": ("mine.toml", text.encode())}).json()["id"]
    slower = text.replace("[1090, 80]", "[1090, 60]")
    server.client.put(f"/api/uploads/{line}", json={"toml": slower, "version": 1})
    project = server.post("/api/projects", {"name": "Täglich 1", "notes": "a\nb"}, code=201)["id"]
    section = {**SECTION, "line": line}
    drive = server.post("/api/jobs/drive", {**section, "driver": "flat_out"}, code=202)["id"]
    journey = server.post("/api/jobs/journey", {"line": line, "total_s": 1990}, code=201)["id"]
    live = server.post("/api/live", {**section, "time_s": 101, "pace": 0}, code=201)["id"]
    server.post(f"/api/live/{live}/arrival", {"scheduled_time_s": 110})
    server.post(f"/api/live/{live}/stop")
    server.wait(drive)
    server.client.patch(f"/api/jobs/{drive}", json={"name": "first"})
    for job in (drive, journey, live):
        answer = server.client.put(f"/api/jobs/{job}/project", json={"project": project})
        assert answer.json()["project"] == project
    assert server.client.put(f"/api/uploads/{line}/project", json={"project": project}).status_code == 204
    return (
        project,
        line,
        (drive, journey, live),
        server.client.get(f"/api/projects/{project}/archive").content,
    )


def test_a_project_holds_what_is_filed_in_it(server, filled):
    project, line, jobs, _ = filled
    found = server.get(f"/api/projects/{project}")
    assert set(found["jobs"]) == set(jobs)
    assert [each["id"] for each in found["uploads"]] == [line]
    assert {row["id"] for row in server.get(f"/api/jobs?project={project}")} == set(jobs)
    assert project in {row["id"] for row in server.get("/api/projects")}
    answer = server.client.put(f"/api/projects/{project}", json={"name": "Täglich 1", "notes": "c"})
    assert answer.json()["notes"] == "c"
    for code, path, field in ((404, "nowhere", "project"), (422, "../etc", None)):
        body = server.client.put(f"/api/jobs/{jobs[0]}/project", json={"project": path})
        assert body.status_code == code
        refusal_of(body.json(), field or "project")


def test_an_archive_gives_the_same_project_elsewhere(filled, tmp_path):
    other = Server(tmp_path)
    try:
        _, line, (drive, journey, live), content = filled
        project = send(other, content, 201)
        assert (project["name"], project["notes"]) == ("Täglich 1", "a\nb")
        other.kill()
        other = Server(tmp_path)
        found = other.get(f"/api/projects/{project['id']}")
        rows = {row["kind"]: row for row in other.get(f"/api/jobs?project={project['id']}")}
        assert set(rows) == {"drive", "journey", "live"}
        assert rows["drive"]["name"] == "first"
        (upload,) = found["uploads"]
        assert upload["id"] != line
        assert {row["request"]["line"] for row in rows.values()} == {upload["id"]}
        assert not {rows[kind]["id"] for kind in rows} & {drive, journey, live}
        assert [row["number"] for row in other.get(f"/api/uploads/{upload['id']}/versions")] == [2, 1]
        kpis = other.get(f"/api/jobs/{rows['drive']['id']}/drive")["kpis"]
        assert kpis["energy_wheel_kwh"] == rows["drive"]["summary"]["energy_kwh"]
        packed = other.client.get(f"/api/jobs/{rows['drive']['id']}/files/run.zip").content
        with zipfile.ZipFile(io.BytesIO(packed)) as archive:
            assert {name.rpartition("/")[2] for name in archive.namelist()} >= {"run.toml", "kpis.json"}
            assert sum(name.endswith(".toml") for name in archive.namelist()) == 2
        resumed = other.post(f"/api/live/{rows['live']['id']}/resume", code=201)["id"]
        for _ in range(100):
            if other.get(f"/api/live/{resumed}")["scheduled_time_s"] == 110:
                break
            time.sleep(0.1)
        assert other.get(f"/api/live/{resumed}")["scheduled_time_s"] == 110
        again = zipfile.ZipFile(
            io.BytesIO(other.client.get(f"/api/projects/{project['id']}/archive").content)
        )
        assert len(json.loads(again.read("project.json"))["jobs"]) == 2  # the live one runs again
    finally:
        other.close()


def test_an_archive_holds_running_lines_with_their_graph(server):
    project = server.post("/api/projects", {"name": "lines"}, code=201)["id"]
    body = {"line": "yizhuang", "headway_s": 300, "pace": 0, "lasts_s": 300}
    lives = [server.post("/api/running-lines", body, code=201)["id"] for _ in range(2)]
    server.post(f"/api/live/{lives[0]}/hold", {"station": "RJ", "hold_s": 120})
    server.post(f"/api/live/{lives[0]}/pace", {"pace": 100})
    server.wait(lives[0])
    server.post(f"/api/live/{lives[1]}/stop")
    for live in lives:
        server.client.put(f"/api/jobs/{live}/project", json={"project": project})
    content = server.client.get(f"/api/projects/{project}/archive").content
    made = send(server, content, 201)["id"]
    rows = {row["status"]: row["id"] for row in server.get(f"/api/jobs?project={made}")}
    assert set(rows) == {"done", "stopped"}
    assert not set(rows.values()) & set(lives)
    told = [server.get(f"/api/live/{live}/line") for live in (lives[0], rows["done"])]
    assert told[0] == told[1]
    graph = told[1]["graph"]
    assert graph["time_s"] == [5.0 * k for k in range(1, 61)]
    assert {len(row) for row in graph["position_m"]} == {told[1]["trains"]}
    drawn = finished_line_figure(graph)["data"]
    assert sum(len(drawn[k]["x"]) for k in range(3)) == 3 * 59 * told[1]["trains"]
    assert len(drawn[2]["x"]) > 0, "a train is more than a minute late"
    assert drawn[-1]["y"] == [m / 1000 for m in graph["position_m"][-1]]
    paths = [f"/api/jobs/{job}/files/delays.csv" for job in (lives[0], rows["done"])]
    assert len({server.client.get(path).text for path in paths}) == 1
    assert server.post(f"/api/live/{rows['stopped']}/resume", code=201)["status"] in {"running", "queued"}
    server.post(f"/api/live/{rows['stopped']}/stop")


ROWS = {"time_s": [5], "position_m": [[1]], "delay_s": [[0]], "energy_kwh": [1], "floor_kwh": [1]}
GRAPH = {"stops": [], **ROWS}


@pytest.mark.parametrize("change", [{"position_m": []}, {"position_m": [[1, 2]]}, {"stops": "x"}])
def test_a_train_graph_without_a_shape_is_refused(server, change):
    told = dict.fromkeys(("time_s", "energy_kwh", "floor_kwh", "largest_delay_s", "delay_s"), 1.0)
    told |= {"trains": 1, "waits": 0, "stops": 0, "gap_percent": 0, "disturbed_s": None, "recovered_s": None}
    request = {"line": "yizhuang", "headway_s": 300, "lasts_s": 300}
    job = {**JOB, "kind": "live", "id": "live-1", "request": request}
    for graph, code in ((GRAPH, 201), (GRAPH | change, 422)):
        result = json.dumps({**told, "outcome": "", "graph": graph})
        entries = [("project.json", index(jobs=[job])), ("jobs/live-1/result.json", result)]
        answer = send(server, pack(entries), code)
    assert answer["error"]["message"].startswith("not usable")
    assert answer["error"]["field"] == "jobs[0]"


def link(name):
    entry = zipfile.ZipInfo(name)
    entry.external_attr = (stat.S_IFLNK | 0o777) << 16
    return entry


INDEX = json.dumps({"format": 1, "name": "x", "notes": "", "jobs": [], "uploads": []})
JOB = {"id": "drive-1", "kind": "drive", "status": "done", "created": "2026-01-01T00:00:00", "request": {}}


def index(**changes):
    return json.dumps({**json.loads(INDEX), **changes})


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ([("project.json", INDEX), ("../evil.txt", "x")], "another name"),
        ([("project.json", INDEX), ("jobs/../../evil", "x")], "another name"),
        ([("project.json", INDEX), ("/etc/passwd", "x")], "another name"),
        ([("project.json", INDEX), ("C:\\evil", "x")], "another name"),
        ([("project.json", INDEX), ("jobs/a/..", "x")], "another name"),
        ([("project.json", INDEX), (link("jobs/a/kpis.json"), "/etc/passwd")], "no plain file"),
        ([("project.json", INDEX), ("jobs/a/big.json", b"0" * 70_000_000)], "too large"),
        ([("project.json", index(name="n" * 70_000_000))], "too large"),
        ([("jobs/a/kpis.json", "{}")], "not a project"),
        ([("project.json", "[]")], "not a project"),
        ([("project.json", "{")], "not a project"),
        ([("project.json", "[" * 100_000)], "not a project"),
        ([("project.json", index(format=2))], "not a project"),
        ([("project.json", index(jobs=3))], "not a list"),
        ([("project.json", index(jobs=[{"kind": "walk", "status": "done"}]))], "not a job"),
        ([("project.json", index(jobs=[{"kind": "learn", "status": "running"}]))], "not a job"),
        ([("project.json", index(jobs=[{"kind": "learn", "status": "done"}]))], "not usable"),
        ([("project.json", index(jobs=[{**JOB, "request": {"line": "/etc/passwd"}}]))], "not usable"),
        ([("project.json", index(jobs=[{**JOB, "created": "<b>"}]))], "not usable"),
        ([("project.json", index(jobs=[JOB])), ("jobs/drive-1/result.json", '{"kpis": 3}')], "not usable"),
        ([("project.json", index(uploads=[{"id": "../x", "versions": ["1.toml"]}]))], "not an upload"),
        ([("project.json", index(uploads=[{"id": "upload-00000000", "versions": ["1.toml"]}]))], "missing"),
    ],
)
def test_an_archive_that_cannot_be_used_is_refused_in_one_line(server, entries, words):
    before = server.get("/api/projects"), len(list(server.data.glob("uploads/*")))
    error = send(server, pack(entries), 422)["error"]
    assert words in error["message"]
    assert "\n" not in error["message"]
    assert before == (server.get("/api/projects"), len(list(server.data.glob("uploads/*"))))
    assert not list(server.data.parent.rglob("evil*"))


@pytest.mark.parametrize(
    ("kind", "result"),
    [
        ("live", {"kpis": {}, "success": True, "time_s": 1.0, "speeds": []}),
        ("live", {"kpis": {"trainsets": 3}, "success": True, "time_s": 1.0, "speeds": []}),
    ],
)
def test_a_result_without_what_the_list_of_runs_shows_is_refused(server, kind, result):
    job = {**JOB, "kind": kind, "id": "live-1", "request": {"trainsets": 2, "follower": "follow_plan"}}
    entries = [("project.json", index(jobs=[job])), ("jobs/live-1/result.json", json.dumps(result))]
    error = send(server, pack(entries), 422)["error"]
    assert (error["file"], error["field"]) == ("project.json", "jobs[0].result")


def test_a_bad_line_in_an_archive_leaves_nothing_behind(server, filled):
    content = filled[3]
    files = {}
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    last = max(name for name in files if name.startswith("uploads/"))
    files[last] = files[last].replace(b'kind = "line"', b'kind = "lime"')
    before = len(list(server.data.glob("uploads/*")))
    error = send(server, pack(files.items()), 422)["error"]
    assert error["field"] == "kind"
    assert len(list(server.data.glob("uploads/*"))) == before
    garbage = send(server, b"PK\x03\x04 nothing", 422)["error"]
    assert garbage["message"] == "not a readable ZIP archive"


def test_a_removed_project_leaves_what_it_held(server):
    project = server.post("/api/projects", {"name": "short"}, code=201)["id"]
    job = server.post("/api/jobs/journey", {"line": "yizhuang", "total_s": 1990}, code=201)["id"]
    server.client.put(f"/api/jobs/{job}/project", json={"project": project})
    assert server.client.delete(f"/api/projects/{project}").status_code == 204
    assert server.get(f"/api/jobs/{job}")["project"] is None
    refusal_of(server.get(f"/api/projects/{project}", code=404), "project")
    refusal_of(server.post("/api/projects", {"name": ""}, code=422), "name")

"""Archives of projects with learning runs, campaigns, studies and exports: they go on on another server."""

import io
import json
import time
import zipfile

import pytest
from tests.web.program import Server
from tests.web.test_api import SECTION
from tests.web.test_projects import pack, send

from metropilot.web.store import JobStore

LEARN = {"driver": "ppo", "budget": "quick", "steps": 60_000, "evaluations": 4}
MATRIX = {"loads": ["AW2"], "times": [1.2, 1.4]}
STUDY = {
    "study": "lu2023",
    "budget": "quick",
    "rows": [
        {
            "table": "1",
            "case": "a",
            "driver": "dqn",
            "kpi": "time",
            "unit": "s",
            "published": 1.0,
            "ours": 2.0,
        }
        | dict.fromkeys(("low", "high", "optimum"))
    ],
}


def heavy(drivers, sections):
    matrix = {**MATRIX, "drivers": drivers, "sections": sections}
    return {"name": "heavy", "matrix": matrix, "disturbance": [{"name": "heavy", "mass_factor": [1.0, 1.2]}]}


def stop_when_begun(server, job):
    """Stop a campaign after its first shard."""
    while server.get(f"/api/jobs/{job}")["progress"] == 0:
        time.sleep(0.05)
    server.post(f"/api/jobs/{job}/stop")
    server.wait(job, until=("stopped",))


@pytest.fixture(scope="module")
def made(server):
    """Jobs of every kind that takes long, by name, on a line of which nothing but they know."""
    text = server.client.get("/api/lines/yizhuang/toml").text
    line = server.client.post("/api/uploads", files={"file": ("mine.toml", text.encode())}).json()["id"]
    learned = server.post("/api/jobs/learn", LEARN | {"steps": 4000, "evaluations": 1}, code=202)["id"]
    run = server.wait(learned)["run"]
    there = {"line": line, "sections": "RJ-WYJ", "load": "AW2"}
    stopped = server.post("/api/jobs/learn", LEARN | there, code=202)["id"]
    while len(server.get(f"/api/jobs/{stopped}")["run"] or "") == 0:
        time.sleep(0.05)
    while not server.get(f"/api/runs/{server.get(f'/api/jobs/{stopped}')['run']}/history")["columns"]:
        time.sleep(0.05)
    server.post(f"/api/jobs/{stopped}/stop")
    server.wait(stopped, until=("stopped",))
    drivers = ["flat_out", f"learned:policy={run}"]
    whole = server.post("/api/jobs/campaign", heavy(drivers, [f"{line} RJ WYJ"]), code=202)["id"]
    server.wait(whole)
    body = heavy(["flat_out", "manual"], [f"{line} RJ WYJ"])
    body["matrix"]["seeds"] = 12
    part = server.post("/api/jobs/campaign", body, code=202)["id"]
    stop_when_begun(server, part)
    export = server.post("/api/jobs/export", {**SECTION, "driver": "ppo", "number": "float"}, code=202)["id"]
    server.wait(export)
    store = JobStore(server.data)
    study = store.new_job("study", {"study": "lu2023", "budget": "quick"})
    store.update(study, status="done", result=STUDY)
    jobs = {"stopped": stopped, "whole": whole, "part": part, "export": export, "study": study}
    project = server.post("/api/projects", {"name": "long"}, code=201)["id"]
    for job in jobs.values():
        server.client.put(f"/api/jobs/{job}/project", json={"project": project})
    content = server.client.get(f"/api/projects/{project}/archive").content
    return jobs | {"learned": learned, "run": run, "line": line, "content": content}


def rows_of(server, job):
    found = server.get(f"/api/campaigns/{job}/rows", params={"limit": 200})["rows"]
    timed = ("processor_s", "wall_s", "decision_us_median", "decision_us_max", "worker_mb")
    return [{name: value for name, value in row.items() if name not in timed} for row in found]


def test_learning_runs_and_campaigns_go_on_elsewhere(server, made, tmp_path):
    with zipfile.ZipFile(io.BytesIO(made["content"])) as archive:
        for name in archive.namelist():
            assert str(server.data).encode() not in archive.read(name), name
    other = Server(tmp_path)
    try:
        project = send(other, made["content"], 201)
        jobs = other.get(f"/api/jobs?project={project['id']}")
        assert len(jobs) == 6
        assert len(other.get(f"/api/projects/{project['id']}")["uploads"]) == 1
        by = {(row["kind"], row["status"]): row for row in jobs}
        learned, stopped = by["learn", "done"], by["learn", "stopped"]
        told = other.get(f"/api/runs/{learned['run']}/history")
        assert told == server.get(f"/api/runs/{made['run']}/history")
        # a campaign: the same rows, and each drives as it did
        whole = by["campaign", "done"]["id"]
        ids = {
            row["request"]["matrix"]["sections"][0].split()[0] for row in jobs if row["kind"] == "campaign"
        }
        text = json.dumps(rows_of(server, made["whole"]))
        text = text.replace(made["line"], ids.pop()).replace(made["run"], learned["run"])
        assert rows_of(other, whole) == json.loads(text)
        assert not ids
        assert other.get(f"/api/campaigns/{whole}/rows/3")["options"] == {"policy": learned["run"]}
        row = rows_of(other, whole)[3]
        again = other.post("/api/jobs/drive", other.get(f"/api/campaigns/{whole}/rows/3"), code=202)["id"]
        other.wait(again)
        assert other.get(f"/api/jobs/{again}/drive")["kpis"]["energy_wheel_kwh"] == row["energy_wheel_kwh"]
        # one that was stopped goes on from its rows
        part = by["campaign", "stopped"]["id"]
        before = rows_of(other, part)
        assert [row["row"] for row in before] == [row["row"] for row in rows_of(server, made["part"])]
        other.post(f"/api/jobs/{part}/resume", code=202)
        server.post(f"/api/jobs/{made['part']}/resume", code=202)
        # so does learning, from its checkpoint
        steps = len(other.get(f"/api/runs/{stopped['run']}/history")["columns"]["steps"])
        assert steps > 0
        other.post(f"/api/jobs/{stopped['id']}/resume", code=202)
        assert other.wait(stopped["id"])["run"] == stopped["run"]
        assert other.get(f"/api/runs/{stopped['run']}")["status"] == "done"
        for each, job in ((other, part), (server, made["part"])):
            each.wait(job)
        both = ((other, part), (server, made["part"]))
        ends = [[row["energy_wheel_kwh"] for row in rows_of(*each)] for each in both]
        assert len(ends[0]) == 48 > len(before) > 0
        assert ends[0] == ends[1], "the rest was drawn as it would have been there"
        assert other.get("/api/studies/lu2023") == STUDY["rows"]
        packed = other.client.get(f"/api/jobs/{by['export', 'done']['id']}/files/run.zip").content
        with zipfile.ZipFile(io.BytesIO(packed)) as files:
            assert {name.rpartition("/")[2] for name in files.namelist()} >= {
                "Makefile",
                "ppo.c",
                "vectors.csv",
            }
    finally:
        other.close()


def edit_archive(content, change):
    """An archive with its files changed by a function of name and content; None leaves a file out."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        files = {name: change(name, archive.read(name)) for name in archive.namelist()}
    return pack([(name, data) for name, data in files.items() if data is not None])


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("run.toml", b"id = 3", "not the folder of a learning run"),
        ("policy.safetensors", b"\x00" * 100, ""),
        ("progress.jsonl", b"[1, 2]\n", "not a history"),
        ("history.parquet", b"PAR1 nothing", "cannot read the history"),
        ("results.parquet", b"PAR1 nothing", "not the rows of a campaign"),
    ],
)
def test_a_file_that_cannot_be_used_leaves_nothing_behind(server, made, name, data, words):
    folders = [len(list(server.data.glob(f"{kind}/*"))) for kind in ("jobs", "runs", "uploads")]
    before = server.get("/api/projects"), len(server.get("/api/runs"))
    content = edit_archive(made["content"], lambda path, old: data if path.endswith(f"/{name}") else old)
    error = send(server, content, 422)["error"]
    assert words in error["message"]
    assert str(server.data) not in str(error)
    assert before == (server.get("/api/projects"), len(server.get("/api/runs")))
    assert folders == [len(list(server.data.glob(f"{kind}/*"))) for kind in ("jobs", "runs", "uploads")]


def test_a_run_of_another_configuration_begins_again(server, made):
    def change(path, old):
        return (
            old.replace(b"hidden = [\n    64", b"hidden = [\n    65") if path.endswith("/run.toml") else old
        )

    project = send(server, edit_archive(made["content"], change), 201)["id"]
    rows = {
        row["status"]: row for row in server.get(f"/api/jobs?project={project}") if row["kind"] == "learn"
    }
    assert rows["stopped"]["run"] is None
    assert rows["done"]["run"] is not None

"""Logs are uploaded, a trainset is fitted to them and saved; what cannot be told is one line."""

import tomllib

import pytest
from tests.web.test_api import SECTION, refusal_of


def send(server, name, content):
    return server.client.post("/api/uploads", files={"file": (name, content)})


@pytest.fixture(scope="module")
def log(server):
    """Log of a run whose plant is heavier and later than the trainset."""
    asked = {**SECTION, "time_s": 130, "driver": "manual", "mass_factor": 1.1, "delay_s": 0.4}
    job = server.post("/api/jobs/drive", asked, code=202)["id"]
    server.wait(job)
    answer = send(
        server, "monday run.csv", server.client.get(f"/api/jobs/{job}/files/trajectory.csv").content
    )
    assert answer.status_code == 201, answer.text
    found = answer.json()
    assert (found["kind"], found["name"]) == ("log", "monday run.csv")
    assert found["notes"][0].endswith("command, effort, position, gradient")
    return found["id"]


def test_a_trainset_is_fitted_and_saved_version_by_version(server, log):
    job = server.post("/api/jobs/fit", {**SECTION, "logs": [log]}, code=202)["id"]
    row = server.wait(job)
    assert row["summary"]["outcome"].startswith("residuals 0.0")
    found = server.get(f"/api/jobs/{job}/fit")
    told = {each["id"]: each for each in found["parameters"]}
    assert told["mass_factor"]["value"] == pytest.approx(1.1, rel=2e-3)
    assert told["delay_s"]["low"] < 0.4 + 0.01 < told["delay_s"]["high"] + 0.02
    assert found["logs"] == ["monday run.csv"]
    assert "commands cannot tell them apart" in found["ambiguities"][0]
    curves = found["residuals"]
    assert len(curves["time_s"]) == len(curves["measured_mps"]) > 400
    assert len(curves["lag_s"]) == len(curves["correlation"])
    text = server.client.get(f"/api/jobs/{job}/files/trainset.toml").text
    assert "monday run.csv" in tomllib.loads(text)["mass"]["source"]
    assert str(server.data) not in text
    assert server.client.get(f"/api/jobs/{job}/files/residuals.png").content.startswith(b"\x89PNG")
    saved = server.post(f"/api/jobs/{job}/fit/trainset", {}, code=201)
    assert saved["number"] == 1
    again = server.post(f"/api/jobs/{job}/fit/trainset", {"upload": saved["id"]}, code=201)
    assert (again["id"], again["number"]) == (saved["id"], 2)
    assert server.client.get(f"/api/trainsets/{saved['id']}/toml").text == text
    section = {**SECTION, "trainset": saved["id"]}
    assert server.post("/api/section", section)["minimum_running_time_s"] > 84
    refusal_of(server.post(f"/api/jobs/{job}/fit/trainset", {"upload": log}, code=409), "id")
    refusal_of(server.post(f"/api/jobs/{job}/fit/trainset", {"upload": "upload-0"}, code=404), "id")


def test_a_log_that_does_not_tell_enough_fails_with_what_is_missing(server, log):
    text = "time [s],speed [km/h],command\n" + "".join(f"{k / 5},{0.4 * k},1\n" for k in range(100))
    short = send(server, "departure.csv", text).json()["id"]
    job = server.post("/api/jobs/fit", {"logs": [short]}, code=202)["id"]
    error = server.wait(job, until=("failed",))["error"]
    assert "the logs have" in error["message"]
    assert "no braking" in error["message"]
    refusal_of(server.get(f"/api/jobs/{job}/fit", code=404), "id")
    refusal_of(server.post(f"/api/jobs/{job}/fit/trainset", {}, code=404), "id")
    server.client.delete(f"/api/uploads/{short}")
    refusal_of(server.post("/api/jobs/fit", {"logs": [log, short]}, code=422), "logs[1]")


@pytest.mark.parametrize(
    ("content", "field"),
    [
        ("time [s],command\n" + "1,1\n" * 40, "speed"),
        ("time [s],speed [furlong]\n" + "1,1\n" * 40, "column 'speed'"),
        ("time [s],speed [km/h]\n" + "1,1\n" * 40, "line 3"),
        ("time [s],speed [km/h]\n1,fast\n" + "2,1\n" * 40, "line 2, column 'speed [km/h]'"),
    ],
)
def test_a_bad_log_is_refused_by_name_and_line(server, content, field):
    answer = send(server, "bad.csv", content)
    assert answer.status_code == 422
    error = refusal_of(answer.json(), field)
    assert error["file"] == "bad.csv"
    assert str(server.data) not in answer.text


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"logs": []}, "logs"),
        ({"logs": ["../console.sqlite"]}, "logs[0]"),
        ({"trainset": "none"}, "trainset"),
        ({"load": "AW9"}, "load"),
        ({"line": "yizhuang"}, "origin"),
        ({"line": "nowhere", "origin": "RJ", "destination": "WYJ"}, "line"),
        ({"keep": ["colour"]}, "keep[0]"),
        ({"input": "guess"}, "input"),
    ],
)
def test_a_fit_that_is_not_possible_is_refused_at_once(server, log, body, field):
    refusal_of(server.post("/api/jobs/fit", {"logs": [log], **body}, code=422), field)


def test_a_log_larger_than_allowed_is_refused(server):
    answer = send(server, "long.csv", b"time [s],speed [km/h]\n" + b"1,1\n" * 2_100_000)
    assert answer.status_code in {413, 422}
    refusal_of(answer.json(), "")


def test_a_project_takes_logs_and_fits_with_it(server, log):
    project = server.post("/api/projects", {"name": "Fits"}, code=201)["id"]
    job = server.post("/api/jobs/fit", {**SECTION, "logs": [log], "keep": ["lag", "brake"]}, code=202)["id"]
    server.wait(job)
    for path in (f"/api/jobs/{job}/project", f"/api/uploads/{log}/project"):
        assert server.client.put(path, json={"project": project}).status_code < 300
    packed = server.client.get(f"/api/projects/{project}/archive").content
    answer = server.client.post("/api/projects/archive", files={"file": ("fits.zip", packed)})
    assert answer.status_code == 201, answer.text
    found = server.get(f"/api/projects/{answer.json()['id']}")
    assert [(each["kind"], each["name"]) for each in found["uploads"]] == [("log", "monday run.csv")]
    request = server.get(f"/api/jobs/{found['jobs'][0]}")["request"]
    assert request["logs"] == [found["uploads"][0]["id"]] != [log]
    kept = {p["id"]: p["estimated"] for p in server.get(f"/api/jobs/{found['jobs'][0]}/fit")["parameters"]}
    assert (kept["lag_s"], kept["brake_factor"], kept["mass_factor"]) == (False, False, True)

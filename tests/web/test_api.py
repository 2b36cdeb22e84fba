"""The HTTP API of a running server: what it answers, and how it refuses."""

import html
import io
import json
import re
import subprocess
import zipfile
from pathlib import Path

import pytest
from tests.web.program import PROGRAM

from metropilot.policy import shipped_policy
from metropilot.railway import load_line, write_line
from metropilot.web.api.docs import command
from metropilot.web.schemas import requests

SECTION = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ"}
LIMIT = "restrictions[0].limit_mps"
ERROR = {"message", "file", "field", "value", "unit", "allowed"}


def refusal_of(answer, field):
    assert set(answer["error"]) == ERROR
    assert (answer["error"]["field"] or "").startswith(field)
    assert answer["error"]["message"]
    assert "\n" not in answer["error"]["message"]
    return answer["error"]


def test_the_catalogue(server):
    lines = server.get("/api/lines")
    assert "yizhuang" in {row["id"] for row in lines}
    line = server.get("/api/lines/yizhuang")
    assert len(line["stops"]) == line["stations"] == len(line["sections"]) + 1
    assert max(line["limit_mps"]["value"]) == pytest.approx(80 / 3.6)
    assert "AW2" in server.get("/api/trainsets/dkz32")["loads_kg"]
    assert {"optimal", "manual"} <= {row["id"] for row in server.get("/api/drivers")}
    assert "drive" in {row["id"] for row in server.get("/api/tasks")}


def test_a_plan_has_that_of_the_true_plant_beside_it(server):
    plain = server.post("/api/plan", {**SECTION, "time_s": 101})
    assert plain["plant"] is None
    heavy = server.post("/api/plan", {**SECTION, "time_s": 101, "mass_factor": 1.2})
    late = server.post(
        "/api/plan", {**SECTION, "time_s": 101, "mass_factor": 1.2, "delay_s": 0.5, "lag_s": 0.4}
    )
    assert heavy["energy_j"] == late["energy_j"] == plain["energy_j"]
    assert 1.1 * plain["energy_j"] < heavy["plant"]["energy_j"] < late["plant"]["energy_j"]
    assert late["plant"]["minimum_running_time_s"] > plain["minimum_running_time_s"]
    barely = server.post("/api/plan", {**SECTION, "time_s": 84, "mass_factor": 1.4})
    assert barely["plant"] is None
    refused = server.post("/api/plan", {**SECTION, "mass_factor": 9}, code=422)
    assert refused["error"]["field"] == "mass_factor"


def test_a_plan_has_a_certificate_and_a_price(server):
    section = server.post("/api/section", SECTION)
    assert 80 < section["minimum_running_time_s"] < 85
    plan = server.post("/api/plan", {**SECTION, "time_s": 101})
    assert plan["running_time_s"] == pytest.approx(101, abs=0.05)
    assert 0 <= plan["certificate_gap"] < 1e-3
    later = server.post("/api/plan", {**SECTION, "time_s": 102})
    assert plan["energy_j"] - later["energy_j"] == pytest.approx(plan["second_w"], rel=0.1)
    front = server.post("/api/front", SECTION)
    assert front["energy_j"] == sorted(front["energy_j"], reverse=True)


def test_too_little_time_is_refused_with_the_bound(server):
    error = refusal_of(server.post("/api/plan", {**SECTION, "time_s": 50}, code=422), "time_s")
    assert "83" in error["allowed"]
    assert error["unit"] == "s"
    refusal_of(server.post("/api/jobs/drive", {**SECTION, "time_s": 50}, code=422), "time")


def test_a_journey_whose_reserve_is_spread_costs_less(server):
    kept = server.post("/api/journey", {"line": "yizhuang"})
    total = kept["running_time_s"]
    spread = server.post("/api/journey", {"line": "yizhuang", "total_s": total})
    assert spread["energy_j"] < spread["planned_energy_j"] == pytest.approx(kept["energy_j"], rel=1e-6)
    assert spread["running_time_s"] <= total + 0.5
    assert spread["time_s"] == sorted(spread["time_s"])


def test_a_drive_with_its_files(server):
    job = server.post("/api/jobs/drive", {**SECTION, "time_s": 101}, code=202)["id"]
    server.wait(job)
    driven = server.get(f"/api/jobs/{job}/drive")
    assert driven["success"]
    assert driven["kpis"]["outcome"] == "arrived"
    assert len(driven["columns"]["speed_mps"]) == len(driven["columns"]["phase"]) > 400
    assert server.client.get(f"/api/jobs/{job}/files/profile.png").content.startswith(b"\x89PNG")
    csv = server.client.get(f"/api/jobs/{job}/files/trajectory.csv").text
    assert csv.startswith("time_s,position_m")
    server.get(f"/api/jobs/{job}/compare", code=404)
    told = driven["explanation"]
    assert told["decisions"] == []
    assert told == server.get(f"/api/jobs/{job}/files/explanation.json")
    powered, coasting = told["prices"][2], told["prices"][10]
    assert powered["later_j"] < powered["second_w"] < powered["sooner_j"] < 1.1 * powered["later_j"]
    assert coasting["later_j"] < 1e3 < coasting["sooner_j"]


def test_a_learned_drive_says_what_its_decisions_rest_on(server):
    body = {**SECTION, "time_s": 105, "driver": "ppo"}
    job = server.post("/api/jobs/drive", body, code=202)["id"]
    server.wait(job)
    decisions = server.get(f"/api/jobs/{job}/drive")["explanation"]["decisions"]
    assert len(decisions) == 20
    for decision in decisions:
        whole = sum(share["share"] for share in decision["shares"])
        assert whole == pytest.approx(decision["output"] - decision["usual"], abs=0.05)
        assert decision["meaning"] == "more power"
    assert {"speed", "running-time reserve"} <= {share["words"] for share in decisions[0]["shares"]}


def test_a_comparison(server):
    asked = {**SECTION, "time_s": 101, "drivers": ["optimal", "flat_out"]}
    job = server.post("/api/jobs/compare", asked, code=202)["id"]
    server.wait(job)
    entries = server.get(f"/api/jobs/{job}/compare")["entries"]
    assert [e["driver"] for e in entries] == ["optimal", "flat_out"]
    energy = [e["kpis"]["energy_wheel_kwh"]["mean"] for e in entries]
    assert energy[0] < energy[1]


def test_a_line_in_operation_with_its_timetable(server):
    body = {"line": "lu2023", "zones": 1, "headway_s": 240}
    job = server.post("/api/jobs/line", body, code=202)["id"]
    server.wait(job)
    found = server.get(f"/api/jobs/{job}/line")
    told, least = found["energies"], found["bottleneck"]
    assert told["floor_kwh"] <= told["energy_kwh"] <= told["driving_only_kwh"] < told["cruise_kwh"]
    assert 20 < least["headway_s"] == told["technical_headway_s"] < 240
    stops = [stop["position_m"] for stop in found["graph"]["stops"]]
    for path in found["graph"]["paths"].values():
        assert len(path["time_s"]) == len(path["position_m"])
        assert {x is None for x in path["time_s"]} == {True, False}
        places = [x for x in path["position_m"] if x is not None]
        assert stops[0] - 1 <= min(places) < max(places) <= stops[-1] + 1
    rows = server.client.get(f"/api/jobs/{job}/files/timetable.csv").text.splitlines()
    assert rows[0].startswith("direction,origin,destination,zone,departure_s")
    assert len(rows) == 1 + 2 * (len(stops) - 1)
    with zipfile.ZipFile(io.BytesIO(server.client.get(f"/api/jobs/{job}/files/run.zip").content)) as packed:
        assert {Path(name).name for name in packed.namelist()} == set(found["files"])
    early = server.post("/api/jobs/line", {**body, "headway_s": 20}, code=202)["id"]
    failed = server.wait(early, until=("failed",))
    assert failed["error"]["field"] == "headway_s"
    assert "at least" in failed["error"]["allowed"]
    refusal_of(server.get(f"/api/jobs/{early}/line", code=404), "id")


def test_a_day_of_a_line_gives_a_gtfs_feed(server):
    assert [day["line"] for day in server.get("/api/days")] == ["yizhuang"]
    fed = {row["id"]: row["lines"] for row in server.get("/api/feedings")}
    assert "yizhuang" in fed["yizhuang"]
    assert "lu2023" not in fed["yizhuang"]
    job = server.post("/api/jobs/line", {"day": "yizhuang", "time_window_s": 0}, code=202)["id"]
    server.wait(job)
    found = server.get(f"/api/jobs/{job}/line")
    assert set(found["graph"]["paths"]) == {"forward", "backward"}
    assert found["bottleneck"] is None
    feed = server.client.get(f"/api/jobs/{job}/files/gtfs.zip").content
    with zipfile.ZipFile(io.BytesIO(feed)) as packed:
        trips = packed.read("trips.txt").decode().splitlines()
    assert len(trips) == 1 + sum(found["energies"]["journeys"].values())


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"line": "/etc/passwd"}, "line"),
        ({"line": "nowhere"}, "line"),
        ({"trainset": "none"}, "trainset"),
        ({"load": "AW9"}, "load"),
        ({"headway_s": 5}, "headway_s"),
        ({"headway_s": 180.5}, "headway_s"),
        ({"dwell_s": 5, "dwell_window_s": 10}, "dwell_window_s"),
        ({"zones": 14}, "zones"),
        ({"day": "none"}, "day"),
        ({"day": "../days/yizhuang"}, "day"),
        ({"line": "lu2023", "zones": 1, "day": "yizhuang"}, "line"),
        ({"feeding": "none"}, "feeding"),
        ({"line": "lu2023", "zones": 1, "feeding": "yizhuang"}, "line"),
    ],
)
def test_a_line_that_cannot_be_operated_is_refused_at_once(server, body, field):
    assert refusal_of(server.post("/api/jobs/line", body, code=422), field)["message"]


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({**SECTION, "line": "/etc/passwd"}, "line"),
        ({**SECTION, "line": "../secret.toml"}, "line"),
        ({**SECTION, "line": "nowhere"}, "line"),
        ({**SECTION, "origin": "nowhere"}, "station"),
        ({**SECTION, "driver": "policy.safetensors"}, "driver"),
        ({**SECTION, "options": {"policy": "/etc/passwd"}}, "options.policy"),
        ({**SECTION, "time_s": "nan"}, "time_s"),
        ({**SECTION, "colour": "red"}, "colour"),
        ({**SECTION, "restrictions": [{"from_m": 5, "to_m": 5, "limit_mps": 3}]}, "to_m"),
        ({**SECTION, "restrictions": [{"from_m": 5, "to_m": 9, "limit_mps": 0}]}, LIMIT),
        ({**SECTION, "restrictions": [{"from_m": -5, "to_m": 9, "limit_mps": 9}]}, "restrictions[0].from_m"),
        ({**SECTION, "restrictions": [{"from_m": 5, "to_m": 9, "limit_mps": 1e-4}]}, LIMIT),
        ({**SECTION, "restrictions": [{"from_m": 5, "to_m": 9, "limit_mps": 500 / 3.6}]}, LIMIT),
        ({**SECTION, "restrictions": [{"from_m": 5, "to_m": 9000, "limit_mps": 10}]}, "restriction"),
    ],
)
def test_what_cannot_be_used_is_named(server, body, field):
    assert refusal_of(server.post("/api/jobs/drive", body, code=422), field)["message"]


def test_an_upload_is_used_like_any_line(server, tmp_path):
    write_line(load_line("yizhuang"), tmp_path / "mine.toml")
    text = (tmp_path / "mine.toml").read_bytes()
    answer = server.client.post("/api/uploads", files={"file": ("../../mine.toml", text)})
    assert answer.status_code == 201, answer.text
    key = answer.json()["id"]
    assert server.post("/api/section", {**SECTION, "line": key})["length_m"] == pytest.approx(1280)
    assert [p.parent.name for p in server.data.rglob("*.toml") if p.parent.name == "uploads"] == ["uploads"]
    server.client.delete(f"/api/uploads/{key}")
    refusal_of(server.post("/api/section", {**SECTION, "line": key}, code=422), "line")


def test_an_uploaded_policy_drives_by_its_id(server, tmp_path):
    content = shipped_policy("ppo").read_bytes()
    answer = server.client.post("/api/uploads", files={"file": ("mine.safetensors", content)})
    assert answer.status_code == 201, answer.text
    key = answer.json()["id"]
    assert answer.json()["kind"] == "policy"
    told = {"driver": "learned", "options": {"policy": key}}
    asked = {**SECTION, "time_s": 110, "drivers": ["ppo", "learned"], **told}
    job = server.post("/api/jobs/compare", asked, code=202)["id"]
    server.wait(job)
    entries = server.get(f"/api/jobs/{job}/compare")["entries"]
    assert [e["driver"] for e in entries] == ["ppo", "learned"]
    ours, theirs = (e["kpis"]["energy_wheel_kwh"]["mean"] for e in entries)
    assert ours == theirs
    assert str(server.data) not in str(entries)
    refusal_of(server.post("/api/jobs/drive", {**SECTION, "driver": "learned"}, code=422), "options.policy")
    other = shipped_policy("ddpg_pid").read_bytes()
    answer = server.client.post("/api/uploads", files={"file": ("gains.safetensors", other)})
    assert refusal_of(answer.json(), "perception")["file"] == "gains.safetensors"
    server.client.delete(f"/api/uploads/{key}")
    refusal_of(server.post("/api/jobs/drive", {**SECTION, **told}, code=422), "options.policy")


def test_a_line_has_versions_and_the_second_hand_is_told(server):
    text = server.client.get("/api/lines/yizhuang/toml").text
    assert "# Confidence of the sources" in text
    key = server.client.post("/api/uploads", files={"file": ("mine.toml", text.encode())}).json()["id"]
    faster = text.replace("[1090, 80]", "[1090, 60]")
    assert faster != text
    saved = server.client.put(f"/api/uploads/{key}", json={"toml": faster, "version": 1})
    assert saved.json()["number"] == 2, saved.text
    assert server.get(f"/api/lines/{key}")["limit_mps"]["value"][3] == pytest.approx(60 / 3.6)
    section = {**SECTION, "origin": "SJZ", "destination": "XC"}
    slow, usual = (server.post("/api/section", {**section, "line": line}) for line in (key, "yizhuang"))
    assert slow["minimum_running_time_s"] > usual["minimum_running_time_s"]
    late = server.client.put(f"/api/uploads/{key}", json={"toml": text, "version": 1})
    assert late.status_code == 409
    error = refusal_of(late.json(), "version")
    assert (error["message"], error["value"], error["allowed"]) == ("version 2 was saved meanwhile", 1, "2")
    bad = server.client.put(
        f"/api/uploads/{key}", json={"toml": text.replace("[1090, 80]", "[1090, 800]"), "version": 2}
    )
    assert bad.status_code == 422
    assert refusal_of(bad.json(), "speed_limits.values[3].speed")["value"] == 800
    other = server.client.get("/api/trainsets/dkz32/toml").text
    refusal_of(server.client.put(f"/api/uploads/{key}", json={"toml": other, "version": 2}).json(), "kind")
    assert [row["number"] for row in server.get(f"/api/uploads/{key}/versions")] == [2, 1]
    assert server.client.get(f"/api/lines/{key}/toml").text == faster
    assert server.client.get(f"/api/lines/{key}/toml?version=1").text == text
    refusal_of(server.get(f"/api/lines/{key}/toml?version=9", code=404), "version")
    refusal_of(server.get(f"/api/trainsets/{key}/toml", code=404), "trainset")
    kept = {path.name for path in (server.data / "uploads").iterdir()}
    server.client.delete(f"/api/uploads/{key}")
    assert len(kept - {path.name for path in (server.data / "uploads").iterdir()}) == 2
    refusal_of(server.get(f"/api/uploads/{key}/versions", code=404), "id")


@pytest.mark.parametrize("kind", ["drive", "live"])
def test_the_archive_of_a_run_on_an_uploaded_line_is_driven_again_anywhere(server, tmp_path, kind):
    write_line(load_line("yizhuang"), tmp_path / "mine.toml")
    text = (tmp_path / "mine.toml").read_bytes()
    key = server.client.post("/api/uploads", files={"file": ("mine.toml", text)}).json()["id"]
    asked = {**SECTION, "line": key, "time_s": 101}
    if kind == "drive":
        job = server.post("/api/jobs/drive", asked, code=202)["id"]
    else:
        job = server.post("/api/live", {**asked, "pace": 0}, code=201)["id"]
        server.post(f"/api/live/{job}/arrival", {"scheduled_time_s": 110})
        server.post(f"/api/live/{job}/restriction", {"from_m": 700, "to_m": 800, "limit_mps": 14.7})
        server.post(f"/api/live/{job}/pace", {"pace": 50})
    server.wait(job)
    server.client.delete(f"/api/uploads/{key}")
    answer = server.client.get(f"/api/jobs/{job}/files/run.zip")
    assert answer.headers["content-type"] == "application/zip"
    zipfile.ZipFile(io.BytesIO(answer.content)).extractall(tmp_path)
    folder = tmp_path / job
    assert str(server.data) not in (folder / "run.toml").read_text()
    again = [PROGRAM, "drive", "--from", folder / "run.toml", "--out", tmp_path / "again"]
    done = subprocess.run(again, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    kpis = [json.loads((place / "kpis.json").read_text()) for place in (folder, tmp_path / "again")]
    for name in ("running_time_s", "energy_wheel_kwh", "stopping_error_m", "scheduled_time_s"):
        assert kpis[0][name] == pytest.approx(kpis[1][name], abs=1e-6)


def test_a_bad_upload_names_the_field(server, tmp_path):
    write_line(load_line("yizhuang"), tmp_path / "bad.toml")
    text = (tmp_path / "bad.toml").read_text().replace('kind = "line"', 'kind = "lime"')
    answer = server.client.post("/api/uploads", files={"file": ("bad.toml", text)})
    assert answer.status_code == 422
    error = refusal_of(answer.json(), "kind")
    assert error["file"] == "bad.toml"
    assert str(server.data) not in answer.text
    large = server.client.post("/api/uploads", files={"file": ("large.toml", b"#" * 1_100_000)})
    assert large.status_code in {413, 422}
    odd = server.client.post("/api/uploads", files={"file": ("script.py", b"print()")})
    assert odd.status_code == 422


@pytest.mark.parametrize(
    "path",
    ["/", "/compare", "/journey", "/line", "/convoy", "/learn", "/lines", "/fit", "/runs", "/campaigns"],
)
def test_pages_are_there_and_load_nothing_from_elsewhere(server, path):
    answer = server.client.get(path)
    assert answer.status_code == 200
    assert "default-src 'self'" in answer.headers["content-security-policy"]
    assert "metropilot" in answer.text


def test_what_is_no_page_is_said_on_one(server):
    answers = [
        server.client.get("/nowhere", headers={"cookie": f"metropilot_language={language}"})
        for language in ("en", "zh")
    ]
    assert [answer.status_code for answer in answers] == [404, 404]
    for words, answer in zip(("no such page", "没有这个页面"), answers, strict=True):
        assert words in answer.text
    assert "HTTPException" not in answers[0].text + answers[1].text


def test_what_is_no_route_is_told_in_the_same_shape(server):
    answers = server.get("/api/nowhere", code=404), server.post("/api/nowhere", {}, code=404)
    assert [refusal_of(each, "path")["field"] for each in answers] == ["path", "path"]


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("PUT", "/api/lines", "GET"),
        ("POST", "/api/lines", "GET"),
        ("GET", "/api/plan", "POST"),
        ("DELETE", "/api/jobs/x/files/run.toml", "GET"),
        ("OPTIONS", "/api/live", "GET, POST"),
    ],
)
def test_a_route_asked_in_another_way_says_in_which(server, method, path, allowed):
    answer = server.client.request(method, path)
    assert (answer.status_code, answer.headers["allow"]) == (405, allowed)
    error = refusal_of(answer.json(), "method")
    assert (error["value"], error["allowed"]) == (method, allowed)


@pytest.mark.parametrize(
    ("kind", "body", "code", "field"),
    [
        ("text/plain", b"hello", 415, "Content-Type"),
        ("text/plain", b'{"line": "yizhuang"}', 415, "Content-Type"),
        ("application/x-www-form-urlencoded", b"line=yizhuang", 415, "Content-Type"),
        ("application/octet-stream", b"\xff\x00", 415, "Content-Type"),
        ("application/json", b"{bad", 422, "body"),
        ("application/json", b"[1]", 422, "body"),
        ("application/json", b"", 422, "body"),
    ],
)
def test_a_body_that_is_not_json_is_told_in_one_line(server, kind, body, code, field):
    answer = server.client.post("/api/plan", content=body, headers={"Content-Type": kind})
    assert answer.status_code == code
    error = refusal_of(answer.json(), field)
    assert "\n" not in error["message"]
    assert "b'" not in answer.text
    assert error["value"] == (kind if code == 415 else "[1]" if body == b"[1]" else None)


def test_the_api_is_described_on_a_page_that_needs_nothing_else(server):
    answer = server.client.get("/api/docs")
    assert answer.headers["content-type"].startswith("text/html")
    document = server.get("/api/openapi.json")
    for path in document["paths"]:
        assert f"<code>{path}</code>" in answer.text
    for name in document["components"]["schemas"]:
        assert f'id="{name}"' in answer.text
    assert not re.search(r"<(script|img|link|iframe)|https?://|url\(", answer.text)


def test_every_route_has_an_example_that_works(server):
    document = server.get("/api/openapi.json")
    schemas = document["components"]["schemas"]
    shown = html.unescape(server.client.get("/api/docs").text)
    known, tried = {"$UPLOAD", "$JOB", "$LIVE", "$RUN", "$OTHER", "$PROJECT"}, set()
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            call = command(method, path, operation, schemas)
            assert call in shown, (method, path)
            target = re.search(r"\$URL(\S+)", call)[1]
            body = re.search(r"--json '(.*)'", call)
            if any(name in target for name in known) or re.search(
                r"/jobs/(fit|learn|study)$|/live$|/convoys$|/running-lines$", target
            ):
                continue  # not there, minutes long, or (running lines) tried below
            if "-F" in call or "/studies/" in target:
                continue
            answer = server.client.request(method, target, json=json.loads(body[1]) if body else None)
            assert answer.status_code < 300, (call, answer.text)
            tried.add(target)
    assert {"/api/plan", "/api/journey", "/api/jobs/line", "/api/lines/yizhuang/toml"} <= tried
    for job in server.get("/api/jobs"):
        server.post(f"/api/jobs/{job['id']}/stop")


def test_the_example_of_a_running_line_works(server):
    """The one example that is answered at once but takes ten seconds."""
    document = server.get("/api/openapi.json")
    operation = document["paths"]["/api/running-lines"]["post"]
    call = command("post", "/api/running-lines", operation, document["components"]["schemas"])
    live = server.post("/api/running-lines", json.loads(re.search(r"--json '(.*)'", call)[1]), code=201)
    assert live["id"].startswith("live-")
    server.post(f"/api/live/{live['id']}/stop")


@pytest.mark.parametrize(
    "name",
    [
        "ArrivalIn",
        "CompareIn",
        "ConvoyIn",
        "FitIn",
        "LearnIn",
        "Lever",
        "LiveIn",
        "NewLink",
        "Pace",
        "StudyIn",
    ],
)
def test_an_example_is_a_body_that_is_allowed(name):
    kind = getattr(requests, name)
    assert isinstance(kind.model_validate(kind.model_json_schema()["examples"][0]), kind)


def test_no_other_file_is_readable(server):
    for path in ("/api/jobs/x/files/..%2F..%2Fconsole.sqlite", "/static/../server.py", "/console.sqlite"):
        answer = server.client.get(path)
        assert answer.status_code in {404, 422}, path
        assert b"SQLite" not in answer.content


@pytest.mark.parametrize(
    ("method", "path", "body", "field", "allowed"),
    [
        ("POST", "/api/jobs/compare", '{"seeds": 51}', "seeds", "<= 50"),
        ("POST", "/api/jobs/drive", '{"seed": 9223372036854775808}', "seed", "< 9223372036854775808"),
        ("POST", "/api/jobs/drive", '{"time_s": 1e400}', "time_s", "a finite number"),
        ("POST", "/api/jobs/drive", '{"time_s": [1]}', "time_s", "a number"),
        ("POST", "/api/jobs/drive", '{"trainset": "../x"}', "trainset", "letters, digits, - and _"),
        (
            "POST",
            "/api/jobs/drive",
            '{"options": {"a": null}}',
            "options.a",
            "true or false or a whole number",
        ),
        ("POST", "/api/jobs/study", '{"stduy": "lu2023", "study": "lu2023"}', "stduy", "study, budget"),
        ("POST", "/api/jobs/drive", '{"seed": ' + "9" * 5000 + "}", "body", "a JSON object"),
        ("GET", "/api/jobs?limit=-1", None, "limit", ">= "),
        ("GET", "/api/jobs?sort=foo", None, "sort", "created"),
        ("GET", "/api/jobs?kind=foo", None, "kind", "drive"),
    ],
)
def test_a_refusal_says_what_is_allowed(server, method, path, body, field, allowed):
    headers = {"content-type": "application/json"}
    answer = server.client.request(method, path, content=body, headers=headers if body else {})
    assert answer.status_code in {400, 422}, answer.text
    error = refusal_of(answer.json(), field)
    assert error["allowed"].startswith(allowed), error


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"line": "nowhere"}, "line"),
        ({"driver": "manual", "options": {"speed": 3}}, "options"),
        ({"driver": "learned"}, "options.policy"),
    ],
)
def test_a_refusal_offers_what_a_request_can_send(server, body, field):
    error = refusal_of(server.post("/api/jobs/drive", body, code=422), field)
    assert "path" not in (error["allowed"] or "").lower()
    assert "--set" not in str(error)


@pytest.mark.parametrize(
    ("body", "field"),
    [
        ({"line": "nowhere"}, "line"),
        ({"line": "yizhuang", "sections": "RJ"}, "sections"),
        ({"sections": "RJ-WYJ"}, "sections"),
        ({"trainset": "nothing"}, "trainset"),
        ({"load": "AW9"}, "load"),
        ({"driver": "eitop", "line": "yizhuang"}, "task"),
    ],
)
def test_where_nothing_can_be_learned_is_refused_at_once(server, body, field):
    before = server.get("/api/jobs?kind=learn")
    error = refusal_of(server.post("/api/jobs/learn", body, code=422), field)
    assert error["value"] in {None, *body.values(), "huang2025"}
    assert server.get("/api/jobs?kind=learn") == before


def test_a_form_without_a_file_says_so(server):
    error = refusal_of(server.client.post("/api/uploads", files={"file": (None, "a text")}).json(), "file")
    assert (error["message"], error["allowed"]) == ("wrong kind of value", "a file")

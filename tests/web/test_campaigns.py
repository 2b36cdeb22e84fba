"""Campaigns over HTTP: published rows, a declared one from its start to a row that is driven again."""

import io
import time

import duckdb
import pytest
from tests.web.test_api import refusal_of

TINY = {
    "name": "tiny",
    "matrix": {
        "drivers": ["flat_out", "manual"],
        "sections": ["yizhuang RJ WYJ"],
        "loads": ["AW2"],
        "times": [1.2, 1.4],
    },
    "disturbance": [
        {
            "name": "heavy",
            "mass_factor": [1.0, 1.2],
            "restriction": {"from": 0.4, "to": 0.6, "kmh": 50, "announced": 0.2},
        }
    ],
}


def test_the_published_campaigns_are_there(server):
    rows = {row["id"]: row for row in server.get("/api/campaigns")}
    assert {"leaderboard", "robustness", "trainsets"} <= set(rows)
    found = server.get("/api/campaigns/leaderboard")
    assert len(found["drivers"]) == 19
    assert found["rows"] == rows["leaderboard"]["rows"] == 2964
    assert found["written"].startswith("Written by `metropilot campaign leaderboard")
    asked = {"driver": "optimal", "sort": "optimality_gap_percent", "ascending": "false", "limit": 3}
    told = server.get("/api/campaigns/leaderboard/rows", params=asked)
    assert told["count"] == 156
    gaps = [row["optimality_gap_percent"] for row in told["rows"]]
    assert gaps == sorted(gaps, reverse=True)
    refusal_of(server.get("/api/campaigns/leaderboard/rows?sort=nothing", code=422), "column")
    refusal_of(server.get("/api/campaigns/nowhere", code=404), "id")
    refusal_of(server.get("/api/campaigns/leaderboard/rows/99999", code=422), "row")


def test_a_campaign_is_computed_and_a_row_is_driven_again(server):
    job = server.post("/api/jobs/campaign", TINY, code=202)["id"]
    server.wait(job)
    found = server.get(f"/api/campaigns/{job}")
    assert (found["rows"], found["done"], found["status"]) == (4, 4, "done")
    assert {row["driver"] for row in found["cells"]} == {"flat_out", "manual"}
    rows = server.get(f"/api/campaigns/{job}/rows")["rows"]
    row = rows[-1]
    assert 1.0 < row["mass_factor"] < 1.2
    request = server.get(f"/api/campaigns/{job}/rows/{row['row']}")
    assert request["restrictions"][0]["limit_mps"] == pytest.approx(50 / 3.6)
    assert request["restrictions"][0]["at_s"] == pytest.approx(0.2 * row["scheduled_time_s"], abs=0.06)
    again = server.post("/api/jobs/drive", request, code=202)["id"]
    server.wait(again)
    kpis = server.get(f"/api/jobs/{again}/drive")["kpis"]
    assert kpis["energy_wheel_kwh"] == row["energy_wheel_kwh"]
    content = server.client.get(f"/api/jobs/{job}/files/results.parquet").content
    path = server.data / "taken.parquet"
    path.write_bytes(content)
    assert len(duckdb.sql(f"SELECT * FROM '{path}'").fetchall()) == 4
    assert str(server.data).encode() not in io.BytesIO(content).read()


def test_a_campaign_is_stopped_and_resumed(server):
    matrix = {**TINY["matrix"], "drivers": ["flat_out"], "sections": ["yizhuang"], "times": [1.2]}
    body = {"name": "whole line", "matrix": matrix}
    job = server.post("/api/jobs/campaign", body, code=202)["id"]
    for _ in range(600):
        if server.get(f"/api/jobs/{job}")["progress"] > 0:
            break
        time.sleep(0.1)
    server.post(f"/api/jobs/{job}/stop")
    row = server.wait(job, until=("stopped",))
    done = server.get(f"/api/campaigns/{job}/rows")["count"]
    assert 0 < done < 26
    assert "it can be resumed" in row["words"]
    assert server.post(f"/api/jobs/{job}/resume", code=202)["status"] in {"queued", "running"}
    server.wait(job)
    assert server.get(f"/api/campaigns/{job}/rows")["count"] == 26


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"sections": ["/etc/passwd.toml A B"]}, "matrix.sections"),
        ({"sections": ["../secret.toml"]}, "matrix.sections"),
        ({"sections": ["yizhuang RJ"]}, "matrix.sections"),
        ({"sections": ["yizhuang '"]}, "matrix.sections"),
        ({"trainsets": ["x/y.toml"]}, "matrix.trainsets"),
        ({"trainsets": {"drawn": 1_000_000}}, "matrix.trainsets"),
        ({"drivers": ["learned:policy=/etc/passwd"]}, "matrix.drivers"),
        ({"drivers": ["learned:policy=nobody"]}, "options.policy"),
        ({"drivers": ["optimall"]}, "matrix.drivers"),
        ({"drivers": ["manual"] * 41}, "matrix.drivers"),
        ({"seeds": 1_000_000}, "matrix"),
        ({"colour": 1}, "matrix.colour"),
    ],
)
def test_a_campaign_that_cannot_be_computed_is_refused_at_once(server, changes, field):
    body = {**TINY, "matrix": {**TINY["matrix"], **changes}}
    error = refusal_of(server.post("/api/jobs/campaign", body, code=422), field)
    assert str(server.data) not in str(error)


def test_the_page_of_a_study_has_verdicts_rows_and_figures(server):
    found = server.get("/api/studies/lu2023/page")
    assert found["verdicts"][0]["verdict"] in {"beaten", "matched", "missed"}
    assert len(found["rows"]) > 100
    figure = server.client.get(f"/api/studies/lu2023/figures/{found['figures'][0]['name']}")
    assert figure.headers["content-type"] == "image/png"
    refusal_of(server.get("/api/studies/lu2023/figures/other.png", code=404), "figure")
    refusal_of(server.get("/api/studies/nobody/page", code=404), "study")

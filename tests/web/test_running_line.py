"""A running line over HTTP: watched, disturbed, paced, stopped and resumed."""

import csv
import io

from tests.web.test_api import refusal_of
from tests.web.test_live import pace, watch

LINE = {"line": "yizhuang", "headway_s": 240, "pace": 100, "lasts_s": 900}


def rows_of(seen):
    return [row for _, kind, data in seen if kind == "rows" for row in data["rows"]]


def after(seconds):
    return lambda kind, data: kind == "rows" and data["rows"] and data["rows"][-1][0] >= seconds


def test_a_delay_is_injected_and_watched_to_the_end(server):
    live = server.post("/api/running-lines", LINE, code=201)["id"]
    seen = watch(server, live, until=after(60))
    pace(server, live, 0)
    scene = next(data for _, kind, data in seen if kind == "scene")
    assert (scene["headway_s"], len(scene["stops"])) == (240, 14)
    server.post(f"/api/live/{live}/hold", {"station": "RJ", "hold_s": 200})
    server.post(
        f"/api/live/{live}/slow", {"station": "JHL", "backward": True, "limit_mps": 8, "lasts_s": 300}
    )
    refused = server.post(f"/api/live/{live}/hold", {"station": "nowhere"}, code=422)
    refusal_of(refused, "station")
    assert refused["error"]["allowed"].startswith("SJZ, ")
    refusal_of(server.post(f"/api/live/{live}/hold", {"station": "RJ", "hold_s": 0}, code=422), "hold_s")
    refusal_of(server.post(f"/api/live/{live}/arrival", {"scheduled_time_s": 5}, code=422), "kind")
    server.post(f"/api/live/{live}/stop")
    resumed = server.post(f"/api/live/{live}/resume", code=201)
    assert resumed["status"] == "running"
    rest = watch(server, live)
    words = [data["words"] for _, kind, data in rest if kind == "event"]
    assert any("is held" in text and text.endswith("for 200 s") for text in words)
    assert any(text.endswith("29 km/h for 300 s") for text in words)
    rows = rows_of(rest)
    assert [row[-1] for row in rows] == list(range(1, 181)), "all of them, once, after it was resumed"
    before = rows_of(seen)
    assert [row[:4] for row in rows[: len(before)]] == [row[:4] for row in before], "the same again"
    trains = scene["trains"]
    assert all(len(row[1]) == len(row[2]) == trains for row in rows)
    assert max(rows[0][2]) == 0
    assert 150 < max(max(row[2]) for row in rows) <= 260
    told = server.get(f"/api/live/{live}/line")
    assert (told["time_s"], told["trains"]) == (900, trains)
    assert told["energy_kwh"] > told["floor_kwh"] > 0
    row = server.get(f"/api/jobs/{live}")
    assert row["status"] == "done"
    assert row["summary"]["energy_kwh"] == told["energy_kwh"]
    text = server.client.get(f"/api/jobs/{live}/files/delays.csv").text
    table = list(csv.reader(io.StringIO(text)))
    assert len(table) == 181
    assert len(table[0]) == trains + 1
    refusal_of(server.get(f"/api/jobs/{live}/drive", code=404), "id")


def test_what_no_line_can_is_refused(server):
    for change, field in (
        ({"line": "nowhere"}, "line"),
        ({"headway_s": 20}, "headway_s"),
        ({"zones": 90}, "zones"),
        ({"lasts_s": 5}, "lasts_s"),
    ):
        error = refusal_of(server.post("/api/running-lines", {**LINE, **change}, code=422), field)
        assert error["allowed"] or "should be" in error["message"], error
        assert "\n" not in error["message"]
    job = server.post("/api/live", {"line": "yizhuang", "pace": 0, "time_s": 101}, code=201)["id"]
    no_line = refusal_of(server.get(f"/api/live/{job}/line", code=404), "id")
    assert no_line["value"] == job
    assert refusal_of(server.post(f"/api/live/{job}/hold", {"station": "RJ"}, code=422), "kind")["message"]
    server.post(f"/api/live/{job}/stop")

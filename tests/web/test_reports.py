"""Reports as PDF: what they say, their pages, and who gets one."""

import re

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from metropilot.web.work.reports import WIDTH_IN, report_of

SECTION = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 120}
SLOW = [{"from_m": 500, "to_m": 700, "limit_mps": 10}]


@pytest.fixture(scope="module")
def jobs(server):
    """A drive, a comparison and a journey that are over."""
    driven = {**SECTION, "driver": "flat_out", "mass_factor": 1.1, "restrictions": SLOW}
    made = {
        "drive": server.post("/api/jobs/drive", driven, code=202)["id"],
        "compare": server.post("/api/jobs/compare", {**SECTION, "drivers": ["optimal", "manual"]}, code=202)[
            "id"
        ],
        "journey": server.post("/api/jobs/journey", {"line": "yizhuang"}, code=201)["id"],
    }
    for job in made.values():
        server.wait(job)
    return made


@pytest.mark.parametrize("kind", ["drive", "compare", "journey"])
def test_a_report_is_a_pdf_on_a4(server, jobs, kind):
    answer = server.client.get(f"/api/jobs/{jobs[kind]}/files/report.pdf")
    assert answer.status_code == 200
    assert answer.headers["content-type"] == "application/pdf"
    assert answer.content.startswith(b"%PDF-")
    boxes = re.findall(rb"/MediaBox \[ 0 0 (\S+) (\S+) \]", answer.content)
    assert len(boxes) >= 2
    assert all((round(float(w)), round(float(h))) == (595, 842) for w, h in boxes)


def test_a_report_says_what_the_run_was(server, jobs, tmp_path):
    driven = server.get(f"/api/jobs/{jobs['drive']}/drive")
    about = {
        "id": jobs["drive"],
        "name": "With a restriction",
        "created": "2026-11-25T10:40:00",
        "request": {"line": "yizhuang", "restrictions": SLOW, "time_s": 120.0, "load": None},
        "made_with": {"metropilot": "0.1.0", "commit": "abc"},
    }
    sheets = report_of("drive", about, driven, str(tmp_path))
    texts = [each.get_text() for figure in sheets.figures for each in figure.texts]
    kpis = driven["kpis"]
    wanted = {
        "With a restriction",
        "Drive of 2026-11-25 10:40 UTC.",
        f"{kpis['running_time_s']:.1f} s",
        f"{kpis['energy_wheel_kwh']:.2f} kWh",
        "from_m 500, to_m 700, limit_mps 10",
        "120",
        "abc",
        "mostly bound by",
    }
    assert wanted <= set(texts)
    assert "load" not in texts
    assert texts.count("FAILED") == sum(not check["passed"] for check in driven["checks"])
    for figure in sheets.figures:
        renderer = FigureCanvasAgg(figure).get_renderer()
        spans = [each.get_window_extent(renderer) for each in figure.texts]
        assert max(span.x1 for span in spans) < WIDTH_IN * figure.dpi
        assert min(span.y0 for span in spans) > 0


def test_other_jobs_and_unknown_ones_have_no_report(server, jobs):
    assert server.client.get("/api/jobs/none/files/report.pdf").status_code == 404
    convoy = server.post("/api/convoys", {**SECTION, "trainsets": 2, "pace": 0}, code=201)["id"]
    server.post(f"/api/live/{convoy}/stop")
    refused = server.client.get(f"/api/jobs/{convoy}/files/report.pdf")
    assert (refused.status_code, refused.json()["error"]["message"]) == (404, "the job is a convoy")
    found = server.client.get(f"/api/jobs/{jobs['drive']}/files/other.pdf")
    assert found.status_code == 422

"""The page Runs: find, sort, name, open, stop, resume, compare two, delete."""

import re

import pytest
from playwright.sync_api import expect
from tests.web.program import Server

PATIENCE_MS = 60_000
PROJECT = re.compile(r"project=(project-[0-9a-f]{8})")


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A server without the runs of other tests."""
    made = Server(tmp_path_factory.mktemp("runs"))
    yield made
    made.close()


@pytest.fixture(scope="module")
def driven(server):
    """Two drives of a section, and a live run that waits."""
    section = {"line": "yizhuang", "origin": "XHM", "destination": "JG", "time_s": 150}
    found = [
        server.post("/api/jobs/drive", {**section, "driver": name}, code=202)["id"]
        for name in ("manual", "flat_out")
    ]
    live = server.post("/api/live", {**section, "pace": 0}, code=201)["id"]
    for job in found:
        server.wait(job)
    return [*found, live]


def press_until(button, row, words):
    """Press a heading until a row says so: a table that is filled at that moment loses the press."""
    for _ in range(5):
        button.press("Enter")
        for _ in range(20):
            if words in row.inner_text():
                return
            button.page.wait_for_timeout(50)
    expect(row).to_contain_text(words)


@pytest.mark.parametrize("width", [1440, 390])
def test_runs_are_found_named_compared_and_deleted(visit, server, driven, width):
    body = {
        "line": "yizhuang",
        "origin": "XHM",
        "destination": "JG",
        "driver": "flat_out",
        "time_s": 140 + width,
    }
    unwanted = server.post("/api/jobs/drive", body, code=202)["id"]
    server.wait(unwanted)
    page = visit("/runs", width=width, height=900)
    rows = page.locator('[aria-label="Runs"] tbody tr').filter(has_text="XHM – JG")
    page.get_by_label("Find in Runs").fill("XHM")
    expect(rows).to_have_count(4)
    sort = page.get_by_role("button", name="Sort by Energy (kWh)")
    press_until(sort, rows.last, "flat_out")
    press_until(sort, rows.first, "flat_out")
    manual = rows.filter(has_text="manual")
    manual.get_by_role("button", name=re.compile("^Name ")).click()
    page.get_by_label("Name", exact=True).fill(f"By hand {width}")
    page.get_by_role("button", name="Keep").click()
    expect(manual).to_contain_text(f"By hand {width}")
    assert server.get(f"/api/jobs/{driven[0]}")["name"] == f"By hand {width}"
    live = rows.filter(has_text="optimal")
    live.get_by_role("button", name=re.compile("^Stop ")).click()
    expect(live).to_contain_text("stopped", timeout=PATIENCE_MS)
    compare = page.locator('[data-test="compare-two"]')
    expect(compare).to_be_disabled()
    manual.get_by_role("checkbox").click()
    live.get_by_role("checkbox").click()
    compare.click()
    expect(page.locator('[data-test="problem"]')).to_contain_text("no result: the job is stopped")
    live.get_by_role("checkbox").click()
    rows.filter(has_text=" 150 s").filter(has_text="flat_out").get_by_role("checkbox").click()
    compare.click()
    kpis = page.get_by_role("table", name="KPIs of two runs").get_by_role("row")
    expect(kpis.nth(1)).to_contain_text("running time (s)", timeout=PATIENCE_MS)
    before, after, change = (
        float(kpis.nth(1).get_by_role("cell").nth(k).inner_text().replace("−", "-")) for k in (1, 2, 3)
    )
    assert change == pytest.approx(after - before, abs=0.11)
    assert change < -5
    page.wait_for_url(re.compile(rf"run={driven[0]}&with={driven[1]}"))
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for row in (manual, rows.filter(has_text=" 150 s").filter(has_text="flat_out")):
        row.get_by_role("checkbox").click()
    rows.filter(has_text=f"{140 + width} s").get_by_role("checkbox").click()
    page.locator('[data-test="delete"]').click()
    page.locator('[data-test="delete-sure"]').click()
    expect(rows).to_have_count(3)
    server.get(f"/api/jobs/{unwanted}", code=404)
    live.get_by_role("button", name=re.compile("^Resume ")).click()
    expect(page.locator('[data-test="live"]')).to_have_attribute(
        "data-status", "running", timeout=PATIENCE_MS
    )
    assert page.url.endswith(f"/?run={driven[2]}")


def test_a_run_is_opened_again(visit, driven):
    page = visit(f"/?run={driven[1]}")
    kpis = page.get_by_role("table", name="KPIs")
    expect(kpis).to_contain_text("scheduled 150 s", timeout=PATIENCE_MS)
    expect(page.locator('[data-test="resume"]')).to_be_hidden()
    why = page.locator('[data-test="why"]')
    expect(why).to_contain_text(
        re.compile(r"Bound by .*effort \d+ %.*Above the optimum: .* % driver, most of it in")
    )
    expect(why).to_contain_text("Protection never stepped in")
    expect(page.get_by_role("table", name="Regimes").get_by_role("row")).not_to_have_count(1)
    page.wait_for_function("document.querySelector('[data-test=explanation]')?.data", timeout=PATIENCE_MS)
    drawn = page.evaluate("document.querySelector('[data-test=explanation]').data.map(t => t.name)")
    assert {"driven", "lost by the trainset", "lost by the driver", "effort", "speed limit"} <= set(drawn)
    bands = page.evaluate("document.querySelector('[data-test=explanation]').layout.shapes.length")
    assert bands > 3


@pytest.mark.parametrize("width", [1440, 390])
def test_the_worth_of_a_second_and_a_learned_drivers_features_are_shown(visit, server, width):
    body = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "driver": "ppo", "time_s": 105}
    job = server.post("/api/jobs/drive", body, code=202)["id"]
    server.wait(job)
    page = visit(f"/?run={job}", width=width, height=900)
    worth = page.get_by_role("table", name="Worth of a second")
    expect(worth).to_be_visible(timeout=PATIENCE_MS)
    rows = [row.get_by_role("cell").all_inner_texts() for row in worth.get_by_role("row").all()[1:]]
    powered, coasting = rows[2], rows[10]
    assert 0.15 < float(powered[3]) <= float(powered[2]) <= float(powered[4]) < 0.3
    assert float(coasting[3]) == 0.0 < float(coasting[4])
    features = page.get_by_role("table", name="Strongest features")
    first = features.get_by_role("row").nth(1)
    expect(first).to_contain_text(re.compile(r"speed \+0\.\d\d; "))
    expect(page.get_by_text("how far each speaks for more power")).to_be_visible()
    page.wait_for_function("document.querySelector('[data-test=explanation]')?.data", timeout=PATIENCE_MS)
    drawn = page.evaluate("document.querySelector('[data-test=explanation]').data.map(t => t.name)")
    assert {"a second more saves", "a second less costs"} <= set(drawn)
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_a_journey_is_opened_again(visit, server):
    asked = {"line": "yizhuang", "total_s": 1200, "destination": "RJ", "load": "AW2"}
    job = server.post("/api/jobs/journey", asked, code=201)["id"]
    page = visit(f"/journey?job={job}")
    expect(page.locator('[data-test="sections"] tbody tr')).to_have_count(7, timeout=PATIENCE_MS)
    expect(page.get_by_label("Whole journey")).to_have_value("1200")
    expect(page.locator('[data-test="summary"]')).to_contain_text("20 min 00 s")
    assert f"job={job}" in page.url


@pytest.mark.parametrize("width", [1440, 390])
def test_a_project_is_filled_exported_and_imported(visit, server, tmp_path, width):
    body = {
        "line": "yizhuang",
        "origin": "XC",
        "destination": "XHM",
        "driver": "flat_out",
        "time_s": 100 + width,
    }
    job = server.post("/api/jobs/drive", body, code=202)["id"]
    server.wait(job)
    page = visit("/runs?find=XC+%E2%80%93+XHM", width=width, height=900)
    rows = page.locator('[aria-label="Runs"] tbody tr').filter(has_text=f"{100 + width} s")
    expect(page.get_by_label("Find in Runs")).to_have_value("XC – XHM", timeout=PATIENCE_MS)
    page.locator('[data-test="new-project"]').click()
    card = page.locator('[data-test="project"]')
    page.get_by_label("Name of the project").fill(f"Tender {width}")
    page.get_by_label("Notes").fill("Two lines\nof notes")
    page.get_by_label("Notes").blur()
    expect(rows).to_have_count(0)
    page.get_by_role("combobox", name="Project", exact=True).click()
    page.get_by_role("option", name="every run").click()
    rows.get_by_role("checkbox").click()
    page.locator('[data-test="move"]').click()
    page.get_by_role("combobox", name="To project").click()
    page.get_by_role("option", name=f"Tender {width}").click()
    page.get_by_role("button", name="Move", exact=True).click()
    page.get_by_role("combobox", name="Project", exact=True).click()
    page.get_by_role("option", name=f"Tender {width}").click()
    expect(rows).to_have_count(1)
    page.wait_for_url(re.compile(rf"{PROJECT.pattern}&find=XC"))
    begun = PROJECT.search(page.url)[1]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.reload()
    expect(page.get_by_label("Notes")).to_have_value("Two lines\nof notes", timeout=PATIENCE_MS)
    expect(rows).to_have_count(1)
    with page.expect_download() as saved:
        card.get_by_role("link", name="Export").click(modifiers=["Alt"])
    saved.value.save_as(tmp_path / "tender.zip")
    page.locator('[data-test="import"]').click()
    (tmp_path / "bad.zip").write_bytes(b"PK nothing")
    page.locator('input[type="file"]').set_input_files(tmp_path / "bad.zip")
    expect(page.get_by_text("not a readable ZIP archive")).to_be_visible(timeout=PATIENCE_MS)
    page.locator('input[type="file"]').set_input_files(tmp_path / "tender.zip")
    expect(page.get_by_text("Import a project")).to_be_hidden(timeout=PATIENCE_MS)
    page.wait_for_url(lambda url: PROJECT.search(url)[1] != begun)
    expect(rows).to_have_count(1)
    imported = PROJECT.search(page.url)[1]
    found = server.get(f"/api/projects/{imported}")
    assert (found["name"], len(found["jobs"])) == (f"Tender {width}", 1)
    assert found["jobs"] != [job]

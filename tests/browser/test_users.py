"""A shared server: runs that wait in a queue, who began what, and a viewer who changes nothing."""

import re

import pytest
from playwright.sync_api import expect
from tests.web.program import Server

PATIENCE_MS = 60_000
SECTION = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101, "pace": 0}
ANNA, VERA = "a" * 20, "v" * 20


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """A server of two named users, one of whom reads only."""
    data = tmp_path_factory.mktemp("shared")
    path = data / "users.txt"
    path.write_text(f"anna = {ANNA}, user\nvera = {VERA}, viewer\n")
    made = Server(data, "--users", path)
    made.client.headers["Authorization"] = f"Bearer {ANNA}"
    yield made
    made.close()


@pytest.fixture
def full(server):
    """Every place of the live runs taken."""
    lives = [server.post("/api/live", SECTION, code=201)["id"] for _ in range(4)]
    yield lives
    for row in server.get("/api/live"):
        if row["status"] in {"queued", "running"}:
            server.post(f"/api/live/{row['id']}/stop")


@pytest.mark.parametrize("width", [1440, 390])
def test_a_run_waits_for_its_place_and_starts_by_itself(visit, server, full, width):
    page = visit(f"/?token={ANNA}", width=width, height=900)
    expect(page.locator('[data-test="user"]')).to_have_text("anna")
    page.locator('[data-test="depart"]').click()
    live = page.locator('[data-test="live"]')
    expect(live).to_have_attribute("data-status", "queued", timeout=PATIENCE_MS)
    status = page.locator('[data-mp="status"]')
    expect(status).to_have_text("waiting: place 1 in the queue; it starts by itself")
    run = re.search(r"run=(live-[\w-]+)", page.url)[1]
    mine = page.locator(f'.mp-run[data-run="{run}"]')
    expect(mine).to_contain_text("waits: place 1 in the queue")
    expect(mine).to_contain_text("· anna")
    second = server.post("/api/live", SECTION, code=201)
    assert second["place"] == 2
    expect(page.locator(f'.mp-run[data-run="{second["id"]}"]')).to_contain_text("waits: place 2 in the queue")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.locator(f'.mp-run[data-run="{second["id"]}"]').get_by_role(
        "button", name=re.compile("^Cancel ")
    ).click()
    expect(page.locator(f'.mp-run[data-run="{second["id"]}"]')).to_contain_text("stopped: not started")
    page.locator(f'.mp-run[data-run="{full[0]}"]').get_by_role("button", name=re.compile("^Stop ")).click()
    expect(live).to_have_attribute("data-status", "running", timeout=PATIENCE_MS)
    expect(status).to_have_text("under way")
    page.wait_for_function("+document.querySelector('[data-test=live]').dataset.position > 1")


@pytest.mark.parametrize("width", [1440, 390])
def test_a_viewer_sees_everything_and_changes_nothing(visit, server, width):
    body = {name: value for name, value in SECTION.items() if name != "pace"}
    job = server.post("/api/jobs/drive", {**body, "driver": "flat_out", "time_s": 100 + width}, code=202)
    server.wait(job["id"])
    live = server.post("/api/live", SECTION, code=201)["id"]
    server.post("/api/projects", {"name": f"Tender {width}"}, code=201)
    page = visit(f"/?token={VERA}&run={live}", width=width, height=900, expected=("403 (Forbidden)",))
    note = page.locator('[data-test="reads-only"]')
    expect(note).to_have_text(
        "You are signed in as vera, who reads only: everything can be looked at, nothing changed."
    )
    expect(page.locator('[data-test="live"]')).to_have_attribute("data-status", "running")
    for name in ("depart", "stop", "tell-arrival", "restrict"):
        expect(page.locator(f'[data-test="{name}"]')).to_be_disabled()
    expect(page.locator('[data-mp="take"]')).to_be_disabled()
    expect(page.locator('[data-test="stop"]')).to_have_attribute("title", "vera reads only")
    expect(page.locator(f'.mp-run[data-run="{live}"]').get_by_role("button")).to_be_disabled()
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.goto(server.url + "/runs")
    rows = page.locator('[aria-label="Runs"] tbody tr')
    row = rows.filter(has_text=f"{100 + width} s")
    expect(row).to_have_count(1, timeout=PATIENCE_MS)
    if width > 600:
        expect(row).to_contain_text("anna")
    expect(row.get_by_role("button")).to_have_count(0)
    row.get_by_role("checkbox").click()
    for name in ("delete", "move", "new-project", "import"):
        expect(page.locator(f'[data-test="{name}"]')).to_be_disabled()
    page.get_by_role("combobox", name="Project", exact=True).click()
    page.get_by_role("option", name=f"Tender {width}").click()
    card = page.locator('[data-test="project"]')
    expect(card).to_contain_text("Begun by anna.")
    expect(page.get_by_label("Name of the project")).to_be_disabled()
    for path in ("/compare", "/journey", "/line", "/convoy", "/learn", "/lines", "/campaigns", "/fit"):
        page.goto(server.url + path)
        expect(note).to_be_visible(timeout=PATIENCE_MS)
    page.goto(f"{server.url}/?run={job['id']}")
    expect(page.get_by_role("table", name="KPIs")).to_be_visible(timeout=PATIENCE_MS)
    # a page that would enable its buttons by hand is refused by the server all the same
    page.evaluate(f"fetch('/api/live/{live}/stop', {{method: 'POST'}}).then(a => window.told = a.status)")
    page.wait_for_function("window.told === 403")
    assert server.get(f"/api/live/{live}")["status"] == "running"
    server.post(f"/api/live/{live}/stop")

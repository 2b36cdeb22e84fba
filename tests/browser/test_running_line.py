"""The live train graph of the page Line: run, hold a train, slow a section, stop, resume."""

import re

import pytest
from playwright.sync_api import expect
from tests.web.program import Server

PATIENCE_MS = 90_000


@pytest.mark.parametrize("width", [1440, 390])
def test_a_delay_is_watched_on_the_train_graph(visit, server, width):
    page = visit("/line", width=width, height=900)
    page.get_by_label("Headway (s)", exact=True).fill("240")
    page.get_by_label("Headway (s)", exact=True).blur()
    card = page.locator('[data-test="running"]')
    page.locator('[data-test="hold"]').click()
    expect(page.locator('[data-test="running-problem"]')).to_have_text("no line is running; press Run")
    page.locator('[data-test="run-line"]').click()
    expect(card).to_have_attribute("data-status", "running", timeout=PATIENCE_MS)
    page.wait_for_function("+document.querySelector('[data-test=running]').dataset.time > 30")
    page.locator('[data-test="hold"]').click()
    log = card.locator('[data-mp="log"] li')
    expect(log.filter(has_text="is held at")).to_contain_text("for 120 s")
    page.locator('[data-test="slow"]').click()
    expect(log.filter(has_text="25 km/h for 600 s")).to_have_count(1)
    page.wait_for_function(
        "+document.querySelector('[data-test=running]').dataset.late > 0", timeout=PATIENCE_MS
    )
    expect(card.locator('[data-mp="late"]')).to_contain_text(re.compile(r"[1-9]\d* of 19"))
    drawn = page.evaluate("document.querySelector('[data-test=running-graph]').data.map(t => t.x.length)")
    assert drawn[0] > 100
    assert drawn[1] + drawn[2] > 0, "late trains have colours of their own"
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    run = re.search(r"/line\?run=(live-[\w-]+)", page.url)[1]
    page.get_by_role("combobox", name="At station").click()
    page.get_by_role("option", name=re.compile("^YZHC ")).click()
    page.locator('[data-test="hold"]').click()
    expect(page.get_by_text("no trip begins there (allowed: ")).to_be_visible()
    page.locator('[data-test="stop-line"]').click()
    expect(card).to_have_attribute("data-status", "stopped", timeout=PATIENCE_MS)
    page.goto(f"{server.url}/?run={run}")
    page.wait_for_url(f"**/line?run={run}")
    expect(page.get_by_label("Headway (s)", exact=True)).to_have_value("240", timeout=PATIENCE_MS)
    page.locator('[data-test="resume-line"]').click()
    expect(card).to_have_attribute("data-status", "running", timeout=PATIENCE_MS)
    expect(log.filter(has_text="is held at")).to_have_count(1)
    page.locator('[data-test="stop-line"]').click()
    expect(card).to_have_attribute("data-status", "stopped", timeout=PATIENCE_MS)
    page.goto(f"{server.url}/runs?find=every+240")
    expect(page.locator('[aria-label="Runs"] tbody tr').first).to_contain_text("yizhuang · every 240 s")


def test_a_line_that_is_over_shows_its_graph(browser, tmp_path):
    """After the server was restarted there is no stream of it any more, only what was kept."""
    served = Server(tmp_path)
    body = {"line": "yizhuang", "headway_s": 300, "pace": 100, "lasts_s": 120}
    run = served.post("/api/running-lines", body, code=201)["id"]
    served.wait(run)
    served.kill()
    served = Server(tmp_path)
    page = browser.new_page()
    try:
        page.goto(f"{served.url}/line?run={run}")
        expect(page.locator('[data-test="running"]')).to_have_attribute("data-status", "done")
        graph = "document.querySelector('[data-test=running-graph]')"
        page.wait_for_function(f"{graph}.data?.[0].x.length > 100", timeout=PATIENCE_MS)
        assert page.evaluate(f"{graph}.layout.yaxis.ticktext.length") == 14
        expect(page.locator('[data-test="running-result"]')).to_contain_text("trains in 2 min")
    finally:
        page.close()
        served.close()

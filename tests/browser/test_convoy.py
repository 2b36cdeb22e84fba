"""The page Convoy: depart, a link that falls silent, KPIs of every trainset."""

import pytest
from playwright.sync_api import expect
from tests.browser.test_drive import choose, number, until


@pytest.mark.parametrize("width", [1440, 390])
def test_a_convoy_whose_link_falls_silent(visit, width):
    page = visit("/convoy", width=width)
    expect(page.get_by_text("minimum 83.3 s")).to_be_visible()
    choose(page, "Pace", "5 ×")
    page.locator('[data-test="depart"]').click()
    convoy = page.locator('[data-test="convoy"]')
    expect(convoy).to_have_attribute("data-status", "running")
    until(lambda: float(convoy.get_attribute("data-time") or 0) > 15)
    expect(page.locator(".mp-convoy rect")).to_have_count(3)
    close = number(page, "gap")
    assert 3 < close < 40
    page.locator('[data-test="silent"]').click()
    expect(page.locator('[data-mp="log"]')).to_contain_text("the link is silent")
    expect(page.locator('[data-mp="link"]')).to_have_text("silent")
    choose(page, "Pace", "10 ×")
    until(lambda: number(page, "age") > 5)
    expect(convoy).to_have_attribute("data-status", "done", timeout=240_000)
    seen = "el => el.scrollWidth <= el.clientWidth || el.scrollLeft > el.clientWidth / 2"
    assert convoy.locator(".mp-strip").evaluate(seen), "the strip follows the trainsets"
    result = page.locator('[data-test="result"]')
    expect(result.get_by_role("row", name="no contact")).to_contain_text("✓ passed")
    expect(result.locator('[aria-label="Trainsets"] tbody tr')).to_have_count(3)
    assert number(page, "least") > 0
    expect(result.get_by_role("link", name="trajectories.zip")).to_be_visible()


def test_a_link_to_a_convoy_restores_all_of_it(visit, server):
    asked = {
        "line": "yizhuang",
        "origin": "XHM",
        "destination": "JG",
        "time_s": 200,
        "load": "AW3",
        "trainsets": 2,
        "gap_m": 8,
        "link_loss": 0.2,
        "guard": "independent",
        "pace": 20,
    }
    run = server.post("/api/convoys", asked, code=201)["id"]
    server.wait(run)
    page = visit(f"/convoy?run={run}")
    expect(page.locator('[data-test="convoy"]')).to_have_attribute("data-status", "done")
    for label, value in (("Trainsets", "2"), ("Desired gap (m)", "8"), ("Lost (%)", "20")):
        until(
            lambda label=label, value=value: (
                float(page.get_by_role("spinbutton", name=label).input_value()) == float(value)
            )
        )
    shown = {"From": "XHM · Xiaohongmen", "To": "JG · Jiugong", "Load": "AW3 · 307 t"}
    for label, value in shown.items():
        expect(page.get_by_role("combobox", name=label, exact=True)).to_have_value(value)
    expect(page.get_by_text("Running time 200 s")).to_be_visible()
    expect(page.locator(".mp-strip")).to_contain_text("Xiaohongmen")
    expect(page.locator(".mp-convoy rect")).to_have_count(2)
    page.get_by_role("spinbutton", name="Trainsets").fill("1")
    page.locator('[data-test="depart"]').click()
    field = page.locator("label").filter(has_text="Trainsets")
    expect(field).to_contain_text("out of range (allowed: 2 to 6)")

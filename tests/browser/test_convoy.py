"""The page Convoy: depart, a link that falls silent, KPIs of every trainset."""

from playwright.sync_api import expect
from tests.browser.test_drive import choose, number, until


def test_a_convoy_whose_link_falls_silent(visit):
    page = visit("/convoy")
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
    result = page.locator('[data-test="result"]')
    expect(result.get_by_role("row", name="no contact")).to_contain_text("✓ passed")
    expect(result.locator('[aria-label="Trainsets"] tbody tr')).to_have_count(3)
    assert number(page, "least") > 0

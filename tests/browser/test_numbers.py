"""Either decimal mark in the fields and tables of the pages, by keyboard and by paste."""

import re

import pytest
from playwright.sync_api import expect

PATIENCE_MS = 90_000


@pytest.mark.parametrize("locale", ["en-US", "zh-CN"])
def test_a_comma_is_a_decimal_mark_in_every_browser(browser, server, locale):
    context = browser.new_context(locale=locale)
    page = context.new_page()
    page.goto(f"{server.url}/convoy")
    gap = page.locator("input[role=spinbutton]").nth(1)
    expect(page.get_by_text("83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    gap.click()
    gap.press("Control+a")
    page.keyboard.type("7,25")
    page.keyboard.press("Tab")
    expect(gap).to_have_value("7,25")
    gap.press("ArrowUp")
    expect(gap).to_have_value("8.25")
    gap.press("Control+a")
    page.keyboard.type("1,234")
    field = page.locator(".q-field").filter(has=page.locator(f"id={gap.get_attribute('id')}")).last
    expect(field).to_contain_text("1234")
    expect(field).to_contain_text("1.234")
    page.locator("[data-test=depart]").click()
    expect(field).to_have_class(re.compile("q-field--error"), timeout=PATIENCE_MS)
    expect(page.locator("[data-test=convoy]")).to_have_attribute("data-status", "none")
    expect(gap).to_have_value("1,234")
    gap.press("Control+a")
    page.keyboard.type("6,5")
    page.locator("[data-test=depart]").click()
    page.wait_for_url(re.compile(r"run=live-"), timeout=PATIENCE_MS)
    run = page.url.partition("run=")[2]
    assert server.get(f"/api/jobs/{run}")["request"]["gap_m"] == 6.5
    server.post(f"/api/live/{run}/stop")
    context.close()


def test_a_paste_with_commas_is_read(visit):
    page = visit("/edit?line=yizhuang")
    table = page.get_by_role("table", name="speed_limits.table").or_(page.locator(".mp-grid").nth(1)).first
    cell = table.locator("tbody tr").nth(0).locator("input").nth(1)
    expect(cell).to_be_visible(timeout=PATIENCE_MS)
    cell.evaluate(
        """(at) => { const data = new DataTransfer(); data.setData('text/plain', '0\\t62,5\\n276\\t80');
        const paste = new ClipboardEvent('paste', { clipboardData: data, bubbles: true });
        at.closest('tr').querySelector('input').dispatchEvent(paste); }"""
    )
    expect(table.locator("tbody tr").nth(0).locator("input").nth(1)).to_have_value("62.5")
    status = page.locator("[data-test=status]")
    expect(status).to_have_text("not saved")
    cell = table.locator("tbody tr").nth(0).locator("input").nth(1)
    cell.fill("1,234")
    expect(status).to_contain_text("1,234", timeout=PATIENCE_MS)

"""The page Campaigns: published rows sorted and opened as runs, one's own declared and watched; studies."""

import re

import pytest
from playwright.sync_api import expect

PATIENCE_MS = 90_000


@pytest.mark.parametrize("width", [1440, 390])
def test_a_row_of_the_leaderboard_is_opened_as_a_run(visit, width):
    page = visit("/campaigns", width=width, height=900)
    drivers = page.locator('[aria-label="Drivers"] tbody tr')
    expect(drivers).to_have_count(38, timeout=PATIENCE_MS)
    page.get_by_role("button", name="Sort by Gap, median (%)").press("Enter")
    expect(drivers.first).to_contain_text("optimal")
    page.get_by_role("combobox", name="Driver", exact=True).click()
    page.get_by_role("option", name="ston", exact=True).click()
    expect(drivers).to_have_count(2)
    expect(page.locator('[data-test="count"]')).to_have_text("156 of 156 rows")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    first = page.locator('[aria-label="Rows"] tbody tr').first
    expect(first).to_contain_text("ston")
    late = "dead time" in first.inner_text()
    first.get_by_role("link").click()
    expect(page.get_by_role("combobox", name="Driver", exact=True)).to_have_value("ston", timeout=PATIENCE_MS)
    expect(page.get_by_text("minimum ")).to_be_visible(timeout=PATIENCE_MS)
    if late:
        expect(page.get_by_role("combobox", name="Trainset")).to_have_value("dkz32@0.6,0.4")


@pytest.mark.parametrize("width", [1440, 390])
def test_a_campaign_is_declared_computed_and_shown(visit, server, width):
    page = visit("/campaigns", width=width)
    page.get_by_label("Name", exact=True).fill("by form")
    for field, station in (("From", "RJ"), ("To", "WYJ")):
        page.get_by_role("combobox", name=field, exact=True).click()
        page.get_by_role("option", name=re.compile(f"^{station} ")).last.click()
    page.get_by_text("Disturbance", exact=True).first.click()
    page.get_by_label("True mass / nominal").fill("1.0 … 1.5")
    text = page.locator('[data-test="toml"] textarea').or_(page.get_by_label("Campaign (TOML)")).first
    expect(text).to_have_value(re.compile(r"mass_factor = \[1\.0, 1\.5\]"))
    text.fill(text.input_value().replace('["optimal", "manual"]', '["flat_out", "manuel"]'))
    page.locator('[data-test="start"]').click()
    expect(page.get_by_text("unknown driver, did you mean manual?").first).to_be_visible()
    text.fill(text.input_value().replace("manuel", "manual"))
    page.locator('[data-test="start"]').click()
    page.wait_for_url(re.compile(r"/campaigns\?campaign=campaign-"))
    rows = page.locator('[aria-label="Rows"] tbody tr')
    expect(rows).to_have_count(2, timeout=PATIENCE_MS)
    expect(page.get_by_role("link", name="results.parquet")).to_be_visible(timeout=PATIENCE_MS)
    expect(page.locator('[data-test="campaigns"]')).to_contain_text("by form · 2 rows")


def test_a_study_shows_its_published_page(visit):
    page = visit("/learn?study=lu2023", width=390)
    expect(page.locator('[data-test="verdict"]')).to_contain_text("beaten", timeout=PATIENCE_MS)
    expect(page.get_by_role("table", name="Verdicts").get_by_role("row")).to_have_count(14)
    picture = page.locator("img.mp-picture").first
    picture.scroll_into_view_if_needed()
    page.wait_for_function("document.querySelector('img.mp-picture').naturalWidth > 300")
    page.get_by_label("Find in Published rows").fill("pid_lu2023")
    expect(page.locator('[aria-label="Published rows"] tbody tr').first).to_contain_text("pid_lu2023")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize("width", [1440, 390])
def test_a_learned_driver_is_exported_as_c(visit, width):
    page = visit("/learn", width=width)
    page.locator('[data-test="export"]').click(timeout=PATIENCE_MS)
    status = page.locator('[data-test="export-status"]')
    expect(status).to_have_text("done", timeout=2 * PATIENCE_MS)
    with page.expect_download() as saved:
        page.get_by_role("link", name="run.zip").click(modifiers=["Alt"])
    assert saved.value.suggested_filename.startswith("export-")

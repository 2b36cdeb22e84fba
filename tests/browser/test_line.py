"""The page Line: a headway computed, dragged and refused; a day with its feed."""

import csv
import re

import pytest
from playwright.sync_api import expect

PATIENCE_MS = 120_000
READS = '[data-test="result"] .mp-read'


def read(page, name):
    """A number of the result."""
    text = page.locator(READS).filter(has_text=re.compile(f"^{name}")).inner_text()
    return float(re.search(r"[\d.]+", text.split("\n")[1])[0])


@pytest.mark.parametrize("width", [1440, 390])
def test_a_headway_is_computed_and_dragged(visit, tmp_path, width):
    page = visit("/line", width=width, height=900)
    result = page.locator('[data-test="result"]')
    expect(result).not_to_be_empty()
    page.get_by_label("Feeding zones").fill("3" if width == 390 else "5")
    expect(result).to_contain_text("not computed for these settings")
    page.locator('[data-test="compute"]').click()
    graph = page.locator('[data-test="graph"]')
    expect(graph).to_be_visible(timeout=PATIENCE_MS)
    expect(graph.locator(".scatterlayer .trace")).to_have_count(3)
    at_180 = read(page, "energy"), read(page, "floor")
    assert at_180[1] <= at_180[0] < 1.02 * at_180[1]
    assert read(page, "technical headway") < 90
    link = page.get_by_role("link", name="timetable.csv")
    expect(link).to_be_visible(timeout=PATIENCE_MS)
    with page.expect_download() as download:
        page.evaluate("document.querySelectorAll('[data-test=result] a').forEach(a => a.target = '')")
        link.click()
    download.value.save_as(tmp_path / "timetable.csv")
    with (tmp_path / "timetable.csv").open() as file:
        assert len(list(csv.DictReader(file))) == 26
    slider = page.locator('[data-test="headway"] [tabindex="0"]')
    for _ in range(4):
        slider.press("PageUp")
    chosen = 380
    expect(page.get_by_label("Headway (s)")).to_have_value(str(chosen))
    heading = page.get_by_role("heading", name=f"yizhuang, every {chosen} s")
    expect(heading).to_be_visible(timeout=PATIENCE_MS)
    assert read(page, "energy") > at_180[0]
    points = "document.querySelector('[data-test=curve]').data.map(t => t.x)"
    drawn = page.evaluate(points)
    assert {(at[0], at[-1]) for at in drawn} == {(180, chosen)}
    assert len(drawn) == 5
    page.goto(page.url)
    expect(heading).to_be_visible()
    assert page.evaluate(points) == drawn
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_a_headway_that_is_too_short_is_told_beside_its_field(visit):
    page = visit("/line")
    page.get_by_label("Headway (s)").fill("40")
    page.locator('[data-test="compute"]').click()
    field = page.locator("label").filter(has_text="Headway (s)")
    expect(field).to_contain_text("trains disturb one another at station", timeout=PATIENCE_MS)
    expect(field).to_contain_text("with a moving block")
    page.get_by_label("Headway (s)").fill("4")
    page.locator('[data-test="compute"]').click()
    expect(field).to_contain_text("out of range (allowed: 10 to 7200 s)")


def test_a_search_is_stopped(visit, server):
    page = visit("/line")
    page.get_by_text("Search dwells and running times too").click()
    page.locator('[data-test="compute"]').click()
    expect(page.locator('[data-test="status"]')).to_contain_text("%", timeout=PATIENCE_MS)
    page.locator('[data-test="stop"]').click()
    expect(page.locator('[data-test="status"]')).to_have_text("", timeout=PATIENCE_MS)
    job = next(row for row in server.get("/api/jobs?kind=line") if row["request"]["optimise"])
    assert job["status"] == "stopped"


@pytest.mark.parametrize("width", [1440, 390])
def test_a_day_has_its_feed(visit, width):
    page = visit("/line", width=width)
    page.get_by_role("combobox", name="Timetable").click()
    page.get_by_role("option", name="working day").click()
    expect(page.locator('[data-test="headway"]')).to_be_hidden()
    page.locator('[data-test="compute"]').click()
    expect(page.locator('[data-test="graph"]')).to_be_visible(timeout=PATIENCE_MS)
    expect(page.get_by_role("link", name="gtfs.zip")).to_be_visible(timeout=PATIENCE_MS)
    assert read(page, "gap") > 0
    assert read(page, "energy") > 50_000

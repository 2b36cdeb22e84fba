"""Compare, Journey, Lines, Learn; narrow and dark; by keyboard; how soon the first page is there."""

import os
import re

import pytest
from playwright.sync_api import expect

from metropilot.railway import load_line, write_line

PATIENCE_MS = 90_000
PAGES = ("/", "/compare", "/journey", "/convoy", "/learn", "/lines")


def test_compare(visit):
    page = visit("/compare")
    second = page.locator('[data-test="second"]')
    expect(second).to_contain_text("The next second saves", timeout=PATIENCE_MS)
    before = second.inner_text()
    page.locator('[data-test="time"] [tabindex="0"]').press("ArrowRight")
    expect(second).to_contain_text("At 102 s")
    saves = [float(re.search(r"saves (\d+) Wh", text)[1]) for text in (before, second.inner_text())]
    assert saves[0] > saves[1] > 0
    page.locator('[data-test="compare"]').click()
    rows = page.locator('[aria-label="Comparison"] tbody tr')
    expect(rows).to_have_count(3, timeout=PATIENCE_MS)
    expect(rows.nth(0)).to_contain_text("optimal")
    expect(rows.nth(0)).to_contain_text("on time")
    expect(rows.nth(2)).to_contain_text("early")
    expect(page.locator('[data-test="picture"] .scatterlayer .trace').first).to_be_attached()
    expect(page.locator('[data-test="front"]')).to_contain_text("flat_out")


def test_journey(visit):
    page = visit("/journey")
    sections = page.locator('[data-test="sections"] tbody tr')
    expect(sections).to_have_count(13, timeout=PATIENCE_MS)
    expect(page.locator('[data-test="summary"]')).to_contain_text("against the timetable's times")
    saved = re.search(r"−(\d+\.\d+) %", page.locator('[data-test="summary"]').inner_text())
    assert float(saved[1]) > 0.1
    page.locator('[data-test="total"]').locator("input").or_(page.get_by_label("Whole journey")).first.fill(
        "600"
    )
    page.locator('[data-test="plan"]').click()
    expect(page.get_by_text("cannot be reached before")).to_be_visible(timeout=PATIENCE_MS)


def test_a_bad_upload_is_told_beside_its_field(visit, tmp_path):
    write_line(load_line("yizhuang"), tmp_path / "bad.toml")
    text = (tmp_path / "bad.toml").read_text()
    (tmp_path / "bad.toml").write_text(text.replace('kind = "line"', 'kind = "<img src=x onerror=alert(1)>"'))
    page = visit("/lines")
    page.locator('input[type="file"]').set_input_files(tmp_path / "bad.toml")
    said = page.locator('[data-test="upload-said"]')
    expect(said).to_contain_text("This file cannot be used", timeout=PATIENCE_MS)
    expect(said.get_by_role("row", name=re.compile("^field"))).to_contain_text("kind")
    expect(said.get_by_role("row", name=re.compile("^allowed"))).to_contain_text("line")
    assert page.locator("img[src=x]").count() == 0


def test_a_good_upload_is_drawn_and_driven_on(visit, tmp_path):
    write_line(load_line("yizhuang"), tmp_path / "mine.toml")
    text = (tmp_path / "mine.toml").read_text()
    name = "<b>My</b> line & co"
    (tmp_path / "mine.toml").write_text(
        re.sub(r'(?m)^name = "Beijing[^"]*"', f'name = "{name}"', text, count=1)
    )
    page = visit("/lines")
    page.locator('input[type="file"]').set_input_files(tmp_path / "mine.toml")
    expect(page.locator('[data-test="upload-said"]')).to_contain_text("taken as upload-", timeout=PATIENCE_MS)
    shown = page.locator('[data-test="line"]')
    expect(shown.get_by_role("heading", name=name)).to_be_visible()
    expect(shown.locator("svg circle")).to_have_count(14)


def test_learn_stop_and_resume(visit):
    page = visit("/learn")
    page.get_by_label("Environment steps").fill("200000")
    page.locator('[data-test="learn"]').click()
    status = page.locator('[data-test="status"]')
    expect(status).to_contain_text("steps/s", timeout=4 * PATIENCE_MS)
    page.locator('[data-test="stop"]').click()
    expect(status).to_contain_text("it can be resumed", timeout=2 * PATIENCE_MS)
    points = "document.querySelector('[data-test=curves]').data[0].x"
    before = page.evaluate(f"{points}.length")
    assert 1 <= before < 8
    page.reload()
    expect(status).to_contain_text("it can be resumed")
    page.locator('[data-test="resume"]').click()
    expect(status).to_contain_text("· done", timeout=4 * PATIENCE_MS)
    steps = page.evaluate(points)
    assert steps == sorted(set(steps))
    assert len(steps) == 8


@pytest.mark.parametrize("path", PAGES)
@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (390, "dark")])
def test_nothing_sticks_out(visit, path, width, scheme):
    page = visit(path, width=width, height=844, scheme=scheme)
    expect(page.locator("#main")).to_be_visible()
    page.wait_for_timeout(500)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    dark = page.evaluate("document.body.classList.contains('body--dark')")
    assert dark == (scheme == "dark")


def test_by_keyboard_alone(visit):
    page = visit("/")
    expect(page.get_by_text("minimum 83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to content"
    names = []
    for _ in range(30):
        page.keyboard.press("Tab")
        names.append(
            page.evaluate(
                "document.activeElement.getAttribute('aria-label') || document.activeElement.textContent"
            )
        )
        if "Depart" in names[-1]:
            break
    assert "Depart" in names[-1], names
    page.keyboard.press("Enter")
    expect(page.locator('[data-test="live"]')).to_have_attribute(
        "data-status", "running", timeout=PATIENCE_MS
    )
    page.get_by_role("button", name="Stop", exact=True).click()


def test_the_first_page_is_there_in_two_seconds(visit):
    spent = []
    for _ in range(3):
        page = visit("/")
        expect(page.locator('[data-test="depart"]')).to_be_visible(timeout=PATIENCE_MS)
        spent.append(page.evaluate("performance.getEntriesByType('paint').at(-1).startTime") / 1000)
    busy = max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))
    assert min(spent) < 2.0 * busy, spent

"""The console for everyone: axe-core finds nothing, all is reached by keyboard, a section is driven by it."""

import os
import re
from importlib.resources import files
from pathlib import Path

import pytest
from playwright.sync_api import expect

PATIENCE_MS = 90_000
SECTION = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101}
VIEWS = (("light", 1280, 900), ("dark", 1280, 900), ("dark", 390, 844), ("light", 390, 844))
REFUSED = ("critical", "serious", "moderate")
LEFT_OUT = "region"
"""Lists that are open lie beside the page, outside its landmarks: of moderate impact, and Quasar's way."""
RUN_AXE = """axe.run(document, {resultTypes: ['violations']}).then(found => {
    const [major, minor] = axe.version.split('.').map(Number);
    const mistaken = major < 4 || major === 4 && minor < 14;
    const counts = (rule, node) => !(mistaken && rule.id === 'color-contrast'
        && document.querySelector(node.target[0])?.closest('.q-dialog, .mp-beside'));
    return found.violations.map(rule => ({...rule, nodes: rule.nodes.filter(node => counts(rule, node))}))
        .filter(rule => rule.nodes.length > 0);
})"""
"""Axe-core before 4.14 (4.12.1 does) takes what lies behind a dialog or a sticky column for its background;
4.14.1 finds nothing there."""


@pytest.fixture(scope="session")
def axe():
    """Source of axe-core: the file that METROPILOT_AXE names, or that of the extra `browser`."""
    named = os.environ.get("METROPILOT_AXE")
    source = Path(named) if named else files("axe_playwright_python") / "axe.min.js"
    return source.read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def made(server):
    """Jobs whose pages are looked at with their results, by the names that PAGES has."""
    bodies = {name: {**SECTION, "driver": name} for name in ("manual", "flat_out")}
    found = {name: server.post("/api/jobs/drive", body, code=202)["id"] for name, body in bodies.items()}
    found["compare"] = server.post("/api/jobs/compare", SECTION, code=202)["id"]
    found["journey"] = server.post("/api/jobs/journey", {"line": "yizhuang"}, code=201)["id"]
    for job in found.values():
        server.wait(job)
    return found


def run_line(server):
    """A line that runs, in which a train is held; it is stopped when nobody looks at it any more."""
    body = {"line": "yizhuang", "headway_s": 180, "pace": 10, "lasts_s": 36_000}
    job = server.post("/api/running-lines", body, code=201)["id"]
    server.post(f"/api/live/{job}/hold", {"station": "RJ", "hold_s": 900})
    return job


def open_folds(page):
    for name in ("Speed restrictions", "Driver options", "Disturbances"):
        page.get_by_role("button", name=re.compile(f"{name}")).first.click()
    page.get_by_role("button", name="Add a restriction").click()


def open_list(page):
    page.get_by_role("combobox", name="Driver", exact=True).click()
    expect(page.get_by_role("option").first).to_be_visible()


def open_dialog(page):
    page.get_by_role("checkbox", name=re.compile("^Select ")).nth(1).click()
    page.locator('[data-test="delete"]').click()
    expect(page.get_by_role("dialog")).to_be_visible()


def open_import(page):
    page.get_by_role("button", name="Import").click()
    expect(page.get_by_role("dialog")).to_be_visible()


def open_all(page):
    page.evaluate("document.querySelectorAll('details').forEach(each => { each.open = true; })")


PAGES = {
    "drive": ("/", '[data-test="depart"]', None),
    "driven": ("/?run={manual}", '[data-test="result"] table', None),
    "fields": ("/", '[data-test="depart"]', open_folds),
    "list": ("/", '[data-test="depart"]', open_list),
    "chinese": ("/?run={manual}", '[data-test="result"] table', None),
    "compare": ("/compare?job={compare}", '[aria-label="Comparison"]', None),
    "journey": ("/journey?job={journey}", '[data-test="sections"] tbody tr', None),
    "line": ("/line", "#main button", None),
    "running": ("/line?run={running}", '[data-test="running"]:not([data-late="0"]) [data-mp="log"] li', None),
    "convoy": ("/convoy", '[data-test="depart"]', None),
    "learn": ("/learn?study=lu2023", '[data-test="learn"]', None),
    "lines": ("/lines", '[data-test="line"] svg', None),
    "edit-line": ("/edit?line=yizhuang", ".mp-grid", None),
    "edit-trainset": ("/edit?trainset=dkz32", ".mp-grid", None),
    "runs": ("/runs?run={manual}&with={flat_out}", '[data-test="difference"] table', None),
    "delete": ("/runs", ".mp-data tbody tr", open_dialog),
    "import": ("/runs", ".mp-data tbody tr", open_import),
    "campaigns": ("/campaigns?campaign=robustness", ".mp-data tbody tr", None),
    "reference": ("/api/docs", "summary", open_all),
}


@pytest.mark.parametrize("name", PAGES)
def test_axe_finds_nothing(axe, visit, server, made, name):
    path, there, act = PAGES[name]
    begun = {"running": run_line(server)} if "{running}" in path else {}
    page = visit(path.format(**made, **begun), language="zh" if name == "chinese" else None)
    expect(page.locator(there).first).to_be_visible(timeout=PATIENCE_MS)
    page.wait_for_timeout(1000)
    if act:
        act(page)
    found = []
    for scheme, width, height in VIEWS:
        page.emulate_media(color_scheme=scheme)
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(500)
        page.evaluate(axe)
        found += [
            (scheme, width, each["id"], each["nodes"][0]["html"][:200], each["nodes"][0]["failureSummary"])
            for each in page.evaluate(RUN_AXE)
            if each["impact"] in REFUSED and each["id"] != LEFT_OUT
        ]
    assert found == []


FOCUS = """() => { const at = document.activeElement, style = getComputedStyle(at);
    const field = at.closest('.q-field'), thumb = at.closest('.q-slider');
    const end = at === document.body, said = at.labels?.[0]?.innerText || (end ? '' : at.innerText);
    return { end, name: at.getAttribute('aria-label') || said || '',
        seen: parseFloat(style.outlineWidth) > 1 && style.outlineStyle !== 'none' || thumb !== null
            || field !== null && field.classList.contains('q-field--focused') }; }"""


def walk_to(page, name, *, most=80):
    """Press Tab until an element has the focus; every one on the way shows that it has it."""
    passed = []
    for _ in range(most):
        page.keyboard.press("Tab")
        at = page.evaluate(FOCUS)
        assert at["seen"] or at["end"], at
        passed.append(at["name"])
        if re.search(name, at["name"].strip()):
            return
    raise AssertionError(f"{name} is not reached: {passed}")


def test_a_section_is_driven_by_keyboard_alone(visit):
    page = visit("/")
    expect(page.get_by_text("minimum 83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    walk_to(page, "Skip to content")
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "main"
    walk_to(page, "Load")
    page.keyboard.press("Enter")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    expect(page.get_by_role("combobox", name="Load")).to_have_value(re.compile("^AW2"))
    walk_to(page, "Scheduled running time")
    page.keyboard.press("ArrowRight")
    assert page.evaluate("document.activeElement.getAttribute('role')") == "slider"
    page.wait_for_function("document.activeElement.getAttribute('aria-valuenow') === '102'")
    expect(page.get_by_text("Running time 102 s")).to_be_visible(timeout=PATIENCE_MS)
    walk_to(page, "Pace")
    page.keyboard.press("Enter")
    for _ in range(4):
        page.keyboard.press("ArrowDown")
    page.keyboard.press("Enter")
    expect(page.get_by_role("combobox", name="Pace")).to_have_value("30 ×")
    walk_to(page, "Depart")
    page.keyboard.press("Enter")
    live = page.locator('[data-test="live"]')
    expect(live).to_have_attribute("data-status", "done", timeout=PATIENCE_MS)
    expect(page.locator('[data-test="result"]').get_by_text("✓ passed")).to_have_count(5)
    with page.context.expect_page() as opened:
        walk_to(page, "kpis.json")
        page.keyboard.press("Enter")
    opened.value.close()


def test_runs_are_sorted_chosen_and_kept_by_keyboard(visit, made):
    page = visit("/runs")
    expect(page.locator(".mp-data tbody tr").first).to_be_visible(timeout=PATIENCE_MS)
    walk_to(page, "Sort by Energy")
    page.keyboard.press("Enter")
    heading = page.get_by_role("columnheader", name=re.compile("Energy"))
    expect(heading).to_have_attribute("aria-sort", "ascending")
    for _ in range(2):
        walk_to(page, "Select (?!all)")
        page.keyboard.press("Space")
        # the server draws the table anew; the box keeps the focus
        page.wait_for_function("document.activeElement.ariaChecked === 'true'", timeout=PATIENCE_MS)
    expect(page.locator('[data-test="chosen"]')).to_have_text("2 chosen")
    page.locator('[data-test="delete"]').focus()
    page.keyboard.press("Enter")
    dialog = page.get_by_role("dialog", name="Delete 2 runs?")
    expect(dialog).to_be_visible()
    expect(dialog.get_by_role("button", name="Cancel")).to_be_visible()
    page.wait_for_function("document.activeElement.closest('[role=dialog]') !== null")
    page.keyboard.press("Escape")
    expect(dialog).not_to_be_visible()
    expect(page.locator('[data-test="delete"]')).to_be_focused()
    expect(page.locator('[data-test="chosen"]')).to_have_text("2 chosen")

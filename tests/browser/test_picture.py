"""Work on the picture of a run: moments, pause and step, copies, what is dragged, sliders."""

import csv
import re
import struct
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from playwright.sync_api import expect
from tests.browser.test_drive import PATIENCE_MS, depart, number

ROOT = Path(__file__).parents[2]
SECTION = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 101}
SIZES = [(1440, 900), (390, 844)]
PLOT = "document.querySelector('[data-test=live] .js-plotly-plot')"
CURSORS = """[...document.querySelectorAll('.mp-along.js-plotly-plot')].map(
    el => (el.layout.shapes || []).filter(s => s.name === 'moment').map(s => s.x0))"""


@pytest.fixture(scope="module")
def driven(server):
    """Drive that is over."""
    job = server.post("/api/jobs/drive", {**SECTION, "driver": "manual"}, code=202)["id"]
    server.wait(job)
    return job


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_a_finished_run_is_scrubbed(visit, server, driven, width, height):
    columns = server.get(f"/api/jobs/{driven}/drive")["columns"]
    page = visit(f"/?run={driven}", width=width, height=height)
    slider = page.get_by_role("slider", name="Moment")
    expect(slider).to_be_visible()
    expect(page.locator('[data-test="explanation"]')).to_be_visible()
    rows = len(columns["time_s"])
    expect(slider).to_have_attribute("max", str(rows - 1))
    assert number(page, "time") == pytest.approx(columns["time_s"][-1], abs=0.06)
    slider.focus()
    page.keyboard.press("Home")
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    expect(page.locator('[data-mp="time"]')).to_contain_text(f"{columns['time_s'][5]:.1f}")
    slider.fill(str(rows // 2))
    speed, place = 3.6 * columns["speed_mps"][rows // 2], columns["position_m"][rows // 2]
    expect(page.locator('[data-mp="speed"]')).to_contain_text(f"{speed:.1f}")
    expect(page.locator('[data-mp="place"]')).to_contain_text(f"{place:.0f} m")
    told = slider.get_attribute("aria-valuetext")
    assert f"{place:.0f} m, {speed:.1f} km/h, permitted" in told
    assert told.endswith("kWh, protection: watching")
    page.wait_for_function(f"{CURSORS}.every(at => at.length === 1 && Math.abs(at[0] - {place}) < 0.01)")
    assert len(page.evaluate(CURSORS)) == 2
    scale = float(page.locator(".mp-strip svg[data-scale]").first.get_attribute("data-scale"))
    moved = page.locator(".mp-train").get_attribute("style")
    assert f"translateX({scale * place:.2f}px)" in moved


def test_the_pointer_chooses_the_moment(visit, driven):
    page = visit(f"/?run={driven}", width=1440)
    expect(page.get_by_role("slider", name="Moment")).to_be_visible()
    expect(page.locator('[data-test="explanation"] .ylines-above').first).to_be_attached()
    across = """name => { const el = document.querySelector(name), a = el._fullLayout.xaxis;
        const box = el.getBoundingClientRect();
        return [box.left + a._offset + a.d2p(600), box.top + 120]; }"""
    for name in ("[data-test=live] .js-plotly-plot", "[data-test=explanation]"):
        page.locator(name).scroll_into_view_if_needed()
        page.mouse.move(5, 5)
        page.mouse.move(*page.evaluate(across, name))
        page.wait_for_function(f"{CURSORS}.every(at => Math.abs(at[0] - 600) < 8)")
        assert number(page, "distance") == pytest.approx(1280 - 600, abs=30)
        page.get_by_role("slider", name="Moment").fill("3")
        page.wait_for_function(f"{CURSORS}.every(at => at[0] < 50)")


def test_a_live_run_that_is_over_is_scrubbed_until_the_form_changes(visit):
    page = visit("/")
    live = depart(page, "30 ×")
    expect(live).to_have_attribute("data-status", "done", timeout=PATIENCE_MS)
    slider = page.get_by_role("slider", name="Moment")
    expect(slider).to_be_visible()
    slider.fill("100")
    page.wait_for_function("Number(document.querySelector('[data-test=live]').dataset.time) < 40")
    assert 0 < (number(page, "speed") or 0) < 90
    page.locator('[data-test="time"] [tabindex="0"]').focus()
    page.keyboard.press("ArrowRight")
    expect(slider).to_be_hidden()
    page.wait_for_function(f"!({PLOT}.layout.shapes || []).some(s => s.name === 'moment')")


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_a_run_is_paused_and_stepped(visit, width, height):
    page = visit("/", width=width, height=height)
    expect(page.locator('[data-mp="pause"]')).to_be_hidden()
    live = depart(page, "5 ×")
    pause = page.locator('[data-mp="pause"]')
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("Space")
    expect(pause).to_have_text("Go on (space)")
    expect(page.locator('[data-mp="pace"]')).to_have_text("paused")
    page.wait_for_timeout(300)
    at = float(live.get_attribute("data-time"))
    for k in range(1, 4):
        page.get_by_role("button", name="Step 1 s").click()
        page.wait_for_function(
            f"Math.abs(document.querySelector('[data-test=live]').dataset.time - {at + k}) < 1e-3"
        )
    page.wait_for_timeout(500)
    assert float(live.get_attribute("data-time")) == pytest.approx(at + 3, abs=1e-3)
    pause.click()
    expect(pause).to_have_text("Pause (space)")
    page.wait_for_function(f"document.querySelector('[data-test=live]').dataset.time > {at + 4}")
    page.locator('[data-test="stop"]').click()
    expect(pause).to_be_hidden()


def taken(page, plot, kind):
    """File that a button of a plot gives."""
    with page.expect_download() as download:
        page.get_by_role("button", name=kind, exact=True).nth(plot).click()
    return Path(download.value.path()), download.value.suggested_filename


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_a_plot_is_taken_as_svg_png_and_csv(visit, server, driven, width, height):
    columns = server.get(f"/api/jobs/{driven}/drive")["columns"]
    page = visit(f"/?run={driven}", width=width, height=height)
    expect(page.locator('[data-test="explanation"] .ylines-above').first).to_be_attached()
    path, name = taken(page, 0, "Values of the plot as CSV")
    assert name == "metropilot-drive-1.csv"
    with path.open(encoding="utf-8-sig", newline="") as file:
        head, *rows = csv.reader(file)
    speed = head.index("driven: speed (km/h)")
    assert head[speed - 1] == "driven: distance (m)"
    assert "energy at the wheel: energy (kWh)" in head
    assert "command: command" in head
    values = [(float(row[speed - 1]), float(row[speed])) for row in rows if row[speed]]
    assert [x for x, _ in values] == pytest.approx(columns["position_m"])
    assert [y for _, y in values] == pytest.approx([3.6 * v for v in columns["speed_mps"]], abs=1e-3)
    path, name = taken(page, 0, "Plot as SVG")
    assert name == "metropilot-drive-1.svg"
    drawn = ET.fromstring(path.read_text(encoding="utf-8"))
    texts = ["".join(each.itertext()) for each in drawn.iter() if each.tag.endswith("}text")]
    assert {"distance (m)", "speed (km/h)", "energy (kWh)"} <= set(texts)
    path, name = taken(page, 1, "Plot as PNG")
    assert name == "metropilot-drive-2.png"
    content = path.read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    shown = page.locator('[data-test="explanation"]').bounding_box()
    assert struct.unpack(">II", content[16:24]) == pytest.approx(
        (2 * shown["width"], 2 * shown["height"]), abs=2
    )


def test_every_plot_is_placed_with_its_buttons():
    pages = ROOT / "src" / "metropilot" / "web" / "pages"
    direct = {path.name for path in pages.glob("*.py") if "ui.plotly(" in path.read_text(encoding="utf-8")}
    assert direct == {"frame.py"}


@pytest.mark.parametrize("width", [1440, 390])
def test_a_report_is_taken_from_the_page(visit, driven, width):
    page = visit(f"/?run={driven}", height=844, width=width)
    link = page.locator('[data-test="result"]').get_by_role("link", name="report.pdf")
    expect(link).to_be_visible()
    answer = page.request.get(link.evaluate("at => at.href"))
    assert answer.headers["content-type"] == "application/pdf"
    assert answer.body().startswith(b"%PDF-")


SPOT = """([x, y]) => { const el = document.querySelector('[data-test=live] .js-plotly-plot');
    const f = el._fullLayout;
    el.scrollIntoView({ block: 'center' });
    const box = el.getBoundingClientRect();
    return [box.left + f.xaxis._offset + f.xaxis.d2p(x), box.top + f.yaxis._offset + f.yaxis.d2p(y)]; }"""


def drag(page, begin, end):
    """Drag from one point of the speed plot, m and km/h, to another."""
    page.mouse.move(*page.evaluate(SPOT, begin))
    page.mouse.down()
    spot = page.evaluate(SPOT, end)
    page.mouse.move(*spot, steps=6)
    page.mouse.up()


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_a_restriction_is_dragged_before_departure(visit, width, height):
    page = visit("/", width=width, height=height)
    expect(page.get_by_text("minimum 83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    page.get_by_text("Speed restrictions", exact=True).click()
    page.get_by_role("button", name="Add a restriction").click()
    rows = page.locator('[data-test="restrictions"]')
    expect(rows.get_by_label("From (m)")).to_have_value("500")
    page.wait_for_function(f"{PLOT}.layout?.shapes?.length === 1")
    drag(page, [550, 60], [752, 60])
    expect(rows.get_by_label("From (m)")).to_have_value("700")
    expect(rows.get_by_label("To (m)")).to_have_value("800")
    expect(rows.get_by_label("Speed (km/h)")).to_have_value("40")
    page.wait_for_function(f"{PLOT}.layout.shapes[0].x0 === 700 && {PLOT}.layout.shapes[0].x1 === 800")
    drag(page, [750, 42], [750, 33])
    expect(rows.get_by_label("Speed (km/h)")).to_have_value("30")
    expect(rows.get_by_label("From (m)")).to_have_value("700")


def test_a_restriction_is_dragged_on_the_way(visit):
    page = visit("/", width=1440)
    live = depart(page, "real time")
    page.get_by_label("From (m)").fill("700")
    page.get_by_label("To (m)").fill("900")
    page.wait_for_function(f"({PLOT}.layout.shapes || []).some(s => s.name === 'draft' && s.x1 === 900)")
    drag(page, [800, 60], [901, 50])
    expect(page.get_by_label("From (m)")).to_have_value("800")
    expect(page.get_by_label("To (m)")).to_have_value("1000")
    expect(page.get_by_label("Speed (km/h)")).to_have_value("30")
    page.locator('[data-test="restrict"]').click()
    expect(page.locator('[data-mp="log"]')).to_contain_text("30 km/h from 800 to 1000 m")
    expect(page.locator(".mp-restrictions rect")).to_have_count(1)
    page.wait_for_function(f"!{PLOT}.layout.shapes.some(s => s.name === 'draft')")
    at = float(live.get_attribute("data-time") or 0)
    page.wait_for_function(f"document.querySelector('[data-test=live]').dataset.time > {at + 0.5}")
    page.locator('[data-test="stop"]').click()


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_the_plan_follows_the_true_plant(visit, width, height):
    page = visit("/", width=width, height=height)
    expect(page.get_by_text("minimum 83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    page.get_by_text("Disturbances", exact=True).click()
    field = page.get_by_label("True mass / nominal", exact=True).and_(page.get_by_role("spinbutton"))
    field.fill("1.2")
    plant = f"{PLOT}?.data?.find(t => t.name === 'plan of the true plant')"
    page.wait_for_function(f"{plant}.x.length > 50")
    words = page.locator('[data-test="plant"]')
    expect(words).to_contain_text("at best")
    heavy = words.inner_text()
    delay = page.get_by_label("Additional dead time (s)", exact=True)
    slider = page.locator('.q-slider[aria-label="Additional dead time"]')
    slider.locator('[tabindex="0"]').focus()
    for value in ("0.05", "0.1"):
        page.keyboard.press("ArrowRight")
        expect(delay).to_have_value(value)
    page.wait_for_timeout(500)  # what the slider has sent meanwhile is behind
    delay.fill("0.4")
    expect(slider).to_have_attribute("aria-valuenow", "0.4")
    expect(words).not_to_have_text(heavy)
    delay.fill("0")
    field.fill("1")
    expect(words).to_have_text("")
    page.wait_for_function(f"{plant}.x.length === 0")


def test_every_slider_is_the_one_that_keeps_its_place():
    pages = ROOT / "src" / "metropilot" / "web" / "pages"
    assert [
        path.name for path in pages.glob("*.py") if "ui.slider(" in path.read_text(encoding="utf-8")
    ] == []


def press_quickly(page, name, begin):
    """Press an arrow key 12 times on a slider, as quickly as it goes; return the slider."""
    slider = page.locator(f'.q-slider[aria-label="{name}"]')
    expect(slider).to_have_attribute("aria-valuenow", begin)
    thumb = slider.locator('[tabindex="0"]')
    expect(thumb).to_be_visible()
    thumb.focus()
    expect(thumb).to_be_focused()
    for _ in range(12):
        page.keyboard.press("ArrowRight")
    return slider


@pytest.mark.parametrize(
    ("name", "field", "begin", "end"),
    [
        ("True mass / nominal", "mass_factor", 1, 1.12),
        ("True resistance / nominal", "resistance_factor", 1, 1.6),
        ("Additional dead time", "delay_s", 0, 0.6),
        ("Additional lag", "lag_s", 0, 0.6),
        ("Scheduled running time in seconds", "time_s", 101, 113),
    ],
)
def test_no_quick_press_on_a_slider_is_lost(visit, server, name, field, begin, end):
    page = visit("/", width=1440)
    expect(page.get_by_text("minimum 83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    page.get_by_text("Disturbances", exact=True).click()
    slider = press_quickly(page, name, f"{begin:g}")
    expect(slider).to_have_attribute("aria-valuenow", f"{end:g}")
    answer = server.post("/api/plan", {**SECTION, field: end})
    plan, drawn = (
        (answer, "optimal plan") if field == "time_s" else (answer["plant"], "plan of the true plant")
    )
    trace = f"{PLOT}?.data?.find(t => t.name === '{drawn}').y"
    highest = 3.6 * max(plan["speed_mps"])
    page.wait_for_function(
        f"{trace}.length === {len(plan['speed_mps'])} && Math.abs(Math.max(...{trace}) - {highest}) < 1e-3"
    )
    if field == "time_s":
        expect(page.get_by_text("Running time 113 s")).to_be_visible()
    else:
        typed = page.get_by_label(re.compile(f"^{re.escape(name)}( \\(s\\))?$")).and_(
            page.get_by_role("spinbutton")
        )
        expect(typed).to_have_value(f"{end:g}")
    expect(slider).to_have_attribute("aria-valuenow", f"{end:g}")


def test_a_fast_drag_of_a_slider_ends_where_it_is_let_go(visit, server):
    page = visit("/", width=1440)
    expect(page.get_by_text("minimum 83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    page.get_by_text("Disturbances", exact=True).click()
    slider = page.locator('.q-slider[aria-label="Additional dead time"]')
    page.wait_for_timeout(400)  # until the expansion stands still
    slider.scroll_into_view_if_needed()
    box = slider.bounding_box()
    page.mouse.move(box["x"] + 12, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + box["height"] / 2, steps=40)
    page.mouse.up()
    shown = float(slider.get_attribute("aria-valuenow"))
    assert 1.0 < shown < 1.4
    expect(page.get_by_label("Additional dead time (s)", exact=True)).to_have_value(f"{shown:g}")
    highest = 3.6 * max(server.post("/api/plan", {**SECTION, "delay_s": shown})["plant"]["speed_mps"])
    plant = f"{PLOT}?.data?.find(t => t.name === 'plan of the true plant')"
    page.wait_for_function(f"Math.abs(Math.max(...{plant}.y) - {highest}) < 1e-3")
    assert float(slider.get_attribute("aria-valuenow")) == shown


def test_no_quick_press_on_the_headway_is_lost(visit):
    page = visit("/line", width=1440)
    expect(page.locator('[data-test="result"]')).not_to_be_empty()
    slider = press_quickly(page, "Headway in seconds", "180")
    expect(slider).to_have_attribute("aria-valuenow", "240")
    expect(page.get_by_label("Headway (s)")).to_have_value("240")
    expect(slider).to_have_attribute("aria-valuenow", "240")


LANE = """time_s => { const el = document.querySelector('[data-test=live] .js-plotly-plot');
    const lane = el._fullLayout.yaxis4;
    el.scrollIntoView({ block: 'center' });
    return el.getBoundingClientRect().top + lane._offset + lane.d2p(time_s); }"""
LANE_TOP = f"{PLOT}._fullLayout.yaxis4.range[1]"
ARRIVAL, WISH = (
    f"{PLOT}?.data?.find(t => t.name === '{name}')?" for name in ("scheduled arrival", "not sent yet")
)


def drag_arrival(page, begin, end):
    """Drag the bar of the arrival from one time to another, s; the button stays pressed."""
    height = page.evaluate(LANE, begin)
    box = page.locator(".mp-arrival").bounding_box()
    across = box["x"] + box["width"] / 2
    assert box["y"] < height < box["y"] + box["height"]
    page.mouse.move(across, height)
    page.mouse.down()
    page.mouse.move(across - 9, page.evaluate(LANE, end), steps=6)


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_an_arrival_is_dragged_before_departure(visit, server, width, height):
    page = visit("/", width=width, height=height)
    expect(page.get_by_text("minimum 83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    page.wait_for_function(f"{ARRIVAL}.y[0] === 101")
    slider = page.locator('.q-slider[data-test="time"]')
    least, most = (slider.get_attribute(f"aria-value{end}") for end in ("min", "max"))
    drag_arrival(page, 101, 118)
    expect(slider).to_have_attribute("aria-valuenow", "118")
    page.wait_for_function(f"{ARRIVAL}.y[0] === 118")  # the plan follows while it is held
    page.mouse.up()
    expect(page.get_by_text("Running time 118 s")).to_be_visible()
    plan = server.post("/api/plan", {**SECTION, "time_s": 118})
    lane = f"{PLOT}?.data?.find(t => t.name === 'optimal plan' && t.yaxis === 'y4').y"
    page.wait_for_function(f"Math.abs({lane}.at(-1) - {plan['time_s'][-1]}) < 1e-3")
    drag_arrival(page, 118, 3)
    page.mouse.up()
    expect(slider).to_have_attribute("aria-valuenow", least)
    page.wait_for_function(f"{ARRIVAL}.y[0] === {least}")
    drag_arrival(page, float(least), 1000)
    page.mouse.up()
    expect(slider).to_have_attribute("aria-valuenow", most)
    assert page.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_an_arrival_is_dragged_on_the_way(visit, width, height):
    page = visit("/", width=width, height=height)
    live = depart(page, "real time")
    field = page.get_by_label("Arrive after (s)")
    page.wait_for_function(f"{ARRIVAL}.y[0] === 101 && {WISH}.x.length === 0")
    drag_arrival(page, 101, 121)
    expect(field).to_have_value("121")
    page.wait_for_function(f"{WISH}.y[0] === 121 && {WISH}.text[0].includes('not sent yet')")
    page.mouse.up()
    expect(page.locator('[data-mp="scheduled"]')).to_contain_text("101")
    assert page.locator('[data-mp="log"] li').count() == 0
    drag_arrival(page, 121, 115)
    page.mouse.up()
    expect(field).to_have_value("115")
    page.locator('[data-test="tell-arrival"]').click()
    expect(page.locator('[data-mp="log"]')).to_contain_text("new arrival time, later: after 115 s")
    page.wait_for_function(f"{ARRIVAL}.y[0] === 115 && {WISH}.x.length === 0")
    expect(page.locator('[data-mp="scheduled"]')).to_contain_text("115")
    top = page.evaluate(f"Math.floor({LANE_TOP})")
    drag_arrival(page, 115, top)
    page.mouse.up()
    page.wait_for_function(f"{LANE_TOP} > {top} + 20")  # the lane grows where the bar is let go at its top
    drag_arrival(page, top, top + 15)
    page.mouse.up()
    expect(field).to_have_value(re.compile(rf"{top + 14}|{top + 15}|{top + 16}"))
    field.fill("9000")
    page.wait_for_function(f"{LANE_TOP} > 9000")
    field.fill("130")
    page.wait_for_function(
        f"{WISH}.y[0] === 130 && {LANE_TOP} < 300"
    )  # a far time that is taken back leaves no room
    page.locator('[data-test="stop"]').click()
    expect(live).to_have_attribute("data-status", "stopped")
    page.locator('[data-mp="take"]').click()
    expect(live).to_have_attribute("data-hand", "false")
    page.wait_for_function(f"{ARRIVAL}.y[0] === 115 && {WISH}.x.length === 0")
    expect(page.locator(".mp-arrival")).to_be_hidden()


def test_a_run_that_is_over_shows_its_time_and_arrival(visit, server, driven):
    columns = server.get(f"/api/jobs/{driven}/drive")["columns"]
    page = visit(f"/?run={driven}", width=1440)
    expect(page.get_by_role("slider", name="Moment")).to_be_visible()
    page.wait_for_function(f"{ARRIVAL}.y[0] === 101")
    drawn = page.evaluate(f"{PLOT}?.data?.find(t => t.name === 'driven' && t.yaxis === 'y4').y")
    assert drawn == pytest.approx(columns["time_s"])
    expect(page.locator(".mp-arrival")).to_be_hidden()
    page.get_by_role("slider", name="Moment").fill("50")
    page.get_by_label("Arrive after (s)").fill("120")  # an update of the page leaves the moment where it is
    page.wait_for_timeout(300)
    expect(page.get_by_role("slider", name="Moment")).to_have_value("50")
    head = f"{PLOT}.data.filter(t => t.yaxis === 'y4' && t.mode === 'markers')[0].y[0]"
    page.wait_for_function(f"Math.abs({head} - {columns['time_s'][50]}) < 1e-6")
    path, _ = taken(page, 0, "Values of the plot as CSV")
    with path.open(encoding="utf-8-sig", newline="") as file:
        names, first, *_ = csv.reader(file)
    assert first[names.index("scheduled arrival: time (s)")] == "101"
    assert first[names.index("driven: time (s)")] == f"{columns['time_s'][0]:g}"

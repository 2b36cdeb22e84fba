"""The page Edit: own lines and trainsets as forms, saved version by version, two hands at one of them."""

import re
import tomllib

import pytest
from playwright.sync_api import expect

PATIENCE_MS = 60_000
DRAWN = "document.querySelector('[data-test=drawing]').data"


def cell(page, name):
    return page.get_by_label(name, exact=True)


def save(page, version):
    page.locator('[data-test="save"]').click()
    expect(page.locator('[data-test="status"]')).to_have_text(
        f"saved as version {version}", timeout=PATIENCE_MS
    )


def read_saved(server, page, kind):
    """The saved document that a page shows, and its id."""
    page.wait_for_url(re.compile(rf"/edit\?{kind}=upload-"))
    key = page.url.partition("=")[2]
    return tomllib.loads(server.client.get(f"/api/{kind}s/{key}/toml").text), key


@pytest.mark.parametrize("width", [1440, 390])
def test_a_line_is_copied_edited_saved_and_driven_on(visit, server, width):
    page = visit("/edit?line=yizhuang", width=width, height=900)
    limit = cell(page, "speed_limits.values row 4 speed")
    expect(limit).to_have_value("80")
    expect(page.locator('[data-test="status"]')).to_have_text("not saved")
    limit.fill("800")
    wrong = page.get_by_text("speed_limits.values[3].speed: ").first
    expect(wrong).to_contain_text("800 km/h (allowed: > 0 km/h and <= 540 km/h)")
    expect(page.locator('[data-test="save"]')).to_be_disabled()
    limit.fill("60")
    expect(wrong).to_be_hidden()
    page.wait_for_function(f"Math.round({DRAWN}[0].y[3]) === 60")
    save(page, 1)
    document, key = read_saved(server, page, "line")
    assert document["id"] == "yizhuang-copy"
    assert document["speed_limits"]["values"][3] == [1090, 60]
    assert document["stations"]["source"].startswith("12th Chinese")
    page.get_by_role("button", name="Add a row after row 4 of speed_limits.values").click()
    expect(page.get_by_text("speed_limits.values[4].from").first).to_be_visible()
    cell(page, "speed_limits.values row 5 from").fill("2000")
    cell(page, "speed_limits.values row 5 speed").fill("70")
    save(page, 2)
    assert read_saved(server, page, "line")[0]["speed_limits"]["values"][3:5] == [[1090, 60], [2000, 70]]
    for _ in range(3):
        page.locator('[data-test="undo"]').click()
    expect(cell(page, "speed_limits.values row 5 from")).to_have_value("2511")
    page.locator('[data-test="redo"]').click()
    expect(cell(page, "speed_limits.values row 5 from")).to_have_value("1090")
    page.get_by_role("button", name="Open version 1").click()
    save(page, 3)
    assert read_saved(server, page, "line")[0] == document
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    with page.expect_popup() as opened:
        page.get_by_role("link", name="Drive", exact=True).last.click()
    drive = opened.value
    expect(
        drive.get_by_text("SJZ · Songjiazhuang").or_(drive.locator('[value^="SJZ"]')).first
    ).to_be_attached()
    section = {"line": key, "origin": "SJZ", "destination": "XC"}
    least = server.post("/api/section", section)["minimum_running_time_s"]
    expect(drive.get_by_text(f"minimum {least:.1f} s")).to_be_visible(timeout=PATIENCE_MS)
    assert least > server.post("/api/section", section | {"line": "yizhuang"})["minimum_running_time_s"] + 1


@pytest.mark.parametrize("width", [1440, 390])
def test_a_trainset_is_drawn_as_one_types_and_compared(visit, server, width):
    page = visit("/edit?trainset=dkz32", width=width)
    mass = cell(page, "mass.loads row 1 mass")
    expect(mass).to_have_value("194.295")
    page.wait_for_function(f"{DRAWN}?.length === 6")
    start = page.evaluate(f"{DRAWN}[4].y[60]")
    mass.fill("250")
    page.wait_for_function(f"{DRAWN}[4].y[60] < {0.85 * start}")
    force = cell(page, "traction.pieces row 1 constant")
    force.fill("150")
    page.wait_for_function(f"Math.round({DRAWN}[0].y[0]) === 150")
    speed = page.get_by_label("Max speed (km/h)")
    speed.fill("8000")
    field = page.locator("label").filter(has_text="Max speed (km/h)")
    expect(field).to_contain_text("out of range (allowed: > 0 km/h and <= 540 km/h)")
    speed.fill("")
    expect(field).to_contain_text("missing")
    speed.fill("80")
    page.get_by_label("Adhesion").fill("0.15")
    save(page, 1)
    document, key = read_saved(server, page, "trainset")
    assert document["mass"]["loads"]["AW0"] == 250
    assert document["limits"]["adhesion"] == 0.15
    assert document["limits"]["units"]["adhesion"] == "1"
    with page.expect_popup() as opened:
        page.get_by_role("link", name="Compare", exact=True).last.click()
    compare = opened.value
    expect(compare.get_by_text("AW0 · 250 t")).to_be_attached(timeout=PATIENCE_MS)
    expect(compare.locator('[data-test="second"]')).to_contain_text("The next second", timeout=PATIENCE_MS)
    told = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ", "time_s": 110}
    energy = [server.post("/api/plan", told | {"trainset": name})["energy_j"] for name in ("dkz32", key)]
    assert energy[1] > 1.2 * energy[0]


def test_two_hands_at_one_line(visit, server):
    first = visit("/edit?line=lu2023")
    limit = "speed_limits.values row 1 speed"
    before = cell(first, limit).input_value()
    cell(first, limit).fill("70")
    save(first, 1)
    _, key = read_saved(server, first, "line")
    second = visit(f"/edit?line={key}")
    expect(cell(second, limit)).to_have_value("70")
    cell(second, limit).fill("65")
    cell(first, limit).fill("75")
    save(first, 2)
    told = second.locator('[data-test="meanwhile"]')
    expect(told).to_contain_text("Version 2 was saved elsewhere while you edit version 1")
    expect(cell(second, limit)).to_have_value("65")
    second.locator('[data-test="open-theirs"]').click()
    expect(cell(second, limit)).to_have_value("75")
    second.locator('[data-test="undo"]').click()
    expect(cell(second, limit)).to_have_value("65")
    save(second, 3)
    expect(first.locator('[data-test="meanwhile"]')).to_contain_text("Version 3 was saved elsewhere")
    cell(first, limit).fill(before)
    first.locator('[data-test="save-mine"]').click()
    expect(first.locator('[data-test="status"]')).to_have_text("saved as version 4")
    found = [
        tomllib.loads(server.client.get(f"/api/lines/{key}/toml?version={n}").text)["speed_limits"]["values"][
            0
        ][1]
        for n in (1, 2, 3, 4)
    ]
    assert found == [70, 75, 65, float(before)]


@pytest.mark.parametrize("width", [1440, 390])
def test_rows_are_pasted_from_a_spreadsheet(visit, server, width):
    page = visit("/edit?line=lu2023", width=width)
    rows = "0\t60\n300\t75,5\n".replace(",", ".") + "900\t50\n"
    first = cell(page, "speed_limits.values row 1 from")
    first.click()
    page.evaluate(
        """text => { const data = new DataTransfer(); data.setData('text/plain', text);
        document.activeElement.dispatchEvent(new ClipboardEvent('paste', {clipboardData: data, bubbles: true,
        cancelable: true})); }""",
        rows,
    )
    expect(cell(page, "speed_limits.values row 3 speed")).to_have_value("50")
    save(page, 1)
    assert read_saved(server, page, "line")[0]["speed_limits"]["values"][:3] == [
        [0, 60],
        [300, 75.5],
        [900, 50],
    ]


def test_what_is_not_there_is_told(visit):
    page = visit("/edit?line=../../etc/passwd.toml")
    expect(page.locator('[data-test="problem"]')).to_contain_text("no such line")


def test_trainsets_are_listed_and_drawn(visit):
    page = visit("/lines")
    page.locator('[data-test="trainsets"]').get_by_role("button", name="DKZ32").first.click()
    expect(page.locator('[data-test="effort"] .scatterlayer .trace').first).to_be_attached(
        timeout=PATIENCE_MS
    )
    expect(page.get_by_role("link", name="Edit a copy")).to_be_visible()


def drag_handle(page, kind, row, right, down):
    """Drag a handle of the drawing by pixels; it is taken in its middle."""
    handle = page.locator(f'.mp-handle[data-kind="{kind}"][data-row="{row}"]')
    handle.scroll_into_view_if_needed()
    box = handle.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + right, y + down, steps=5)
    expect(page.locator(".mp-handle[data-value]")).to_have_count(1)
    page.mouse.up()
    expect(page.locator(".mp-handle[data-value]")).to_have_count(0)


@pytest.mark.parametrize("width", [1440, 390])
def test_a_limit_and_a_station_are_dragged_in_the_drawing(visit, width):
    page = visit("/edit?line=yizhuang", width=width, height=900)
    speed, begin = (cell(page, f"speed_limits.values row 4 {name}") for name in ("speed", "from"))
    expect(page.locator(".mp-handle")).to_have_count(34 + 33 + 14)
    drag_handle(page, "speed", 3, 0, 25)
    expect(speed).to_have_value("65")
    page.wait_for_function(f"Math.round({DRAWN}[0].y[3]) === 65")
    drag_handle(page, "speed", 3, 0, 300)
    expect(speed).to_have_value("5")  # no limit is dragged to a standstill
    drag_handle(page, "from", 3, -8, 0)
    expect(begin).not_to_have_value("1090")
    assert 520 < int(begin.input_value()) < 1090
    place = cell(page, "stations.list row 4 position")
    drag_handle(page, "station", 3, 14, 0)
    expect(place).not_to_have_value("6272")
    assert 6272 < int(place.input_value()) < 8254
    for _ in range(4):
        page.locator('[data-test="undo"]').click()  # each drag is one change
    expect(place).to_have_value("6272")
    expect(begin).to_have_value("1090")
    expect(speed).to_have_value("80")
    expect(page.locator('[data-test="undo"]')).to_be_disabled()
    assert page.evaluate("document.documentElement.scrollWidth") <= width

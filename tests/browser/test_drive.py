"""The page Drive: depart, news on the way, the lever by hand, KPIs."""

import re
import shutil
import time

import pytest
from playwright.sync_api import expect
from tests.web.program import Server

from metropilot.policy import shipped_policy

PATIENCE_MS = 60_000


def number(page, part):
    text = page.locator(f'[data-mp="{part}"]').inner_text().replace("−", "-")
    found = re.search(r"-?\d+(\.\d+)?", text)
    return float(found[0]) if found else None


def until(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.1)


def choose(page, label, option):
    page.get_by_label(label, exact=True).click()
    page.get_by_role("option", name=option, exact=True).click()


def depart(page, pace="10 ×"):
    expect(page.get_by_text("minimum 83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    choose(page, "Pace", pace)
    page.locator('[data-test="depart"]').click()
    live = page.locator('[data-test="live"]')
    expect(live).to_have_attribute("data-status", "running", timeout=PATIENCE_MS)
    until(lambda: float(live.get_attribute("data-position") or 0) > 0)
    return live


def count_points(page, name):
    """Number of points of a curve of the picture."""
    script = """name => { const el = document.querySelector('[data-test=live] .js-plotly-plot');
        const curve = el?.data?.find(t => t.name === name);
        return curve ? curve.x.length : 0; }"""
    return page.evaluate(script, name)


def first_point(page, name):
    """Beginning of a curve of the picture."""
    script = """name => document.querySelector('[data-test=live] .js-plotly-plot')
        .data.find(t => t.name === name).x[0]"""
    return page.evaluate(script, name)


@pytest.mark.parametrize("width", [1440, 390])
def test_a_run_from_departure_to_kpis(visit, width):
    page = visit("/", width=width)
    live = depart(page, "30 ×")
    expect(live).to_have_attribute("data-status", "done", timeout=PATIENCE_MS)
    result = page.locator('[data-test="result"]')
    expect(result.get_by_text("stops at the mark")).to_be_visible()
    expect(result.get_by_text("✓ passed")).to_have_count(5)
    expect(result.get_by_text("above the optimum", exact=True)).to_be_visible()
    assert number(page, "time") == pytest.approx(101, abs=3)
    assert number(page, "distance") == pytest.approx(0, abs=0.3)
    assert count_points(page, "driven") > 400
    assert count_points(page, "optimal plan") > 50
    with page.expect_download() as download:
        page.evaluate("document.querySelectorAll('[data-test=result] a').forEach(a => a.target = '')")
        result.get_by_role("link", name="trajectory.csv").click()
    assert download.value.suggested_filename.endswith("trajectory.csv")


@pytest.mark.parametrize("width", [1440, 390])
def test_told_to_arrive_later_on_the_way(visit, width):
    page = visit("/", width=width)
    live = depart(page, "real time")
    page.get_by_label("Arrive after (s)").fill("125")
    page.locator('[data-test="tell-arrival"]').click()
    expect(page.locator('[data-mp="log"]')).to_contain_text("new arrival time, later: after 125 s")
    expect(page.locator('[data-mp="scheduled"]')).to_contain_text("125")
    choose(page, "Pace", "10 ×")
    expect(live).to_have_attribute("data-status", "done", timeout=PATIENCE_MS)
    assert number(page, "time") == pytest.approx(125, abs=3)


@pytest.mark.parametrize("width", [1440, 390])
def test_a_restriction_added_on_the_way(visit, width):
    page = visit("/", expected=("422",), width=width)
    live = depart(page, "real time")
    page.get_by_label("From (m)").fill("800")
    page.get_by_label("To (m)").fill("900")
    page.get_by_label("Speed (km/h)").fill("30")
    page.locator('[data-test="restrict"]').click()
    expect(page.locator('[data-mp="log"]')).to_contain_text(
        "restriction announced: 30 km/h from 800 to 900 m"
    )
    expect(page.locator(".mp-restrictions rect")).to_have_count(1)
    choose(page, "Pace", "5 ×")
    until(lambda: number(page, "speed") > 30)
    page.get_by_label("From (m)").fill("1")
    page.get_by_label("To (m)").fill("1270")
    page.locator('[data-test="restrict"]').click()
    expect(page.get_by_text("no brake could keep it")).to_be_visible()
    until(lambda: float(live.get_attribute("data-position")) > 805)
    assert number(page, "speed") < 30.1
    expect(live).to_have_attribute("data-status", "done", timeout=PATIENCE_MS)


@pytest.mark.parametrize("width", [1440, 390])
def test_restrictions_and_an_objective_before_departure(visit, server, width):
    page = visit("/", width=width)
    expect(page.get_by_text("minimum 83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    speeds = (
        "document.querySelector('[data-test=live] .js-plotly-plot .ylines-above').getBoundingClientRect()"
    )
    page.locator('[data-test="live"] .js-plotly-plot .ylines-above').first.wait_for(
        state="attached", timeout=PATIENCE_MS
    )
    if width > 390:  # the speed plot is in the first view of a desktop
        assert page.evaluate(f"{speeds}.bottom") < 900
    expect(page.locator('[data-test="driver-words"]')).to_contain_text("Own: Convex optimal plan")
    choose(page, "Plans save", "Energy at the line")
    page.get_by_text("Speed restrictions", exact=True).click()
    page.get_by_role("button", name="Add a restriction").click()
    rows = page.locator('[data-test="restrictions"]')
    rows.get_by_label("Speed (km/h)").fill("30")
    page.get_by_role("button", name="Add a restriction").click()
    rows.get_by_label("Sent after").nth(1).fill("5")
    expect(page.get_by_text("minimum 83.3 s")).to_be_hidden(timeout=PATIENCE_MS)
    rows.get_by_label("To (m)").nth(0).fill("9000")
    expect(page.locator('[data-test="problem"]').first).to_contain_text("restriction", timeout=PATIENCE_MS)
    rows.get_by_label("To (m)").nth(0).fill("600")
    expect(page.locator('[data-test="problem"]').first).to_have_text("", timeout=PATIENCE_MS)
    choose(page, "Pace", "30 ×")
    page.locator('[data-test="depart"]').click()
    live = page.locator('[data-test="live"]')
    expect(live).to_have_attribute("data-status", "done", timeout=PATIENCE_MS)
    asked = server.get("/api/jobs?kind=live&limit=1")[0]["request"]
    assert asked["objective"] == "line"
    told = [
        (r["from_m"], r["to_m"], round(3.6 * r["limit_mps"], 6), r["at_s"]) for r in asked["restrictions"]
    ]
    assert told == [(500, 600, 30, None), (700, 800, 40, 5)]
    expect(page.locator('[data-mp="log"]')).to_contain_text(
        "restriction announced: 40 km/h from 700 to 800 m"
    )
    page.goto(page.url)
    expect(rows.get_by_label("From (m)")).to_have_count(2, timeout=PATIENCE_MS)
    expect(rows.get_by_label("Speed (km/h)").first).to_have_value("30")


@pytest.mark.parametrize("width", [1440, 390])
def test_the_options_of_a_driver_are_fields(visit, server, width):
    page = visit("/", expected=("422",), width=width)
    expect(page.get_by_text("minimum 83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    choose(page, "Driver", "pid")
    expect(page.locator('[data-test="driver-words"]')).to_contain_text("Published: Incremental PID")
    page.get_by_text("Driver options", exact=True).click()
    options = page.locator('[data-test="driver-options"]')
    expect(options.get_by_label("kp", exact=True)).to_have_value("3.4")
    options.get_by_label("kp", exact=True).fill("-2")
    page.locator('[data-test="depart"]').click()
    expect(options.locator(".q-field--error")).to_contain_text("allowed", timeout=PATIENCE_MS)
    options.get_by_label("kp", exact=True).fill("3")
    options.get_by_text("station stop").click()
    choose(page, "Pace", "30 ×")
    page.locator('[data-test="depart"]').click()
    live = page.locator('[data-test="live"]')
    expect(live).to_have_attribute("data-status", re.compile("running|done"), timeout=PATIENCE_MS)
    asked = server.get("/api/jobs?kind=live&limit=1")[0]
    assert asked["request"]["options"] == {"kp": 3, "station_stop": False}
    page.goto(f"{server.url}/?run={asked['id']}")
    expect(options.get_by_label("kp", exact=True)).to_have_value("3", timeout=PATIENCE_MS)
    choose(page, "Driver", "manual")
    expect(page.get_by_text("Driver options", exact=True)).to_be_hidden()


def test_the_lever_by_hand_from_the_keyboard(visit):
    page = visit("/")
    live = depart(page, "real time")
    page.locator("body").press("m")
    expect(live).to_have_attribute("data-hand", "true")
    for _ in range(10):
        page.keyboard.press("ArrowUp")
    expect(page.locator('[data-mp="hand"]')).to_have_text("manual: 100 %")
    expect(page.locator('[data-mp="log"]')).to_contain_text("the lever is taken by hand")
    page.locator("body").press("b")
    expect(page.locator('[data-mp="hand"]')).to_have_text("manual: -100 %")
    until(lambda: "brake" in page.locator('[data-mp="command"]').inner_text())
    page.keyboard.press("Escape")
    expect(page.locator('[data-mp="log"]')).to_contain_text("the lever is returned to the driver")
    page.get_by_role("button", name="Stop", exact=True).click()
    expect(live).to_have_attribute("data-status", "stopped", timeout=PATIENCE_MS)


def test_a_hand_that_goes_too_fast_is_supervised(visit):
    page = visit("/", expected=("409",))  # the lever may be renewed once more when the run is over
    live = depart(page, "10 ×")
    page.locator("body").press("m")
    for _ in range(10):
        page.keyboard.press("ArrowUp")
    until(lambda: count_points(page, "protection") > 0)
    assert number(page, "speed") <= 80.0
    page.keyboard.press("Escape")
    expect(live).to_have_attribute("data-status", "done", timeout=PATIENCE_MS)
    expect(page.locator('[data-test="result"]').get_by_text("no overspeed")).to_be_visible()


TOLD = {
    "line": "yizhuang",
    "origin": "TJN",
    "destination": "JHL",
    "time_s": 163.5,
    "trainset": "dkz32",
    "load": "AW2",
    "driver": "manual",
    "mass_factor": 1.05,
    "seed": 7,
    "dt_s": 0.1,
    "pace": 0,
}


def stop_all(server):
    for live in server.get("/api/live"):
        if live["status"] == "running":
            server.post(f"/api/live/{live['id']}/stop")


def expect_restored(page):
    """The form of a page that came by a link to ``TOLD``."""
    expect(page.get_by_text("Running time 164 s · minimum")).to_be_visible(timeout=PATIENCE_MS)
    expect(page.get_by_label("From", exact=True)).to_have_value("TJN · Tongji South Road")
    expect(page.get_by_label("To", exact=True)).to_have_value("JHL · Jinghai Road")
    expect(page.get_by_label("Load", exact=True)).to_have_value(re.compile("AW2"))
    expect(page.get_by_label("Driver", exact=True)).to_have_value("manual")
    mass = page.get_by_role("spinbutton", name="True mass / nominal")
    expect(mass).to_have_value("1.05")
    expect(page.get_by_label("Seed", exact=True)).to_have_value("7")
    expect(page.get_by_label("Control period (s)")).to_have_value("0.1")
    expect(page.locator(".mp-strip text[font-weight='700']").first).to_have_text(re.compile("TJN"))


def test_a_link_restores_the_form_the_map_and_the_time(visit, server):
    live = server.post("/api/live", TOLD, code=201)["id"]
    server.post(f"/api/live/{live}/arrival", {"scheduled_time_s": 180})
    page = visit(f"/?run={live}")
    expect_restored(page)
    expect(page.locator('[data-mp="scheduled"]')).to_contain_text("180")
    page.get_by_role("button", name="10 s later").click()
    expect(page.locator('[data-mp="log"]')).to_contain_text("after 190 s")
    server.post(f"/api/live/{live}/arrival", {"scheduled_time_s": 185})
    page.get_by_role("button", name="10 s later").click()
    expect(page.locator('[data-mp="log"]')).to_contain_text("after 195 s")
    page.locator('[data-test="stop"]').click()
    expect(page.locator('[data-mp="status"]')).to_have_text("stopped; it can be resumed")
    page.locator('[data-test="depart"]').click()
    expect(page.locator('[data-test="live"]')).not_to_have_attribute("data-run", live)
    expect(page.locator('[data-test="live"]')).to_have_attribute("data-status", "running")
    again = server.get("/api/live/" + page.locator('[data-test="live"]').get_attribute("data-run"))
    assert {name: again["request"][name] for name in TOLD if name != "pace"} == {
        name: value for name, value in TOLD.items() if name != "pace"
    }
    stop_all(server)


def test_the_list_opens_stops_and_resumes(visit, server):
    stop_all(server)
    live = server.post("/api/live", TOLD, code=201)["id"]
    page = visit("/compare")
    page.get_by_role("link", name="Drive", exact=True).click()
    row = page.locator(f'[data-run="{live}"].mp-run')
    expect(row).to_contain_text("TJN – JHL · manual · 163.5 s")
    expect(row).to_contain_text("0:00.0 · paused · no viewer")
    row.get_by_role("link", name=re.compile("Open")).click()
    expect_restored(page)
    expect(row).to_contain_text("(this one)")
    expect(row).to_contain_text("1 watching")
    row.get_by_role("button", name=re.compile("Stop")).click()
    expect(row).to_have_attribute("data-status", "stopped")
    expect(page.locator('[data-mp="status"]')).to_have_text("stopped; it can be resumed")
    row.get_by_role("button", name=re.compile("Resume")).click()
    expect(page.locator('[data-test="live"]')).to_have_attribute("data-status", "running")
    expect_restored(page)
    stop_all(server)


def test_a_link_after_a_restart_offers_to_resume(browser, tmp_path):
    first = Server(tmp_path)
    live = first.post("/api/live", {**TOLD, "pace": 30}, code=201)["id"]
    until(lambda: first.get(f"/api/live/{live}")["time_s"] > 20)
    first.kill()
    again = Server(tmp_path)
    page = browser.new_page()
    try:
        page.goto(f"{again.url}/?run={live}")
        expect_restored(page)
        said = "interrupted: the server was restarted; it can be resumed"
        expect(page.locator('[data-mp="status"]')).to_have_text(said)
        page.locator('[data-test="resume"]').click()
        live_run = page.locator('[data-test="live"]')
        expect(live_run).to_have_attribute("data-status", "done", timeout=2 * PATIENCE_MS)
        expect(page.locator('[data-mp="status"]')).to_have_text("arrived at its end")
        page.reload()
        expect(page.locator('[data-test="result"]').get_by_text("stops at the mark")).to_be_visible()
        assert "Traceback" not in (tmp_path / "server.log").read_text()
    finally:
        page.close()
        again.close()


def test_two_pages_and_one_lever(visit, server):
    live = server.post("/api/live", TOLD, code=201)["id"]
    one, two = visit(f"/?run={live}"), visit(f"/?run={live}", expected=("409",))
    for page in (one, two):
        expect(page.locator('[data-test="live"]')).to_have_attribute("data-status", "running")
        expect(page.locator('[data-mp="hand"]')).to_have_text("the driver has it")
    one.locator("body").press("m")
    expect(one.locator('[data-mp="hand"]')).to_have_text("manual: 0 %")
    held = one.locator('[data-test="live"]').get_attribute("data-holder")
    expect(two.locator('[data-mp="hand"]')).to_have_text(f"held by {held} since 0.0 s")
    two.locator("body").press("m")
    expect(two.locator('[data-test="live"]')).to_have_attribute("data-hand", "false")
    one.locator("body").press("ArrowUp")
    expect(one.locator('[data-mp="hand"]')).to_have_text("manual: 10 %")
    two.get_by_role("button", name="Take the lever over").click()
    expect(two.locator('[data-mp="hand"]')).to_have_text("manual: 0 %")
    other = two.locator('[data-test="live"]').get_attribute("data-holder")
    expect(one.locator('[data-mp="hand"]')).to_have_text(f"held by {other} since 0.0 s")
    two.wait_for_timeout(4000)
    expect(two.locator('[data-mp="hand"]')).to_have_text("manual: 0 %")
    two.goto("about:blank")
    expect(one.locator('[data-mp="hand"]')).to_have_text("the driver has it")
    stop_all(server)


def test_a_run_that_cannot_start_says_why_beside_the_button(visit):
    page = visit("/")
    expect(page.get_by_text("minimum 83.3 s")).to_be_visible(timeout=PATIENCE_MS)
    choose(page, "Driver", "learned")
    page.locator('[data-test="depart"]').click()
    problem = page.locator('[data-test="departure-problem"]')
    expect(problem).to_contain_text("needs a policy")
    expect(page.locator('[data-test="live"]')).to_have_attribute("data-status", "none")


def test_a_reload_finds_the_run_again(visit):
    page = visit("/")
    gone = depart(page, "2 ×")
    until(lambda: float(gone.get_attribute("data-position")) > 20)
    page.reload()
    live = page.locator('[data-test="live"]')
    expect(live).to_have_attribute("data-status", "running", timeout=PATIENCE_MS)
    until(lambda: count_points(page, "driven") > 5)
    assert first_point(page, "driven") < 5.0, "what was driven before the reload is not there"
    page.get_by_role("button", name="Stop", exact=True).click()
    expect(live).to_have_attribute("data-status", "stopped", timeout=PATIENCE_MS)


def test_what_was_learned_drives_and_its_link_restores_it(visit, server):
    runs = ("ppo-20260202-120000-ab12", "ppo-20260203-120000-ab12")
    for run in runs:
        (server.data / "runs" / run).mkdir(parents=True)
        shutil.copyfile(shipped_policy("ppo"), server.data / "runs" / run / "policy.safetensors")
    told = {**TOLD, "driver": "learned", "options": {"policy": runs[0]}}
    live = server.post("/api/live", told, code=201)["id"]
    page = visit(f"/?run={live}")
    expect(page.get_by_text("Running time 164 s · minimum")).to_be_visible(timeout=PATIENCE_MS)
    expect(page.get_by_label("Driver", exact=True)).to_have_value(f"learned · {runs[0]}")
    choose(page, "Driver", f"learned · {runs[1]}")
    page.locator('[data-test="depart"]').click()
    view = page.locator('[data-test="live"]')
    expect(view).not_to_have_attribute("data-run", live)
    expect(view).to_have_attribute("data-status", "running")
    body = server.get("/api/live/" + view.get_attribute("data-run"))["request"]
    assert (body["driver"], body["options"], body["dt_s"]) == (f"learned:policy={runs[1]}", {}, 0.1)
    stop_all(server)

"""The page Fit: logs are dropped, a trainset is fitted, looked at and saved as one's own."""

import csv
import re

import numpy as np
import pytest
from playwright.sync_api import expect

from metropilot.evaluate import make_driver
from metropilot.railway import load_line, load_trainset
from metropilot.sim import Disturbance, Run, drive

PATIENCE_MS = 60_000


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Noisy log of a run of a heavier trainset, its first 20 s, and one that is none."""
    folder = tmp_path_factory.mktemp("logs")
    section = load_line("yizhuang").section("RJ", "WYJ")
    plant = Disturbance(mass_factor=1.1, delay_s=0.4, lag_s=0.3)
    driven = drive(Run(section, load_trainset("dkz32"), 130.0, plant), make_driver("manual")).trajectory
    noise = np.random.default_rng(1).normal(0.0, 0.05, driven.time_s.size)
    for name, most in (("monday.csv", 1000.0), ("departure.csv", 20.0)):
        with (folder / name).open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["time [s]", "speed [km/h]", "command", "position [m]"])
            for k, time_s in enumerate(driven.time_s):
                if time_s <= most:
                    speed = 3.6 * max(driven.speed_mps[k] + noise[k], 0.0)
                    rows.writerow(
                        [round(time_s, 2), round(speed, 1), driven.command[k], driven.position_m[k]]
                    )
    (folder / "bad.csv").write_text("time [s],speed [furlong]\n" + "1,1\n" * 40)
    return folder


def choose(page, label, option):
    page.get_by_role("combobox", name=label, exact=True).click()
    page.get_by_role("option", name=option).first.click()  # those of the catalogue come first
    expect(page.get_by_role("option")).to_have_count(0)


@pytest.mark.parametrize("width", [1440, 390])
def test_a_trainset_is_fitted_to_a_dropped_log_and_saved(visit, server, logs, width):
    page = visit("/lines", width=width, height=900)
    page.locator('[data-test="to-fit"]').click()
    said = page.locator('[data-test="log-said"]')
    page.locator("input[type=file]").set_input_files([logs / "monday.csv", logs / "bad.csv"])
    expect(said).to_contain_text(re.compile(r"✓ monday.csv: \d+ samples, 2.2 min"), timeout=PATIENCE_MS)
    expect(said).to_contain_text("✗ bad.csv: column 'speed': unknown unit: 'furlong' (allowed: speed in m/s")
    expect(page.get_by_role("checkbox", name="monday.csv").first).to_be_checked()
    choose(page, "Begin from", "DKZ32, six cars, Beijing Subway Yizhuang line")
    choose(page, "Line of the logs", "Beijing Subway Yizhuang line (contest data)")
    choose(page, "From", "RJ")
    choose(page, "To", "WYJ")
    page.locator('[data-test="fit"]').click()
    table = page.get_by_role("table", name="Parameters")
    expect(table).to_be_visible(timeout=PATIENCE_MS)
    mass = table.get_by_role("row").filter(has_text="mass / nominal").get_by_role("cell").all_inner_texts()
    assert float(mass[2]) == pytest.approx(1.1, abs=0.02)
    low, high = map(float, mass[3].split(" to "))
    assert low < float(mass[2]) < high < low + 0.1
    remarks = page.locator('[data-test="remarks"]')
    expect(remarks).to_contain_text("commands cannot tell them apart")
    drawn = "document.querySelector('[data-test=residuals]').data.map(t => t.x.length)"
    page.wait_for_function("document.querySelector('[data-test=residuals]').data?.length === 4")
    measured, simulated, left, apart = page.evaluate(drawn)
    assert measured == simulated == left > 300
    assert apart > 10
    page.locator('[data-test="save"]').click()
    saved = page.locator('[data-test="saved"]')
    expect(saved).to_contain_text("fitted to logs, version 1")
    key = re.search(r"trainset=(upload-\w+)", saved.get_by_role("link", name="Edit").get_attribute("href"))[1]
    assert server.get(f"/api/trainsets/{key}")["loads_kg"]["AW0"] == pytest.approx(1.1 * 194_295, rel=0.02)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.goto(page.url)
    expect(page.get_by_role("table", name="Parameters")).to_be_visible(timeout=PATIENCE_MS)
    expect(page.get_by_role("checkbox", name="monday.csv").first).to_be_checked()
    choices = page.get_by_role("combobox", name="Save as", exact=True)
    choices.click()
    page.get_by_role("option", name="Next version of").first.click()
    page.locator('[data-test="save"]').click()
    expect(page.locator('[data-test="saved"]')).to_contain_text("version 2")


def test_what_the_logs_do_not_tell_is_one_line(visit, logs):
    page = visit("/fit?trainset=dkz32")
    page.locator('[data-test="fit"]').click()
    expect(page.locator('[data-test="problem"]')).to_contain_text("no log is ticked")
    page.locator("input[type=file]").set_input_files(logs / "departure.csv")
    expect(page.get_by_role("checkbox", name="departure.csv")).to_be_checked(timeout=PATIENCE_MS)
    page.locator('[data-test="fit"]').click()
    refusal = page.locator('[data-test="refusal"]')
    expect(refusal).to_contain_text("brake factor", timeout=PATIENCE_MS)
    expect(refusal).to_contain_text("no braking")
    expect(refusal).to_contain_text("keep: brake")

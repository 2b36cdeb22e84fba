"""Draw the console's pictures anew: ``python tools/console_pictures.py URL [drive compare ...]``.

URL is that of a running `metropilot serve` with an empty folder of data (``--data``); needs the extra
``browser`` and Chromium. Without names it draws all of them into docs/images. What a picture shows it first
computes over HTTP.
"""

import argparse
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "examples"))
from client.metropilot_client import Client  # noqa: E402  # pyright: ignore[reportMissingImports]

OUT = ROOT / "docs" / "images"
PATIENCE_MS = 300_000
COLOURS = 128
READY = "minimum 83.3 s"
SWEEP = 7
"""Headways that the button of the page Line computes."""
LIVE, CONVOY = '[data-test="live"]', '[data-test="convoy"]'


def depart(page: Page, pace: str) -> None:
    """Choose a pace and depart."""
    page.get_by_text(READY).wait_for()
    page.wait_for_timeout(1500)
    page.get_by_label("Pace", exact=True).click()
    page.get_by_role("option", name=pace, exact=True).click()
    page.locator('[data-test="depart"]').click()


def until(page: Page, where: str, what: str, value: float) -> None:
    """Wait until a live run has come so far."""
    while float(page.locator(where).get_attribute(what) or 0) < value:
        time.sleep(0.1)


def drive(page: Page) -> None:
    """A restriction and a later arrival on the way."""
    depart(page, "5 ×")
    until(page, LIVE, "data-position", 250)
    for label, value in (("From (m)", "800"), ("To (m)", "950"), ("Speed (km/h)", "40")):
        page.get_by_label(label, exact=True).fill(value)
    page.locator('[data-test="restrict"]').click()
    page.get_by_label("Arrive after (s)").fill("112")
    page.locator('[data-test="tell-arrival"]').click()
    until(page, LIVE, "data-position", 880)


def phone(page: Page) -> None:
    """Half way."""
    depart(page, "5 ×")
    until(page, LIVE, "data-position", 600)


def compare(page: Page) -> None:
    """Three drivers."""
    page.get_by_text("The next second saves").wait_for()
    page.locator('[data-test="compare"]').click()
    page.locator('[aria-label="Comparison"] tbody tr').first.wait_for()


def journey(page: Page) -> None:
    """The whole line."""
    page.locator('[data-test="sections"] tbody tr').first.wait_for()


def line(page: Page) -> None:
    """A headway and the sweep."""
    page.locator('[data-test="compute"]').click()
    page.get_by_role("link", name="timetable.csv").wait_for()
    page.locator('[data-test="sweep"]').click()
    while page.evaluate("document.querySelector('[data-test=curve]').data[0].x.length") < SWEEP:
        time.sleep(0.5)


def convoy(page: Page) -> None:
    """A link that falls silent."""
    depart(page, "5 ×")
    until(page, CONVOY, "data-time", 48)
    page.locator('[data-test="silent"]').click()
    until(page, CONVOY, "data-time", 62)


def learn(page: Page) -> None:
    """The curves of a job."""
    page.locator('[data-test="curves"] .scatterlayer .trace').first.wait_for()


def edit(page: Page) -> None:
    """A limit that no line has."""
    page.get_by_label("speed_limits.values row 4 speed", exact=True).fill("800")
    page.get_by_text("speed_limits.values[3].speed: ").first.wait_for()


def fit(page: Page) -> None:
    """The residuals of a job."""
    page.locator('[data-test="residuals"] .scatterlayer .trace').first.wait_for()


def lines(page: Page) -> None:
    """A file that cannot be used."""
    page.wait_for_timeout(2500)
    with tempfile.TemporaryDirectory() as folder:
        bad = Path(folder, "bad.toml")
        bad.write_text('kind = "line"\nid = "x"\nname = "My line"\nlength = "12 km"\n')
        page.locator('input[type="file"]').set_input_files(bad)
        page.get_by_text("This file cannot be used").wait_for()


def campaigns(page: Page) -> None:
    """The robustness campaign by driver and disturbance."""
    page.get_by_text("robustness ·").first.click()
    page.get_by_text("heavy, more resistance").first.wait_for()


def runs(page: Page) -> None:
    """Two drives against each other."""
    rows = page.locator('[aria-label="Runs"] tbody tr')
    for driver in ("optimal", "manual"):
        row = rows.filter(has_text=f"· {driver} · 101 s").filter(has_text="Drive")
        row.get_by_role("checkbox").click()
    page.locator('[data-test="compare-two"]').click()
    page.get_by_role("table", name="KPIs of two runs").get_by_role("row").nth(1).wait_for()
    page.locator(".scatterlayer .trace").first.wait_for()


def running(page: Page) -> None:
    """A train that is held for four minutes, a slow section, and the delays until they die away."""
    card = page.locator('[data-test="running"]')
    card.get_by_label("Pace", exact=True).click()
    page.get_by_role("option", name="30 ×", exact=True).click()
    page.locator('[data-test="run-line"]').click()
    until(page, '[data-test="running"]', "data-time", 480)
    for at, field, value, button in (
        ("RJ", "Hold for (s)", "240", "hold"),
        ("JG", "For (s)", "400", "slow"),
    ):
        card.get_by_label("At station", exact=True).click()
        page.get_by_role("option", name=f"{at} ·").click()
        card.get_by_label(field, exact=True).fill(value)
        page.locator(f'[data-test="{button}"]').click()
    until(page, '[data-test="running"]', "data-time", 1650)


def learn_driver(client: Client) -> str:
    """Learn a driver; path of the run."""
    job = client.jobs.learn({"driver": "ppo", "budget": "quick", "evaluations": 16})
    client.wait(job["id"])
    return f"/learn?job={job['id']}"


def fit_trainset(client: Client) -> str:
    """Fit a trainset to the log of one that is heavier and later than it says; path of the fit."""
    section = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ"}
    driven = client.jobs.drive(
        {**section, "time_s": 130.0, "driver": "manual", "mass_factor": 1.1, "delay_s": 0.4}
    )
    client.wait(driven["id"])
    log = client.catalogue.upload("monday run.csv", client.jobs.file(driven["id"], "trajectory.csv"))
    job = client.fits.fit({**section, "logs": [log["id"]]})
    client.wait(job["id"])
    return f"/fit?job={job['id']}"


def make_runs(client: Client) -> str:
    """Make a run of every kind; path of their list."""
    section = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ"}
    made = [
        client.jobs.drive({**section, "driver": driver, "time_s": time_s})
        for driver, time_s in (("optimal", 101.0), ("manual", 101.0), ("flat_out", 95.0))
    ]
    made.append(client.jobs.compare({**section, "drivers": ["optimal", "manual"], "time_s": 101.0}))
    made.append(client.jobs.journey({"line": "yizhuang", "total_s": 1950.0}))
    for job in made:
        client.wait(job["id"])
    return "/runs"


PICTURES: dict[str, tuple[str | Callable[[Client], str], Callable[[Page], None], str]] = {
    "drive": ("/", drive, ""),
    "compare": ("/compare", compare, ""),
    "journey": ("/journey", journey, ""),
    "line": ("/line", line, ""),
    "running": ("/line", running, '[data-test="running"]'),
    "convoy": ("/convoy", convoy, ""),
    "learn": (learn_driver, learn, ""),
    "edit": ("/edit?line=yizhuang", edit, ""),
    "lines": ("/lines", lines, ""),
    "runs": (make_runs, runs, ""),
    "campaigns": ("/campaigns", campaigns, ""),
    "fit": (fit_trainset, fit, ""),
    "phone": ("/", phone, ""),
}
"""Of each picture its page, or what makes it; what is done there; and the part that is shown, or all."""
FIRST_VIEW = frozenset({"edit", "campaigns"})
"""Pages of which the first view is enough."""


def draw(browser: Browser, url: str, name: str) -> None:
    """One picture: made, looked for, kept in few colours so that it stays small."""
    path, act, part = PICTURES[name]
    path = path if isinstance(path, str) else path(Client(url))
    narrow = name == "phone"
    context = browser.new_context(color_scheme="dark" if narrow else "light")
    page = context.new_page()
    page.set_viewport_size({"width": 390, "height": 844} if narrow else {"width": 1280, "height": 900})
    page.set_default_timeout(PATIENCE_MS)
    page.goto(url + path)
    act(page)
    page.wait_for_timeout(1000)
    with tempfile.TemporaryDirectory() as folder:
        raw = Path(folder, "raw.png")
        if part:
            page.locator(part).screenshot(path=raw)
        else:
            page.screenshot(path=raw, full_page=name not in FIRST_VIEW)
        with Image.open(raw) as picture:
            few = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
            few.save(OUT / f"console-{name}.png", optimize=True)
    print(name, (OUT / f"console-{name}.png").stat().st_size, "bytes")
    context.close()


def main() -> None:
    """Draw what is named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("url")
    parser.add_argument("names", nargs="*", choices=PICTURES, default=list(PICTURES))
    given = parser.parse_args()
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-gpu"])
        for name in given.names:
            draw(browser, given.url, name)
        browser.close()


if __name__ == "__main__":
    main()

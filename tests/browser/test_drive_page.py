"""The page on which a reader drives, opened from disk: by itself, by hand, by keyboard."""

from pathlib import Path

import pytest
from playwright.sync_api import expect

PAGE = Path(__file__).parents[2] / "docs" / "assets" / "drive.html"
LEAST_PER_S = 60.0


@pytest.fixture
def page(browser):
    context = browser.new_context(offline=True)
    page = context.new_page()
    page.wrong, page.asked = [], []
    page.on("pageerror", lambda error: page.wrong.append(str(error)))
    page.on("console", lambda said: said.type == "error" and page.wrong.append(said.text))
    page.on("request", lambda request: page.asked.append(request.url))
    page.goto(PAGE.as_uri())
    expect(page.locator("#title")).to_contain_text("Rongjing East Street to Wanyuan")
    yield page
    assert page.wrong == []
    assert page.asked == [PAGE.as_uri()]
    context.close()


def test_the_driver_arrives_and_the_page_keeps_up(page):
    assert page.evaluate("periodsPerSecond()") > LEAST_PER_S
    page.get_by_label("let ppo drive").check()
    page.get_by_label("Speed of time").select_option("12")
    page.get_by_role("button", name="Start").click()
    expect(page.locator("#result")).to_contain_text("Arrived, on time")
    expect(page.locator("#result")).to_contain_text("0 interventions")


def test_protection_takes_the_lever_from_a_reckless_hand(page):
    page.get_by_label("Lever: brake to traction").fill("1")
    page.get_by_label("Speed of time").select_option("12")
    page.get_by_role("button", name="Start").click()
    expect(page.locator("#level")).to_contain_text("Protection:")
    expect(page.locator("#interventions")).not_to_have_text("0")
    page.get_by_role("button", name="Again").click()
    expect(page.locator("#time")).to_have_text("0.0 s")


def test_the_lever_follows_the_keyboard(page):
    page.keyboard.press("ArrowUp")
    page.keyboard.press("ArrowUp")
    expect(page.locator("#command")).to_have_text("20 %")
    page.keyboard.press(" ")
    expect(page.locator("#command")).to_have_text("0 %")

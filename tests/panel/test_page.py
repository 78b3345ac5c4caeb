"""The page in a browser, as an operator uses it; screenshots go to ``reports/panel``."""

from __future__ import annotations

import os
import re
import shutil
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.live.bench import winder
from tests.panel.bench import proven
from tests.panel.test_panel_killed import Plant
from threadline.live.sim_rows import SimRows
from threadline.panel.server import PAGE

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None:
    pytest.skip("there is no chromium", allow_module_level=True)
if not (PAGE / "index.html").exists():
    pytest.skip("the page was not built: make panel", allow_module_level=True)

from playwright.sync_api import Browser, Page, expect, sync_playwright  # noqa: E402

SHOTS = Path(__file__).parents[2] / "reports" / "panel"
SPEED = 0.5
"""Half of real time: the page has 500 ms to renew a jog, on however busy a computer."""
SIZE = {"width": 1280, "height": 1000}


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture
def plant(tmp_path: Path) -> Iterator[Plant]:
    proven(tmp_path)
    SimRows(winder(), np.zeros(3, np.int64), lambda _: None)
    found = Plant(tmp_path, tmp_path / "black-box", SPEED)
    yield found
    os.kill(found.server, signal.SIGKILL)
    os.waitpid(found.server, 0)
    found.end()


def opened(browser: Browser, plant: Plant) -> Page:
    page = browser.new_page(viewport=SIZE)
    page.set_default_timeout(60_000)
    page.goto(f"http://127.0.0.1:{plant.port}/")
    expect(page.locator("#machine")).to_have_text("lathe-winder, simulated", timeout=60_000)
    return page


def shot(page: Page, name: str) -> None:
    SHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SHOTS / f"{name}.png", full_page=True)


def press(page: Page, text: str) -> None:
    page.get_by_role("button", name=text, exact=True).click()


def state(page: Page, name: str) -> None:
    """Wait for a state, whatever reason is told with it."""
    expect(page.locator("#state")).to_have_text(re.compile(rf"{name}(:|$)"), timeout=60_000)


def ready(page: Page) -> None:
    press(page, "Take control")
    press(page, "Enable")
    press(page, "Home all")
    state(page, "idle")


def x_mm(page: Page) -> float:
    return float(page.locator("#at-X").inner_text().split()[0])


def test_home_jog_calculate_run_hold_resume_stop(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    shot(page, "1-opened")
    ready(page)
    plus = page.get_by_label("Jog X plus while held")
    plus.hover()
    page.mouse.down()
    page.wait_for_timeout(500)
    state(page, "jogging")
    page.mouse.up()
    state(page, "idle")
    expect(page.locator("#state")).not_to_contain_text("nobody has renewed")
    let_go = x_mm(page)
    assert let_go > 2.0
    page.wait_for_timeout(400)
    assert x_mm(page) == pytest.approx(let_go, abs=3.0)  # the loop settles; nothing is commanded
    press(page, "Zero all")
    expect(page.locator("#at-X")).to_have_text("0.00 mm", timeout=60_000)
    state(page, "idle")

    press(page, "Calculate")
    expect(page.locator("#figures")).to_contain_text("IN SPEC")
    shot(page, "2-calculated")
    press(page, "Start")
    state(page, "running")
    page.wait_for_timeout(700)
    press(page, "Hold")
    state(page, "holding")
    shot(page, "3-holding")
    press(page, "Resume")
    state(page, "running")
    page.keyboard.press("Escape")
    state(page, "idle")
    expect(page.locator("#progress-text")).to_contain_text("stopped")
    shot(page, "4-stopped")
    page.close()


def test_another_browser_watches_and_may_stop(browser: Browser, plant: Plant) -> None:
    first, second = opened(browser, plant), opened(browser, plant)
    ready(first)
    expect(second.get_by_role("button", name="Home all")).to_be_disabled()
    press(first, "Calculate")
    expect(second.locator("#figures")).to_contain_text("IN SPEC")
    press(first, "Start")
    state(second, "running")
    press(second, "STOP")
    state(first, "idle")
    press(second, "Ask for control")
    press(first, "Give control")
    expect(second.locator("#control")).to_have_text("you have control")
    expect(first.get_by_role("button", name="Home all")).to_be_disabled()
    shot(first, "5-watching")
    first.close()
    second.close()


def test_without_the_server_everything_is_stale(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    ready(page)
    os.kill(plant.server, signal.SIGSTOP)
    expect(page.locator("body")).to_have_class("stale", timeout=5000)
    expect(page.locator("#age")).to_contain_text("no data for")
    expect(page.get_by_role("button", name="Home all")).to_be_disabled()
    expect(page.get_by_role("button", name="STOP")).to_be_enabled()
    shot(page, "6-stale")
    os.kill(plant.server, signal.SIGCONT)
    expect(page.locator("body")).not_to_have_class("stale", timeout=20_000)
    page.close()

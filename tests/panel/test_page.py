"""The page in a browser: jogs, runs, stops, control."""

from __future__ import annotations

import json
import os
import signal
import time
import urllib.request
from typing import Any, cast

import pytest

from tests.panel.browsing import (
    Browser,
    Page,
    begin_jog,
    calculate,
    expect,
    held_and_let_go,
    jog_until,
    looks,
    moved_on,
    opened,
    part,
    press,
    ready,
    shot,
    stands,
    state,
    to_zero,
    x_mm,
)
from tests.panel.test_panel_killed import Plant


def shown_mm(plant: Plant) -> float:
    """Return the commanded X: at rest the time of this machine stands still."""
    with urllib.request.urlopen(f"http://127.0.0.1:{plant.port}/api/state") as answer:
        return 1e3 * float(json.load(answer)["axes"]["X"]["commanded"])


def written_at_rest(page: Page) -> set[str]:
    """Return the elements that the page writes, or rewrites, within the second of this check.

    It begins after two messages of the machine, so that the end of the previous action was shown.
    """
    looks(page, 3)
    return set(page.evaluate(
        """async () => {
          const written = new Set();
          const watching = new MutationObserver((changes) => {
            for (const { target, attributeName } of changes)
              written.add(target.id || attributeName || target.textContent);
          });
          watching.observe(document, {
            subtree: true, childList: true, attributes: true, characterData: true,
          });
          await new Promise((come) => setTimeout(come, 1000));
          watching.disconnect();
          return [...written];
        }"""
    ))  # fmt: skip


def test_home_jog_calculate_run_hold_resume_stop(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    shot(page, "1-opened")
    ready(page)
    held_and_let_go(page, "Jog X plus", 2.0)
    let_go = stands(page)
    page.wait_for_timeout(400)
    assert x_mm(page) == pytest.approx(let_go, abs=0.1)  # nothing is commanded
    to_zero(page, lambda: press(page, "Zero all"))
    # A renewal that comes after the end of the move is no news.
    expect(page.locator("#log")).not_to_contain_text("there is no jog")

    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC")
    shot(page, "2-calculated")
    assert written_at_rest(page) <= {"age"}  # otherwise the page is laid out and drawn all the time
    press(page, "Start")
    state(page, "running")
    moved_on(page, 0.0)
    press(page, "Hold")
    state(page, "holding")
    shot(page, "3-holding")
    press(page, "Resume")
    state(page, "running")
    page.keyboard.press("Escape")
    state(page, "idle")
    expect(page.locator("#progress-text")).to_contain_text("stopped")
    shot(page, "4-stopped")

    part(page, "Review")  # the rest begins at the interrupted line, after a confirmation
    expect(page.locator("#kept")).to_contain_text("stopped", timeout=60_000)
    press(page, "Continue")
    expect(page.locator("#rest-notes")).to_contain_text("the work begins again at line")
    expect(page.get_by_role("button", name="Start the rest")).to_be_enabled()
    state(page, "idle")
    to_zero(page, lambda: press(page, "Go there"))
    shot(page, "8-rest")
    press(page, "Start the rest")
    state(page, "running")
    expect(page.get_by_role("button", name="Start the rest")).to_be_disabled()
    page.keyboard.press("Escape")
    state(page, "idle")
    page.close()


def test_jogs_by_keys_while_they_are_held(browser: Browser, plant: Plant) -> None:
    """Keys move nothing before they are armed; a second key ends the jog of the first."""
    page = opened(browser, plant)
    ready(page)
    page.keyboard.down("ArrowRight")
    looks(page, 10)
    page.keyboard.up("ArrowRight")
    assert stands(page) == 0.0
    page.get_by_label("Jog by keys").check()
    jog_until(page, "ArrowRight", lambda: shown_mm(plant) > 2.0)
    there = shown_mm(plant)
    page.keyboard.press("+")
    expect(page.locator("#share-shown")).to_have_text("75 %")

    begin_jog(page, "PageUp")
    page.keyboard.down("q")  # any key
    state(page, "idle")
    stands(page)
    turned = page.locator("#at-A").inner_text()
    page.keyboard.up("q")
    page.wait_for_timeout(700)
    assert page.locator("#at-A").inner_text() == turned  # although PgUp is still held
    page.keyboard.up("PageUp")

    page.locator("#step").select_option("1")
    page.get_by_role("heading", name="Machine").click()
    page.keyboard.press("ArrowLeft")
    until, stepped = time.monotonic() + 60.0, pytest.approx(there - 1.0, abs=0.5 / 55.358)
    while shown_mm(plant) != stepped:  # within half a count
        assert time.monotonic() < until, shown_mm(plant)
    stands(page)
    assert shown_mm(plant) == stepped
    press(page, "Release control")
    expect(page.get_by_label("Jog by keys")).not_to_be_checked()
    shot(page, "7-keys")
    page.close()


class Armed:
    """A browser in whose pages jogs by keys are always on."""

    def __init__(self, browser: Browser) -> None:
        self._browser = browser

    def new_page(self, **options: Any) -> Page:
        page = self._browser.new_page(**options)
        page.add_init_script(
            """setInterval(() => {
              const box = document.getElementById("by-keys");
              if (box && !box.disabled) box.checked = true;
            }, 20)"""
        )
        return page


def test_keys_that_were_not_armed_would_move_it(browser: Browser, plant: Plant) -> None:
    """Without the guard the test above fails at its first key."""
    with pytest.raises(AssertionError, match=r"assert \d+\.\d+ == 0\.0"):
        test_jogs_by_keys_while_they_are_held(cast(Browser, Armed(browser)), plant)


def test_any_key_stops_a_run_and_h_holds_it(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC")
    press(page, "Start")
    state(page, "running")
    page.keyboard.press("Tab")
    page.keyboard.press("h")
    state(page, "holding")
    page.keyboard.press("r")
    state(page, "running")
    page.keyboard.press("ArrowRight")
    state(page, "idle")
    expect(page.locator("#progress-text")).to_contain_text("stopped")
    page.close()


def test_another_browser_watches_and_may_stop(browser: Browser, plant: Plant) -> None:
    first, second = opened(browser, plant), opened(browser, plant)
    ready(first)
    expect(second.get_by_role("button", name="Home all")).to_be_disabled()
    calculate(first)
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
    expect(page.locator("body")).to_have_class("stale", timeout=60_000)
    expect(page.locator("#age")).to_contain_text("no data for")
    expect(page.get_by_role("button", name="Home all")).to_be_disabled()
    expect(page.get_by_role("button", name="STOP")).to_be_enabled()
    shot(page, "6-stale")
    os.kill(plant.server, signal.SIGCONT)
    expect(page.locator("body")).not_to_have_class("stale", timeout=60_000)
    page.close()


def test_a_server_that_is_gone_is_told_at_once_and_until_it_is_back(
    browser: Browser, plant: Plant
) -> None:
    """The old state is not shown again while there is no connection."""
    page = opened(browser, plant)
    ready(page)
    page.evaluate(
        """() => {
          window.gone = new Promise((done) => {
            const state = document.getElementById("state");
            new MutationObserver(() => {
              if (!state.textContent.startsWith("no connection")) return;
              setTimeout(() => done(state.textContent), 500);
            }).observe(state, { childList: true, subtree: true });
          });
        }"""
    )
    os.kill(plant.server, signal.SIGKILL)
    gone = page.evaluate("() => window.gone")
    assert gone.startswith("no connection: trying again; a run goes on, unless the panel has ended")
    page.close()


@pytest.mark.long(shown_by="test_home_jog_calculate_run_hold_resume_stop")
def test_the_feed_of_a_run_is_overridden_by_buttons_and_keys(
    browser: Browser, plant: Plant
) -> None:
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC")
    slower = page.get_by_role("button", name="Feed 10 % slower")
    faster = page.get_by_role("button", name="Feed 10 % faster")
    expect(slower).to_be_hidden()  # an override belongs to a run
    press(page, "Start")
    state(page, "running")
    expect(page.locator("#feed-percent")).to_have_text("")
    expect(faster).to_be_disabled()  # more than 100 % was not proven
    slower.click()
    expect(page.locator("#feed-percent")).to_have_text("at 90 %")
    slower.focus()
    page.keyboard.press("Enter")
    expect(page.locator("#feed-percent")).to_have_text("at 80 %")
    page.keyboard.press("-")
    expect(page.locator("#feed-percent")).to_have_text("at 70 %")
    for one in (slower, faster):
        box = one.bounding_box()
        assert box is not None
        assert min(box["width"], box["height"]) >= 48.0
    shot(page, "9-override")
    press(page, "Hold")
    state(page, "holding")
    page.keyboard.press("+")
    expect(page.locator("#feed-percent")).to_have_text("at 80 %")
    press(page, "Resume")
    state(page, "running")
    expect(page.locator("#feed-percent")).to_have_text("at 80 %")
    page.keyboard.press("Escape")
    state(page, "idle")
    expect(page.locator("#feed-percent")).to_have_text("")
    expect(slower).to_be_hidden()
    page.close()

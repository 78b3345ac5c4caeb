"""The page by the keyboard: moving, stopping and drawing without a pointer."""

from __future__ import annotations

import re
from contextlib import suppress

import pytest

from tests.panel.browsing import (
    Browser,
    Page,
    begin_jog,
    calculate,
    expect,
    jog_until,
    moved_on,
    opened,
    part,
    press,
    press_until,
    ready,
    stands,
    state,
    to_zero,
    x_mm,
)
from tests.panel.test_panel_killed import Plant

MOST_TABS = 60
NAME = """() => { const at = document.activeElement;
  return at.getAttribute("aria-label") || at.closest("label")?.innerText || at.innerText; }"""


def tab_to(page: Page, name: str) -> None:
    """Go to an element by Tab, from any focus."""
    seen = []
    for _ in range(MOST_TABS):
        page.keyboard.press("Tab")
        seen.append(str(page.evaluate(NAME)).strip())
        if seen[-1] == name:
            return
    raise AssertionError(f"{name!r} is not among {seen}")


def enter(page: Page, name: str) -> None:
    expect(page.get_by_role("button", name=name, exact=True)).to_be_enabled(timeout=60_000)
    tab_to(page, name)
    page.keyboard.press("Enter")


def test_keys_stop_in_every_view(browser: Browser, plant: Plant) -> None:
    """This holds with control and without."""
    page = opened(browser, plant)
    entries = page.locator("#log li", has_text="stopped by")
    for count, name in enumerate(("Prepare", "Run", "Teach", "Draw", "Review", "Guide")):
        part(page, name)
        expect(page.get_by_role("button", name="STOP")).to_be_visible()
        before = entries.count()
        page.keyboard.press("Escape" if count % 2 else " ")
        expect(entries.nth(before)).to_have_count(1, timeout=60_000)
    page.close()


def test_home_jog_run_hold_stop_and_draw_without_a_pointer(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    for name in ("Take control", "Enable", "Home all"):
        enter(page, name)
    state(page, "idle")

    tab_to(page, "Jog X plus while held")
    jog_until(page, "Enter", lambda: x_mm(page) > 1.0)
    begin_jog(page, "Enter")
    page.keyboard.press("Tab")  # leaving the button ends the jog, although Enter is still held
    state(page, "idle")
    there = stands(page)
    assert there < 400.0  # the jog did not go on to the end of the travel
    page.wait_for_timeout(400)
    assert x_mm(page) == pytest.approx(there, abs=0.1)  # nothing is commanded
    page.keyboard.up("Enter")
    tab_to(page, "Jog by keys")
    page.keyboard.press("Enter")
    expect(page.get_by_label("Jog by keys")).to_be_checked()
    jog_until(page, "ArrowLeft", lambda: x_mm(page) < there)
    to_zero(page, lambda: enter(page, "Zero all"))

    tab_to(page, "Prepare")
    page.keyboard.press("Enter")
    enter(page, "Calculate")
    expect(page.locator("#figures")).to_contain_text("IN SPEC", timeout=60_000)
    enter(page, "Start")
    state(page, "running")
    page.keyboard.press("h")
    state(page, "holding")
    page.keyboard.press("r")
    state(page, "running")
    page.keyboard.press(" ")
    state(page, "idle")
    expect(page.locator("#progress-text")).to_contain_text("stopped")

    tab_to(page, "Draw")
    page.keyboard.press("Enter")
    for x, tool in ((10, "Line"), (60, "Circle")):
        enter(page, tool)
        tab_to(page, "Point x, y")
        for point in (f"{x}, 10", f"{x + 20}, 10"):
            page.keyboard.type(point)
            page.keyboard.press("Enter")
        page.keyboard.press("Enter")
    expect(page.locator("#drawn")).to_contain_text("2 shapes")
    tab_to(page, "Drawing; points can be typed below")
    page.keyboard.press("PageUp")
    page.keyboard.press("Delete")
    expect(page.locator("#drawn")).to_have_text(re.compile(r"^1 shape\b(?!s)"))
    assert "A 20.0000" in str(page.locator("#paper path[data-at='0']").get_attribute("d"))
    page.close()


def runs(page: Page) -> None:
    """Start the program at its begin, and wait until it moves."""
    part(page, "Run")
    if x_mm(page) != 0.0:
        for _ in range(6):  # X may be at zero if a busy computer ends the move too early for A
            to_zero(page, lambda: press(page, "Zero all"))
            with suppress(AssertionError):
                expect(page.locator("#at-A")).to_have_text(re.compile(r"^0\.00"), timeout=10_000)
                break
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_enabled(timeout=60_000)
    press_until(page, "Start", "running")
    moved_on(page, 0.0)


def stopped(page: Page, key: str) -> None:
    page.keyboard.press(key)
    state(page, "idle")
    expect(page.locator("#progress-text")).to_contain_text("stopped")


@pytest.mark.long(shown_by="tests/panel/test_page.py::test_any_key_stops_a_run_and_h_holds_it")
def test_keys_stop_a_run_wherever_the_focus_is(browser: Browser, plant: Plant) -> None:
    """In lists, sliders and fields, and on other parts of the page: no control gets the key."""
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC", timeout=60_000)
    for name, focus, key in (
        ("Run", "#axis", " "),
        ("Run", "#step", "x"),
        ("Run", "#share", "ArrowRight"),
        ("Prepare", "#feed", "x"),
        ("Prepare", "#offset", " "),
        ("Draw", "#drawing-name", "Enter"),
        ("Draw", "#paper svg", "Delete"),
        ("Review", "#beside", "ArrowDown"),
    ):
        runs(page)
        part(page, name)
        if focus == "#offset":
            page.get_by_text("Expert options").click()
        there = page.locator(focus)
        there.focus()
        written = "svg" not in focus and focus != "#beside"  # the list of runs is still being read
        before = there.input_value() if written else ""
        stopped(page, key)
        assert not written or there.input_value() == before, focus
    page.close()


@pytest.mark.long(shown_by="tests/panel/test_page.py::test_any_key_stops_a_run_and_h_holds_it")
def test_keys_of_a_run_hold_and_resume_it_in_a_field(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC", timeout=60_000)
    runs(page)
    part(page, "Prepare")
    page.locator("#feed").focus()
    page.keyboard.press("h")
    state(page, "holding")
    page.keyboard.press("r")
    state(page, "running")
    assert page.locator("#feed").input_value() == ""
    # An open list would take the keys, so it closes, and a press takes the next entry.
    page.evaluate("document.activeElement.blur()")
    part(page, "Run")
    before = page.locator("#axis").input_value()
    page.locator("#axis").click()
    assert page.locator("#axis").input_value() != before
    expect(page.locator("#file")).to_be_disabled()
    stopped(page, " ")
    expect(page.locator("#file")).to_be_enabled()
    # At rest the space bar writes a blank, and the field gets the keys.
    page.locator("#teach-name").evaluate("at => at.value = ''")
    part(page, "Teach")
    page.locator("#teach-name").focus()
    page.keyboard.type("a b")
    assert page.locator("#teach-name").input_value() == "a b"
    page.close()

"""Each kind of machine by the keyboard alone: from its file to the verdict of its run."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.live.grbl_model import GrblModel
from tests.live.test_grbl import settings
from tests.panel.bench import CASES, GCODE
from tests.panel.browsing import (
    SIZE,
    Browser,
    Page,
    expect,
    opened,
    shot,
    state,
)
from tests.panel.test_page_keyboard import NAME, enter, tab_to
from tests.panel.test_page_looks import nothing_is_wider
from tests.panel.test_page_operator import panel
from tests.panel.test_panel_killed import Plant

if TYPE_CHECKING:
    from playwright.sync_api import FileChooser

SLOW = 0.15
"""A run of seconds, so that there is time to go to a button by Tab on a busy computer."""
LONG_MS = 300_000.0
SHOWN = "tests/panel/test_page_keyboard.py::test_home_jog_run_hold_stop_and_draw_without_a_pointer"
KINDS = [
    pytest.param((name, SLOW), name, id=name, marks=pytest.mark.long(shown_by=SHOWN))
    for name in ("lathe-winder", "stitcher", "letter-placer", "schiffli-frame")
]


def walked(page: Page, program: str, verdict: str, name: str) -> None:
    """Home, prove, start, hold, resume, stop and read the verdict without a pointer."""
    for button, then in (("Take control", ""), ("Enable", "enabled"), ("Home all", "idle")):
        enter(page, button)
        if then:
            state(page, then)
    shot(page, f"40-{name}-homed")
    looked_at(page)

    enter_tab(page, "Prepare")
    tab_to(page, "Program")
    page.keyboard.type(program[:12])
    expect(page.locator("#program")).to_have_value(program)
    shot(page, f"41-{name}-previewed")
    looked_at(page)
    enter(page, "Calculate")
    expect(page.locator("#figures")).to_contain_text(verdict, timeout=LONG_MS)
    shot(page, f"42-{name}-proven")
    looked_at(page)

    if verdict != "IN SPEC":
        tab_to(page, "Reason to run out of specification")
        page.keyboard.type("a trial without work")
    enter_tab(page, "Run")
    enter(page, "Start")
    state(page, "running")
    enter(page, "Hold")
    state(page, "holding")
    shot(page, f"43-{name}-held")
    looked_at(page)
    for _ in range(20):  # a page that saw an old state is refused, and asks again
        page.keyboard.press("r")
        with suppress(AssertionError):
            expect(page.locator("#state")).to_have_text("running", timeout=3_000)
            break
    state(page, "running")
    page.keyboard.press(" ")
    state(page, "(idle|enabled|disabled)")
    expect(page.locator("#progress-text")).to_contain_text("stopped")
    expect(page.locator("#last-run-told")).to_contain_text("stopped", timeout=LONG_MS)
    shot(page, f"45-{name}-stopped")
    looked_at(page)

    enter_tab(page, "Review")
    expect(page.locator("#kept")).to_contain_text("stopped", timeout=LONG_MS)
    chosen = page.locator("#kept tbody button").first
    run = chosen.inner_text()
    tab_to(page, run)
    page.keyboard.press("Enter")
    expect(page.locator("#kept tr[aria-current]")).to_have_count(1)
    expect(page.locator("#kept img, #kept svg").first).to_be_visible(timeout=LONG_MS)
    # The table is rewritten when pictures come: the focus must stay.
    assert str(page.evaluate(NAME)).strip() == run
    shot(page, f"46-{name}-reviewed")
    looked_at(page)


def looked_at(page: Page) -> None:
    """Check each size, light and dark, with axe-core; the page is shown on a desk afterwards."""
    nothing_is_wider(page)
    page.set_viewport_size(SIZE)  # type: ignore[arg-type]
    if page.get_by_role("button", name="Take control", exact=True).is_visible():
        enter(page, "Take control")  # axe-core has kept the page from renewing


def brought(page: Page, file: Path) -> None:
    """Choose a file by the keyboard; again if a busy computer has lost control meanwhile."""
    opened_lists: list[FileChooser] = []
    # Playwright marks its handlers, and cannot mark built-in ones.
    page.on("filechooser", lambda one: opened_lists.append(one))  # noqa: PLW0108
    page.wait_for_timeout(1000)  # the browser hands its list over
    for _ in range(10):
        if page.get_by_role("button", name="Take control", exact=True).is_visible():
            enter(page, "Take control")
        tab_to(page, "Load a program into the project folder")
        page.keyboard.press("Enter")
        for _ in range(50):
            if opened_lists:
                opened_lists[0].set_files(file)
                return
            page.wait_for_timeout(200)
    raise AssertionError("ten times Enter opened no list of files")


def enter_tab(page: Page, name: str) -> None:
    tab_to(page, name)
    page.keyboard.press("Enter")
    expect(page.get_by_role("tab", name=name)).to_have_attribute("aria-selected", "true")


@pytest.mark.parametrize("plant, name", KINDS, indirect=["plant"])
def test_each_kind_without_a_pointer(browser: Browser, plant: Plant, name: str) -> None:
    page = opened(browser, plant, name)
    walked(page, CASES[name].program, "IN SPEC", name)
    assert "stopped" in page.locator("#kept tr[aria-current]").inner_text()
    page.close()


@pytest.mark.long(shown_by=SHOWN)
def test_grbl_without_a_pointer(browser: Browser, tmp_path: Path) -> None:
    """A file is also chosen by the keyboard, and a reason to run out of specification is typed."""
    model = GrblModel(settings(), faster=SLOW)
    model.start()
    (tmp_path / "there.gcode").write_text(GCODE, "utf-8")
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    shutil.move(tmp_path / "there.gcode", elsewhere / "brought.gcode")
    try:
        link = f"grbl:{model.address}"
        with panel(tmp_path, "-m", "stepper-winder", "--link", link) as address:
            page = browser.new_page(viewport=SIZE)  # type: ignore[arg-type]
            page.set_default_timeout(60_000)
            page.goto(address)
            expect(page.locator("#machine")).to_have_text(f"stepper-winder, {link}")
            enter(page, "Take control")
            enter_tab(page, "Prepare")
            brought(page, elsewhere / "brought.gcode")
            expect(page.locator("#program")).to_have_value("brought.gcode")
            enter_tab(page, "Run")
            enter(page, "Release control")
            walked(page, "brought.gcode", "OUT OF SPEC", "grbl")
            page.close()
    finally:
        model.close()

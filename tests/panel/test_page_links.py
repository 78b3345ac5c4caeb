"""The page at its links: missing commands are grey, alarms are shown, a token is requested."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.live.grbl_model import GrblModel
from tests.live.test_grbl import settings
from tests.panel.browsing import (
    SIZE,
    Browser,
    Page,
    expect,
    held_and_let_go,
    moved_on,
    opened,
    part,
    press,
    press_until,
    ready,
    shot,
    stands,
    state,
)
from tests.panel.test_page_looks import nothing_is_wider
from tests.panel.test_page_operator import panel
from tests.panel.test_panel_killed import Plant

TOKEN = "correct-horse-battery"


@pytest.mark.long(shown_by="test_page_says_that_an_axis_is_not_homed_and_a_file_exists")
def test_grbl_is_homed_jogged_and_in_alarm(browser: Browser, tmp_path: Path) -> None:
    model = GrblModel(settings())
    model.start()
    link = f"grbl:{model.address}"
    try:
        with panel(tmp_path, "-m", "stepper-winder", "--link", link) as address:
            page = browser.new_page(viewport=SIZE)
            page.set_default_timeout(60_000)
            page.goto(address)
            expect(page.locator("#machine")).to_have_text(f"stepper-winder, {link}", timeout=60_000)
            expect(page.locator("#link-notes")).to_contain_text(
                "Disable is not available on this link: grbl switches its drives by itself"
            )
            ready(page)
            disable = page.get_by_role("button", name="Disable")
            expect(disable).to_be_disabled()
            assert "not available on this link" in str(disable.get_attribute("title"))
            held_and_let_go(page, "Jog X plus", 1.0)
            console_is_used(page, model)
            nothing_is_wider(page)
            shot(page, "26-grbl-console")
            model.state = "Alarm"
            state(page, "fault")
            expect(page.locator("#state")).to_contain_text("Alarm")
            shot(page, "27-grbl")
            page.close()
    finally:
        model.close()


@pytest.mark.long(shown_by="test_page_says_that_an_axis_is_not_homed_and_a_file_exists")
def test_a_grbl_program_is_held_in_the_middle_and_a_lost_link_comes_back(
    browser: Browser, tmp_path: Path
) -> None:
    """The hold stands where it is asked for; a board that was unplugged needs no new panel."""
    model = GrblModel(settings())
    model.start()
    link = f"grbl:{model.address}"
    lines = "".join(f"G1 A{10 * k} X{5 * k} F6000\n" for k in range(1, 41))
    (tmp_path / "long.gcode").write_text(f"G21 G90\n{lines}M30\n", "utf-8")
    try:
        with panel(tmp_path, "-m", "stepper-winder", "--link", link) as address:
            page = browser.new_page(viewport=SIZE)
            page.set_default_timeout(60_000)
            page.goto(address)
            ready(page)
            part(page, "Prepare")
            press(page, "Calculate")
            expect(page.locator("#figures")).to_contain_text("long.gcode", timeout=300_000)
            if page.locator("#override").is_visible():
                page.locator("#override").fill("a trial")
            part(page, "Run")
            press(page, "Start")
            moved_on(page, 0.0)
            press_until(page, "Hold", "holding")
            stood = stands(page)
            assert 1.0 < stood < 195.0
            expect(page.locator("#state")).not_to_contain_text("rest of the program")
            expect(page.locator("#log")).not_to_contain_text("a hold stands at")
            press_until(page, "Resume", "running")
            moved_on(page, stood)
            model.close()
            state(page, "fault")
            expect(page.locator("#state")).to_contain_text("the link is gone")
            model = GrblModel(settings(), port=model.port)
            model.start()
            expect(page.locator("#age")).to_contain_text("no data")
            press(page, "Reconnect")
            state(page, "disabled")
            press_until(page, "Enable", "enabled")
            press_until(page, "Home all", "idle")
            page.close()
    finally:
        model.close()


def console_is_used(page: Page, model: GrblModel) -> None:
    """Send a command, be refused, write a wrong setting, and restore the right one by a button."""
    expect(page.locator("#board-fill")).to_contain_text("planner: 0 of 15 blocks")
    board_text = page.locator("#board-told")
    expect(board_text).to_contain_text("Compared with the machine file: 6 the same.")
    line = page.get_by_label("Line for the controller")
    line.fill("$i")
    line.press("Enter")
    log = page.locator("#console")
    expect(log).to_contain_text("[AXS:4:XYZA]")
    expect(log.locator(".typed")).to_have_text(re.compile(r"you\$I$"))
    line.fill("G0 X10")
    press(page, "Send")
    expect(page.locator("#toasts")).to_contain_text("the console does not send 'G0X10': it moves")
    line.press("ArrowUp")
    expect(line).to_have_value("G0 X10")
    assert b"X10\n" not in model.heard
    right = settings()[110]
    line.fill(f"$110={2 * right:g}")
    line.press("Enter")
    state(page, "fault")
    expect(page.locator("#state")).to_contain_text("the setting $110 was written")
    expect(board_text).to_contain_text("1 must be corrected, 5 the same")
    first = page.locator("#board-settings tr").nth(1)
    expect(first).to_contain_text("highest speed of X")
    press(page, "Put $110=24000 into the line of the console")
    expect(line).to_have_value("$110=24000")
    line.press("Enter")
    expect(board_text).to_contain_text("6 the same")
    press_until(page, "Reset", "disabled")
    press_until(page, "Enable", "enabled")
    press_until(page, "Home all", "homing|idle")
    state(page, "idle")


@pytest.mark.parametrize("plant", [("lathe-winder", 0.5, TOKEN)], indirect=True)
def test_the_page_asks_for_the_token(browser: Browser, plant: Plant) -> None:
    """The page says why it is refused, and keeps the token as long as the tab is open."""
    page = browser.new_page(viewport=SIZE)
    page.set_default_timeout(60_000)
    page.goto(f"http://127.0.0.1:{plant.port}/")
    shown = page.locator("#state")
    expect(shown).to_have_text("refused by the panel: the token is not the right one")
    page.get_by_label("Token").fill("none of its words")
    press(page, "Enter the panel")
    expect(shown).to_have_text("refused by the panel: the token is not the right one")
    page.get_by_label("Token").fill(TOKEN)
    page.keyboard.press("Enter")
    expect(page.locator("#machine")).to_have_text("lathe-winder, simulated")
    expect(page.get_by_label("Token")).to_be_hidden()
    expect(page.locator("#program option")).to_have_count(1)  # HTTP requests carry it, too
    page.reload()
    expect(page.locator("#machine")).to_have_text("lathe-winder, simulated")
    page.close()


def test_page_says_that_an_axis_is_not_homed_and_a_file_exists(
    browser: Browser, plant: Plant
) -> None:
    """Axes without a home have no position; an upload with an existing name asks first."""
    page = opened(browser, plant)
    for name in "AXY":
        expect(page.locator(f"#at-{name}")).to_have_text("not homed")
    home = page.get_by_role("button", name="Home all")
    expect(home).to_have_attribute("title", "take control first")
    press(page, "Take control")
    expect(home).to_have_attribute("title", "not possible now: the machine is disabled")
    press(page, "Release control")
    ready(page)
    expect(page.locator("#at-X")).to_have_text("0.00 mm")
    other = plant.box.with_name("elsewhere") / "there.prg"
    other.parent.mkdir()
    other.write_text("%\nM30;\n%\n", "utf-8")
    kept = plant.box.with_name("there.prg")
    before = kept.read_text("utf-8")
    for answer, content in (("Keep it", before), ("Overwrite it", other.read_text("utf-8"))):
        page.locator("#file").set_input_files(other)
        expect(page.locator("#ask-text")).to_have_text("there.prg is in the project folder already")
        press(page, answer)
        expect(page.locator("#ask-row")).to_be_hidden()
        message = "is kept" if answer == "Keep it" else "there.prg is in the project folder"
        expect(page.locator("#log li").first).to_contain_text(message)
        assert kept.read_text("utf-8") == content
    page.close()

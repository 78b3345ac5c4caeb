"""Mistakes at the page, and attacks on it: one clear message each, and a safe machine."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.panel.browsing import (
    PHONE,
    SIZE,
    Browser,
    Page,
    calculate,
    expect,
    opened,
    part,
    press,
    press_until,
    ready,
    state,
)
from tests.panel.test_panel_killed import Plant

EXAMPLES = Path(__file__).parents[2] / "examples"
HEAD_OF_A_PHONE = 0.34
"""Share of a phone that the bar takes for the seconds in which somebody asks for control."""


def messages(page: Page) -> list[str]:
    found: list[str] = page.locator("#toasts span").all_inner_texts()
    return found


def test_two_browsers_want_control(browser: Browser, plant: Plant) -> None:
    """The asking client is told the result, and the other client is told who gets control."""
    one, other = opened(browser, plant), opened(browser, plant)
    press(one, "Take control")
    press(other, "Ask for control")
    one.set_viewport_size(PHONE)  # type: ignore[arg-type]
    expect(one.get_by_role("button", name="Keep control", exact=True)).to_be_visible()
    header = one.locator("header").bounding_box()
    assert header is not None and header["height"] < HEAD_OF_A_PHONE * PHONE["height"]
    press(one, "Keep control")
    expect(other.locator("#toasts")).to_contain_text("keeps control")

    press(other, "Ask for control")
    press(one, "Give control")
    expect(other.locator("#toasts")).to_contain_text("you have control now")
    assert "control has passed" not in " ".join(messages(one))  # its operator has agreed
    one.set_viewport_size(SIZE)  # type: ignore[arg-type]
    expect(one.get_by_role("button", name="Ask for control", exact=True)).to_be_visible()
    one.close()
    other.close()


def test_files_that_are_no_programs(browser: Browser, plant: Plant, tmp_path: Path) -> None:
    """Each is refused, or named as no program of this machine; the chosen program stays."""
    files = tmp_path / "elsewhere"
    files.mkdir()
    (files / "long.prg").write_bytes(b"N 10 A 20 X 60;\n" * (9 * 1024 * 1024 // 16))
    (files / "binary.prg").write_bytes(bytes(range(256)) * 1000)
    (files / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(1000))
    shutil.copy(EXAMPLES / "rosette.dst", files)
    page = opened(browser, plant)
    press(page, "Take control")
    part(page, "Prepare")
    expect(page.locator("#program")).to_have_value("there.prg")
    expect(page.locator("#extent")).to_contain_text("X 0.0 to 60.0 mm")
    for name, text in (
        ("long.prg", "long.prg has more than 8 MiB"),
        ("binary.prg", "binary.prg:1: controllers execute the byte 0x00 at once"),
        ("picture.png", "has a suffix of no format"),
        ("rosette.dst", "rosette.dst is in the project folder. It is no program of this machine"),
    ):
        page.locator("#file").set_input_files(files / name)
        expect(page.locator("#log")).to_contain_text(text)
        expect(page.locator("#program")).to_have_value("there.prg")
    assert not (tmp_path / "long.prg").exists() and not (tmp_path / "binary.prg").exists()
    page.close()


def test_a_start_before_homing_and_a_page_that_is_loaded_again(
    browser: Browser, plant: Plant
) -> None:
    """The start is grey and says why; the reloaded page takes control again, holds and resumes."""
    page = opened(browser, plant)
    press(page, "Take control")
    press_until(page, "Enable", "enabled")
    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC")
    start = page.get_by_role("button", name="Start", exact=True)
    expect(start).to_be_disabled()
    expect(start).to_have_attribute("title", "home first: the positions of the axes are unknown")
    expect(page.locator("#next")).to_have_text("Next: home the machine")
    page.close()

    page = opened(browser, plant)
    ready(page)
    press_until(page, "Start", "running")
    page.reload()
    expect(page.locator("#state")).to_have_text("running")
    press(page, "Take control")
    press_until(page, "Hold", "holding")
    press_until(page, "Resume", "running")
    press(page, "STOP")
    state(page, "idle")
    page.close()


@pytest.mark.parametrize("plant", [("lathe-winder", 0.25)], indirect=True)
def test_the_connection_is_cut_in_a_run(browser: Browser, plant: Plant) -> None:
    """The page says so and greys old values; the run goes on, and another browser stops it."""
    context = browser.new_context(viewport=SIZE)  # type: ignore[arg-type]
    page = context.new_page()
    page.add_init_script(
        """window.made = []; const Real = WebSocket;
        window.WebSocket = class extends Real {
          constructor(...words) { super(...words); window.made.push(this); }
        };"""
    )
    page.goto(f"http://127.0.0.1:{plant.port}/")
    other = opened(browser, plant)
    ready(page)
    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC")
    press_until(page, "Start", "running")
    context.set_offline(True)
    page.evaluate("() => window.made.forEach((one) => one.close())")
    expect(page.locator("#state")).to_contain_text("no connection")
    expect(page.locator("#state")).to_contain_text("a run goes on")
    expect(page.get_by_role("button", name="Hold", exact=True)).to_be_disabled()
    state(other, "running")
    context.set_offline(False)
    expect(page.locator("#toasts")).to_contain_text("control was lost: take it again")
    press(other, "STOP")
    state(other, "idle")
    state(page, "idle")
    context.close()
    other.close()

"""The page in a browser: only the chosen program starts, and messages are shown on every part."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from tests.panel.browsing import (
    Browser,
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


def test_program_that_is_no_longer_chosen_does_not_start(
    browser: Browser, plant: Plant, tmp_path: Path
) -> None:
    there = tmp_path / "there.prg"
    (tmp_path / "other.prg").write_bytes(there.read_bytes())
    page = opened(browser, plant)
    ready(page)
    chosen, changed = page.locator("#program"), page.locator("#changed")
    motions = [page.get_by_role("button", name=name, exact=True) for name in ("Start", "Approach")]
    part(page, "Prepare")
    chosen.select_option("there.prg")
    press(page, "Calculate")
    for one in motions:
        expect(one).to_be_enabled()
    expect(changed).to_be_hidden()

    chosen.select_option("other.prg")
    for one in motions:
        expect(one).to_be_disabled()
    expect(changed).to_contain_text("calculate again")
    chosen.select_option("there.prg")
    page.get_by_label("Feed", exact=True).fill("80 count/tick")
    for one in motions:
        expect(one).to_be_disabled()
    page.get_by_label("Feed", exact=True).fill("")
    page.get_by_text("Expert options").click()
    page.get_by_label("Loads follow").check()
    for one in motions:
        expect(one).to_be_disabled()
    page.get_by_label("Loads follow").uncheck()
    for one in motions:
        expect(one).to_be_enabled()

    page.reload()  # the page forgets the choice, and chooses the calculated program
    expect(page.locator("#figures")).to_contain_text("there.prg")
    expect(chosen).to_have_value("there.prg")
    press(page, "Take control")
    for one in motions:
        expect(one).to_be_enabled()
    page.close()


def test_a_panel_that_begins_anew_has_calculated_nothing(
    browser: Browser, plant: Plant, tmp_path: Path
) -> None:
    """The page reconnects by itself, and drops what the previous panel had proven."""
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    verdict = page.locator("#figures")
    expect(verdict).to_contain_text("IN SPEC")
    os.kill(plant.server, signal.SIGKILL)
    expect(page.locator("body")).to_have_class("stale")

    again = Plant(tmp_path, tmp_path / "second-box", port=plant.port)
    expect(page.locator("body")).not_to_have_class("stale")
    expect(verdict).not_to_contain_text("IN SPEC")
    expect(page.get_by_role("button", name="Start", exact=True)).to_be_disabled()
    page.close()
    os.kill(again.server, signal.SIGKILL)
    os.waitpid(again.server, 0)
    again.end()


def test_messages_show_in_every_view_and_the_end_of_a_run_stays(
    browser: Browser, plant: Plant
) -> None:
    page = opened(browser, plant)
    toast = page.locator("#toasts [role=alert]")
    part(page, "Draw")
    press(page, "Use as mandrel")
    expect(toast).to_contain_text("a profile is one chosen line")
    part(page, "Review")
    expect(toast).to_be_visible()
    press(page, "Close this message")
    expect(toast).to_have_count(0)
    part(page, "Run")
    expect(page.locator("#log")).to_contain_text("a profile is one chosen line")
    expect(page.locator("#log-count")).to_have_text("1 message, 1 about trouble")

    ready(page)
    calculate(page)
    press_until(page, "Start", "running")
    press(page, "STOP")
    state(page, "idle")
    expect(page.locator("#log")).to_contain_text("there.prg: stopped by the operator. NOT PROVEN")
    page.close()


def test_a_place_that_is_not_known_is_not_the_programs_zero(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    part(page, "Prepare")
    page.get_by_text("Expert options").click()
    here = page.get_by_role("button", name="Program's zero is here")
    expect(here).to_be_disabled()  # nobody has control
    part(page, "Run")
    press(page, "Take control")
    press_until(page, "Enable", "enabled")
    part(page, "Prepare")
    expect(here).to_be_disabled()  # where the axes are is not known
    part(page, "Run")
    press_until(page, "Home all", "homing|idle")
    state(page, "idle")
    part(page, "Prepare")
    expect(here).to_be_enabled()
    page.close()

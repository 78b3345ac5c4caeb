"""Buttons of the operator's own: kept by the browser, and never more than the panel allows."""

from __future__ import annotations

from contextlib import suppress

import pytest

from tests.panel.browsing import Browser, expect, opened, part, press, press_until, ready, state
from tests.panel.test_panel_killed import Plant


@pytest.mark.parametrize("plant", [("lathe-winder", 0.1)], indirect=True)
def test_an_own_button_homes_and_calculates_and_overrides_in_a_run(
    browser: Browser, plant: Plant
) -> None:
    """The steps run one after the other; no step can move the machine by hand."""
    page = opened(browser, plant)
    ready(page)
    page.locator("#own-edit summary").click()
    page.locator("#own-name").fill("Morning")
    steps = page.locator("#own-steps")
    steps.fill("home\nstart")
    press(page, "Save button")
    expect(page.locator("#own-wrong")).to_contain_text('Not saved: step 2, "start": start is not')
    steps.fill("home\nprogram there.prg")
    press(page, "Save button")
    expect(page.locator("#own-wrong")).to_have_text("")
    page.locator("#own-name").fill("Slow")
    steps.fill("feed 50 %")
    press(page, "Save button")
    slow = page.get_by_role("button", name="Slow", exact=True)
    expect(slow).to_be_disabled()  # there is no run whose feed it could override

    page.reload()  # the browser has kept the buttons
    morning = page.get_by_role("button", name="Morning", exact=True)
    expect(morning).to_be_disabled()  # without control
    press(page, "Take control")
    morning.click()
    expect(page.locator("#now-program")).to_have_text("there.prg", timeout=120_000)
    expect(page.locator("#next")).to_have_text("Next: start")  # and the button has started nothing
    press_until(page, "Start", "running")
    expect(morning).to_be_disabled()
    halved = page.locator("#feed-percent")
    for _ in range(20):  # a busy computer refuses a command with an old state
        slow.click()
        with suppress(AssertionError):
            expect(halved).to_have_text("at 50 %", timeout=5_000)
            break
    expect(halved).to_have_text("at 50 %")
    press(page, "STOP")
    state(page, "idle")
    part(page, "Run")
    page.locator("#own-edit summary").click()
    press(page, "Remove Slow")
    expect(slow).to_have_count(0)
    page.close()


@pytest.mark.parametrize("plant", [("letter-placer", 2.0)], indirect=True)
def test_a_button_has_only_steps_of_its_machine(browser: Browser, plant: Plant) -> None:
    """Cylinders have neither feed nor console; a missing program ends the steps."""
    page = opened(browser, plant, "letter-placer")
    ready(page)
    page.locator("#own-edit summary").click()
    page.locator("#own-name").fill("Wrong")
    for text, message in (("feed 50 %", "no feed"), ("line $G", "takes no typed lines")):
        page.locator("#own-steps").fill(text)
        press(page, "Save button")
        expect(page.locator("#own-wrong")).to_contain_text(message)
    page.locator("#own-steps").fill("program nobody.toml\nhome")
    press(page, "Save button")
    page.get_by_role("button", name="Wrong", exact=True).click()
    expect(page.locator("#log")).to_contain_text(
        'Own button ended at "program nobody.toml": there is no such program in the folder'
    )
    state(page, "idle")
    page.close()

"""What buttons, lists and ends are called on the page in a browser, and why some are grey."""

from __future__ import annotations

from tests.panel.browsing import Browser, expect, opened, press, press_until, state
from tests.panel.test_panel_killed import Plant


def test_to_move_to_zero_is_not_to_home(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    zeros = [page.get_by_role("button", name=f"Zero {one}", exact=True) for one in ("X", "all")]
    press(page, "Take control")
    press_until(page, "Enable", "enabled")
    expect(page.get_by_role("button", name="Home", exact=False)).to_have_count(1)  # Home all
    for zero in zeros:
        expect(zero).to_be_disabled()
        expect(zero).to_have_attribute("title", "home first: it is not known where the axes are")
    press_until(page, "Home all", "homing|idle")
    state(page, "idle")
    for zero in zeros:
        expect(zero).to_be_enabled()
        expect(zero).to_have_attribute("title", "")
    page.close()

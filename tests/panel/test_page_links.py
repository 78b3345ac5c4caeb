"""The page at a controller with grbl: what the link lacks is greyed, and alarms are seen."""

from __future__ import annotations

from pathlib import Path

from tests.live.grbl_model import GrblModel
from tests.live.test_grbl import settings
from tests.panel.browsing import SIZE, Browser, expect, held_and_let_go, ready, shot, state
from tests.panel.test_page_operator import panel


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
                "disable is not had on this link: grbl switches its drives by itself"
            )
            ready(page)
            disable = page.get_by_role("button", name="Disable")
            expect(disable).to_be_disabled()
            assert "not had on this link" in str(disable.get_attribute("title"))
            held_and_let_go(page, "Jog X plus", 1.0)
            model.state = "Alarm"
            state(page, "fault")
            expect(page.locator("#state")).to_contain_text("Alarm")
            shot(page, "27-grbl")
            page.close()
    finally:
        model.close()

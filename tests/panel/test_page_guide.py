"""The guide in a browser: on the screen, and alone on paper."""

from __future__ import annotations

from tests.panel.browsing import PICTURES, SHOTS, Browser, expect, opened, part, shot
from tests.panel.test_panel_killed import Plant


def test_the_guide_is_shown_and_printed_alone(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    part(page, "Guide")
    expect(page.locator("#guide-tables")).to_contain_text(
        "Calibration, step by step", timeout=60_000
    )
    expect(page.locator("#guide-tables")).to_contain_text("Connector CN1")
    expect(page.get_by_role("button", name="STOP")).to_be_visible()
    expect(page.get_by_role("button", name="Print")).to_be_enabled()
    shot(page, "17-guide")
    with page.expect_download() as download:
        page.get_by_role("button", name="PDF").click()
    assert download.value.suggested_filename == "guide.pdf"
    page.emulate_media(media="print")
    expect(page.get_by_role("button", name="STOP")).to_be_hidden()
    expect(page.get_by_role("button", name="Print")).to_be_hidden()
    expect(page.locator("#guide-tables")).to_be_visible()
    if PICTURES:
        page.screenshot(path=SHOTS / "18-guide-on-paper.png", full_page=True)
    page.close()

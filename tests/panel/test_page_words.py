"""Names of buttons, lists and results on the page in a browser, and reasons why some are grey."""

from __future__ import annotations

import json
import re

import pytest

from tests.panel.browsing import (
    Browser,
    calculate,
    expect,
    opened,
    part,
    press,
    press_until,
    ready,
    shot,
    state,
)
from tests.panel.test_panel_killed import Plant


def test_to_move_to_zero_is_not_to_home(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    zeros = [page.get_by_role("button", name=f"Zero {one}", exact=True) for one in ("X", "all")]
    press(page, "Take control")
    press_until(page, "Enable", "enabled")
    homes = page.locator("#commands").get_by_role("button", name="Home", exact=False)
    expect(homes).to_have_count(1)  # Home all
    for zero in zeros:
        expect(zero).to_be_disabled()
        expect(zero).to_have_attribute("title", "home first: the positions of the axes are unknown")
    press_until(page, "Home all", "homing|idle")
    state(page, "idle")
    for zero in zeros:
        expect(zero).to_be_enabled()
        expect(zero).to_have_attribute("title", "")
    page.close()


def test_the_list_of_runs_has_the_words_of_the_verdict(browser: Browser, plant: Plant) -> None:
    """A stopped run is not proven, which is not out of specification."""
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    press_until(page, "Start", "running")
    press(page, "STOP")
    state(page, "idle")
    expect(page.locator("#log")).to_contain_text("there.prg: stopped by the operator. NOT PROVEN")
    expect(page.locator("#log li", has_text=re.compile("  stopped by"))).to_have_count(1)
    once = re.compile(r"^stopped by the operator\. NOT PROVEN: it did not reach its end$")
    expect(page.locator("#progress-text")).to_contain_text(once)
    expect(page.locator("#last-run-told")).to_have_class("verdict")
    expect(page.locator(".wrong", has_text="not proven")).to_have_count(0)
    part(page, "Review")
    for text in ("stopped by the operator", "not proven"):
        expect(page.locator("#kept tbody td:not(.wrong)", has_text=text)).to_have_count(1)
    page.close()


@pytest.mark.long(shown_by="test_the_list_of_runs_has_the_words_of_the_verdict")
@pytest.mark.parametrize("plant", [("schiffli-frame", 40.0)], indirect=True)
def test_unavailable_buttons_are_grey_with_the_reason(browser: Browser, plant: Plant) -> None:
    """No part program can be taught to a frame; a completed run has no rest."""
    page = opened(browser, plant, "schiffli-frame")
    ready(page)
    expect(page.locator("[data-what=zero]")).to_be_hidden()  # the frame cannot be moved by hand
    for name in ("Teach", "Draw"):  # no part program can be taught to it, and it sews no drawing
        expect(page.get_by_role("tab", name=name)).to_be_hidden()
    page.keyboard.press("p")
    expect(page.locator("#taught tr")).to_have_count(0)

    part(page, "Run")
    expect(page.locator("#program option")).to_have_text(["rosette.dst"])
    calculate(page)
    press_until(page, "Start", "running")
    expect(page.locator("#log")).to_contain_text("rosette: completed. IN SPEC")
    part(page, "Review")
    for text in ("completed", "in spec"):
        expect(page.locator("#kept tbody td", has_text=text)).to_have_text(text)
    expect(page.get_by_role("button", name="Continue", exact=True)).to_be_hidden()
    expect(page.locator("#rest-notes")).to_contain_text("nothing of it is left to do")
    page.close()


FIELDS = {
    "lathe-winder": {
        "interpolation", "priority", "feed", "shaper", "radius", "law", "tolerance", "contour",
        "feed-forward", "smoothing", "robust", "offset",
    },
    "schiffli-frame": {"feed", "law", "tolerance", "robust"},
    "letter-placer": {"shaper"},
}  # fmt: skip


@pytest.mark.parametrize(
    "name, plant", [(name, (name, 4.0)) for name in FIELDS], indirect=["plant"]
)
def test_fields_are_those_of_the_kind_of_work(browser: Browser, plant: Plant, name: str) -> None:
    page = opened(browser, plant, name)
    part(page, "Prepare")
    page.get_by_text("Expert options").click()
    for field in FIELDS["lathe-winder"]:
        expect(page.locator(f"#{field}")).to_be_visible(visible=field in FIELDS[name])
    shot(page, f"30-options-{name}")
    page.close()


@pytest.mark.long(shown_by="test_the_list_of_runs_has_the_words_of_the_verdict")
@pytest.mark.parametrize("plant", [("lathe-winder", 4.0)], indirect=True)
def test_typed_options_are_sent_with_the_request(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    press(page, "Take control")
    part(page, "Prepare")
    page.get_by_text("Expert options").click()
    asked = {"law": "harmonic:7", "tolerance": "0.2 mm", "contour": "0.3 mm", "robust": "0 %"}
    for field, text in asked.items():
        page.locator(f"#{field}").fill(text)
    page.evaluate(
        """() => {
          window.asked = [];
          const send = WebSocket.prototype.send;
          WebSocket.prototype.send = function (text) {
            window.asked.push(text);
            send.call(this, text);
          };
        }"""
    )
    calculate(page)
    page.wait_for_function("() => window.asked.some((one) => one.includes('calculate'))")
    commands = [json.loads(one) for one in page.evaluate("() => window.asked")]
    (sent,) = [
        one["command"] for one in commands if one.get("command", {}).get("what") == "calculate"
    ]
    assert {name: sent[name] for name in asked} == asked
    assert (sent["interpolation"], sent["feed_forward"]) == ("default", False)
    assert "shaper" not in sent
    page.close()


def test_calculate_says_what_it_needs(browser: Browser, plant: Plant) -> None:
    """Where no program is in the folder, there is nothing to calculate."""
    plant.box.with_name("there.prg").unlink()
    page = opened(browser, plant)
    press(page, "Take control")
    part(page, "Prepare")
    calculates = page.get_by_role("button", name="Calculate", exact=True)
    expect(calculates).to_be_disabled()
    expect(calculates).to_have_attribute("title", "choose or load a program first")
    page.close()

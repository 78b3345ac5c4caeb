"""The page on a desk, a tablet and a phone, light and dark: everything visible and in reach."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.panel.browsing import (
    Browser,
    Page,
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

AXE = Path(__file__).parents[2] / "web" / "node_modules" / "axe-core" / "axe.min.js"
PARTS = ("Prepare", "Run", "Review", "Teach", "Draw", "Guide")
SIZES = ((1280, 800), (1024, 768), (390, 844))
LEAST_PX = 44
"""Least height of what is pressed: 48 CSS pixels by design, and WCAG 2.5.5 asks for 44."""


def findings(page: Page) -> list[str]:
    """Return what axe-core finds in the page as it is."""
    found: dict[str, Any] = page.evaluate("() => axe.run()")
    return [
        f"{one['id']}: {node['target']} {node['failureSummary']}"
        for one in found["violations"]
        for node in one["nodes"]
    ]


@pytest.mark.skipif(not AXE.exists(), reason="axe-core is not installed: make panel")
def test_axe_finds_nothing_on_any_part(browser: Browser, plant: Plant) -> None:
    """Light on a desk and dark on a phone, with a calculated program and an open drawer."""
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC")
    page.evaluate(AXE.read_text("utf-8"))
    part(page, "Prepare")
    page.get_by_text("Expert options").click()
    part(page, "Guide")
    expect(page.locator("#guide-tables table").first).to_be_visible()
    for (width, height), scheme in ((SIZES[0], "light"), (SIZES[2], "dark")):
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        for name in PARTS:
            part(page, name)
            assert findings(page) == [], (name, scheme)
            shot(page, f"31-{name.lower()}-{scheme}")
    page.close()


def nothing_is_wider(page: Page) -> None:
    """Check that the open part is not wider than any screen, and that axe-core finds no fault."""
    if AXE.exists():
        page.evaluate(AXE.read_text("utf-8"))
    for (width, height), scheme in zip(SIZES, ("light", "light", "dark"), strict=True):
        page.set_viewport_size({"width": width, "height": height})
        page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        # A canvas takes its new width with the next picture.
        fits = "width => document.documentElement.scrollWidth <= width"
        page.wait_for_function(fits, arg=width, timeout=10_000)
        if AXE.exists() and width != SIZES[1][0]:
            assert findings(page) == [], scheme
    page.set_viewport_size({"width": SIZES[0][0], "height": SIZES[0][1]})


def bar_leaves_room(page: Page, height: int) -> None:
    """Check that the permanent bar leaves three quarters of the screen."""
    box = page.locator("header").bounding_box()
    assert box is not None
    assert box["height"] <= height / 4, (page.viewport_size, page.locator("#state").inner_text())


def bar_leaves_room_on_all(page: Page) -> None:
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        bar_leaves_room(page, height)
    page.set_viewport_size({"width": SIZES[0][0], "height": SIZES[0][1]})


def test_a_desk_at_twice_its_size_has_room_for_the_work(browser: Browser, plant: Plant) -> None:
    """Zoom 200 %: the bar takes less than a third of the screen, and nothing in it overlaps."""
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    press_until(page, "Start", "running")
    page.set_viewport_size({"width": 640, "height": 400})
    header = page.locator("header").bounding_box()
    assert header is not None and header["height"] <= 400 / 3
    names = ("#state", "#now", "#going", "#left-row", "#feed-row", "#run", "#stop")
    boxes = [page.locator(name).bounding_box() for name in names]
    for k, one in enumerate(boxes):
        for name, other in zip(names[k + 1 :], boxes[k + 1 :], strict=True):
            assert one is not None and other is not None
            across = (
                one["x"] + one["width"] <= other["x"] or other["x"] + other["width"] <= one["x"]
            )
            down = (
                one["y"] + one["height"] <= other["y"] or other["y"] + other["height"] <= one["y"]
            )
            assert across or down, (names[k], name)
    assert page.evaluate("document.documentElement.scrollWidth") <= 640
    page.close()


@pytest.mark.parametrize("plant", [("lathe-winder", 0.1)], indirect=True)
def test_a_hold_moves_nothing_and_the_decimal_points_are_in_line(
    browser: Browser, plant: Plant
) -> None:
    """The next step of a held run has its place in the bar; A in degrees, X in millimetres."""
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    press_until(page, "Start", "running")
    tops = []
    for text, name in (("Hold", "holding"), ("Resume", "running")):
        press_until(page, text, name)
        expect(page.locator("#next")).to_be_visible(visible=name == "holding")
        tops.append([page.locator(box).bounding_box() for box in ("#by-hand", "#seen-section")])
    assert tops[0] == tops[1]
    for size in SIZES:
        page.set_viewport_size({"width": size[0], "height": size[1]})
        ends = set()
        for axis in ("A", "X"):
            digits, unit = (
                page.locator(f"#{part}-{axis}").bounding_box() for part in ("digits", "unit")
            )
            number = page.locator(f"#at-{axis}").bounding_box()
            assert digits is not None and unit is not None and number is not None
            assert unit["x"] + unit["width"] <= number["x"] + number["width"] + 0.5  # not cut off
            ends.add(round(digits["x"] + digits["width"]))
        assert len(ends) == 1, size
    page.close()


def test_nothing_is_wider_than_the_screen_and_the_run_is_in_sight(
    browser: Browser, plant: Plant
) -> None:
    """On each part: STOP in the same corner; the state, hold and time left without scrolling."""
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    press_until(page, "Start", "running")
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        corners = set()
        for name in PARTS:
            part(page, name)
            assert page.evaluate("document.documentElement.scrollWidth") <= width, name
            bar_leaves_room(page, height)
            stop = page.locator("#stop").bounding_box()
            assert stop is not None
            corners.add((round(width - stop["x"] - stop["width"]), round(stop["y"])))
            for expected in ("#state", "#time-left", "#progress", "#now-program"):
                box = page.locator(expected).bounding_box()
                assert box is not None
                assert box["y"] + box["height"] < height / 2, (name, expected)
            hold = page.get_by_role("button", name="Hold", exact=True).bounding_box()
            assert hold is not None
            assert hold["height"] >= LEAST_PX
            assert hold["y"] + hold["height"] < height / 2
        assert len(corners) == 1
        assert max(next(iter(corners))) < 16
    if AXE.exists():  # pictures of a run have names, even before they are scrolled into sight
        page.set_viewport_size({"width": SIZES[0][0], "height": SIZES[0][1]})
        part(page, "Run")
        expect(page.locator("#error-live")).to_be_visible()
        page.evaluate(AXE.read_text("utf-8"))
        assert findings(page) == []
    press(page, "STOP")
    state(page, "idle")
    page.close()


@pytest.mark.parametrize("plant", [("lathe-winder", 0.1)], indirect=True)
def test_the_bar_leaves_room_in_each_state(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant)
    bar_leaves_room_on_all(page)  # nobody has control
    press(page, "Take control")
    press_until(page, "Enable", "enabled")
    bar_leaves_room_on_all(page)
    press_until(page, "Home all", "homing|idle")
    state(page, "idle")
    calculate(page)
    expect(page.locator("#next")).to_have_text("Next: start")
    bar_leaves_room_on_all(page)
    press_until(page, "Start", "running")
    bar_leaves_room_on_all(page)
    press_until(page, "Hold", "holding")
    bar_leaves_room_on_all(page)
    press(page, "STOP")
    state(page, "idle")
    expect(page.locator("#progress-text")).to_contain_text("did not reach its end")
    bar_leaves_room_on_all(page)
    page.close()


@pytest.mark.long(shown_by="tests/panel/test_page.py::test_home_jog_calculate_run_hold_resume_stop")
def test_the_bar_leads_a_newcomer_to_the_start(browser: Browser, plant: Plant) -> None:
    """Only the next button to press is marked and named."""
    page = opened(browser, plant)
    marked = page.locator("button.next")
    for words, name, until in (
        ("take control", "Take control", ""),
        ("enable the drives", "Enable", "enabled"),
        ("home the machine", "Home all", "homing|idle"),
    ):
        expect(page.locator("#next")).to_have_text(f"Next: {words}")
        expect(marked).to_have_text(name)
        page.locator("#next").click()  # leads to the button, and presses nothing
        expect(marked).to_be_focused()
        expect(page.locator("#next")).to_have_text(f"Next: {words}")
        press_until(page, name, until) if until else press(page, name)
    state(page, "idle")
    expect(marked).to_have_text(["Prepare", "Calculate"])  # the part of the page, and the button
    calculate(page)
    expect(page.locator("#next")).to_have_text("Next: start")
    expect(marked).to_have_text("Start")
    press_until(page, "Start", "running")
    expect(page.locator("#now-line")).to_have_text("line 5")
    expect(marked).to_have_count(0)
    press(page, "STOP")
    state(page, "idle")
    page.close()

"""The views in three dimensions: a winding, a placer's cycle, a frame, a seam."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.panel import bench
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
from tests.panel.test_wound import PRODUCT, PROGRAM
from threadline.panel.protocol import Calculate

if TYPE_CHECKING:
    from playwright.sync_api import Request

SPACE = True


@pytest.fixture
def helix(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A program with a product, instead of the winder's usual program."""
    (tmp_path / "helix.prg").write_text(PROGRAM, "utf-8")
    (tmp_path / "tube.wind.toml").write_text(PRODUCT, "utf-8")
    words = {"program": "helix.prg", "product": "tube.wind.toml", "interpolation": "linear"}
    asked = Calculate.model_validate({"what": "calculate", "level": "nominal", **words})
    monkeypatch.setitem(bench.CASES, "lathe-winder", asked)


@pytest.mark.long(shown_by="test_a_winding_is_seen_before_and_while_it_is_wound")
@pytest.mark.parametrize("plant", [("lathe-winder", 0.4)], indirect=True)
def test_the_bands_of_a_product_are_seen_as_they_are_laid(
    browser: Browser, helix: None, plant: Plant
) -> None:
    """Before a run all bands are shown; during a run each place is requested once, in time."""
    page = opened(browser, plant)
    ready(page)
    expect(page.locator("#legend")).not_to_contain_text("fibre")
    asked: list[int] = []

    def note(one: Request) -> None:
        if "/api/wound" in one.url:
            asked.append(int(one.url.split("after=")[1]))

    page.on("request", note)
    calculate(page)
    expect(page.locator("#legend")).to_contain_text("fibre laid so far")
    whole = int(page.locator("#space > div").get_attribute("data-laid") or 0)
    assert whole > 100 and asked == [0]
    shot(page, "17-product")
    part(page, "Prepare")
    page.locator("#override").fill("a test")
    part(page, "Run")
    press(page, "Start")
    state(page, "running")
    laid = "Number(document.querySelector('#space > div').dataset.laid)"
    page.wait_for_function(f"() => {laid} > 5 && {laid} < {whole}")
    with page.expect_request(re.compile(r"/api/wound.*after=[1-9]")):
        shot(page, "18-wound")
    page.keyboard.press("Escape")
    state(page, "idle")
    part_laid, last = int(page.evaluate(laid)), len(asked)
    assert 5 < part_laid < whole
    assert asked[1] == whole and asked[2:] == sorted(asked[2:]) and asked[-1] > 0
    page.wait_for_timeout(1000)
    assert len(asked) == last and page.evaluate(laid) == part_laid
    page.close()


def test_a_winding_is_seen_before_and_while_it_is_wound(browser: Browser, plant: Plant) -> None:
    """At most ten pictures a second, or five with rough edges if the processor draws them.

    The test's own process runs the machine.
    """
    page = opened(browser, plant)
    ready(page)
    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC")
    press(page, "Simulate")
    expect(page.locator("#seen")).to_contain_text("SIMULATED, not the machine")
    page.wait_for_timeout(1500)
    shot(page, "10-simulated")
    press(page, "Start")
    state(page, "running")
    expect(page.locator("#seen")).to_have_text("the machine, now")
    # By the clock of the page, however long a busy computer takes for its pictures.
    drawn_ms = page.evaluate(
        """() => new Promise((come) => {
          const space = document.getElementById("space"), times = [];
          new MutationObserver(() => {
            times.push(performance.now());
            if (times.length === 21) come(times);
          }).observe(space, { attributes: true, attributeFilter: ["data-drawn"] });
        })"""
    )
    drawn_by, smooth = page.evaluate(
        """() => {
          const context = document.querySelector("#space canvas").getContext("webgl2");
          context.getExtension("WEBGL_debug_renderer_info");
          return [context.getParameter(0x9246), context.getContextAttributes().antialias];
        }"""
    )
    assert smooth == ("SwiftShader" not in drawn_by)
    assert np.median(np.diff(drawn_ms)) >= (90.0 if smooth else 180.0)
    page.keyboard.press("Escape")
    state(page, "idle")
    page.close()


@pytest.mark.parametrize("plant", [("letter-placer", 2.0)], indirect=True)
def test_the_placers_cycle(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant, "letter-placer")
    ready(page)
    lamp = page.locator(".scheme [data-signal=x_is_right]")
    expect(lamp).to_be_visible()  # before any program, and without axes
    for absent in ("#feed-row", "#tab-teach-in", "#tab-drawing", "#priority"):
        expect(page.locator(absent)).to_be_hidden()
    part(page, "Prepare")
    page.get_by_text("Without swinging").click()
    expect(page.locator("#shaper")).to_have_value("um-zv")
    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC")
    press(page, "Simulate")  # the plan moves the pistons and lights the lamps
    expect(lamp).to_have_class("lamp on")
    press(page, "End simulation")
    press(page, "Start")
    state(page, "running")
    page.wait_for_timeout(1000)
    press(page, "Hold")
    state(page, "holding")
    lanes = page.locator(".switched").evaluate_all("all => all.map((one) => one.getAttribute('d'))")
    assert any(lanes) and not any("Infinity" in one or "NaN" in one for one in lanes)
    actual = page.locator("polyline.actual").first
    held = actual.get_attribute("points")
    assert held
    shot(page, "13-placer")
    press(page, "Resume")
    expect(page.locator("#progress-text")).to_contain_text("IN SPEC", timeout=240_000)
    expect(page.locator("#facts")).to_contain_text(
        "cycles completed since the machine was connected: 1"
    )
    expect(page.locator("#error-live")).to_be_hidden()  # a cycle has no contour
    expect(page.locator("#board")).to_be_hidden()
    page.close()


@pytest.mark.long(shown_by="test_the_placers_cycle")
@pytest.mark.parametrize("plant", [("schiffli-frame", 10.0)], indirect=True)
def test_an_embroidery_is_sewn(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant, "schiffli-frame")
    ready(page)
    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC")
    legend = page.locator("#legend")
    expect(legend).to_contain_text("thread 1")
    page.locator("#seen-as").select_option("use")  # a map of the residuals
    expect(legend).to_contain_text("swing at the needle: half of the limit or less")
    shot(page, "14-frame-residuals")
    page.locator("#seen-as").select_option("threads")
    expect(legend).to_contain_text("thread 1")
    press_until(page, "Start", "running")
    page.wait_for_timeout(4000)
    expect(page.locator("#space p")).to_contain_text(
        re.compile(r"^stitch \d+ of 185, thread \d of 2, \d+ stitches a minute$")
    )
    expect(page.locator("#facts")).to_have_text("a hold stands at the end of the stitch")
    shot(page, "14-frame")
    page.keyboard.press("Escape")  # the thread broke
    state(page, "idle")
    expect(page.locator("#space p")).to_contain_text("of 185, thread")  # how far it is sewn
    hint = page.locator("#rest-here-told")
    expect(hint).to_contain_text("home the machine first")
    press_until(page, "Home all", "homing|idle")
    state(page, "idle")
    expect(hint).to_contain_text("After a thread break, go some stitches back.", timeout=60_000)
    page.locator("#back-stitches input").fill("5")
    press(page, "Back")
    expect(hint).to_contain_text("with needle and tools off. Start the rest confirms")
    shot(page, "15-back")
    press(page.locator("#rest-here"), "Start the rest")
    state(page, "running")
    expect(page.locator("#rest-here")).to_be_hidden()
    expect(page.locator("#progress-text")).to_contain_text("IN SPEC", timeout=120_000)
    page.close()


@pytest.mark.long(shown_by="test_the_placers_cycle")
@pytest.mark.parametrize("plant", [("stitcher", 2.0)], indirect=True)
def test_a_seam(browser: Browser, plant: Plant) -> None:
    page = opened(browser, plant, "stitcher")
    ready(page)
    part(page, "Prepare")
    page.locator("#program").select_option("strap.seam.toml")
    calculate(page)
    expect(page.locator("#figures")).to_contain_text("IN SPEC")
    press(page, "Simulate")
    page.wait_for_timeout(1500)
    shot(page, "16-seam")
    press(page, "Start")
    state(page, "running")
    expect(page.locator("#facts")).to_contain_text("a hold ")
    error = page.locator("#error-told")
    expect(error).to_contain_text("measured at the load")
    expect(error).to_contain_text("so far at most")
    shot(page, "19-seam-runs")
    expect(page.locator("#progress-text")).to_contain_text("IN SPEC", timeout=60_000)
    expect(error).to_have_text(re.compile(r"^so far at most [\d.]+ mm of [\d.]+ mm, measured"))
    worst = page.locator("#error-line")
    expect(worst).to_have_text(re.compile(r"^worst at line \d+$"))
    page.close()


@pytest.mark.parametrize(
    "name, plant",
    [(name, (name, 4.0)) for name in ("schiffli-frame", "lathe-winder")],
    indirect=["plant"],
)
def test_a_view_is_seen_larger_by_the_keyboard(browser: Browser, plant: Plant, name: str) -> None:
    """Fit brings back a picture of the whole work."""
    page = opened(browser, plant, name)
    part(page, "Prepare")
    expect(page.locator("#extent")).not_to_be_empty()

    def drawn() -> bytes:
        page.mouse.move(5, 5)
        page.wait_for_timeout(600)
        return page.locator("#space canvas").screenshot()

    whole = drawn()
    page.get_by_role("button", name="Larger", exact=True).focus()
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")
    larger = drawn()
    assert larger != whole
    page.get_by_role("button", name="Smaller", exact=True).focus()
    page.keyboard.press("Enter")
    assert drawn() not in (whole, larger)
    page.get_by_role("button", name="Fit", exact=True).focus()
    page.keyboard.press("Enter")
    assert drawn() == whole
    page.close()

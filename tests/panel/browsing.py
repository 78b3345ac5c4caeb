"""The page in a browser, as an operator uses it.

If ``THREADLINE_PICTURES`` is set, pictures of the page go to ``reports/panel``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from tools.browser import chromium

from tests.panel.test_panel_killed import Plant
from threadline.panel.server import PAGE

CHROMIUM = chromium()
if CHROMIUM is None:
    pytest.skip("there is no chromium", allow_module_level=True)
if not (PAGE / "index.html").exists():
    pytest.skip("the page was not built: make panel", allow_module_level=True)

from playwright.sync_api import Browser, Locator, Page, expect  # noqa: E402
from playwright.sync_api import TimeoutError as WaitedTooLong  # noqa: E402

expect.set_options(timeout=60_000)  # a busy computer is slow, and waiting in vain is a failure
SHOTS = Path(__file__).parents[2] / "reports" / "panel"
PICTURES = bool(os.environ.get("THREADLINE_PICTURES"))
SIZE = {"width": 1280, "height": 800}
SHOWN_X = "Number.parseFloat(document.getElementById('at-X').textContent)"
TABLET = {"width": 1024, "height": 768}
PHONE = {"width": 390, "height": 844}


def opened(browser: Browser, plant: Plant, machine: str = "lathe-winder") -> Page:
    page = browser.new_page(viewport=SIZE)
    page.set_default_timeout(60_000)
    page.goto(f"http://127.0.0.1:{plant.port}/")
    expect(page.locator("#machine")).to_have_text(f"{machine}, simulated", timeout=60_000)
    return page


def shot(page: Page, name: str) -> None:
    """Take pictures of a desk, a tablet and a phone, if somebody wants to see them."""
    if not PICTURES:
        return
    SHOTS.mkdir(parents=True, exist_ok=True)
    for scheme in ("dark", "light"):
        page.emulate_media(color_scheme=scheme)  # type: ignore[arg-type]
        for size, ending in ((PHONE, "-phone"), (TABLET, "-tablet"), (SIZE, "")):
            page.set_viewport_size(size)
            page.wait_for_timeout(300)
            page.screenshot(path=SHOTS / f"{name}{ending}-{scheme}.png", full_page=True)


def press(page: Page | Locator, text: str) -> None:
    page.get_by_role("button", name=text, exact=True).click()


def part(page: Page, name: str) -> None:
    page.get_by_role("tab", name=name).click()


def calculate(page: Page) -> None:
    """Calculate the chosen program, and go back to the machine."""
    part(page, "Prepare")
    press(page, "Calculate")
    part(page, "Run")


def state(page: Page, name: str) -> None:
    """Wait for a state, with any reason."""
    expect(page.locator("#state")).to_have_text(re.compile(rf"{name}(:|$)"), timeout=60_000)


def ready(page: Page) -> None:
    press(page, "Take control")
    press_until(page, "Enable", "enabled")
    press_until(page, "Home all", "homing|idle")
    state(page, "idle")


def press_until(page: Page, text: str, names: str) -> None:
    """Press a button until one of some states is shown.

    A command is refused if the state seen by its sender is older than half a second, which happens
    on a busy computer.
    """
    shown = page.locator("#state")
    expected = re.compile(rf"({names})(:|$)")
    for _ in range(40):
        with suppress(WaitedTooLong):  # the state came late, and the button is grey by now
            page.get_by_role("button", name=text, exact=True).click(timeout=1_000)
        with suppress(AssertionError):
            expect(shown).to_have_text(expected, timeout=5_000)
            return
    raise AssertionError(f"{text} was pressed 40 times: {shown.inner_text()}")


def x_mm(page: Page) -> float:
    return float(page.locator("#at-X").inner_text().removesuffix("mm"))


def moved_on(page: Page, from_mm: float) -> None:
    """Wait until X has moved farther than a settling loop moves it."""
    page.wait_for_function(f"from => Math.abs({SHOWN_X} - from) > 1.0", arg=from_mm)


def reached(page: Page, where: str) -> bool:
    """Wait a while until the shown X meets a comparison; return whether it does."""
    try:
        page.wait_for_function(f"() => {SHOWN_X} {where}", timeout=5_000)
    except WaitedTooLong:
        return False
    return True


def to_zero(page: Page, ask: Callable[[], None]) -> None:
    """Send X to zero, again if a busy computer has renewed the move too late."""
    for _ in range(20):
        ask()
        if reached(page, "== 0"):
            state(page, "idle")
            return
        state(page, "idle")
    raise AssertionError("20 moves did not bring X to zero")


def stands(page: Page) -> float:
    """Wait until X is the same in ten fresh states; return it in mm."""
    return float(page.evaluate(
        f"""async () => {{
          const seen = [];
          while (seen.length < 10 || seen.some((x) => Math.abs(x - seen[0]) > 0.02)) {{
            await new Promise((come) => setTimeout(come, 60));
            const age = /^data ([0-9]+) ms/.exec(document.getElementById("age").textContent);
            if (!age || Number(age[1]) > 200) {{ seen.length = 0; continue; }}
            seen.push({SHOWN_X});
            if (seen.length > 10) seen.shift();
          }}
          return seen[9];
        }}"""
    ))  # fmt: skip


def looks(page: Page, number: int) -> None:
    """Wait for a number of fresh states: by then every earlier request has begun."""
    page.evaluate(
        """async (number) => {
          for (let seen = 0; seen < number;) {
            await new Promise((come) => setTimeout(come, 60));
            const age = /^data ([0-9]+) ms/.exec(document.getElementById("age").textContent);
            if (age && Number(age[1]) <= 200) seen++;
          }
        }""",
        number,
    )


def jog_until(page: Page, key: str, enough: Callable[[], bool]) -> None:
    """Hold a key until a condition is met; release it, and wait until the machine is idle.

    On a busy computer a jog may end because it was renewed too late, perhaps before anyone looked;
    then the key is pressed again.
    """
    for _ in range(20):
        page.keyboard.down(key)
        page.wait_for_timeout(600)
        page.keyboard.up(key)
        state(page, "idle")
        if enough():
            return
    raise AssertionError(f"20 jogs by {key} were not enough")


def held_and_let_go(page: Page, label: str, far: float, axis: str = "X") -> None:
    """Hold a button with the mouse until an axis has moved so far (mm or degrees); release it.

    On a busy computer a jog may end because it was renewed too late. Then the button is held again,
    so that releasing the button ends the last jog.
    """
    page.get_by_label(f"{label} while held").hover()
    for _ in range(20):
        shown = SHOWN_X.replace("at-X", f"at-{axis}")
        before = page.evaluate(shown)
        page.mouse.down()
        try:
            page.wait_for_function(
                f"([from, far]) => Math.abs({shown} - from) > far",
                arg=[before, far],
                timeout=5_000,
            )
        except WaitedTooLong:
            page.mouse.up()
            continue
        page.mouse.up()
        state(page, "idle")
        if "nobody has renewed" not in page.locator("#state").inner_text():
            return
    raise AssertionError(f"20 times {label} was not ended by the hand")


def begin_jog(page: Page, key: str) -> None:
    """Hold a key until the machine jogs; it is pressed again as in ``jog_until``."""
    for _ in range(20):
        page.keyboard.down(key)
        try:
            expect(page.locator("#state")).to_have_text("jogging", timeout=2_000)
        except AssertionError:
            page.keyboard.up(key)
        else:
            return
    raise AssertionError(f"20 times {key} began no jog")


def typed(page: Page, *points: tuple[float, float]) -> None:
    for x, y in points:
        page.locator("#typed-point").fill(f"{x}, {y}")
        page.locator("#typed-point").press("Enter")

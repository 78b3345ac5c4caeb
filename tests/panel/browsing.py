"""The page in a browser, as an operator uses it.

With ``THREADLINE_PICTURES`` set to something, pictures of it go to ``reports/panel``.
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

expect.set_options(timeout=60_000)  # a busy computer is slow, and what never comes is a failure
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
    """Take pictures of a desk, a tablet and a phone, where somebody wants to look at them."""
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
    """Wait for a state, whatever reason is told with it."""
    expect(page.locator("#state")).to_have_text(re.compile(rf"{name}(:|$)"), timeout=60_000)


def ready(page: Page) -> None:
    press(page, "Take control")
    press_until(page, "Enable", "enabled")
    press_until(page, "Home all", "homing|idle")
    state(page, "idle")


def press_until(page: Page, text: str, names: str) -> None:
    """Press a button until one of some states is shown.

    A command is refused where the state that its sender has seen is older than half a second, as on
    a busy computer it is.
    """
    shown = page.locator("#state")
    wanted = re.compile(rf"({names})(:|$)")
    for _ in range(40):
        with suppress(WaitedTooLong):  # it cannot be pressed any more, as the state came late
            page.get_by_role("button", name=text, exact=True).click(timeout=1_000)
        with suppress(AssertionError):
            expect(shown).to_have_text(wanted, timeout=5_000)
            return
    raise AssertionError(f"{text} was pressed 40 times: {shown.inner_text()}")


def x_mm(page: Page) -> float:
    return float(page.locator("#at-X").inner_text().split()[0])


def moved_on(page: Page, from_mm: float) -> None:
    """Wait until X is shown elsewhere: farther away than a loop that settles goes."""
    page.wait_for_function(f"from => Math.abs({SHOWN_X} - from) > 1.0", arg=from_mm)


def reached(page: Page, where: str) -> bool:
    """Wait a while until X is shown in a place, told as a comparison; return whether it is."""
    try:
        page.wait_for_function(f"() => {SHOWN_X} {where}", timeout=5_000)
    except WaitedTooLong:
        return False
    return True


def to_zero(page: Page, ask: Callable[[], None]) -> None:
    """Ask for X at zero, again where a busy computer has renewed the move too late."""
    for _ in range(20):
        ask()
        if reached(page, "== 0"):
            state(page, "idle")
            return
        state(page, "idle")
    raise AssertionError("20 moves did not bring X to zero")


def stands(page: Page) -> float:
    """Wait until X is shown where it was in ten looks at what is fresh; return where, in mm."""
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
    """Look at what is fresh, a number of times: whatever was asked for before has begun then."""
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
    """Hold a key until it is enough; let it go, and stay until the machine is idle.

    On a busy computer a jog ends because it was renewed too late, perhaps before anyone looked; the
    key is pressed again then.
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
    """Hold a button by the mouse until an axis is shown that far (mm or degrees) away; let it go.

    On a busy computer a jog ends because it was renewed too late; it is held again then, so what
    ends the jog that counts is the hand.
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
    """Hold a key that is seen to jog; it is pressed again as ``jog_until`` does."""
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

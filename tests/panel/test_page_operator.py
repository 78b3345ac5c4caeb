"""An operator's day in one browser: the cone-dome-cylinder program, from its file to a profile."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.panel.browsing import (
    PICTURES,
    SHOTS,
    SIZE,
    Browser,
    Page,
    calculate,
    expect,
    held_and_let_go,
    moved_on,
    part,
    press,
    ready,
    shot,
    stands,
    state,
    typed,
    x_mm,
)

SPACE = True
EXAMPLE = Path(__file__).parents[2] / "examples" / "cone-dome-cylinder.prg"
PLANNED_BESIDE_COMMANDED = """() => {
  const told = document.getElementById("position").title.match(/planned (\\S+), commanded (\\S+),/);
  return told && Math.abs(Number(told[1]) - Number(told[2])) < 3.0;
}"""
LONG_MS = 300_000.0
"""For a calculation, on a computer that is busy with other tests."""


@contextmanager
def panel(folder: Path, *chosen: str) -> Iterator[str]:
    """Serve a project by the command; yield its address."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = ["panel", str(folder), "--port", str(port), *chosen]
    process = subprocess.Popen(
        [sys.executable, "-m", "threadline", *words, "--store", str(folder / "runs")],
        stdout=subprocess.DEVNULL,
    )
    address = f"http://127.0.0.1:{port}/"
    try:
        end = time.monotonic() + 200.0
        while time.monotonic() < end:
            try:
                urllib.request.urlopen(f"{address}api/state", timeout=10).close()
                break
            except (urllib.error.URLError, ConnectionError):
                time.sleep(0.2)
        yield address
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(60)


def seen_by_others(page: Page, name: str) -> None:
    """Take pictures of the page in the colours of colour-blind people."""
    if not PICTURES:
        return
    session = page.context.new_cdp_session(page)
    for kind in ("deuteranopia", "protanopia", "tritanopia", "achromatopsia", "none"):
        session.send("Emulation.setEmulatedVisionDeficiency", {"type": kind})
        if kind != "none":
            page.screenshot(path=SHOTS / f"{name}-{kind}.png")
    session.detach()


def calculated(page: Page, program: str) -> None:
    expect(page.locator("#program")).to_have_value(program)
    calculate(page)
    expect(page.locator("#figures")).to_contain_text(program, timeout=LONG_MS)


@pytest.mark.long(shown_by="tests/panel/test_page.py::test_home_jog_calculate_run_hold_resume_stop")
def test_an_operators_day(browser: Browser, tmp_path: Path) -> None:
    folder = tmp_path / "project"
    folder.mkdir()
    with panel(folder, "-m", "lathe-winder", "--speed", "0.5") as address:
        page = browser.new_page(viewport=SIZE)
        page.set_default_timeout(60_000)
        page.goto(address)
        ready(page)

        page.locator("#file").set_input_files(EXAMPLE)
        there = f"{EXAMPLE.name} is in the project folder"
        expect(page.locator("#log")).to_contain_text(there, timeout=60_000)
        assert (folder / EXAMPLE.name).read_bytes() == EXAMPLE.read_bytes()
        start = page.get_by_role("button", name="Start", exact=True)
        expect(start).to_be_disabled()
        part(page, "Prepare")
        page.get_by_text("Expert options").click()
        page.locator("#interpolation").select_option("optimal")
        calculated(page, EXAMPLE.name)
        figures = page.locator("#figures")
        for text in ("IN SPEC", "duration", "ticks", "circuits", "points"):
            expect(figures).to_contain_text(text)
        expect(page.locator("#criteria")).to_contain_text("the tool stays within 0.500 mm of its")
        press(page, "Simulate")
        expect(page.locator("#seen")).to_contain_text("SIMULATED, not the machine")
        page.wait_for_timeout(1500)
        shot(page, "20-day-simulated")
        press(page, "End simulation")

        expect(start).to_be_enabled()
        press(page, "Start")
        state(page, "running")
        expect(page.locator("#progress-text")).to_contain_text(" %")
        expect(page.locator("#seen")).to_have_text("the machine, now")
        moved_on(page, x_mm(page))
        shot(page, "21-day-running")
        press(page, "Hold")
        state(page, "holding")
        held = stands(page)
        page.wait_for_timeout(1000)
        assert abs(x_mm(page) - held) < 0.1  # the loop settles
        shot(page, "22-day-held")
        seen_by_others(page, "22-day-held")
        press(page, "Resume")
        state(page, "running")
        moved_on(page, held)
        # The plan is shown at the times at which the run reaches it: a hold shifts them.
        page.wait_for_function(PLANNED_BESIDE_COMMANDED)
        press(page, "STOP")
        state(page, "idle")
        expect(page.locator("#progress-text")).to_contain_text("stopped")

        part(page, "Review")
        expect(page.locator("#kept")).to_contain_text("stopped", timeout=LONG_MS)
        expect(page.locator("#trace .uplot")).to_have_count(2, timeout=LONG_MS)
        shot(page, "23-day-trace")
        part(page, "Run")

        for k, (label, axis) in enumerate((("X plus", "X"), ("A plus", "A"), ("X minus", "X"))):
            held_and_let_go(page, f"Jog {label}", 2.0, axis)
            page.keyboard.press("p")
            expect(page.locator("#taught tr")).to_have_count(k + 1)
        part(page, "Teach")
        page.locator("#teach-name").fill("three")
        shot(page, "24-day-taught")
        press(page, "Save program")
        part(page, "Run")
        expect(start).to_be_disabled()
        calculated(page, "three.prg")
        expect(figures.locator("dt", has_text=re.compile("^points$")).locator("+ dd")).to_have_text(
            "3"
        )

        part(page, "Draw")
        press(page, "Line")
        typed(page, (-300, 20), (0, 60), (100, 60), (300, 30))
        page.locator("#typed-point").press("Enter")
        shot(page, "25-day-profile")
        press(page, "Use as mandrel")
        part(page, "Run")
        expect(page.locator("#radius")).to_have_value(
            "A=20 mm at X -300 mm; 60 mm at X 0 mm; 60 mm at X 100 mm; 30 mm at X 300 mm"
        )
        page.close()

"""Watch the panel at work for an hour: what its processes cost, and whether memory stays flat.

A headless Chromium has the page open and runs a program again and again. ``python -m
tools.panel_hour --minutes 60`` writes a line a minute, and the figures of ``docs/panel.md`` at the
end. With ``--circuits 60`` one run lasts long, so that the machine moves all the time. ``--machine
stitcher --program strap.seam.toml`` takes another machine and another example.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from playwright.sync_api import Page, TimeoutError, sync_playwright
from tools.browser import chromium

ROOT = Path(__file__).parents[1]
PROGRAM = ROOT / "examples" / "cone-dome-cylinder.prg"
CIRCUITS = 3
"""Circuits of the program; each call of its subroutine winds one."""
SPEED = "0.9"
"""Just below real time, so that a busy computer delays the machine and is no fault of it."""
_TICKS = os.sysconf("SC_CLK_TCK")
_PAGE = os.sysconf("SC_PAGE_SIZE")
_SETTLED_S = 120.0  # caches and the store's libraries are there


def cost(pid: int) -> tuple[float, float]:
    """Return the processor time in s, and the memory in MB, of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text("utf-8").rpartition(")")[2].split()
    pages = int(Path(f"/proc/{pid}/statm").read_text("utf-8").split()[1])
    return (int(fields[11]) + int(fields[12])) / _TICKS, pages * _PAGE / 1e6


def child_of(pid: int) -> int:
    """Return the first child of a process."""
    return int(Path(f"/proc/{pid}/task/{pid}/children").read_text("utf-8").split()[0])


def open_page(page: Page, port: int, program: str) -> None:
    """Open the panel, and bring the machine to where the program was calculated."""
    end = time.monotonic() + 120.0
    while True:
        try:
            page.goto(f"http://127.0.0.1:{port}/")
            break
        except Exception:  # the server is not there yet
            if time.monotonic() > end:
                raise
            time.sleep(1.0)
    for name in ("Take control", "Enable", "Home all"):
        press(page, name)
    page.get_by_role("tab", name="Prepare").click()
    page.locator("#program").select_option(program)
    press(page, "Calculate")
    page.locator("#figures dt").first.wait_for(timeout=600_000)
    if (reason := page.locator("#override")).is_visible():  # a program out of specification
        reason.fill("to measure the panel")
    page.get_by_role("tab", name="Run").click()


def press(page: Page, name: str) -> None:
    """Press a button once it can be pressed."""
    page.get_by_role("button", name=name, exact=True).click(timeout=300_000)


def approach(page: Page) -> None:
    """Hold the button that moves the axes to where the program begins, until they stand there."""
    if "Approach" not in page.locator("#next").inner_text():
        return
    page.get_by_role("button", name="Approach", exact=True).hover()
    page.mouse.down()
    with suppress(TimeoutError):  # it is held again
        page.locator("#next", has_text="Next: start").wait_for(timeout=30_000)
    page.mouse.up()
    page.wait_for_timeout(1000)


def go_on(page: Page) -> bool:
    """Start the program again where it has ended, from where it begins.

    A page that a busy computer has kept waiting has lost control, and takes it again. A machine
    that such a computer has brought into a fault is reset, enabled and homed; True is returned.
    """
    take = page.get_by_role("button", name="Take control", exact=True)
    if take.is_visible():
        take.click()
    fault = page.locator("#state").inner_text().startswith("fault")
    if fault:
        for name in ("Reset", "Enable", "Home all"):
            press(page, name)
    start = page.get_by_role("button", name="Start", exact=True)
    if start.is_enabled():
        approach(page)
        if start.is_enabled():
            start.click()
    return fault


def heap_mb(page: Page) -> float:
    """Return what the page's own objects take, MB, after what is not used was collected."""
    session = page.context.new_cdp_session(page)
    session.send("HeapProfiler.collectGarbage")
    found: Any = session.send("Runtime.getHeapUsage")
    session.detach()
    return float(found["usedSize"]) / 1e6


def browser_pids(page: Page) -> dict[str, int]:
    """Return the process of the page, and the one that draws for it, as Chromium names them."""
    browser = page.context.browser
    assert browser is not None
    session = browser.new_browser_cdp_session()
    answer: Any = session.send("SystemInfo.getProcessInfo")
    session.detach()
    kinds = {"renderer": "page", "GPU": "drawing"}
    found = {one["type"]: one["id"] for one in answer["processInfo"] if one["cpuTime"] > 0.0}
    return {name: int(found[kind]) for kind, name in kinds.items() if kind in found}


def watch(page: Page, pids: dict[str, int], minutes: float) -> None:
    """Write a line a minute with memory and processor time, and at the end what they come to."""
    began = time.monotonic()
    first: dict[str, tuple[float, float]] = {}
    settled, heaps = began, list[float]()
    most, faults = dict.fromkeys(pids, 0.0), 0
    while time.monotonic() - began < 60.0 * minutes:
        until = time.monotonic() + 60.0
        while time.monotonic() < until:
            faults += go_on(page)
            page.wait_for_timeout(2000)
        now = {name: cost(pid) for name, pid in pids.items()}
        heaps.append(heap_mb(page))
        if not first and time.monotonic() - began >= _SETTLED_S:
            first, settled = now, time.monotonic()
            most, heaps = {name: now[name][1] for name in pids}, heaps[-1:]
        most = {name: max(most[name], now[name][1]) for name in pids}
        memory = ", ".join(f"{name} {now[name][1]:.1f} MB, {now[name][0]:.1f} s" for name in pids)
        at_min = (time.monotonic() - began) / 60.0
        sys.stdout.write(f"{at_min:5.1f} min: {memory}, page {heaps[-1]:.1f} MB\n")
        sys.stdout.flush()
    over_s = time.monotonic() - settled
    for name, pid in pids.items():
        spent_s, memory_mb = cost(pid)
        sys.stdout.write(
            f"{name}: {100.0 * (spent_s - first[name][0]) / over_s:.1f} % of a core, "
            f"{first[name][1]:.1f} MB at first, {most[name]:.1f} at most, {memory_mb:.1f} at last\n"
        )
    sys.stdout.write(f"page: {heaps[0]:.1f} MB at first, {max(heaps):.1f} at most\n")
    sys.stdout.write(f"over {over_s / 60.0:.0f} min, after the first {_SETTLED_S / 60.0:.0f}\n")
    runs = page.evaluate("() => fetch('/api/runs').then((a) => a.json()).then((r) => r.length)")
    if not runs:
        sys.exit("no run was started: these figures are of a panel at rest")
    sys.stdout.write(f"{runs} runs, {faults} faults of the machine\n")


def main() -> None:
    """Serve, open, watch, end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--circuits", type=int, default=CIRCUITS, help="circuits of a run")
    parser.add_argument("--machine", default="lathe-winder", help="machine file or library name")
    parser.add_argument("--program", default=PROGRAM.name, help="a program of examples/")
    given = parser.parse_args()
    minutes: float = given.minutes
    if minutes < _SETTLED_S / 60.0 + 2.0:
        parser.error(
            f"--minutes must be {_SETTLED_S / 60.0 + 2.0:g} or more: the first are left out"
        )
    program = chromium()
    if program is None:
        parser.error("there is no chromium to open the page in")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as folder:
        for one in PROGRAM.parent.glob(f"{given.program.partition('.')[0]}.*"):  # with its drawing
            shutil.copy(one, folder)
        if given.program == PROGRAM.name:
            text = PROGRAM.read_text("utf-8")
            assert f" L {CIRCUITS};" in text
            wound = text.replace(f" L {CIRCUITS};", f" L {given.circuits};")
            (Path(folder) / PROGRAM.name).write_text(wound, "utf-8")
        server = subprocess.Popen(
            [sys.executable, "-m", "threadline", "panel", folder, "-m", given.machine,
             "--port", str(port), "--speed", SPEED, "--store", f"{folder}/runs"],
        )  # fmt: skip
        try:
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(
                    executable_path=program,
                    args=["--no-sandbox", "--enable-unsafe-swiftshader"],
                )
                page = browser.new_page(viewport={"width": 1280, "height": 800})
                open_page(page, port, given.program)
                owner = child_of(server.pid)
                pids = {"server": server.pid, "owner": owner, "machine": child_of(owner)}
                pids |= browser_pids(page)
                watch(page, pids, minutes)
                browser.close()
        finally:
            server.send_signal(signal.SIGTERM)
            server.wait()


if __name__ == "__main__":
    main()

"""A browser for the tests of the page."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.panel.bench import proven, simulated_of
from tests.panel.test_panel_killed import Plant
from threadline.live.supervised import interventions
from threadline.machine import load_machine
from threadline.panel import calculation, drawn, stored_runs

if TYPE_CHECKING:
    from playwright.sync_api import Browser

SPEED = 0.5
"""Half of real time: the page has 500 ms to renew a jog, on however busy a computer."""

UNSEEN = (
    "WebUIOmniboxPopup", "WebUIOmniboxAimPopup",
    "AimEnabled", "DestroyProfileOnBrowserClose", "HttpsUpgrades", "LensOverlay", "MediaRouter",
    "NetworkTimeServiceQuerying", "OptimizationHints", "PaintHolding", "PreconnectToSearch",
)  # fmt: skip
"""What a browser is not to begin: two menus of its own, which nobody opens, take as much of the
processor with each window as the page takes to open. And what Playwright tells it by the same word.
"""


@pytest.fixture(autouse=True)
def simulated_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate holds and overrides in this process: starting another takes seconds for each run.

    ``test_run_work`` tests the other process.
    """
    monkeypatch.setattr(stored_runs, "interventions_apart", interventions)


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Allow minutes for processes that read for the panel: a busy computer starts them slowly.

    Tests of the time limits set limits of their own.
    """
    monkeypatch.setattr(drawn, "LONGEST_S", 300.0)
    monkeypatch.setattr(calculation, "PREVIEW_S", 300.0)


@pytest.fixture(scope="module")
def browser(request: pytest.FixtureRequest) -> Iterator[Browser]:
    """A browser, with a view in three dimensions if the module has ``SPACE``.

    Without a graphics card this view takes half of the time of a page.
    """
    from playwright.sync_api import sync_playwright

    from tests.panel.browsing import CHROMIUM

    space = getattr(request.module, "SPACE", False)
    arguments = ["--no-sandbox", f"--disable-features={','.join(UNSEEN)}"]
    arguments += ["--enable-unsafe-swiftshader" if space else "--disable-3d-apis"]
    with sync_playwright() as playwright:
        found = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield found
        found.close()


@pytest.fixture
def plant(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Plant]:
    """A winder, or the machine, the speed and the token that the test names."""
    name, speed, *token = getattr(request, "param", ("lathe-winder", SPEED))
    machine = load_machine(name)
    proven(tmp_path, name)
    simulated_of(machine, lambda _: None)
    found = Plant(tmp_path, tmp_path / "black-box", speed, machine, token="".join(token))
    yield found
    os.kill(found.server, signal.SIGKILL)
    os.waitpid(found.server, 0)
    found.end()

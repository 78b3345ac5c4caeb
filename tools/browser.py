"""The browser in which the panel's page is tried."""

from __future__ import annotations

import shutil

BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser")
"""The first that there is: the one without windows takes three quarters of the others' time."""


def chromium() -> str | None:
    """Return the path of the browser, None where there is none."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)

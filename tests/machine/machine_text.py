"""The text of the winder, with helpers to find and change lines in it."""

from __future__ import annotations

from importlib import resources

LIBRARY = resources.files("threadline.machine") / "library"
WINDER = (LIBRARY / "lathe-winder.toml").read_text(encoding="utf-8")


def line_of(text: str, part: str) -> int:
    """Return the number of the only line of ``text`` that contains ``part``."""
    (found,) = [n for n, line in enumerate(text.splitlines(), start=1) if part in line]
    return found


def edit(old: str, new: str, count: int = 1) -> str:
    assert old in WINDER
    return WINDER.replace(old, new, count)

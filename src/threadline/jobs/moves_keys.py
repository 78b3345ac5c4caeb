"""The words of a move list, and what to say about a wrong one."""

from __future__ import annotations

import difflib

TOP_KEYS = ("name", "operation")
OPERATION_KEYS = {
    "move": ("move",),
    "dwell": ("dwell",),
    "valve": ("valve", "on"),
    "vacuum": ("vacuum", "on"),
    "output": ("output", "on"),
    "wait": ("wait", "is", "timeout"),
}
"""What an operation may say, and the keys that go with it."""
DEFAULT_TIMEOUT_S = 2.0
"""How long an input is waited for unless the list says otherwise."""


def hint(name: str, known: list[str]) -> str:
    """Return a remedy for an unknown word: the nearest right one, or all of them."""
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"Did you mean {close[0]!r}?" if close else f"Known: {', '.join(known) or 'none'}."

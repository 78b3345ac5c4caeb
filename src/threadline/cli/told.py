"""What is told on standard error: warnings after the answer, and a word each minute of a long run.

An error is told alone, in one line: warnings wait until a command has answered, and are dropped if
it does not. Only the standard library is imported here.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field

from threadline.escaping import plain
from threadline.foreign_messages import grouped

STDOUT = "standard output"
"""What an error calls it where a file would have its name."""
_STDERR = 2  # its file descriptor
_EVERY_S = 50.0  # a minute without a word is too long


@dataclass(slots=True)
class Telling:
    """What a command has to tell beside its answer.

    Attributes
    ----------
    warnings
        Held until the answer stands.
    stage
        What the command is doing, as its progress calls it; empty where it does not say.
    shown
        Whether a progress bar shows it.
    """

    warnings: list[str] = field(default_factory=list)
    stage: str = ""
    shown: bool = False


_TELLING: ContextVar[Telling | None] = ContextVar("telling", default=None)


def note(text: str) -> None:
    """Print a line for people on standard error, so that --json stays pure.

    Where nobody reads it, the line is lost and nothing fails.
    """
    try:
        sys.stderr.write(plain(text) + "\n")
        sys.stderr.flush()
    except (OSError, ValueError):
        with suppress(OSError):  # or the interpreter would flush what is left, and complain
            os.dup2(os.open(os.devnull, os.O_WRONLY), _STDERR)


def warning(text: str) -> None:
    """Tell a warning once the command has answered; at once where no command is running."""
    telling = _TELLING.get()
    if telling is None:
        note(f"warning: {text}")
    else:
        telling.warnings.append(text)


def at_work(stage: str, *, shown: bool) -> None:
    """Take down what the command is doing, and whether a bar shows it."""
    telling = _TELLING.get()
    if telling is not None:
        telling.stage, telling.shown = stage, shown


@contextmanager
def telling() -> Iterator[Telling]:
    """Hold the warnings of the block, and tell every minute that it is still at work."""
    held = Telling()
    before = _TELLING.set(held)
    ended = threading.Event()
    threading.Thread(target=_beat, args=(held, ended), daemon=True).start()
    try:
        yield held
    finally:
        ended.set()
        _TELLING.reset(before)


def _beat(held: Telling, ended: threading.Event) -> None:
    began = time.monotonic()
    while not ended.wait(_EVERY_S):
        if not held.shown:
            doing = f": {held.stage}" if held.stage else ""
            note(f"still at work after {time.monotonic() - began:.0f} s{doing}")


def tell_warnings(warnings: Iterable[str]) -> None:
    """Print warnings that have waited; those that say the same of several parts are one line."""
    for line in grouped(warnings):
        note(f"warning: {line}")

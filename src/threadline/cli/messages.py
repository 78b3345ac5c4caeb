"""Messages on standard error: warnings after the answer, a progress line each minute of a long run.

An error is printed alone, in one line: warnings wait until a command has answered, and are dropped
if the command fails. Only the standard library is imported here.
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

from threadline.base.progress import COMPILING, PLANNING, WRITING
from threadline.base.wording import grouped, plain

STDOUT = "standard output"
"""Name of standard output in errors, where a file has its path."""
_STDERR = 2  # its file descriptor
_NEARLY = 99  # percent: from this share done on, the time left is not estimated
_TELLING_FROM = 0.05  # below this share done the time left is not estimated
EVERY_S = 50.0  # a minute without output is too long
LOOK_S = 1.0
PLANNING_STAGE = "planning"
"""Stage whose progress ``PLANNING`` holds."""
"""This stage has no share done, because the duration is unknown until the motion is planned."""
WRITING_STAGE = "writing and reading back"
"""Stage whose progress ``WRITING`` holds."""
STARTING_S = 0.6
_STARTING = "starting ..."
_ERASED = "\r" + " " * len(_STARTING) + "\r"
COMPILING_S = 4.0  # after this time of compiling, a line says why it takes so long
_ONCE = "once on this computer: later runs begin at once"
_EACH_TIME = (
    "as every run does on this computer: no folder to keep it in can be written; name one in "
    "NUMBA_CACHE_DIR"
)


class Starting:
    """A word on a terminal while a command is being loaded, before it can report progress.

    The word has its own line, and is erased before anything else is printed.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._stands = False
        self._may = False

    def begin(self) -> None:
        """Allow the word to be shown, if standard error is a terminal."""
        with self._lock:
            self._may = sys.stderr is not None and sys.stderr.isatty()

    def show(self) -> None:
        """Print the word, if nothing has been printed yet."""
        with self._lock:
            if self._may and not self._stands:
                self._stands = True
                _write(_STARTING)

    def over(self) -> None:
        """Erase the word, and do not print it again."""
        with self._lock:
            if self._stands:
                _write(_ERASED)
            self._may = self._stands = False


STARTING = Starting()


@dataclass(slots=True)
class Telling:
    """Warnings and progress of the running command.

    Attributes
    ----------
    warnings
        Texts to print after the answer.
    stage
        Current activity, as the command's progress call names it; empty if unknown.
    since_s
        Start of the stage, on the monotonic clock.
    fraction
        Share of the stage that is done.
    shown
        Whether a progress bar shows the stage.
    grown
        Each increase of the share that ``look`` found: time on the monotonic clock, and the share.
    """

    warnings: list[str] = field(default_factory=list)
    stage: str = ""
    since_s: float = field(default_factory=time.monotonic)
    fraction: float = 0.0
    shown: bool = False
    grown: list[tuple[float, float]] = field(default_factory=list)

    def look(self) -> None:
        """Record the share done and the time, if the share has grown since the last call."""
        fraction = share_of(self.stage, self.fraction)
        if fraction > max((share for _, share in self.grown[-1:]), default=0.0):
            self.grown.append((time.monotonic(), fraction))

    def doing(self) -> str:
        """Return the stage, its share done, and the time left if it can be estimated."""
        self.look()
        fraction = share_of(self.stage, self.fraction)
        if not self.stage or not fraction:
            return in_full(self.stage)
        percent = int(100.0 * fraction + 1e-9)
        if percent >= _NEARLY:
            return f"{self.stage}, nearly done"
        left_s = self._left_s()
        left = f", about {_lasting(left_s)} more" if left_s > 0.0 else ""
        return f"{self.stage}, {percent} % done{left}"

    def _left_s(self) -> float:
        """Return the time left, s, by the rate in the second half of the time; <= 0 if unknown.

        The first few percent give no estimate, because a stage may begin with its quickest or its
        slowest part. If the share has not grown for longer than the estimated rest, the result is
        negative.
        """
        began_s, now_s = self.since_s, time.monotonic()
        *earlier, (last_s, last_share) = [(began_s, 0.0), *self.grown]
        if last_share < _TELLING_FROM:
            return 0.0
        first_half = [point for point in earlier if point[0] <= 0.5 * (began_s + now_s)]
        since_s, share = first_half[-1] if first_half else earlier[0]
        per_s = (last_share - share) / max(last_s - since_s, 1e-9)
        return (1.0 - last_share) / per_s - (now_s - last_s)


def share_of(stage: str, fraction: float) -> float:
    """Return the share done of a stage: while writing from ``WRITING``, else ``fraction``."""
    return WRITING.share if stage == WRITING_STAGE else fraction


def in_full(stage: str) -> str:
    """Return the text of a stage with unknown share done; for planning, with the motion so far."""
    so_far = PLANNING.words() if stage == PLANNING_STAGE else ""
    return f"{stage}, {so_far}" if so_far else stage


_TELLING: ContextVar[Telling | None] = ContextVar("telling", default=None)


def note(text: str) -> None:
    """Print a line for people on standard error, so that --json output stays pure.

    If standard error is closed, the line is lost and nothing fails.
    """
    STARTING.over()
    _write(plain(text) + "\n")


def _write(text: str) -> None:
    try:
        sys.stderr.write(text)
        sys.stderr.flush()
    except (OSError, ValueError):
        with suppress(OSError):  # otherwise the interpreter flushes the rest at exit, and fails
            os.dup2(os.open(os.devnull, os.O_WRONLY), _STDERR)


def warning(text: str) -> None:
    """Keep a warning until the command has answered; print at once if no command is running."""
    telling = _TELLING.get()
    if telling is None:
        note(f"warning: {text}")
    else:
        telling.warnings.append(text)


def at_work(stage: str, fraction: float = 0.0, *, shown: bool) -> None:
    """Record the stage of the command, the share of it done, and whether a bar shows it."""
    telling = _TELLING.get()
    if telling is None:
        return
    # A stage's text may include changing values (a duration, a limit); a new stage starts at 0.
    if stage != telling.stage and fraction <= telling.fraction:
        telling.since_s = time.monotonic()
        telling.grown.clear()
    telling.stage, telling.fraction, telling.shown = stage, fraction, shown
    telling.look()


def _lasting(seconds: float) -> str:
    for unit, size_s in (("days", 86_400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2.0 * size_s:
            return f"{_two_digits(seconds / size_s)} {unit}"
    return f"{_two_digits(seconds)} s"


def _two_digits(value: float) -> str:
    return f"{value:.0f}" if value >= 9.95 else f"{value:.2g}"


@contextmanager
def telling(*, starting: bool = False) -> Iterator[Telling]:
    """Collect the warnings of the block; print a line every minute while the command runs.

    If machine code is compiled for longer than ``COMPILING_S``, one line says so. With
    ``starting``, a terminal shows within a second that the command is being loaded.
    """
    collected = Telling()
    token = _TELLING.set(collected)
    ended = threading.Event()
    word = threading.Timer(STARTING_S, STARTING.show)
    if starting:
        STARTING.begin()
        word.daemon = True
        word.start()
    beat = threading.Thread(target=_beat, args=(collected, ended), daemon=True)
    beat.start()
    try:
        yield collected
    finally:
        word.cancel()
        STARTING.over()
        ended.set()
        beat.join()  # otherwise its unfinished line would appear after or within the error
        _TELLING.reset(token)


ASKING = threading.Event()
"""Set while a question waits for the answer of a person at the keyboard."""


def _beat(collected: Telling, ended: threading.Event) -> None:
    began_s = last_s = time.monotonic()
    compiled_s: float | None = COMPILING.lasted_s()
    while not ended.wait(min(LOOK_S, EVERY_S)):
        collected.look()
        if compiled_s is not None and COMPILING.lasted_s() - compiled_s > COMPILING_S:
            compiled_s = None
            note(f"compiling machine code, {_ONCE if COMPILING.cached else _EACH_TIME}")
        if ASKING.is_set():
            began_s = last_s = time.monotonic()
        if time.monotonic() - last_s < EVERY_S:
            continue
        last_s = time.monotonic()
        if not collected.shown:
            doing = collected.doing()
            note(f"still at work after {last_s - began_s:.0f} s{doing and ': '}{doing}")


def tell_warnings(warnings: Iterable[str]) -> None:
    """Print collected warnings; equal warnings about several parts become one line."""
    for line in grouped(warnings):
        note(f"warning: {line}")

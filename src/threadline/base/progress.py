"""Progress of planning, of compiling to machine code, and of any other long calculation.

A progress bar reads these values. Only the standard library is imported, because an import of numba
takes a second.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

_COMPILED_FOR = {
    "threadline.commands": "planning",
    "threadline.dynamics": "simulating",
    "threadline.geometry": "planning",
    "threadline.jobs": "planning",
    "threadline.motion": "planning",
    "threadline.twin": "simulating",
    "threadline.verdict": "judging",
    "threadline.winding": "planning",
}
"""Package -> what its compiled functions are for."""
USUAL_FUNCTIONS = 90
"""Usual largest number of functions that a first proof on a computer compiles.

Counted: 12 for a frame, 25 for a placer, 55 to 68 for winders, 73 to 83 for a stitcher.
"""
_PAUSE_S = 0.5


@dataclass(slots=True)
class Compiling:
    """Time spent on compiling; nested compilations count once.

    Attributes
    ----------
    done_s
        Time of finished compilations, s.
    depth
        Number of nested compilations in progress.
    began_s
        Start of the outermost compilation in progress, on the monotonic clock, s.
    cached
        Whether the machine code is kept on disk; False if no folder for it can be written.
    functions
        Number of functions of this program whose compilation has begun; numba's own, which these
        call, do not count.
    part
        What the last of these functions is for: planning, simulating or judging; empty if for
        something else.
    ended_s
        End of the last outermost compilation, on the monotonic clock, s.
    """

    done_s: float = 0.0
    depth: int = 0
    began_s: float = 0.0
    cached: bool = True
    functions: int = 0
    part: str = ""
    ended_s: float = -math.inf

    def begin(self, module: str = "numba.") -> None:
        """Note the start of the compilation of a function of a module, given by its full name."""
        if self.depth == 0:
            self.began_s = time.monotonic()
        self.depth += 1
        if not module.startswith("numba."):
            self.functions += 1
            self.part = _COMPILED_FOR.get(".".join(module.split(".")[:2]), "")

    def end(self) -> None:
        """Note the end of a compilation."""
        self.depth -= 1
        if self.depth == 0:
            self.ended_s = time.monotonic()
            self.done_s += self.ended_s - self.began_s

    def busy(self) -> bool:
        """Return whether a function is being compiled, or was less than ``_PAUSE_S`` ago.

        A function runs for a moment before it calls for the next one to be compiled.
        """
        return self.depth > 0 or time.monotonic() - self.ended_s < _PAUSE_S

    def words(self) -> str:
        """Return how far the compilation is, in words.

        >>> Compiling(done_s=12.3, functions=34, part="judging").words()
        'compiling machine code for judging: 34 functions (usually at most 90), 12 s'
        """
        part = f" for {self.part}" if self.part else ""
        plural = "" if self.functions == 1 else "s"
        return (
            f"compiling machine code{part}: {self.functions} function{plural} "
            f"(usually at most {USUAL_FUNCTIONS}), {self.lasted_s():.0f} s"
        )

    def lasted_s(self) -> float:
        """Return the time spent so far, s."""
        return self.done_s + (time.monotonic() - self.began_s if self.depth else 0.0)


COMPILING = Compiling()
"""Compilations of this process."""


@dataclass(slots=True)
class PlanningSoFar:
    """Progress of the motion that is being planned.

    Attributes
    ----------
    motion_s
        Duration of the motion planned so far, s; 0 while unknown.
    round_, rounds
        Number of timing passes done over the motion, and largest number of passes; 0 if a single
        pass plans the motion piece by piece.
    """

    motion_s: float = 0.0
    round_: int = 0
    rounds: int = 0

    def reach(self, motion_s: float, round_: int = 0, rounds: int = 0) -> None:
        """Set the progress."""
        self.motion_s, self.round_, self.rounds = motion_s, round_, rounds

    def words(self) -> str:
        """Return the progress in words; empty while unknown.

        >>> PlanningSoFar(3585.7).words(), PlanningSoFar(3585.7, 2, 16).words()
        ('3586 s of motion so far', 'motion of 3586 s, time 2 of at most 16')
        """
        if not self.motion_s:
            return ""
        if self.rounds:
            return f"motion of {self.motion_s:.4g} s, time {self.round_} of at most {self.rounds}"
        return f"{self.motion_s:.4g} s of motion so far"


PLANNING = PlanningSoFar()
"""Planning of this process."""


@dataclass(slots=True)
class WritingSoFar:
    """Progress of the file that is being written and read back.

    Attributes
    ----------
    share
        Share done, 0 to 1; it never falls until ``begin``.
    low, high
        Share at the start and at the end of the present pass over the motion.
    """

    share: float = 0.0
    low: float = 0.0
    high: float = 0.0

    def begin(self) -> None:
        """Start again at 0 for a new file."""
        self.share = self.low = self.high = 0.0

    def pass_to(self, high: float) -> None:
        """Start a pass over the motion; at the end of the pass the share ``high`` is done."""
        self.low, self.high = max(self.share, self.low), max(high, self.high)
        self.share = self.low

    def reach(self, motion_s: float, whole_s: float) -> None:
        """Set how far the present pass has come in the motion: to ``motion_s`` of ``whole_s``, s.

        >>> written = WritingSoFar()
        >>> written.pass_to(0.5)
        >>> written.reach(30.0, 60.0)
        >>> written.share
        0.25
        """
        pass_share = min(motion_s / whole_s, 1.0) if whole_s > 0.0 else 1.0
        self.share = max(self.share, self.low + (self.high - self.low) * pass_share)


WRITING = WritingSoFar()
"""Writing of this process."""


_UNDER_WAY = 0.98
"""Largest reported share of an unfinished search, even if it takes longer than expected."""
Progress = Callable[[str, float], None]
"""Called with the name of the work and the share done, 0 to 1."""


class TrialShares:
    """Share done of a search by trials: it never falls, and it is 1 only at the end of the search.

    When a search learns how many trials are left, the remaining share is spread over them. A wrong
    first guess, or a later one, therefore neither lowers the share nor stops its growth.

    Parameters
    ----------
    progress
        Receives the work and the share done; None reports nothing.
    work
        The work, in words.
    left
        Expected number of trials.

    Examples
    --------
    >>> parts = []
    >>> trials = TrialShares(lambda work, share: parts.append(round(share, 2)), "searching", left=2)
    >>> trials.within(0.5)
    >>> trials.done()
    >>> trials.expects(4)
    >>> trials.done()
    >>> parts
    [0.24, 0.49, 0.61]
    """

    def __init__(self, progress: Progress | None, work: str, left: float) -> None:
        self._progress, self._work = progress, work
        self._share = self._from = 0.0
        self._done, self._left = 0, left

    def expects(self, left: float) -> None:
        """Set the number of trials that are left."""
        self._from, self._done, self._left = self._share, 0, left

    def within(self, share: float) -> None:
        """Report the share done of the present trial."""
        of_rest = min((self._done + share) / max(self._left, 1e-9), 1.0)
        self._share = max(self._share, self._from + (_UNDER_WAY - self._from) * of_rest)
        if self._progress is not None:
            self._progress(self._work, self._share)

    def done(self) -> None:
        """Report the end of a trial."""
        self._done += 1
        self.within(0.0)


def part_of(progress: Progress | None, begun: float, part: float) -> Progress | None:
    """Return a callback for a part of a work, which begins when the share ``begun`` is done."""
    return None if progress is None else lambda work, share: progress(work, begun + part * share)


def never_back(progress: Progress | None) -> Progress | None:
    """Return a callback that reports the largest share so far; None for None.

    Searches that follow each other know only their own number of trials, and each begins at 0.

    >>> shares = []
    >>> forwards = never_back(lambda work, share: shares.append(share))
    >>> for share in (0.1, 0.4, 0.0, 0.5):
    ...     forwards("proving", share)
    >>> shares
    [0.1, 0.4, 0.4, 0.5]
    """
    if progress is None:
        return None
    largest = 0.0

    def forwards(work: str, share: float) -> None:
        nonlocal largest
        largest = max(largest, share)
        progress(work, largest)

    return forwards

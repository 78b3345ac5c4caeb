"""How far a long calculation is: of planning, of compiling to machine code, and of any other work.

What is compiled is kept on disk (``compiled``), so that later runs do not wait. Whoever talks to
people reads it here. Only the standard library is imported: numba takes a second.

Whoever talks to people reads it here. Only the standard library is imported.

Whoever draws a bar of it needs no more than this name.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(slots=True)
class Compiling:
    """Time spent on compiling, one function inside another counted once.

    Attributes
    ----------
    done_s
        Of what is compiled.
    depth
        Functions that are being compiled now.
    began_s
        Start of the outermost of them, on the monotonic clock.
    """

    done_s: float = 0.0
    depth: int = 0
    began_s: float = 0.0

    def begin(self) -> None:
        """Note that a function is being compiled from now on."""
        if self.depth == 0:
            self.began_s = time.monotonic()
        self.depth += 1

    def end(self) -> None:
        """Note that it is compiled."""
        self.depth -= 1
        if self.depth == 0:
            self.done_s += time.monotonic() - self.began_s

    def lasted_s(self) -> float:
        """Return the time spent until now."""
        return self.done_s + (time.monotonic() - self.began_s if self.depth else 0.0)


COMPILING = Compiling()
"""Of this process."""


@dataclass(slots=True)
class PlanningSoFar:
    """What is planned of the motion under way.

    Attributes
    ----------
    motion_s
        How much of the motion is planned, s; 0 where nothing is known of it.
    round_, rounds
        How often a motion of that length was timed, and how often it will be at most; 0 where it
        is planned once, piece after piece.
    """

    motion_s: float = 0.0
    round_: int = 0
    rounds: int = 0

    def reach(self, motion_s: float, round_: int = 0, rounds: int = 0) -> None:
        """Note what is planned now."""
        self.motion_s, self.round_, self.rounds = motion_s, round_, rounds

    def words(self) -> str:
        """Return it for people; empty where nothing is known.

        >>> PlanningSoFar(3585.7).words(), PlanningSoFar(3585.7, 2, 16).words()
        ('3586 s of motion so far', 'motion of 3586 s, time 2 of at most 16')
        """
        if not self.motion_s:
            return ""
        if self.rounds:
            return f"motion of {self.motion_s:.4g} s, time {self.round_} of at most {self.rounds}"
        return f"{self.motion_s:.4g} s of motion so far"


PLANNING = PlanningSoFar()
"""Of this process."""


Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction that is done."""

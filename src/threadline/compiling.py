"""For how long this process has compiled machine code: the first run on a computer waits for it.

What is compiled is kept on disk (``compiled``), so that later runs do not wait. Whoever talks to
people reads it here. Only the standard library is imported: numba takes a second.
"""

from __future__ import annotations

import time
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

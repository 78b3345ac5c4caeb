"""What an inverse makes of a motion, tick by tick."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Told:
    """What an inverse makes of the motion of one axis at consecutive ticks of its controller.

    Parameters
    ----------
    references_si
        (k,) what the controller is told, m or rad.
    levels
        (k,) what it puts out, V, before its DAC loses any of it.
    counts
        (k,) what its sensor reads.
    """

    references_si: FloatArray
    levels: FloatArray
    counts: FloatArray

    def __len__(self) -> int:
        return len(self.levels)

    @classmethod
    def none(cls) -> Told:
        """Return what is told at no ticks."""
        return cls(references_si=np.zeros(0), levels=np.zeros(0), counts=np.zeros(0))

    def joined(self, other: Told) -> Told:
        """Return this and the ticks behind it."""
        return Told(
            references_si=np.concatenate([self.references_si, other.references_si]),
            levels=np.concatenate([self.levels, other.levels]),
            counts=np.concatenate([self.counts, other.counts]),
        )

    def part(self, first: int, stop: int) -> Told:
        """Return the ticks from one to before another."""
        some = slice(first, stop)
        return Told(
            references_si=self.references_si[some],
            levels=self.levels[some],
            counts=self.counts[some],
        )

    def held(self, more: int) -> Told:
        """Return the same with ``more`` ticks at rest behind it."""
        return Told(
            references_si=np.pad(self.references_si, (0, more), mode="edge"),
            levels=np.pad(self.levels, (0, more)),
            counts=np.pad(self.counts, (0, more), mode="edge"),
        )

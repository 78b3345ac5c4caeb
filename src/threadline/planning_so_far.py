"""How far the planning of this process has come: that of a very slow motion takes minutes.

Whoever talks to people reads it here. Only the standard library is imported.
"""

from __future__ import annotations

from dataclasses import dataclass


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

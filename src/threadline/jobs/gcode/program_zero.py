"""The programmed zero and the home position of a part program: G92 to G92.3 and G28.1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

_HOME, _SHIFT, _SUSPEND, _RESTORE = 281, 920, 922, 923


class Zeros:
    """Positions on the machine for a number of ``axes``, as exact 10**-18 mm or degrees.

    Attributes
    ----------
    offset
        Position of the programmed zero.
    home
        Position to which G28 moves.
    """

    def __init__(self, axes: int) -> None:
        self.offset = [0] * axes
        self.home = [0] * axes
        self._kept = [0] * axes  # while G92.2 has set the offset aside

    def take(self, code: int, at: Sequence[int], given: Mapping[int, int]) -> None:
        """Apply a G word, given as ten times its number, at the position ``at``.

        Parameters
        ----------
        given
            Programmed positions that G92 gives the present position, by the index of the axis.
        """
        if code == _HOME:
            self.home = list(at)
        elif code == _SHIFT:
            self.offset = [
                at[index] - given[index] if index in given else offset
                for index, offset in enumerate(self.offset)
            ]
        elif code == _RESTORE:
            self.offset = list(self._kept)
        else:
            self._kept = self.offset if code == _SUSPEND else [0] * len(self.offset)
            self.offset = [0] * len(self.offset)

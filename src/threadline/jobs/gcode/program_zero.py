"""Where the programmed zero and the home of a part program are: G92 to G92.3 and G28.1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

_HOME, _SHIFT, _SUSPEND, _RESTORE = 281, 920, 922, 923


class Zeros:
    """Exact positions of ``axes`` axes on the machine: 10**-18 mm or degrees.

    Attributes
    ----------
    offset
        Where the programmed zero is.
    home
        Where G28 goes.
    """

    def __init__(self, axes: int) -> None:
        self.offset = [0] * axes
        self.home = [0] * axes
        self._kept = [0] * axes  # while G92.2 has set the offset aside

    def take(self, code: int, at: Sequence[int], given: Mapping[int, int]) -> None:
        """Do what ten times a G word says, at the position ``at``.

        Parameters
        ----------
        given
            What G92 calls the position from now on, by the index of the axis.
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

"""The programmed zero and the home position: G92 to G92.3, G54 to G59, and G28.1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from threadline.jobs.gcode.work_offsets import MACHINE

_HOME, _SHIFT, _SUSPEND, _RESTORE = 281, 920, 922, 923


class Zeros:
    """Positions on the machine for a number of ``axes``, as exact 10**-18 mm or degrees.

    Attributes
    ----------
    offset
        Position of the programmed zero.
    home
        Position to which G28 moves.
    machine
        Zero of the machine's own system.
    kept
        What G92 has shifted, for G92.3, while G92.2 has set it aside, too.

    Parameters
    ----------
    systems
        Zero of each work coordinate system, by ten times its G word, and of the machine; none where
        a program uses one system alone.
    """

    def __init__(self, axes: int, systems: Mapping[int, tuple[int, ...]]) -> None:
        self.offset = [0] * axes
        self.machine = systems.get(MACHINE, (0,) * axes)
        self._systems = systems
        self._system = (0,) * axes
        self.home = [0] * axes
        self.kept = [0] * axes

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
            self.kept = _moved(self.offset, self._system, -1)
        elif code == _RESTORE:
            self.offset = _moved(self.kept, self._system, 1)
        else:
            if code != _SUSPEND:
                self.kept = [0] * len(self.offset)
            self.offset = list(self._system)

    def choose(self, code: int) -> None:
        """Go over to a work coordinate system, ten times its G word; what G92 shifted stays."""
        system = self._systems.get(code, self._system)
        self.offset = _moved(_moved(self.offset, self._system, -1), system, 1)
        self._system = system


def _moved(values: Sequence[int], by: Sequence[int], times: int) -> list[int]:
    return [value + times * way for value, way in zip(values, by, strict=True)]

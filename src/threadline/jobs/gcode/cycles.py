"""Drilling cycles of part programs (G73, G81 to G83, G85, G89): the moves of each hole.

Source: LinuxCNC 2.9, G codes (canned cycles) and ``interp_cycles.cc``. A cycle goes to the place
of a hole at the height R or above it, then down to R, and from there to the bottom. After G99 it
ends at R; after G98 it ends at the height where the series of cycles began, or at R if R is higher.
LinuxCNC starts with G99.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal, NamedTuple

from threadline.errors import JobError, Place
from threadline.jobs.gcode.block import DRILLING, Block
from threadline.jobs.gcode.words import ONE

MOST_STEPS = 100_000
"""Most moves and dwells of one block."""
_PECKS, _DWELLS = frozenset({73, 83}), frozenset({82, 89})
_BACK_OFF = 254 * ONE // 1000
"""How far a peck stops above the last depth: 0.254 mm in LinuxCNC 2.9 as Debian has it."""
_LETTERS = {170: ("XY", "Z"), 180: ("ZX", "Y"), 190: ("YZ", "X")}
"""Letters of each plane, and of the direction of its holes."""

Kind = Literal["rapid", "feed", "dwell"]


class Step(NamedTuple):
    """A part of a cycle: a move of the named axes, or a dwell.

    Parameters
    ----------
    kind
        Move at the rapid, move at the feed, or dwell.
    to
        Exact place of each axis that moves, by its index.
    dwell_s
        Time of a dwell, in s.
    """

    kind: Kind
    to: tuple[tuple[int, int], ...] = ()
    dwell_s: float = 0.0


class Frame(NamedTuple):
    """The modes of a block and the position before it.

    Parameters
    ----------
    exact
        (axes,) exact position.
    offset
        (axes,) exact zero of the program.
    axes
        Index of each axis, by its letter in the program.
    plane
        Ten times the number of G17, G18 or G19.
    relative
        Whether G91 is in force.
    tenth_mm
        Unit of length in tenths of a millimetre.
    at
        Place of the block, for errors.
    """

    exact: tuple[int, ...]
    offset: tuple[int, ...]
    axes: Mapping[str, int]
    plane: int
    relative: bool
    tenth_mm: int
    at: Place


class Cycles:
    """The words that a series of drilling cycles keeps from block to block."""

    def __init__(self) -> None:
        self._to_r = True  # G99, in which LinuxCNC starts
        self._begun: int | None = None  # height at which the series began
        self._motion = -1  # the last cycle of the series
        self._modes = (0, 0)  # plane and unit of the series
        self._last_words: dict[str, int] = {}  # last depth, R, Q and P

    def take(self, settings: tuple[int, ...], motion: int) -> None:
        """Take the G98, G99 and the motion of a block; another motion ends the series."""
        for code in settings:
            if code in (980, 990):
                self._to_r = code == 990
        if motion != -1 and motion not in DRILLING:
            self._begun, self._motion = None, -1

    def steps(self, motion: int, block: Block, frame: Frame) -> Iterator[Step]:
        """Return the moves and dwells of a block in the cycle ``motion``.

        Raises
        ------
        JobError
            If the machine has no axis in the direction of the holes; if a word is missing, belongs
            to another axis, has no use in the cycle, or is a P below 0 or a Q not above 0; if R is
            below the bottom; if the plane or the unit changed within the series; or if the block
            has more than ``MOST_STEPS`` moves.
        """
        across_letters, depth_letter = _LETTERS[frame.plane]
        if depth_letter not in frame.axes:
            raise _error(
                frame, f"G{motion} drills along {depth_letter}, and the machine has no such axis"
            )
        modes = (frame.plane, frame.tenth_mm)
        if self._begun is not None and modes != self._modes:
            raise _error(
                frame,
                f"G{motion} behind a change of plane or unit within a series of cycles, whose kept "
                "words mean something else now: end the series with G80 before the change",
            )
        self._modes = modes
        depth_axis = frame.axes[depth_letter]
        words = self._words(motion, block, frame, depth_letter)
        given = {i: value * frame.tenth_mm // 10 for i, value in block.axes}
        start_height = frame.exact[depth_axis] if self._begun is None else self._begun
        if frame.relative:
            r = start_height + words["R"]
            bottom = r + words[depth_letter]
        else:
            r, bottom = (frame.offset[depth_axis] + words[word] for word in ("R", depth_letter))
        if r < bottom:
            raise _error(
                frame, f"R of G{motion} lies {(bottom - r) / ONE:.6g} mm deeper than {depth_letter}"
            )
        self._begun, self._motion = start_height, motion
        self._last_words.update(words)
        across_axes = [frame.axes[letter] for letter in across_letters if letter in frame.axes]
        hole = {
            i: frame.exact[i] if frame.relative or i not in given else frame.offset[i] + given[i]
            for i in across_axes
        }
        spacing = {i: given.get(i, 0) if frame.relative else 0 for i in across_axes}
        peck_count = (r - bottom) // words["Q"] if motion in _PECKS else 0
        repeats = block.passes or 1
        if repeats * (3 * peck_count + 5) > MOST_STEPS:
            raise _error(frame, f"G{motion} makes more than {MOST_STEPS} moves in one block")
        height = frame.exact[depth_axis]
        if start_height < r:
            yield Step("rapid", ((depth_axis, r),))
            start_height = height = r
        end_height = r if self._to_r else start_height
        height = height if height > r else end_height
        for _ in range(repeats):
            hole = {i: position + spacing[i] for i, position in hole.items()}
            yield Step("rapid", (*hole.items(), (depth_axis, height)))
            if height > r:
                yield Step("rapid", ((depth_axis, r),))
            yield from _hole(motion, depth_axis, (r, bottom, end_height), words)
            height = end_height

    def _words(self, motion: int, block: Block, frame: Frame, depth_letter: str) -> dict[str, int]:
        """Return the exact depth, R, and Q or P; a missing word is taken from an earlier block."""
        letter_of_axis = {index: letter for letter, index in frame.axes.items()}
        words: dict[str, int] = {}
        for index, value in block.axes:
            if letter_of_axis[index] not in "XYZ":
                raise _error(frame, f"{letter_of_axis[index]} has no use in G{motion}")
            if letter_of_axis[index] == depth_letter:
                words[depth_letter] = value * frame.tenth_mm // 10
        for letter, value in block.curve:
            if letter != "R" and (letter != "Q" or motion not in _PECKS):
                raise _error(frame, f"{letter} has no use in G{motion}")
            words[letter] = value * frame.tenth_mm // 10
        if block.p is not None:
            if motion not in _DWELLS:
                raise _error(frame, f"P has no use in G{motion}")
            words["P"] = block.p
        needed = (depth_letter, "R", *("Q" * (motion in _PECKS)), *("P" * (motion in _DWELLS)))
        for letter in needed:
            if letter in words:
                continue
            if self._motion != motion or letter not in self._last_words:
                raise _error(frame, f"G{motion} has no {letter}")
            words[letter] = self._last_words[letter]
        if "P" in needed and words["P"] < 0:
            raise _error(frame, f"P of G{motion} must not be negative")
        if "Q" in needed and words["Q"] <= 0:
            raise _error(frame, f"Q of G{motion} must be greater than 0")
        return words


def _hole(
    motion: int, depth_axis: int, heights: tuple[int, int, int], words: Mapping[str, int]
) -> Iterator[Step]:
    """Return the steps of one hole, from the height R; ``heights`` are R, bottom and end."""
    r, bottom, end_height = heights
    if motion in _PECKS:
        peck_bottom = r - words["Q"]
        while peck_bottom > bottom:
            yield Step("feed", ((depth_axis, peck_bottom),))
            if motion == 83:
                yield Step("rapid", ((depth_axis, r),))
            yield Step("rapid", ((depth_axis, peck_bottom + _BACK_OFF),))
            peck_bottom -= words["Q"]
    yield Step("feed", ((depth_axis, bottom),))
    if motion in _DWELLS:
        yield Step("dwell", dwell_s=words["P"] / ONE)
    if motion == 85:
        yield Step("feed", ((depth_axis, r),))
    yield Step("feed" if motion == 89 else "rapid", ((depth_axis, end_height),))


def _error(frame: Frame, message: str) -> JobError:
    return JobError(
        message,
        place=frame.at,
        remedy="Write a cycle as G81 X10 Y20 Z-5 R2, with Q for the pecks of G73 and G83, and P "
        "for the dwell of G82 and G89 (seconds).",
    )

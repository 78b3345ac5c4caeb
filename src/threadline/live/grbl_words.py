"""What grbl is told and what it answers: lines, status reports, and its counted buffer.

Sources: "Grbl v1.1 Interface", "Grbl v1.1 Commands" and "Grbl v1.1 Jogging" in the documentation of
gnea/grbl.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import LinkFaultError, PlanError

STATUS, HOLD, RESUME, RESET, JOG_CANCEL = b"?", b"!", b"~", b"\x18", b"\x85"
"""Bytes that grbl acts on at once, wherever they come; they take no room in its buffer."""
RX_BYTES = 128
"""Characters that grbl's receive buffer holds, unless it tells of fewer (``$I``)."""
_STANDS = frozenset({"Idle", "Alarm", "Sleep", "Check"})
_STANDING = {"Hold": (-1, 0), "Door": (-1, 0, 1)}
"""Numbers behind states that say that the machine stands; -1 is none."""
PAUSES = frozenset({"Hold", "Door"})
"""States that a run is in for a while, and goes on from."""
_TOLD = {
    "Hold": "by its own hold button, or by M0",
    "Door": "its safety door is closed again, and it waits to be told to go on",
    "Door:1": "its safety door is open, and has to be closed before it can go on",
    "Door:2": "its safety door was opened, and it brakes",
    "Door:3": "its safety door is closed, and it goes on",
    "Sleep": "its motors are off, so that it has to be reset and homed",
    "Check": "it reads lines and moves by none, until $C ends that",
    "Home": "it homes, and was not told to here",
    "Jog": "it is moved by hand, and was not told to here",
    "Run": "it moves, and was not told to here",
}
_REALTIME = re.compile(rb"[?!~\x00-\x1f\x7f-\xff]")
_REPORT = re.compile(r"<([A-Za-z]+)(?::(\d{1,4}))?\|(.*)>")
_SETTING = re.compile(r"\$(\d{1,5})=([^\s(]*).*")
_WORD = re.compile(r"([A-Z])(-?\d+\.?\d*|-?\.\d+)")


@dataclass(frozen=True, slots=True, eq=False)
class Status:
    """A status report.

    Parameters
    ----------
    state
        ``Idle``, ``Run``, ``Hold``, ``Alarm`` and so on.
    detail
        Number behind the state: ``Hold:0`` stands, ``Hold:1`` still brakes. -1 without one.
    position
        (letters,) machine position, mm or degrees; None where the report has none.
    offset
        (letters,) work coordinate offset; None where the report has none.
    """

    state: str
    detail: int
    position: FloatArray | None
    offset: FloatArray | None

    @property
    def stands(self) -> bool:
        """Whether nothing moves, and nothing will before it is told to."""
        return self.state in _STANDS or self.detail in _STANDING.get(self.state, ())

    @property
    def told(self) -> str:
        """The state in words, for people."""
        means = _TOLD.get(f"{self.state}:{self.detail}", _TOLD.get(self.state, ""))
        return f"the controller tells {self.state}{f': {means}' if means else ''}"


def status_of(line: str) -> Status | None:
    """Return the status report in a line; None where it is none.

    Raises
    ------
    LinkFaultError
        If numbers of a report are none.
    """
    form = _REPORT.fullmatch(line)
    if form is None:
        return None
    state, detail, rest = form.groups()
    fields = dict(part.partition(":")[::2] for part in rest.split("|"))
    place, offset = (numbers(fields[name]) if name in fields else None for name in ("MPos", "WCO"))
    return Status(state, -1 if detail is None else int(detail), place, offset)


def numbers(text: str) -> FloatArray:
    """Return the numbers between commas; a LinkFaultError where one is none."""
    try:
        found = np.array([float(part) for part in text.split(",")])
    except ValueError:
        found = np.array([np.nan])
    if not np.isfinite(found).all():
        raise LinkFaultError(f"the controller sent {text[:40]!r} where numbers were due")
    return found


class CharacterCount:
    """Counts the characters that grbl may still hold: a line leaves when it is answered."""

    def __init__(self, room: int = RX_BYTES) -> None:
        self._room = room
        self._lengths: deque[int] = deque()

    @property
    def open(self) -> int:
        """Number of lines that were not answered."""
        return len(self._lengths)

    def fits(self, line: bytes) -> bool:
        """Return whether there is room for a line."""
        return sum(self._lengths) + len(line) <= self._room

    def sent(self, line: bytes) -> None:
        """Count a line that was sent."""
        self._lengths.append(len(line))

    def answered(self) -> None:
        """Take the oldest line off; a LinkFaultError where none was sent."""
        if not self._lengths:
            raise LinkFaultError("the controller answered a line that was not sent")
        self._lengths.popleft()


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """A part program as grbl is sent it.

    Parameters
    ----------
    lines
        Each with its line feed.
    ends
        (n, axes) where each line ends, m or rad.
    durations_s
        (n,) how long each takes at its feed alone.
    rows, operations
        (n,) tick of the plan at which each begins, and the operation of the job that is under way
        then; all 0 where that is not known.
    """

    lines: tuple[bytes, ...]
    ends: FloatArray
    durations_s: FloatArray
    rows: IntArray
    operations: IntArray


def program_of(text: bytes, axes: Sequence[str], scale: FloatArray, start: FloatArray) -> Program:
    """Return the program in a text of straight moves in absolute millimetres and degrees.

    Parameters
    ----------
    axes
        Their letters.
    scale
        (axes,) m or rad of a unit of the program.
    start
        (axes,) where it begins, m or rad.

    Raises
    ------
    PlanError
        If a line holds a byte that grbl acts on at once, a command of its own (``$``), or is longer
        than its buffer.
    """
    lines, ends, durations = [], [], []
    at, feed = start.copy(), 0.0
    for number, line in enumerate(text.splitlines(), start=1):
        refuse_realtime(line, number)
        words = _WORD.findall(line.decode("ascii"))
        then = at.copy()
        for letter, value in words:
            if letter == "F":
                feed = float(value)
            elif letter in axes:
                k = axes.index(letter)
                then[k] = float(value) * scale[k]
        way = float(np.linalg.norm((then - at) / scale))
        dwell = sum(float(v) for w, v in words if w == "P")
        durations.append((60.0 * way / feed if feed else 0.0) + dwell)
        lines.append(line + b"\n")
        ends.append(then)
        at = then
    none = np.zeros(len(lines), dtype=np.int64)
    return Program(
        tuple(lines), np.array(ends).reshape(-1, len(axes)), np.array(durations), none, none
    )


def refuse_realtime(line: bytes, number: int) -> None:
    """Refuse a line that grbl would not take as one of a program.

    Raises
    ------
    PlanError
        With the number of the line.
    """
    if _REALTIME.search(line) or line.lstrip().startswith(b"$") or len(line) >= RX_BYTES:
        raise PlanError(
            f"line {number} of the program, {line[:40]!r}, holds what grbl would act on at once, "
            "or is longer than its buffer",
            remedy="Nothing but lines of a part program is sent to a controller.",
        )


def runs_out(program: Program, blocks: int, most: int = RX_BYTES) -> tuple[float, float]:
    """Return how long and how far grbl goes on by itself at most when nothing more is sent.

    It has then the line under way, as many blocks as its planner holds, and the lines in its
    receive buffer. Times are those of the feeds, without ramps.

    Parameters
    ----------
    blocks, most
        Blocks of its planner, and characters of its receive buffer.

    Returns
    -------
    tuple
        s; and path in m, rotary axes left out as they are: in rad.
    """
    ways = np.linalg.norm(np.diff(program.ends, axis=0, prepend=program.ends[:1]), axis=1)
    longest_s = longest = 0.0
    for first in range(len(program.lines)):
        end, room = first + blocks + 1, most
        while end < len(program.lines) and room >= len(program.lines[end]):
            room -= len(program.lines[end])
            end += 1
        longest_s = max(longest_s, float(program.durations_s[first:end].sum()))
        longest = max(longest, float(ways[first:end].sum()))
    return longest_s, longest


def settings_of(lines: Iterable[str]) -> dict[int, float]:
    """Return the settings that ``$$`` has listed, by their numbers; NaN for one that is no number.

    Some controllers list texts among them, such as the address of their network.
    """
    found = {}
    for line in lines:
        form = _SETTING.fullmatch(line)
        if form is not None:
            try:
                found[int(form.group(1))] = float(form.group(2))
            except ValueError:
                found[int(form.group(1))] = np.nan
    return found

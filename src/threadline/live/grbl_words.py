"""Commands to grbl and its answers, over a serial line or TCP.

Sources: "Grbl v1.1 Interface", "Grbl v1.1 Commands" and "Grbl v1.1 Jogging" in the documentation of
gnea/grbl.
"""

from __future__ import annotations

import re
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import LinkFaultError, PlanError

STATUS, HOLD, RESUME, RESET, JOG_CANCEL = b"?", b"!", b"~", b"\x18", b"\x85"
"""Bytes that grbl executes at once, wherever they stand; they take no room in its buffer."""
RX_BYTES = 128
"""Characters that grbl's receive buffer holds, unless it reports fewer (``$I``)."""
AS_IS = 100.0
"""Override that leaves a feed unchanged, %; grbl returns to it at each reset."""
_OVERRIDES_S = 5.0  # timeout of an override: nine coarse and nine fine steps, a report after each
_FEED_AS_IS = b"\x90"
_COARSE = 10  # %; a fine step is 1 %
_COARSER, _FINER = (b"\x92", b"\x91"), (b"\x94", b"\x93")  # down, up
_STANDS = frozenset({"Idle", "Alarm", "Sleep", "Check"})
_STANDING = {"Hold": (-1, 0), "Door": (-1, 0, 1)}
"""Numbers after ``Hold`` and ``Door`` with which the machine stands still; -1: no number."""
PAUSES = frozenset({"Hold", "Door"})
"""States in which a run pauses and from which it can resume."""
_MEANINGS = {
    "Hold": "by its own hold button, or by M0",
    "Door": "its safety door is closed again, and it waits to be resumed",
    "Door:1": "its safety door is open, and has to be closed before it can resume",
    "Door:2": "its safety door was opened, and it brakes",
    "Door:3": "its safety door is closed, and it resumes",
    "Sleep": "its motors are off, so that it has to be reset and homed",
    "Check": "it reads lines without moving, until $C ends that",
    "Home": "it homes, without a command from here",
    "Jog": "it is moved by hand, without a command from here",
    "Run": "it moves, without a command from here",
}
_ALARMS = {
    1: "a limit switch was hit, and its position is lost: home it",
    2: "a move would have left its travel",
    3: "it was reset while it moved, and its position is lost: home it",
    4: "the probe was not in its expected state at the beginning",
    5: "the probe touched nothing within its travel",
    6: "it was reset while it homed",
    7: "its safety door was opened while it homed",
    8: "homing did not come free of a limit switch: raise the pull-off ($27), or check the wiring",
    9: "homing found no limit switch: raise the travel ($130 to $132), or check the wiring",
}
_ERRORS = {
    1: "a letter was expected",
    2: "a number is missing or invalid",
    3: "it does not know this $ command",
    4: "a value is negative",
    5: "homing is switched off in its settings ($22)",
    7: "its settings could not be read, and have their defaults now",
    8: "it takes $ commands only at rest",
    9: "it is in alarm or in a jog",
    10: "soft limits need homing ($22)",
    11: "the line is too long",
    13: "its safety door is open",
    15: "the jog would leave its travel",
    16: "the jog is not valid",
    20: "it does not know this command",
    21: "two commands of one modal group",
    22: "no feed is set",
    23: "the command needs a whole number",
    24: "two commands use the axis words",
    25: "a word is repeated",
    26: "axis words are missing",
    27: "the line number is not valid",
    28: "a value is missing",
    30: "G53 needs G0 or G1",
    31: "axis words have no use here",
    32: "the arc has no axis word in its plane",
    33: "the target of the move is not valid",
    34: "the radius of the arc is not valid",
    35: "the arc has no offset in its plane",
    36: "words have no use here",
    38: "the tool number is too large",
}
"""Alarm and error codes of grbl 1.1 ("Grbl v1.1 Interface"); others have no meaning here."""
_CODE = re.compile(r"(ALARM|error):(\d{1,3})")
_REALTIME = re.compile(rb"[?!~\x00-\x1f\x7f-\xff]")
_REPORT = re.compile(r"<([A-Za-z]+)(?::(\d{1,4}))?\|(.*)>")
_BUFFER = re.compile(r"(\d{1,5}),(\d{1,6})")
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
        Number after the state (``Hold:0``: at rest, ``Hold:1``: still braking); -1: no number.
    position
        (letters,) machine position per axis letter, mm or degrees; None if the report has none.
    offset
        (letters,) work coordinate offset, mm or degrees; None if the report has none.
    overrides
        (3,) overrides of feed, rapids and spindle, %; None if the report has none, as in most
        reports.
    free
        Free blocks of the planner, and free characters of the receive buffer; None if the report
        has none (``$10`` without 2).
    """

    state: str
    detail: int
    position: FloatArray | None
    offset: FloatArray | None
    overrides: FloatArray | None = None
    free: tuple[int, int] | None = None

    @property
    def stands(self) -> bool:
        """Whether the machine stands still, and stays so until a command."""
        return self.state in _STANDS or self.detail in _STANDING.get(self.state, ())

    @property
    def words(self) -> str:
        """The state in words, for people."""
        meaning = _MEANINGS.get(f"{self.state}:{self.detail}", _MEANINGS.get(self.state, ""))
        return f"the controller tells {self.state}{f': {meaning}' if meaning else ''}"


def in_words(line: str) -> str:
    """Return an alarm or error line with its meaning: ``ALARM:2, a move would have left ...``.

    A line without a code of grbl 1.1 is returned as it is.
    """
    match = _CODE.fullmatch(line.strip())
    if match is None:
        return line
    meaning = (_ALARMS if match[1] == "ALARM" else _ERRORS).get(int(match[2]), "")
    return f"{match[0]}, {meaning}" if meaning else line


def status_of(line: str) -> Status | None:
    """Return the status report in a line; None if it is not one.

    Raises
    ------
    LinkFaultError
        If a number in a report is invalid.
    """
    match = _REPORT.fullmatch(line)
    if match is None:
        return None
    state, detail, rest = match.groups()
    fields = dict(part.partition(":")[::2] for part in rest.split("|"))
    position, offset, overrides = (
        numbers(fields[name]) if name in fields else None for name in ("MPos", "WCO", "Ov")
    )
    buffer = _BUFFER.fullmatch(fields.get("Bf", ""))
    free = None if buffer is None else (int(buffer[1]), int(buffer[2]))
    return Status(state, -1 if detail is None else int(detail), position, offset, overrides, free)


def override_bytes(percent: int, current: int) -> bytes:
    r"""Return the bytes of the next step from the feed override ``current`` to ``percent``, %.

    grbl keeps one flag for each kind of step, so two equal bytes may count as one. Therefore at
    most one coarse and one fine step are sent at once ("Grbl v1.1 Commands", feed overrides).

    >>> override_bytes(100, 50), override_bytes(37, 100), override_bytes(52, 51)
    (b'\x90', b'\x92\x94', b'\x93')
    """
    if percent == AS_IS:
        return _FEED_AS_IS
    change = percent - current
    coarse, fine = divmod(abs(change), _COARSE)
    up = change > 0
    return (_COARSER[up] if coarse else b"") + (_FINER[up] if fine else b"")


def override_words(overrides: FloatArray) -> str:
    """Return the overrides of a status report in words.

    >>> override_words(np.array([50.0, 100.0, 90.0]))
    'feed 50 %, spindle 90 %'
    >>> override_words(np.full(3, 100.0))
    'none'
    """
    named_overrides = zip(("feed", "rapids", "spindle"), overrides.tolist(), strict=False)
    return (
        ", ".join(f"{name} {percent:g} %" for name, percent in named_overrides if percent != AS_IS)
        or "none"
    )


class Overrides:
    """The overrides that a controller reports, and the feed override that was requested."""

    def __init__(self) -> None:
        self._reported = np.full(3, AS_IS)  # of feed, rapids and spindle, %
        self.forget_request()

    def reset(self) -> None:
        """Note a reset of the controller, after which all its overrides are 100 %."""
        self._reported = np.full(3, AS_IS)

    def forget_request(self) -> None:
        """Forget the requested override, and any reported change that was not noted."""
        self._unnoted = False
        self._requested: int | None = None  # requested feed override, %; None once it is reported
        self._sent_s = -np.inf  # time of the latest step to it
        self._until_s = np.inf  # time at which the request fails

    @property
    def percent(self) -> int:
        """Reported override of the feed, %."""
        return round(float(self._reported[0]))

    @property
    def as_is(self) -> bool:
        """Whether nothing is overridden."""
        return bool((self._reported == AS_IS).all())

    @property
    def to_note(self) -> bool:
        """Whether the reported overrides have changed, other than by steps to a request."""
        return self._unnoted and self._requested is None

    def take(self, found: Status, *, to_note: bool = True) -> None:
        """Take the overrides of a report, if it has any; ``to_note``: a change is to be noted."""
        if found.overrides is not None and not np.array_equal(found.overrides, self._reported):
            self._reported, self._unnoted = found.overrides, self._unnoted or to_note

    def noted(self) -> str:
        """Return the overrides in words, and mark them as noted."""
        self._unnoted = False
        return override_words(self._reported)

    def want(self, percent: int, now_s: float) -> None:
        """Request a feed override, %, at the time ``now_s``."""
        self._requested, self._until_s = percent, now_s + _OVERRIDES_S

    def waited_s(self, now_s: float) -> float:
        """Return the time since the latest step, s."""
        return float(now_s - self._sent_s)

    def step(self, now_s: float) -> tuple[bytes, str]:
        """Return the bytes of the next step to the requested override, and why it failed.

        The bytes are empty if no step is due, the reason if the request has not failed.
        """
        if self._requested is None or self._requested == self.percent:
            self._requested = None
            return b"", ""
        if now_s > self._until_s:
            requested, self._requested = self._requested, None
            return b"", (
                f"the controller was told to override the feed by {requested} %, and reports "
                f"{self.percent} %"
            )
        self._sent_s = now_s
        return override_bytes(self._requested, self.percent), ""


def numbers(text: str) -> FloatArray:
    """Return the numbers between commas; raise LinkFaultError if one is invalid."""
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        values = np.array([np.nan])
    if not np.isfinite(values).all():
        raise LinkFaultError(f"the controller sent {text[:40]!r} instead of numbers")
    return values


class CharacterCount:
    """Counts the characters in grbl's receive buffer: an answer frees the oldest line."""

    def __init__(self, room: int = RX_BYTES) -> None:
        self._room = room
        self._lengths: deque[int] = deque()

    @property
    def open(self) -> int:
        """Number of lines not answered yet."""
        return len(self._lengths)

    def fits(self, line: bytes) -> bool:
        """Return whether there is room for a line."""
        return sum(self._lengths) + len(line) <= self._room

    def sent(self, line: bytes) -> None:
        """Count a line that was sent."""
        self._lengths.append(len(line))

    def answered(self) -> None:
        """Remove the oldest line; raise LinkFaultError if no line waits for an answer."""
        if not self._lengths:
            raise LinkFaultError("the controller answered a line that was not sent")
        self._lengths.popleft()


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """A part program as sent to grbl.

    Parameters
    ----------
    lines
        Lines of the program, each with its line feed.
    ends
        (n, axes) position at the end of each line, m or rad.
    durations_s
        (n,) time of each line at its feed, without ramps, and its dwell.
    rows, operations
        (n,) tick of the plan at which each line begins, and the operation of the job at that tick;
        all 0 if unknown.
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
        Letters of the axes.
    scale
        (axes,) m or rad per unit of the program.
    start
        (axes,) starting position, m or rad.

    Raises
    ------
    PlanError
        If a line has a byte that grbl executes at once, is a command of grbl (``$``), or is longer
        than its receive buffer.
    """
    lines, ends, durations_s = [], [], []
    position, feed = start.copy(), 0.0
    for number, line in enumerate(text.splitlines(), start=1):
        refuse_realtime(line, number)
        words = _WORD.findall(line.decode("ascii"))
        next_position = position.copy()
        for letter, value in words:
            if letter == "F":
                feed = float(value)
            elif letter in axes:
                k = axes.index(letter)
                next_position[k] = float(value) * scale[k]
        length = float(np.linalg.norm((next_position - position) / scale))
        dwell_s = sum(float(v) for w, v in words if w == "P")
        durations_s.append((60.0 * length / feed if feed else 0.0) + dwell_s)
        lines.append(line + b"\n")
        ends.append(next_position)
        position = next_position
    zeros = np.zeros(len(lines), dtype=np.int64)
    return Program(
        tuple(lines), np.array(ends).reshape(-1, len(axes)), np.array(durations_s), zeros, zeros
    )


def refuse_realtime(line: bytes, number: int) -> None:
    """Refuse a line that grbl would not read as part of a program.

    Raises
    ------
    PlanError
        If the line has such a byte, begins with ``$`` or fills the receive buffer; it names the
        line.
    """
    if _REALTIME.search(line) or line.lstrip().startswith(b"$") or len(line) >= RX_BYTES:
        raise PlanError(
            f"line {number} of the program, {line[:40]!r}, has a byte that grbl executes at once, "
            "or is longer than its buffer",
            remedy="Only lines of a part program may be sent to a controller.",
        )


def runs_out(program: Program, blocks: int, most: int = RX_BYTES) -> tuple[float, float]:
    """Return for how long and how far grbl can go on at most when nothing more is sent.

    grbl then still has the current line, the blocks in its planner and the lines in its receive
    buffer. Times are at the programmed feeds, without ramps.

    Parameters
    ----------
    blocks, most
        Blocks of grbl's planner, and characters of its receive buffer.

    Returns
    -------
    tuple
        Time in s, and path length in m, in which 1 rad of a rotary axis counts as 1 m.
    """
    lengths_m = np.linalg.norm(np.diff(program.ends, axis=0, prepend=program.ends[:1]), axis=1)
    longest_s = longest_m = 0.0
    for first in range(len(program.lines)):
        end, room = first + blocks + 1, most
        while end < len(program.lines) and room >= len(program.lines[end]):
            room -= len(program.lines[end])
            end += 1
        longest_s = max(longest_s, float(program.durations_s[first:end].sum()))
        longest_m = max(longest_m, float(lengths_m[first:end].sum()))
    return longest_s, longest_m


def settings_of(lines: Iterable[str]) -> dict[int, float]:
    """Return the settings of a ``$$`` listing by number; NaN for a value that is not a number.

    Some controllers list texts among their settings, such as their network address.
    """
    settings = {}
    for line in lines:
        match = _SETTING.fullmatch(line)
        if match is not None:
            try:
                settings[int(match.group(1))] = float(match.group(2))
            except ValueError:
                settings[int(match.group(1))] = np.nan
    return settings

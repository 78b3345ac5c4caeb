"""Commands to grbl and its answers, over a serial line or TCP.

Sources: "Grbl v1.1 Interface", "Grbl v1.1 Commands" and "Grbl v1.1 Jogging" in the documentation of
gnea/grbl.
"""

from __future__ import annotations

import os
import re
import select
import socket
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from ipaddress import ip_address

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import LinkFaultError, OptionError, PlanError
from threadline.live.guards import clock_s

_NAME = re.compile(r"[A-Za-z0-9_-]+(\.[A-Za-z0-9_-]+)*\.?")
_MOST = 253
MOST_PORT = 65535
"""Largest number of a TCP port."""


def is_host(text: str) -> bool:
    """Return whether a text is an IP address, or a well-formed host name.

    A name has letters, digits, ``-`` and ``_`` in parts between dots (RFC 1123, and the underscore
    found in practice), at most 253 characters; a name in other alphabets counts in its ASCII form
    (RFC 3490). A text that ends in digits alone must be an address. No name is looked up.
    """
    try:
        ip_address(text)
    except ValueError:
        pass
    else:
        return True
    try:
        name = text.encode("idna").decode("ascii")
    except UnicodeError:
        return False
    if len(name) > _MOST or _NAME.fullmatch(name) is None:
        return False
    return not name.rstrip(".").rpartition(".")[2].isdecimal() or _is_old_address(name)


def bare(host: str) -> str:
    """Return a host without the brackets that an IPv6 address may have."""
    return host[1:-1] if host.startswith("[") and host.endswith("]") and ":" in host else host


def in_url(host: str) -> str:
    """Return a host for a URL: an IPv6 address in brackets (RFC 3986)."""
    return f"[{host}]" if ":" in host else host


def _is_old_address(name: str) -> bool:
    """Return whether it is an address with fewer than four numbers, such as ``127.1``."""
    try:
        socket.inet_aton(name)
    except OSError:
        return False
    return True


STATUS, HOLD, RESUME, RESET, JOG_CANCEL = b"?", b"!", b"~", b"\x18", b"\x85"
"""Bytes that grbl executes at once, wherever they come; they take no room in its buffer."""
RX_BYTES = 128
"""Characters that grbl's receive buffer holds, unless it reports fewer (``$I``)."""
_STANDS = frozenset({"Idle", "Alarm", "Sleep", "Check"})
_STANDING = {"Hold": (-1, 0), "Door": (-1, 0, 1)}
"""Details after states in which the machine stands; -1 is none."""
PAUSES = frozenset({"Hold", "Door"})
"""States that a run may be in for a while, and resume from."""
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
        Number after the state: ``Hold:0`` stands, ``Hold:1`` still brakes. -1 without one.
    position
        (letters,) machine position, mm or degrees; None if the report has none.
    offset
        (letters,) work coordinate offset; None if the report has none.
    """

    state: str
    detail: int
    position: FloatArray | None
    offset: FloatArray | None

    @property
    def stands(self) -> bool:
        """Whether nothing moves, nor will without a command."""
        return self.state in _STANDS or self.detail in _STANDING.get(self.state, ())

    @property
    def words(self) -> str:
        """The state in words, for people."""
        means = _MEANINGS.get(f"{self.state}:{self.detail}", _MEANINGS.get(self.state, ""))
        return f"the controller tells {self.state}{f': {means}' if means else ''}"


def status_of(line: str) -> Status | None:
    """Return the status report in a line; None if it is not one.

    Raises
    ------
    LinkFaultError
        If a number in a report is invalid.
    """
    form = _REPORT.fullmatch(line)
    if form is None:
        return None
    state, detail, rest = form.groups()
    fields = dict(part.partition(":")[::2] for part in rest.split("|"))
    place, offset = (numbers(fields[name]) if name in fields else None for name in ("MPos", "WCO"))
    return Status(state, -1 if detail is None else int(detail), place, offset)


def numbers(text: str) -> FloatArray:
    """Return the numbers between commas; a LinkFaultError if one is invalid."""
    try:
        found = np.array([float(part) for part in text.split(",")])
    except ValueError:
        found = np.array([np.nan])
    if not np.isfinite(found).all():
        raise LinkFaultError(f"the controller sent {text[:40]!r} instead of numbers")
    return found


class CharacterCount:
    """Counts the characters that grbl may still hold: a line leaves when it is answered."""

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
        """Remove the oldest line; a LinkFaultError if none was sent."""
        if not self._lengths:
            raise LinkFaultError("the controller answered a line that was not sent")
        self._lengths.popleft()


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """A part program as sent to grbl.

    Parameters
    ----------
    lines
        Each with its line feed.
    ends
        (n, axes) position at the end of each line, m or rad.
    durations_s
        (n,) time of each at its feed alone.
    rows, operations
        (n,) tick of the plan at which each begins, and the operation of the job at that tick; all
        0 if unknown.
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
    """Refuse a line that grbl would not read as part of a program.

    Raises
    ------
    PlanError
        Names the line.
    """
    if _REALTIME.search(line) or line.lstrip().startswith(b"$") or len(line) >= RX_BYTES:
        raise PlanError(
            f"line {number} of the program, {line[:40]!r}, has a byte that grbl executes at once, "
            "or is longer than its buffer",
            remedy="Only lines of a part program may be sent to a controller.",
        )


def runs_out(program: Program, blocks: int, most: int = RX_BYTES) -> tuple[float, float]:
    """Return how long and how far grbl can go on at most when nothing more is sent.

    It then has the current line, as many blocks as its planner holds, and the lines in its receive
    buffer. Times are at the feeds, without ramps.

    Parameters
    ----------
    blocks, most
        Blocks of its planner, and characters of its receive buffer.

    Returns
    -------
    tuple
        s; and path length in m, where rotary axes count in rad.
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
    """Return the settings that ``$$`` has listed, by number; NaN for one that is not a number.

    Some controllers list texts among them, such as their network address.
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


BAUD = 115200
"""Speed of a serial line to grbl, in bits a second."""
# struct termios2 of Linux (asm-generic/termbits.h): four words of flags, 20 bytes, two speeds.
_TERMIOS2_BYTES, _TCGETS2, _TCSETS2, _CBAUD, _BOTHER = 44, 0x802C542A, 0x402C542B, 0x100F, 0x1000
_CONNECT_S = 5.0
_AT_ONCE = 4096
_DIGITS = 5  # of a port
_LONGEST_LINE = 1 << 14
_MOST_OLD = 10_000  # lines that came during a silence; a longer flood is not read to its end


def host_and_port(address: str) -> tuple[str, int]:
    """Return the host and the port of a ``HOST:PORT``; nothing is looked up or connected.

    Raises
    ------
    OptionError
        If there is no such host or port.
    """
    host, _, port = address.rpartition(":")
    host = bare(host)
    wrong = ""
    if not is_host(host):
        wrong = f"{host[:60]!r} is not a host"
    elif not (port.isascii() and port.isdecimal() and len(port) <= _DIGITS):
        wrong = f"{port[:20]!r} is not a port"
    elif not 1 <= int(port) <= MOST_PORT:
        wrong = f"port {port} is not between 1 and {MOST_PORT}"
    if wrong:
        raise OptionError(
            f"{address[:60]!r} is not an address of a controller: {wrong}",
            remedy='Write it like "grbl:192.168.0.10:23" or "grbl:/dev/ttyUSB0".',
        )
    return host, int(port)


def check_address(address: str) -> None:
    """Refuse a text that is neither ``HOST:PORT`` nor the path of a device; nothing is connected.

    Raises
    ------
    OptionError
        If it is not an address.
    """
    if not address.startswith("/"):
        host_and_port(address)


class Port:
    """A stream of lines from a controller, and bytes to it.

    Parameters
    ----------
    address
        ``HOST:PORT`` or the path of a serial device.
    baud
        Speed of a serial device, in bits a second.

    Attributes
    ----------
    lost
        Whether the other side is gone.

    Raises
    ------
    LinkFaultError
        If nothing answers there.
    OptionError
        If it is not an address.
    """

    def __init__(self, address: str, baud: int = BAUD) -> None:
        self._socket: socket.socket | None = None
        self.lost = False
        self._bytes = bytearray()
        self._lines: deque[str] = deque()
        try:
            if address.startswith("/"):
                self._number = _serial(address, baud)
            else:
                self._socket = socket.create_connection(host_and_port(address), _CONNECT_S)
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._socket.setblocking(False)
                self._number = self._socket.fileno()
        except OSError as error:
            raise LinkFaultError(
                f"nothing answers at {address[:60]!r}: {error.strerror or error}",
                remedy="Check that the controller is switched on and connected.",
            ) from error

    def fileno(self) -> int:
        """Return the descriptor, which is readable when data has come."""
        return self._number

    @property
    def waiting(self) -> bool:
        """Whether a complete line is buffered that ``receive`` has not returned yet."""
        return bool(self._lines)

    def send(self, content: bytes) -> None:
        """Send bytes; if the other side is gone or accepts none, ``lost`` becomes True."""
        while content and not self.lost:
            try:
                content = content[os.write(self._number, content) :]
            except BlockingIOError:
                if not select.select([], [self._number], [], 0.5)[1]:
                    self.lost = True
            except OSError:
                self.lost = True

    def receive(self, timeout_s: float) -> str | None:
        """Return the next line, stripped; None if none came in time or the link is gone."""
        line = self.receive_indented(timeout_s)
        return None if line is None else line.strip()

    def receive_indented(self, timeout_s: float) -> str | None:
        """Return the next line with the spaces before it, which count in YAML; or None."""
        until = clock_s() + timeout_s
        while not self._lines and not self.lost:
            left = max(until - clock_s(), 0.0)
            if not select.select([self._number], [], [], left)[0]:
                return None
            self._read()
            if not self._lines and clock_s() >= until:  # data may never complete a line
                return None
        return self._lines.popleft() if self._lines else None

    def forget_reports(self) -> None:
        """Drop the status reports received so far: they are outdated."""
        while not self.lost and select.select([self._number], [], [], 0.0)[0]:
            before = len(self._bytes), len(self._lines)
            self._read()
            if len(self._lines) > _MOST_OLD or before == (len(self._bytes), len(self._lines)):
                break
        self._lines = deque(line for line in self._lines if not line.startswith("<"))

    def _read(self) -> None:
        try:
            more = os.read(self._number, _AT_ONCE)
        except BlockingIOError:
            return
        except OSError:
            more = b""
        if not more:
            self.lost = True
        self._bytes += more
        *whole, rest = self._bytes.split(b"\n")
        self._bytes = bytearray(rest[:_LONGEST_LINE])
        self._lines.extend(line.decode("latin-1").rstrip() for line in whole if line.strip())

    def close(self) -> None:
        """Close the port."""
        self.lost = True
        if self._socket is not None:
            self._socket.close()
        else:
            os.close(self._number)


def _serial(path: str, baud: int) -> int:
    """Open a serial device, raw and exclusively, and return its descriptor."""
    import array
    import fcntl
    import termios
    import tty

    number = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)  # lines of two programs would mix
    except OSError as error:
        os.close(number)
        raise OSError(error.errno, "another program has it") from error
    try:
        tty.setraw(number)
        mode = termios.tcgetattr(number)
        known = getattr(termios, f"B{baud}", None)
        mode[4] = mode[5] = termios.B115200 if known is None else known
        mode[2] |= termios.CLOCAL | termios.CREAD
        mode[2] &= ~termios.HUPCL  # closing it must not reset the controller
        termios.tcsetattr(number, termios.TCSANOW, mode)
        if known is None:  # Marlin's 250000 has no name: Linux takes it as a number
            speeds = array.array("I", bytes(_TERMIOS2_BYTES))
            fcntl.ioctl(number, _TCGETS2, speeds)
            speeds[2] = speeds[2] & ~_CBAUD | _BOTHER
            speeds[-2] = speeds[-1] = baud
            fcntl.ioctl(number, _TCSETS2, speeds)
    except OSError as error:
        os.close(number)
        raise OSError(error.errno, f"it does not take {baud} bits a second") from error
    except termios.error as error:
        os.close(number)
        raise OSError(error.args[0], "it is not a serial line") from error
    return number

"""The port of a controller with grbl: a serial line, or TCP."""

from __future__ import annotations

import os
import select
import socket
from collections import deque

from threadline.errors import LinkFaultError, OptionError
from threadline.live.host_names import MOST_PORT, bare, is_host
from threadline.live.lateness import clock_s

_CONNECT_S = 5.0
_AT_ONCE = 4096
_DIGITS = 5  # of a port
_LONGEST_LINE = 1 << 14
_MOST_OLD = 10_000  # lines that came in a silence; who sends more is not waited for


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
        wrong = f"{host[:60]!r} is no host"
    elif not (port.isascii() and port.isdecimal() and len(port) <= _DIGITS):
        wrong = f"{port[:20]!r} is no port"
    elif not 1 <= int(port) <= MOST_PORT:
        wrong = f"port {port} is not between 1 and {MOST_PORT}"
    if wrong:
        raise OptionError(
            f"{address[:60]!r} is no address of a controller: {wrong}",
            remedy='Write it like "grbl:192.168.0.10:23" or "grbl:/dev/ttyUSB0".',
        )
    return host, int(port)


def check_address(address: str) -> None:
    """Refuse what is neither ``HOST:PORT`` nor the path of a device; nothing is connected.

    Raises
    ------
    OptionError
        If it is no address.
    """
    if not address.startswith("/"):
        host_and_port(address)


class Port:
    """A stream of lines from a controller, and bytes to it.

    Parameters
    ----------
    address
        ``HOST:PORT`` or the path of a serial device.

    Attributes
    ----------
    lost
        Whether the other side is gone.

    Raises
    ------
    LinkFaultError
        If nothing answers there.
    OptionError
        If it is no address.
    """

    def __init__(self, address: str) -> None:
        self._socket: socket.socket | None = None
        self.lost = False
        self._bytes = bytearray()
        self._lines: deque[str] = deque()
        try:
            if address.startswith("/"):
                self._number = _serial(address)
            else:
                self._socket = socket.create_connection(host_and_port(address), _CONNECT_S)
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._socket.setblocking(False)
                self._number = self._socket.fileno()
        except OSError as error:
            raise LinkFaultError(
                f"nothing answers at {address[:60]!r}: {error.strerror or error}",
                remedy="Look whether the controller is switched on and connected.",
            ) from error

    def fileno(self) -> int:
        """Return the descriptor, which is readable when something came."""
        return self._number

    @property
    def waiting(self) -> bool:
        """Whether a line was read that ``receive`` has not returned yet."""
        return bool(self._lines)

    def send(self, content: bytes) -> None:
        """Send bytes; where the other side is gone or takes none, ``lost`` becomes True."""
        while content and not self.lost:
            try:
                content = content[os.write(self._number, content) :]
            except BlockingIOError:
                if not select.select([], [self._number], [], 0.5)[1]:
                    self.lost = True
            except OSError:
                self.lost = True

    def receive(self, timeout_s: float) -> str | None:
        """Return the next line without its end; None if none came in time or the link is gone."""
        until = clock_s() + timeout_s
        while not self._lines and not self.lost:
            left = max(until - clock_s(), 0.0)
            if not select.select([self._number], [], [], left)[0]:
                return None
            self._read()
            if not self._lines and clock_s() >= until:  # what comes may never be a line
                return None
        return self._lines.popleft() if self._lines else None

    def forget_reports(self) -> None:
        """Leave out the status reports that have come until now: they tell of a time before."""
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
        self._lines.extend(line.decode("latin-1").strip() for line in whole if line.strip())

    def close(self) -> None:
        """Close the port."""
        self.lost = True
        if self._socket is not None:
            self._socket.close()
        else:
            os.close(self._number)


def _serial(path: str) -> int:
    """Open a serial device, raw and for nobody else, and return its descriptor."""
    import fcntl
    import termios
    import tty

    number = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)  # lines of two would be mixed
    except OSError as error:
        os.close(number)
        raise OSError(error.errno, "another program has it") from error
    try:
        tty.setraw(number)
        mode = termios.tcgetattr(number)
        mode[4] = mode[5] = termios.B115200
        mode[2] |= termios.CLOCAL | termios.CREAD
        mode[2] &= ~termios.HUPCL  # closing it must not reset the controller
        termios.tcsetattr(number, termios.TCSANOW, mode)
    except termios.error as error:
        os.close(number)
        raise OSError(error.args[0], "it is no serial line") from error
    return number

"""The port to a controller, a serial device or a TCP connection, and its address.

Host names follow RFC 1123 and RFC 3490; a name is looked up only to connect to it.
"""

from __future__ import annotations

import os
import re
import select
import socket
from collections import deque
from ipaddress import ip_address
from typing import Protocol

from threadline.errors import LinkFaultError, OptionError
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
    problem = ""
    if ":" not in address:
        problem = "there is no colon between host and port"
    elif not is_host(host):
        problem = f"{host[:60]!r} is not a host"
    elif not (port.isascii() and port.isdecimal() and len(port) <= _DIGITS):
        problem = f"{port[:20]!r} is not a port"
    elif not 1 <= int(port) <= MOST_PORT:
        problem = f"port {port} is not between 1 and {MOST_PORT}"
    if problem:
        raise OptionError(
            f"{address[:60]!r} is not an address of a controller: {problem}",
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


class PortLog(Protocol):
    """A log of the bytes that pass a port."""

    def sent(self, content: bytes) -> None:
        """Take bytes that were sent."""

    def heard(self, line: str) -> None:
        """Take a line that was received."""


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
    log
        Log of all bytes that are sent and of all lines that are received; None: no log.

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
        self.log: PortLog | None = None
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
        if self.log is not None:
            self.log.sent(content)
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
        until_s = clock_s() + timeout_s
        while not self._lines and not self.lost:
            left_s = max(until_s - clock_s(), 0.0)
            if not select.select([self._number], [], [], left_s)[0]:
                return None
            self._read()
            if not self._lines and clock_s() >= until_s:  # data may never complete a line
                return None
        if not self._lines:
            return None
        line = self._lines.popleft()
        if self.log is not None:
            self.log.heard(line)
        return line

    def forget_reports(self) -> None:
        """Drop the status reports received so far: they are outdated."""
        while not self.lost and select.select([self._number], [], [], 0.0)[0]:
            sizes_before = len(self._bytes), len(self._lines)
            self._read()
            if len(self._lines) > _MOST_OLD or sizes_before == (len(self._bytes), len(self._lines)):
                break
        self._lines = deque(line for line in self._lines if not line.startswith("<"))

    def _read(self) -> None:
        try:
            received = os.read(self._number, _AT_ONCE)
        except BlockingIOError:
            return
        except OSError:
            received = b""
        if not received:
            self.lost = True
        self._bytes += received
        *complete_lines, incomplete_line = self._bytes.split(b"\n")
        self._bytes = bytearray(incomplete_line[:_LONGEST_LINE])
        self._lines.extend(
            line.decode("latin-1").rstrip() for line in complete_lines if line.strip()
        )

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

    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)  # lines of two programs would mix
    except OSError as error:
        os.close(descriptor)
        raise OSError(error.errno, "another program has it") from error
    try:
        tty.setraw(descriptor)
        mode = termios.tcgetattr(descriptor)
        baud_flag = getattr(termios, f"B{baud}", None)
        mode[4] = mode[5] = termios.B115200 if baud_flag is None else baud_flag
        mode[2] |= termios.CLOCAL | termios.CREAD
        mode[2] &= ~termios.HUPCL  # closing it must not reset the controller
        termios.tcsetattr(descriptor, termios.TCSANOW, mode)
        if baud_flag is None:  # Marlin's 250000 has no name: Linux takes it as a number
            termios2 = array.array("I", bytes(_TERMIOS2_BYTES))
            fcntl.ioctl(descriptor, _TCGETS2, termios2)
            termios2[2] = termios2[2] & ~_CBAUD | _BOTHER
            termios2[-2] = termios2[-1] = baud
            fcntl.ioctl(descriptor, _TCSETS2, termios2)
    except OSError as error:
        os.close(descriptor)
        raise OSError(error.errno, f"it does not take {baud} bits a second") from error
    except termios.error as error:
        os.close(descriptor)
        raise OSError(error.args[0], "it is not a serial line") from error
    return descriptor

"""Messages between an executor and a machine: a length, a head of JSON, and arrays.

A message is four bytes of length, four bytes of the length of its head, the head (JSON, UTF-8),
and the bytes of its arrays in the order in which the head names them; integers are little-endian.
Consecutive arrays of one type and shape are named together. Nothing in a message is code, and
nothing is longer than ``MOST_BYTES``. The far end of a link may be a process of its own.
"""

from __future__ import annotations

import json
import math
import os
import pickle
import select
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, get_args

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.importing import program_apart
from threadline.errors import LinkFaultError
from threadline.files import Creep, Event
from threadline.files.clock import EventKind

PROTOCOL = 3
MOST_BYTES = 1 << 24
_LENGTHS = struct.Struct("<II")
_TYPES = {"<i8": np.int64, "<f8": np.float64}
_AT_ONCE = 1 << 16
_encode = json.JSONEncoder(allow_nan=False, ensure_ascii=False).encode
_EVENT_KINDS = get_args(EventKind)
_SEND_S = 2.0
"""Time in s after which an unsent message means that the other side is gone."""
_JOIN_S = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """A message from one side of a link to the other.

    Parameters
    ----------
    kind
        Type of the message, such as ``"refill"``.
    head
        Values that JSON can hold, by name.
    arrays
        Arrays of int64 or float64, by name.
    """

    kind: str
    head: Mapping[str, Any] = field(default_factory=dict)
    arrays: Mapping[str, IntArray | FloatArray] = field(default_factory=dict)

    def encoded(self) -> bytes:
        """Return the bytes of the message."""
        # Arrays of one form together.
        array_groups: list[tuple[list[str], str, tuple[int, ...]]] = []
        parts: list[bytes] = []
        for name, array in self.arrays.items():
            dtype = "<i8" if array.dtype.kind == "i" else "<f8"
            if array_groups and array_groups[-1][1] == dtype and array_groups[-1][2] == array.shape:
                array_groups[-1][0].append(name)
            else:
                array_groups.append(([name], dtype, array.shape))
            parts.append((array if array.dtype == dtype else array.astype(dtype)).tobytes())
        content = {"kind": self.kind, "head": dict(self.head), "arrays": array_groups}
        head = _encode(content).encode()
        body = b"".join(parts)
        return _LENGTHS.pack(len(head) + len(body) + 4, len(head)) + head + body


def _refuse(why: str) -> LinkFaultError:
    return LinkFaultError(f"the link sent bytes that are not a message: {why}")


def decoded(content: bytes) -> Message:
    """Return the message in ``content``, which begins with the length of the head.

    Raises
    ------
    LinkFaultError
        If the bytes are not a message.
    """
    try:
        (size,) = struct.unpack_from("<I", content)
        message_fields = json.loads(content[4 : 4 + size])
        kind, head, array_groups = (
            str(message_fields["kind"]),
            dict(message_fields["head"]),
            list(message_fields["arrays"]),
        )
        arrays: dict[str, IntArray | FloatArray] = {}
        offset = 4 + size
        for names, dtype, shape in array_groups:
            full_shape = [len(list(names)), *(int(n) for n in shape)]
            if not shape or min(full_shape) < 0:
                raise _refuse(f"an array of shape {shape}")
            values: Any = np.frombuffer(content, _TYPES[dtype], math.prod(full_shape), offset)
            arrays.update(zip(map(str, names), values.reshape(full_shape), strict=True))
            offset += values.nbytes
    except (
        ArithmeticError,
        ValueError,
        KeyError,
        TypeError,
        struct.error,
        RecursionError,
    ) as error:
        raise _refuse(str(error)[:80] or type(error).__name__) from error
    if offset != len(content):
        raise _refuse(f"{len(content) - offset} bytes are left over")
    return Message(kind, head, arrays)


def event_row(event: Event) -> list[Any]:
    """Return an event as a list for the head of a message."""
    return [event.tick, event.kind, event.operation, event.name, event.value]


def event_of(row: Any) -> Event:
    """Return the event that ``event_row`` wrote.

    Raises
    ------
    LinkFaultError
        If ``row`` is not an event.
    """
    try:
        tick, kind, operation, name, value = row
        if kind not in _EVENT_KINDS:
            raise _refuse(f"an event {str(kind)[:20]!r}")
        return Event(
            tick=int(tick), kind=kind, operation=int(operation), name=str(name), value=float(value)
        )
    except (TypeError, ValueError) as error:
        raise _refuse(str(error)[:80]) from error


def creep_of(row: Any) -> Creep:
    """Return the creep that ``row`` describes.

    Raises
    ------
    LinkFaultError
        If ``row`` is not a creep.
    """
    try:
        return Creep.of_row(row)
    except (TypeError, ValueError) as error:
        raise _refuse(str(error)[:80]) from error


class Connection:
    """One end of a link: whole messages, over a stream socket.

    Parameters
    ----------
    end
        The socket; the connection closes it.
    """

    def __init__(self, end: socket.socket) -> None:
        self._socket = end
        self._bytes = bytearray()
        self.lost = False  # the other side is gone

    def fileno(self) -> int:
        """Return the file descriptor of the socket; a message may wait already (``waiting``)."""
        return self._socket.fileno()

    @property
    def waiting(self) -> bool:
        """Whether a complete message is buffered that ``receive`` has not returned yet."""
        return len(self._bytes) >= 4 and len(self._bytes) >= 4 + self._length()

    def _length(self) -> int:
        (length,) = struct.unpack_from("<I", self._bytes)
        if not 4 <= length <= MOST_BYTES:
            raise _refuse(f"a length of {length} bytes")
        return int(length)

    def send(self, message: Message) -> None:
        """Send a message; if the other side is gone, ``lost`` becomes True without an error."""
        try:
            self._socket.sendall(message.encoded())
        except OSError:
            self.lost = True

    def receive(self, timeout_s: float | None = None) -> Message | None:
        """Return the next message; None if none came in time, or the other side is gone.

        Raises
        ------
        LinkFaultError
            If the received bytes are not a message.
        """
        while not self.waiting:
            if self.lost or not self._readable(timeout_s):
                return None
            try:
                received = self._socket.recv(_AT_ONCE)
            except OSError:
                received = b""
            if not received:
                self.lost = True
            self._bytes += received
        length = self._length()
        content = bytes(self._bytes[4 : 4 + length])
        del self._bytes[: 4 + length]
        return decoded(content)

    def _readable(self, timeout_s: float | None) -> bool:
        wait_s = None if timeout_s is None else max(timeout_s, 0.0)
        return bool(select.select([self._socket], [], [], wait_s)[0])

    def close(self) -> None:
        """Close the socket; a thread that waits in ``receive`` is woken."""
        self.lost = True
        with suppress(OSError):  # the other side is gone already
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()


@contextmanager
def process_link(program: str, sent: tuple[Any, ...]) -> Iterator[Connection]:
    """Start a process for a machine, and yield the link to it.

    A forked process would share open files with its parent, and a process of ``multiprocessing``
    would run the main program of the caller again.

    Parameters
    ----------
    program
        Python code that calls ``machine_end`` and serves.
    sent
        Object sent to the process through a pipe.
    """
    ours, theirs = socket.socketpair()
    process = subprocess.Popen(  # noqa: S603  # this interpreter, and words of ours
        [*program_apart(program), str(theirs.fileno())],
        stdin=subprocess.PIPE,
        pass_fds=(theirs.fileno(),),
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,  # keys of the terminal are for the executor
    )
    theirs.close()
    assert process.stdin is not None
    with suppress(BrokenPipeError), process.stdin as pipe:  # if it died, no greeting will come
        pickle.dump(sent, pipe)
    ours.settimeout(_SEND_S)
    connection = Connection(ours)
    try:
        yield connection
    finally:
        connection.close()
        try:
            process.wait(_JOIN_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def machine_end() -> tuple[socket.socket, Any]:
    """Return this process's end of the link, and the object from the parent process."""
    sent = pickle.load(sys.stdin.buffer)  # noqa: S301  # of the parent, through a pipe of its own
    return socket.socket(fileno=int(sys.argv[1])), sent

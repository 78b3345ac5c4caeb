"""The fifos of LinuxCNC's ``streamer`` and ``sampler``, as they lie in shared memory.

``halstreamer`` and ``halsampler`` read and write the same memory. They only append, and a braking
tail has to be replaced by what is sent next, so that the records that wait are written here.
Layout: ``struct hal_stream_shm`` of LinuxCNC 2.8 and 2.9; it is compared before anything is
written.
"""

from __future__ import annotations

import ctypes
import platform
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.errors import LinkFaultError

HAL_KEY, STREAMER_KEY, SAMPLER_KEY = 0x48414C32, 0x48535430, 0x48534130
"""Keys of the shared memory of HAL, of its first streamer and of its first sampler."""
_MAGIC = 0x4649464F
_MOST_FIELDS = 21
_TYPES = {"b": 1, "f": 2, "s": 3, "u": 4}
_HEAD = 128  # bytes before the records
_RECORDS_APART = 8  # bytes; each record ends in a field of its own, its number
_REMOVE = 0  # IPC_RMID
_MEMORIES = Path("/proc/sysvipc/shm")
_ATTACHED = ctypes.CDLL(None, use_errno=True)
_ATTACHED.shmat.restype = ctypes.c_void_p
_ATTACHED.shmat.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_int]
_ATTACHED.shmdt.argtypes = [ctypes.c_void_p]


def in_use(key: int) -> int:
    """Return the process that made the shared memory with a key; 0 where nobody uses any."""
    for line in _MEMORIES.read_text("ascii").splitlines()[1:]:
        its, _, _, _, maker, _, users, *_ = line.split()
        if int(its) == key and int(users):
            return int(maker)
    return 0


def remove_left() -> None:
    """Remove the fifos of a HAL that was killed: memory that nobody uses."""
    for key in (STREAMER_KEY, SAMPLER_KEY):
        number = int(_ATTACHED.shmget(key, 0, 0))
        if number >= 0 and not in_use(key):
            _ATTACHED.shmctl(number, _REMOVE, None)


class HalFifo:
    """One fifo of HAL.

    Parameters
    ----------
    key
        Of its shared memory.
    depth
        Number of records that it was made for.
    fields
        A letter for each field: b, f, s, u.

    Attributes
    ----------
    numbers
        (depth, fields + 1) fields as float64, to be read and written where they are float.
    words
        (depth, fields + 1) the low 32 bits of the same.

    Raises
    ------
    LinkFaultError
        If there is none, or it is laid out in another way.
    """

    def __init__(self, key: int, depth: int, fields: str) -> None:
        if platform.machine() not in {"x86_64", "AMD64"}:  # stores are seen in their order there
            raise LinkFaultError(
                f"the fifo of HAL is written on x86-64 alone, this is {platform.machine()}"
            )
        number = int(_ATTACHED.shmget(key, 0, 0))
        at = None if number < 0 else _ATTACHED.shmat(number, None, 0)
        if at is None or at == ctypes.c_void_p(-1).value:
            raise LinkFaultError(
                "the fifo of HAL is not there, or belongs to somebody else",
                remedy="Look whether LinuxCNC runs: halcmd show comp.",
            )
        self._at = int(at)
        row = (len(fields) + 1) * _RECORDS_APART
        whole = memoryview((ctypes.c_char * (_HEAD + depth * row)).from_address(self._at)).cast("B")
        self._head: NDArray[np.uint32] = np.frombuffer(whole, np.uint32, 10)
        kinds = np.frombuffer(whole, np.int32, _MOST_FIELDS, 40)[: len(fields)].tolist()
        told = [int(self._head[k]) for k in (0, 4, 5)]
        if told != [_MAGIC, depth, len(fields)] or kinds != [_TYPES[f] for f in fields]:
            self.close()
            raise LinkFaultError(
                "the fifo of HAL is laid out in another way than that of LinuxCNC 2.9",
                remedy="Use LinuxCNC 2.8 or 2.9.",
            )
        self.depth = depth
        self.numbers: NDArray[np.float64] = np.frombuffer(whole, np.float64, offset=_HEAD).reshape(
            depth, -1
        )
        self.words: NDArray[np.int32] = self.numbers.view(np.int32)[:, ::2]

    @property
    def written(self) -> int:
        """Slot that is written next."""
        return int(self._head[1])

    @written.setter
    def written(self, slot: int) -> None:
        self._head[1] = slot

    @property
    def read(self) -> int:
        """Slot that is read next."""
        return int(self._head[2])

    @property
    def waiting(self) -> int:
        """Number of records that wait to be read."""
        return (self.written - self.read) % self.depth

    @property
    def overruns(self) -> int:
        """Number of records that found the fifo full, and were lost."""
        return int(self._head[6])

    def take(self) -> tuple[IntArray, FloatArray]:
        """Return the records that wait, as words and as numbers, and free their room."""
        until = self.written
        slots = (self.read + np.arange((until - self.read) % self.depth)) % self.depth
        words, numbers = self.words[slots].astype(np.int64), self.numbers[slots]
        self._head[2] = until
        return words, numbers

    def close(self) -> None:
        """Let go of the memory; nothing of it may be used after that."""
        self._head = np.zeros(10, np.uint32)
        self.numbers, self.words = np.zeros((0, 1)), np.zeros((0, 1), np.int32)
        _ATTACHED.shmdt(self._at)

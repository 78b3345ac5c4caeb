"""The fifos of LinuxCNC's ``streamer`` and ``sampler`` in shared memory.

``halstreamer`` and ``halsampler`` access the same memory, but can only append. The next refill must
replace a braking tail, so Threadline writes the waiting records itself. Layout: ``struct
hal_stream_shm`` of LinuxCNC 2.8 and 2.9; it is checked before anything is written.

A thread plays a record of ``streamer`` at each tick and puts a record into ``sampler``. A record
holds the positions of all axes twice, as two versions; ``flip`` switches from one to the other for
all later records. To replace waiting rows, the unused version of their records is written, and a
single bit in the first of these records puts all of them in force at once.
"""

from __future__ import annotations

import ctypes
import os
import platform
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.dynamics.responses import answers_of
from threadline.errors import LinkFaultError, OptionError
from threadline.machine import Machine

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
    """Return the process that created the shared memory with a key; 0 if nobody uses it."""
    for line in _MEMORIES.read_text("ascii").splitlines()[1:]:
        its_key, _, _, _, creator, _, user_count, *_ = line.split()
        if int(its_key) == key and int(user_count):
            return int(creator)
    return 0


def remove_left() -> None:
    """Remove the fifos that a killed HAL left: shared memory without a user."""
    for key in (STREAMER_KEY, SAMPLER_KEY):
        memory_id = int(_ATTACHED.shmget(key, 0, 0))
        if memory_id >= 0 and not in_use(key):
            _ATTACHED.shmctl(memory_id, _REMOVE, None)


class HalFifo:
    """One fifo of HAL.

    Parameters
    ----------
    key
        Key of its shared memory.
    depth
        Number of records for which it was created.
    fields
        Type letter of each field: b (bit), f (float), s (signed), u (unsigned).

    Attributes
    ----------
    numbers
        (depth, fields + 1) fields as float64; valid for float fields.
    words
        (depth, fields + 1) low 32 bits of the same fields; valid for the other types.

    Raises
    ------
    LinkFaultError
        If the computer is not x86-64, the fifo is missing or belongs to another user, or its layout
        differs.
    """

    def __init__(self, key: int, depth: int, fields: str) -> None:
        if platform.machine() not in {"x86_64", "AMD64"}:  # x86 keeps the order of stores
            raise LinkFaultError(f"the fifo of HAL needs x86-64, this is {platform.machine()}")
        memory_id = int(_ATTACHED.shmget(key, 0, 0))
        address = None if memory_id < 0 else _ATTACHED.shmat(memory_id, None, 0)
        if address is None or address == ctypes.c_void_p(-1).value:
            raise LinkFaultError(
                "the fifo of HAL is not there, or belongs to somebody else",
                remedy="Check whether LinuxCNC runs: halcmd show comp.",
            )
        self._at = int(address)
        record_bytes = (len(fields) + 1) * _RECORDS_APART
        memory = memoryview(
            (ctypes.c_char * (_HEAD + depth * record_bytes)).from_address(self._at)
        ).cast("B")
        self._head: NDArray[np.uint32] = np.frombuffer(memory, np.uint32, 10)
        field_types = np.frombuffer(memory, np.int32, _MOST_FIELDS, 40)[: len(fields)].tolist()
        head_values = [int(self._head[k]) for k in (0, 4, 5)]
        if head_values != [_MAGIC, depth, len(fields)] or field_types != [
            _TYPES[letter] for letter in fields
        ]:
            self.close()
            raise LinkFaultError(
                "the layout of HAL's fifo differs from LinuxCNC 2.9",
                remedy="Use LinuxCNC 2.8 or 2.9.",
            )
        self.depth = depth
        self.numbers: NDArray[np.float64] = np.frombuffer(memory, np.float64, offset=_HEAD).reshape(
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
        """Number of records that were lost because the fifo was full."""
        return int(self._head[6])

    def take(self) -> tuple[IntArray, FloatArray]:
        """Return the waiting records, as words and as numbers, and free their slots."""
        end = self.written
        slots = (self.read + np.arange((end - self.read) % self.depth)) % self.depth
        words, numbers = self.words[slots].astype(np.int64), self.numbers[slots]
        self._head[2] = end
        return words, numbers

    def close(self) -> None:
        """Detach the memory; the fifo must not be used after that."""
        self._head = np.zeros(10, np.uint32)
        self.numbers, self.words = np.zeros((0, 1)), np.zeros((0, 1), np.int32)
        _ATTACHED.shmdt(self._at)


AXES_AT_MOST = 9  # a streamer has 20 fields: two for each axis, and two more
FILL_S = 0.15
"""Time for which the fifo holds records at rest after the motion, s."""
SILENT_S = 0.3
"""Time in s without a tick of HAL's thread after which it counts as gone."""
_HELD_S = 1.2  # capacity of the fifo for rows, braking tail and rest
SAMPLED_S = 4.0
_LEAD_S = 0.005  # a row this close to being played is not replaced any more
_PATIENCE_S = 10.0
_FLIP, _NUMBER = 0, 1  # fields of a record of the streamer
_OWN = 2  # fields before the positions, in records of the streamer and of the sampler


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples of HAL, oldest first.

    Parameters
    ----------
    record
        (n,) number of the record that was played.
    interval_s
        (n,) time between the tick and the previous tick.
    commanded, read
        (n, axes) counts that HAL commanded, and counts that it read back.
    """

    record: IntArray
    interval_s: FloatArray
    commanded: FloatArray
    read: FloatArray

    def at(self, which: slice | NDArray[np.bool_]) -> Samples:
        """Return the samples that ``which`` selects."""
        return Samples(
            self.record[which], self.interval_s[which], self.commanded[which], self.read[which]
        )

    @staticmethod
    def joined(parts: Sequence[Samples]) -> Samples:
        """Return consecutive samples joined; at least one part."""
        return Samples(
            np.concatenate([part.record for part in parts]),
            np.concatenate([part.interval_s for part in parts]),
            np.concatenate([part.commanded for part in parts]),
            np.concatenate([part.read for part in parts]),
        )


def as_user() -> list[str]:
    """Return the words to put before a HAL command.

    There are none, except for root: HAL refuses root, so the command runs as the user of sudo.

    Raises
    ------
    OptionError
        If root did not use sudo, so that no other user is known.
    """
    if os.geteuid() != 0:
        return []
    user = os.environ.get("SUDO_UID", "")
    if not user.isdecimal() or int(user) == 0:
        raise OptionError(
            "LinuxCNC's HAL refuses to run as root", remedy="Run threadline as another user."
        )
    return ["setpriv", f"--reuid={user}", f"--regid={user}", "--clear-groups"]


def words_to_end() -> list[str]:
    """Return the words of a command that ends a HAL that was left running."""
    return [*as_user(), "env", f"RTAPI_FIFO_PATH={_meeting_place()}", "halrun", "-U"]


def _meeting_place() -> Path:
    """Return the working folder of HAL's programs: the same for each run of a user."""
    user = os.geteuid() or os.environ.get("SUDO_UID", "")
    return Path(tempfile.gettempdir()) / f"threadline-hal-{user}"


class HalSession:
    """A running HAL: rows for its streamer, samples from its sampler.

    Parameters
    ----------
    machine
        Machine that gives the axes and the tick.
    start
        (axes,) starting position, counts.
    plant
        Whether simulated axes, made of HAL's own components, answer; without them HAL returns the
        commands as the positions read.

    Raises
    ------
    LinkFaultError
        If HAL does not start, or differs from the expected configuration.
    """

    def __init__(self, machine: Machine, start: IntArray, *, plant: bool) -> None:
        self._axes, self._plant = len(machine.axes), plant
        tick_s = float(machine.tick_clock.period_s)
        self._depth = int(_HELD_S / tick_s) + 300
        sampler_depth = int(SAMPLED_S / tick_s) + 100
        self._folder = tempfile.TemporaryDirectory(prefix="threadline-hal-")
        self._words = as_user()
        if self._words:
            os.chown(self._folder.name, int(os.environ["SUDO_UID"]), -1)
        position_field_count = _OWN * self._axes
        self._in_force = np.zeros(self._depth, dtype=np.int64)  # version in force, for each slot
        self._fill = int(np.ceil(FILL_S / tick_s))
        self._lead = max(2, int(np.ceil(_LEAD_S / tick_s)))
        remove_left()
        self._tell(_net(machine, self._depth, sampler_depth, plant=plant))
        self._out = HalFifo(STREAMER_KEY, self._depth, "bs" + "f" * position_field_count)
        self._in = HalFifo(SAMPLER_KEY, sampler_depth, "ss" + "f" * position_field_count)
        self._end = self._taken = 0  # numbers of the next records to write and to play
        self._stands = start.astype(np.float64)
        self.fill()
        self._tell(["start"])
        if plant:
            self._begin_plant()

    # --- waiting records -------------------------------------------------------------------

    @property
    def taken(self) -> int:
        """Number of the record that is played next."""
        self._taken += (self._out.read - self._taken) % self._depth
        return self._taken

    @property
    def end(self) -> int:
        """Number of the record that would be appended next."""
        return self._end

    def fill(self) -> None:
        """Append records at rest until records for ``FILL_S`` wait."""
        self._reach(self.taken + self._fill)

    def replace(self, first: int, positions: FloatArray) -> bool:
        """Replace the waiting records from ``first`` on; after them, HAL rests.

        Parameters
        ----------
        first
            Number of a record that has not been played.
        positions
            (n, axes) counts, n >= 1, one row for each record from ``first`` on.

        Returns
        -------
        bool
            Whether the new records are in force. False: ``first`` is about to be played, and
            nothing has changed.

        Raises
        ------
        LinkFaultError
            If the fifo has no room for so many rows; or if writing took too long, so that the
            outcome is unknown: HAL comes to rest by the old or the new rows.
        """
        if first + len(positions) >= self.taken + self._depth - 2:
            raise LinkFaultError("more rows at once than the fifo of HAL has room for")
        self._reach(max(first + len(positions) + 1, self.taken + self._fill))
        if first < self.taken + self._lead:
            return False
        record_numbers = np.arange(first, self._end)
        slots = record_numbers % self._depth
        new_positions = positions[np.minimum(record_numbers - first, len(positions) - 1)]
        spare_versions = 1 - self._in_force[slots]
        for k in range(self._axes):
            self._out.numbers[slots, _OWN + k + spare_versions * self._axes] = new_positions[:, k]
        slot = first % self._depth
        self._out.words[slot, _FLIP] = 1 - self._out.words[slot, _FLIP]  # all of them at once
        if self.taken >= first:  # too late, or unknown
            raise LinkFaultError("HAL has played a row before it could be replaced")
        self._in_force[slots] = spare_versions
        self._stands = new_positions[-1]
        return True

    def _reach(self, end: int) -> None:
        """Append records that repeat the last position, up to the number ``end``."""
        if end <= self._end:
            return
        record_numbers = np.arange(self._end, end)
        slots = record_numbers % self._depth
        self._out.words[slots, _FLIP] = 0
        self._out.words[slots, _NUMBER] = record_numbers
        self._out.numbers[slots, _OWN : _OWN + 2 * self._axes] = np.tile(self._stands, 2)
        self._in_force[slots] = self._in_force[(self._end - 1) % self._depth]
        self._end = end
        self._out.written = end % self._depth

    # --- samples ---------------------------------------------------------------------------

    @property
    def lost(self) -> int:
        """Number of samples that were lost because the earlier ones were not read in time."""
        return self._in.overruns

    def samples(self) -> Samples:
        """Return the samples since the last call."""
        words, numbers = self._in.take()
        return Samples(
            record=words[:, 0],
            interval_s=np.asarray(1e-9 * words[:, 1], dtype=np.float64),
            commanded=numbers[:, _OWN : _OWN + self._axes],
            read=numbers[:, _OWN + self._axes : _OWN + 2 * self._axes],
        )

    # --- HAL itself ------------------------------------------------------------------------

    def close(self) -> None:
        """Let HAL play its remaining rows, which end at rest, and end it."""
        self._play_out()
        self._out.close()
        self._in.close()
        self._run(["halrun", "-U"])
        remove_left()  # fifos of a killed HAL would block the next one
        self._folder.cleanup()

    def _play_out(self) -> None:
        waiting, since_s = self._out.waiting, time.monotonic()
        while waiting and time.monotonic() < since_s + SILENT_S:
            time.sleep(0.01)
            if self._out.waiting != waiting:
                waiting, since_s = self._out.waiting, time.monotonic()

    def _begin_plant(self) -> None:
        """Place the plant at the start, and release it."""
        until_s = time.monotonic() + _PATIENCE_S
        while (
            not len(read_counts := self.samples().read) or (read_counts[-1] != self._stands).any()
        ):
            if time.monotonic() > until_s:
                raise LinkFaultError("HAL does not come to the start: its thread stands still")
            self.fill()
            time.sleep(0.01)
        self._tell([f"setp plant{k}.load 0" for k in range(self._axes)])

    def _tell(self, lines: list[str]) -> None:
        file = Path(self._folder.name) / "net.hal"
        file.write_text("\n".join(lines) + "\n", "ascii")
        status, output = self._run(["halcmd", "-f", str(file)])
        if status:
            raise LinkFaultError(
                f"LinuxCNC's HAL does not start: {output}", remedy="Try it by itself: halrun."
            )

    def _run(self, words: list[str]) -> tuple[int, str]:
        """Run a program of HAL; return its status, and the end of its output."""
        environment = {**os.environ, "RTAPI_FIFO_PATH": str(_meeting_place())}
        # Its child processes stay and would keep a pipe open: write to a file.
        with (Path(self._folder.name) / "said").open("w+b") as log:
            result = subprocess.run(  # noqa: S603  # words of ours
                [*self._words, *words],
                env=environment,
                cwd="/",
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                timeout=_PATIENCE_S,
                check=False,
            )
            log.seek(0)
            return result.returncode, " ".join(log.read().decode("utf-8", "replace").split())[-300:]


def _net(machine: Machine, depth: int, sampler_depth: int, *, plant: bool) -> list[str]:
    """Return the lines of a HAL file: components, functions in their order, and nets."""
    axes = range(len(machine.axes))
    period_s = machine.tick_clock.period_s
    pins = [f"told{k}" for k in axes]
    lines = [
        f"loadrt threads name1=tick period1={int(10**9 * period_s)}",
        f"loadrt streamer depth={depth} cfg=bs{'ff' * len(pins)}",
        f"loadrt sampler depth={sampler_depth} cfg=ss{'ff' * len(pins)}",
        "loadrt timedelta",
        "loadrt xor2 names=version",
        f"loadrt mux2 names={','.join(pins)}",
    ]
    functions = ["timedelta.0", "streamer.0", "version", *pins]
    nets = [
        "net flip streamer.0.pin.0 version.in0",
        f"net version version.out version.in1 {' '.join(f'{name}.sel' for name in pins)}",
        "net number streamer.0.pin.1 sampler.0.pin.0",
        "net interval timedelta.0.out sampler.0.pin.1",
    ]
    n = len(pins)
    for k, name in enumerate(pins):
        nets += [
            f"net before{k} streamer.0.pin.{_OWN + k} {name}.in0",
            f"net after{k} streamer.0.pin.{_OWN + n + k} {name}.in1",
            f"net {name} {name}.out sampler.0.pin.{_OWN + k}",
        ]
    if plant:
        answers = answers_of(machine)
        lines.append(f"loadrt lowpass names={','.join(f'plant{k}' for k in axes)}")
        for k, axis in enumerate(machine.axes):
            # On a ramp the low-pass lags by T (1 - g) / g, which must equal the lag of the
            # machine's loop.
            gain = float(period_s) / (float(period_s) + answers[axis].moments[0])
            functions.append(f"plant{k}")
            nets += [
                f"setp plant{k}.gain {gain:.17g}",
                f"setp plant{k}.load 1",
                f"net told{k} plant{k}.in",
                f"net read{k} plant{k}.out sampler.0.pin.{_OWN + n + k}",
            ]
    else:
        nets += [f"net told{k} sampler.0.pin.{_OWN + n + k}" for k in axes]
    return [*lines, *(f"addf {name} tick" for name in [*functions, "sampler.0"]), *nets]

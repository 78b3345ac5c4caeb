"""A machine and an executor in one process, on the machine's own time, without real time."""

from __future__ import annotations

import atexit
import socket
from collections import deque
from collections.abc import Callable
from functools import cache

import numpy as np

from tests.live.memory_sink import MemorySink
from threadline.files import Event, Stream, TickBlock, TickTable
from threadline.live.executor import Executor
from threadline.live.sim_machine import SimFault
from threadline.live.sim_process import simulated_of
from threadline.live.states import Desk
from threadline.live.wire import Message, decoded
from threadline.machine import Machine, load_machine

GROUP = 5
LONGEST_TICKS = 20_000  # no run of a test is that long
NEVER_READY = socket.socketpair()
for _end in NEVER_READY:
    atexit.register(_end.close)


class Wire:
    """Stand-in for a connection: a sent message is executed at once, through the same bytes."""

    def __init__(
        self, machine: Machine, start: np.ndarray | None = None, fault: SimFault | None = None
    ) -> None:
        self._answers: deque[Message] = deque()
        self.lost = False
        self.group = GROUP
        self.mute = False  # messages do not arrive any more
        self.sent: list[Message] = []
        self.before_play: Callable[[], None] = lambda: None
        counts = np.zeros(len(machine.axes), dtype=np.int64) if start is None else start
        self.machine = simulated_of(machine)(machine, counts, self._receive, fault)
        self.machine.greet()

    def _receive(self, message: Message) -> None:
        self._answers.append(decoded(message.encoded()[4:]))

    def fileno(self) -> int:
        return NEVER_READY[0].fileno()

    @property
    def waiting(self) -> bool:
        return bool(self._answers) or self.lost

    def send(self, message: Message) -> None:
        self.sent.append(message)
        if self.mute or self.lost:
            return
        self.machine.take(decoded(message.encoded()[4:]))
        if message.kind == "go":
            self.before_play()
            self.machine.play(self.group)
            self.lost = bool(self.machine.silenced)

    def receive(self, timeout_s: float | None = None) -> Message | None:
        return self._answers.popleft() if self._answers else None

    def close(self) -> None:
        self.lost = True


@cache
def winder() -> Machine:
    return load_machine("lathe-winder")


def table_of_counts(
    counts: np.ndarray, events: tuple[Event, ...] = (), start: np.ndarray | None = None
) -> TickTable:
    """Return a table of the winder: (n, 3) counts per tick."""
    machine = winder()
    return TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(3, dtype=np.int64) if start is None else start,
        blocks=Stream.of(
            [TickBlock(first_tick=0, counts=counts, operation=np.arange(len(counts)) // 50,
                       events=events)]
        ),
        job_sha256="", machine_sha256=machine.sha256,
    )  # fmt: skip


def there_and_back(peak: float = 10.0, cruise: int = 200) -> np.ndarray:
    """Return rows that accelerate to ``peak`` counts per tick, cruise and return; A turns along."""
    up = peak * (0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 60)))
    speed = np.concatenate([up, np.full(cruise, peak), up[::-1]])
    speed = np.concatenate([speed, -speed])
    places = np.cumsum(np.stack([np.abs(speed), speed, 0.4 * speed], axis=1), axis=0)
    return np.diff(np.rint(places), axis=0, prepend=0.0).astype(np.int64)


class Bench:
    """An executor with a machine."""

    def __init__(
        self,
        start: np.ndarray | None = None,
        other: Machine | None = None,
        fault: SimFault | None = None,
        same: bool = False,
    ) -> None:
        self.desk, self.sink = Desk(), MemorySink()
        self.is_machine = other if same and other is not None else winder()
        self.wire = Wire(other or winder(), start, fault)
        self.executor = Executor(
            self.wire,
            self.is_machine,
            self.desk,
            self.sink,
            speed=0.0,  # type: ignore[arg-type]
        )
        self.executor.connect()

    def __del__(self) -> None:
        self.desk.close()

    def ready(self) -> Bench:
        self.executor.enable()
        self.executor.home()
        return self

    def go_on(self, until: int | None = None) -> None:
        """Step until the machine's tick, or the end of the run."""
        executor = self.executor
        while not executor.over and (until is None or executor.tick < until):
            assert executor.tick < LONGEST_TICKS, "the run does not end"
            executor.step()

    def channel(self, name: str) -> np.ndarray:
        return np.concatenate([block.samples[name] for block in self.sink.blocks])

    def commanded(self) -> np.ndarray:
        """Return (n, axes) commanded counts at the ticks of the run."""
        machine = winder()
        return np.stack(
            [
                np.rint(self.channel(f"{name}.commanded") * scale)
                for name, scale in zip(machine.axes, machine.counts_per_unit, strict=True)
            ],
            axis=1,
        ).astype(np.int64)

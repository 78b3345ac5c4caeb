"""The simulated machine behind a link, and faults that can be injected into it.

The machine knows nothing of jobs and plans. It holds a piece of the commands that ends at rest, and
plays it tick by tick. A refill replaces the commands from a tick on; without refills the machine
comes to rest. A real machine must react in the same way to the same messages.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import ceil
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.wording import nearest
from threadline.errors import OptionError
from threadline.files import Channel, Event, RecordingBlock, RunEnd
from threadline.live.far_end import greeting, samples_per_tick
from threadline.live.wire import Message, event_row
from threadline.machine import Machine
from threadline.units import parse_number

OF_AXES = ("stuck-encoder", "encoder-jump", "unheeded-reversal")
OF_GRIDS = ("light-grid",)
OF_ALL = ("e-stop", "late-ticks", "one-late-tick", "lost-link", "power-loss")
KINDS = (*OF_AXES, "switch-hit", "stuck-contact", *OF_GRIDS, *OF_ALL)
_JUMP_COUNTS = 20_000.0
_LATEST_S = 1e9
_FORM = re.compile(r"([a-z-]+)(?::([A-Za-z_0-9]+))?@(.+)")


@dataclass(frozen=True, slots=True)
class SimFault:
    """A fault that begins at a tick of the run.

    Parameters
    ----------
    kind
        One of ``KINDS``. Faults of encoders, reversals, switches and contacts only change the
        reports to the executor; the simulated controllers keep their true readings. A broken light
        grid affects the controller, too. After a lost link the machine plays its held rows; without
        power it plays and reports nothing.
    tick
        Tick at which the fault begins.
    where
        Name of the axis, switch or contact; empty for a fault of the whole machine.
    """

    kind: str
    tick: int
    where: str = ""

    def apply(
        self, at: int, samples: dict[str, FloatArray], machine: Machine, stuck: dict[str, float]
    ) -> None:
        """Change the samples of a report from number ``at`` on, in place.

        Parameters
        ----------
        at
            First changed sample; 0 if the fault began earlier.
        samples
            (n,) samples of each channel.
        machine
            The machine, for the scale of an encoder.
        stuck
            Reading of each stuck encoder or contact; added when it begins to stick.
        """
        name = next(iter(samples), "")
        if not name or at >= len(samples[name]):
            return
        if self.kind == "stuck-encoder":
            values = samples[f"{self.where}.measured"]
            values[at:] = stuck.setdefault(self.where, float(values[at]))
        elif self.kind == "stuck-contact":
            samples[self.where][at:] = stuck.setdefault(self.where, samples[self.where][at])
        elif self.kind == "switch-hit":
            samples[self.where][at:] = 1.0
        elif self.kind == "encoder-jump":
            scale = machine.axes[self.where].counts.si
            samples[f"{self.where}.measured"][at:] += _JUMP_COUNTS / scale
        elif self.kind == "unheeded-reversal":
            samples[f"{self.where}.voltage"][at:] = np.resize([1.0, -1.0], len(samples[name]) - at)

    @property
    def cuts_supply(self) -> bool:
        """Whether it cuts the supply of the drives."""
        return self.kind in {"e-stop", "power-loss"}

    def silences(self, tick: int) -> bool:
        """Return whether the machine sends no more messages from ``tick`` on."""
        return self.kind in {"lost-link", "power-loss"} and tick >= self.tick

    def stops(self, tick: int) -> bool:
        """Return whether the emergency stop is pressed at ``tick``; it stays pressed."""
        return self.kind == "e-stop" and tick >= self.tick

    def late(self, tick: int) -> float:
        """Return the lateness of the report that begins at ``tick``, in periods of a report."""
        if tick < self.tick:
            return 0.0
        if self.kind == "late-ticks":
            return 0.8
        return 6.0 if self.kind == "one-late-tick" else 0.0


def _places(machine: Machine) -> dict[str, list[str]]:
    """Return the parts that each kind of fault can affect; not for faults of the whole machine."""
    looped_axes = [] if machine.takes_positions else list(machine.axes)
    contacts = machine.contacts.items()
    return {
        **dict.fromkeys(OF_AXES, looped_axes),
        "switch-hit": list(machine.inputs),
        "stuck-contact": [name for name, contact in contacts if contact.cylinder],
        **{kind: [n for n, contact in contacts if contact.kind == kind] for kind in OF_GRIDS},
    }


def parse_fault(text: str, machine: Machine) -> SimFault:
    """Return the fault described by a text such as ``"stuck-encoder:X@1.2 s"``.

    Raises
    ------
    OptionError
        If there is no such fault, axis, switch or time.
    """
    match = _FORM.fullmatch(text.strip())
    if match is None:
        raise OptionError(
            f"--inject {text[:40]!r} is no fault", remedy='Write it like "stuck-encoder:X@1.2 s".'
        )
    kind, where, when = match.groups()
    if kind not in KINDS:
        raise OptionError(f"there is no fault {kind[:40]!r}", remedy=nearest(kind, KINDS))
    parts_by_kind = _places(machine)
    parts = parts_by_kind.get(kind)
    if parts is not None and not parts:
        raise OptionError(
            f"--inject {kind}: {machine.name} has no part with this fault",
            remedy=f"Use one of {', '.join([k for k in KINDS if parts_by_kind.get(k, True)])}.",
        )
    if parts is not None and kind not in OF_GRIDS and where is None:
        raise OptionError(
            f"--inject {kind} does not say where",
            remedy=f'Write "{kind}:{parts[0]}@1.2 s"; {machine.name} has {", ".join(parts)}.',
        )
    if parts is not None and kind not in OF_GRIDS and where not in parts:
        raise OptionError(
            f"--inject {kind}: {machine.name} has no {where[:40]!r}",
            remedy=f"It has {', '.join(parts)}.",
        )
    if where and (parts is None or kind in OF_GRIDS):
        raise OptionError(f"--inject {kind} takes no axis", remedy=f'Write "{kind}@1.2 s".')
    time_s = parse_number("--inject", when.strip(), "s", "1.2 s")
    if not 0.0 <= time_s <= _LATEST_S:
        raise OptionError(
            f"--inject {kind}: {when.strip()[:40]!r} is no time of a run",
            remedy=f"Give one from 0 s to {_LATEST_S:g} s.",
        )
    return SimFault(kind, round(time_s / float(machine.command_clock.period_s)), where or "")


LATE = 0.5
"""Share of the period by which a report may be late."""


class SimMachine(ABC):
    """A machine that answers the messages of an executor.

    Parameters
    ----------
    machine
        The simulated machine.
    start
        Position at switch-on, which is also its home, in the units of its commands.
    tell
        Called with each message to the executor.
    fault
        Injected fault, or None.
    """

    def __init__(
        self,
        machine: Machine,
        start: IntArray,
        tell: Callable[[Message], None],
        fault: SimFault | None = None,
    ) -> None:
        self._machine, self._start, self._tell, self._fault = machine, start, tell, fault
        self._stuck = dict[str, float]()
        self._enabled = self._homed = self._begun = self._pressed = False
        self._number = 0  # of runs and jogs since it was switched on
        self.starved = False
        self.left = False  # the executor has said that it is done
        self.report_ticks = 1
        """Ticks that it plays before it reports them, unless something is urgent (``play``)."""
        self._unreported: list[RecordingBlock] = []
        self._since, self._late_by = 0, 0.0  # first unreported tick; largest lateness since then
        self._answers: dict[str, Callable[[Message], None]] = {
            "enable": self._enable, "disable": self._disable, "home": self._home,
            "begin": self._begin, "refill": self._refill, "finish": self._finish,
            "leave": self._leave, "stop-home": lambda _: None,  # it is home already
            "go": lambda _: None,  # only lets the clock go on (see ``sim_process``)
        }  # fmt: skip
        self._set_up()

    @cached_property
    def _per_tick(self) -> Fraction:
        """Samples of a recording in a tick of the commands."""
        return samples_per_tick(self._machine, self.channels)

    # --- specific to each kind of work -----------------------------------------------------

    @abstractmethod
    def _set_up(self) -> None:
        """Begin without commands, at the start; the last step of the constructor."""

    @property
    @abstractmethod
    def channels(self) -> tuple[Channel, ...]:
        """Channels that it reports."""

    @property
    @abstractmethod
    def tick(self) -> int:
        """Ticks since the beginning of the run."""

    @property
    @abstractmethod
    def held(self) -> int:
        """Number of ticks until its commands have been played, or a bound on it; 0 at rest."""

    @property
    @abstractmethod
    def position(self) -> IntArray:
        """Distance commanded since the beginning of the run, in the units of its commands."""

    @abstractmethod
    def _drop(self) -> None:
        """Drop its commands; the drives are off."""

    @abstractmethod
    def _start_anew(self) -> str:
        """Set the clock to 0 at the present position; return why that is impossible, or nothing."""

    @abstractmethod
    def _take_refill(self, message: Message) -> str:
        """Accept a refill; return why it does not fit, or nothing."""

    @abstractmethod
    def _tell_end(self, ended: RunEnd, text: str) -> None:
        """Note how the run ended."""

    @abstractmethod
    def _simulate(self, ticks: int) -> list[RecordingBlock]:
        """Go on for a number of ticks."""

    def _extra_entries(self) -> dict[str, Any]:
        """Return entries of a report beyond the common ones."""
        return {}

    def _at_home_samples(self) -> dict[str, FloatArray]:
        """Return (1,) samples of the channels whose value at home only the machine knows."""
        return {}

    def _urgent(self) -> tuple[object, ...]:
        """Return the values whose changes are reported at once."""
        return self.standing, self.starved

    # --- common to all kinds ---------------------------------------------------------------

    @property
    def silenced(self) -> str:
        """Kind of the fault that keeps it from sending messages; empty without one."""
        fault = self._fault
        return fault.kind if fault is not None and fault.silences(self.tick) else ""

    @property
    def standing(self) -> bool:
        """Whether it has no more rows to play, so that the commands stand still."""
        return not self.held

    @property
    def begun(self) -> bool:
        """Whether its clock runs."""
        return self._begun

    def rehearse(self) -> None:
        """Play a moment on another machine of this kind, so that its code is compiled or loaded.

        Loading takes a third of a second: in real time the first tick of a run would be late.
        """
        type(self)(self._machine, self._start, lambda _: None)._play_a_moment()

    def _play_a_moment(self) -> None:
        self._simulate(1)

    def greet(self) -> None:
        """Send the greeting."""
        self._say("hello", **greeting(self._machine, self.channels))

    def take(self, message: Message) -> None:
        """Act on a message of the executor, or refuse it."""
        answer = self._answers.get(message.kind)
        if message.kind != "refill":
            self._report_all()
        if answer is None:
            self._say("refused", what=message.kind, why="it is unknown here")
        else:
            answer(message)

    def play(self, ticks: int, late_by: float = 0.0) -> None:
        """Simulate a number of ticks; report them, once ``report_ticks`` were played.

        Late ticks have a report of their own, at once. A fault, the end of the rows and a
        standstill are reported at once, too.

        Parameters
        ----------
        ticks
            Number of ticks.
        late_by
            Lateness of these ticks, as a multiple of their total duration.
        """
        if self._fault is not None:
            late_by = max(late_by, self._fault.late(self.tick))
        if late_by > LATE:
            self._report_all()
        if not self._unreported:
            self._since, self._late_by = self.tick, 0.0
        urgent_before = self._urgent()
        blocks = self._simulate(ticks)
        self._unreported.extend(blocks)
        self._late_by = max(self._late_by, late_by)
        if (
            late_by > LATE
            or not blocks  # its session has failed
            or self.tick - self._since >= self.report_ticks
            or self.silenced
            or (self.pressed and self._enabled)
            or urgent_before != self._urgent()
            or any(event.kind == "fault" for block in blocks for event in block.events)
        ):
            self._report_now()

    def _report_all(self) -> None:
        """Report the ticks that were played since the last report, if there are any."""
        if self._unreported:
            self._report_now()

    def _report_now(self) -> None:
        blocks, self._unreported = self._unreported, []
        self._report(self._since, blocks, self._late_by)

    def _say(self, kind: str, **head: Any) -> None:
        self._tell(Message(kind, head))

    @property
    def pressed(self) -> bool:
        """Whether its emergency stop is pressed, which has cut the supply of its drives."""
        self._pressed = self._pressed or (
            self._begun and self._fault is not None and self._fault.stops(self.tick)
        )
        return self._pressed

    def _enable(self, _message: Message) -> None:
        if self.pressed:
            self._say("refused", what="enable", why="the emergency stop is pressed")
            return
        self._enabled = True
        self._say("enabled")

    def _disable(self, _message: Message) -> None:
        self._drop()
        self._enabled = self._homed = self._begun = False

    def _home(self, _message: Message) -> None:
        # It is switched on at its home: there is nothing to search for.
        if self._enabled:
            self._homed, self.starved = True, False
            head = {"position": (self._start + self.position).tolist()}
            self._tell(Message("homed", head, self._at_home_samples()))
        else:
            self._say("refused", what="home", why="the drives are off")

    def _begin(self, _message: Message) -> None:
        """Begin a run: the clock starts at 0, at the present position."""
        why = "it is not enabled, homed and at rest"
        if self._enabled and self._homed and self.standing and not self.starved:
            why = self._start_anew()
        if why:
            self._say("refused", what="begin", why=why)
            return
        self._begun = True
        self._number += 1

    def _refill(self, message: Message) -> None:
        """Accept a refill; refuse one that does not continue the earlier ones."""
        why = "the drives are off, or the run has not begun"
        if self._begun and self._enabled:
            why = "it has stopped since the last refill came too late" if self.starved else ""
        if why := why or self._take_refill(message):
            self._say("refused", what="refill", why=why, tick=self.tick)

    def _finish(self, message: Message) -> None:
        self._tell_end(RunEnd(message.head["ended"]), str(message.head["text"]))

    def _leave(self, _message: Message) -> None:
        self.left = True

    def _report(self, first: int, blocks: list[RecordingBlock], late_by: float) -> None:
        arrays = _joined(blocks)
        clock = self.channels[0].clock
        per_tick = self._per_tick
        sample = blocks[0].first_tick[clock.name] if blocks else ceil(first * per_tick)
        if self._fault is not None:
            first_changed = max(ceil(self._fault.tick * per_tick) - sample, 0)
            self._fault.apply(first_changed, arrays, self._machine, self._stuck)
        late_ticks = self.tick - first if late_by > LATE else 0
        events = [event_row(event) for block in blocks for event in block.events]
        if self.pressed and self._enabled:
            # With the supply of the drives cut, the motion is not simulated any more.
            why = "the emergency stop is pressed"
            events.append(event_row(Event(tick=sample, kind="fault", operation=-1, name=why)))
            self._drop()
            self._enabled = self._homed = False
        if late_ticks:
            lateness = Event(
                tick=sample, kind="late", operation=-1, value=float(late_ticks * per_tick)
            )
            events.append(event_row(lateness))
        head = {
            "run": self._number, "tick": first, "sample": sample, "now": self.tick,
            "held": self.held, "starved": self.starved, "late": late_ticks, "late_by": late_by,
            "events": events, "position": self.position.tolist(), **self._extra_entries(),
        }  # fmt: skip
        self._tell(Message("report", head, arrays))


def _joined(blocks: list[RecordingBlock]) -> dict[str, FloatArray]:
    """Return the samples of consecutive blocks, in writable arrays."""
    if len(blocks) == 1:
        return {
            name: values
            if values.dtype == np.float64 and values.flags.writeable
            else np.array(values, np.float64)
            for name, values in blocks[0].samples.items()
        }
    names = blocks[0].samples if blocks else ()
    return {
        name: np.concatenate([block.samples[name] for block in blocks]).astype(np.float64)
        for name in names
    }

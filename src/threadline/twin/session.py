"""A simulated machine that receives its commands in pieces, and halts at stops and waits.

A live simulation is a session; ``simulate`` runs a session in a loop.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.dynamics.values import Values
from threadline.errors import MachineError, OptionError
from threadline.files import Channel, ChannelKind, RecordingBlock
from threadline.machine import Machine
from threadline.twin.channels import (
    TENSION,
    run_phases,
    samples_of,
    sources_of,
    tick_channels,
)
from threadline.twin.kernel import Engine, Run
from threadline.twin.row_session import Part, RowSession, joined

if TYPE_CHECKING:
    from threadline.twin.unwinding import Unwinding

_SETTLES_S = 2.0  # time of the loops to settle under the pull of the fibre, before the first tick
_REBUILT = frozenset(("channels", "_clock", "_sources", "_readings", "_run"))


class Session(RowSession):
    """One simulated machine that receives its commands in pieces.

    The tick of the machine always goes on; one row is taken at each tick unless the rows are
    halted. While they are halted, the commanded position stands still; control loops, springs and
    friction are simulated on. The same rows give the same samples, to the bit, however they are
    divided into pieces. A session can be pickled, and continues in another process with the same
    bits.

    Parameters
    ----------
    machine
        The simulated machine; it starts at rest.
    start_counts
        (axes,) commanded position before the first row; 0 when None.
    encoder_phase
        (axes,) position of each encoder between two counts at the start, in [0, 1), or (runs, axes)
        for each run; 0.5 when None.
    record_every
        Number of ticks from sample to sample.
    quantised
        False to omit the rounding of encoders and DACs, for comparisons.
    values
        Numbers of each of several runs, simulated side by side under the same rows; None for the
        machine's numbers.
    kinds
        Kinds of the channels to record.
    engine
        An engine that was made before for this machine, values and start; it saves time.

    Attributes
    ----------
    channels
        The channels of the blocks that are returned.

    Raises
    ------
    MachineError
        If the clocks or parts of the machine cannot be simulated.
    OptionError
        If an option is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from threadline.machine.load import load_machine
    >>> from threadline.files import Event, TickBlock
    >>> session = Session(load_machine("lathe-winder"))
    >>> stop = Event(tick=2, kind="stop", operation=0)
    >>> rows = TickBlock(first_tick=0, counts=np.full((4, 3), 5), operation=np.zeros(4, np.int64),
    ...                  events=(stop,))
    >>> len(session.advance(rows).samples["X.load"]), session.halted == stop, session.queued
    (2, True, 2)
    >>> len(session.advance(ticks=100).samples["X.load"]), session.queued  # the operator is away
    (100, 2)
    >>> session.resume()
    >>> len(session.advance().samples["X.load"]), session.queued
    (2, 0)
    """

    def __init__(
        self,
        machine: Machine,
        *,
        start_counts: IntArray | None = None,
        encoder_phase: FloatArray | None = None,
        record_every: int = 1,
        quantised: bool = True,
        values: Values | None = None,
        kinds: Collection[ChannelKind] = tuple(ChannelKind),
        engine: Engine | None = None,
    ) -> None:
        if record_every < 1:
            raise OptionError(f"record_every must be at least 1, got {record_every}")
        super().__init__(machine, start_counts)
        self._values = Values.of(machine) if values is None else values
        self._phases = run_phases(machine, encoder_phase, self._values.count)
        self._kinds = tuple(kinds)
        self._every, self._quantised = record_every, quantised
        start_si = self._start / machine.counts_per_unit
        self._fibre: Unwinding | None = None
        if machine.unwinds:
            from threadline.twin.unwinding import Unwinding  # only for winders with a spool

            self._fibre = Unwinding(machine, self._values, start_si)
        self._begin(engine)
        if self._fibre is not None:
            self._run.settle(self._fibre.pulls, _SETTLES_S)

    def _begin(self, engine: Engine | None) -> None:
        machine = self._machine
        if engine is None:
            start_si = self._start / machine.counts_per_unit
            engine = Engine(machine, self._values, start_si)
        self.channels: tuple[Channel, ...] = tick_channels(machine, self._every, self._kinds)
        self._clock = machine.tick_clock.name
        self._sources = sources_of(machine, self.channels, self._start)
        self._readings = tuple(one.reading for one in self._sources if one.reading is not None)
        self._run: Run = engine.start(
            self._phases,
            watch_current=ChannelKind.CURRENT in self._kinds,
            quantised=self._quantised,
        )

    def __getstate__(self) -> dict[str, Any]:
        state = {name: value for name, value in vars(self).items() if name not in _REBUILT}
        return {**state, "snapshot": self._run.snapshot()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        snapshot = state.pop("snapshot")
        vars(self).update(state)
        self._begin(None)
        self._run.restore(snapshot)

    @property
    def tick(self) -> int:
        """Number of ticks simulated so far."""
        return self._run.tick

    def _tripped(self, name: str) -> bool:
        return self._run.tripped(name)

    # --- samples ---------------------------------------------------------------------------

    def _read(self, part: Part) -> Mapping[Any, FloatArray]:
        read = self._advanced(part)
        failure = self._run.failure()
        if failure is not None:
            axes, why = failure
            raise MachineError(
                f"axes {', '.join(axes)}: the simulation has no answer, {why}",
                remedy="Check stiffness, friction and gains in the machine file.",
            )
        return read

    def _advanced(self, part: Part) -> Mapping[Any, FloatArray]:
        """Advance by as many ticks as there are rows; return the samples."""
        travelled, operations = part.travelled, part.operation.tolist()
        own = tuple(one for one in self._readings if one is not TENSION)
        fibre = self._fibre
        if fibre is None:
            return self._run.advance(travelled, own, every=self._every)
        counts = self._machine.counts_per_unit
        start_si, runs = self._start / counts, self._values.count
        first, every = self.tick, self._every
        samples = -(-(first + len(travelled)) // every) - -(-first // every)
        read = {one: np.empty((samples, runs)) for one in self._readings}
        at = 0
        for row in range(len(travelled)):
            now = self._run.advance(travelled[row : row + 1], own, every=every)
            if (first + row) % every == 0:
                for one in own:
                    read[one][at] = now[one][0]
                if TENSION in read:
                    read[TENSION][at] = fibre.tension_n
                at += 1
            place, rate = self._run.loads()
            commanded = start_si + travelled[row] / counts
            fibre.advance(commanded, start_si + place, rate, operations[row])
            self._run.pull(fibre.pulls)
        return read

    def _block(self, first: int, parts: list[Part]) -> RecordingBlock:
        begin = -(-first // self._every) * self._every
        whole = (
            parts[0]
            if len(parts) == 1
            else joined(parts, len(self._position), self._values.count, self._readings)
        )
        recorded_rows = slice(begin - first, None, self._every)
        samples = samples_of(self._sources, whole.read, whole.travelled[recorded_rows])
        samples["operation"] = whole.operation[recorded_rows].astype(np.float64)
        events, self._pending_events = tuple(self._pending_events), []
        return RecordingBlock(first_tick={self._clock: begin}, samples=samples, events=events)

"""A switch schedule as the Petri net that a PLC plays: one token, places and transitions.

A place is a state of all outputs; the token leaves it when the milliseconds since the last wait
reach a due time, or when an input is there. Place 0 has every output off.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from threadline.errors import PlanError
from threadline.targets.schedule import Scheduled


@dataclass(frozen=True, slots=True, kw_only=True)
class NetPlace:
    """A place and the transition out of it.

    Parameters
    ----------
    number
        From 1, in the order in which the token visits them.
    step
        Step of the cycle.
    on
        Outputs that are on.
    due_ms
        The token leaves this long after the origin; of a waiting place, its timeout.
    wait
        Input that is waited for, and its value; the time of the input is the next origin.
    begin_tick, origin_tick
        Scans of the schedule at which the token arrives, and from which its time counts.
    """

    number: int
    step: str
    on: tuple[str, ...]
    due_ms: int
    wait: tuple[str, bool] | None = None
    begin_tick: int = 0
    origin_tick: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class PetriNet:
    """The net of a schedule.

    Parameters
    ----------
    outputs
        All outputs, in the order of the machine.
    places
        In order; the transition out of the last leads back to place 0.
    scan_ms
        Period of the scan.
    """

    outputs: tuple[str, ...]
    places: tuple[NetPlace, ...]
    scan_ms: int


def petri_net(scheduled: Scheduled) -> PetriNet:
    """Return the net of ``scheduled``.

    Raises
    ------
    PlanError
        If the scan is not a whole number of milliseconds.
    """
    commands = scheduled.commands
    period_ms = commands.clock.period_s * 1000
    if period_ms.denominator != 1:
        raise PlanError(
            f"the scan {commands.clock.name!r} is {float(period_ms):g} ms; a PLC counts whole ones",
            remedy="Give the scan in whole milliseconds.",
        )
    scan_ms = int(period_ms)
    timeouts = iter(scheduled.wait_timeouts_s)
    # Rows of a tick take effect before a wait at that tick begins.
    marks: list[tuple[int, int, str, object]] = [
        (int(tick), 1, "row", tuple(int(v) for v in row))
        for tick, row in zip(commands.ticks, commands.levels, strict=True)
    ]
    for event in commands.events:
        if event.kind == "tool":
            marks.append((event.tick, 0, "step", event.name))
        elif event.kind == "wait":
            marks.append((event.tick, 2, "wait", (event.name, bool(event.value), next(timeouts))))
    marks.sort(key=lambda mark: mark[:2])
    walk = _Walk(commands.outputs, scan_ms)
    for tick, _, kind, payload in marks:
        walk.pass_mark(tick, kind, payload)
    walk.close(commands.duration_ticks)
    return PetriNet(outputs=commands.outputs, places=tuple(walk.places), scan_ms=scan_ms)


class _Walk:
    """Follows the token through the schedule."""

    def __init__(self, outputs: tuple[str, ...], scan_ms: int) -> None:
        self.outputs, self.scan_ms = outputs, scan_ms
        self.places: list[NetPlace] = []
        self.step, self.on = "", tuple[str, ...]()
        self.origin = self.arrival = 0
        self.pending = False

    def pass_mark(self, tick: int, kind: str, payload: object) -> None:
        if kind == "step":
            # Outputs that stay as they are still change place, so that the step can be seen.
            if self.pending:
                self._leave(tick)
            self.step = str(payload)
            self._arrive(tick)
        elif kind == "row":
            assert isinstance(payload, tuple)
            if self.pending and tick > self.arrival:
                self._leave(tick)
            self.on = tuple(n for n, v in zip(self.outputs, payload, strict=True) if v)
            self._arrive(tick)
        else:
            assert isinstance(payload, tuple)
            if self.pending and tick > self.arrival:
                self._leave(tick)
            self._wait(tick, *payload)

    def _arrive(self, tick: int) -> None:
        self.arrival, self.pending = tick, True

    def _ms(self, tick: int) -> int:
        return (tick - self.origin) * self.scan_ms

    def _leave(self, tick: int) -> None:
        if tick > self.arrival:
            self._add(self._ms(tick), None)
        self.pending = False

    def _wait(self, tick: int, name: str, value: bool, timeout_s: float) -> None:
        self.arrival = tick
        scans = math.ceil(1000.0 * timeout_s / self.scan_ms - 1e-9)
        self._add(self._ms(tick) + scans * self.scan_ms, (name, value))
        # The token arrives in the next place at once; its rows come at the next scan.
        self.origin = self.arrival = tick
        self.pending = True

    def _add(self, due_ms: int, wait: tuple[str, bool] | None) -> None:
        self.places.append(
            NetPlace(
                number=len(self.places) + 1,
                step=self.step,
                on=self.on,
                due_ms=due_ms,
                wait=wait,
                begin_tick=self.arrival,
                origin_tick=self.origin,
            )
        )

    def close(self, tick: int) -> None:
        if self.pending:
            self._leave(max(tick, self.arrival + 1))

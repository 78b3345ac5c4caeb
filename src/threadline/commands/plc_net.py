"""The Petri net of a schedule, and valid names for PLC programs.

A place is a state of all outputs. The token leaves a place when the milliseconds since the last
wait reach the due time, or when an input is there. Place 0 has every output off. A name has
letters, digits and single underscores, and is no word of the language.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

from threadline.commands.intents import Scheduled
from threadline.errors import PlanError
from threadline.files import Creep

_WORDS = """
abs absolute_time acos action add and any any_bit any_date any_derived any_elementary any_int
any_magnitude any_num any_real any_string array asin at atan bool by byte cal calc calcn call
case char class concat configuration constant continue cos ct ctd ctu ctud date date_and_time
delete dint div do dt dword else elsif en end_action end_case end_class end_configuration end_for
end_function end_function_block end_if end_interface end_method end_namespace end_program
end_repeat end_resource end_step end_struct end_transition end_type end_var end_while eno eq exit
exp expt extends f_edge f_trig false final find for from function function_block ge gt if
implements in initial_step insert int interface internal interval jmp jmpc jmpcn ld ldate
ldate_and_time ldn ldt le left len limit lint ln log lreal lt ltime ltime_of_day ltod lword max
method mid min mod move mul mux namespace ne neg non_retain not null of on or orn overlap override
pou pointer priority private program protected public r r1 r_edge r_trig read_only read_write real
ref ref_to reference repeat replace resource ret retain retc retcn return right rol ror rs rtc s
s1 sel sema shl shr sin single sint sqrt sr st step stn string struct sub super t tan task then
this time time_of_day to tod tof ton tp transition true trunc type udint uint ulint until ups
using usint var var_access var_config var_external var_global var_in_out var_input var_output
var_temp wchar while with word wstring xor xorn andn clk cu cv cd pv q qd qu et pt
"""
RESERVED = frozenset(_WORDS.split())
"""Keywords, types, standard functions, standard blocks and their pins, in lower case."""
_MAX_LENGTH = 30


class Names:
    """Gives out valid and unique names in one program, without regard to case.

    Parameters
    ----------
    taken
        Names already used in the program.
    """

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = {name.lower() for name in taken}

    def give(self, preferred: str) -> str:
        """Return a valid name as close to ``preferred`` as possible.

        >>> names = Names()
        >>> names.give("step"), names.give("x-low"), names.give("X_low"), names.give("2nd__try")
        ('step_signal', 'x_low', 'X_low_2', 'n2nd_try')
        """
        name = re.sub(r"[^A-Za-z0-9]+", "_", preferred).strip("_") or "unnamed"
        name = name[:_MAX_LENGTH].rstrip("_")
        if name[0].isdigit():
            name = f"n{name}"
        if name.lower() in RESERVED:
            name = f"{name}_signal"
        unique, count = name, 1
        while unique.lower() in self._taken or unique.lower() in RESERVED:
            count += 1
            unique = f"{name}_{count}"
        self._taken.add(unique.lower())
        return unique


@dataclass(frozen=True, slots=True, kw_only=True)
class NetPlace:
    """A place and the transition out of it.

    Parameters
    ----------
    number
        Number from 1, in the order in which the token visits the places.
    step
        Step of the cycle.
    on
        Outputs that are on.
    due_ms
        Time since the origin at which the token leaves; for a waiting place, the timeout; for an
        opening, its length.
    wait
        Awaited input and its value; the time of the input is the next origin.
    creep
        How a cylinder creeps in a waiting place; its tick is the tick of the wait.
    opens
        Whether the place is an opening of the creep of the place before it, to which the token then
        returns; it has the same wait.
    begin_tick, origin_tick
        Scans of the schedule at which the token arrives and at which its time count begins.
    """

    number: int
    step: str
    on: tuple[str, ...]
    due_ms: int
    wait: tuple[str, bool] | None = None
    begin_tick: int = 0
    origin_tick: int = 0
    creep: Creep | None = None
    opens: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class PetriNet:
    """The net of a schedule.

    Parameters
    ----------
    outputs
        All outputs, in the order of the machine.
    places
        Places in order; the transition out of the last one leads back to place 0.
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
    creeps = {creep.tick: creep for creep in commands.creeps}
    # Rows of a tick take effect before a wait at the same tick begins.
    marks: list[tuple[int, int, str, object]] = [
        (int(tick), 1, "row", tuple(int(v) for v in row))
        for tick, row in zip(commands.ticks, commands.levels, strict=True)
    ]
    for event in commands.events:
        if event.kind == "tool":
            marks.append((event.tick, 0, "step", event.name))
        elif event.kind == "wait":
            wait = event.name, bool(event.value), next(timeouts), creeps.get(event.tick)
            marks.append((event.tick, 2, "wait", wait))
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
            # A new step begins a new place even if no output changes, so that the step is visible.
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

    def _wait(
        self, tick: int, name: str, value: bool, timeout_s: float, creep: Creep | None
    ) -> None:
        self.arrival = tick
        scans = math.ceil(1000.0 * timeout_s / self.scan_ms - 1e-9)
        due_ms = self._ms(tick) + scans * self.scan_ms
        self._add(due_ms, (name, value), creep)
        if creep is not None:
            on = tuple(n for n, v in zip(self.outputs, creep.levels, strict=True) if v)
            opened = replace(self.places[-1], number=len(self.places) + 1, on=on)
            opens_ms = creep.opens * self.scan_ms
            self.places.append(replace(opened, due_ms=opens_ms, creep=None, opens=True))
        # The token arrives in the next place immediately; the rows come at the next scan.
        self.origin = self.arrival = tick
        self.pending = True

    def _add(self, due_ms: int, wait: tuple[str, bool] | None, creep: Creep | None = None) -> None:
        self.places.append(
            NetPlace(
                number=len(self.places) + 1,
                step=self.step,
                on=self.on,
                due_ms=due_ms,
                wait=wait,
                begin_tick=self.arrival,
                origin_tick=self.origin,
                creep=creep,
            )
        )

    def close(self, tick: int) -> None:
        if self.pending:
            self._leave(max(tick, self.arrival + 1))

"""Comparison of PLC programs with the schedule of a plan, for ``equal``: scan by scan.

``scan_language`` reads the program, and ``Controller`` runs it: home, start, one cycle. The end
switches follow the simulated machine that plays the plan. Each input that no cylinder moves comes
at the scan at which the plan waits for it. The outputs that the program then switches are compared,
scan by scan, with the switchings of the plan.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from threadline.base.arrays import IntArray
from threadline.commands.intents import Scheduled
from threadline.machine import Machine
from threadline.readback.equal_found import Curve, Found, refusing
from threadline.readback.scan_language import (
    FIRST_VALUES,
    TIMER,
    Declared,
    Statement,
    Unit,
    Variables,
)
from threadline.readback.scan_units import ReadProgram, of_plcopen, of_scl, of_text
from threadline.readback.scan_words import ScanError
from threadline.twin.switching import SwitchOptions, simulate_switching

SCANS = 1
"""Scans by which a switching of the program may differ from the plan's."""
_MOST_HOME = 60_000  # scans that homing may take
_BUTTONS = {"start": "start", "acknowledge": "acknowledge", "home": "home"}
_HELD_CONTACTS = ("light-grid", "enable")
_DEEPEST = 8  # blocks in one another; a sequence has two


def compare_schedule(target: str, scheduled: Scheduled, path: Path) -> Found:
    """Run the program in a file, and compare it with the schedule of a plan.

    Parameters
    ----------
    target
        ``st``, ``openplc``, ``plcopen`` or ``scl``.

    Raises
    ------
    RecordingError
        If the file holds no such program, or another version of Threadline wrote it, or it was
        written for another job or machine.
    """
    cycle = scheduled.one_cycle
    with refusing(f"program of target {target}", target, path):
        program = _READERS[target](path)
        controller = Controller(program.units, program.addresses)
        _check_addresses(controller, cycle.machine)
    period_us = round(1e6 * float(cycle.commands.clock.period_s))
    played = _played(cycle, period_us)
    notes = []
    if program.interval_us not in (None, period_us):
        interval_ms = (program.interval_us or 0) / 1e3
        notes.append(f"its task runs every {interval_ms:g} ms, the plan has {period_us / 1e3:g} ms")
    try:
        switchings = _run(controller, cycle, played, program.interval_us or period_us)
    except ScanError as error:
        switchings, fault = np.zeros((0, len(cycle.commands.outputs)), dtype=np.int64), str(error)
    else:
        fault = ""
    return _compared(cycle, played, switchings, "; ".join([*notes, *([fault] if fault else [])]))


def _check_addresses(controller: Controller, machine: Machine) -> None:
    located = {name: contact.address for name, contact in machine.contacts.items()}
    located |= {name: output.address for name, output in machine.outputs.items()}
    for name, address in located.items():
        if address not in controller.addresses:
            raise ScanError(f"nothing in it has the address {address} of {name}")


@dataclass(frozen=True, slots=True, eq=False)
class _Played:
    """The plan on the simulated machine: n scans of outputs and contacts."""

    outputs: IntArray
    contacts: Mapping[str, IntArray]


def _played(cycle: Scheduled, period_us: int) -> _Played:
    """Play the schedule on the nominal machine, and sample it once per scan."""
    machine, commands = cycle.machine, cycle.commands
    recording = simulate_switching(commands, machine, SwitchOptions(after_s=0.0))
    blocks = list(recording.blocks)
    columns = {
        channel.name: np.concatenate([block.samples[channel.name] for block in blocks])
        for channel in recording.channels
    }
    ends = [event for block in blocks for event in block.events if event.kind == "wait"]
    samples = len(columns[commands.outputs[0]])
    sample_index = np.arange(0, samples * 1000, period_us) // 1000
    outputs = np.column_stack([columns[name][sample_index] > 0.5 for name in commands.outputs])
    contacts = {
        name: (columns[name][sample_index] > 0.5).astype(np.int64) for name in machine.contacts
    }
    scans = [int(event.tick) * 1000 // period_us for event in ends]
    for name, contact in machine.contacts.items():
        waits_for_it = [
            (scan, int(event.value)) for scan, event in zip(scans, ends, strict=True)
            if event.name == name
        ]  # fmt: skip
        if contact.kind in _HELD_CONTACTS:
            contacts[name][:] = 1
        elif contact.kind != "contact":
            contacts[name][:] = 0
        elif contact.cylinder is None:
            contacts[name] = _uncylindered_states(
                waits_for_it, outputs[:, _vacuums(machine, commands.outputs)].astype(np.int64)
            )
    return _Played(outputs.astype(np.int64), contacts)


def _vacuums(machine: Machine, outputs: tuple[str, ...]) -> list[int]:
    return [k for k, name in enumerate(outputs) if machine.outputs[name].kind == "vacuum"]


def _uncylindered_states(waits: list[tuple[int, int]], vacuums: IntArray) -> IntArray:
    """Return the states of a contact that no cylinder closes: it comes when the plan waits for it.

    After a wait it stays until a vacuum is switched off; without one, until halfway to the next
    wait.
    """
    count = len(vacuums)
    if not waits:
        return np.ones(count, dtype=np.int64)
    switched_off = np.flatnonzero((np.diff(vacuums, axis=0) < 0).any(axis=1)) + 1
    state = np.full(count, 1 - waits[0][1], dtype=np.int64)
    for k, (scan, value) in enumerate(waits):
        state[scan:] = value
        follows = k + 1 < len(waits)
        end, next_value = waits[k + 1] if follows else (count, value)
        released = switched_off[(switched_off > scan) & (switched_off < end)]
        if len(released):
            state[released[0] :] = 1 - next_value
        elif follows:
            state[(scan + end) // 2 :] = 1 - next_value
    return state


def _run(controller: Controller, cycle: Scheduled, played: _Played, scan_us: int) -> IntArray:
    """Bring the program home, start a cycle, and return its (n, outputs) switchings.

    The first row is of the scan in which the start button is down.
    """
    machine = cycle.machine
    button = {
        kind: next(name for name, c in machine.contacts.items() if c.kind == kind)
        for kind in _BUTTONS
    }
    names = {name: controller.addresses[c.address] for name, c in machine.contacts.items()}
    output_addresses = [machine.outputs[name].address for name in cycle.commands.outputs]
    now_us = 0

    def scan(contacts: Mapping[str, int]) -> list[bool]:
        nonlocal now_us
        now_us += scan_us
        state = controller.scan({names[n]: bool(v) for n, v in contacts.items()}, now_us)
        return [state(address) for address in output_addresses]

    contacts_at_rest = {name: int(column[0]) for name, column in played.contacts.items()}
    for pressed in ((), ("acknowledge",), ()):
        scan({**contacts_at_rest, **{button[kind]: 1 for kind in pressed}})
    outputs_on = scan({**contacts_at_rest, button["home"]: 1})
    if not any(outputs_on):
        raise ScanError("the program does not begin its way home")
    for _ in range(_MOST_HOME):
        if not any(outputs_on):
            break
        outputs_on = scan(contacts_at_rest)
    else:
        raise ScanError("the program never comes home")
    scan(contacts_at_rest)
    rows = []
    for k in range(len(played.outputs)):
        contacts_now = {name: int(column[k]) for name, column in played.contacts.items()}
        rows.append(scan({**contacts_now, button["start"]: int(k == 0)}))
    return np.array(rows, dtype=np.int64)


def _compared(cycle: Scheduled, played: _Played, found: IntArray, note: str) -> Found:
    period_s = float(cycle.commands.clock.period_s)
    planned, notes = played.outputs, [note] if note else []
    if not len(found):
        found = np.zeros_like(planned)
    times, scans_apart, names = [], [], []
    for k, name in enumerate(cycle.commands.outputs):
        planned_scans, found_scans = (_changes(rows[:, k]) for rows in (planned, found))
        if len(planned_scans) != len(found_scans) and not note:
            notes.append(
                f"{name}: {len(found_scans)} switchings, the plan has {len(planned_scans)}"
            )
        count = min(len(planned_scans), len(found_scans))
        times += planned_scans[:count].tolist()
        scans_apart += (found_scans[:count] - planned_scans[:count]).tolist()
        names += [f"{name} at scan {scan}" for scan in planned_scans[:count].tolist()]
    order = np.argsort(times, kind="stable")
    scans = np.array(scans_apart, dtype=np.int64)[order]
    names = [names[k] for k in order.tolist()]
    worst = int(np.argmax(np.abs(scans))) if len(scans) else 0
    axis, off_m, limit_m = _stroke(cycle, planned, found, period_s)
    return Found(
        reader="a PLC of IEC 61131-3, scan by scan",
        place=off_m,
        place_limit=limit_m,
        unit="m" if cycle.machine.cylinders[axis].kind == "linear" else "rad",
        axis=axis,
        time_s=period_s * float(abs(scans[worst])) if len(scans) else 0.0,
        time_limit_s=SCANS * period_s,
        at=names[worst] if len(scans) and scans[worst] else "",
        wrong="; ".join(notes),
        curve=Curve(
            time_s=period_s * np.array(times, dtype=np.float64)[order],
            late_s=period_s * scans.astype(np.float64),
        ),
    )


def _changes(column: IntArray) -> IntArray:
    return np.flatnonzero(np.diff(column, prepend=0))


def _stroke(
    cycle: Scheduled, planned: IntArray, found: IntArray, period_s: float
) -> tuple[str, float, float]:
    """Return the cylinder whose stroke differs most by its limit, the difference, and the limit.

    The stroke is speed times level, summed as long as the valve and a flow of the cylinder are
    open.
    """
    worst = ("", 0.0, 0.0)
    column = {name: k for k, name in enumerate(cycle.commands.outputs)}
    for axis, cylinder in cycle.machine.cylinders.items():
        level, largest_flow = np.zeros(len(planned)), 0.0
        for direction, sign in ((cylinder.forward, 1.0), (cylinder.back, -1.0)):
            for flow, size in direction.flows.items():
                flow_on = [
                    rows[:, column[direction.valve]] * rows[:, column[flow]]
                    for rows in (found, planned)
                ]
                level += sign * size.si * (flow_on[0] - flow_on[1])
            largest_flow = max(largest_flow, sum(size.si for size in direction.flows.values()))
        off = float(np.abs(np.cumsum(level)).max(initial=0.0)) * cylinder.speed.si * period_s
        limit = SCANS * largest_flow * cylinder.speed.si * period_s
        if not worst[0] or off * worst[2] > worst[1] * limit:
            worst = (axis, off, limit)
    return worst


_READERS: Mapping[str, Callable[[Path], ReadProgram]] = {
    "st": of_text, "openplc": of_text, "plcopen": of_plcopen, "scl": of_scl,
}  # fmt: skip


class OnDelay:
    """The on-delay timer TON of IEC 61131-3, in microseconds."""

    def __init__(self) -> None:
        self.values: Variables = {"in": False, "pt": 0, "q": False, "et": 0}
        self._since_us: int | None = None

    def call(self, pins: Variables, now_us: int) -> None:
        """Run it once, with new values of its inputs."""
        values = self.values
        values.update(pins)
        if not values["in"]:
            self._since_us = None
            values["q"], values["et"] = False, 0
            return
        if self._since_us is None:
            self._since_us = now_us
        elapsed = now_us - self._since_us
        values["q"] = elapsed >= values["pt"]
        values["et"] = min(elapsed, values["pt"])


class Instance:
    """A function block, or the program, with its own variables.

    Raises
    ------
    ScanError
        If the unit has no body, contains itself, or a variable has an unknown type.
    """

    def __init__(
        self, unit: Unit, units: Mapping[str, Unit], around: tuple[Unit, ...] = ()
    ) -> None:
        if unit.body is None:
            raise ScanError(f"{unit.name} has no body")
        self._body: Statement = unit.body
        self.values: Variables = {}
        for name, declared in unit.declared.items():
            self.values[name] = _first_value(declared, units, (*around, unit))

    def call(self, pins: Variables, now_us: int) -> None:
        """Run it once, with new values of its inputs."""
        self.values.update(pins)
        self._body(self.values, now_us)


def _first_value(
    declared: Declared, units: Mapping[str, Unit], outer_units: tuple[Unit, ...]
) -> object:
    if declared.type == TIMER:
        return OnDelay()
    if declared.type in units:
        if units[declared.type] in outer_units:
            raise ScanError(f"{declared.name} is of a block that has it inside itself")
        if len(outer_units) > _DEEPEST:
            raise ScanError(f"blocks stand more than {_DEEPEST} deep in one another")
        return Instance(units[declared.type], units, outer_units)
    if declared.type not in FIRST_VALUES:
        raise ScanError(f"{declared.name} is of the unknown type {declared.type.upper()}")
    return FIRST_VALUES[declared.type] if declared.initial is None else declared.initial


class Controller:
    """The one program of a text: inputs in, outputs out.

    Parameters
    ----------
    units
        Programs and function blocks of the text.
    addresses
        Address by name of the program's variables; the text's own if not given.

    Raises
    ------
    ScanError
        If there is not one program, or a type is unknown.
    """

    def __init__(self, units: Sequence[Unit], addresses: Mapping[str, str] | None = None) -> None:
        programs = [unit for unit in units if unit.kind == "program"]
        if len(programs) != 1:
            raise ScanError(f"it has {len(programs)} programs, and 1 is expected")
        by_name = {unit.name: unit for unit in units}
        if len(by_name) != len(units):
            raise ScanError("two of its units have one name")
        declared_addresses = {
            name: variable.address for name, variable in programs[0].declared.items()
        }
        located = {**declared_addresses, **(addresses or {})}
        self.addresses = {address: name for name, address in located.items() if address}
        self._instance = Instance(programs[0], by_name)

    def scan(self, inputs: Mapping[str, bool], now_us: int) -> Callable[[str], bool]:
        """Run one scan at ``now_us``; return a function from an address to its state then.

        Parameters
        ----------
        inputs
            State by name of a variable of the program.

        Raises
        ------
        ScanError
            If the program cannot go on.
        """
        try:
            self._instance.call(dict(inputs), now_us)
        except (
            ArithmeticError, AttributeError, KeyError, MemoryError, RecursionError, TypeError,
        ) as error:  # fmt: skip
            text = f"{type(error).__name__} {error}"
            raise ScanError(f"the program cannot go on: {text}") from error
        values = self._instance.values
        return lambda address: bool(values[self.addresses[address]])

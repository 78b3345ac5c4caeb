"""IEC 61131-3 structured text of a schedule: a function block that plays its Petri net.

It is written as two files, units and configuration, or as one file for OpenPLC. The text is
standard (second and third edition): it calls no vendor functions, declares and types every name,
and puts located variables in a VAR block of their own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from threadline import __version__
from threadline.base.wording import st_comment
from threadline.base.writing import content_of, together
from threadline.commands.intents import Scheduled
from threadline.commands.plc_net import Names, PetriNet
from threadline.commands.plc_sequence import (
    CREEP_NAMES,
    FAULTS,
    Block,
    PlcProgram,
    Pou,
    Sequence,
    Variable,
    Words,
    sequence_of,
)
from threadline.commands.plc_watch import air_ms
from threadline.commands.schedule_moves import shaping_words
from threadline.commands.structured_text_body import body_lines, branches_in_scan
from threadline.commands.structured_text_panel import HAND_NAMES, hand_constants, hand_state
from threadline.commands.structured_text_table import (
    LISTED,
    MOST_PLACES,
    TABLE_NAMES,
    Tables,
    named_places,
    table_state,
    tables_of,
)
from threadline.errors import Place, PlanError
from threadline.files.formats.common import Written, atomic_file, written
from threadline.machine import Machine

_PANEL_INPUTS = {
    "continuous": ("BOOL", "cycle after cycle; single cycles else"),
    "stop_at_end": ("BOOL", "ends continuous cycles at the end of this one"),
    "manual": ("BOOL", "by hand, where no cycle runs"),
    "jog": ("INT", "action by hand; 0 for none"),
}
_PANEL_OUTPUTS = {
    "busy": ("BOOL", "FALSE", "a cycle or the way home runs"),
    "finished": ("BOOL", "FALSE", "the cycle ran to its end"),
    "homed": ("BOOL", "FALSE", "every piston is home"),
    "stopped": ("BOOL", "FALSE", "it was broken off"),
    "fault": ("BOOL", "FALSE", "until it is acknowledged"),
    "fault_code": ("INT", "0", "one of the constants no_fault, f_..."),
    "fault_place": ("INT", "0", "the place in which it stopped"),
    "fault_contact": ("INT", "0", "the input that it is about, c_...; 0 for none"),
    "place": ("INT", "0", "the step counter: one of the constants s_..."),
    "count": ("DINT", "0", "cycles since power-on"),
    "step_text": ("STRING", "'idle'", ""),
    "hint_text": ("STRING", "''", "why nothing happens, and the next action"),
    "fault_text": ("STRING", "''", ""),
    "fault_step": ("STRING", "''", "the step in which it stopped"),
    "contact_text": ("STRING", "''", ""),
    "contact_address": ("STRING", "''", ""),
}
_INTERNAL = (
    "origin", "elapsed", "late", "allowed", "start_before", "home_before", "acknowledge_before",
    "cycle_timer", "scan_timer", "cause", "culprit", "ending", "sequence",
    *CREEP_NAMES, *HAND_NAMES, *TABLE_NAMES, *_PANEL_INPUTS, *_PANEL_OUTPUTS, *FAULTS,
)  # fmt: skip
_ONCE = ("start", "acknowledge", "home")


OPENPLC = ("Config0", "Res0")
"""Names of configuration and resource with OpenPLC, whose build moves and compiles the files
``Config0.c`` and ``Res0.c``."""


def plc_program(scheduled: Scheduled, cell: tuple[str, str] = ("cell", "cpu")) -> PlcProgram:
    """Return the program units of ``scheduled``; ``cell`` names configuration and resource.

    Raises
    ------
    PlanError
        If the machine lacks an input that a program needs, a cylinder cannot be brought home, or
        the net cannot be built.
    """
    machine = scheduled.machine
    assert machine.plc is not None
    roles = {kind: _of_kind(machine, kind) for kind in ("light-grid", "enable", *_ONCE)}
    names = Names(_INTERNAL)
    # First, so that these names stay unchanged.
    configuration, resource = names.give(cell[0]), names.give(cell[1])
    block_name, main_name = names.give(scheduled.job.name), names.give(f"{machine.name}_main")
    inputs = {contact: names.give(contact) for contact in machine.contacts}
    outputs = {output: names.give(output) for output in machine.outputs}
    sequence = sequence_of(scheduled, names, inputs, outputs)
    net = sequence.net
    if len(sequence.places) > MOST_PLACES:
        raise PlanError(
            f"the list has {len(sequence.places)} places, and a PLC numbers {MOST_PLACES} at most",
            place=Place(scheduled.job.file),
            remedy="Divide the list.",
        )
    free = [
        named.place.wait
        for named in sequence.cycle
        if named.place.wait is not None and machine.contacts[named.place.wait[0]].cylinder is None
    ]
    words = Words(
        inputs=inputs,
        outputs=outputs,
        grids=tuple(inputs[n] for n in roles["light-grid"]),
        enables=tuple(inputs[n] for n in roles["enable"]),
        start=inputs[roles["start"][0]],
        acknowledge=inputs[roles["acknowledge"][0]],
        home=inputs[roles["home"][0]],
        fresh={
            wait: names.give(f"{wait[0]}_was_{'off' if wait[1] else 'on'}")
            for wait in dict.fromkeys(free)
        },
        watchdog_ms=round(1000.0 * machine.plc.watchdog.si),
        early_ms=net.scan_ms // 2,
        air_ms=air_ms(machine, net.scan_ms),
        dwell_ms=_dwell_ms(machine),
    )
    tables = tables_of(sequence, words, names) if len(sequence.places) > LISTED else None
    block = Pou(
        kind="FUNCTION_BLOCK",
        name=block_name,
        notes=_notes(scheduled, net),
        blocks=tuple(_block_variables(words, sequence, tables)),
        body=tuple(body_lines(sequence, words, machine, tables)),
    )
    main = _main(machine, words, block_name, main_name)
    return PlcProgram(
        block=block,
        main=main,
        configuration=configuration,
        resource=resource,
        task=names.give("timed"),
        instance=names.give("machine"),
        interval_ms=net.scan_ms,
    )


_BRANCH_US = 2.0
"""Time of a branch with its comparisons on a small controller, us; a fast one needs a tenth."""
_LARGE = 0.25
"""Share of the scan that the branches may take before the program is called large."""
_LARGE_KB = 1000.0
_WIDTH = 100  # characters of a line in an array


def sized(scheduled: Scheduled, program: PlcProgram, path: Path) -> Written:
    """Return the written file with its size and the time of a scan, and a warning if it is long."""
    branches, scan_ms = branches_in_scan(program.block.body), program.interval_ms
    takes_ms = 1e-3 * _BRANCH_US * branches
    branching = f"{branches} branches in a scan take about {takes_ms:.3g} ms of {scan_ms} ms"
    kilobytes = content_of(path).stat().st_size / 1000.0
    fact = f"{branching} at {_BRANCH_US:g} us each; {kilobytes:.0f} kB of text"
    large = (
        f"the program is large: {branching} at {_BRANCH_US:g} us each; more than "
        f"{_LARGE * 100.0:g} % of it is much for a small PLC. Measure its scan time, take a faster "
        "PLC or a longer scan, or divide the list",
        f"the program is large: {kilobytes:.0f} kB of text; a small PLC holds some hundred. Divide "
        "the list, or take a larger PLC",
    )
    over = (takes_ms > _LARGE * scan_ms, kilobytes > _LARGE_KB)
    warned = (text for text, applies in zip(large, over, strict=True) if applies)
    return replace(written(path, (*scheduled.warnings, *warned)), facts=(fact,))


def _of_kind(machine: Machine, kind: str) -> list[str]:
    found = [name for name, contact in machine.contacts.items() if contact.kind == kind]
    if not found or (kind in _ONCE and len(found) > 1):
        raise PlanError(
            f"machine {machine.name!r} has {len(found)} contacts of kind {kind!r}; a PLC program "
            f"needs {'exactly' if kind in _ONCE else 'at least'} one",
            remedy=f'Add contacts with kind = "{kind}" to the machine file.',
        )
    return found


def _dwell_ms(machine: Machine) -> int:
    """Return the longest of the minimum times between two switchings of a valve, ms."""
    assert machine.plc is not None
    strokes = [way for c in machine.cylinders.values() for way in (c.forward, c.back)]
    dwells_s = [machine.plc.dwell.si, *(way.least_hold_s(machine.plc) for way in strokes)]
    return math.ceil(1000.0 * max(dwells_s) - 1e-9)


def _notes(scheduled: Scheduled, net: PetriNet) -> tuple[str, ...]:
    assert scheduled.machine.plc is not None
    cycle_s = scheduled.commands.duration_ticks * net.scan_ms / 1000.0
    return (
        f"Written by Threadline {__version__}",
        f"Job {scheduled.job.name}, sha256 {scheduled.job.sha256[:16]}",
        f"Machine {scheduled.machine.name}, sha256 {scheduled.machine.sha256[:16]}",
        "Compiling proves nothing: threadline prove of this list on this machine gives a verdict.",
        f"A cycle takes {cycle_s:.3f} s where every input comes as soon as it is waited for.",
        f"Call it every {net.scan_ms} ms from a timed task. Place idle has every output off.",
        "A broken light grid, a missing enable, a late scan, or a contact that cannot be believed",
        "switches all outputs off in the same scan. Then: acknowledge, home, start.",
        "Power-on, work by hand and every fault ask for home before a start.",
        "Times t_... count from the input that came last, or from the start of the run.",
        "It is no safety function: what protects people has to cut the air without it.",
        *(f"{axis}: {_shaped(scheduled, axis)}" for axis in scheduled.machine.cylinders),
        *(
            f"{axis} creeps to a late end switch: "
            f"{scheduled.machine.cylinders[axis].place(one['opening_m'], '.2g')} each "
            f"{one['every_s']:.3g} s, until it is there or its time limit is over."
            for axis, one in scheduled.creeping.items()
        ),
    )


def _shaped(scheduled: Scheduled, axis: str) -> str:
    """Return words for the shaping of a cylinder's moves."""
    shaping = scheduled.shaping.get(axis)
    plain = all(move.levels.levels == (1.0, 0.0) for move in scheduled.moves if move.axis == axis)
    return shaping_words(shaping) if shaping or plain else "each move as the move list says"


def _block_variables(words: Words, sequence: Sequence, tables: Tables | None) -> Iterator[Block]:
    yield Block(
        kind="VAR_INPUT",
        variables=(
            *(Variable(name=n, type="BOOL") for n in words.inputs.values()),
            *_panel_inputs(),
        ),
    )
    yield Block(
        kind="VAR_OUTPUT",
        variables=(
            *(Variable(name=n, type="BOOL", initial="FALSE") for n in words.outputs.values()),
            *_panel_outputs(),
        ),
    )
    named = None if tables is None else named_places(sequence)
    yield Block(
        kind="VAR CONSTANT",
        variables=(*sequence.constants(words.outputs, named), *hand_constants(words)),
    )
    if tables is not None:
        yield Block(kind="VAR CONSTANT", variables=tables.arrays)
    more = () if tables is None else table_state()
    yield Block(kind="VAR", variables=(*_state(words, sequence), *more))


def _panel_inputs() -> Iterator[Variable]:
    for name, (kind, note) in _PANEL_INPUTS.items():
        yield Variable(name=name, type=kind, note=note)


def _panel_outputs() -> Iterator[Variable]:
    for name, (kind, initial, note) in _PANEL_OUTPUTS.items():
        yield Variable(name=name, type=kind, initial=initial, note=note)


def _state(words: Words, sequence: Sequence) -> Iterator[Variable]:
    yield Variable(name="origin", type="TIME", initial="T#0ms", note="of the last input")
    yield Variable(name="elapsed", type="TIME", initial="T#0ms", note="since the origin")
    for name in ("late", "allowed", "ending"):
        yield Variable(name=name, type="BOOL", initial="FALSE")
    yield Variable(name="cause", type="INT", initial="0", note="of a stop in this scan")
    yield Variable(name="culprit", type="INT", initial="0", note="the input that it is about")
    # TRUE at power-on: a button held at power-on is not a fresh press.
    for name in ("start_before", "home_before", "acknowledge_before"):
        yield Variable(name=name, type="BOOL", initial="TRUE")
    for name in words.fresh.values():
        yield Variable(name=name, type="BOOL", initial="FALSE")
    if sequence.creeps:
        for name, note in zip(
            CREEP_NAMES, ("of the next opening", "of its end", "of its rest"), strict=True
        ):
            yield Variable(name=name, type="TIME", initial="T#0ms", note=note)
    for one in sequence.guarded:
        yield Variable(name=one.expect, type="INT", initial="0")
        yield Variable(name=one.early, type="TIME", initial="T#0ms")
        yield Variable(name=one.gone, type="TIME", initial="T#0ms")
    yield from hand_state()
    yield Variable(name="cycle_timer", type="TON", derived=True)
    yield Variable(name="scan_timer", type="TON", derived=True)


def _main(machine: Machine, words: Words, block_name: str, name: str) -> Pou:
    located = [
        Variable(name=words.inputs[n], type="BOOL", address=contact.address)
        for n, contact in machine.contacts.items()
    ] + [
        Variable(name=words.outputs[n], type="BOOL", address=output.address)
        for n, output in machine.outputs.items()
    ]
    arguments = ", ".join(f"{n} := {n}" for n in (*words.inputs.values(), *_PANEL_INPUTS))
    body = [f"sequence({arguments});"]
    body += [f"{n} := sequence.{n};" for n in (*words.outputs.values(), *_PANEL_OUTPUTS)]
    return Pou(
        kind="PROGRAM",
        name=name,
        notes=(
            "Feeds the block from the inputs and writes its outputs, once a scan. What has no",
            "address is for a panel.",
        ),
        blocks=(
            Block(kind="VAR", variables=tuple(located)),
            Block(
                kind="VAR",
                variables=(
                    *_panel_inputs(),
                    *_panel_outputs(),
                    Variable(name="sequence", type=block_name, derived=True),
                ),
            ),
        ),
        body=tuple(body),
    )


def pou_text(pou: Pou) -> list[str]:
    """Return the lines of one program unit."""
    lines = [f"{pou.kind} {pou.name}", *(f"(* {st_comment(note)} *)" for note in pou.notes)]
    for block in pou.blocks:
        lines.append(block.kind)
        lines += [f"  {_declaration(variable)}" for variable in block.variables]
        lines.append("END_VAR")
    return [*lines, "", *pou.body, f"END_{pou.kind}"]


def _declaration(variable: Variable) -> str:
    at = f" AT {variable.address}" if variable.address else ""
    kind, initial = variable.type, f" := {variable.initial}" if variable.initial else ""
    if variable.values:
        kind = f"ARRAY [0..{len(variable.values) - 1}] OF {kind}"
        initial = f" := {_array_literal(variable)}"
    note = f" (* {st_comment(variable.note)} *)" if variable.note else ""
    return f"{variable.name}{at} : {kind}{initial};{note}"


def _array_literal(variable: Variable) -> str:
    """Return the values of an array in lines of some hundred characters; equal ones as a count."""
    lines, line = list[str](), "["
    for literal, count in variable.runs:
        line += f"{literal}, " if count == 1 else f"{count}({literal}), "
        if len(line) > _WIDTH:
            lines.append(line.rstrip())
            line = "    "
    return "\n".join((*lines, line)).rstrip(", \n") + "]"


def configuration_text(program: PlcProgram) -> list[str]:
    """Return the configuration: the timed task and the program in it."""
    return [
        f"CONFIGURATION {program.configuration}",
        f"  RESOURCE {program.resource} ON PLC",
        f"    TASK {program.task}(INTERVAL := T#{program.interval_ms}ms, PRIORITY := 0);",
        f"    PROGRAM {program.instance} WITH {program.task} : {program.main.name};",
        "  END_RESOURCE",
        "END_CONFIGURATION",
    ]


@dataclass(frozen=True, slots=True)
class StructuredText:
    """Two texts: the program units, and the configuration, which some tools do not import."""

    units: str
    configuration: str


def structured_text(
    scheduled: Scheduled, cell: tuple[str, str] = ("cell", "cpu")
) -> StructuredText:
    """Return the structured text of ``scheduled``; ``cell`` names configuration and resource.

    Raises
    ------
    PlanError
        As ``plc_program``.
    """
    program = plc_program(scheduled, cell)
    units = [*pou_text(program.block), "", *pou_text(program.main)]
    return StructuredText("\n".join(units) + "\n", "\n".join(configuration_text(program)) + "\n")


def write_structured_text(scheduled: Scheduled, path: Path) -> list[Written]:
    """Write the units to ``path`` and the configuration beside it, ``NAME.configuration.st``."""
    text = structured_text(scheduled)
    beside = path.with_name(f"{path.stem}.configuration.st")
    with together():
        for file, content in ((path, text.units), (beside, text.configuration)):
            with atomic_file(file) as stream:
                stream.write(content.encode("ascii"))
        return [sized(scheduled, plc_program(scheduled), path), written(beside)]


def write_openplc(scheduled: Scheduled, path: Path) -> list[Written]:
    """Write units and configuration to ``path`` as the one file that OpenPLC takes."""
    text = structured_text(scheduled, OPENPLC)
    with atomic_file(path) as stream:
        stream.write(f"{text.units}\n{text.configuration}".encode("ascii"))
    return [sized(scheduled, plc_program(scheduled), path)]

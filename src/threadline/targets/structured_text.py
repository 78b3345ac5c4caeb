"""IEC 61131-3 structured text of a schedule: a block that plays its Petri net, scan by scan.

Standard text only (second and third edition): no vendor's functions, every name declared and
typed, located variables in a VAR block of their own.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from threadline.errors import PlanError
from threadline.escaping import st_comment
from threadline.machine import Machine
from threadline.signals.files.common import Written, atomic_file, written
from threadline.targets.plc_names import Names
from threadline.targets.plc_net import PetriNet, petri_net
from threadline.targets.plc_pou import Block, PlcProgram, Pou, Variable
from threadline.targets.schedule import Scheduled
from threadline.targets.schedule_moves import shaping_words
from threadline.targets.structured_text_body import Words, body_lines
from threadline.writing import together

_INTERNAL = (
    "place", "origin", "elapsed", "late", "allowed", "start_before", "cycle_timer", "scan_timer",
    "busy", "finished", "fault", "stopped", "sequence",
)  # fmt: skip


def plc_program(scheduled: Scheduled) -> PlcProgram:
    """Return the program units of ``scheduled``.

    Raises
    ------
    PlanError
        If the machine has no light grid, no enable or no start input, or the net can't be made.
    """
    machine, net = scheduled.machine, petri_net(scheduled)
    assert machine.plc is not None
    roles = {kind: _of_kind(machine, kind) for kind in ("light-grid", "enable", "start")}
    names = Names(_INTERNAL)
    block_name, main_name = names.give(scheduled.job.name), names.give(f"{machine.name}_main")
    inputs = {contact: names.give(contact) for contact in machine.contacts}
    outputs = {output: names.give(output) for output in machine.outputs}
    words = Words(
        inputs=inputs,
        outputs=outputs,
        clear=tuple(inputs[n] for n in (*roles["light-grid"], *roles["enable"])),
        start=inputs[roles["start"][0]],
        watchdog_ms=round(1000.0 * machine.plc.watchdog.si),
        early_ms=net.scan_ms // 2,
    )
    block = Pou(
        kind="FUNCTION_BLOCK",
        name=block_name,
        notes=_notes(scheduled, net),
        blocks=_block_variables(words, net),
        body=tuple(body_lines(net, words)),
    )
    main = _main(machine, words, block_name, main_name)
    return PlcProgram(
        block=block,
        main=main,
        configuration=names.give("cell"),
        resource=names.give("cpu"),
        task=names.give("timed"),
        instance=names.give("machine"),
        interval_ms=net.scan_ms,
    )


def _of_kind(machine: Machine, kind: str) -> list[str]:
    found = [name for name, contact in machine.contacts.items() if contact.kind == kind]
    if not found or (kind == "start" and len(found) > 1):
        raise PlanError(
            f"machine {machine.name!r} has {len(found)} contacts of kind {kind!r}; a PLC program "
            f"needs {'exactly' if kind == 'start' else 'at least'} one",
            remedy=f'Add contacts with kind = "{kind}" to the machine file.',
        )
    return found


def _notes(scheduled: Scheduled, net: PetriNet) -> tuple[str, ...]:
    assert scheduled.machine.plc is not None
    return (
        f"Job {scheduled.job.name}, sha256 {scheduled.job.sha256[:16]}",
        f"Machine {scheduled.machine.name}, sha256 {scheduled.machine.sha256[:16]}",
        f"Call it every {net.scan_ms} ms from a timed task. Place 0 has every output off.",
        "A broken light grid, a missing enable or a late scan switches all outputs off in the",
        "same scan; only a new rising edge of the start input begins again, from place 1.",
        "It is no safety function: what protects people has to cut the air without it.",
        *(
            f"{axis}: {shaping_words(scheduled.shaping.get(axis))}"
            for axis in scheduled.machine.cylinders
        ),
    )


def _block_variables(words: Words, net: PetriNet) -> tuple[Block, ...]:
    return (
        Block(
            kind="VAR_INPUT",
            variables=tuple(Variable(name=n, type="BOOL") for n in words.inputs.values()),
        ),
        Block(
            kind="VAR_OUTPUT",
            variables=(
                *(Variable(name=n, type="BOOL", initial="FALSE") for n in words.outputs.values()),
                Variable(name="busy", type="BOOL", initial="FALSE", note="the cycle runs"),
                Variable(name="finished", type="BOOL", initial="FALSE", note="it ran to its end"),
                Variable(name="stopped", type="BOOL", initial="FALSE", note="it was broken off"),
                Variable(name="fault", type="BOOL", initial="FALSE", note="late scan or input"),
            ),
        ),
        Block(
            kind="VAR",
            variables=(
                Variable(name="place", type="INT", initial="0", note=f"0 to {len(net.places)}"),
                Variable(name="origin", type="TIME", initial="T#0ms", note="of the last input"),
                Variable(name="elapsed", type="TIME", initial="T#0ms", note="since the origin"),
                Variable(name="late", type="BOOL", initial="FALSE"),
                Variable(name="allowed", type="BOOL", initial="FALSE"),
                # TRUE at power-on: a button that is held then is no fresh start.
                Variable(name="start_before", type="BOOL", initial="TRUE"),
                Variable(name="cycle_timer", type="TON", derived=True),
                Variable(name="scan_timer", type="TON", derived=True),
            ),
        ),
    )


def _main(machine: Machine, words: Words, block_name: str, name: str) -> Pou:
    located = [
        Variable(name=words.inputs[n], type="BOOL", address=contact.address)
        for n, contact in machine.contacts.items()
    ] + [
        Variable(name=words.outputs[n], type="BOOL", address=output.address)
        for n, output in machine.outputs.items()
    ]
    arguments = ", ".join(f"{n} := {n}" for n in words.inputs.values())
    body = [f"sequence({arguments});"]
    body += [f"{n} := sequence.{n};" for n in words.outputs.values()]
    return Pou(
        kind="PROGRAM",
        name=name,
        notes=("Feeds the block from the inputs and writes its outputs, once a scan.",),
        blocks=(
            Block(kind="VAR", variables=tuple(located)),
            Block(
                kind="VAR", variables=(Variable(name="sequence", type=block_name, derived=True),)
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
    initial = f" := {variable.initial}" if variable.initial else ""
    note = f" (* {st_comment(variable.note)} *)" if variable.note else ""
    return f"{variable.name}{at} : {variable.type}{initial};{note}"


def configuration_text(program: PlcProgram) -> list[str]:
    """Return the configuration: the timed task and the program that runs in it."""
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
    """The two texts: program units, and the configuration that not every tool imports."""

    units: str
    configuration: str


def structured_text(scheduled: Scheduled) -> StructuredText:
    """Return the structured text of ``scheduled``.

    Raises
    ------
    PlanError
        As ``plc_program``.
    """
    program = plc_program(scheduled)
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
        return [written(path, scheduled.warnings), written(beside)]

"""The reader of part programs."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from threadline.errors import BudgetError, JobError, MachineError, OptionError, Place
from threadline.jobs.gcode.block import CHANGE
from threadline.jobs.gcode.dialects import DIALECTS, Dialect, Reading, dialect_of
from threadline.jobs.gcode.f_words import f_rule, normal_feed_m_s
from threadline.jobs.gcode.findings import Findings
from threadline.jobs.gcode.interpreter import PartProgram
from threadline.jobs.gcode.parametric.program import ParametricProgram, is_parametric
from threadline.jobs.gcode.parametric.survey import survey
from threadline.jobs.gcode.scan import Scanner
from threadline.jobs.gcode.subprograms import Structure
from threadline.jobs.gcode.textfile import SourceFile, identify
from threadline.jobs.gcode.words import ONE
from threadline.jobs.gcode.work_offsets import zeros_of
from threadline.jobs.operations import Job, MoveRun, Operation, OperationStream
from threadline.machine import Machine
from threadline.signals import Stream

_RESERVED = "EFGLMNOP"
_MAX_WARNINGS = 5


def read_part_program(
    path: str | Path,
    *,
    machine: Machine,
    dialect: str | None = None,
    feed_mode: str | None = None,
    base_axes: tuple[str, ...] = (),
) -> Job:
    """Return the job of a part program.

    The file is read once here: every block is checked, and the moves are counted, with the passes
    of calls multiplied. The job reads the file again in every iteration.

    Parameters
    ----------
    path
        A program in the dialect of ``docs/part-programs.md``.
    machine
        Machine whose axes the program may move.
    dialect
        Name of the dialect; that of the machine file when None.
    feed_mode, base_axes
        Rule for the meaning of F (``threadline.jobs.gcode.f_words``); that of the machine file, or
        else of the dialect, when None.

    Raises
    ------
    JobError
        With file and line, if the program cannot be read, or the machine has no axes.
    BudgetError
        If it has more moves than the machine's tick budget.
    OptionError
        If the options do not fit together.
    """
    path = Path(path)
    if not machine.axis_names:
        raise JobError(
            f"{machine.name!r} has no axes for part programs",
            place=Place(str(path)),
            remedy="Such a machine takes move lists (.toml); choose another job or machine (-m).",
        )
    for name in machine.axis_names:
        if name in _RESERVED:
            raise MachineError(
                f"the axis {name} of {machine.name!r} has the letter of another word",
                remedy="A part program moves axes A B C U V W X Y Z.",
            )
    spoken = _dialect(machine, dialect)
    rule = f_rule(machine, feed_mode, tuple(base_axes), spoken.feed_rule)
    file = identify(path)
    axes = {name: index for index, name in enumerate(machine.axis_names)}
    reading = Reading(str(path), machine.name, axes, spoken)
    linear = tuple(axis.kind == "linear" for axis in machine.axes.values())
    program: PartProgram | ParametricProgram
    if spoken.flavour is not None and is_parametric(file):
        surveyed = survey(file, reading, linear, rule, machine)
        program, findings = surveyed.program, surveyed.findings
        moved, label = surveyed.moved, None
    else:
        scanner = Scanner(file, reading)
        structure = scanner.run()
        if structure.totals[structure.main.label].moves == 0:
            raise JobError(
                f"{structure.main.name} moves nothing",
                place=file.place(structure.main.line),
                remedy="Name a file with a program that moves an axis.",
            )
        _check_budget(structure, file, machine)
        systems = zeros_of(scanner.systems, machine, file)
        program = PartProgram(file, reading, linear, rule, systems, structure)
        findings, moved = scanner.findings, scanner.moved_axes
        label = structure.main.label
    return Job(
        name=path.name,
        file=str(path),
        sha256=file.sha256,
        axes=machine.axis_names,
        start=(0.0,) * len(machine.axis_names),
        operations=OperationStream(Stream(_runs, program), Stream(_folded, program)),
        warnings=_warnings(findings, file, spoken),
        capped=_capped(findings, moved, label, machine, file),
        feed_rule=rule.text,
        dialect=spoken.name,
    )


def _runs(program: PartProgram | ParametricProgram) -> Iterator[Operation | MoveRun]:
    return program.runs()


def _folded(
    program: PartProgram | ParametricProgram,
) -> Iterator[tuple[Operation | MoveRun, int, int]]:
    return program.folded()


def _dialect(machine: Machine, option: str | None) -> Dialect:
    name = dialect_of(machine, option)
    if name not in DIALECTS:
        raise OptionError(
            f"there is no dialect {name[:40]!r} of part programs",
            remedy=f"Choose {', '.join(DIALECTS)}.",
        )
    return DIALECTS[name]


def _check_budget(structure: Structure, file: SourceFile, machine: Machine) -> None:
    """Refuse more operations than the tick budget: each takes at least one tick."""
    budget = int(machine.tick_budget.si)
    main = structure.main
    totals = structure.totals[main.label]
    needed = totals.operations
    if needed <= budget:
        return
    call = max(
        main.calls.items(),
        key=lambda item: item[1].passes * structure.totals[item[0]].operations,
        default=None,
    )
    line = main.line if call is None else call[1].line
    asked = f"{needed}" if needed < 10**15 else "more than 10^15"
    raise BudgetError(
        f"the program asks for {asked} operations with all passes; the machine's tick budget is "
        f"{budget} and each counts as a tick at least",
        place=file.place(line),
        remedy="Lower L, or raise tick_budget in the machine file.",
    )


def _capped(
    findings: Findings, moved: list[int], label: int | None, machine: Machine, file: SourceFile
) -> tuple[str, ...]:
    used = moved or range(len(machine.axis_names))  # G28 alone names none
    caps_m_s = normal_feed_m_s(machine)
    if machine.operator is None or caps_m_s is None:
        return ()
    cap_m_s = min(caps_m_s[i] for i in used)
    caps = ", ".join(f"{machine.axis_names[i]} {1e3 * caps_m_s[i]:.1f}" for i in used)
    speeds_m_s = [
        (line, feed, feed * tenth_mm / (600_000 * ONE))
        for (feed, tenth_mm), line in findings.feeds.speeds(label).items()
    ]
    return _first(
        f"{file.place(line)}: F {feed / ONE:g} is {1e3 * speed_m_s:.1f} mm/s, above the "
        f"normal feed of {machine.operator.normal_feed.si:g} count/tick ({caps} mm/s), "
        "which caps it. Choose another feed with --feed, or raise operator.normal_feed."
        for line, feed, speed_m_s in speeds_m_s
        if speed_m_s > cap_m_s
    )


def _warnings(findings: Findings, file: SourceFile, dialect: Dialect) -> tuple[str, ...]:
    warnings = [
        f"{file.place(line)}: P of G4 is in seconds; a thousand or more looks like milliseconds."
        for line in findings.long_dwells
    ]
    warnings += [
        f"{file.place(line)}: G64 is for other controllers; here the interpolation decides how "
        "corners are rounded."
        for line in findings.blends
    ]
    if findings.rapid_f and not dialect.rapid_is_feed:
        warnings.append(
            f"{file.place(findings.rapid_f)}: F of a G0 sets the feed of later moves; the G0 "
            "itself goes as fast as the limits allow."
        )
    if findings.changes and CHANGE in dialect.grammar.of_sender:
        warnings.append(
            f"{file.place(findings.changes)}: {dialect.name} itself refuses M6; what sends the "
            "program must take it out and stop there, as it is read here."
        )
    if findings.anew:
        lines = ", ".join(map(str, findings.anew[:_MAX_WARNINGS]))
        more = " ..." if len(findings.anew) > _MAX_WARNINGS else ""
        warnings.append(
            f"{file.place(findings.anew[0])}: M2 and M30 (lines {lines}{more}) set G1 G17 G54 G90 "
            "G94 and end nothing: grbl goes on with what its sender sends. One that takes them out "
            "leaves the modes as they are."
        )
    if findings.unset:
        first = next(iter(findings.unset.items()))
        names = " ".join(f"#{which}" for which in list(findings.unset)[:_MAX_WARNINGS])
        more = " ..." if len(findings.unset) > _MAX_WARNINGS else ""
        warnings.append(
            f"{file.place(first[1])}: parameters that the program has not set are 0 here "
            f"({names}{more}); the control may have kept another value from an earlier program."
        )
    if findings.doubtful:
        warnings.append(
            f"{file.place(findings.doubtful)}: the numbers compared differ by rounding: LinuxCNC "
            "2.9 finds LE and GE untrue of them, and EQ true up to 0.0001; later versions find all "
            "three true, up to 0.000001. Here it is done as in 2.9."
        )
    if findings.waits:
        warnings.append(
            f"{file.place(findings.waits)}: the program waits for a temperature; how long is not "
            "known, and no part of any time here."
        )
    if findings.idle:
        words = ", ".join(f"{w} (line {line})" for w, line in findings.idle.items())
        warnings.append(f"{file.place()}: without effect on motion, first seen: {words}.")
    return _first(warnings)


def _first(warnings: Iterable[str]) -> tuple[str, ...]:
    found = tuple(warnings)
    if len(found) <= _MAX_WARNINGS:
        return found
    return (
        *found[:_MAX_WARNINGS],
        f"{len(found) - _MAX_WARNINGS} more warnings of these kinds.",
    )

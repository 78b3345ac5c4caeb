"""Warnings of a part program: words without effect here, or with another meaning elsewhere."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from threadline.jobs.gcode.block import CHANGE
from threadline.jobs.gcode.dialects import SILENT, Dialect
from threadline.jobs.gcode.feeds import normal_feed_m_s
from threadline.jobs.gcode.foreign import FILAMENT, LETTERS
from threadline.jobs.gcode.scan import Findings
from threadline.jobs.gcode.textfile import SourceFile, first_found
from threadline.jobs.gcode.words import ONE
from threadline.machine import Machine

_MAX_WARNINGS = 5


def capped_feeds(
    findings: Findings, moved: list[int], label: int | None, machine: Machine, file: SourceFile
) -> tuple[str, ...]:
    """Return warnings of feeds above the normal feed of the operator, which caps them.

    Parameters
    ----------
    moved
        Indices of the axes that the program moves; the normal feed of the slowest counts.
    label
        Number of the main program; None for a program with parameters.
    """
    used_axes = moved or range(len(machine.axis_names))  # G28 without axis words names no axis
    caps_m_s = normal_feed_m_s(machine)
    if machine.operator is None or caps_m_s is None:
        return ()
    cap_m_s = min(caps_m_s[i] for i in used_axes)
    caps = ", ".join(f"{machine.axis_names[i]} {1e3 * caps_m_s[i]:.1f}" for i in used_axes)
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


def program_warnings(findings: Findings, file: SourceFile, dialect: Dialect) -> tuple[str, ...]:
    """Return warnings about findings of the scan, each with file and line."""
    warnings = list(_long_dwells(findings, file, dialect))
    blends = (
        "this G64 does not count: the interpolation decides how corners are rounded, and with "
        "--interpolation firmware [planner] of the machine file (tolerance is P of G64, "
        "cam_tolerance is Q)."
        if dialect.name == "linuxcnc"
        else "G64 is for other controllers; here the interpolation decides how corners are rounded."
    )
    warnings += [f"{file.place(line)}: {blends}" for line in findings.blends]
    if findings.rapid_f and not dialect.rapid_is_feed:
        warnings.append(
            f"{file.place(findings.rapid_f)}: F of a G0 sets the feed of later moves; the G0 "
            "itself goes as fast as the limits allow."
        )
    if findings.changes and CHANGE in dialect.grammar.of_sender:
        warnings.append(
            f"{file.place(findings.changes)}: {dialect.name} itself refuses M6; the sender program "
            "must remove it and stop there, as the plan does."
        )
    if findings.length:
        warnings.append(
            f"{file.place(findings.length)}: only the control knows the tool length of G43; "
            "it holds for every move of Z, and the program's zero is at the start position."
        )
    if findings.macros:
        macros = ", ".join(f"{name} (line {line})" for name, line in findings.macros.items())
        warnings.append(
            f"{file.place()}: macros, first seen: {macros}: the plan rests there, and does not "
            "include their moves and their time."
        )
    if findings.limits:
        warnings.append(
            f"{file.place(findings.limits)}: limits that the program sets apply with "
            "--interpolation firmware, as in klipper; other interpolations use the limits of the "
            "machine file."
        )
    if findings.decel:
        warnings.append(
            f"{file.place(findings.decel)}: ACCEL_TO_DECEL is read as a minimum cruise ratio of "
            "1 - ACCEL_TO_DECEL / ACCEL; klipper ignores it from August 2025 on."
        )
    if findings.tape:
        warnings.append(
            f"{file.place(findings.tape)}: {dialect.name} answers error:1 to a line with %, at "
            "which many senders stop: take these lines out."
        )
    warnings += _realtime(file, dialect)
    if findings.anew:
        lines = ", ".join(map(str, findings.anew[:_MAX_WARNINGS]))
        dots = " ..." if len(findings.anew) > _MAX_WARNINGS else ""
        warnings.append(
            f"{file.place(findings.anew[0])}: M2 and M30 (lines {lines}{dots}) set G1 G17 G54 G90 "
            "G94 and do not end the program: grbl runs the lines after them. A sender that removes "
            "them leaves the modes as they are."
        )
    if findings.unset:
        first_unset = next(iter(findings.unset.items()))
        names = " ".join(f"#{number}" for number in list(findings.unset)[:_MAX_WARNINGS])
        dots = " ..." if len(findings.unset) > _MAX_WARNINGS else ""
        warnings.append(
            f"{file.place(first_unset[1])}: parameters that the program has not set are 0 here "
            f"({names}{dots}); the control may have kept another value from an earlier program."
        )
    if findings.doubtful:
        warnings.append(
            f"{file.place(findings.doubtful)}: the compared numbers differ only by rounding: in "
            "LinuxCNC 2.9 EQ is true up to a difference of 0.0001, LE and GE are not; in later "
            "versions all three are true up to 0.000001. Threadline compares as 2.9 does."
        )
    if findings.waits:
        warnings.append(
            f"{file.place(findings.waits)}: the program waits for a temperature; this time is not "
            "known, and no time here includes it."
        )
    if findings.idle:
        words = ", ".join(f"{word} (line {line})" for word, line in findings.idle.items())
        silent = " ".join(
            word for word in findings.idle if word[1:].isdigit() and int(word[1:]) in SILENT
        )
        left_out = f" compile leaves out words that only show or store: {silent}." * bool(silent)
        dropped = " ".join(word for word in findings.idle if word in LETTERS + FILAMENT)
        left_out += f" compile writes no {dropped}: --axes leaves it out." * bool(dropped)
        warnings.append(f"{file.place()}: without effect on motion, first seen: {words}.{left_out}")
    return _first(warnings)


def _long_dwells(findings: Findings, file: SourceFile, dialect: Dialect) -> Iterator[str]:
    """Yield a warning of the first dwell that looks like milliseconds in place of seconds."""
    for line, dwell_s in list(findings.long_dwells.items())[:1]:
        if dialect.dwell_s.get("P") != (1.0, 1.0):
            return
        further = len(findings.long_dwells) - 1
        others = (
            f" ({further} more {'line waits' if further == 1 else 'lines wait'} as long)"
            * bool(further)
        )
        yield (
            f"{file.place(line)}: this G4 waits {dwell_s:g} s{others}: {dialect.name} takes P as "
            f"seconds. If milliseconds were meant, write P{dwell_s * 1e-3:g}."
        )


_ACT_NOW = {"!": "stops the feed", "~": "resumes after a stop", "?": "asks for a report"}


def _realtime(file: SourceFile, dialect: Dialect) -> list[str]:
    """Return a warning of characters that act at once if a sender sends comments, too."""
    if not dialect.grammar.realtime:
        return []
    line, letter = first_found(file, dialect.grammar.realtime)
    if not line:
        return []
    effect = _ACT_NOW.get(letter, "stops the machine or changes an override")
    return [
        f"{file.place(line)}: {dialect.name} acts on {letter!r} as soon as it is sent, even within "
        f"a comment: it {effect}. Use a sender that leaves comments out, or delete ! ~ ? and all "
        "letters that are not ASCII."
    ]


def _first(warnings: Iterable[str]) -> tuple[str, ...]:
    all_warnings = tuple(warnings)
    if len(all_warnings) <= _MAX_WARNINGS:
        return all_warnings
    return (
        *all_warnings[:_MAX_WARNINGS],
        f"{len(all_warnings) - _MAX_WARNINGS} more warnings of these kinds.",
    )

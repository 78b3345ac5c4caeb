"""The body of a sequence's function block in structured text."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import groupby

from threadline.commands.plc_sequence import CREEP_NAMES, Guarded, Sequence, Words
from threadline.commands.plc_watch import NamedPlace, reads, switches_of
from threadline.commands.structured_text_panel import hand_lines, panel_texts, plain_text
from threadline.commands.structured_text_table import (
    Tables,
    looked_up,
    table_interlocks,
    table_outputs,
    table_steps,
    table_transitions,
)
from threadline.machine import Machine

_LONGEST = "PT := T#24h"


def body_lines(
    sequence: Sequence, words: Words, machine: Machine, tables: Tables | None
) -> Iterator[str]:
    """Yield the lines of the body, with ``tables`` for a long sequence."""
    yield from _watchdog(words)
    yield from _guards(words, sequence)
    yield from _buttons(words, sequence)
    yield from _clock(words, sequence, tables)
    yield from _plausible(words, sequence, machine)
    yield from _stop(sequence)
    if tables is None:
        yield "(* The transitions, in order: several may fire in one scan. *)"
        for run in (sequence.cycle, sequence.homing):
            yield from _transitions(run, words, sequence)
        yield ""
        yield from _steps(sequence)
        yield from _interlocks(words, sequence)
    else:
        first, second = (tuple(_end(run, words, sequence)) for run in (True, False))
        yield from table_transitions(sequence, words, tables, (first, second))
        yield from table_steps()
        yield from table_interlocks(sequence, words, tables)
    yield from _stop(sequence)
    if tables is None:
        yield from _outputs(words, sequence)
    else:
        yield from table_outputs(sequence, words, tables)
    yield from hand_lines(sequence, words)
    yield from panel_texts(sequence, words, machine)
    yield f"busy := place <> {sequence.idle};"


def _watchdog(words: Words) -> Iterator[str]:
    limit = f"PT := T#{words.watchdog_ms}ms"
    yield "(* The watchdog: Q tells that the scan before this one is too long ago. *)"
    yield f"scan_timer(IN := TRUE, {limit});"
    yield "late := scan_timer.Q;"
    yield f"scan_timer(IN := FALSE, {limit});"
    yield f"scan_timer(IN := TRUE, {limit});"
    yield ""


def _guards(words: Words, sequence: Sequence) -> Iterator[str]:
    clear = " AND ".join((*words.grids, *words.enables))
    yield "(* What forbids motion: the cause of a stop, and the input that it is about. *)"
    yield "cause := no_fault;"
    yield "culprit := 0;"
    yield f"allowed := {clear} AND NOT late;"
    yield f"IF (place <> {sequence.idle}) OR jogging THEN"
    first = True
    for condition, fault in (
        *((f"NOT {name}", "f_light_grid") for name in words.grids),
        *((f"NOT {name}", "f_enable") for name in words.enables),
        ("late", "f_late_scan"),
    ):
        yield f"  {'IF' if first else 'ELSIF'} {condition} THEN"
        yield f"    cause := {fault};"
        first = False
    yield "  END_IF;"
    yield "END_IF;"
    yield ""


def _buttons(words: Words, sequence: Sequence) -> Iterator[str]:
    idle = sequence.idle
    yield "(* A fault stays until it is acknowledged; then home, then start. *)"
    yield f"IF {words.acknowledge} AND NOT acknowledge_before AND allowed THEN"
    yield "  fault := FALSE;"
    yield "  stopped := FALSE;"
    yield "  fault_code := no_fault;"
    yield "  fault_place := 0;"
    yield "  fault_contact := 0;"
    yield "  fault_step := '';"
    yield "END_IF;"
    yield f"acknowledge_before := {words.acknowledge};"
    ready = f"allowed AND NOT fault AND NOT manual AND (place = {idle})"
    for button, before, run, condition in (
        (words.home, "home_before", sequence.homing, ready),
        (words.start, "start_before", sequence.cycle, f"{ready} AND homed"),
    ):
        yield f"IF {button} AND NOT {before} AND {condition} THEN"
        yield from (f"  {line}" for line in _begin(run[0].name, words, sequence.creeps))
        yield "  finished := FALSE;"
        yield "  ending := FALSE;"
        if run is sequence.homing:
            yield "  homed := FALSE;"
        yield "END_IF;"
        yield f"{before} := {button};"
    yield "IF stop_at_end THEN"
    yield "  ending := TRUE;"
    yield "END_IF;"
    yield ""


def _begin(first: str, words: Words, creeps: bool) -> Iterator[str]:
    yield f"place := {first};"
    yield "origin := T#0ms;"
    yield f"cycle_timer(IN := FALSE, {_LONGEST});"
    yield from (f"{name} := T#0ms;" for name in CREEP_NAMES if creeps)
    yield from (f"{fresh} := FALSE;" for fresh in words.fresh.values())


def _clock(words: Words, sequence: Sequence, tables: Tables | None) -> Iterator[str]:
    early = f" + T#{words.early_ms}ms" if words.early_ms else ""
    yield "(* Milliseconds since the last input, by half a scan ahead: the nearest scan acts. *)"
    yield f"cycle_timer(IN := place <> {sequence.idle}, {_LONGEST});"
    yield f"elapsed := cycle_timer.ET - origin{early};"
    yield from _fresh(words, sequence, tables)
    yield ""


def _fresh(words: Words, sequence: Sequence, tables: Tables | None) -> Iterator[str]:
    """Yield the lines that note whether an input had its other value before it counts.

    An input switched by a vacuum must have its other value when the vacuum is switched on.
    """
    if tables is not None and tables.before:
        yield from looked_up()
    for (name, value), fresh in words.fresh.items():
        word = words.inputs[name]
        yield f"IF {f'NOT {word}' if value else word} THEN"
        yield f"  {fresh} := TRUE;"
        before = sequence.before_vacuum.get((name, value), ())
        if before:
            places = " OR ".join(f"(place = {one})" for one in before)
            if tables is not None:
                places = f"{tables.before[name, value]}[look]"
            yield f"ELSIF {places} THEN"
            yield f"  {fresh} := FALSE;"
        yield "END_IF;"


def _plausible(words: Words, sequence: Sequence, machine: Machine) -> Iterator[str]:
    for one in sequence.guarded:
        yield f"(* The end switches of {one.axis}: where it stands, and on its way. *)"
        yield f"IF (place <> {sequence.idle}) AND (cause = no_fault) THEN"
        lines = list(_contradictions(one, words, machine))
        for number, (condition, fault, name) in enumerate(lines):
            yield f"  {'ELSIF' if number else 'IF'} {condition} THEN"
            yield f"    cause := {fault};"
            yield f"    culprit := {sequence.contacts[name]};"
        if lines:
            yield "  END_IF;"
        yield "END_IF;"
    yield ""


def _contradictions(one: Guarded, words: Words, machine: Machine) -> Iterator[tuple[str, str, str]]:
    """Yield condition, fault and contact of every implausible state of a cylinder's switches."""
    switches = switches_of(machine, one.axis)
    for (begin, end), constant in one.known.items():
        at = f"({one.expect} = {constant})"
        switch_values = {
            name: (reads(contact, begin), reads(contact, end)) for name, contact in switches.items()
        }
        for name, (first, last) in switch_values.items():
            word = words.inputs[name]
            if (first, last) == (True, True):
                yield f"{at} AND NOT {word}", "f_lost", name
            elif (first, last) == (False, False):
                yield f"{at} AND {word}", "f_wrong", name
            elif (first, last) == (False, True):
                yield f"{at} AND {word} AND (elapsed < {one.early})", "f_early", name
        for name, (first, last) in switch_values.items():
            word = words.inputs[name]
            if (first, last) == (True, False):
                yield f"{at} AND {word} AND (elapsed >= {one.gone})", "f_stayed", name
                # The far switch came in time, so the near switch should be off.
                for far, far_values in switch_values.items():
                    if far_values == (False, True):
                        yield f"{at} AND {word} AND {words.inputs[far]}", "f_stayed", name
    for near, low in switches.items():
        for far, high in switches.items():
            if low.at is None or high.at is None:
                continue
            if (low.beyond, high.beyond) == ("below", "above") and low.at.si < high.at.si:
                yield f"{words.inputs[near]} AND {words.inputs[far]}", "f_opposite", far


def _stop(sequence: Sequence) -> Iterator[str]:
    yield "IF cause <> no_fault THEN"
    yield "  fault_code := cause;"
    yield "  fault_contact := culprit;"
    yield "  fault_place := place;"
    yield "  fault_step := step_text;"
    yield "  step_text := 'idle';"
    yield f"  place := {sequence.idle};"
    yield "  fault := TRUE;"
    yield "  stopped := TRUE;"
    yield "  homed := FALSE;"
    yield "  cause := no_fault;"
    yield "END_IF;"
    yield ""


_PASSES = 3  # passes of the loop over transitions in a scan: it may enter and leave a place


def branches_in_scan(body: tuple[str, ...]) -> int:
    """Return the largest number of branches that a controller evaluates in a scan."""
    count, often = 0, 1
    for line in body:
        often = _PASSES if line.startswith("WHILE ") else often
        count += often * line.lstrip().startswith(("IF ", "ELSIF ", "WHILE "))
        often = 1 if line == "END_WHILE;" else often
    return count


def _transitions(run: tuple[NamedPlace, ...], words: Words, sequence: Sequence) -> Iterator[str]:
    """Yield the transitions out of each place, with the places by which cylinders creep."""
    steady = [named for named in run if not named.place.opens]
    opened = {run[i - 1].name: named for i, named in enumerate(run) if named.place.opens}
    step = None
    for named, then in zip(steady, (*steady[1:], None), strict=True):
        comment = [] if named.place.step == step else [f"(* Step {named.place.step} *)"]
        step, beside = named.place.step, opened.get(named.name)
        yield from comment
        yield from _transition(named, then, words, sequence, beside)


def _transition(
    named: NamedPlace,
    then: NamedPlace | None,
    words: Words,
    sequence: Sequence,
    opened: NamedPlace | None,
) -> Iterator[str]:
    place = named.place
    leave = (
        [f"place := {then.name};"] if then else list(_end(named in sequence.cycle, words, sequence))
    )
    if place.wait is None:
        yield f"IF (place = {named.name}) AND (elapsed >= {named.due}) THEN"
        yield from (f"  {line}" for line in leave)
        yield "END_IF;"
        return
    word = words.inputs[place.wait[0]]
    fresh = "" if named.name in sequence.still_held else words.fresh.get(place.wait)
    awaited = word if place.wait[1] else f"NOT {word}"
    calm = ""
    if opened:
        calm = " AND (elapsed >= creep_calm)"
        yield f"(* Short openings until {word} is there, and a rest after the last one. *)"
        yield f"IF (place = {opened.name}) AND (elapsed >= creep_shut) THEN"
        yield f"  place := {named.name};"
        yield "END_IF;"
    yield f"IF place = {named.name} THEN"
    yield f"  IF {awaited}{f' AND {fresh}' if fresh else ''}{calm} THEN"
    if fresh:
        yield f"    {fresh} := FALSE;"
    yield "    origin := cycle_timer.ET;"
    yield f"    elapsed := T#{words.early_ms}ms;"
    yield from (f"    {name} := T#0ms;" for name in CREEP_NAMES if opened)
    yield from (f"    {line}" for line in leave)
    if opened:
        first, every, rest = named.creeps
        yield f"  ELSIF {awaited} THEN"
        yield f"    place := {named.name};"
        yield f"  ELSIF (elapsed >= {first}) AND (elapsed >= creep_due)"
        yield f"    AND (elapsed < {named.due}) THEN"
        yield f"    place := {opened.name};"
        yield f"    creep_due := cycle_timer.ET - origin + {every};"
        yield f"    creep_shut := cycle_timer.ET - origin + {opened.due};"
        yield f"    creep_calm := creep_shut + {rest};"
    yield f"  ELSIF elapsed >= {named.due} THEN"
    if fresh:
        yield "    cause := f_missing;"
        yield f"    IF {awaited} THEN"
        yield "      cause := f_stuck;"
        yield "    END_IF;"
    else:
        yield "    cause := f_missing;"
    yield f"    culprit := {sequence.contacts[place.wait[0]]};"
    yield "  END_IF;"
    yield "END_IF;"


def _end(cycle: bool, words: Words, sequence: Sequence) -> Iterator[str]:
    """Yield the actions of the last place of the cycle, or of the way home."""
    if not cycle:
        yield f"place := {sequence.idle};"
        yield "homed := TRUE;"
        return
    yield "count := count + 1;"
    yield "IF continuous AND NOT ending THEN"
    yield from (f"  {line}" for line in _begin(sequence.again, words, sequence.creeps))
    yield "ELSE"
    yield f"  place := {sequence.idle};"
    yield "  finished := TRUE;"
    yield "END_IF;"


def _steps(sequence: Sequence) -> Iterator[str]:
    yield "step_text := 'idle';"
    for first, last in _runs(sequence.places, lambda named: named.place.step):
        yield f"IF {_within(first, last)} THEN"
        yield f"  step_text := '{plain_text(first.place.step)}';"
        yield "END_IF;"
    yield ""


def _interlocks(words: Words, sequence: Sequence) -> Iterator[str]:
    """Yield the interlocks of the machine file; a violation is a fault in the same scan."""
    for name, places in sequence.interlocks.items():
        where = _in_any(sequence.places, frozenset(places))
        word = words.inputs[name]
        yield f"(* An interlock of the machine file: {word} is on in all of these places. *)"
        yield f"IF (cause = no_fault) AND NOT {word} AND ({where}) THEN"
        yield "  cause := f_interlock;"
        yield f"  culprit := {sequence.contacts[name]};"
        yield "END_IF;"


def _runs(
    places: tuple[NamedPlace, ...], key: Callable[[NamedPlace], object]
) -> Iterator[tuple[NamedPlace, NamedPlace]]:
    """Yield first and last of each run of consecutive places with equal keys."""
    for _, group in groupby(places, key):
        run = list(group)
        yield run[0], run[-1]


def _in_any(places: tuple[NamedPlace, ...], names: frozenset[str]) -> str:
    runs = _runs(places, lambda named: named.name in names)
    return " OR ".join(f"({_within(*run)})" for run in runs if run[0].name in names)


def _within(first: NamedPlace, last: NamedPlace) -> str:
    if first is last:
        return f"place = {first.name}"
    return f"(place >= {first.name}) AND (place <= {last.name})"


def _outputs(words: Words, sequence: Sequence) -> Iterator[str]:
    yield "(* The outputs: off, except the outputs that this place switches on. *)"
    for word in words.outputs.values():
        yield f"{word} := FALSE;"
    for one in sequence.guarded:
        yield f"{one.expect} := {one.unknown};"
        yield f"{one.early} := T#0ms;"
        yield f"{one.gone} := T#0ms;"
    for named in sequence.places:
        yield from _outputs_of(named, words, sequence)
    yield ""


def _outputs_of(named: NamedPlace, words: Words, sequence: Sequence) -> Iterator[str]:
    yield f"IF place = {named.name} THEN"
    for name in named.place.on:
        yield f"  {words.outputs[name]} := TRUE;"
    for one in sequence.guarded:
        watch = named.watch.get(one.axis)
        if watch is None:
            continue
        known = one.known[round(watch.begin_m, 9), round(watch.end_m, 9)]
        yield f"  {one.expect} := {known};"
        if not watch.stands:
            early, gone = named.bounds[one.axis]
            yield f"  {one.early} := {early};"
            yield f"  {one.gone} := {gone};"
    yield "END_IF;"

"""A long sequence as tables: constant arrays by place, and one piece of code for all places.

Below a number of places the body names every place (``structured_text_body``). Beyond it a
controller would compare the place with thousands of constants, and the text would have megabytes.
Then ``row_of`` gives each place its row: the times of the place, and its look. A look is all that
the program switches and expects in a place: its outputs, its waits, the state of the end switches,
the interlocks. Equal rows and equal looks stand in the tables once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from threadline.commands.plc_net import Names
from threadline.commands.plc_sequence import CREEP_NAMES, Guarded, Variable, Words
from threadline.commands.plc_sequence import Sequence as PlcSequence
from threadline.commands.plc_watch import NamedPlace
from threadline.commands.structured_text_panel import plain_text

LISTED = 200
"""Places that a body still names one by one."""
MOST_PLACES = 32_767
"""Places that an INT of a PLC can number."""
TABLE_NAMES = (
    "row_of", "step_of", "step_names", "look_of", "due_of", "wait_of", "opens_of", "creeps_of",
    "first_of", "every_of", "open_of", "rest_of", "row", "look", "step_now", "waits", "stays",
    "fires", "awaited", "proper", "asked",
)  # fmt: skip
_NOTHING, _OPENING = 0, -1  # wait of a place that ends by time; of an opening, and of idle


@dataclass(frozen=True, slots=True, kw_only=True)
class Waits:
    """A way to wait: the input, its value, and the variable that says that it is fresh."""

    name: str
    value: bool
    fresh: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Tables:
    """The tables of a sequence, and the names of the tables that depend on the parts of a machine.

    Parameters
    ----------
    arrays
        Constant arrays with all of their values.
    waits
        Ways to wait; their numbers in ``wait_of`` begin with 1.
    on, needs, before
        Array of looks by output, by contact of an interlock, and by input with its value.
    expect, early, gone
        Array of looks by cylinder, and two of rows.
    """

    arrays: tuple[Variable, ...]
    waits: tuple[Waits, ...]
    on: dict[str, str]
    needs: dict[str, str]
    before: dict[tuple[str, bool], str]
    expect: dict[str, str]
    early: dict[str, str]
    gone: dict[str, str]


def tables_of(sequence: PlcSequence, words: Words, names: Names) -> Tables:
    """Return the tables of a sequence."""
    outputs = [name for name in words.outputs if any(name in p.place.on for p in sequence.places)]
    axes = [one.axis for one in sequence.guarded]
    waits: dict[Waits, int] = {}
    opened = {
        sequence.cycle[i - 1].name: named.place.due_ms
        for i, named in enumerate(sequence.cycle)
        if named.place.opens
    }
    looks: dict[tuple[object, ...], int] = {}
    rows: dict[tuple[int, ...], int] = {}
    texts: dict[str, int] = {"idle": 0}
    row_of, step_of = [0], [0]
    flagged = len(outputs) + len(sequence.interlocks) + len(sequence.before_vacuum)
    idle = (_OPENING, False, False, *[False] * flagged, *[0] * len(axes))
    rows[looks.setdefault(idle, 0), *[0] * (5 + 2 * len(axes))] = 0
    for named in sequence.places:
        place, wait = named.place, _NOTHING
        if place.opens:
            wait = _OPENING
        elif place.wait is not None:
            fresh = words.fresh.get(place.wait)
            own = fresh if named.name not in sequence.still_held else None
            way = Waits(name=place.wait[0], value=place.wait[1], fresh=own)
            wait = waits.setdefault(way, len(waits) + 1)
        flags = [
            *(name in place.on for name in outputs),
            *(named.name in where for where in sequence.interlocks.values()),
            *(named.name in where for where in sequence.before_vacuum.values()),
        ]
        expects = (_expected(named, one) for one in sequence.guarded)
        look = (wait, place.opens, bool(named.creeps) and named.name in opened, *flags, *expects)
        times = {name: ms for name, ms, _ in sequence.creep_times(named)}
        bounds = [
            ms
            for axis in axes
            for watch in (named.watch.get(axis),)
            for ms in ((0, 0) if watch is None or watch.stands else (watch.early_ms, watch.gone_ms))
        ]
        row = (
            looks.setdefault(look, len(looks)),
            place.due_ms,
            *(times.get(name, 0) for name in named.creeps or ("", "", "")),
            opened.get(named.name, 0),
            *bounds,
        )
        row_of.append(rows.setdefault(row, len(rows)))
        step_of.append(texts.setdefault(plain_text(place.step), len(texts)))
    on = {name: names.give(f"on_{words.outputs[name]}") for name in outputs}
    needs = {name: names.give(f"needs_{words.inputs[name]}") for name in sequence.interlocks}
    before = {wait: names.give(f"before_{words.fresh[wait]}") for wait in sequence.before_vacuum}
    expect, early, gone = (
        {axis: names.give(f"{axis.lower()}_{word}_of") for axis in axes}
        for word in ("expected", "too_early", "gone")
    )
    by_look = ["wait_of", "opens_of", "creeps_of"]
    by_look += [*on.values(), *needs.values(), *before.values(), *expect.values()]
    by_row = ["look_of", "due_of", "first_of", "every_of", "rest_of", "open_of"]
    by_row += [array for axis in axes for array in (early[axis], gone[axis])]
    arrays = [
        _array("row_of", "INT", row_of, "row of each place"),
        _array("step_of", "INT", step_of, "step of each place"),
        Variable(
            name="step_names",
            type="STRING",
            values=tuple(f"'{text}'" for text in texts),
            note="names of the steps",
        ),
    ]
    for name, column in zip(by_row, zip(*rows, strict=True), strict=True):
        kind = "INT" if name == "look_of" else "TIME"
        arrays.append(_array(name, kind, column, "by row"))
    numbers = {"wait_of", *expect.values()}
    for name, values in zip(by_look, zip(*looks, strict=True), strict=True):
        arrays.append(_array(name, "INT" if name in numbers else "BOOL", values, "by look"))
    unused = {"opens_of", "creeps_of", "first_of", "every_of", "rest_of", "open_of"}
    return Tables(
        arrays=tuple(a for a in arrays if sequence.creeps or a.name not in unused),
        waits=tuple(waits),
        on=on,
        needs=needs,
        before=before,
        expect=expect,
        early=early,
        gone=gone,
    )


def _expected(named: NamedPlace, one: Guarded) -> int:
    """Return the number of the state in which the end switches of a cylinder are expected."""
    watch = named.watch.get(one.axis)
    if watch is None:
        return 0
    return list(one.known).index((round(watch.begin_m, 9), round(watch.end_m, 9))) + 1


def _array(name: str, kind: str, values: Sequence[object], note: str) -> Variable:
    literals: dict[str, Callable[[object], str]] = {
        "INT": str,
        "TIME": lambda value: f"T#{value}ms",
        "BOOL": lambda value: "TRUE" if value else "FALSE",
    }
    literal = literals[kind]
    return Variable(name=name, type=kind, values=tuple(literal(v) for v in values), note=note)


def table_state() -> Iterator[Variable]:
    """Yield the variables that the lines of the tables use."""
    for name in ("row", "look", "step_now", "waits", "asked"):
        yield Variable(name=name, type="INT", initial="0")
    for name in ("stays", "fires", "awaited", "proper"):
        yield Variable(name=name, type="BOOL", initial="FALSE")


def named_places(sequence: PlcSequence) -> frozenset[str]:
    """Return the places that the body still names: where runs begin, begin again, and end."""
    cycle, homing = sequence.cycle, sequence.homing
    return frozenset(
        {cycle[0].name, _last(cycle).name, homing[0].name, _last(homing).name, sequence.again}
    )


def _last(run: Sequence[NamedPlace]) -> NamedPlace:
    return [named for named in run if not named.place.opens][-1]


def looked_up() -> Iterator[str]:
    """Yield the lines that look a place up in the tables."""
    yield "row := row_of[place];"
    yield "look := look_of[row];"


def table_transitions(
    sequence: PlcSequence, words: Words, tables: Tables, ends: tuple[Sequence[str], Sequence[str]]
) -> Iterator[str]:
    """Yield the transitions: from place to place, as long as one fires.

    Parameters
    ----------
    ends
        Actions of the last place of the cycle, and of the last place of the way home.
    """
    creeps = sequence.creeps
    yield "(* The transitions: from place to place as long as one fires. *)"
    yield "stays := FALSE;"
    yield "WHILE NOT stays DO"
    yield "  stays := TRUE;"
    yield from (f"  {line}" for line in looked_up())
    if creeps:
        yield "  IF opens_of[look] AND (elapsed >= creep_shut) THEN"
        yield "    place := place - 1;"
        yield from (f"    {line}" for line in looked_up())
        yield "  END_IF;"
    yield "  waits := wait_of[look];"
    yield f"  fires := (waits = {_NOTHING}) AND (elapsed >= due_of[row]);"
    yield f"  IF waits > {_NOTHING} THEN"
    yield from (f"    {line}" for line in _awaiting(sequence, words, tables, creeps))
    yield "  END_IF;"
    yield "  IF fires THEN"
    for number, (run, end) in enumerate(zip((sequence.cycle, sequence.homing), ends, strict=True)):
        yield f"    {'ELSIF' if number else 'IF'} place = {_last(run).name} THEN"
        yield from (f"      {line}" for line in end)
    yield "    ELSE"
    yield "      place := place + 1;"
    if creeps:
        yield from (f"      {line}" for line in looked_up())
        yield "      IF opens_of[look] THEN"
        yield "        place := place + 1;"
        yield "      END_IF;"
    yield "      stays := FALSE;"
    yield "    END_IF;"
    yield "  END_IF;"
    yield "END_WHILE;"
    yield ""


def _awaiting(sequence: PlcSequence, words: Words, tables: Tables, creeps: bool) -> Iterator[str]:
    yield "awaited := FALSE;"
    yield "proper := TRUE;"
    for number, way in enumerate(tables.waits, start=1):
        word = words.inputs[way.name]
        yield f"{'IF' if number == 1 else 'ELSIF'} waits = {number} THEN"
        yield f"  awaited := {word if way.value else f'NOT {word}'};"
        yield f"  asked := {sequence.contacts[way.name]};"
        if way.fresh:
            yield f"  proper := {way.fresh};"
    yield "END_IF;"
    calm = " AND (NOT creeps_of[look] OR (elapsed >= creep_calm))" if creeps else ""
    yield f"IF awaited AND proper{calm} THEN"
    for number, way in enumerate(tables.waits, start=1):
        if way.fresh:
            yield f"  IF waits = {number} THEN"
            yield f"    {way.fresh} := FALSE;"
            yield "  END_IF;"
    yield "  fires := TRUE;"
    yield "  origin := cycle_timer.ET;"
    yield f"  elapsed := T#{words.early_ms}ms;"
    late = "elapsed >= due_of[row]"
    if creeps:
        yield "  IF creeps_of[look] THEN"
        yield from (f"    {name} := T#0ms;" for name in CREEP_NAMES)
        yield "  END_IF;"
        yield "ELSIF creeps_of[look] AND NOT awaited AND (elapsed >= first_of[row])"
        yield "  AND (elapsed >= creep_due) AND (elapsed < due_of[row]) THEN"
        yield "  place := place + 1;"
        yield "  creep_due := cycle_timer.ET - origin + every_of[row];"
        yield "  creep_shut := cycle_timer.ET - origin + open_of[row];"
        yield "  creep_calm := creep_shut + rest_of[row];"
        late = f"({late}) AND NOT (creeps_of[look] AND awaited)"
    yield f"ELSIF {late} THEN"
    yield "  cause := f_missing;"
    yield "  IF awaited THEN"
    yield "    cause := f_stuck;"
    yield "  END_IF;"
    yield "  culprit := asked;"
    yield "END_IF;"


def table_steps() -> Iterator[str]:
    """Yield the text of the step."""
    yield "step_now := step_of[place];"
    yield "step_text := step_names[step_now];"
    yield ""


def table_interlocks(sequence: PlcSequence, words: Words, tables: Tables) -> Iterator[str]:
    """Yield the interlocks of the machine file; a violation is a fault in the same scan."""
    yield from looked_up()
    for name, array in tables.needs.items():
        word = words.inputs[name]
        yield f"(* An interlock of the machine file: {word} is on in these places. *)"
        yield f"IF (cause = no_fault) AND NOT {word} AND {array}[look] THEN"
        yield "  cause := f_interlock;"
        yield f"  culprit := {sequence.contacts[name]};"
        yield "END_IF;"


def table_outputs(sequence: PlcSequence, words: Words, tables: Tables) -> Iterator[str]:
    """Yield the outputs of the place, and the expected states of its end switches."""
    yield "(* The outputs, and the end switches, as the place has them. *)"
    yield from looked_up()
    for name, word in words.outputs.items():
        yield f"{word} := {f'{tables.on[name]}[look]' if name in tables.on else 'FALSE'};"
    for one in sequence.guarded:
        yield f"{one.expect} := {tables.expect[one.axis]}[look];"
        yield f"{one.early} := {tables.early[one.axis]}[row];"
        yield f"{one.gone} := {tables.gone[one.axis]}[row];"
    yield ""

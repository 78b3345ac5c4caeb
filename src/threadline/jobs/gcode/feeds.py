"""F words: their meaning, their feeds, and the unit of length in force.

In G94, F is a speed in mm/min (G20: inch/min). When axes of different kinds move together, each
kind of control applies F to a different speed. ``RULES`` has the rules by name:

``fastest-axis`` (the default: the printed winder's rule)
    F is the speed of the fastest axis; a rotary axis counts with its arc length at its radius. A
    move by the differences d_i takes max_i(r_i |d_i|) / F, r_i = 1 for a linear axis. No axis moves
    faster than F, and a single linear axis moves at F.
``base-axes``
    F is the speed of the base axes alone, as in CADFIL: mode 1 has the base A, mode 2 the base A
    and X. The move takes |(r_i d_i), i in the base| / F, and the other axes follow. If the base
    axes rest, the length over all axes counts instead.
``path``
    F is the speed along the path of the linear axes. If only rotary axes move, their arc length at
    their radii counts.
``cadfil``, ``grbl``, ``fluidnc``, ``fanuc``
    F is the speed along the path of all axes together, and a degree counts as a millimetre. This
    rule gives the times in CADFIL's reports; grbl's and FluidNC's planners take the length of a
    block over every axis; Fanuc's G01 of linear and rotary axes uses the tangential speed in the
    Cartesian system of the axes (B-63174EN, section 4.2).
``linuxcnc``, ``rs274``, ``marlin``
    F is the speed along the path of X Y Z. If X Y Z rest, F is the speed of U V W; if U V W rest,
    too, F is the speed of A B C in degrees a minute: RS274/NGC version 3 section 2.1.2.5 (which
    has no U V W), LinuxCNC's canon and Marlin 2.1's ``get_move_distance`` with rotational axes.

The rules ``linuxcnc``, ``rs274`` and ``marlin`` depend only on the letters of the axes, as in the
firmwares: a mandrel on axis Y of a Marlin counts as a linear axis, a degree as a millimetre. For a
move of A B C alone F is in degrees, so G20 does not scale it.

In G93, F is the inverse of the move's time in minutes, and every G1 block needs its own F. G0
moves as fast as the limits of the machine allow.

The reader reports F as written. If the machine file has an operator's normal feed (counts per tick
of the fastest axis), the planner caps F at it unless another feed is given: the 1994 controller ran
the printed program at 10 counts per tick, although its F 12000 would be 200 mm/s. The reader warns
about each capped F.

A subroutine without G20 or G21 uses the unit of its caller; a subroutine with G20 or G21 leaves its
own unit in force when it returns. The scan therefore notes modes, feeds and calls in order. When
all programs are known, the calls are followed from the main program.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, NamedTuple

from threadline.errors import OptionError
from threadline.jobs.gcode.words import ONE
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import Machine

_AT_RADIUS = "a rotary axis at its radius"
_DEGREE = "a degree as a millimetre"
_ALL = (FeedMode.ALL_AXES, f"of all axes together, {_DEGREE}")
_IN_TURN = (FeedMode.IN_TURN, "of X Y Z, else of U V W, else of A B C in degrees")
RULES: Mapping[str, tuple[FeedMode, str]] = {
    "fastest-axis": (FeedMode.FASTEST_AXIS, f"of the fastest axis, {_AT_RADIUS}"),
    "base-axes": (FeedMode.BASE_AXES, f"of the base axes, {_AT_RADIUS}"),
    "path": (FeedMode.PATH, "of the linear axes"),
    "cadfil": _ALL,
    "grbl": _ALL,
    "fluidnc": _ALL,
    "fanuc": _ALL,
    "linuxcnc": _IN_TURN,
    "rs274": _IN_TURN,
    "marlin": _IN_TURN,
}
"""Feed mode of each rule, and a text that names the speed set by F."""
F_MODES = tuple(dict.fromkeys(mode for mode, _ in RULES.values()))
_WITHOUT_UVW = "rs274"


@dataclass(frozen=True, slots=True)
class FRule:
    """The meaning of F in G94: the feed mode ``mode``, from the rule ``name``."""

    name: str
    mode: FeedMode
    base_axes: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """Name of the rule with its base axes."""
        base = f":{','.join(self.base_axes)}" if self.base_axes else ""
        return f"{self.name}{base}"


def parse_feed_mode(text: str) -> dict[str, Any]:
    """Return the reader's options ``feed_mode`` and ``base_axes`` from a text.

    Examples of the text are ``"path"`` and ``"base-axes:A,X"``. ``f_rule`` refuses unknown rules
    and axes.
    """
    mode, _, axes = text.partition(":")
    base = tuple(name.strip().upper() for name in axes.split(",")) if axes.strip() else ()
    return {"feed_mode": mode.strip(), "base_axes": base}


def f_rule(
    machine: Machine,
    feed_mode: str | None,
    base_axes: tuple[str, ...] = (),
    of_dialect: str = "fastest-axis",
) -> FRule:
    """Return the rule for F on ``machine``.

    A ``feed_mode`` of None means the rule of the machine file, else of the dialect.

    Raises
    ------
    OptionError
        If the rule is unknown, a base axis is missing or not on the machine, or the machine has
        axes that the rule does not know.
    """
    if feed_mode is None:
        feed_mode = machine.programs.feed_mode or of_dialect
        base_axes = machine.programs.base_axes
    if feed_mode not in RULES:
        raise OptionError(
            f"F cannot be read as {str(feed_mode)!r}", remedy=f"Choose {', '.join(RULES)}."
        )
    for name in base_axes:
        if name not in machine.axis_names:
            raise OptionError(
                f"the base axis {name!r} is not one of {machine.name!r}",
                remedy=f"It has {', '.join(machine.axis_names)}.",
            )
    mode, _ = RULES[feed_mode]
    if (mode is FeedMode.BASE_AXES) != bool(base_axes):
        raise OptionError(
            "base axes go with the feed mode base-axes, and only with it",
            remedy="CADFIL's mode 1 has the base A, mode 2 the base A, X.",
        )
    uvw_axes = [axis for axis in machine.axis_names if axis in "UVW"]
    if feed_mode == _WITHOUT_UVW and uvw_axes:
        raise OptionError(
            f"RS274/NGC does not say what F means to the axis {uvw_axes[0]}",
            remedy="Choose linuxcnc, which takes U V W behind X Y Z.",
        )
    return FRule(feed_mode, mode, tuple(base_axes))


def normal_feed_m_s(machine: Machine) -> tuple[float, ...] | None:
    """Return the (axes,) speeds at the tool in m/s at the operator's normal feed."""
    if machine.operator is None:
        return None
    tick_s = float(machine.tick_clock.period_s)
    axis_speeds_si = machine.operator.normal_feed.si / machine.counts_per_unit / tick_s
    return tuple((axis_speeds_si * machine.radius_m).tolist())


def as_f_words(value_m_s: float, rule: str) -> Feed:
    """Return the feed of an F word of ``value_m_s``, by the rule text of ``Job.feed_rule``.

    Raises
    ------
    OptionError
        If no F word of the job is a speed.
    """
    name, _, base = rule.partition(":")
    if name not in RULES:
        raise OptionError(
            f"feed 'F {60_000.0 * value_m_s:.6g}': F of this job is not the speed of its moves",
            remedy='Give the speed of the fastest axis, like "36 mm/s".',
        )
    return Feed(RULES[name][0], value_m_s, tuple(base.split(",")) if base else ())


def speed_of(rule: str, *, turning: bool = True) -> str:
    """Return a text that names the speed set by F, by the rule text of ``Job.feed_rule``.

    Without ``turning`` no axis turns, and the text says nothing about axes that do.

    >>> speed_of("base-axes:A,X"), speed_of("x-winder")
    ('of the base axes, a rotary axis at its radius', 'of the carriage, a second')
    >>> speed_of("grbl", turning=False), speed_of("linuxcnc", turning=False)
    ('of all axes together', 'of X Y Z')
    """
    name = rule.partition(":")[0]
    if name not in RULES:
        return "of the carriage, a second"
    text = RULES[name][1]
    return text if turning else text.partition(",")[0]


_MOST = 1000
_MM_PER_M = 1000 * ONE


class FeedCache:
    """A store of feeds by mode and value, so that equal feeds are one object.

    Parameters
    ----------
    rule
        Meaning of F in G94.
    """

    def __init__(self, rule: FRule) -> None:
        self._rule = rule
        self._feeds: dict[tuple[FeedMode, float], Feed] = {}

    def feed(self, value: float, *, inverse_time: bool) -> Feed:
        """Return the feed of ``value`` in m/s, or in 1/s in G93 (``inverse_time``)."""
        rule = self._rule
        mode = FeedMode.INVERSE_TIME if inverse_time else rule.mode
        feed = self._feeds.get((mode, value))
        if feed is None:
            if len(self._feeds) >= _MOST:
                self._feeds.clear()
            feed = Feed(mode, value, rule.base_axes if mode is FeedMode.BASE_AXES else ())
            self._feeds[mode, value] = feed
        return feed


@lru_cache(maxsize=_MOST)
def travelling(feed: Feed) -> Feed:
    """Return the travel feed of a G0 that moves at ``feed``."""
    return feed if feed.travels else replace(feed, travel=True)


def value_of(word: int, tenth_mm: int, *, inverse_time: bool) -> float:
    """Return the value of an F word in m/s, or in 1/s in G93 (``inverse_time``).

    Parameters
    ----------
    word
        Exact number of the F word.
    tenth_mm
        Tenths of a millimetre in the unit of length.
    """
    if inverse_time:
        return word / (60 * ONE)
    return word * tenth_mm / (10 * 60 * _MM_PER_M)


MILLIMETRE, INCH = 10, 254  # tenths of a millimetre
_UNITS = {200: INCH, 210: MILLIMETRE}
_INVERSE = {930: True, 940: False}
_MAX_NOTES = 100_000


class _Modes(NamedTuple):
    """Unit in tenths of a millimetre, and whether F is an inverse time; None: as at the call."""

    unit: int | None = None
    inverse: bool | None = None

    def then(self, later: _Modes) -> _Modes:
        return _Modes(
            self.unit if later.unit is None else later.unit,
            self.inverse if later.inverse is None else later.inverse,
        )


class _Feed(NamedTuple):
    exact: int
    line: int


class _Call(NamedTuple):
    label: int
    repeats: bool


_Note = _Modes | _Feed | _Call


@dataclass(slots=True)
class _Program:
    notes: list[_Note] = field(default_factory=list)
    feeds: set[int] = field(default_factory=set)  # noted since the last change of modes


@dataclass(slots=True)
class FeedNotes:
    """The modes, feeds and calls of every program of a file, in order.

    At most 100 000 notes are kept, so memory is bounded; repeated notes are left out.
    """

    _programs: dict[int | None, _Program] = field(default_factory=dict)
    _count: int = 0

    def set_mode(self, program: int | None, code: int) -> None:
        """Note G20, G21, G93 or G94 (ten times its number); any other code has no effect."""
        modes = _Modes(_UNITS.get(code), _INVERSE.get(code))
        if modes != _Modes():
            self._change(program, modes)

    def feed(self, program: int | None, exact: int, line: int) -> None:
        """Note an exact F and its line."""
        program_notes = self._programs.setdefault(program, _Program())
        if exact not in program_notes.feeds and self._count < _MAX_NOTES:
            self._count += 1
            program_notes.feeds.add(exact)
            program_notes.notes.append(_Feed(exact, line))

    def call(self, program: int | None, label: int, passes: int) -> None:
        """Note a call of a subroutine and its passes."""
        self._change(program, _Call(label, passes > 1))

    def _change(self, program: int | None, note: _Modes | _Call) -> None:
        program_notes = self._programs.setdefault(program, _Program())
        if (
            not program_notes.notes or program_notes.notes[-1] != note
        ) and self._count < _MAX_NOTES:
            self._count += 1
            program_notes.feeds.clear()
            program_notes.notes.append(note)

    def speeds(self, main: int | None) -> dict[tuple[int, int], int]:
        """Return the first line of each F in G94, over the programs that run.

        The keys are the exact F and its unit in tenths of a millimetre.

        Parameters
        ----------
        main
            Label of the main program. No program may call itself.
        """
        modes_left: dict[int | None, _Modes] = {}
        first_lines: dict[tuple[int, int], int] = {}
        waiting_runs = [(main, _Modes(MILLIMETRE, False))]
        seen_runs = set(waiting_runs)
        while waiting_runs:
            program, modes = waiting_runs.pop()
            for note, modes_now in self._followed(program, modes, modes_left):
                if isinstance(note, _Feed) and not modes_now.inverse and modes_now.unit is not None:
                    key = note.exact, modes_now.unit
                    first_lines[key] = min(note.line, first_lines.get(key, note.line))
                elif isinstance(note, _Call):
                    modes_after_call = modes_now.then(self._left(note.label, modes_left))
                    for entry_modes in (
                        (modes_now, modes_after_call) if note.repeats else (modes_now,)
                    ):
                        if (note.label, entry_modes) not in seen_runs:
                            seen_runs.add((note.label, entry_modes))
                            waiting_runs.append((note.label, entry_modes))
        return dict(sorted(first_lines.items(), key=lambda item: item[1]))

    def _followed(
        self, program: int | None, modes: _Modes, modes_left: dict[int | None, _Modes]
    ) -> Iterator[tuple[_Note, _Modes]]:
        """Yield each note of a program that begins in ``modes``, with the modes before the note."""
        for note in self._programs.get(program, _Program()).notes:
            yield note, modes
            if isinstance(note, _Modes):
                modes = modes.then(note)
            elif isinstance(note, _Call):
                modes = modes.then(self._left(note.label, modes_left))

    def _left(self, program: int | None, modes_left: dict[int | None, _Modes]) -> _Modes:
        """Return the modes that a program sets; None for a mode that it does not set."""
        if program not in modes_left:
            modes = _Modes()
            for note in self._programs.get(program, _Program()).notes:
                if isinstance(note, _Modes):
                    modes = modes.then(note)
                elif isinstance(note, _Call):
                    modes = modes.then(self._left(note.label, modes_left))
            modes_left[program] = modes
        return modes_left[program]

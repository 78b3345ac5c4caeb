"""The unit of length in force at each feed of a program, which depends on its calls.

A subroutine without G20 or G21 has the unit of its caller; one with them leaves its own unit in
force when it returns. Modes, feeds and calls are therefore noted in order while the file is
scanned. When all programs are known, the calls are followed from the main program on.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

MILLIMETRE, INCH = 10, 254  # tenths of a millimetre
_UNITS = {200: INCH, 210: MILLIMETRE}
_INVERSE = {930: True, 940: False}
_MAX_NOTES = 100_000


class _Modes(NamedTuple):
    """Tenths of a millimetre, and whether F is an inverse of a time; None: as at the call."""

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
    feeds: set[int] = field(default_factory=set)  # noted since a mode may have changed


@dataclass(slots=True)
class FeedNotes:
    """The modes, feeds and calls of every program of a file, in order.

    At most a hundred thousand are kept, so that memory is bounded; repetitions are left out.
    """

    _programs: dict[int | None, _Program] = field(default_factory=dict)
    _count: int = 0

    def set_mode(self, program: int | None, code: int) -> None:
        """Note ten times G20, G21, G93 or G94; any other code changes nothing here."""
        modes = _Modes(_UNITS.get(code), _INVERSE.get(code))
        if modes != _Modes():
            self._change(program, modes)

    def feed(self, program: int | None, exact: int, line: int) -> None:
        """Note an exact F."""
        kept = self._programs.setdefault(program, _Program())
        if exact not in kept.feeds and self._count < _MAX_NOTES:
            self._count += 1
            kept.feeds.add(exact)
            kept.notes.append(_Feed(exact, line))

    def call(self, program: int | None, label: int, passes: int) -> None:
        """Note a call."""
        self._change(program, _Call(label, passes > 1))

    def _change(self, program: int | None, note: _Modes | _Call) -> None:
        kept = self._programs.setdefault(program, _Program())
        if (not kept.notes or kept.notes[-1] != note) and self._count < _MAX_NOTES:
            self._count += 1
            kept.feeds.clear()
            kept.notes.append(note)

    def speeds(self, main: int | None) -> dict[tuple[int, int], int]:
        """Return the first line of each speed F (in G94) of the programs that are run.

        The keys are exact F and its unit in tenths of a millimetre.

        Parameters
        ----------
        main
            Label of the main program. No program may call itself.
        """
        left: dict[int | None, _Modes] = {}
        found: dict[tuple[int, int], int] = {}
        waiting = [(main, _Modes(MILLIMETRE, False))]
        seen = set(waiting)
        while waiting:
            program, modes = waiting.pop()
            for note, now in self._followed(program, modes, left):
                if isinstance(note, _Feed) and not now.inverse and now.unit is not None:
                    key = note.exact, now.unit
                    found[key] = min(note.line, found.get(key, note.line))
                elif isinstance(note, _Call):
                    again = now.then(self._left(note.label, left))
                    for entry in (now, again) if note.repeats else (now,):
                        if (note.label, entry) not in seen:
                            seen.add((note.label, entry))
                            waiting.append((note.label, entry))
        return dict(sorted(found.items(), key=lambda item: item[1]))

    def _followed(
        self, program: int | None, modes: _Modes, left: dict[int | None, _Modes]
    ) -> Iterator[tuple[_Note, _Modes]]:
        """Yield the notes of a program that begins in ``modes``, each with the modes before it."""
        for note in self._programs.get(program, _Program()).notes:
            yield note, modes
            if isinstance(note, _Modes):
                modes = modes.then(note)
            elif isinstance(note, _Call):
                modes = modes.then(self._left(note.label, left))

    def _left(self, program: int | None, left: dict[int | None, _Modes]) -> _Modes:
        """Return the modes that a program leaves behind, None for those that it leaves alone."""
        if program not in left:
            modes = _Modes()
            for note in self._programs.get(program, _Program()).notes:
                if isinstance(note, _Modes):
                    modes = modes.then(note)
                elif isinstance(note, _Call):
                    modes = modes.then(self._left(note.label, left))
            left[program] = modes
        return left[program]

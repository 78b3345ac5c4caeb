"""One plan beside the files of many controllers: whether each of them is that plan.

A file is read by something that did not write it. Tick tables are read by csv, json and numpy;
programs for LinuxCNC by its own interpreter; programs for other firmwares as a job in their
dialect. Where a file on disk is given, everything that does not move (words, comments, events)
is compared with the file that ``compile`` writes.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from threadline.base.progress import Progress
from threadline.commands.boards import BOARDS
from threadline.commands.plan import Plan
from threadline.commands.write import TABLES
from threadline.errors import OptionError, Place, PlanError, RecordingError
from threadline.machine import Machine
from threadline.proof.asked import check_target
from threadline.proof.kinds import kind_of
from threadline.proof.options import Options
from threadline.proof.pipeline import write

HEADER = ("target", "verdict", "place", "limit", "time", "limit", "worst at", "note")
_PROGRAMS = ("nc", *BOARDS)
_NO_READER = "no program here reads it but the one that writes it"


@dataclass(frozen=True, slots=True, kw_only=True)
class Equal:
    """The file of one target beside the plan.

    Parameters
    ----------
    target, file
        Target, and the file that was read; empty for a file that ``equal`` wrote itself.
    verdict
        ``"equal"``, ``"differs"`` or ``"skipped"``.
    place, place_limit
        Largest difference in place and its limit, in ``unit``; None if skipped.
    unit
        ``"count"`` or ``"m"``.
    time_s, time_limit_s
        Largest difference in time and its limit; None where a firmware makes the time.
    at
        Line, block or row of the worst.
    note
        Further differences, times of a firmware, or why the target was skipped.
    """

    target: str
    verdict: str
    file: str = ""
    place: float | None = None
    place_limit: float | None = None
    unit: str = ""
    time_s: float | None = None
    time_limit_s: float | None = None
    at: str = ""
    note: str = ""

    def row(self) -> list[str]:
        """Return the texts of a row, in the order of ``HEADER``."""
        place, limit = (_length(value, self.unit) for value in (self.place, self.place_limit))
        times = [
            "-" if value is None else f"{1e3 * value:.3g} ms"
            for value in (self.time_s, self.time_limit_s)
        ]
        return [self.target, self.verdict, place, limit, *times, self.at or "-", self.note]

    def content(self) -> dict[str, Any]:
        """Return the fields as JSON content."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Equality:
    """A plan beside the files of controllers.

    Parameters
    ----------
    plan
        The plan.
    targets
        A row for each target, in the order asked for.
    """

    plan: Plan
    targets: tuple[Equal, ...]

    @property
    def passed(self) -> bool:
        """Whether no file differs; skipped targets do not count."""
        return all(one.verdict != "differs" for one in self.targets)

    def content(self) -> dict[str, Any]:
        """Return the answer as JSON content."""
        return {
            "job": self.plan.job.name,
            "machine": self.plan.machine.name,
            "equal": self.passed,
            "targets": [one.content() for one in self.targets],
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """The targets to compare, and files on disk for some of them.

    Parameters
    ----------
    targets
        Names; those that cannot be written or read are skipped.
    files
        File on disk by target.
    slower
        As for ``compile``.
    """

    targets: tuple[str, ...]
    files: Mapping[str, Path]
    slower: bool = False


def asked_of(
    machine: Machine,
    options: Options,
    targets: Sequence[str],
    files: Sequence[str],
    *,
    slower: bool = False,
) -> Asked:
    """Return what to compare; without targets and files, all targets of the kind of machine.

    Parameters
    ----------
    targets
        Names of targets.
    files
        ``TARGET=FILE`` each.

    Raises
    ------
    OptionError
        If a target is unknown, belongs to another kind of machine, cannot hold the plan, or is
        named twice; if a file is not given as TARGET=FILE or is not there.
    """
    own: dict[str, Path] = {}
    for text in files:
        name, equals, file = text.partition("=")
        if not (equals and name and file):
            raise OptionError(
                f"--file {text[:80]!r} is not TARGET=FILE", remedy="Write grbl=part.nc."
            )
        if name in own:
            raise OptionError(f"--file names {name} twice", remedy="Compare one file at a time.")
        own[name] = Path(file)
        if not own[name].is_file():
            raise OptionError(
                f"there is no file {file[:200]!r}", remedy="Give the file to compare."
            )
    named = list(dict.fromkeys([*targets, *own]))
    for name in named:
        check_target(name, machine, options)
    return Asked(targets=tuple(named or kind_of(machine).targets), files=own, slower=slower)


def equal_targets(
    plan: Plan, options: Options, asked: Asked, progress: Progress | None = None
) -> Equality:
    """Write ``plan`` for each target, read the files back, and compare them with the plan.

    Raises
    ------
    InputError
        If a given file cannot be read, or belongs to another job or machine; if no target at all
        could be compared.
    """
    found = []
    with tempfile.TemporaryDirectory(prefix="threadline-equal-") as folder:
        for number, target in enumerate(asked.targets):
            if progress is not None:
                progress(f"comparing {target}", number / len(asked.targets))
            given = asked.files.get(target)
            found.append(_one(plan, options, target, Path(folder), given, slower=asked.slower))
    if all(one.verdict == "skipped" for one in found):
        reasons = dict.fromkeys(f"{one.target}: {one.note}" for one in found)
        raise OptionError(
            f"no target was compared: {'; '.join(reasons)}",
            remedy="Name a target that can be compared: "
            f"{', '.join(name for name in kind_of(plan.machine).targets if _readable(name))}."
            if any(map(_readable, kind_of(plan.machine).targets))
            else "Compare a job of a machine with axes.",
        )
    return Equality(plan=plan, targets=tuple(found))


def _readable(target: str) -> bool:
    return target in TABLES or target in _PROGRAMS


def _one(
    plan: Plan, options: Options, target: str, folder: Path, given: Path | None, *, slower: bool
) -> Equal:
    """Return the row of one target; a target that cannot be compared is skipped with its reason."""
    from threadline.search.equal_programs import missing_reader

    why = "" if _readable(target) else _NO_READER
    why = why or missing_reader(target)
    fresh = folder / f"plan.{target}"
    if not why:
        try:
            check_target(target, plan.machine, options)
            write(plan, target, fresh, slower=slower)
        except (OptionError, PlanError) as error:
            if given is not None:
                raise
            why = f"not written: {' '.join(error.message.split())}"
    if why:
        return Equal(target=target, verdict="skipped", file=str(given or ""), note=why)
    path = fresh if given is None else given
    other = "" if given is None else _other_text(target, fresh, given)
    one = _table(plan, target, path) if target in TABLES else _program(plan, target, path)
    notes = [text for text in (other, one.note) if text]
    beyond = (
        (one.place or 0.0) > (one.place_limit or 0.0)
        or abs(one.time_s or 0.0) > (one.time_limit_s or 0.0)
        or bool(other)
        or (target in TABLES and bool(one.note))
    )
    return Equal(
        **{
            **one.content(),
            "verdict": "differs" if beyond else "equal",
            "file": str(given or ""),
            "note": "; ".join(notes),
        }
    )


def _table(plan: Plan, target: str, path: Path) -> Equal:
    from threadline.search.equal_tables import compare_table

    found = compare_table(target, plan, path)
    return Equal(
        target=target,
        verdict="",
        place=float(found.counts),
        place_limit=0.0,
        unit="count",
        time_s=found.time_s,
        time_limit_s=0.0,
        at=found.at,
        note=found.note,
    )


def _program(plan: Plan, target: str, path: Path) -> Equal:
    from threadline.search.equal_programs import PLACE_M, TIME_SHARE, compare_program

    found = compare_program(target, plan, path)
    return Equal(
        target=target,
        verdict="",
        place=found.place_m,
        place_limit=PLACE_M,
        unit="m",
        time_s=found.time_s,
        time_limit_s=None if found.time_s is None else TIME_SHARE * plan.duration_s,
        at=found.at,
        note=found.note,
    )


def _other_text(target: str, fresh: Path, given: Path) -> str:
    """Return the first part of a given file that ``compile`` writes otherwise; empty if none."""
    if target == "npz":
        return _other_arrays(fresh, given)
    wanted, found = (_lines(path) for path in (fresh, given))
    for (_, text), (number, other) in zip(wanted, found, strict=False):
        if text != other:
            return f"line {number} is {other[:40]!r}, compile writes {text[:40]!r}"
    if len(wanted) != len(found):
        return f"{len(found)} lines, compile writes {len(wanted)}"
    return ""


def _lines(path: Path) -> list[tuple[int, str]]:
    """Return the numbered lines of a file that are not empty, without blanks at their ends."""
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise RecordingError(
            f"the file is no text: {error.reason} at byte {error.start}",
            place=Place(str(path)),
            remedy="Give a file that compile wrote.",
        ) from error
    found = ((k, line.strip()) for k, line in enumerate(text.splitlines(), 1))
    return [(k, line) for k, line in found if line]


def _other_arrays(fresh: Path, given: Path) -> str:
    """Return the name of the first array that differs between two archives."""
    try:
        with np.load(fresh) as wanted, np.load(given) as found:
            for name in wanted.files:
                if name not in found.files or not np.array_equal(wanted[name], found[name]):
                    return f"{name} is not as compile writes it"
    except (ValueError, OSError, KeyError, EOFError, BadZipFile) as error:
        raise RecordingError(
            f"the file is no archive of arrays: {' '.join(str(error).split())[:120]}",
            place=Place(str(given)),
            remedy="Give a file that compile --target npz wrote.",
        ) from error
    return ""


def _length(value: float | None, unit: str) -> str:
    if value is None:
        return "-"
    return f"{value:.0f} count" if unit == "count" else f"{1e6 * value:.3g} um"

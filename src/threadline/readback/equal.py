"""Comparison of a plan with its files for many controllers: whether each file is that plan.

A file is read by something that did not write it: tick tables by csv, json and numpy, programs for
LinuxCNC by its own interpreter, step tables by a decoder of their documented format, programs of a
PLC scan by scan, programs for other firmwares by the code of the firmware where it is at hand. A
file on disk is also compared, line by line, with the file that ``compile`` writes.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from errno import EDQUOT, ENOSPC
from pathlib import Path
from typing import Any

from threadline.base.progress import Progress
from threadline.base.summary import Summarised, Summary
from threadline.commands.boards import BOARDS
from threadline.commands.plan import Plan
from threadline.commands.write import TABLES
from threadline.errors import InputError, OptionError, PlanError
from threadline.machine import Machine
from threadline.proof.kinds import kind_of
from threadline.proof.options import Options
from threadline.proof.pipeline import target_names, write
from threadline.proof.request import check_target
from threadline.readback.equal_found import UNITS, Curve, Found
from threadline.readback.equal_text import check_version, other_text

HEADER = ("target", "read by", "verdict", "place", "limit", "at the tool", "time", "limit", "worst")
EQUAL, DIFFERS, READ_BACK, SKIPPED = "equal", "differs", "read back", "skipped"
"""Verdicts. ``read back``: no difference, but only a reader of Threadline's has read the file."""
_SCHEDULES = ("st", "openplc", "plcopen", "scl")
_LEAST_SHOWN = 1e-4  # a smaller difference is a rounding error, and shown as 0
_COARSE = 1000.0  # um or urad from which a difference is shown in mm or mrad
_NO_READER = "no reader here is independent of its writer"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Equal:
    """The comparison of one target's file with the plan.

    Parameters
    ----------
    target, file
        Target, and the file that was read; empty for a file that ``equal`` wrote itself.
    verdict
        ``"equal"``, ``"differs"``, ``"read back"`` or ``"skipped"``.
    reader
        The reader of the file; empty if skipped.
    place, place_limit
        Largest difference in place and its limit, in ``unit``; None if skipped.
    unit, axis
        ``"count"``, ``"step"``, ``"m"`` or ``"rad"``, and the axis; empty for all together.
    tool_m
        The same difference at the tool, m; None where there is none.
    time_s, time_limit_s
        Largest difference in time, s, and its limit; None where a firmware sets the timing.
    at
        Line, block, row or step of the largest difference.
    note
        Further differences, times of a firmware, or why the target was skipped.
    missing
        The reader that could be installed, and how; empty if nothing is missing.
    curve
        The differences over time; None if skipped.
    """

    target: str
    verdict: str
    file: str = ""
    reader: str = ""
    place: float | None = None
    place_limit: float | None = None
    unit: str = ""
    axis: str = ""
    tool_m: float | None = None
    time_s: float | None = None
    time_limit_s: float | None = None
    at: str = ""
    note: str = ""
    missing: str = ""
    curve: Curve | None = None

    def row(self) -> list[str]:
        """Return the texts of a row, in the order of ``HEADER``."""
        place, limit = (_place(value, self.unit) for value in (self.place, self.place_limit))
        if self.axis and self.place:
            place = f"{self.axis} {place}"
        tool = "-" if self.tool_m is None else _place(self.tool_m, "m")
        times = [_time(value) for value in (self.time_s, self.time_limit_s)]
        cells = [self.target, self.reader or "-", self.verdict, place, limit, tool, *times]
        return [*cells, self.at or "-"]

    @property
    def remark(self) -> str:
        """Note and missing reader, each once; empty without either."""
        text = self.note if self.missing in self.note else f"{self.note}; {self.missing}"
        return text.removeprefix("; ")

    def content(self) -> dict[str, Any]:
        """Return the fields as JSON content, without the curve."""
        names = (name for name in self.__dataclass_fields__ if name != "curve")
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Equality(Summarised):
    """The comparison of a plan with files for controllers; prints itself as a table.

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
        return all(one.verdict != DIFFERS for one in self.targets)

    @property
    def missing(self) -> dict[str, str]:
        """Targets whose reader could be installed and is not, with the reason."""
        return {one.target: one.missing for one in self.targets if one.missing}

    def content(self) -> dict[str, Any]:
        """Return the answer as JSON content."""
        return {
            "job": self.plan.job.name,
            "machine": self.plan.machine.name,
            "equal": self.passed,
            "missing": self.missing,
            "targets": [one.content() for one in self.targets],
        }

    def _summary(self) -> Summary:
        title = f"{self.plan.job.name} on {self.plan.machine.name}"
        return Summary(title, HEADER, [one.row() for one in self.targets], self.closing())

    def closing(self) -> str:
        """Return the answer in one line."""
        count = {word: 0 for word in (EQUAL, DIFFERS, READ_BACK, SKIPPED)}
        for target_row in self.targets:
            count[target_row.verdict] += 1
        outcome = "equal" if self.passed else "NOT EQUAL"
        parts = [f"{count[EQUAL] + count[DIFFERS] + count[READ_BACK]} compared"]
        if count[READ_BACK]:
            parts.append(f"{count[READ_BACK]} of them by Threadline's own reader alone")
        return f"{outcome}: {', '.join([*parts, f'{count[SKIPPED]} skipped'])}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """The targets to compare, and files on disk for some of them.

    Parameters
    ----------
    targets
        Names; one that this kind of machine lacks, or that cannot be written or read, is skipped.
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
        If a target is unknown; if it belongs to another kind of machine or cannot hold the plan,
        and has a file or is the only one; if a file is named twice, is not given as TARGET=FILE or
        is not there.
    """
    files_given: dict[str, Path] = {}
    for text in files:
        name, equals, file = text.partition("=")
        if not (equals and name and file):
            raise OptionError(
                f"--file {text[:80]!r} is not TARGET=FILE", remedy="Write grbl=part.nc."
            )
        if name in files_given:
            raise OptionError(f"--file names {name} twice", remedy="Compare one file at a time.")
        files_given[name] = Path(file)
        if not files_given[name].is_file():
            raise OptionError(
                f"there is no file {file[:200]!r}", remedy="Give the file to compare."
            )
    names = list(dict.fromkeys([*targets, *files_given]))
    refusals = [error for name in names if (error := _refusal(name, machine, options)) is not None]
    for name in names:
        if name in files_given or name not in target_names() or len(refusals) == len(names):
            check_target(name, machine, options)
    return Asked(targets=tuple(names or kind_of(machine).targets), files=files_given, slower=slower)


def _refusal(target: str, machine: Machine, options: Options) -> OptionError | None:
    try:
        check_target(target, machine, options)
    except OptionError as error:
        return error
    return None


def equal_targets(
    plan: Plan, options: Options, question: Asked, progress: Progress | None = None
) -> Equality:
    """Write ``plan`` for each target, read the files back, and compare them with the plan.

    Raises
    ------
    InputError
        If a given file cannot be read, or belongs to another job or machine; an ``OptionError`` if
        no target at all could be compared.
    """
    rows = []
    with tempfile.TemporaryDirectory(prefix="threadline-equal-") as folder, _room_in(folder):
        for number, target in enumerate(question.targets):
            if progress is not None:
                progress(f"comparing {target}", number / len(question.targets))
            file_given = question.files.get(target)
            rows.append(
                _target_row(plan, options, target, Path(folder), file_given, slower=question.slower)
            )
    if all(row.verdict == "skipped" for row in rows):
        reasons = dict.fromkeys(f"{row.target}: {row.note}" for row in rows)
        raise OptionError(
            f"no target was compared: {'; '.join(reasons)}",
            remedy="Name a target that can be compared: "
            f"{', '.join(name for name in kind_of(plan.machine).targets if _readable(name))}."
            if any(map(_readable, kind_of(plan.machine).targets))
            else "Compare a job of a machine with axes.",
        )
    return Equality(plan=plan, targets=tuple(rows))


@contextmanager
def _room_in(folder: str) -> Iterator[None]:
    """Name the folder that the user may change if a disk is full, not a temporary file."""
    try:
        yield
    except (OSError, InputError) as error:
        cause: BaseException | None = error
        while cause is not None and getattr(cause, "errno", None) not in (ENOSPC, EDQUOT):
            cause = cause.__cause__ or cause.__context__
        if cause is None:
            raise
        raise OptionError(
            f"the files that are compared do not fit on the disk of {str(Path(folder).parent)!r}",
            remedy="Make room there, or let TMPDIR name a folder with more.",
        ) from error


def _readable(target: str) -> bool:
    return target in _COMPARED or target in _TAPES


def _missing(target: str) -> str:
    """Return the reader of a target that is not installed here, and how to get it."""
    if target in {"nc", "linuxcnc"}:
        from threadline.readback.equal_programs import missing_rs274

        return missing_rs274()
    if target in BOARDS:
        from threadline.readback.equal_firmware import missing_oracle

        return missing_oracle(target)
    return ""


def _target_row(
    plan: Plan, options: Options, target: str, folder: Path, given: Path | None, *, slower: bool
) -> Equal:
    """Return the row of one target; a target that cannot be compared is skipped with its reason."""
    missing = _missing(target) if target in kind_of(plan.machine).targets else ""
    skip_reason = "" if _readable(target) else _NO_READER
    if not skip_reason and target in {"nc", "linuxcnc"}:
        skip_reason = missing
    written_file = folder / f"plan{_SUFFIX.get(target, '')}.{_ENDING.get(target, target)}"
    if given is not None and given.suffix:
        written_file = folder / given.name
    if not skip_reason:
        try:
            check_target(target, plan.machine, options)
            write(plan, target, written_file, slower=slower)
        except (OptionError, PlanError) as error:
            if given is not None:
                raise
            skip_reason = f"not written: {' '.join(error.message.split())}"
    if skip_reason:
        file_text = str(given or "")
        return Equal(
            target=target, verdict=SKIPPED, file=file_text, note=skip_reason, missing=missing
        )
    text_difference = ""
    if given is not None:
        check_version(target, given, plan)
    if target in _TAPES:
        from threadline.readback.equal_tapes import compare_tape

        found = compare_tape(target, plan.stitched, given or written_file, written_file)
    else:
        found = _COMPARED[target](target, plan, given or written_file)
        text_difference = "" if given is None else other_text(target, written_file, given)
    notes = [text for text in (text_difference, found.wrong, found.note) if text]
    differs = found.beyond or bool(text_difference)
    return Equal(
        target=target,
        verdict=DIFFERS if differs else READ_BACK if found.own else EQUAL,
        file=str(given or ""),
        reader=found.reader,
        place=found.place,
        place_limit=found.place_limit,
        unit=found.unit,
        axis=found.axis,
        tool_m=found.tool_m,
        time_s=found.time_s,
        time_limit_s=found.time_limit_s,
        at=found.at,
        note="; ".join(notes),
        missing=missing,
        curve=found.curve,
    )


def _table(target: str, plan: Plan, path: Path) -> Found:
    from threadline.readback.equal_tables import compare_table

    return compare_table(target, plan, path)


def _interpreted(target: str, plan: Plan, path: Path) -> Found:
    from threadline.readback.equal_programs import compare_interpreted

    return compare_interpreted(target, plan, path)


def _firmware(target: str, plan: Plan, path: Path) -> Found:
    from threadline.readback.equal_firmware import compare_firmware

    return compare_firmware(target, plan, path)


def _schedule(target: str, plan: Plan, path: Path) -> Found:
    from threadline.readback.equal_schedule import compare_schedule

    return compare_schedule(target, plan.scheduled, path)


def _steps(target: str, plan: Plan, path: Path) -> Found:  # noqa: ARG001
    from threadline.readback.equal_steps import compare_steps

    return compare_steps(plan.stitched, path)


_COMPARED: Mapping[str, Callable[[str, Plan, Path], Found]] = {
    **dict.fromkeys(TABLES, _table),
    **dict.fromkeys(BOARDS, _firmware),
    **dict.fromkeys(("nc", "linuxcnc"), _interpreted),
    **dict.fromkeys(_SCHEDULES, _schedule),
    "steps": _steps,
}
"""For each target whose file something else can read, the function that compares the file."""
_TAPES = ("dst", "u01")
_ENDING = {"steps": "json", "openplc": "st", "plcopen": "xml"}
_SUFFIX = {"openplc": "-openplc"}


def _place(value: float | None, unit: str) -> str:
    if value is None:
        return "-"
    factor, name = UNITS[unit]
    scaled = factor * value
    if unit in {"m", "rad"} and abs(scaled) >= _COARSE:
        scaled, name = 1e-3 * scaled, {"m": "mm", "rad": "mrad"}[unit]
    return f"{scaled if abs(scaled) >= _LEAST_SHOWN else 0.0:.3g} {name}"


def _time(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{1e3 * value:.3g} ms" if abs(value) >= 1e-6 or not value else f"{1e9 * value:.3g} ns"

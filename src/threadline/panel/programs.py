"""Programs in the project folder, and the plan options that an operator's priority sets.

Names are names of files in the folder itself; nothing outside it is read or written.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from threadline.base.reading import reading_within
from threadline.commands.plan import Plan
from threadline.errors import JobError, OptionError, Place
from threadline.files.formats.common import atomic_file
from threadline.jobs import FORMATS, own_product
from threadline.jobs.operations import Job
from threadline.jobs.seam.job import AXES as SEAM_AXES
from threadline.machine import Machine
from threadline.proof.kinds import kind_of
from threadline.proof.option_form import Door, Group
from threadline.proof.option_table import options_for
from threadline.proof.options import Options, options_of
from threadline.proof.pipeline import Trials, open_job, plan_job
from threadline.search.least_limits import fastest_job
from threadline.search.paced import Question
from threadline.verdict import Spec

PROGRAMMED = "programmed"
"""Priority that changes no option."""
_MARGINS = {"optimum": 0.2, "speed": 0.0}
"""Share of every limit that the fastest plan must keep free, by priority."""


def by_priority(
    priority: str,
    job: Job,
    machine: Machine,
    spec: Spec,
    options: Options,
    trials: Trials,
    share: Callable[[str, float], None],
) -> Mapping[str, Any]:
    """Return the option words that a priority sets, in place of the request's.

    Parameters
    ----------
    priority
        ``accuracy`` is the operator's normal feed; ``speed`` the fastest feed and share of the
        machine's limits in spec; ``optimum`` the fastest that keeps 20 % of every limit free.
    trials
        The runs that judge every feed of the search.
    share
        Called with the share done of the search.

    Raises
    ------
    OptionError
        If the machine has no normal feed, the job is not paced by a feed, or nothing is in spec.
    """
    if job.paced_by != "feed":
        raise OptionError(
            f"{job.name} is not paced by a feed, but by: {job.paced_by}",
            remedy="Calculate it as programmed; threadline fastest searches it.",
        )
    if priority == "accuracy":
        if machine.operator is None:
            raise OptionError(
                f"{machine.name} has no normal feed",
                remedy="Give operator.normal_feed in the machine file, or a feed.",
            )
        return {"feed": f"{machine.operator.normal_feed.si!r} count/tick"}
    spec = spec.with_margin(_MARGINS[priority])
    question = Question(
        job=job, machine=machine, spec=spec, options=options, progress=share, trials=trials
    )
    candidate = fastest_job(question).best
    if candidate.found.best is None:
        raise OptionError(
            f"{job.name} is out of specification at every feed: {candidate.found.limited_by}",
            remedy="Calculate it as programmed, and look at what fails.",
        )
    return {"feed": f"{candidate.found.best!r} m/s", "limits": f"{candidate.share * 100.0!r} %"}


MOST_UPLOAD = 8 << 20
"""Largest accepted program, in bytes."""
_MOST_FILES = 500
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._ -]{0,99}")
_ENDINGS = tuple(ending for known in FORMATS for ending in known.extensions)
_BESIDE = (".svg", ".dxf", ".csv")
"""Suffixes of drawings and tables that belong to a program, and are no programs themselves."""
_MOST_LOOKED_AT = 4 << 20
_SHARED = {
    ".wind.toml": re.compile(rb"^[ \t]*(?:\[\[[ \t]*layer[ \t]*\]\]|layer[ \t]*=)", re.M),
    ".seam.toml": re.compile(b""),
    ".toml": re.compile(rb"^[ \t]*(?:\[\[[ \t]*operation[ \t]*\]\]|operation[ \t]*=)", re.M),
    ".txt": re.compile(rb"^[ \t]*(?:%|/?[GMNO][ \t]*[0-9]|\[G-CODE GENERATED)", re.M | re.I),
}
"""Suffixes that files other than jobs also have, and the words by which a job is recognised: the
layers of a winding, the operations of a move list, and the first words of a part program's lines. A
product file without layers is no job; every seam file is a job. The first suffix that fits
applies."""
_SEAM, _WINDING = "seam", "winding"
_PART_PROGRAMS = FORMATS[0].extensions
_REALTIME = re.compile(rb"[?!~\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\xff]")
"""Bytes that a controller executes wherever they are, even in a comment."""


def program_names(folder: Path, machine: Machine) -> list[str]:
    """Return the names of the jobs in a folder that suit a machine, sorted, at most 500.

    The suffix gives the format; if other files use it too, the content decides whether it is a job.
    The errors of a job appear when it is calculated.
    """
    names = sorted(
        file.name
        for file in folder.iterdir()
        if _NAME.fullmatch(file.name)
        and _is_taken(file.name.lower(), machine)
        and file.is_file()
        and not file.is_symlink()
        and _may_be_job(file)
    )
    return names[:_MOST_FILES]


def _is_taken(name: str, machine: Machine) -> bool:
    """Return whether a machine accepts the format of a file name's suffix.

    A drawing alone is no seam: the seam file adds stitch length and speed.
    """
    job_format = next(
        (candidate for candidate in FORMATS if name.endswith(candidate.extensions)), None
    )
    if (
        job_format is None
        or job_format.name not in kind_of(machine).takes
        or name.endswith(_BESIDE)
    ):
        return False
    axes = machine.axes
    if job_format.name == _WINDING:
        return machine.tool is not None and machine.tool.kind == "eye"
    return job_format.name != _SEAM or all(
        a in axes and axes[a].kind == "linear" for a in SEAM_AXES
    )


def _may_be_job(file: Path) -> bool:
    """Return whether a file with an ambiguous suffix looks like a job."""
    name = file.name.lower()
    words = next((words for ending, words in _SHARED.items() if name.endswith(ending)), None)
    if words is None:
        return True
    try:
        with file.open("rb") as stream:
            return bool(words.search(stream.read(_MOST_LOOKED_AT)))
    except OSError:
        return True  # the error appears when it is calculated


def program_path(folder: Path, name: str) -> Path:
    """Return the file of a program.

    Raises
    ------
    JobError
        If it is not the name of a file in the folder itself, or the name of a link.
    """
    if not _NAME.fullmatch(name):
        raise JobError(
            f"{name[:60]!r} is not a name of a program in the project folder",
            remedy="Use letters, digits, blanks, dots, dashes and underscores.",
        )
    path = folder / name
    if path.is_symlink():
        raise JobError(
            f"{name[:60]!r} is a link, and the panel follows none",
            remedy="Put the file itself into the project folder.",
        )
    return path


def untaught(machine: Machine) -> str:
    """Return why no part program can be taught to a machine; empty if one can."""
    takes = kind_of(machine).takes
    if FORMATS[0].name in takes:
        return ""
    return f"{machine.name} takes {' and '.join(f'{one}s' for one in takes)}, no part programs"


class ThereAlreadyError(JobError):
    """A file with the name of an upload exists, and the client did not agree to replace it."""


def take_program(folder: Path, name: str, content: bytes, *, overwrite: bool) -> None:
    """Write a client's program into the folder; all or nothing.

    Raises
    ------
    ThereAlreadyError
        If a file with that name exists, and ``overwrite`` is False.
    JobError
        If its name, format or content is not accepted.
    """
    path = program_path(folder, name)
    if not name.lower().endswith((*_ENDINGS, *_BESIDE)):
        raise JobError(
            f"{name[:60]!r} has a suffix of no format of jobs or drawings",
            remedy=f"Known: {', '.join(dict.fromkeys((*_ENDINGS, *_BESIDE)))}.",
        )
    if len(content) > MOST_UPLOAD:
        raise JobError(
            f"the program has {len(content)} bytes, limit {MOST_UPLOAD}",
            place=Place(name),
            remedy="Copy it into the project folder.",
        )
    if name.lower().endswith(_PART_PROGRAMS):
        _refuse_realtime(name, content)
    if path.exists() and not overwrite:
        raise ThereAlreadyError(f"{name} is in the project folder already", remedy="")
    try:
        with atomic_file(path) as file:
            file.write(content)
    except OSError as error:
        why = error.strerror or error
        raise JobError(f"{name[:60]!r} cannot be written: {why}", place=Place(name)) from error


def _refuse_realtime(name: str, content: bytes) -> None:
    for number, line in enumerate(content.splitlines(), 1):
        if (found := _REALTIME.search(line)) is not None:
            raise JobError(
                f"controllers execute the byte {found[0][0]:#04x} at once",
                place=Place(name, number),
                remedy="Take it out, even from comments.",
            )


def words_of(content: Mapping[str, Any], program: Path | None = None) -> Options:
    """Return the options of a calculation from a client's request.

    A ``program`` that is a winding is judged on its own product, unless the request names another.

    Raises
    ------
    InputError
        If an option cannot be read, or the winding.
    """
    words = [entry.word for entry in options_for("panel", Door.PANEL, [Group.PLAN])]
    given = {word: content[word] for word in words}
    if program is not None and given["product"] is None:
        given["product"] = own_product(program)
    return options_of(**given)


def planned(folder: Path, content: Mapping[str, Any], machine: Machine) -> tuple[Plan, Options]:
    """Return the plan of a program, and its options.

    It reads no file outside the folder, even if the program or an option names one.

    Raises
    ------
    InputError
        If the program cannot be read or planned.
    """
    with reading_within(folder):
        path = program_path(folder, str(content["program"]))
        options = words_of(content, path)
        return plan_job(open_job(path, machine, options), machine, options), options

"""``threadline design`` in parts: ``--part 3/16 -o FILE`` anywhere, then ``--merge FILE...``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from threadline.base.progress import Progress
from threadline.cli.output import print_json, say
from threadline.cli.yield_sharing import (
    check_merge_options,
    recorded_words,
    words_for_part,
)
from threadline.proof.request import Words
from threadline.search.design import DesignResult, redesign
from threadline.search.design_parts import (
    DesignPart,
    DesignRecord,
    design_identity,
    read_design_parts,
    searches_of,
    write_design_part,
)
from threadline.search.design_question import DesignAims, DesignQuestion
from threadline.search.yield_parts import Part


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignRequest:
    """Job, machine and options of a redesign: from the command line, or from the parts.

    Parameters
    ----------
    job, machine, words, aims
        As typed, or as the parts say.
    parts
        All parts to merge; none for a redesign that is searched here.
    """

    job: Path
    machine: str
    words: Words
    aims: DesignAims
    parts: Sequence[DesignPart] = ()


def design_of_parts(
    files: Sequence[Path], machine: str | None, words: Words, aims: DesignAims
) -> DesignRequest:
    """Return the question that the record of the parts in ``files`` states.

    Parameters
    ----------
    machine, words
        As typed with ``--merge``: neither may be given.
    aims
        As typed: only the plotted parameters may be given.

    Raises
    ------
    OptionError
        If an option is given that the parts decide, or the parts are not one redesign.
    RecordingError
        If a file cannot be read as a part.
    """
    given = {
        "--corners": aims.corners,
        "--front": aims.front or None,
        "--searches": None if aims.searches == 1 else aims.searches,
    }
    check_merge_options(machine, words, given)
    parts = read_design_parts(files)
    record = parts[0].record
    job, machine_name, part_words = recorded_words("design", record.words, parts[0].path)
    part_aims = replace(aims, corners=record.corners, front=record.front, searches=record.searches)
    return DesignRequest(
        job=job, machine=machine_name, words=part_words, aims=part_aims, parts=parts
    )


def make_part(
    output: Path,
    part: Part,
    request: DesignRequest,
    asked: DesignQuestion,
    progress: Progress,
) -> DesignRecord:
    """Make the searches of a part, and write them; return the record of the part."""
    question = redesign(asked.job, asked.machine, asked.spec, asked.options, asked.requirements)
    record = DesignRecord(
        identity=design_identity(question),
        words={
            "job": str(request.job),
            "machine": request.machine,
            **words_for_part(request.words),
        },
        corners=request.aims.corners,
        front=request.aims.front,
        searches=request.aims.searches,
        part=part,
    )
    searches = question.searched(searches_of(part, request.aims.searches), progress)
    write_design_part(output, record, searches)
    return record


def tell_part(output: Path, record: DesignRecord, *, json: bool) -> None:
    """Print the content of a part."""
    numbers = searches_of(record.part, record.searches)
    if json:
        print_json(
            {
                "part": str(record.part),
                "first": numbers.start + 1,
                "made": len(numbers),
                "searches": record.searches,
                "file": str(output),
            }
        )
    else:
        say(
            f"Part {record.part}: {output}, searches {numbers.start + 1} to {numbers.stop} of "
            f"{record.searches}"
        )


def merged_design(
    parts: Sequence[DesignPart], asked: DesignQuestion, progress: Progress
) -> DesignResult:
    """Return the answer of all parts, the same to the bit as of one run.

    Raises
    ------
    OptionError
        If job, machine, options or versions differ from the parts', or if the machine of the file
        has another result on this computer.
    """
    question = redesign(asked.job, asked.machine, asked.spec, asked.options, asked.requirements)
    identity = design_identity(question)
    for part in parts:
        present_record = replace(part.record, identity=identity)
        part.record.check_same(part.path, present_record, "this Threadline and the files here")
    return question.answer([search for part in parts for search in part.searches], progress)

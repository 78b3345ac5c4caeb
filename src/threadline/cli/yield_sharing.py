"""``threadline yield`` in parts: ``--part 3/16 -o FILE`` anywhere, then ``--merge FILE...``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from threadline import __version__
from threadline.base.writing import is_stdout
from threadline.cli.output import print_json, say
from threadline.commands.plan import Plan
from threadline.errors import OptionError, RecordingError
from threadline.proof.option_form import Door, Group, Type, Word
from threadline.proof.option_table import options_for
from threadline.proof.proof_file import options_sha256
from threadline.proof.proof_hash import spec_sha256
from threadline.proof.request import Words, known_words
from threadline.search.machine_yield import Yield
from threadline.search.yield_parts import Part, PartFile, Record, read_parts, write_part
from threadline.verdict import Spec

_KINDS: Mapping[Type, type] = {Type.FLAG: bool, Type.COUNT: int}
_ENGINES = ("numpy", "scipy", "numba")


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """Job, machine and options of a yield: from the command line, or from the parts.

    Parameters
    ----------
    job, machine, words
        As typed.
    variants, seed
        Length and seed of the sequence of machines.
    parts
        All parts to merge; none for a yield that is drawn here.
    """

    job: Path
    machine: str
    words: Words
    variants: int
    seed: int
    parts: Sequence[PartFile] = ()


def question_from_words(
    files: Sequence[Path], machine: str | None, words: Words, variants: int = 0, seed: int = 0
) -> Question:
    """Return the question of the command line.

    Raises
    ------
    OptionError
        If there are several jobs, or no machine is named.
    """
    if len(files) > 1:
        raise OptionError(
            f"there are {len(files)} jobs: {str(files[0])!r}, {str(files[1])!r} ...",
            remedy="Give one JOB; with --merge, the files of all parts.",
        )
    if machine is None:
        raise OptionError(
            "no machine is named", remedy="Give --machine NAME; threadline machines lists them."
        )
    return Question(job=files[0], machine=machine, words=words, variants=variants, seed=seed)


def question_from_parts(
    files: Sequence[Path], machine: str | None, words: Words, given: Mapping[str, object]
) -> Question:
    """Return the question that the record of the parts in ``files`` states.

    Parameters
    ----------
    machine, words
        As typed with ``--merge``: neither may be given.
    values
        Options that have no meaning for a merge, or another value than in the parts: each by its
        name, with its value, None if it was left out.

    Raises
    ------
    OptionError
        If an option is given that the parts decide, or the parts are not one yield.
    RecordingError
        If a file cannot be read as a part.
    """
    check_merge_options(machine, words, given)
    parts = read_parts(files)
    record = parts[0].record
    job, machine_name, part_words = recorded_words("yield", record.words, parts[0].path)
    return Question(
        job=job,
        machine=machine_name,
        words=part_words,
        variants=record.variants,
        seed=record.seed,
        parts=parts,
    )


def check_merge_options(machine: str | None, words: Words, given: Mapping[str, object]) -> None:
    """Refuse options of a merge that the parts decide.

    Raises
    ------
    OptionError
        If one is given.
    """
    planning_words = words_for_part(words)
    typed = [] if machine is None else ["--machine"]
    typed += [one.typed for one in options_for(words.verb) if one.word in planning_words]
    typed += [name for name, value in given.items() if value not in (None, False)]
    if typed:
        raise OptionError(
            f"--merge takes job, machine and options from the parts, and {typed[0]} was given",
            remedy=f"Leave {typed[0]} out.",
        )


def recorded_words(verb: str, words: Mapping[str, Word], path: Path) -> tuple[Path, str, Words]:
    """Return job, machine and options that the record of the part in ``path`` states.

    Raises
    ------
    OptionError, RecordingError
        If it does not name them, or a word is no option of the verb.
    """
    remaining = dict(words)
    job, machine_name = remaining.pop("job", None), remaining.pop("machine", None)
    if not isinstance(job, str) or not isinstance(machine_name, str):
        raise RecordingError(
            f"{str(path)!r} does not name its job and machine", remedy="Make that part again."
        )
    if not Path(job).exists():
        raise OptionError(
            f"the parts are of job {job!r}, and it is not here",
            remedy="Merge in the folder in which the parts were made, or in a copy of it.",
        )
    return Path(job), machine_name, words_of_part(verb, remaining, path)


def words_of_part(verb: str, recorded: Mapping[str, Word], path: Path) -> Words:
    """Return the words that the record of a part states.

    Raises
    ------
    OptionError, RecordingError
        If a word is no option of the verb, or has another type.
    """
    table = {one.word: one for one in options_for(verb)}
    for word, value in recorded.items():
        if word in table and type(value) is not _KINDS.get(table[word].type, str):
            raise RecordingError(
                f"{str(path)!r} has an option {word!r} of another type",
                remedy="Make that part again.",
            )
    return Words(verb, known_words(verb, Door.LINE, recorded))


def words_for_part(words: Words) -> dict[str, str | int | float | bool]:
    """Return the words that differ from their defaults; where machines are judged is left out."""
    where_judged = {one.word for one in options_for(words.verb, groups=[Group.WHERE])}
    given = {
        word: value if isinstance(value, bool | int | float) else str(value)
        for word, value in words.values.items()
        if value is not None and value is not False and word not in where_judged
    }
    defaults = known_words(words.verb, Door.LINE, {})
    return {word: value for word, value in given.items() if value != defaults[word]}


def record_of(question: Question, identity: Mapping[str, str], part: Part) -> Record:
    """Return the record of a part of the yield; where it was judged does not matter."""
    words = words_for_part(question.words)
    return Record(
        identity=identity,
        words={"job": str(question.job), "machine": question.machine, **words},
        seed=question.seed,
        variants=question.variants,
        part=part,
    )


def part_identity(plan: Plan, spec: Spec) -> dict[str, str]:
    """Return everything that the results of a part depend on, but seed and number of machines."""
    return {
        "job": plan.job.sha256,
        "machine": plan.machine.sha256,
        "specification": spec_sha256(spec),
        "set of options": options_sha256(plan),
        "plan": plan.commands.rows_sha256(),
        "version of threadline": __version__,
        **{f"version of {name}": version(name) for name in _ENGINES},
    }


def check_part_options(
    output: Path | None, given: Mapping[str, object], whole: str = "yield", some: str = "machines"
) -> None:
    """Refuse options that have no meaning for one part, and a missing or unusable file.

    Parameters
    ----------
    values
        Options of the whole, by name; None or False for options that were left out.
    whole, some
        Names of the divided work, and of its items.

    Raises
    ------
    OptionError
        If the part has no output file, or an option belongs to the whole work.
    """
    typed = [name for name, value in given.items() if value not in (None, False)]
    if typed:
        raise OptionError(
            f"{typed[0]} needs the whole {whole}, and --part judges only some of its {some}",
            remedy=f"Give {typed[0]} to --merge.",
        )
    if output is None:
        raise OptionError("--part has no file for its results", remedy="Give -o FILE.")
    if is_stdout(output):
        raise OptionError(
            f"-o {str(output)!r} is the output of the answer itself", remedy="Name a file."
        )


def finish_part(output: Path, record: Record, found: Yield, *, json: bool) -> None:
    """Write a part, and say so."""
    write_part(output, record, found.found)
    machines = record.part.machines(record.variants)
    if json:
        content: dict[str, Any] = {
            "part": str(record.part),
            "first": machines.start,
            "runs": len(machines),
            "variants": record.variants,
            "seed": record.seed,
            "passed": found.passed,
            "file": str(output),
        }
        print_json(content)
    else:
        say(
            f"Part {record.part}: {output}, machines {machines.start} to {machines.stop - 1} of "
            f"{record.variants}, {found.passed} of {len(machines)} in spec"
        )

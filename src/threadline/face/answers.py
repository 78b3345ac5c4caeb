"""Answers of the Python interface: verdicts, proofs, and the result of a search for speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from threadline.base.arguments import checked
from threadline.base.arrays import FloatArray
from threadline.base.summary import MOST_ROWS, Summary, html_table
from threadline.base.wording import plain
from threadline.base.writing import staged_file, together
from threadline.errors import OptionError
from threadline.files.recording import columns_of
from threadline.proof.option_form import Word
from threadline.verdict import Result, Verdict, closing, verdict_json, verdict_rows

if TYPE_CHECKING:
    from threadline.commands.plan import Plan
    from threadline.files import Recording
    from threadline.files.formats import Written
    from threadline.proof.pipeline import Proof
    from threadline.proof.recorded import Judged
    from threadline.search import Certainty, Mismatch


PathLike = str | Path


_URGENCY = {"failed": 0, "not-measured (required)": 1, "passed": 2}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Answer:
    """A verdict and its plan; prints itself in at most ten lines, in a notebook as a table.

    Parameters
    ----------
    of
        A proof; or recordings with the plan and the specification by which they were judged.
    """

    of: Proof | Judged

    @property
    def plan(self) -> Plan:
        """The plan of the job."""
        return self.of.plan

    @property
    def verdict(self) -> Verdict:
        """Every criterion, with its measured value."""
        return self.of.verdict

    @property
    def passed(self) -> bool:
        """Whether no criterion failed and every required criterion was measured."""
        return self.of.verdict.passed

    @checked
    def result(self, criterion: str, axis: str = "") -> Result:
        """Return the result of a criterion, for the worst axis if none is named.

        Raises
        ------
        KeyError
            If the criterion was not judged.
        """
        return self.of.verdict.result(criterion, axis)

    def json(self) -> dict[str, Any]:
        """Return the output of the command line with ``--json``."""
        return verdict_json(self.of.verdict, self.of.plan)

    def __repr__(self) -> str:
        _, rows, more = self._summary()
        parts = [row[:4] for row in rows]
        widths = [max(map(len, column)) for column in zip(*parts, strict=True)]
        lines = [f"{self._title()}: {closing(self.of.verdict)}"]
        for (name, axis, measured, limit), row in zip(parts, rows, strict=True):
            figures = f"{measured:>{widths[2]}}  limit {limit:<{widths[3]}}"
            where = "" if row[6] == "-" else f", line {row[6]}"
            lines.append(f"  {name:<{widths[0]}}  {axis:<{widths[1]}}  {figures}  {row[4]}{where}")
        return "\n".join(plain(line) for line in [*lines, *([f"  {more}"] if more else [])])

    def _repr_html_(self) -> str:
        header, rows, more = self._summary()
        below = "; ".join(filter(None, (closing(self.of.verdict), more)))
        return html_table(Summary(self._title(), header, rows, below))

    def _title(self) -> str:
        plan = self.of.plan
        return f"{plan.job.name} on {plan.machine.name}, {plan.duration_s:.4g} s"

    def _summary(self) -> tuple[list[str], list[list[str]], str]:
        """Return the table header, the rows of the most urgent criteria, and a closing line."""
        header, rows = verdict_rows(self.of.verdict)
        rows.sort(key=lambda row: _URGENCY.get(row[4], len(_URGENCY)))
        others = len(rows) - MOST_ROWS
        more = f"and {others} more; .verdict.results has all of them" if others > 0 else ""
        return header, rows[:MOST_ROWS], more


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Proved(Answer):
    """A proof: a plan, its recording on the simulated machine, and the verdict."""

    of: Proof

    @property
    def recording(self) -> Recording:
        """The recording of the simulated machine."""
        return self.of.recording

    @checked
    def columns(self, run: int = 1) -> dict[str, FloatArray]:
        """Return the channels of a judged run as columns, for plots and data frames.

        The first column is ``time [s]``. The other columns are named after their channel and its
        unit, such as ``X.load [m]``. All columns have the same length: a channel with fewer samples
        holds each sample until its next one, and is NaN before its first sample.

        Raises
        ------
        OptionError
            If there is no such run.
        """
        if not 1 <= run <= self.of.runs:
            raise OptionError(
                f"run={run} is none of the {self.of.runs} judged", remedy="Give run=1."
            )
        return columns_of(self.of.run(run))

    @checked
    def report(self, folder: PathLike) -> Path:
        """Write the report (HTML, PDF, PNG, SVG) into a folder; return the path of its page.

        A proof over the tolerances adds the machine file of the worst machine, ``worst.toml``.

        Raises
        ------
        OptionError
            If ``folder`` is a file, or its ``worst.toml`` is a machine file of this proof.
        """
        from threadline.proof.proof_file import write_worst_beside
        from threadline.report.proof import write_report
        from threadline.search.report_data import report_data

        place = Path(folder)
        if place.exists() and not place.is_dir():
            raise OptionError(
                f"cannot write {str(place)!r}: it is a file, not a folder",
                remedy="Give the folder of the report.",
            )
        with together():
            page = write_report(report_data(self.of), place)
            write_worst_beside(self.of, place)
        return page

    @checked
    def write(self, file: PathLike, sign: PathLike | None = None) -> Written:
        """Write the proof as a file (see ``docs/files.md``), signed with the key in ``sign``."""
        from threadline.proof.proof_file import write_proof
        from threadline.proof.proof_hash import read_key

        return write_proof(self.of, file, None if sign is None else read_key(sign))

    @checked
    def record(self, file: PathLike) -> Written:
        """Write the recording; the extension of the file name selects the format."""
        from threadline.files.formats import write_recording

        return write_recording(self.of.recording, file)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FastestResult:
    """The result of a search for the fastest way to do a job in spec.

    Parameters
    ----------
    best
        The highest feed (m/s of the fastest axis, or a factor on the program's feeds if these
        differ) or needle speed (stitch/s) in spec, the shortest cycle of a move list (s), or the
        shortest duration of an embroidery design (s); None if nothing is in spec.
    unit
        ``"m/s"``, ``"stitch/s"`` or ``"s"``; empty for a factor.
    limited_by
        The criterion that a faster plan would fail, or where nothing is in spec, that the closest
        plan fails.
    of
        The result of the search in ``threadline.search``, with every try; its type depends on the
        job (``docs/api.md``).
    best_options
        The planning options of the best plan: ``tl.prove(job, machine, **best_options)`` proves it.
        None if nothing is in spec, or if the moves of the best cycle have commands and waits of
        their own: no option of ``prove`` gives the command of a single move, and ``move_list`` has
        them.
    move_list
        The best cycle of a move list, as text of a file that ``prove`` takes in place of the job;
        ``write`` writes it. None for other jobs, or if nothing is in spec.
    certainty
        Loss of speed that is due to the options ``ends``, ``band`` or ``robust``; None without one
        of them.
    mismatch
        The fastest plan for each machine at the ends of the tolerances; empty without the option
        ``mismatch``.
    ended
        Why the search stopped early, such as ``"out of time"``; the result is then the best so far.
        Empty for a complete search.
    """

    best: float | None
    unit: str
    limited_by: str
    of: Any
    best_options: Mapping[str, Any] | None = None
    move_list: str | None = None
    certainty: Certainty | None = None
    mismatch: tuple[Mismatch, ...] = ()
    ended: str = ""
    _asked: Callable[..., Proved] | None = None
    _end: str = "the end of the search"
    _pace: str = "feed"  # empty for a cycle, which has none
    _job: Path | None = None

    def prove(self, file: PathLike | None = None, **words: Word) -> Proved:
        """Prove the best: the same job on the same machine, with ``best_options``.

        Parameters
        ----------
        file
            For a move list: the file for ``move_list``. It is written and proved in place of the
            job, which is necessary where no options describe the best cycle.
        **words
            Options of ``prove`` that replace options of the search, such as ``level="nominal"``.

        Raises
        ------
        OptionError
            If nothing was in spec, if only a move list can describe the best plan and no file is
            given, or if a file is given for another job.
        """
        if self.best is None:
            raise self._nothing_found()
        if file is not None and self._asked is not None:
            return self._asked(self.write(file), **words)
        if self._asked is None or self.best_options is None:
            raise OptionError(
                "only a move list can describe the best plan, and there is no file for it",
                remedy='Give one: .prove("best.toml").',
            )
        return self._asked(None, **{**self.best_options, **words})

    @checked
    def write(self, file: PathLike) -> Path:
        """Write ``move_list``; ``tl.prove`` takes the returned file in place of the job.

        Raises
        ------
        OptionError
            If nothing was in spec, if the job is no move list, or if the file is the job itself.
        """
        if self.best is None:
            raise self._nothing_found()
        if self.move_list is None:
            raise OptionError(
                "the job is no move list: the best plan has options, and no file",
                remedy="Give best_options to prove, or call .prove() without a file.",
            )
        path = Path(file)
        if self._job is not None and path.exists() and path.samefile(self._job):
            raise OptionError(
                f"{str(path)!r} is the move list that was searched", remedy="Give another file."
            )
        with staged_file(path) as stream:
            stream.write(self.move_list.encode())
        return path

    def _nothing_found(self) -> OptionError:
        """Return the error for the proof of a best plan where no plan is in spec."""
        from threadline.search.deadline import INTERRUPTED

        if self.ended:
            return OptionError(
                f"no plan in spec was found before the search stopped ({self.ended}), so there is "
                "no best plan to prove",
                remedy="Let it search to its end."
                if self.ended == INTERRUPTED
                else "Give within= a longer time.",
            )
        return OptionError(
            "nothing was in spec, so there is no best plan to prove",
            remedy=f"Prove with a lower {self._pace}, or with wider limits."
            if self._pace
            else "Give wider limits, or another move list or machine.",
        )

    def __repr__(self) -> str:
        """Return the answer in a few lines; ``of`` has every try."""
        from threadline.search.fastest import RANGE

        limit = self._end if self.limited_by == RANGE else self.limited_by
        if self.best is None and self.ended:
            return f"no plan in spec was found so far ({self.ended}), limited by {limit}"
        if self.best is None:
            return f"nothing is in spec, limited by {limit}"
        unit = self.unit or "times the feeds of the program"
        options = ", ".join(
            f"{name}={value!r}" for name, value in (self.best_options or {}).items()
        )
        duration_s = getattr(getattr(self.of, "best", None), "duration_s", None)
        lasting = "" if duration_s is None else f"{duration_s:.6g} s at "
        so_far = f" so far ({self.ended})" if self.ended else ""
        lines = [f"fastest{so_far}: {lasting}{self.best:.6g} {unit}, limited by {limit}"]
        if self.best_options is None:
            told = (
                '  no options describe it; .prove("best.toml") writes its move list and proves it'
            )
        else:
            told = f"  .prove() proves it: {options}" if options else "  .prove() proves it"
        return "\n".join([*lines, told])

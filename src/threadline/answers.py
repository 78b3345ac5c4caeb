"""What the functions of the face answer: a verdict, a proof, or what a search found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from threadline.arguments import checked
from threadline.errors import OptionError
from threadline.escaping import plain
from threadline.verdict import Result, Verdict, closing, verdict_json, verdict_rows

if TYPE_CHECKING:
    from threadline.pipeline import Proof
    from threadline.plan import Plan
    from threadline.recorded import Judged
    from threadline.signals import Recording
    from threadline.signals.files import Written

PathLike = str | Path
_MOST_ROWS = 7  # of the criteria that an answer prints: with the lines around them ten in all
_URGENCY = {"failed": 0, "not-measured (required)": 1, "passed": 2}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Answer:
    """A verdict and its plan; prints itself in at most ten lines, in a notebook as a table.

    Parameters
    ----------
    of
        A proof; of recordings, the plan and the specification that they were judged by.
    """

    of: Proof | Judged

    @property
    def plan(self) -> Plan:
        """What was intended."""
        return self.of.plan

    @property
    def verdict(self) -> Verdict:
        """Every criterion, with what was measured."""
        return self.of.verdict

    @property
    def passed(self) -> bool:
        """Whether nothing failed and all that is required was measured."""
        return self.of.verdict.passed

    @checked
    def result(self, criterion: str, axis: str = "") -> Result:
        """Return the result of a criterion, of the worst axis where none is named.

        Raises
        ------
        KeyError
            If it was not judged.
        """
        return self.of.verdict.result(criterion, axis)

    def json(self) -> dict[str, Any]:
        """Return what the command line prints with ``--json``."""
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
        lines = [f"<table><caption>{escape(plain(self._title()))}</caption>"]
        for tag, row in [("th", header), *(("td", row) for row in rows)]:
            cells = "".join(f"<{tag}>{escape(plain(cell))}</{tag}>" for cell in row)
            lines.append(f"<tr>{cells}</tr>")
        below = "; ".join(filter(None, (closing(self.of.verdict), more)))
        return "\n".join([*lines, f"</table><p>{escape(plain(below))}</p>"])

    def _title(self) -> str:
        plan = self.of.plan
        return f"{plan.job.name} on {plan.machine.name}, {plan.duration_s:.4g} s"

    def _summary(self) -> tuple[list[str], list[list[str]], str]:
        """Return header and rows of the most urgent criteria, and a line about the others."""
        header, rows = verdict_rows(self.of.verdict)
        rows.sort(key=lambda row: _URGENCY.get(row[4], len(_URGENCY)))
        others = len(rows) - _MOST_ROWS
        more = f"and {others} more; .verdict.results has all of them" if others > 0 else ""
        return header, rows[:_MOST_ROWS], more


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Proved(Answer):
    """A proof: a plan, what the simulated machine made of it, and the verdict."""

    of: Proof

    @property
    def recording(self) -> Recording:
        """What happened on the simulated machine."""
        return self.of.recording

    @checked
    def report(self, folder: PathLike) -> Path:
        """Write the report (HTML, PDF, PNG, SVG) into a folder; return its page."""
        from threadline.report import write_report
        from threadline.search.studied import studied

        place = Path(folder)
        if place.exists() and not place.is_dir():
            raise OptionError(
                f"cannot write {str(place)!r}: it is a file, not a folder",
                remedy="Give the folder of the report.",
            )
        return write_report(studied(self.of), place)

    @checked
    def write(self, file: PathLike, sign: PathLike | None = None) -> Written:
        """Write the proof as a file, see ``docs/files.md``; ``sign`` is the file of a key."""
        from threadline.proof_file import read_key, write_proof

        return write_proof(self.of, file, None if sign is None else read_key(sign))

    @checked
    def record(self, file: PathLike) -> Written:
        """Write the recording; the ending of the file says how."""
        from threadline.signals.files import write_recording

        return write_recording(self.of.recording, file)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The result of a search for the fastest way to do a job in spec.

    Parameters
    ----------
    best
        The highest feed (m/s of the fastest axis, or a share of the program's feeds where these
        differ) or needle speed (stitch/s) in spec, the shortest cycle of a move list (s), or the
        shortest duration of an embroidery design (s); None where nothing is in spec.
    unit
        ``"m/s"``, ``"stitch/s"`` or ``"s"``; empty for a share.
    limited_by
        The criterion that forbids more.
    of
        The result of the search in ``threadline.search``, with every try; its type depends on the
        job (``docs/api.md``).
    best_options
        The options of planning with which ``prove`` plans the best: ``tl.prove(job, machine,
        **best_options)``. None where nothing is in spec, or where only a move list can say it.
    """

    best: float | None
    unit: str
    limited_by: str
    of: Any
    best_options: Mapping[str, Any] | None = None

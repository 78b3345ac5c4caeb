"""What the functions of the face answer: a verdict, a proof, or what a search found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from threadline.arguments import checked
from threadline.errors import OptionError
from threadline.verdict import Result, Verdict, verdict_json

if TYPE_CHECKING:
    from threadline.pipeline import Proof
    from threadline.plan import Plan
    from threadline.recorded import Judged
    from threadline.signals import Recording
    from threadline.signals.files import Written

PathLike = str | Path


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """A verdict, with the plan that it is of.

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


@dataclass(frozen=True, slots=True, eq=False)
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

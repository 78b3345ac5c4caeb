"""The report of a proof with axes: facts, lines below the verdict, circuits, captions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.wording import grouped
from threadline.commands.plan import Plan
from threadline.dynamics import Demand
from threadline.files import TickTable, tick_table
from threadline.files.formats.plt import LINES_1994
from threadline.jobs.gcode.feeds import of_which
from threadline.jobs.operations import Job, Source, begins_circuit
from threadline.motion.timing.optimal.binding import BINDS
from threadline.proof.pipeline import Proof
from threadline.proof.recorded import warnings_of
from threadline.report.document import (
    Document,
    Table,
    changes,
    options_facts,
    origin_facts,
    run_facts,
)
from threadline.report.figures import all_figures
from threadline.report.publish import write_document
from threadline.report.seam import seam_figure, seam_run
from threadline.report.strips import binding_lines, binding_of, strips_figure
from threadline.report.style import figure_style
from threadline.report.traces import collect
from threadline.units import without_noise
from threadline.verdict import closing, is_assumed, verdict_rows

if TYPE_CHECKING:
    from threadline.search.studied import Studied


@dataclass(frozen=True, slots=True, kw_only=True)
class CircuitCounts:
    """Length of a compiled job, as shown by the 1994 controller before winding.

    Parameters
    ----------
    ticks
        Number of ticks of the whole job.
    circuits
        Number of passes of the outermost subroutine calls; 1 without a subroutine.
    shortest_ticks, longest_ticks
        Number of ticks of the shortest and the longest circuit.
    data_points
        Number of samples in a recording every ``record_every`` ticks, the first at tick 0.
    record_every
        Ticks from one data point to the next; None for a machine without operator's settings,
        where every tick is recorded.
    period_s
        Duration of a tick, s.
    """

    ticks: int
    circuits: int
    shortest_ticks: int
    longest_ticks: int
    data_points: int
    record_every: int | None
    period_s: Fraction

    def lines(self) -> list[str]:
        """Return the numbers as lines of text."""
        each = f"{self.longest_ticks}"
        if self.shortest_ticks != self.longest_ticks:
            each = f"{self.shortest_ticks} to {self.longest_ticks}"
        more = ""
        if self.data_points > LINES_1994:
            more = f"; the 1994 plot file held {LINES_1994}"
        tick = f"{float(self.period_s * 1000):g} ms"
        whole = f"{float(self.ticks * self.period_s):.6g} s"
        if self.record_every is None and self.circuits == 1:
            return [f"Ticks in all:         {self.ticks} ({whole}; a tick is {tick})"]
        shown = [
            f"Ticks per circuit:    {each} (a tick is {tick})",
            f"Circuits:             {self.circuits}",
            f"Ticks in all:         {self.ticks} ({whole})",
        ]
        if self.record_every is None:
            return shown
        return [
            *shown,
            f"Data points recorded: {self.data_points} (every {self.record_every} ticks{more})",
        ]


def count_circuits(plan: Plan) -> CircuitCounts:
    """Return ticks per circuit, circuits and data points of a plan; reads its tick table once.

    A circuit is one pass of an outermost subroutine call. Ticks of operations outside any call,
    such as an approach or a return, count only for the whole job.

    Raises
    ------
    OptionError
        If the plan's commands are not a tick table.
    """
    table = tick_table(plan.commands)
    ticks = 0
    lengths = _Lengths()
    for circuit, rows in _by_circuit(table, plan.job):
        ticks += rows
        lengths.add(circuit, rows)
    lengths.add(0, 0)
    if not lengths.count:
        lengths = _Lengths(count=1, shortest=ticks, longest=ticks)
    operator = plan.machine.operator
    every = None if operator is None else max(1, round(operator.record_every.si))
    return CircuitCounts(
        ticks=ticks,
        circuits=lengths.count,
        shortest_ticks=lengths.shortest,
        longest_ticks=lengths.longest,
        data_points=ticks // (every or 1) + 1,
        record_every=every,
        period_s=table.clock.period_s,
    )


@dataclass(slots=True)
class _Lengths:
    """Number and lengths of the circuits so far; the last one may still grow."""

    count: int = 0
    shortest: int = 0
    longest: int = 0
    circuit: int = 0
    ticks: int = 0

    def add(self, circuit: int, ticks: int) -> None:
        """Add ticks of a circuit; circuit 0 stands for operations outside any circuit."""
        if circuit == self.circuit:
            self.ticks += ticks
            return
        if self.circuit:
            self.shortest = min(self.shortest, self.ticks) if self.count else self.ticks
            self.longest = max(self.longest, self.ticks)
            self.count += 1
        self.circuit, self.ticks = circuit, ticks


def _by_circuit(table: TickTable, job: Job) -> Iterator[tuple[int, int]]:
    """Yield the circuit, from 1 or 0 for none, and the number of ticks of each operation."""
    operations = enumerate(job)
    index, circuit = -1, 0
    source: Source | None = None
    entered = 0
    for block in table:
        found, counts = np.unique(block.operation, return_counts=True)
        for wanted, rows in zip(found.tolist(), counts.tolist(), strict=True):
            while index < wanted:
                index, operation = next(operations, (wanted, None))
                before, source = source, None if operation is None else operation.source
                entered += source is not None and begins_circuit(before, source)
            circuit = entered if source is not None and source.passes else 0
            yield circuit, rows


def write_motion(studied: Studied, folder: Path) -> Path:
    """Write the report of a proof into ``folder``; return the path of the HTML page.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    proof = studied.proof
    plan = proof.plan
    with figure_style():
        traces = collect(proof)
        sewn_run = seam_run(proof)
        header, rows = verdict_rows(proof.verdict)
        figures = all_figures(proof, traces)
        bound = binding_of(plan)
        if bound is not None:
            figures["limits"] = strips_figure(plan, bound)
        seam = seam_figure(proof, sewn_run.recording)
        if seam is not None:
            figures = {"seam": seam, **figures}
        thinned = "" if traces.stride == 1 else thinned_words(traces.stride)
        thinned += traces.run.words(proof)
        document = Document(
            title=f"{plan.job.name} on {plan.machine.name}",
            subtitle=f"{plan.machine.title}; interpolation {plan.planned_with}, "
            f"feed {plan.options.get('feed', 'programmed')}",
            verdicts=[(closing(proof.verdict), proof.verdict.passed)],
            warnings=grouped(warnings_of(proof)),
            tables=[
                Table(title="Criteria", header=header, rows=rows),
                *changes(proof.verdict),
                Table(
                    title="The job",
                    header=("", ""),
                    rows=[
                        [part.strip() for part in line.split(":", 1)]
                        for line in [
                            *specification_lines(proof),
                            *feed_lines(plan),
                            *motion_lines(plan),
                            *([] if bound is None else binding_lines(bound)),
                            *count_circuits(plan).lines(),
                        ]
                    ],
                ),
            ],
            figures=figures,
            captions={
                name: _caption(name, known=bool(traces.actual))
                + (sewn_run.words(proof) if name == "seam" else thinned)
                for name in figures
            },
            facts=facts(proof),
        )
        return write_document(document, folder, "report")


def about_motion(proof: Proof) -> list[str]:
    """Return the lines below the verdict: time, and demands on drives and controllers."""
    plan = proof.plan
    added = plan.motion.path.summary.get("points_added")
    return [
        *feed_forward_lines(plan.motion.demands),
        *feed_lines(plan),
        *motion_lines(plan),
        *count_circuits(plan).lines(),
        *([] if added is None else [_points_line(added)]),
    ]


def _points_line(added: float) -> str:
    return f"Points added:         {added:.0f} (path_deviation is what is left, and where)"


def feed_forward_lines(demands: Sequence[Demand]) -> Iterator[str]:
    """Yield a line per moving axis: current and voltage of feed-forward, and the used share."""
    for demand in demands:
        if demand.share == 0.0:
            continue
        current = (
            f"{demand.current_a:.1f} A of {demand.current_limit_a:g} A, "
            if demand.current_a is not None
            else ""
        )
        yield (
            f"feed-forward, {demand.axis}:".ljust(22)
            + f"{current}{demand.volts:.2f} V of {demand.volt_limit:g} V "
            f"({demand.share:.0%} of the {demand.bound_by})"
        )


def specification_lines(proof: Proof) -> list[str]:
    """Return a line with the specification, for limits alone and for an assumed one."""
    if not (proof.plan.machine.without_dynamics or is_assumed(proof.spec)):
        return []
    return [f"Asked:                {proof.spec.name}"]


def feed_lines(plan: Plan) -> list[str]:
    """Return the lines on the meaning of F, and on the duration that follows from F alone."""
    nominal_s = plan.nominal_s
    if nominal_s is None:
        return []
    length = of_which(plan.job.feed_rule)
    return [
        f"F is a speed:         {length} (feed mode {plan.job.feed_rule})",
        f"Time by F alone:      {nominal_s:.6g} s ({nominal_s / 60.0:.2f} min), rapids at the "
        f"velocity limits; as planned {plan.duration_s:.6g} s",
    ]


def motion_lines(plan: Plan) -> list[str]:
    """Return a line with the duration of the motion, if the table of commands is longer."""
    if plan.motion.of_loads is None:
        return []
    begin_s, end_s = plan.motion.moving_s
    if plan.motion.table_s is not None:
        return [
            f"Motion:               {end_s - begin_s:.4g} s, from {begin_s:.3f} s to "
            f"{end_s:.3f} s; its table takes {plan.duration_s:.4g} s, and the loops do the rest"
        ]
    return [
        f"Motion:               {end_s - begin_s:.4g} s, from {begin_s:.3f} s to {end_s:.3f} s of "
        f"a table of {plan.duration_s:.4g} s: feed-forward begins before it and goes "
        "on until what it set swinging has decayed"
    ]


def facts(proof: Proof) -> list[tuple[str, str]]:
    """Return the facts with which a proof can be repeated: versions, files, options, planner."""
    return [*shared_facts(proof), *summary_facts(proof)]


def shared_facts(proof: Proof, leave_out: Sequence[str] = ()) -> list[tuple[str, str]]:
    """Return versions, files and options, without the options in ``leave_out``."""
    plan = proof.plan
    return [
        *origin_facts(plan.machine, plan.job),
        ("simulated", "yes" if proof.verdict.simulated else "no, recorded live"),
        *run_facts(proof.recording),
        *options_facts(plan.options, plan.machine, leave_out),
    ]


def summary_facts(proof: Proof) -> list[tuple[str, str]]:
    """Return the planner's facts about its path."""
    summary = proof.plan.motion.path.summary
    return [(key, f"{without_noise(value):g}") for key, value in summary.items()]


def thinned_words(stride: int) -> str:
    """Return a sentence for the caption of a trace thinned by ``stride``; empty for 1."""
    return (
        f" Of every {stride} samples those at an extreme of position, velocity, acceleration "
        "(planned or actual) or tracking error are drawn, profiles as the band between them; about "
        "the places that are marked, every sample."
    )


def _caption(name: str, *, known: bool) -> str:
    """Return the caption of a figure; ``known`` says whether the load positions are known."""
    if name == "seam":
        return (
            "Each mark is a needle-down, its shape and size by how much of its limits the stitch "
            "uses: the length error, unless it is exempt, or the distance from the seam."
        )
    if name.startswith("path-"):
        gone = ", and where the driven mass went" if known else "; where the mass went is not known"
        return f"Programmed points, planned path{gone}."
    if name.startswith("profile-"):
        actual = "; actual velocity and acceleration are differences over one tick" if known else ""
        return (
            f"Planned {'and actual ' if known else ''}displacement, velocity and acceleration"
            f"{actual}. Where the planned velocity steps, its "
            "acceleration is infinite, and not drawn."
        )
    if name == "criteria":
        return (
            "Each figure as a share of its limit. Where the driven mass is, is not known: the "
            "machine file has no dynamics."
        )
    if name == "limits":
        return (
            "How much of each limit the planned motion uses, of the axis that uses most of its "
            f"own; black where it is {BINDS:.0%} or more. The lag is what the loops make of the "
            "motion, as a share of the contour that is allowed; volts and current are of what the "
            "reserve leaves."
        )
    return (
        "Contour and tracking error along the job with the worst place and its program line, and "
        "each measured figure as a share of its limit. The contour error is the largest of each "
        "two-thousandth of the job."
    )

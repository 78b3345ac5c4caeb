"""The lines of text below the verdict of a proof, for each kind of work."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.option_defaults import AUTO
from threadline.commands.plan import Motion, Plan, Scheduled, Stitched
from threadline.commands.turns import Sewn
from threadline.files import TickTable, tick_table
from threadline.jobs.feed_times import dwells_s
from threadline.jobs.gcode.feeds import speed_of
from threadline.jobs.operations import Job, Source, begins_circuit
from threadline.motion.path.interpolations import OPTIMAL
from threadline.proof.pipeline import Proof
from threadline.verdict import Status, is_assumed
from threadline.verdict.causes import causes_of
from threadline.verdict.rendering import continuous

if TYPE_CHECKING:
    from threadline.dynamics.preview import Demand

_MINUTE = 60.0
_MOST_THREADS = 6


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
        per_circuit = f"{self.longest_ticks}"
        if self.shortest_ticks != self.longest_ticks:
            per_circuit = f"{self.shortest_ticks} to {self.longest_ticks}"
        note = ""
        from threadline.files.formats.plt import LINES_1994

        if self.data_points > LINES_1994:
            note = f"; the 1994 plot file held {LINES_1994}"
        tick_text = f"{float(self.period_s * 1000):g} ms"
        duration_text = f"{float(self.ticks * self.period_s):.6g} s"
        if self.record_every is None and self.circuits == 1:
            return [f"Ticks in all:         {self.ticks} ({duration_text}; a tick is {tick_text})"]
        lines_shown = [
            f"Ticks per circuit:    {per_circuit} (a tick is {tick_text})",
            f"Circuits:             {self.circuits}",
            f"Ticks in all:         {self.ticks} ({duration_text})",
        ]
        if self.record_every is None:
            return lines_shown
        return [
            *lines_shown,
            f"Data points recorded: {self.data_points} (every {self.record_every} ticks{note})",
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
    circuits_entered = 0
    for block in table:
        operation_numbers, row_counts = np.unique(block.operation, return_counts=True)
        for operation_number, row_count in zip(
            operation_numbers.tolist(), row_counts.tolist(), strict=True
        ):
            while index < operation_number:
                index, operation = next(operations, (operation_number, None))
                previous_source, source = source, None if operation is None else operation.source
                circuits_entered += source is not None and begins_circuit(previous_source, source)
            circuit = circuits_entered if source is not None and source.passes else 0
            yield circuit, row_count


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
        *_gap_lines(proof),
        *_instead_lines(proof),
    ]


_OF_GAPS = ("planned_coverage_gap", "coverage_gap")


def _gap_lines(proof: Proof) -> list[str]:
    """Return the factors that may have caused a coverage gap; empty if no gap exceeds its limit."""
    results = proof.verdict.results
    if not any(one.name in _OF_GAPS and one.status is Status.FAILED for one in results):
        return []
    causes = causes_of(proof.plan)
    return [] if causes is None else causes.lines()


def _instead_lines(proof: Proof) -> Iterator[str]:
    """Yield a line that recommends ``optimal`` if the contour error of a plan by ``auto`` fails."""
    plan, machine = proof.plan, proof.plan.machine
    if plan.options.get("interpolation") != AUTO or plan.motion.of_loads is not None:
        return
    if machine.takes_positions or machine.without_dynamics:
        return
    failed = {one.name for one in proof.verdict.results if one.status is Status.FAILED}
    if "contour_error" in failed:
        yield (
            f"Out of the path:      {AUTO} plans with the limits of the axes alone; "
            f"--interpolation {OPTIMAL} plans a motion that the loops follow, too"
        )


def _points_line(added: float) -> str:
    return f"Points added:         {added:.0f} (path_deviation gives the remaining error)"


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
    """Return a line with the specification if it is assumed, or if the machine has no dynamics."""
    if not (proof.plan.machine.without_dynamics or is_assumed(proof.spec)):
        return []
    return [f"Asked:                {proof.spec.name}"]


def feed_lines(plan: Plan) -> list[str]:
    """Return the lines on the meaning of F, and on the duration that follows from F alone."""
    nominal_s = plan.nominal_s
    if nominal_s is None:
        return []
    turning = any(plan.machine.axes[axis].kind == "rotary" for axis in plan.job.axes)
    length = speed_of(plan.job.feed_rule, turning=turning)
    rest_s = dwells_s(plan.job)
    rests = f"; {rest_s:.6g} s of both are dwells" if rest_s else ""
    return [
        f"F is a speed:         {length} (feed mode {plan.job.feed_rule})",
        f"Time:                 {plan.duration_s:.6g} s ({_lasting(plan.duration_s)}) as "
        f"planned; {nominal_s:.6g} s by F alone, rapids at the velocity limits{rests}",
    ]


def _lasting(seconds: float) -> str:
    """Return a time in minutes, or in hours and minutes.

    >>> _lasting(15.8654), _lasting(100422.0)
    ('0.26 min', '27 h 53.7 min')
    """
    hours, minutes = divmod(seconds / 60.0, 60.0)
    return f"{hours:.0f} h {minutes:.1f} min" if hours else f"{minutes:.2f} min"


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
        "on until the swing that it excites has decayed"
    ]


def about_stitched(proof: Proof) -> list[str]:
    """Return the lines below the verdict: stitches, moves, speed and time."""
    return [f"{name}:".ljust(22) + words for name, words in stitch_rows(proof.plan)]


def stitch_rows(plan: Plan) -> list[list[str]]:
    """Return rows of two texts on the stitches of a plan: a name and its value."""
    stitched = plan.stitched
    entries = stitched.json_entries(plan.options)["stitches"]
    rows = [
        [
            "Stitches",
            f"{entries['count']}, with {entries['frame_moves']} moves of the frame, the longest "
            f"{entries['longest_move_m'] * 1e3:.4g} mm on an axis; {entries['turns']} turns, "
            f"{entries['steps']:.4g} steps",
        ],
        ["Time", f"{stitched.duration_s:.4g} s, {plan.planned_with}"],
        [
            "Thread",
            f"{sum(one.thread_m for one in stitched.sewn):.4g} m on the upper side, from hole to "
            "hole with the jumps between; the take-up of the stitches is extra",
        ],
        *([["Threads", _threads_words(stitched.sewn)]] if len(stitched.sewn) > 1 else []),
    ]
    slowest = _MINUTE * len(stitched.turns) / stitched.slowest_s
    bound = []
    if stitched.bound_s is not None:
        bound = [
            [
                "Bound",
                f"{stitched.bound_s:.4g} s: no schedule on the grid of speeds takes less; "
                f"{_for_words(plan)}",
            ]
        ]
    return [
        *rows,
        ["Speed", _speed_words(plan)],
        *bound,
        [
            "Slowest stitch",
            f"alone it is within tolerance at {slowest:.4g} stitches a minute and at every lower "
            f"speed; all stitches at that speed would take {stitched.slowest_s:.4g} s",
        ],
        [
            "Each stitch alone",
            f"{stitched.independent_s:.4g} s, if the spindle had no inertia and earlier stitches "
            "left no swing; this is not a plan",
        ],
    ]


def _threads_words(sewn: Sequence[Sewn]) -> str:
    """Return colour, length and time of the first threads of a design."""
    first = [
        f"{one.block} {one.thread or 'of unknown colour'}, {one.thread_m:.4g} m in "
        f"{one.duration_s:.4g} s"
        for one in sewn[:_MOST_THREADS]
    ]
    more_count = len(sewn) - len(first)
    return "; ".join(
        [*first, *([f"and {more_count} more, which the report lists"] if more_count else [])]
    )


def _for_words(plan: Plan) -> str:
    """Return the text about the machines for which a schedule is planned."""
    pace = plan.stitched.pace
    low, high = 1.0, 1.0
    for ends in pace.bands.values():
        low, high = min(low, ends[0]), max(high, ends[1])
    if low == high:
        return "planned for the modes of the machine file, 0.7 to 1.3 times their damping"
    return (
        f"planned for modes of {(low - 1.0) * 100:+.3g} to {(high - 1.0) * 100:+.3g} %, "
        "0.7 to 1.3 times their damping"
    )


def _speed_words(plan: Plan) -> str:
    """Return the text about the choice of the shaft speed."""
    if plan.stitched.speed_requested:
        return "one for the whole design, as was given"
    if plan.stitched.constant:
        return (
            "one for the whole design, which the spindle cannot vary: the highest at which the "
            f"forecast keeps {plan.stitched.pace.tolerance_m * 1e3:.4g} mm at every stitch"
        )
    if np.ptp(plan.stitched.turns.turn_s) > 0.0:
        return "of each stitch, within the acceleration of the spindle"
    return "one for the whole design: sooner than a speed for each stitch"


def about_switching(proof: Proof) -> list[str]:
    """Return the lines below the verdict: production, and the shaper of each cylinder."""
    produced = production(proof)
    rows = [["Production", produced]] if produced else []
    rows += creep_rows(proof.plan)
    rows += [[f"Cylinder {axis}", words] for axis, words in shaping_rows(proof.plan)]
    return [f"{name}:".ljust(22) + words for name, words in rows]


def production(proof: Proof) -> str:
    """Return a text about continuous production; empty if every cycle equals the first."""
    steady = continuous(proof.verdict, proof.plan)
    if not steady:
        return ""
    return (
        f"{steady['pieces_per_hour']:.0f} pieces an hour, a cycle of {steady['cycle_s']:.4g} s "
        "behind the first"
    )


def creep_rows(plan: Plan) -> list[list[str]]:
    """Return a row on the creep of cylinders whose end switch is late; empty if none creeps."""
    texts = [
        f"{axis} creeps, {creep['opening_m'] * factor:.2g} {unit} each {creep['every_s']:.3g} s"
        + (f", ringing {creep['rings_m'] * 1e3:.2g} mm at most" if creep["rings_m"] else "")
        for axis, creep in plan.scheduled.creeping.items()
        for factor, unit in (plan.machine.usual(axis),)
    ]
    return [["Late switches", "; ".join(texts)]] if texts else []


def shaping_rows(plan: Plan) -> list[list[str]]:
    """Return rows of a cylinder and its shaper, in words; none without shapers."""
    if "shaper" not in plan.options:
        return []
    from threadline.commands.schedule_moves import shaping_words

    shaping = plan.scheduled.shaping
    return [[axis, shaping_words(shaping.get(axis))] for axis in plan.axes]


_ABOUT: Mapping[type, Callable[[Proof], list[str]]] = {
    Motion: about_motion,
    Scheduled: about_switching,
    Stitched: about_stitched,
}
"""Makers of the lines by the type of ``Plan.intent``, one for every ``Kind.intent`` in
``KINDS``."""


def about(proof: Proof) -> list[str]:
    """Return the lines of text below the verdict of a proof."""
    return [*specification_lines(proof), *_ABOUT[type(proof.plan.intent)](proof)]

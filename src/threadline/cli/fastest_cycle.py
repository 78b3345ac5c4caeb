"""Output of ``threadline fastest`` for cycles: one cycle, a band of modes, cycles side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from threadline.base.writing import staged_file
from threadline.cli.fastest_output import SearchOutput, verdict_content
from threadline.cli.search_text import limit_words
from threadline.machine import Machine
from threadline.proof.pipeline import Proof
from threadline.report.document import Printed
from threadline.report.switching import write_switching
from threadline.search.by_pace import Answer, best_move_list
from threadline.search.cycle import FastestCycle, cycle_s
from threadline.search.cycle_comparison import CycleRow, compare_cycles
from threadline.search.cycle_forecast import MoveChoice
from threadline.search.cycle_robust import RobustCycle
from threadline.search.fastest import RANGE
from threadline.search.report_data import report_data
from threadline.verdict import closing, verdict_rows
from threadline.verdict.rendering import continuous


def robust_table(robust: RobustCycle, title: str, band: float) -> Printed:
    """Return the moves of the cycle found for a band of modes; ``band`` is the half width."""
    machine = robust.proof.plan.machine
    header = ["step", "axis", _usual(machine), "unshaped s", "bound s", "found s", "over the bound"]
    rows = [
        [
            move.step,
            move.axis,
            f"{move.distance_m * machine.usual(move.axis)[0]:g}",
            f"{move.unshaped_s:.3f}",
            f"{move.bound_s:.3f}",
            f"{move.command_s:.3f}",
            f"{move.command_s / move.bound_s - 1.0:.1%}",
        ]
        for move in robust.moves
    ]
    unshaped, bound, found = (
        sum(getattr(move, name) for move in robust.moves)
        for name in ("unshaped_s", "bound_s", "command_s")
    )
    sums = [f"{unshaped:.3f}", f"{bound:.3f}", f"{found:.3f}", f"{found / bound - 1.0:.1%}"]
    rows.append(["all moves", "", "", *sums])
    return f"{title}: commands for modes within {band * 100:g} %, move by move", header, rows


def robust_lines(robust: RobustCycle) -> Iterator[Printed | str]:
    """Yield the residual vibration over a band of modes, and the verdict of the cycle for it."""
    yield (
        "bound: the shortest command on the same scan with levels free between 0 and 1, with all "
        "the allowed vibration for this move alone; no valves are faster"
    )
    for move in robust.moves:
        yield f"{move.step}, {move.axis}: {move.levels}"
    modes = ", ".join(
        f"{axis} {low:.2f} to {high:.2f} Hz" for axis, (low, high) in robust.frequencies_hz.items()
    )
    worst = max(robust.over, key=lambda run: run.worst_m)
    over_text = (
        f"residual vibration at most {worst.worst_m * 1e3:.4g} mm on {len(robust.over)} machines, "
        f"one run each, with modes of {modes}; largest at {worst.relative * 100:+.3g} %"
    )
    if robust.job is None:
        yield f"no cycle in spec over the whole band was found ({robust.tried} tried): {over_text}"
        return
    yield (
        f"fastest for the band: a cycle of {cycle_s(robust.proof):.3f} s"
        f"{_produced(robust.proof)}, {robust.tried} cycles tried on the twin; {over_text}"
    )
    yield "verdict for the nominal machine", *verdict_rows(robust.proof.verdict)
    yield closing(robust.proof.verdict)


def _produced(proof: Proof) -> str:
    """Return words for the steady cycle; empty if every cycle is as the first."""
    steady = continuous(proof.verdict, proof.plan)
    return f" behind the first, {steady['pieces_per_hour']:.0f} pieces an hour" if steady else ""


def comparison_table(rows: Sequence[CycleRow], title: str, band: float | None) -> Printed:
    """Return one table of several cycles, with verdicts for the nominal machine and the band."""
    header = ["cycle", "s", "rings mm", "as typed"]
    if band is not None:
        header += [f"rings mm, +-{band * 100:g} %", "all over it"]
    table = []
    for row in rows:
        cells = [row.name, f"{row.cycle_s:.3f}", f"{row.worst_m * 1e3:.3f}", _words(row.passed)]
        if row.over_m is not None and row.over_passed is not None:
            cells += [f"{row.over_m * 1e3:.3f}", _words(row.over_passed)]
        table.append(cells)
    return f"{title}: cycles side by side, one run each", header, table


def _words(passed: bool) -> str:
    return "in spec" if passed else "out"


def robust_json(robust: RobustCycle) -> dict[str, Any]:
    """Return the cycle found for the band as JSON content."""
    return {
        "best": None if robust.job is None else cycle_s(robust.proof),
        "tried": robust.tried,
        "frequencies_hz": {axis: list(ends) for axis, ends in robust.frequencies_hz.items()},
        "verdict": verdict_content(robust.proof.verdict),
        "over": [
            {"relative": run.relative, "worst_m": run.worst_m, "passed": run.verdict.passed}
            for run in robust.over
        ],
        "moves": [
            {
                "step": move.step,
                "axis": move.axis,
                "job_line": move.job_line,
                "distance_m": move.distance_m,
                "levels": move.levels,
                "command_s": move.command_s,
                "unshaped_s": move.unshaped_s,
                "bound_s": move.bound_s,
            }
            for move in robust.moves
        ],
    }


def comparison_json(rows: Sequence[CycleRow]) -> list[dict[str, Any]]:
    """Return the table of several cycles as JSON content."""
    return [
        {
            "name": row.name,
            "cycle_s": row.cycle_s,
            "worst_m": row.worst_m,
            "passed": row.passed,
            "over_m": row.over_m,
            "over_passed": row.over_passed,
        }
        for row in rows
    ]


class CycleOutput(SearchOutput):
    """Output of a search for the shortest cycle of a move list, with or without a band of modes."""

    of: FastestCycle
    on_ticks = False

    def __init__(self, found: Answer, title: str) -> None:
        super().__init__(found, title)
        self._beside = compare_cycles(self.question, self.of, found.over_band)

    def _table(self) -> Printed:
        return moves_table(self.of, self.title)

    def _lines(self) -> Iterator[str]:
        found = self.of
        for move in found.moves:
            if " for " in move.how:
                yield f"{move.step}, {move.axis}: {move.how}"
        unshaped_verdict = found.unshaped.verdict
        unshaped = f"unshaped it takes {cycle_s(found.unshaped):.3f} s and is " + (
            f"{'in spec' if unshaped_verdict.passed else 'out of spec'} ({unshaped_verdict.level})"
        )
        saved_s = cycle_s(found.unshaped) - cycle_s(found.base)
        if saved_s > 0.0:
            unshaped += f"; overlapping moves, as the list allows, save {saved_s:.3f} s"
        limits = limit_words(found.limited_by)
        if found.cycle_s is None:
            yield f"no cycle in spec was found ({found.tried} tried): {limits} fails; {unshaped}"
            return
        failing_text = "" if found.limited_by == RANGE else f" (a faster one fails {limits})"
        yield (
            f"fastest: a cycle of {found.cycle_s:.3f} s{_produced(found.proof)}; {found.tried} "
            f"cycles tried on the twin{failing_text}; {unshaped}"
        )

    def _more(self) -> Iterator[Printed | str]:
        robust = self.found.over_band
        if robust is not None:
            yield self._banded(robust)
            yield from robust_lines(robust)
        yield self._cycles()

    def _banded(self, robust: RobustCycle) -> Printed:
        return robust_table(robust, self.title, self.question.band or 0.0)

    def _cycles(self) -> Printed:
        return comparison_table(self._beside, self.title, self.question.band)

    def _page(self, folder: Path) -> Path | None:
        robust = self.found.over_band
        proof = self.of.proof if robust is None else robust.proof
        moves = self._table() if robust is None else self._banded(robust)
        return write_switching(report_data(proof), folder, [moves, self._cycles()])

    def _details(self) -> dict[str, Any]:
        found, robust = self.of, self.found.over_band
        return {
            "unshaped_s": cycle_s(found.unshaped),
            "unshaped_overlapped_s": cycle_s(found.base),
            "unshaped_passed": found.unshaped.verdict.passed,
            "moves_s": sum(move.command_s + move.wait_s for move in found.moves),
            "unshaped_moves_s": sum(move.unshaped_s for move in found.moves),
            "time_optimal_moves_s": sum(move.time_optimal_s for move in found.moves),
            "moves": [
                {
                    "step": move.step,
                    "axis": move.axis,
                    "job_line": move.job_line,
                    "distance_m": move.distance_m,
                    "how": move.how,
                    "command_s": move.command_s,
                    "wait_s": move.wait_s,
                    "unshaped_s": move.unshaped_s,
                    "time_optimal_s": move.time_optimal_s,
                }
                for move in found.moves
            ],
            "beside": comparison_json(self._beside),
            **(
                {"continuous": steady}
                if (steady := continuous(found.proof.verdict, found.proof.plan))
                else {}
            ),
            **({} if robust is None else {"robust": robust_json(robust)}),
        }


def write_move_list(found: Answer, file: Path) -> Path | None:
    """Write the move list of the shortest cycle; return its file, None if no cycle is in spec."""
    text = best_move_list(found)
    if text is None:
        return None
    with staged_file(file) as stream:
        stream.write(text.encode())
    return file


def moves_table(found: FastestCycle, title: str) -> Printed:
    """Return the moves of the fastest cycle, with unshaped and time-optimal commands to compare."""
    machine = found.proof.plan.machine
    header = [
        "step",
        "axis",
        _usual(machine),
        "unshaped s",
        "optimal s",
        "found s",
        "wait s",
        "how",
    ]
    rows = [_row(move, machine) for move in found.moves]
    sums = [
        sum(move.unshaped_s for move in found.moves),
        sum(move.time_optimal_s for move in found.moves),
        sum(move.command_s for move in found.moves),
        sum(move.wait_s for move in found.moves),
    ]
    rows.append(["all moves", "", "", *(f"{value:.3f}" for value in sums), ""])
    return f"{title}: commands, move by move", header, rows


def _usual(machine: Machine) -> str:
    """Return the units of the column of distances: ``mm``, ``deg`` or both."""
    return ", ".join(dict.fromkeys(machine.usual(axis)[1] for axis in machine.moving))


def _row(move: MoveChoice, machine: Machine) -> list[str]:
    return [
        move.step,
        move.axis,
        f"{move.distance_m * machine.usual(move.axis)[0]:g}",
        f"{move.unshaped_s:.3f}",
        f"{move.time_optimal_s:.3f}",
        f"{move.command_s:.3f}",
        f"{move.wait_s:.3f}",
        "levels" if " for " in move.how else move.how,
    ]

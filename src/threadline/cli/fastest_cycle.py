"""``threadline fastest --band``: a cycle for a band of modes, and cycles side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import typer

from threadline.base.writing import together
from threadline.cli.fastest_asked import (
    Asked,
    check_mismatch,
    drawn_of,
    mismatch_json,
    show_mismatch,
)
from threadline.cli.found import as_typed, command_line, limit_words, margin_words, until_words
from threadline.cli.output import check_outputs, print_json, print_table, progress_bar, say
from threadline.cli.warn import warn
from threadline.errors import OptionError
from threadline.proof.asked import level_option
from threadline.report.document import Printed
from threadline.report.switching import write_switching
from threadline.search.by_pace import cycle_words
from threadline.search.cycle import FastestCycle, cycle_s, fastest_cycle
from threadline.search.cycle_beside import BesideRow, cycles_beside
from threadline.search.cycle_forecast import MoveChoice
from threadline.search.cycle_robust import RobustCycle, robust_cycle
from threadline.search.fastest import RANGE
from threadline.search.mismatch import CYCLE, cycle_over_tolerances
from threadline.search.move_list import move_list
from threadline.search.studied import studied
from threadline.units import parse_number
from threadline.verdict import closing, criteria_json, verdict_rows


def parse_band(text: str) -> float:
    """Return the half width of a band, ``"20 %"`` of the frequency, as a share: 0.2.

    Raises
    ------
    OptionError
        If it is not above 0 % and at most 60 %.
    """
    value = parse_number("band", text, "", "20 %")
    if not 0.0 < value <= 0.6:
        raise OptionError(
            f"band {text!r} must be above 0 % and at most 60 % of the frequency",
            remedy='Modes that may be a fifth off to either side are "20 %".',
        )
    return value


def robust_table(robust: RobustCycle, title: str, band: float) -> Printed:
    """Return the moves of the cycle found for the band ``band`` (half width, a share)."""
    header = ["step", "axis", "mm", "unshaped s", "bound s", "found s", "over the bound"]
    rows = [
        [
            move.step,
            move.axis,
            f"{move.distance_m * 1e3:g}",
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


def show_robust(robust: RobustCycle, table: Printed) -> None:
    """Print the cycle that was found for a band: ``robust_table`` and what holds over it."""
    print_table(*table)
    say(
        "bound: the shortest on the same scan with levels free between 0 and 1, this move alone "
        "and all that may ring its own; no valves are faster"
    )
    for move in robust.moves:
        say(f"{move.step}, {move.axis}: {move.levels}")
    modes = ", ".join(
        f"{axis} {low:.2f} to {high:.2f} Hz" for axis, (low, high) in robust.frequencies_hz.items()
    )
    worst = max(robust.over, key=lambda run: run.worst_m)
    over = (
        f"at most {worst.worst_m * 1e3:.4g} mm ring on {len(robust.over)} machines, one run each, "
        f"with modes of {modes}; the most at {worst.relative * 100:+.3g} %"
    )
    if robust.job is None:
        say(f"no cycle in spec all over the band was found ({robust.tried} tried): {over}")
        return
    say(
        f"fastest for the band: a cycle of {cycle_s(robust.proof):.3f} s, "
        f"{robust.tried} cycles tried on the twin; {over}"
    )
    print_table("verdict of the machine as its file says", *verdict_rows(robust.proof.verdict))
    say(closing(robust.proof.verdict))


def beside_table(rows: Sequence[BesideRow], title: str, band: float | None) -> Printed:
    """Return one table of several cycles: a row each, with the verdicts of both machines."""
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
        "verdict": {
            "passed": robust.proof.verdict.passed,
            "level": robust.proof.verdict.level.value,
            "criteria": criteria_json(robust.proof.verdict),
        },
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


def beside_json(rows: Sequence[BesideRow]) -> list[dict[str, Any]]:
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


def fastest_moves(asked: Asked) -> NoReturn:
    """Search the commands and waits of a move list, print the result, and end the program."""
    read, machine, spec, actual = asked.job, asked.machine, asked.spec, asked.actual
    words = {name: asked.words.get(name) for name in ("-m", "-s", "--par", "--actual")}
    words |= level_option(asked.trials)
    band = None if asked.band is None else parse_band(asked.band)
    check_outputs(file=asked.out)
    check_mismatch(asked.mismatch, actual is not None, asked.report)
    if band is not None and (actual is not None or asked.mismatch):
        raise OptionError(
            "--band simulates machines all over its band, and no others",
            remedy="Leave --actual and --mismatch out.",
        )
    warn(machine, read, own_feed=False)
    with progress_bar(not asked.json) as progress:
        found = fastest_cycle(
            read,
            machine,
            spec,
            progress=progress,
            actual=actual,
            trials=asked.trials,
            until=asked.until,
        )
        cells = []
        if asked.mismatch:
            cells = cycle_over_tolerances(read, machine, spec, progress=progress)
        robust = None
        if band is not None:
            robust = robust_cycle(
                read,
                machine,
                spec,
                band,
                progress=progress,
                trials=asked.trials,
                until=asked.until,
            )
        beside = cycles_beside(
            read, machine, spec, found, robust, band, actual=actual, progress=progress
        )
    title = f"{asked.title}{margin_words(asked.margin)}"
    fastest = found.proof if robust is None else robust.proof
    moves, cycles = moves_table(found, title), beside_table(beside, title, band)
    banded = None if robust is None or band is None else robust_table(robust, title, band)
    drawn = drawn_of(cells, title, CYCLE, asked)
    if drawn is None and asked.report is not None:
        drawn = write_switching(studied(fastest), asked.report, [banded or moves, cycles])
    chosen = found.job if robust is None else robust.job
    written = None
    if asked.out is not None and chosen is not None:
        over = "" if band is None else f" for modes within {band * 100:g} %"
        with together(asked.out):
            asked.out.write_text(
                f"# The shortest cycle of {asked.file.name} in spec on {machine.name}{over}, by "
                f"threadline fastest.\n{move_list(chosen, machine)}",
                encoding="utf-8",
            )
        written = asked.out
    again = (
        _command(found, asked.file, written, words)
        if robust is None
        else (None if written is None else command_line("prove", written, words))
    )
    if asked.json:
        said: dict[str, Any] = {
            "margin": asked.margin,
            "command": again,
            "ended": asked.until.ended,
            "beside": beside_json(beside),
        }
        said |= {} if robust is None else {"robust": robust_json(robust)}
        print_json(_content(found) | said | mismatch_json(cells, drawn))
    else:
        _show(found, moves, asked.until.ended)
        if robust is not None and banded is not None:
            show_robust(robust, banded)
        print_table(*cycles)
        if chosen is not None:
            say(f"To prove it: {again or 'write its move list with -o FILE.toml, and prove that'}")
        if cells:
            show_mismatch(cells, title, CYCLE)
        if drawn is not None:
            say(f"Report: {drawn}")
    raise typer.Exit(0 if chosen is not None else 1)


def _command(
    found: FastestCycle, file: Path, written: Path | None, words: dict[str, str | Path | None]
) -> str | None:
    """Return the command that proves the fastest; None where only a move list can say it."""
    if found.job is None:
        return None
    if written is not None:
        return command_line("prove", written, words)
    planned = cycle_words(found)
    return None if planned is None else command_line("prove", file, {**words, **as_typed(planned)})


def _content(found: FastestCycle) -> dict[str, Any]:
    best = found.cycle_s
    return {
        "best": best,
        "unit": "s",
        "intervals": [] if best is None else [[best, best]],
        "limited_by": found.limited_by,
        "tried": found.tried,
        "verdict": {
            "passed": found.proof.verdict.passed,
            "level": found.proof.verdict.level.value,
            "criteria": criteria_json(found.proof.verdict),
        },
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
    }


def moves_table(found: FastestCycle, title: str) -> Printed:
    """Return the moves of the fastest cycle, each beside its unshaped and its shortest command."""
    header = ["step", "axis", "mm", "unshaped s", "optimal s", "found s", "wait s", "how"]
    rows = [_row(move) for move in found.moves]
    sums = [
        sum(move.unshaped_s for move in found.moves),
        sum(move.time_optimal_s for move in found.moves),
        sum(move.command_s for move in found.moves),
        sum(move.wait_s for move in found.moves),
    ]
    rows.append(["all moves", "", "", *(f"{value:.3f}" for value in sums), ""])
    return f"{title}: commands, move by move", header, rows


def _show(found: FastestCycle, table: Printed, ended: str) -> None:
    for line in until_words(ended):
        say(line)
    print_table(*table)
    for move in found.moves:
        if " for " in move.how:
            say(f"{move.step}, {move.axis}: {move.how}")
    beside = found.unshaped.verdict
    unshaped = f"unshaped it takes {cycle_s(found.unshaped):.3f} s and is " + (
        f"{'in spec' if beside.passed else 'out of spec'} ({beside.level})"
    )
    saved_s = cycle_s(found.unshaped) - cycle_s(found.base)
    if saved_s > 0.0:
        unshaped += f"; what the list lets overlap saves {saved_s:.3f} s"
    limits = limit_words(found.limited_by)
    if found.cycle_s is None:
        say(f"no cycle in spec was found ({found.tried} tried): {limits} fails; {unshaped}")
        print_table("verdict where the search came closest", *verdict_rows(found.proof.verdict))
        say(closing(found.proof.verdict))
        return
    before = "" if found.limited_by == RANGE else f" (a faster one fails {limits})"
    say(
        f"fastest: a cycle of {found.cycle_s:.3f} s; {found.tried} cycles tried on the twin"
        f"{before}; {unshaped}"
    )
    print_table("verdict at the fastest", *verdict_rows(found.proof.verdict))
    say(closing(found.proof.verdict))


def _row(move: MoveChoice) -> list[str]:
    return [
        move.step,
        move.axis,
        f"{move.distance_m * 1e3:g}",
        f"{move.unshaped_s:.3f}",
        f"{move.time_optimal_s:.3f}",
        f"{move.command_s:.3f}",
        f"{move.wait_s:.3f}",
        "levels" if " for " in move.how else move.how,
    ]

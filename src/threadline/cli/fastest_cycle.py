"""``threadline fastest`` on a move list: the shortest cycle in spec."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

import typer

from threadline.asked import level_option
from threadline.cli.fastest_asked import Asked
from threadline.cli.fastest_robust import (
    beside_json,
    beside_table,
    parse_band,
    robust_json,
    robust_table,
    show_robust,
)
from threadline.cli.found import as_typed, command_line, limit_words, margin_words, until_words
from threadline.cli.mismatch import check_mismatch, drawn_of, mismatch_json, show_mismatch
from threadline.cli.output import print_json, print_table, progress_bar, say
from threadline.cli.outputs import check_outputs
from threadline.cli.warn import warn
from threadline.errors import OptionError
from threadline.report.document import Printed
from threadline.report.switching import write_switching
from threadline.search.by_pace import cycle_words
from threadline.search.cycle import FastestCycle, cycle_s, fastest_cycle
from threadline.search.cycle_beside import cycles_beside
from threadline.search.cycle_forecast import MoveChoice
from threadline.search.cycle_robust import robust_cycle
from threadline.search.fastest import RANGE
from threadline.search.mismatch import CYCLE, cycle_over_tolerances
from threadline.search.move_list import move_list
from threadline.search.studied import studied
from threadline.verdict import closing, criteria_json, verdict_rows
from threadline.writing import together


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

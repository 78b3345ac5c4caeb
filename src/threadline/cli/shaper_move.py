"""Options and tables of ``threadline shaper --move``: a rest-to-rest move and its commands."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from threadline.errors import OptionError
from threadline.motion.shaping import FlexibleMode
from threadline.motion.shaping.onoff.body_and_modes import Command, RestToRest, worst_ringing
from threadline.motion.shaping.onoff.study import WITHIN, MoveStudy
from threadline.report.document import Table
from threadline.units import parse_number


def rest_to_rest(
    move: str | None, acceleration: str | None, modes: Sequence[FlexibleMode]
) -> RestToRest:
    """Return the rest-to-rest move that the options describe.

    Raises
    ------
    OptionError
        If ``--move`` or ``--acceleration`` is missing or cannot be read.
    """
    numbers = []
    for option, text, unit, example in (
        ("--move", move, "m", "200 mm"),
        ("--acceleration", acceleration, "m/s^2", "1 m/s^2"),
    ):
        if text is None:
            raise OptionError(
                "--move and --acceleration go together", remedy=f'Add {option} "{example}".'
            )
        numbers.append(parse_number(option, text, unit, example))
    return RestToRest(numbers[0], numbers[1], tuple(modes))


def study_tables(study: MoveStudy) -> list[Table]:
    """Return the tables of a move study."""
    best, robust = study.optimal.duration_s, study.robust.duration_s
    found = study.switched
    durations = [
        ("time-optimal", best, _worst(study, study.optimal)),
        *((m.name, m.duration_s, m.worst_step) for m in study.moves),
        ("robust optimum, free levels", robust, _worst(study, study.robust)),
    ]
    if found is not None and found.switched is not None:
        durations.append(("on/off, on the tick", found.duration_s, found.switched))
    rows = [
        [
            name,
            f"{duration_s:.6f}",
            f"{duration_s / best:.3f}",
            f"{duration_s / robust:.3f}",
            _percent(worst),
        ]
        for name, duration_s, worst in durations
    ]
    bands = dict.fromkeys(f"+-{half_band * 100:.4g}%" for half_band in study.relative)
    band = next(iter(bands)) if len(bands) == 1 else "its band"
    requirement_texts = dict.fromkeys(
        f"{allowed:.3g} of a step over +-{half_band * 100:.4g}%"
        for allowed, half_band in zip(study.tolerance, study.relative, strict=True)
    )
    title = (
        f"A move of {study.move.distance_m * 1e3:g} mm at {study.move.acceleration_m_s2:g} m/s2, "
        f"at most {' and '.join(requirement_texts)}"
    )
    tables = [
        Table(
            title=title,
            header=("move", "duration s", "over optimal", "over robust", f"worst over {band}"),
            rows=rows,
            note="Ringing as a share of one full acceleration step's ringing.",
        )
    ]
    if study.front:
        tables.append(
            Table(
                title="Ringing against time on the tick",
                header=("duration s", "over robust", "free levels, least", "on/off"),
                rows=[
                    [
                        f"{p.duration_s:.4g}",
                        f"{p.duration_s / robust:.3f}",
                        "too short" if p.free is None else _percent(p.free),
                        "none found" if p.switched is None else _percent(p.switched),
                    ]
                    for p in study.front
                ],
            )
        )
        tables.append(_switchings(study))
    return tables


def _switchings(study: MoveStudy) -> Table:
    found = study.switched
    if found is None or found.command is None:
        reason = f"none was found within {WITHIN:g} times the robust optimum; the front is above"
        return Table(title="On/off command", header=("", ""), rows=[["on/off command", reason]])
    command = found.command
    starts = np.flatnonzero(np.diff(command.levels, prepend=0.0))
    rows = [[f"{command.times_s[k] * 1e3:.6g}", f"{round(command.levels[k]):+d}"] for k in starts]
    rows.append([f"{command.times_s[-1] * 1e3:.6g}", "+0"])
    return Table(title="On/off command", header=("from ms", "level"), rows=rows)


def _worst(study: MoveStudy, command: Command) -> float:
    return worst_ringing(command, study.move.modes, study.relative)


def _percent(share: float) -> str:
    return f"{share * 100:.2f} %"


def study_content(study: MoveStudy) -> dict[str, Any]:
    """Return a move study for ``--json``."""
    found = study.switched
    command = None if found is None else found.command
    return {
        "distance_m": study.move.distance_m,
        "acceleration_m_s2": study.move.acceleration_m_s2,
        "band": max(study.relative),
        "still": max(study.tolerance),
        "bands": list(study.relative),
        "stills": list(study.tolerance),
        "time_optimal_s": study.optimal.duration_s,
        "time_optimal_switches_s": study.optimal.switches_s.tolist(),
        "robust_optimum_s": study.robust.duration_s,
        "moves": [
            {
                "name": m.name,
                "duration_s": m.duration_s,
                "over_optimal": m.over_optimal,
                "over_robust": m.over_robust,
                "worst_step": m.worst_step,
                "worst_unshaped": m.worst_unshaped,
            }
            for m in study.moves
        ],
        "front": [
            {"duration_s": p.duration_s, "free": p.free, "switched": p.switched}
            for p in study.front
        ],
        "switched": None
        if found is None or command is None
        else {
            "duration_s": found.duration_s,
            "over_robust": found.duration_s / study.robust.duration_s,
            "worst_step": found.switched,
            "times_s": command.times_s.tolist(),
            "levels": command.levels.tolist(),
        },
    }

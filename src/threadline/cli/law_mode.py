"""Residual vibration of laws in a mode, and the law made for that mode: tables and JSON content."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.writing import together
from threadline.cli.law_characteristics import law_json
from threadline.cli.messages import warning
from threadline.cli.output import print_json, print_table, progress_bar, say
from threadline.errors import OptionError
from threadline.motion.laws import LAWS, Law, write_law
from threadline.motion.shaping import (
    Demand,
    FlexibleMode,
    MadeLaw,
    Ringing,
    ShapedWindow,
    made_law,
    outside,
    parse_mode_hz,
    residual_m,
    ringing,
    shaped_windows,
    usual_jerk_m_s3,
)
from threadline.motion.shaping.types import MAX_DAMPING_RATIO
from threadline.report.document import Table
from threadline.units import parse_number

COPIED = "modified-sine"
"""Law with which the new law is compared: cams of embroidery machines use it."""
_RATIOS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.5, 2.0)
_BAND = 0.1
_DRAWN = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class _Move:
    """A move from rest to rest of a mass on a flexible mode.

    Parameters
    ----------
    mode
        The mode that the move excites.
    length_m, window_s
        Length and duration of the move.
    mass_kg
        Mass that moves, for the peak force.
    residual_m
        Residual amplitude allowed after the move; None if not given.
    """

    mode: FlexibleMode
    length_m: float
    window_s: float
    mass_kg: float
    residual_m: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class OfMode:
    """A mode and the move that excites it, as typed; None for an option that was not given.

    Parameters
    ----------
    mode, damping
        Frequency and damping ratio of the mode.
    move, time, mass
        Length, duration and moved mass.
    residual
        Residual amplitude allowed after the move.
    limit, jerk, band
        Largest acceleration and jerk of a law for the mode, and its design band.
    """

    mode: str
    damping: float
    move: str | None
    time: str | None
    mass: str
    residual: str | None
    limit: str | None
    jerk: str | None
    band: float | None


def study(
    laws: Sequence[Law], asked: OfMode, *, out: Path | None, report: Path | None, json: bool
) -> None:
    """Rank ``laws`` on a mode, make a law for it if limits are given, print and write files.

    Raises
    ------
    OptionError
        If an option cannot be read, needs another one, or has an impossible value.
    """
    flexible = _mode(asked.mode, asked.damping)
    if asked.move is None or asked.time is None:
        raise OptionError(
            f"--mode {asked.mode} needs the move", remedy='Add --move "16.5 mm" --time "120 ms".'
        )
    move_m = parse_number("--move", asked.move, "m", "16.5 mm")
    window_s = parse_number("--time", asked.time, "s", "120 ms")
    mass_kg = parse_number("--mass", asked.mass, "kg", "1000 kg")
    still = None
    if asked.residual is not None:
        still = parse_number("--residual", asked.residual, "m", "0.05 mm")
    most = None
    if asked.limit is not None:
        most = parse_number("--limit", asked.limit, "m/s^2", "6.33 m/s^2")
    for option, typed, value, like in (
        ("--move", asked.move, move_m, "16.5 mm"),
        ("--time", asked.time, window_s, "120 ms"),
        ("--mass", asked.mass, mass_kg, "1000 kg"),
        ("--residual", asked.residual, still, "0.05 mm"),
        ("--limit", asked.limit, most, "6.33 m/s^2"),
    ):
        if value is not None and not 0.0 < value < np.inf:
            raise OptionError(
                f"{option} {typed!r} must be greater than 0, and finite",
                remedy=f'Write it like {option} "{like}".',
            )
    motion = _Move(
        mode=flexible, length_m=move_m, window_s=window_s, mass_kg=mass_kg, residual_m=still
    )
    demand = _demand(flexible, move_m, still, most, asked.jerk, asked.band, out)
    made, shaped = None, []
    with progress_bar(not json) as progress:
        found = sorted(
            (
                ringing(
                    each, flexible, move_m, window_s, residual=still,
                    acceleration=np.inf if most is None else most,
                )
                for each in laws
            ),
            key=lambda one: one.residual_m,
        )  # fmt: skip
        if demand is not None:
            made = made_law(demand, progress)
            shaped = shaped_windows(LAWS[COPIED], demand)
    tables = [_ranking(found, motion, limited=most is not None)]
    warnings: list[str] = []
    if made is not None:
        tables += [_made_table(made, shaped, found), _outside_table(made)]
        warnings.append(_notch(made))
    written = None
    with together(out):
        if report is not None:
            written = _report(report, found, laws, made, motion, tables, warnings)
        if out is not None and made is not None:
            write_law(made.law, out)
    if json:
        print_json(_content(found, motion, made, shaped, written))
        return
    for text in warnings:
        warning(text)
    for table in tables:
        print_table(table.title, table.header, table.rows)
        if table.note:
            say(table.note)
    if written is not None:
        say(f"Report: {written}")


def _mode(mode: str, damping: float) -> FlexibleMode:
    """Return the mode; errors name the options."""
    frequency_hz = parse_mode_hz(mode)
    if not 0.0 < frequency_hz < np.inf:
        raise OptionError(
            f"--mode {mode!r}: a frequency must be greater than 0 Hz",
            remedy='Measure at which frequency the load swings: --mode "12 Hz".',
        )
    if not 0.0 <= damping < MAX_DAMPING_RATIO:
        raise OptionError(
            f"--damping {damping:g}: a damping ratio must be from 0 to below {MAX_DAMPING_RATIO:g}",
            remedy="It is a share of critical damping, 0.02 for a frame on belts or screws.",
        )
    return FlexibleMode(frequency_hz, damping)


def _report(
    folder: Path, found: Sequence[Ringing], laws: Sequence[Law], made: MadeLaw | None,
    move: _Move, tables: Sequence[Table], warnings: Sequence[str],
) -> Path:  # fmt: skip
    """Write the report on the best laws, ``COPIED`` and the made law; return its page."""
    from threadline.report.laws import Curve, ResidualPlot, write_laws

    drawn = [Curve(one.law, move.window_s) for one in found[:_DRAWN]]
    if all(one.law.name != COPIED for one in drawn) and len(laws) > 1:
        drawn[-1] = Curve(LAWS[COPIED], move.window_s)
    if made is not None:
        drawn.insert(0, Curve(made.law, made.window_s))
    residual = ResidualPlot(
        curves=drawn,
        mode=move.mode,
        move_m=move.length_m,
        limit_m=move.residual_m,
        band=None if made is None else made.demand.band,
    )
    return write_laws([curve.law for curve in drawn], tables, warnings, folder, residual=residual)


def _demand(
    mode: FlexibleMode, move_m: float, still: float | None, most: float | None, jerk: str | None,
    band: float | None, out: Path | None,
) -> Demand | None:  # fmt: skip
    """Return the demand on the law to be made; None if no law is to be made."""
    if most is not None and still is None:
        raise OptionError("--limit makes a law", remedy='Add --residual "0.05 mm", too.')
    for option, given in (("--jerk", jerk), ("--band", band), ("--out", out)):
        if given is not None and most is None:
            raise OptionError(f"{option} needs a law to be made", remedy="Add --limit, too.")
    if most is None or still is None:
        return None
    return Demand(
        mode=mode, band=_BAND if band is None else band, move_m=move_m, residual_m=still,
        acceleration_m_s2=most,
        jerk_m_s3=usual_jerk_m_s3(move_m, most)
        if jerk is None
        else parse_number("--jerk", jerk, "m/s^3", "663 m/s^3"),
    )  # fmt: skip


def _ranking(found: Sequence[Ringing], move: _Move, *, limited: bool) -> Table:
    move_m, window_s, still = move.length_m, move.window_s, move.residual_m
    header = ["law", "residual mm", "worst mm", "in ms", "m/s^2", "m/s^3", "peak N"]
    rows = []
    for one in found:
        law = one.law
        acceleration = law.acceleration * move_m / window_s**2
        rows.append(
            [
                law.name,
                f"{one.residual_m * 1e3:.4f}",
                f"{one.worst_m * 1e3:.4f}",
                f"{one.worst_window_s * 1e3:.4g}",
                f"{acceleration:.4g}",
                "infinite" if law.jerk is None else f"{law.jerk * move_m / window_s**3:.4g}",
                f"{move.mass_kg * acceleration:.4g}",
            ]
        )
        if one.window_s is not None:
            rows[-1].append(f"{one.window_s * 1e3:.4g}")
    if still is not None:
        header.append("still from ms")
    return Table(
        title=f"{move_m * 1e3:g} mm in {window_s * 1e3:g} ms on a mode of "
        f"{move.mode.frequency_hz:g} Hz, damping ratio {move.mode.damping_ratio:g}, "
        f"mass {move.mass_kg:g} kg",
        header=header,
        rows=rows,
        note="Residual: amplitude of the mode when the move ends, the motor following exactly; "
        "worst: the largest over this and every longer window, and the window that has it."
        + (
            ""
            if still is None
            else f" Still from: that and every longer window leaves at most {still * 1e3:g} mm"
            + (" within the acceleration." if limited else ".")
        ),
    )


def _made_table(made: MadeLaw, shaped: Sequence[ShapedWindow], found: Sequence[Ringing]) -> Table:
    d = made.demand
    rows = [
        [
            "made for the mode",
            f"{made.window_s * 1e3:.1f}",
            f"{made.velocity_m_s * 1e3:.4g}",
            f"{made.acceleration_m_s2:.4g}",
            f"{made.jerk_m_s3:.4g}",
            f"largest residual over the band, simulated: {made.simulated_m * 1e3:.4f} mm",
        ],
        ["bound of free levels", f"{made.free_levels_s * 1e3:.1f}", "", "", "infinite",
         "acceleration free to step, same band"],
        ["time-optimal", f"{made.time_optimal_s * 1e3:.1f}", "", "", "infinite",
         "acceleration free to step, exact mode alone"],
        ["rigid machine", f"{d.rigid_s * 1e3:.1f}", "", "", "infinite", "no mode at all"],
    ]  # fmt: skip
    for one in sorted(shaped, key=lambda each: each.window_s):
        law, window = one.law, one.window_s
        rows.append(
            [
                law.name,
                f"{window * 1e3:.1f}",
                f"{law.velocity * d.move_m / window * 1e3:.4g}",
                f"{law.acceleration * d.move_m / window**2:.4g}",
                "infinite" if law.jerk is None else f"{law.jerk * d.move_m / window**3:.4g}",
                "law and shaper, same band",
            ]
        )
    timed = [one for one in found if one.window_s is not None]
    if timed:
        best = min(timed, key=lambda each: each.window_s or np.inf)
        rows.append(
            [best.law.name, f"{(best.window_s or 0.0) * 1e3:.1f}", "", "", "",
             "the best law without the mode, for every longer window too"]
        )  # fmt: skip
    return Table(
        title=f"Shortest window for {d.residual_m * 1e3:g} mm over +-{d.band * 100:g} % of "
        f"{d.mode.frequency_hz:g} Hz within {d.acceleration_m_s2:g} m/s^2, {d.jerk_m_s3:.4g} m/s^3",
        header=["move", "window ms", "mm/s", "m/s^2", "m/s^3", "note"],
        rows=rows,
    )


def _beside(made: MadeLaw) -> tuple[Any, Any, Any]:
    ratios = np.array(_RATIOS)
    d = made.demand
    at = np.array([made.window_s])
    copied = [
        residual_m(
            LAWS[COPIED], FlexibleMode(r * d.mode.frequency_hz, d.mode.damping_ratio), d.move_m, at
        )[0]
        for r in _RATIOS
    ]
    return ratios, outside(made, ratios), np.array(copied)


def _outside_table(made: MadeLaw) -> Table:
    d = made.demand
    rows = [
        [
            f"{ratio * d.mode.frequency_hz:.4g}",
            f"{(ratio - 1.0) * 100:+.0f} %",
            f"{left * 1e3:.4f}",
            f"{copied * 1e3:.4f}",
            "" if abs(ratio - 1.0) <= d.band + 1e-9 else "outside the band",
        ]
        for ratio, left, copied in zip(*_beside(made), strict=True)
    ]
    return Table(
        title="The law made for the mode is a notch: its residual vibration on other modes, mm",
        header=["Hz", "off", "made", f"{COPIED} in the same window", "note"],
        rows=rows,
    )


def _notch(made: MadeLaw) -> str:
    d = made.demand
    f = d.mode.frequency_hz
    below, above = (
        1e3 * x for x in outside(made, np.array([1.0 - 2.0 * _wide(d), 1.0 + 2.0 * _wide(d)]))
    )
    return (
        f"the law made for the mode is a notch: {d.residual_m * 1e3:g} mm holds from "
        f"{f * (1.0 - d.band):.4g} to {f * (1.0 + d.band):.4g} Hz; at "
        f"{f * (1.0 - 2.0 * _wide(d)):.4g} Hz it leaves {below:.3g} mm, at "
        f"{f * (1.0 + 2.0 * _wide(d)):.4g} Hz {above:.3g} mm. Measure the mode where the load and "
        "the place vary"
    )


def _wide(demand: Demand) -> float:
    return min(max(demand.band, 0.05), 0.45)


def _content(
    found: Sequence[Ringing],
    move: _Move,
    made: MadeLaw | None,
    shaped: Sequence[ShapedWindow],
    written: Path | None,
) -> dict[str, Any]:
    move_m, window_s = move.length_m, move.window_s
    content: dict[str, Any] = {
        "mode_hz": move.mode.frequency_hz,
        "damping_ratio": move.mode.damping_ratio,
        "move_m": move_m,
        "window_s": window_s,
        "mass_kg": move.mass_kg,
        "laws": [
            law_json(one.law)
            | {
                "residual_m": one.residual_m,
                "worst_longer_m": one.worst_m,
                "worst_longer_window_s": one.worst_window_s,
                "velocity_m_s": one.law.velocity * move_m / window_s,
                "acceleration_m_s2": one.law.acceleration * move_m / window_s**2,
                "jerk_m_s3": None if one.law.jerk is None else one.law.jerk * move_m / window_s**3,
                "force_n": move.mass_kg * one.law.acceleration * move_m / window_s**2,
                "still_from_s": one.window_s,
            }
            for one in found
        ],
    }
    if made is not None:
        ratios, left, copied = _beside(made)
        content["made"] = law_json(made.law) | {
            "window_s": made.window_s,
            "residual_m": made.simulated_m,
            "velocity_m_s": made.velocity_m_s,
            "acceleration_m_s2": made.acceleration_m_s2,
            "jerk_m_s3": made.jerk_m_s3,
            "free_levels_s": made.free_levels_s,
            "time_optimal_s": made.time_optimal_s,
            "rigid_s": made.demand.rigid_s,
            "shaped": {one.law.name: one.window_s for one in shaped},
            "outside": [
                {"frequency_hz": r * move.mode.frequency_hz, "residual_m": x, f"{COPIED}_m": y}
                for r, x, y in zip(ratios.tolist(), left.tolist(), copied.tolist(), strict=True)
            ],
            "warning": _notch(made),
        }
    if written is not None:
        content["report"] = str(written)
    return content

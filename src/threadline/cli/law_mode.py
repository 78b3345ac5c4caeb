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
    limit_m = None
    if asked.residual is not None:
        limit_m = parse_number("--residual", asked.residual, "m", "0.05 mm")
    most_m_s2 = None
    if asked.limit is not None:
        most_m_s2 = parse_number("--limit", asked.limit, "m/s^2", "6.33 m/s^2")
    for option, typed, value, example in (
        ("--move", asked.move, move_m, "16.5 mm"),
        ("--time", asked.time, window_s, "120 ms"),
        ("--mass", asked.mass, mass_kg, "1000 kg"),
        ("--residual", asked.residual, limit_m, "0.05 mm"),
        ("--limit", asked.limit, most_m_s2, "6.33 m/s^2"),
    ):
        if value is not None and not 0.0 < value < np.inf:
            raise OptionError(
                f"{option} {typed!r} must be greater than 0, and finite",
                remedy=f'Write it like {option} "{example}".',
            )
    motion = _Move(
        mode=flexible,
        length_m=move_m,
        window_s=window_s,
        mass_kg=mass_kg,
        residual_m=limit_m,
    )
    demand = _demand(flexible, move_m, limit_m, most_m_s2, asked.jerk, asked.band, out)
    made, shaped = None, []
    with progress_bar(not json) as progress:
        ranked = sorted(
            (
                ringing(
                    each, flexible, move_m, window_s, residual=limit_m,
                    acceleration=np.inf if most_m_s2 is None else most_m_s2,
                )
                for each in laws
            ),
            key=lambda one: one.residual_m,
        )  # fmt: skip
        if demand is not None:
            made = made_law(demand, progress)
            shaped = shaped_windows(LAWS[COPIED], demand)
    tables = [_ranking(ranked, motion, limited=most_m_s2 is not None)]
    warnings: list[str] = []
    if made is not None:
        tables += [_made_table(made, shaped, ranked), _outside_table(made)]
        warnings.append(_notch(made))
    written = None
    with together(out):
        if report is not None:
            written = _report(report, ranked, laws, made, motion, tables, warnings)
        if out is not None and made is not None:
            write_law(made.law, out)
    if json:
        print_json(_content(ranked, motion, made, shaped, written))
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

    curves = [Curve(ringing_law.law, move.window_s) for ringing_law in found[:_DRAWN]]
    if all(curve.law.name != COPIED for curve in curves) and len(laws) > 1:
        curves[-1] = Curve(LAWS[COPIED], move.window_s)
    if made is not None:
        curves.insert(0, Curve(made.law, made.window_s))
    residual = ResidualPlot(
        curves=curves,
        mode=move.mode,
        move_m=move.length_m,
        limit_m=move.residual_m,
        band=None if made is None else made.demand.band,
    )
    return write_laws([curve.law for curve in curves], tables, warnings, folder, residual=residual)


def _demand(
    mode: FlexibleMode, move_m: float, limit_m: float | None, most_m_s2: float | None,
    jerk: str | None, band: float | None, out: Path | None,
) -> Demand | None:  # fmt: skip
    """Return the demand on the law to be made; None if no law is to be made."""
    if most_m_s2 is not None and limit_m is None:
        raise OptionError("--limit makes a law", remedy='Add --residual "0.05 mm", too.')
    for option, given in (("--jerk", jerk), ("--band", band), ("--out", out)):
        if given is not None and most_m_s2 is None:
            raise OptionError(f"{option} needs a law to be made", remedy="Add --limit, too.")
    if most_m_s2 is None or limit_m is None:
        return None
    return Demand(
        mode=mode, band=_BAND if band is None else band, move_m=move_m, residual_m=limit_m,
        acceleration_m_s2=most_m_s2,
        jerk_m_s3=usual_jerk_m_s3(move_m, most_m_s2)
        if jerk is None
        else parse_number("--jerk", jerk, "m/s^3", "663 m/s^3"),
    )  # fmt: skip


def _ranking(found: Sequence[Ringing], move: _Move, *, limited: bool) -> Table:
    move_m, window_s, limit_m = move.length_m, move.window_s, move.residual_m
    header = ["law", "residual mm", "worst mm", "in ms", "m/s^2", "m/s^3", "peak N"]
    rows = []
    for ranked_law in found:
        law = ranked_law.law
        acceleration = law.acceleration * move_m / window_s**2
        rows.append(
            [
                law.name,
                f"{ranked_law.residual_m * 1e3:.4f}",
                f"{ranked_law.worst_m * 1e3:.4f}",
                f"{ranked_law.worst_window_s * 1e3:.4g}",
                f"{acceleration:.4g}",
                "infinite" if law.jerk is None else f"{law.jerk * move_m / window_s**3:.4g}",
                f"{move.mass_kg * acceleration:.4g}",
            ]
        )
        if ranked_law.window_s is not None:
            rows[-1].append(f"{ranked_law.window_s * 1e3:.4g}")
    if limit_m is not None:
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
            if limit_m is None
            else f" Still from: that and every longer window leaves at most {limit_m * 1e3:g} mm"
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
    for shaped_window in sorted(shaped, key=lambda each: each.window_s):
        law, window_s = shaped_window.law, shaped_window.window_s
        rows.append(
            [
                law.name,
                f"{window_s * 1e3:.1f}",
                f"{law.velocity * d.move_m / window_s * 1e3:.4g}",
                f"{law.acceleration * d.move_m / window_s**2:.4g}",
                "infinite" if law.jerk is None else f"{law.jerk * d.move_m / window_s**3:.4g}",
                "law and shaper, same band",
            ]
        )
    settling = [ranked for ranked in found if ranked.window_s is not None]
    if settling:
        best = min(settling, key=lambda each: each.window_s or np.inf)
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


def _on_other_modes(made: MadeLaw) -> tuple[Any, Any, Any]:
    ratios = np.array(_RATIOS)
    demand = made.demand
    window_s = np.array([made.window_s])
    copied_m = [
        residual_m(
            LAWS[COPIED],
            FlexibleMode(r * demand.mode.frequency_hz, demand.mode.damping_ratio),
            demand.move_m,
            window_s,
        )[0]
        for r in _RATIOS
    ]
    return ratios, outside(made, ratios), np.array(copied_m)


def _outside_table(made: MadeLaw) -> Table:
    demand = made.demand
    rows = [
        [
            f"{ratio * demand.mode.frequency_hz:.4g}",
            f"{(ratio - 1.0) * 100:+.0f} %",
            f"{made_residual * 1e3:.4f}",
            f"{copied_m * 1e3:.4f}",
            "" if abs(ratio - 1.0) <= demand.band + 1e-9 else "outside the band",
        ]
        for ratio, made_residual, copied_m in zip(*_on_other_modes(made), strict=True)
    ]
    return Table(
        title="The law made for the mode is a notch: its residual vibration on other modes, mm",
        header=["Hz", "off", "made", f"{COPIED} in the same window", "note"],
        rows=rows,
    )


def _notch(made: MadeLaw) -> str:
    d = made.demand
    mode_hz = d.mode.frequency_hz
    low_mm, high_mm = (
        1e3 * x
        for x in outside(made, np.array([1.0 - 2.0 * _half_band(d), 1.0 + 2.0 * _half_band(d)]))
    )
    return (
        f"the law made for the mode is a notch: {d.residual_m * 1e3:g} mm holds from "
        f"{mode_hz * (1.0 - d.band):.4g} to {mode_hz * (1.0 + d.band):.4g} Hz; at "
        f"{mode_hz * (1.0 - 2.0 * _half_band(d)):.4g} Hz it leaves {low_mm:.3g} mm, at "
        f"{mode_hz * (1.0 + 2.0 * _half_band(d)):.4g} Hz {high_mm:.3g} mm. Measure the "
        "mode where the load and the place vary"
    )


def _half_band(demand: Demand) -> float:
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
        ratios, made_m, copied_m = _on_other_modes(made)
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
                for r, x, y in zip(ratios.tolist(), made_m.tolist(), copied_m.tolist(), strict=True)
            ],
            "warning": _notch(made),
        }
    if written is not None:
        content["report"] = str(written)
    return content

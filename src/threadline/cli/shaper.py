"""``threadline shaper``: design an input shaper, and show its cost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.cli.arguments import JsonOption, ReportOption, ratio
from threadline.cli.messages import warning
from threadline.cli.output import print_json, print_table, progress_bar, say, say_lines
from threadline.cli.shaper_measured import (
    Measured,
    measured_content,
    measured_power,
    measured_tables,
    measured_warnings,
    read_measured,
)
from threadline.cli.shaper_move import rest_to_rest, study_content, study_tables
from threadline.cli.shaper_text import (
    BANDED,
    KINDS,
    bands_of,
    curve_lines,
    damping_warnings,
    designed,
    missed,
    modes_of,
    price_content,
    price_table,
    refuse_worse_than_none,
    shape_two_axes,
    suspicions,
    tolerances_of,
)
from threadline.errors import OptionError
from threadline.motion.shaping import (
    ControllerLimits,
    FirmwareExport,
    FlexibleMode,
    Insensitivity,
    Realised,
    Shaper,
    check_higher_modes,
    insensitivity,
    klipper_export,
    marlin_export,
    realise,
    reprap_export,
    vibration_of,
)
from threadline.motion.shaping.onoff.study import MoveStudy, study_move
from threadline.report.document import Table
from threadline.report.shaper import write_shaper
from threadline.units import parse_number, without_noise

_EXPORTS: dict[str, Callable[[Shaper, FlexibleMode], FirmwareExport]] = {
    "klipper": klipper_export,
    "marlin": marlin_export,
    "reprapfirmware": reprap_export,
}
_STILL = 0.01  # allowed ringing, share of one full step's
_SI_BAND = 0.2  # half width over frequency: how well a stiffness is usually known


@dataclass(frozen=True, slots=True, kw_only=True)
class _Answer:
    shaper: Shaper
    modes: tuple[FlexibleMode, ...]
    tolerances: tuple[float, ...]
    realised: Realised | None
    widths: tuple[Insensitivity, ...]
    firmware: tuple[str, FirmwareExport] | None
    warnings: tuple[str, ...]
    study: MoveStudy | None = None
    measured: Measured | None = None


def shaper(
    mode: Annotated[
        list[str] | None,
        typer.Option(
            help='Undamped frequency, "3.04 Hz"; optionally with damping ratio, band and '
            'tolerance: "3.04Hz:0.0089:20%:5%". Repeat for each mode.'
        ),
    ] = None,
    measured: Annotated[
        Path | None,
        typer.Option(
            help="Design for the mode in this file of an accelerometer (CSV of Klipper, Kalico, a "
            "phone or an ADXL), instead of --mode."
        ),
    ] = None,
    axis: Annotated[
        str | None,
        typer.Option(help="With --measured: the axis that was shaken, x, y or z (the strongest)."),
    ] = None,
    damping: Annotated[
        list[float] | None,
        typer.Option(
            parser=ratio("--damping"), help="Damping ratio: one for all modes, or one for each."
        ),
    ] = None,
    tolerance: Annotated[
        float,
        typer.Option(
            parser=ratio("--tolerance"),
            help="Vibration allowed, as a share of the vibration after one unit impulse: 0.05.",
        ),
    ] = 0.05,
    kind: Annotated[
        str, typer.Option(help=", ".join(KINDS) + '; convolved: "zv*um-2ei"; "mzv(n=4,t=0.9)".')
    ] = "zv",
    band: Annotated[
        float | None,
        typer.Option(
            parser=ratio("--band"),
            help="Half width of the frequency band: for si, 0.2 by default; for --tick, by default "
            "the band in which the exact shaper keeps its tolerance.",
        ),
    ] = None,
    tick: Annotated[
        str | None, typer.Option(help='Place impulses on whole ticks of the controller: "10 ms".')
    ] = None,
    dwell: Annotated[
        str | None, typer.Option(help='Shortest time between switchings, with --tick: "20 ms".')
    ] = None,
    max_impulses: Annotated[
        int | None,
        typer.Option(help="With --tick: largest number of impulses the controller takes."),
    ] = None,
    free: Annotated[
        bool, typer.Option(help="With --tick: choose amplitudes anew (flow valves, axes).")
    ] = False,
    move: Annotated[
        str | None, typer.Option(help='Time a move of this length, with --acceleration: "200 mm".')
    ] = None,
    acceleration: Annotated[
        str | None, typer.Option(help='Acceleration during --move: "1 m/s^2".')
    ] = None,
    still: Annotated[
        float | None,
        typer.Option(
            parser=ratio("--still"),
            help="Ringing allowed after --move, as a share of the ringing after a step of full "
            "acceleration (default 0.01).",
        ),
    ] = None,
    klipper: Annotated[
        bool,
        typer.Option(
            "--klipper", help="Print Klipper's section; two modes are one for X and one for Y."
        ),
    ] = False,
    firmware: Annotated[
        str | None,
        typer.Option(
            help="Print the settings of klipper, marlin or reprapfirmware for this shaper, or the "
            "nearest that it plays."
        ),
    ] = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Design an input shaper and print its impulses, its sensitivity and its cost in time.

    Frequencies are undamped, vibration is normalised to one unit impulse, and insensitivity is
    (f_hi - f_lo) / f within the tolerance. Exit status: 0, or 2 for wrong input.

    With --move the shaped move is compared with the time-optimal one and the robust optimum over
    --band (default 20 %). With --tick too, an on/off command is searched within 10 % of that
    optimum, and the trade-off between ringing and time is listed.

    With --measured the damping and the frequency of the strongest mode are found with their 95 %
    intervals, and Klipper's own choice is shown beside the design.

    Example: threadline shaper --mode 3.04Hz --damping 0.17 --tolerance 0.05 --kind um-2ei

    Example: threadline shaper --mode 3.04Hz --kind zv --move "200 mm" --acceleration "1 m/s^2"
    --tick "10 ms"
    """
    moving = move is not None or acceleration is not None
    measurement = _measured(measured, mode, axis, damping)
    needs_band = band is None and (moving or tick is not None or kind in BANDED)
    given_modes = (
        modes_of(mode or [], damping)
        if measurement is None
        else (measurement.as_option(banded=needs_band),)
    )
    modes = tuple(one.mode for one in given_modes)
    if still is not None and not moving:
        raise OptionError(
            "--still needs a move", remedy="Add --move and --acceleration, or leave it out."
        )
    own_band = next((one.band for one in given_modes if one.band is not None), None)
    band_given = band if own_band is None else own_band
    if band_given is not None and not (moving or tick is not None or kind in BANDED):
        raise OptionError(
            f"--band {band_given:g} has no effect on the kind {kind}"
            if own_band is None
            else f"the band of a --mode, {own_band * 100:.4g}%, has no effect on the kind {kind}",
            remedy="Add --tick or --move, or choose --kind si or um-si.",
        )
    if band is None and kind in BANDED:
        band = _SI_BAND
    bands, tolerances = bands_of(given_modes, band or 0.0), tolerances_of(given_modes, tolerance)
    firmware = _firmware(firmware, klipper, len(modes))
    klipper = firmware == "klipper"
    if klipper and len(modes) > 1:
        one_train_options = (tick, move, acceleration, report)
        shape_two_axes(kind, given_modes, tolerances, bands, one_train_options, json)
        return
    designed_shaper = designed(kind, modes, tolerances, bands)
    realised = None
    tick_s = None if tick is None else parse_number("--tick", tick, "s", "10 ms")
    if tick_s is None:
        for name, given in (
            ("--dwell", dwell is not None),
            ("--max-impulses", max_impulses is not None),
            ("--free", free),
        ):
            if given:
                raise OptionError(f"{name} needs the controller's tick", remedy="Add --tick.")
    else:
        limits = ControllerLimits(
            tick_s=tick_s,
            dwell_s=0.0 if dwell is None else parse_number("--dwell", dwell, "s", "20 ms"),
            max_impulses=max_impulses,
            amplitudes_free=free,
        )
        realised = realise(
            designed_shaper,
            modes,
            limits,
            relative=[band if one.band is None else one.band for one in given_modes],
            tolerance=tolerances,
        )
        designed_shaper = realised.shaper
        refuse_worse_than_none(designed_shaper, modes)
    requirements = tuple(zip(modes, bands, tolerances, strict=True))
    warnings = damping_warnings(modes) if firmware else list(suspicions(modes))
    warnings += [
        *_spoiled(realised),
        *(missed(designed_shaper, requirements) if kind in BANDED else ()),
    ]
    # A train of positive amplitudes amplifies at no frequency.
    for one in modes if bool((designed_shaper.amplitudes < 0.0).any()) else ():
        others = [other for other in modes if other is not one]
        warnings += [
            w
            for w in check_higher_modes(designed_shaper, one, others).warnings
            if w not in warnings
        ]
    if measurement is not None:
        warnings += measured_warnings(measurement, designed_shaper, chosen=axis is not None)
    move_study = None
    if moving:
        rest_move = rest_to_rest(move, acceleration, modes)
        with progress_bar(not json) as progress:
            move_study = study_move(
                rest_move,
                designed_shaper,
                relative=bands_of(given_modes, _SI_BAND if band is None else band),
                tolerance=_STILL if still is None else still,
                tick_s=tick_s,
                dwell_s=0.0 if dwell is None else parse_number("--dwell", dwell, "s", "20 ms"),
                progress=progress,
            )
    answer = _Answer(
        shaper=designed_shaper,
        modes=modes,
        tolerances=tolerances,
        realised=realised,
        widths=tuple(
            insensitivity(designed_shaper, one, mode_tolerance)
            for one, mode_tolerance in zip(modes, tolerances, strict=True)
        ),
        firmware=None
        if firmware is None
        else (firmware, _export(firmware, designed_shaper, modes[0], measurement)),
        warnings=tuple(warnings),
        study=move_study,
        measured=measurement,
    )
    written = (
        None
        if report is None
        else write_shaper(
            designed_shaper,
            modes,
            tolerances,
            _tables(answer),
            warnings,
            report,
            None if measurement is None else measured_power(measurement, designed_shaper),
        )
    )
    if json:
        print_json(_content(answer, written))
        return
    _print(answer, written)


def _print(answer: _Answer, written: Path | None) -> None:
    for text in answer.warnings:
        warning(text)
    for table in _tables(answer):
        print_table(table.title, table.header, table.rows)
    for line in curve_lines(answer.shaper, answer.modes, answer.tolerances):
        say(line)
    if answer.firmware is not None:
        export = answer.firmware[1]
        say(export.explanation)
        if export.section:
            say_lines(export.section)
    if written is not None:
        say(f"Report: {written}")


def _tables(answer: _Answer) -> list[Table]:
    train = answer.shaper
    impulses = [
        [str(i), f"{t:.6f}", f"{a:.6f}", f"{level:.6f}"]
        for i, (t, a, level) in enumerate(
            zip(train.times_s, train.amplitudes, train.levels, strict=True), start=1
        )
    ]
    modes = [
        [
            f"{m.frequency_hz:g}",
            f"{m.damping_ratio:g}",
            f"{without_noise(vibration_of(train, m)) * 100:.3g} %",
            f"{width.low_hz:.4g} to {width.high_hz:.4g}",
            f"{width.value:.4f} at {width.tolerance * 100:g} %",
        ]
        for m, width in zip(answer.modes, answer.widths, strict=True)
    ]
    return [
        *([] if answer.measured is None else measured_tables(answer.measured, train)),
        Table(
            title=f"Shaper {train.name}",
            header=("impulse", "time s", "amplitude", "level after"),
            rows=impulses,
        ),
        Table(
            title="Vibration, and where it stays within its tolerance",
            header=("mode Hz", "damping ratio", "vibration", "Hz", "insensitivity"),
            rows=modes,
        ),
        Table(title="Cost", header=("what", "is"), rows=_cost(answer)),
        *([] if answer.realised is None else [price_table(answer.realised)]),
        *([] if answer.study is None else study_tables(answer.study)),
    ]


def _cost(answer: _Answer) -> list[list[str]]:
    train = answer.shaper
    period = max(m.damped_period_s for m in answer.modes)
    rows = [
        ["every move takes longer by", f"{train.duration_s:.6f} s"],
        ["in periods of the slowest mode", f"{train.duration_s / period:.4f}"],
        ["mean delay (centroid)", f"{train.centroid_s:.6f} s"],
        ["a shaped step goes beyond 0 ... 1 by", f"{without_noise(train.over_level):.4g}"],
    ]
    if answer.realised is not None:
        ticked = answer.realised
        rows += [
            ["on ticks", " ".join(map(str, ticked.ticks))],
            [
                f"{'longer' if ticked.time_price_s >= 0.0 else 'shorter'} than the exact train by",
                f"{abs(ticked.time_price_s) * 1e3:.3f} ms",
            ],
            [
                "rings more than that at the modes by",
                f"{without_noise(ticked.vibration_price) * 100:.3g} %",
            ],
        ]
    return rows


def _content(answer: _Answer, written: Path | None) -> dict[str, Any]:
    train = answer.shaper
    vibrations = [vibration_of(train, m) for m in answer.modes]
    content: dict[str, Any] = {
        "kind": train.name,
        "times_s": train.times_s.tolist(),
        "amplitudes": train.amplitudes.tolist(),
        "duration_s": train.duration_s,
        "centroid_s": train.centroid_s,
        "over_level": train.over_level,
        # The worst of several modes; "modes" lists each.
        "vibration": max(vibrations),
        "insensitivity": min(width.value for width in answer.widths),
        "tolerance": max(answer.tolerances),
        "modes": [
            {
                "frequency_hz": m.frequency_hz,
                "damping_ratio": m.damping_ratio,
                "vibration": v,
                "insensitivity": width.value,
                "low_hz": width.low_hz,
                "high_hz": width.high_hz,
                "tolerance": width.tolerance,
            }
            for m, v, width in zip(answer.modes, vibrations, answer.widths, strict=True)
        ],
        "warnings": list(answer.warnings),
    }
    if answer.realised is not None:
        content["ticks"] = list(answer.realised.ticks)
        content["time_price_s"] = answer.realised.time_price_s
        content["vibration_price"] = answer.realised.vibration_price
        content["bands"] = price_content(answer.realised)
    if answer.measured is not None:
        content["measured"] = measured_content(answer.measured, train)
    if answer.study is not None:
        content["move"] = study_content(answer.study)
    if answer.firmware is not None:
        name, export = answer.firmware
        content[name] = export.section or None
        content[f"{name}_note"] = export.explanation
    if written is not None:
        content["report"] = str(written)
    return content


def _measured(
    path: Path | None, mode: list[str] | None, axis: str | None, damping: list[float] | None
) -> Measured | None:
    """Return the mode measured in the file of ``--measured``; None if modes are given."""
    if path is None:
        if axis is not None:
            raise OptionError("--axis names the axis of --measured", remedy="Leave it out.")
        if not mode:
            raise OptionError("no mode is given", remedy="Give --mode or --measured.")
        return None
    if mode:
        raise OptionError("--mode and --measured both give a mode", remedy="Leave one out.")
    return read_measured(path, axis, damping)


def _export(
    name: str, made: Shaper, mode: FlexibleMode, measurement: Measured | None
) -> FirmwareExport:
    if name == "klipper" and measurement is not None and measurement.found.axis in "xy":
        return klipper_export(made, mode, axes=measurement.found.axis)
    return _EXPORTS[name](made, mode)


def _firmware(name: str | None, klipper: bool, modes: int) -> str | None:
    """Return the firmware whose settings are wanted; None without one."""
    if name is not None and name not in _EXPORTS:
        raise OptionError(
            f"--firmware {name!r} is unknown", remedy=f"Firmwares: {', '.join(_EXPORTS)}."
        )
    if klipper and name not in (None, "klipper"):
        raise OptionError(
            f"--klipper and --firmware {name} ask for two firmwares", remedy="Leave one out."
        )
    chosen = "klipper" if klipper else name
    if chosen not in (None, "klipper") and modes > 1:
        raise OptionError(
            f"--firmware {chosen} takes one mode, {modes} are given", remedy="Give one --mode."
        )
    return chosen


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("shaper")(shaper)


def _spoiled(realised: Realised | None) -> list[str]:
    """Return warnings for shapers that the controller's ticks have spoiled."""
    warnings = []
    for band in () if realised is None else realised.bands:
        if band.made >= 1.0:
            warnings.append(
                f"on these ticks the shaper leaves up to {band.made * 100:.3g} % within its band "
                f"about {band.mode.frequency_hz:g} Hz, more than no shaper at all: take a shorter "
                "tick or --dwell, or another kind"
            )
        elif band.made_width == 0.0:
            warnings.append(
                "on these ticks the shaper leaves more than its tolerance of "
                f"{band.tolerance * 100:.3g} % at {band.mode.frequency_hz:g} Hz itself"
            )
    return warnings

"""``threadline cam``: make a motion law from a measured cam."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from threadline.base.writing import together
from threadline.cli.arguments import JsonOption, ReportOption
from threadline.cli.law_characteristics import law_json
from threadline.cli.messages import warning
from threadline.cli.output import check_outputs, print_json, print_table, progress_bar, say
from threadline.errors import OptionError
from threadline.motion.laws import write_law
from threadline.motion.laws.cam import MeasuredCam, Triangle, read_cam
from threadline.motion.laws.cam_study import CamStudy, Faired, Fairing, study_cam
from threadline.motion.laws.fairing import MOST_PASSES
from threadline.report.document import Table
from threadline.units import parse_number

_FEW = 20  # largest number of rows of which all are printed


def cam(
    measured: Annotated[
        Path, typer.Argument(help="Table: alpha [deg], h [mm] and, where printed, phi [deg].")
    ],
    b: Annotated[
        str | None, typer.Option(help='Distance from cam axis to rocker axis: "165 mm".')
    ] = None,
    c: Annotated[str | None, typer.Option(help='Length of the rocker: "135 mm".')] = None,
    roller: Annotated[
        str,
        typer.Option(help="Roller radius, added to each distance h; a negative one is subtracted."),
    ] = "0 mm",
    noise: Annotated[
        str | None, typer.Option(help='Measuring error: "0.05 mm"; default: estimated.')
    ] = None,
    fairing: Annotated[
        str, typer.Option(help="Fairing of the law: spline, rebound, differences, none.")
    ] = "spline",
    start: Annotated[
        str | None, typer.Option(help='Where the rise starts: "7.5 deg"; default: found.')
    ] = None,
    end: Annotated[str | None, typer.Option(help="Where the rise ends; default: found.")] = None,
    passes: Annotated[int, typer.Option(help="Largest number of rebound passes.")] = MOST_PASSES,
    epsilon: Annotated[
        str | None,
        typer.Option(help='Stop the rebound once a pass changes less than this: "0.001 mm".'),
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "--output", help="Write the law as a table (.csv).")
    ] = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Turn a measured cam into a motion law.

    b is the distance from the cam's axis to the rocker's axis, c the length of the rocker up to
    the roller. Each measured distance h closes the triangle with b and c; the angle between b and c
    is the rotation of the rocker. Without b and c, h is the stroke of a straight follower. Rows
    whose printed angle contradicts their distance are flagged, the noise is estimated, the rise is
    found, and the law is faired; no row is left out. Exit status: 0, or 2 for wrong input.

    Example: threadline cam examples/schiffli-cam.csv --b "165 mm" --c "135 mm" --noise "0.05 mm"
    """
    check_outputs(file=out, folder=report)
    if (b is None) != (c is None):
        raise OptionError("cam: a triangle needs b and c", remedy="Give both, or neither.")
    try:
        chosen = Fairing(fairing)
    except ValueError:
        raise OptionError(
            f"unknown fairing {fairing!r}", remedy=f"There are {', '.join(Fairing)}."
        ) from None
    triangle = None
    if b is not None and c is not None:
        triangle = Triangle(
            b_m=parse_number("--b", b, "m", "165 mm"),
            c_m=parse_number("--c", c, "m", "135 mm"),
            roller_m=parse_number("--roller", roller, "m", "10 mm"),
        )
    table = read_cam(measured, triangle)
    with progress_bar(not json):
        study = study_cam(
            table,
            fairing=chosen,
            noise_m=None if noise is None else parse_number("--noise", noise, "m", "0.05 mm"),
            rise_rad=(
                None if start is None else parse_number("--start", start, "rad", "7.5 deg"),
                None if end is None else parse_number("--end", end, "rad", "127.5 deg"),
            ),
            epsilon_m=None if epsilon is None else parse_number("--epsilon", epsilon, "m", "1 um"),
            most_passes=passes,
        )
    tables = [_rows(study), _fairings(study)]
    written = None
    with together(out):
        if report is not None:
            from threadline.report.laws import write_cam

            written = write_cam(study, [_rows(study, everything=True), tables[1]], report)
        if out is not None:
            write_law(study.law, out)
    if json:
        print_json(_content(study, written))
        return
    for text in study.warnings:
        warning(text)
    for table_shown in tables:
        print_table(table_shown.title, table_shown.header, table_shown.rows)
    for line in study.rise.sentences:
        say(line)
    noise_origin = (
        "as given"
        if study.noise_given
        else "from the number of printed digits"
        if study.noise_m <= table.rounding_m
        else "estimated from fourth differences"
    )
    say(f"noise {1e3 * study.noise_m:.3g} mm, {noise_origin}")
    rebound = study.rebounded
    say(
        f"the rebound ended after {rebound.passes} passes, by {rebound.stopped_by}, with rows "
        f"moved by {1e3 * rebound.moved:.3g} mm rms"
    )
    if written is not None:
        say(f"Report: {written}")


def _notes(study: CamStudy) -> dict[int, str]:
    notes = {
        flag.row: f"printed {np.degrees(flag.printed_rad):.2f}, is "
        f"{np.degrees(flag.checked_rad):.3f} deg"
        for flag in study.cam.flags
    }
    for row in study.outliers:
        remark = f"outlier: {study.scaled[row]:+.1f} times the noise off, kept"
        notes[row] = f"{notes[row]}; {remark}" if row in notes else remark
    return notes


def _rows(study: CamStudy, *, everything: bool = False) -> Table:
    """Return every row if they are few or ``everything`` is set, else the rows with a remark."""
    table, notes = study.cam, _notes(study)
    all_rows = everything or len(table.h_m) <= _FEW
    faired = study.faired(study.chosen)
    assert faired is not None
    has_angles = table.triangle is not None
    rows = [
        [
            f"{np.degrees(table.alpha_rad[k]):g}",
            f"{1e3 * table.h_m[k]:.3f}",
            f"{np.degrees(table.follower[k]):.3f}" if has_angles else "",
            f"{1e3 * faired.distances_m[k]:.3f}",
            f"{1e3 * (faired.distances_m[k] - table.h_m[k]):+.3f}",
            notes.get(k, ""),
        ]
        for k in range(len(table.h_m))
        if all_rows or k in notes
    ]
    rows_text = "" if all_rows else f", the ones of {len(table.h_m)} with a remark"
    return Table(
        title=f"Rows of {table.file}{rows_text}",
        header=["alpha deg", "h mm", "phi deg", f"{study.chosen} mm", "moved mm", "note"],
        rows=rows,
    )


def _fairings(study: CamStudy) -> Table:
    return Table(
        title="Before and after fairing; peaks +- their spread over 200 draws of the noise",
        header=["fairing", "moved mm rms", "2nd difference mm", "Cv", "Ca", "Cj", "note"],
        rows=[
            [
                str(faired.fairing) + (" *" if faired.fairing is study.chosen else ""),
                f"{1e3 * faired.moved_m:.4f}",
                f"{1e3 * faired.second_m:.4f}",
                *_peaks(faired),
                "" if faired.monotone else "goes back",
            ]
            for faired in study.fairings
        ],
    )


def _peaks(faired: Faired) -> list[str]:
    return [
        f"{peak:.4g} +- {spread:.2g}" if np.isfinite(peak) else "infinite"
        for peak, spread in zip(faired.peaks.tolist(), faired.spread.tolist(), strict=True)
    ]


def _content(study: CamStudy, written: Path | None) -> dict[str, Any]:
    table: MeasuredCam = study.cam
    faired = study.faired(study.chosen)
    assert faired is not None
    content: dict[str, Any] = {
        "law": law_json(study.law),
        "noise_m": study.noise_m,
        "noise_given": study.noise_given,
        "start_rad": study.rise.start_rad,
        "end_rad": study.rise.end_rad,
        "start_found": study.rise.start_found,
        "end_found": study.rise.end_found,
        "start_within_rad": study.rise.start_within_rad,
        "end_within_rad": study.rise.end_within_rad,
        "fairing": str(study.chosen),
        "fairings": {
            str(each.fairing): {
                "moved_m": each.moved_m,
                "second_difference_m": each.second_m,
                "monotone": each.monotone,
                **{
                    name: {"value": peak, "spread": spread}
                    if np.isfinite(peak)
                    else {"value": None, "spread": None}
                    for name, peak, spread in zip(
                        ("Cv", "Ca", "Cj"), each.peaks.tolist(), each.spread.tolist(), strict=True
                    )
                },
            }
            for each in study.fairings
        },
        "rebound": {
            "passes": study.rebounded.passes,
            "stopped_by": study.rebounded.stopped_by,
            "moved_m": study.rebounded.moved,
        },
        "rows": [
            {
                "line": table.lines[k],
                "alpha_rad": float(table.alpha_rad[k]),
                "h_m": float(table.h_m[k]),
                "follower": float(table.follower[k]),
                "faired_m": float(faired.distances_m[k]),
            }
            for k in range(len(table.h_m))
        ],
        "flagged": [
            {"line": f.line, "printed_rad": f.printed_rad, "checked_rad": f.checked_rad}
            for f in table.flags
        ],
        "outliers": [table.lines[row] for row in study.outliers],
        "warnings": list(study.warnings),
    }
    if written is not None:
        content["report"] = str(written)
    return content


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("cam")(cam)

"""``threadline law``: motion laws, their peaks, and the vibration that they leave in a mode."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.base.writing import together
from threadline.cli.arguments import JsonOption, ReportOption, ratio
from threadline.cli.law_characteristics import law_json, law_row
from threadline.cli.output import check_outputs, print_json, print_table, say
from threadline.errors import OptionError
from threadline.motion.laws import LAWS, Law, write_law
from threadline.motion.laws import law as law_of_catalogue


def law(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Law: modified-sine, 3-4-5, trapezoid:0.2, harmonic:7, a table t,s,v,a (.csv), "
            "modified-sine*zv:12Hz:0.02 in 160 ms; "
            "default: all."
        ),
    ] = None,
    mode: Annotated[
        str | None, typer.Option(help='Rank by the residual vibration of this mode: "12 Hz".')
    ] = None,
    damping: Annotated[
        float, typer.Option(parser=ratio("--damping"), help="Damping ratio of the mode.")
    ] = 0.0,
    move: Annotated[str | None, typer.Option(help='Length of the move: "16.5 mm".')] = None,
    time: Annotated[str | None, typer.Option(help='Duration of the move: "120 ms".')] = None,
    mass: Annotated[str, typer.Option(help="Mass that moves, for the peak force.")] = "1000 kg",
    residual: Annotated[
        str | None,
        typer.Option(
            help='Residual amplitude allowed after the move: "0.05 mm"; lists shortest windows.'
        ),
    ] = None,
    limit: Annotated[
        str | None,
        typer.Option(help='Largest acceleration, "6.33 m/s^2": makes a law for the mode.'),
    ] = None,
    jerk: Annotated[
        str | None,
        typer.Option(
            help="Largest jerk of the law of --limit; default: full acceleration after a 16th of "
            "the shortest move."
        ),
    ] = None,
    band: Annotated[
        float | None,
        typer.Option(
            parser=ratio("--band"),
            help="Half width of the law's design band, share of the frequency (default 0.1).",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "--output",
            help="Write the law, or the one made for the mode, as a table (.csv).",
        ),
    ] = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Show a motion law, rank laws on a mode, make one for it.

    A law is a rise from rest to rest, 1 in time 1. Cv, Ca and Cj are the peaks of velocity,
    acceleration and jerk: a move by h in time T has the peak velocity Cv h / T, acceleration
    Ca h / T^2, jerk Cj h / T^3. The efficiency compares motor heat: the cubic law, which heats
    least, divided by this law.

    With --mode, --move and --time the laws are ranked by the amplitude that they leave in that
    mode. With --residual and --limit too, a law is made for the mode: the shortest window that
    keeps the residual over the band.

    Example: threadline law modified-sine

    Example: threadline law --mode 12Hz --damping 0.02 --move "16.5 mm" --time "120 ms"
    --limit "6.33 m/s^2" --residual "0.05 mm" --band 0.1
    """
    check_outputs(file=out, folder=report)
    laws = list(LAWS.values()) if name is None else [_called(name)]
    mode_options = {
        "--move": move, "--time": time, "--residual": residual, "--limit": limit, "--jerk": jerk,
        "--band": band,
    }  # fmt: skip
    if mode is not None:
        from threadline.cli.law_mode import OfMode, study

        asked = OfMode(
            mode=mode, damping=damping, move=move, time=time, mass=mass, residual=residual,
            limit=limit, jerk=jerk, band=band,
        )  # fmt: skip
        study(laws, asked, out=out, report=report, json=json)
        return
    for option, given in mode_options.items():
        if given is not None:
            raise OptionError(f"{option} needs a mode", remedy='Add --mode "12 Hz".')
    if out is not None and name is None:
        raise OptionError(f"--out {str(out)!r} is for one law", remedy="Name the law.")
    written = None
    with together(out):
        if report is not None:
            from threadline.report.laws import write_laws

            written = write_laws(laws[:4] if name is None else laws, [], [], report)
        if out is not None:
            write_law(laws[0], out)
    if json and name is not None:
        print_json(law_json(laws[0]) | ({} if written is None else {"report": str(written)}))
    elif json:
        print_json({"laws": {each.name: law_json(each) for each in laws}})
    else:
        print_table(
            "Motion laws", ["law", "Cv", "Ca", "Cj", "efficiency"], [law_row(each) for each in laws]
        )
        if written is not None:
            say(f"Report: {written}")


def _called(name: str) -> Law:
    """Return the law with a name; a shaped law imports the shapers, which takes a second."""
    if "*" not in name:
        return law_of_catalogue(name)
    from threadline.motion.shaping.shaped_law import law_named

    return law_named(name)


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("law")(law)

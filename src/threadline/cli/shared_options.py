"""Options that several commands share, with one name and one help text each.

What reads a machine and options is ``chosen``: these texts need none of that.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from threadline.errors import OptionError
from threadline.option_defaults import (
    DEFAULT_CONTOUR_M,
    FEED_FORWARD,
    NO_CONTOUR,
    OPTIMAL_FEED_FORWARD,
)


def ratio(option: str) -> Callable[[str | float], float]:
    """Return the reader of an option that is a ratio, ``"20 %"`` or ``0.2``, for typer.

    Its errors are in the words of this program; a default comes as the number that it is.
    """

    def read(text: str | float) -> float:
        if not isinstance(text, str):
            return text
        # Units take a third of a second to load, and help has none to read.
        from threadline.typed_number import parse_number

        return parse_number(option, text, "", "20 %")

    read.__name__ = "ratio"  # what --help calls such a value
    return read


JobArgument = Annotated[Path, typer.Argument(help="Part program, seam or move list.")]
MachineOption = Annotated[
    str,
    typer.Option(
        "--machine",
        "-m",
        help="Machine file (.toml) or library name (threadline machines lists them), "
        "overlays after a plus: lathe-winder+physical.",
    ),
]
SpecOption = Annotated[
    Path | None,
    typer.Option("--spec", "-s", help="Specification file (.toml); default: the machine's own."),
]
ParOption = Annotated[
    Path | None,
    typer.Option(help="FW-CNC.PAR whose settings replace those of the machine file."),
]
InterpolationOption = Annotated[
    str,
    typer.Option(
        help="auto, optimal, firmware, point-to-point, linear, parabolic, cubic, quintic, "
        "b-spline, b-spline-pulled, law:NAME. By default firmware where the machine file names "
        "a motion planner, else auto; compile, which writes another program, has auto."
    ),
]
LawOption = Annotated[
    str | None,
    typer.Option(
        help="Every move from rest to rest by this motion law: modified-sine, harmonic:7, "
        "frame.csv (threadline law lists them)."
    ),
]
FeedOption = Annotated[
    str | None,
    typer.Option(
        help='Replaces every programmed feed: "10 count/tick", "36 mm/s" '
        '(of the fastest axis), "F 3000" (mm/min, as F of the program is meant).'
    ),
]
FeedModeOption = Annotated[
    str | None,
    typer.Option(
        help="By whose rule F of a part program is a speed: cadfil, fanuc, fluidnc, grbl, "
        "linuxcnc, marlin, rs274, fastest-axis, path, or base-axes:A and base-axes:A,X, CADFIL's "
        "modes 1 and 2. Default: the machine file's."
    ),
]
DialectOption = Annotated[
    str | None,
    typer.Option(
        help="What the words of a program mean: winder, linuxcnc, grbl, fluidnc, marlin, fanuc, "
        "x-winder. Default: the machine file's."
    ),
]
RadiusOption = Annotated[
    str | None,
    typer.Option(
        help='Radius at which a rotary axis acts: "A=40 mm" for a mandrel of 80 mm, '
        '"A=20 mm at X 0 mm; 50 mm at X 100 mm" for a cone, or "A=mandrel.csv". Default: the '
        "machine file's."
    ),
]
ToleranceOption = Annotated[
    str,
    typer.Option(
        help="Largest deviation from the programmed path, kept by auto, optimal and parabolic: "
        '"0.1 mm".'
    ),
]
ContourOption = Annotated[
    str | None,
    typer.Option(
        help=f"Of optimal: how far the loops may leave the path; default "
        f'"{DEFAULT_CONTOUR_M * 1e3:g} mm", "{NO_CONTOUR}" for no limit. With '
        "--feed-forward: how far the loads may leave their motion where its table begins and ends."
    ),
]
LimitsOption = Annotated[
    str,
    typer.Option(help="Share of the acceleration and jerk limits that the planner uses."),
]
JsonOption = Annotated[
    bool,
    typer.Option(
        "--json",
        help="Print one JSON object instead; errors stay text on stderr, stdout is then empty.",
    ),
]


def named_folder(text: str) -> Path:
    """Return a folder; refuse an empty name, which would be the current folder."""
    if not text:
        raise typer.BadParameter("it is empty; name a folder, or . for this one")
    return Path(text)


ReportOption = Annotated[
    Path | None,
    typer.Option(
        parser=named_folder, metavar="<path>", help="Folder for the report (HTML, PDF, PNG, SVG)."
    ),
]
RecordingOption = Annotated[
    Path | None,
    typer.Option(
        help="Write the recording to this file: .npz, .csv, or .plt, a line every "
        "operator.record_every ticks."
    ),
]
ShaperOption = Annotated[
    str | None,
    typer.Option(
        help='Shape the motion: "zv:12Hz:0.02" is kind, frequency, damping ratio; "*" convolves, '
        '"X=..., Y=..." gives axes their own.'
    ),
]
FeedForwardOption = Annotated[
    bool,
    typer.Option(
        "--feed-forward",
        help="Feed-forward by the inverses of the axes' models, so that the loads follow the path.",
    ),
]
SmoothingOption = Annotated[
    str | None,
    typer.Option(
        help=f'Time over which feed-forward smooths the motion; default "{FEED_FORWARD}", of '
        f'optimal "{OPTIMAL_FEED_FORWARD}".'
    ),
]
RobustOption = Annotated[
    str | None,
    typer.Option(
        help="With --feed-forward: keep the loads from ringing wherever masses and stiffnesses are "
        'within this share of their tolerances: "100 %". --smoothing is then the time in which '
        "the speed may change, four turns of a seam's needle without it.",
    ),
]
ActualOption = Annotated[
    str | None,
    typer.Option(
        help="Machine that runs what was planned for --machine: a file or a library name."
    ),
]


def keep_inputs(output: Path | None, *inputs: Path | str | None) -> None:
    """Refuse an output file that is one of the input files, which would be overwritten.

    Raises
    ------
    OptionError
        If the output is one of the inputs, by whatever name.
    """
    if output is None or not output.exists():
        return
    for name in inputs:
        source = None if name is None else Path(name)
        if source is not None and source.exists() and output.samefile(source):
            raise OptionError(
                f"{str(output)!r} is the input {str(source)!r} and would be written over",
                remedy="Give another file to write.",
            )

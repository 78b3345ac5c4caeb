"""Options that several commands share, so that they read and are explained the same everywhere."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.errors import OptionError
from threadline.machine import Machine, load_machine
from threadline.machine.par import read_parameters
from threadline.options import (
    DEFAULT_INTERPOLATION,
    Options,
    parse_feed,
    parse_share,
    parse_tolerance_m,
    parse_width_s,
)
from threadline.path.plan import DEFAULT_TOLERANCE_M

FEED_FORWARD = "40 ms"
"""Over which feed-forward smooths the motion unless told otherwise."""

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
        help="point-to-point, linear, parabolic, cubic, quintic, b-spline, b-spline-pulled, auto."
    ),
]
FeedOption = Annotated[
    str | None, typer.Option(help='Replaces every programmed feed: "10 count/tick", "36 mm/s".')
]
FeedModeOption = Annotated[
    str | None,
    typer.Option(
        help="What F of a part program means: fastest-axis (default), path, or base-axes:A and "
        "base-axes:A,X, CADFIL's modes 1 and 2."
    ),
]
ToleranceOption = Annotated[
    str,
    typer.Option(
        help='Largest deviation from the programmed path, kept by auto and parabolic: "0.1 mm".'
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


def report_folder(text: str) -> Path:
    """Return the folder of a report; an empty name would be the current folder."""
    if not text:
        raise typer.BadParameter("it is empty; name a folder, or . for this one")
    return Path(text)


ReportOption = Annotated[
    Path | None,
    typer.Option(
        parser=report_folder, metavar="<path>", help="Folder for the report (HTML, PDF, PNG, SVG)."
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
        help="Command what the exact inverses of the axes say, so that the loads follow.",
    ),
]
SmoothingOption = Annotated[
    str | None,
    typer.Option(
        help=f'Time over which feed-forward smooths the motion; default "{FEED_FORWARD}".'
    ),
]
ActualOption = Annotated[
    str | None,
    typer.Option(
        help="Machine that runs what was planned for --machine: a file or name, as there."
    ),
]
DEFAULT_INTERPOLATION_TEXT = DEFAULT_INTERPOLATION
DEFAULT_LIMITS_TEXT = "100 %"
DEFAULT_TOLERANCE_TEXT = f"{DEFAULT_TOLERANCE_M * 1e3:g} mm"


def machine_from(reference: str, par: Path | None) -> Machine:
    """Return the machine that the options name."""
    machine = load_machine(reference)
    return machine if par is None else read_parameters(par, machine)


def keep_inputs(output: Path | None, *inputs: Path | str | None) -> None:
    """Refuse an output file that is one of the input files: it would be written over.

    Raises
    ------
    OptionError
        If it is one, by whatever name.
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


def options_of(
    interpolation: str,
    feed: str | None,
    tolerance: str,
    limits: str = DEFAULT_LIMITS_TEXT,
    shaper: str | None = None,
    feed_forward: bool = False,
    smoothing: str | None = None,
    feed_mode: str | None = None,
) -> Options:
    """Return the planning options, read from their text.

    Raises
    ------
    OptionError
        If one is unreadable, a smoothing is given without feed-forward, or a meaning of F with a
        feed that replaces it.
    """
    if smoothing is not None and not feed_forward:
        raise OptionError(
            f"--smoothing {smoothing!r} is of feed-forward", remedy="Give --feed-forward too."
        )
    if feed is not None and feed_mode is not None:
        raise OptionError(
            f"--feed-mode {feed_mode!r} says what F means, and --feed replaces every F",
            remedy="Leave one of them out.",
        )
    return Options(
        interpolation=interpolation,
        feed=None if feed is None else parse_feed(feed),
        feed_mode=feed_mode,
        tolerance_m=parse_tolerance_m(tolerance),
        limit_share=parse_share(limits),
        shaper=shaper,
        feed_forward_s=parse_width_s(FEED_FORWARD if smoothing is None else smoothing)
        if feed_forward
        else None,
    )

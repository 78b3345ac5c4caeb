"""Arguments and outputs that several commands share, with one name and one help text each.

The options of planning, judging and searching are declared in ``option_table``.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from threadline.cli import completion
from threadline.errors import OptionError
from threadline.proof.option_form import Group


def ratio(option: str) -> Callable[[str | float], float]:
    """Return a parser for typer that reads a ratio option, ``"20 %"`` or ``0.2``.

    Its errors are Threadline's own; a default passes as the number that it is.
    """

    def read(text: str | float) -> float:
        if not isinstance(text, str):
            return text
        # Units take a third of a second to load, and --help does not need them.
        from threadline.units import parse_number

        return parse_number(option, text, "", "20 %")

    read.__name__ = "ratio"  # name of the value in --help
    return read


JobArgument = Annotated[Path, typer.Argument(help="Part program, seam or move list.")]
MachineOption = Annotated[
    str,
    typer.Option(
        "--machine",
        "-m",
        autocompletion=completion.machines,
        help="Machine file (.toml) or library name (threadline machines lists them), "
        "overlays after a plus: lathe-winder+physical.",
        rich_help_panel=Group.INPUT.value,
    ),
]
ThisMachineOption = Annotated[
    str | None,
    typer.Option(
        "--machine",
        "-m",
        autocompletion=completion.machines,
        help="Machine file (.toml) or library name (threadline machines lists them), overlays "
        "after a plus: lathe-winder+physical. Not with --merge.",
        rich_help_panel=Group.INPUT.value,
    ),
]
JobsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="JOB",
        help="Part program, seam or move list; with --merge, the files of all parts.",
    ),
]
SpecOption = Annotated[
    Path | None,
    typer.Option("--spec", "-s", help="Specification file (.toml); default: the machine's own."),
]
ParOption = Annotated[
    Path | None,
    typer.Option(help="FW-CNC.PAR whose settings replace the settings of the machine file."),
]
SignOption = Annotated[
    Path | None,
    typer.Option(
        "--sign",
        metavar="KEY",
        help="With --proof: sign the proof with the key in this file (16 bytes and more), "
        "HMAC-SHA256.",
    ),
]
KeyOption = Annotated[
    Path | None,
    typer.Option(
        "--key",
        metavar="KEY",
        help="Refuse a proof that was not signed with the key in this file (prove --sign KEY).",
    ),
]
JsonOption = Annotated[
    bool,
    typer.Option(
        "--json",
        help="Print one JSON object instead; errors stay text on stderr, stdout is then empty.",
    ),
]


def named_folder(text: str) -> Path:
    """Return a folder; refuse an empty name, which would mean the current folder."""
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


def key_of(option: str, key: Path | None, proof: Path | None) -> bytes | None:
    """Return the signing key in the file ``key``, None without one.

    Raises
    ------
    OptionError
        If no proof is given that the key could sign or check, or the file holds no key.
    """
    if key is None:
        return None
    if proof is None:
        raise OptionError(f"{option} signs or checks a proof", remedy="Give --proof FILE.")
    # Proofs take a while to load, and --help does not need them.
    from threadline.proof.proof_hash import read_key

    return read_key(key)


def keep_inputs(output: Path | None, *inputs: Path | str | None) -> None:
    """Refuse an output file that would overwrite one of the input files.

    Raises
    ------
    OptionError
        If the output is one of the inputs, also by another path to the same file.
    """
    if output is None or not output.exists():
        return
    for name in inputs:
        source = None if name is None else Path(name)
        if source is not None and source.exists() and output.samefile(source):
            raise OptionError(
                f"{str(output)!r} is the input {str(source)!r} and would be overwritten",
                remedy="Give another file to write.",
            )

"""``threadline new``: a folder with a machine, a specification and a job that can be proved."""

from __future__ import annotations

import difflib
import os
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from threadline import __version__
from threadline.cli.from_settings import KINDS, PROVE, settings_files
from threadline.cli.output import print_json, say
from threadline.cli.outputs import check_outputs
from threadline.cli.shared_options import JsonOption
from threadline.errors import OptionError
from threadline.machine import library_file
from threadline.writing import staging_folder


@dataclass(frozen=True, slots=True)
class Project:
    """A kind of project.

    Parameters
    ----------
    machine
        Name of a machine of the library.
    prove
        Arguments of ``threadline prove`` with which the job of the project is in specification.
    """

    machine: str
    prove: str


PROJECTS = {
    "winder": Project("lathe-winder", "reversal.prg -m machine.toml"),
    "stepper": Project("stepper-winder", "reversal.prg -m machine.toml"),
    "stitcher": Project(
        "stitcher", 'corners.seam.toml -m machine.toml --feed-forward --smoothing "42 ms"'
    ),
    "placer": Project(
        "letter-placer", "cycle.toml -m machine.toml+whole-scans+own-damping --shaper zv"
    ),
    "embroidery": Project("schiffli-frame", "rosette.dst -m machine.toml"),
}


def new(
    kind: Annotated[
        str, typer.Argument(help=f"What the machine is: {', '.join([*PROJECTS, *KINDS])}.")
    ],
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="Folder to make; an empty one may be there.")
    ],
    from_: Annotated[
        Path | None,
        typer.Option(
            "--from",
            help="Settings of the firmware: what grbl answers to $$, Marlin to M503, a FluidNC "
            "YAML, a printer.cfg, a config.g of RepRapFirmware.",
        ),
    ] = None,
    answers: Annotated[
        list[str] | None,
        typer.Option("--set", help='A value the settings lack: "mass=1.2 kg", "mass.X=1.2 kg".'),
    ] = None,
    limits_only: Annotated[
        bool,
        typer.Option(
            "--limits-only",
            help="Of a firmware's machine: take its limits alone, without values of motors and "
            "masses. Jobs are then proven for limits and time, and not for placement.",
        ),
    ] = False,
    json: JsonOption = False,
) -> None:
    """Make a working project: machine.toml, spec.toml, a job, and a README with the commands.

    The machine is one of the library's, to be changed into yours, or the one that a firmware's
    settings describe; values that the settings lack are asked for by name.

    Example: threadline new winder my-winder

    Of a machine with grbl: threadline new grbl-winder my-winder --from settings.txt
    --set rotary=A --set "torque=1.26 N m"

    With the limits of the settings alone: threadline new grbl-winder my-winder --from settings.txt
    --limits-only --set rotary=A --set "radius=50 mm"
    """
    if kind in KINDS:
        if from_ is None:
            raise OptionError(
                f"a {kind} is made from the settings of its firmware",
                remedy="Name them with --from.",
            )
        prove = PROVE
        contents = settings_files(kind, from_, answers or [], limits_only=limits_only)
    else:
        prove, contents = _project(kind).prove, project_files(kind)
        if from_ is not None or answers or limits_only:
            raise OptionError(
                f"--from, --set and --limits-only are not of the kind {kind!r}",
                remedy=f"Use {', '.join(KINDS)}.",
            )
    _check(folder)
    _write(folder, contents)
    command = f"threadline prove {prove}"
    if json:
        print_json({"folder": str(folder), "files": sorted(contents), "prove": command})
        return
    say(f"{folder}: {', '.join(sorted(contents))}")
    there = "" if folder == Path() else f"cd {shlex.quote(str(folder))} && "
    say(f"Next: {there}{command}")


def project_files(kind: str) -> dict[str, bytes]:
    """Return the files of a project: names and contents."""
    name = PROJECTS[kind].machine
    files = {}
    for file, source in (
        ("machine.toml", library_file(name)),
        ("spec.toml", library_file(name).with_suffix(".spec.toml")),
    ):
        head = f"# From {source.name} of Threadline {__version__}: change it into yours.\n#\n"
        text = source.read_text(encoding="utf-8")
        text = _without_operator(text) if file == "machine.toml" else text
        files[file] = (head + text).encode()
    for entry in (resources.files("threadline.cli") / "projects" / kind).iterdir():
        files[entry.name] = entry.read_bytes()
    return files


def _without_operator(machine: str) -> str:
    """Return a machine file without the operator's settings, which belong to the library's own."""
    return re.sub(r"^\[operator\]\n(?:[^\n\[][^\n]*\n)*\n?", "", machine, flags=re.MULTILINE)


def _project(kind: str) -> Project:
    if kind not in PROJECTS:
        close = difflib.get_close_matches(kind, [*PROJECTS, *KINDS], n=1)
        hint = f"Did you mean {close[0]!r}? " if close else ""
        raise OptionError(
            f"there is no project {kind[:40]!r}",
            remedy=f"{hint}There are: {', '.join([*PROJECTS, *KINDS])}.",
        )
    return PROJECTS[kind]


def _check(folder: Path) -> None:
    if folder.is_dir() and any(folder.iterdir()):
        raise OptionError(
            f"the folder {str(folder)!r} is not empty", remedy="Name one that is not there yet."
        )
    if os.path.lexists(folder) and not folder.is_dir():
        raise OptionError(f"{str(folder)!r} is not a folder", remedy="Name another.")
    check_outputs(folder=folder)


def _write(folder: Path, contents: Mapping[str, bytes]) -> None:
    """Write all files or none, in a folder that is made or is empty."""
    with staging_folder(folder) as staged:
        for name, content in contents.items():
            (staged / name).write_bytes(content)


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("new")(new)

"""``threadline new``: make a folder with a machine, a specification and a job that is in spec."""

from __future__ import annotations

import difflib
import os
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from threadline import __version__
from threadline.base.writing import staging_folder
from threadline.cli.arguments import JsonOption
from threadline.cli.from_settings import (
    ANSWERS_TO,
    FIRMWARES,
    KINDS,
    PROVE,
    FromSettings,
    settings_files,
    settings_of,
    still_missing,
)
from threadline.cli.operator_keys import somebody_at_the_keys
from threadline.cli.output import ask, check_outputs, print_json, print_table, say
from threadline.errors import InputError, OptionError
from threadline.machine import library_file
from threadline.machine.firmware import check_answers, parse_answers

Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class Project:
    """A kind of project.

    Parameters
    ----------
    machine
        Name of a machine of the library.
    prove
        Arguments of ``threadline prove`` that prove the project's job in specification.
    """

    machine: str
    prove: str


_WINDER = "-winder"
"""May follow the name of a firmware: the machine is the same, a winder has a rotary axis."""
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
    "winding": Project("lathe-winder", "vessel.wind.toml -m machine.toml --nominal"),
}


@dataclass(slots=True)
class NewProject:
    """The project to make, from the command line and answers at the terminal."""

    kind: str
    folder: Path
    source: Path | None
    answers: list[str]
    limits_only: bool


def new(
    kind: Annotated[
        str | None,
        typer.Argument(
            metavar="KIND", help=f"What the machine is: {', '.join([*KINDS, *PROJECTS])}."
        ),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="DIR", help="Folder to make; an empty one may be there."),
    ] = None,
    from_: Annotated[
        Path | None,
        typer.Option(
            "--from",
            help="Settings of the controller: grbl's answer to $$, Marlin's to M503, a FluidNC "
            "YAML, a printer.cfg, a config.g of RepRapFirmware, an INI of LinuxCNC. A log of a "
            "terminal will do, prompts and time stamps included.",
        ),
    ] = None,
    answers: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            help='A value that the settings lack: "mass=1.2 kg", "mass.X=1.2 kg", rotary=none.',
        ),
    ] = None,
    limits_only: Annotated[
        bool,
        typer.Option(
            "--limits-only",
            help="For a controller's machine: take only its limits, without motors and masses. "
            "Jobs are then proven for limits and time, not for placement. The same holds if "
            "--set names no motor and no mass.",
        ),
    ] = False,
    json: JsonOption = False,
) -> None:
    """Make a working project: machine.toml, spec.toml, a job, and a README with the commands.

    The machine is a copy of one in the library, to be edited, or comes from the settings of a
    controller: each value is listed with its line, and the command asks by name for values that
    the settings lack. Without arguments the command asks at the terminal for each.

    Example: threadline new winder my-winder

    With the limits of a grbl's settings: threadline new grbl my-router --from settings.txt

    With motors and masses: threadline new grbl my-winder --from settings.txt --set rotary=A
    --set "torque=1.26 N m"
    """
    given = list(answers or [])
    if kind is not None and kind.removesuffix(_WINDER) in KINDS:
        kind = kind.removesuffix(_WINDER)
    if kind is None or folder is None:
        if json or not somebody_at_the_keys():
            raise OptionError(
                "name the kind of machine" if kind is None else f"give a folder for the {kind}",
                remedy=f"Like threadline new {kind or 'grbl'} my-machine. Kinds: "
                f"{', '.join([*KINDS, *PROJECTS])}.",
            )
        project = _asked(kind, folder, from_, given, limits_only)
    else:
        project = NewProject(kind, folder, from_, given, limits_only)
    read: FromSettings | None = None
    if project.kind in KINDS:
        if project.source is None:
            raise OptionError(
                f"a {project.kind} machine is made from the settings of its controller",
                remedy=f"Name {ANSWERS_TO[project.kind]} with --from.",
            )
        read = settings_files(
            project.kind, project.source, project.answers, limits_only=project.limits_only
        )
        prove, contents = PROVE, read.contents
    else:
        prove, contents = _project(project.kind).prove, project_files(project.kind)
        if project.source is not None or project.answers or project.limits_only:
            raise OptionError(
                f"--from, --set and --limits-only do not apply to the kind {project.kind!r}",
                remedy=f"Use {', '.join(KINDS)}.",
            )
    _check(project.folder)
    _write(project.folder, contents)
    _tell(project.folder, sorted(contents), f"threadline prove {prove}", read, json=json)


def _tell(
    folder: Path, files: list[str], command: str, read: FromSettings | None, *, json: bool
) -> None:
    """Print the files made, and the lines of the settings they come from."""
    if json:
        content: dict[str, object] = {"folder": str(folder), "files": files, "prove": command}
        if read is not None:
            keys = ("setting", "value", "from")
            content["read"] = [dict(zip(keys, row, strict=True)) for row in read.rows]
            content |= {"form": read.form, "notes": read.notes, "left_out": read.left_out}
        print_json(content)
        return
    if read is not None:
        print_table(f"settings of {read.form}", ("setting", "value", "from"), read.rows)
        for text in read.notes:
            say(f"  {text}")
    say(f"{folder}: {', '.join(files)}")
    change_folder = "" if folder == Path() else f"cd {shlex.quote(str(folder))} && "
    say(f"Next: {change_folder}{command}")


def _asked(
    kind: str | None,
    folder: Path | None,
    source: Path | None,
    answers: list[str],
    limits_only: bool,
) -> NewProject:
    """Ask at the terminal for missing arguments, with defaults in brackets."""
    if kind is None:
        say(f"Kinds: {', '.join([*KINDS, *PROJECTS])}.")
        kind = _until_right("What the machine is", "grbl", _kind)
    if kind in KINDS and source is None:
        project_kind = kind
        source = _until_right(
            f"File of its settings: {ANSWERS_TO[kind]}",
            "settings.txt",
            lambda t: _source(project_kind, t),
        )
    if folder is None:
        folder = _until_right("Folder to make", f"my-{kind}", _folder)
    project = NewProject(kind, folder, source, answers, limits_only)
    if kind not in KINDS or source is None:
        return project
    settings = settings_of(kind, source)
    if not limits_only and not settings.coupled:
        project.limits_only = _until_right("Limits and times alone, without motors", "yes", _yes)
    project.limits_only |= bool(settings.coupled)
    while missing := still_missing(settings, answers, limits_only=project.limits_only):
        missing_answer = missing[0]

        def said(text: str, key: str = missing_answer.key) -> str:
            answer = f"{key}={text}"
            check_answers(settings, parse_answers([*answers, answer]))
            return answer

        answers.append(
            _until_right(
                f"{missing_answer.key}: {missing_answer.what}", missing_answer.example, said
            )
        )
    return project


def _until_right(question: str, default: str, read: Callable[[str], Answer]) -> Answer:
    """Ask until the answer can be read; an empty answer takes the default in brackets."""
    while True:
        line = ask(f"{question} [{default}]: ")
        if not line:
            raise OptionError(
                "the questions were not answered to the end", remedy="Nothing was made."
            )
        try:
            return read(line.strip() or default)
        except InputError as error:
            say(str(error))


def _kind(text: str) -> str:
    if text not in KINDS:
        _project(text)
    return text


def _source(kind: str, text: str) -> Path:
    settings_of(kind, Path(text).expanduser())
    return Path(text).expanduser()


def _folder(text: str) -> Path:
    _check(Path(text).expanduser())
    return Path(text).expanduser()


def _yes(text: str) -> bool:
    if text.lower() not in ("y", "yes", "n", "no"):
        raise OptionError(f"{text[:20]!r} is neither yes nor no")
    return text.lower() in ("y", "yes")


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
    """Return a machine file without its [operator] table, which holds the library's own."""
    return re.sub(r"^\[operator\]\n(?:[^\n\[][^\n]*\n)*\n?", "", machine, flags=re.MULTILINE)


_MACHINES = ("cnc", "engraver", "laser", "lathe", "mill", "plotter", "printer", "robot", "router")
"""Machines that people name first, and that any controller may drive."""


def _project(kind: str) -> Project:
    if kind not in PROJECTS:
        by_firmware = {firmware: name for name, firmware in FIRMWARES.items()}
        first_word = kind.partition("-")[0]
        close = difflib.get_close_matches(
            by_firmware.get(first_word, first_word), [*PROJECTS, *KINDS], n=1
        )
        hint = f"Did you mean {close[0]!r}? " if close else ""
        if kind.lower() in _MACHINES:
            hint = "A machine like this is named after the firmware of its controller. "
        raise OptionError(
            f"there is no project {kind[:40]!r}",
            remedy=f"{hint}There are: {', '.join([*KINDS, *PROJECTS])}.",
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
    """Write all files or none, in a new or empty folder."""
    with staging_folder(folder) as staged:
        for name, content in contents.items():
            (staged / name).write_bytes(content)


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("new")(new)

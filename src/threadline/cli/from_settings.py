"""A project of a machine that a firmware runs, made from that firmware's settings."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

from threadline import __version__
from threadline.cli.told import warning
from threadline.errors import OptionError, Place
from threadline.machine import library_file, load_machine
from threadline.machine.firmware import (
    Settings,
    machine_text,
    parse_answers,
    read_settings,
)

FIRMWARES = ("grbl", "fluidnc", "marlin", "klipper", "reprapfirmware")
KINDS = tuple(f"{name}-winder" for name in FIRMWARES)
PROVE = "there-and-back.gcode -m machine.toml"
_SPEC = "stepper-winder"
_WAY_MM, _FEED_MM_MIN = 20.0, 1200.0


def settings_files(
    kind: str, source: Path, answers: Sequence[str], *, limits_only: bool = False
) -> dict[str, bytes]:
    """Return the files of a project: names and contents.

    Parameters
    ----------
    kind
        One of ``KINDS``.
    source
        File of the settings as the firmware lists them.
    answers
        Values that the settings lack, ``"mass=1.2 kg"`` each.
    limits_only
        Whether to make a machine of limits alone, without values of motors and masses.

    Raises
    ------
    MachineError
        If the settings cannot be read.
    OptionError
        If the settings are another firmware's, or lack a value that ``answers`` does not give.
    """
    settings = read_settings(source)
    if kind != f"{settings.firmware}-winder":
        raise OptionError(
            f"{Place(str(source))} has the settings of {settings.firmware}, not of "
            f"{kind.removesuffix('-winder')}",
            remedy=f"Make it with: threadline new {settings.firmware}-winder.",
        )
    for unheeded in settings.unheeded:
        warning(unheeded)
    said = parse_answers(answers)
    text = machine_text(settings, said, kind, limits_only=limits_only)
    _check(text)
    head = f"# From the settings of {settings.firmware}, by Threadline {__version__}.\n#\n"
    projects = resources.files("threadline.cli") / "projects"
    own = projects / ("limits" if limits_only else "firmware")
    if limits_only:
        specification = (own / "spec.toml").read_text(encoding="utf-8")
    else:
        theirs = library_file(_SPEC).with_suffix(".spec.toml")
        specification = theirs.read_text(encoding="utf-8")
    readme = (own / "README.md").read_text(encoding="utf-8")
    return {
        "machine.toml": (head + text).encode(),
        "spec.toml": specification.replace(f'"{_SPEC}"', f'"{kind}"').encode(),
        "README.md": readme.replace("TARGET", settings.firmware).encode(),
        "there-and-back.gcode": _job(settings, said.rotary).encode(),
    }


def _check(text: str) -> None:
    """Refuse a machine file that cannot be read or used, before anything is written."""
    with tempfile.TemporaryDirectory(prefix="threadline-") as folder:
        file = Path(folder) / "machine.toml"
        file.write_text(text, encoding="utf-8")
        load_machine(file)


def _job(settings: Settings, rotary: str) -> str:
    """Return a short job: one axis there and back, at a feed that the machine has."""
    straight = [axis for axis in settings.axes if axis not in rotary]
    axis = (straight or list(settings.axes))[0]
    said = settings.axes[axis]
    way = _WAY_MM if said.travel is None else min(_WAY_MM, said.travel.value / 2.0)
    feed = _FEED_MM_MIN if said.rate is None else min(_FEED_MM_MIN, said.rate.value / 2.0)
    lines = ["; There and back", "G21", "G90", f"G1 {axis}{way:g} F{feed:g}", f"G1 {axis}0"]
    return "\n".join(lines) + "\n"

"""The machine file of tuned loops, based on the machine before."""

from __future__ import annotations

from pathlib import Path

from threadline.base.wording import ascii_only, toml_string
from threadline.dynamics.loop_design import CONTROLLERS, NAMES, NUMBERS, ControllerKind
from threadline.errors import OptionError
from threadline.files.formats.common import atomic_file
from threadline.identify.machine_file import base_lines
from threadline.search.tuning import Rule, Tuning


def tuned_toml(tuning: Tuning, kind: ControllerKind, rule: Rule, folder: Path) -> str:
    """Return the text of a machine file with one kind of controller, to lie in ``folder``.

    Raises
    ------
    OptionError
        If an axis has no such controller.
    """
    machine = tuning.machine
    lines = [
        f"# Tuned by threadline tune: {NAMES[kind]}, {rule}.",
        *base_lines(machine, folder),
        f"name = {toml_string(machine.name.split('+')[0] + '-tuned')}",
        f"title = {toml_string(ascii_only(machine.title) + ', tuned')}",
    ]
    for axis in tuning.axes:
        one = axis.loop(kind, rule)
        name = machine.axes[axis.axis].controller
        own = machine.controllers[name].kind
        lines += ["", f"[controllers.{name}]", f"kind = {toml_string(kind)}"]
        for key in NUMBERS[kind]:
            unit = "" if key in {"zero", "pole"} else " dac/count"
            lines.append(
                f'{key} = "{one.gains[key]:.6g}{unit} exact, checked: threadline tune, {rule}"'
            )
        left = {k for one in CONTROLLERS if one == own for k in NUMBERS[one]} - {*NUMBERS[kind]}
        lines += [f'{key} = "none"' for key in sorted(left)]
    return "\n".join(lines) + "\n"


def write_tuned(tuning: Tuning, kind: ControllerKind, rule: Rule, file: Path) -> None:
    """Write a machine file with one kind of controller; nothing is left if that fails.

    Raises
    ------
    OptionError
        If an axis has no such controller, or one that is unstable.
    RecordingError
        If the file cannot be written.
    """
    for axis in tuning.axes:
        if not axis.loop(kind, rule).figures.stable:
            raise OptionError(
                f"axis {axis.axis}: {NAMES[kind]} by {rule} is unstable",
                remedy="Choose another --controller or --rule.",
            )
    text = tuned_toml(tuning, kind, rule, file.parent)
    with atomic_file(file) as stream:
        stream.write(text.encode())

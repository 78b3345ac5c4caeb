"""A design as files: a machine file based on the redesigned machine, and its specification."""

from __future__ import annotations

import os
from pathlib import Path

from threadline.base.wording import ascii_only, toml_string
from threadline.base.writing import together
from threadline.files.formats.common import atomic_file
from threadline.machine import Machine
from threadline.machine.load import split_reference
from threadline.machine.numbers import number_at, number_tables
from threadline.machine.quantity import Quantity
from threadline.search.design import DesignResult
from threadline.search.design_proof import ProvedDesign
from threadline.verdict import Spec
from threadline.verdict.registry import MEASURES

_SPEC_SUFFIX = ".spec.toml"


def spec_file(machine_file: Path) -> Path:
    """Return the path of the specification that belongs to a machine file: beside the file."""
    return machine_file.with_suffix(_SPEC_SUFFIX)


def write_design(result: DesignResult, found: ProvedDesign, file: Path) -> list[Path]:
    """Write the machine file, and beside it the specification with the needle delay.

    Parameters
    ----------
    file
        Path of the machine file, ending in ``.toml``; the specification ends in ``.spec.toml``.

    Raises
    ------
    RecordingError
        If a file cannot be written.
    """
    texts = {
        file: machine_toml(result, found, file.parent),
        spec_file(file): spec_toml(found.spec, found.machine),
    }
    with together():
        for path, text in texts.items():
            with atomic_file(path) as stream:
                stream.write(text.encode())
    return list(texts)


def machine_toml(result: DesignResult, found: ProvedDesign, folder: Path) -> str:
    """Return the machine file of a design, based on the redesigned machine."""
    machine = result.machine
    texts = {
        path: quantity_text(number_at(machine, path), value)
        for path, value in found.numbers.items()
    }
    level = f" ({found.verdict.level})"
    if found.corners is not None:
        level += " and at the corners of the tolerances of [design]"
    lines = [
        f"# Found by threadline design for {ascii_only(result.job.name)}: in specification{level}.",
        f"# Cost {found.candidate.cost:.4g}: the sum of weight x |ln factor|.",
        f"base = {toml_string(_base(machine, folder))}",
        f"name = {toml_string(machine.name.split('+')[0] + '-redesigned')}",
        f"title = {toml_string(machine.title + ', redesigned')}",
        'design = "none"',
        *number_tables(texts),
    ]
    return "\n".join(lines) + "\n"


def quantity_text(old: Quantity, value: float) -> str:
    """Return a number as text of a machine file, with the old number's share of tolerance."""
    spread = "exact"
    if old.tolerance_si and old.si:
        spread = f"+- {100.0 * abs(old.tolerance_si / old.si):.6g} %"
    written = f"{value!r} {old.unit}".strip()
    before = f"{old.si:.6g} {old.unit}".strip()
    return f"{written} {spread}, assumed: redesigned, from {before}"


def _base(machine: Machine, folder: Path) -> str:
    """Return the reference to the base machine as seen from another folder."""
    name, overlays = split_reference(machine.reference)
    if not name.endswith(".toml"):
        return machine.reference
    return "+".join([os.path.relpath(Path(name).resolve(), folder.resolve()), *overlays])


def spec_toml(spec: Spec, machine: Machine) -> str:
    """Return a specification as text of its file."""
    lines = [f"name = {toml_string(spec.name)}", f'lag = "{spec.lag_s!r} s"']
    given = {(c.name, c.axis) for c in spec.criteria if not c.hard}
    for criterion in spec.criteria:
        if criterion.hard and (criterion.name, criterion.axis) in given:
            continue  # the machine's own, narrower limit holds without being named
        kind = MEASURES[criterion.name]
        lines += ["", "[[criteria]]", f"name = {toml_string(criterion.name)}"]
        if criterion.axis:
            lines.append(f"axis = {toml_string(criterion.axis)}")
        if criterion.hard:
            lines.append('limit = "machine"')
        elif criterion.limit is not None:
            unit = kind.unit("rotary" if criterion.axis in machine.rotary else "linear")
            limit = f"{criterion.limit!r} {unit}"
            if not unit and criterion.limit > 1.0:  # more than 100 %: readable only with its unit
                limit = f"{100.0 * criterion.limit!r} %"
            lines.append(f"limit = {toml_string(limit.strip())}")
        if criterion.required:
            lines.append("required = true")
        for key, value in criterion.options.items():
            lines.append(f"{key} = {toml_string(f'{value!r} {kind.options[key].unit}'.strip())}")
    return "\n".join(lines) + "\n"

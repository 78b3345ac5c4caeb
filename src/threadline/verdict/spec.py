"""Read specification files strictly: errors name the line, and the nearest valid key."""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, NoReturn

from threadline.base.reading import note_input, read_text
from threadline.base.wording import line_in_rows, nearest, toml_fault
from threadline.errors import Place, SpecError, UnitError
from threadline.machine import Machine
from threadline.machine.load import split_reference
from threadline.units import USUAL, parse_quantity, same_dimension, split_quantity
from threadline.verdict.demands import always_of
from threadline.verdict.measure import MeasureKind, Option
from threadline.verdict.registry import MEASURES
from threadline.verdict.types import Criterion, Spec

_MOST_BASES = 20
_MAX_BYTES = 1_000_000
TOP_KEYS = ("name", "lag", "criteria")
COMMON_KEYS = ("name", "axis", "limit", "required")
"""Keys of a specification, and of each of its criteria."""
_OWN = "machine"  # stands for the machine's own limit
_LOOSER = "the machine's own limit, which the specification cannot widen"
_ROUNDING = 1e-12  # relative: a limit this close to the machine's limit equals it
_LAG_S = 0.1
_FEWEST = 2  # recordings for a spread
_MOST_LAG_S = 3600.0
_LIMITS_NAME = "the limits of the machine file, which has no specification beside it"
_ASSUMED_NAME = "0.5 mm off the path, assumed, and the limits of the machine file: no specification"
_LIMITS_ONLY_SPEC = f"""
name = "{_LIMITS_NAME}"
[[criteria]]
name = "path_deviation"
"""
_ASSUMED = f"""
name = "{_ASSUMED_NAME}"
[[criteria]]
name = "contour_error"
limit = "0.5 mm"
[[criteria]]
name = "path_deviation"
"""
_ITS_LIMITS = f'name = "{_LIMITS_NAME}"\n'
_ASSUMED_OF = {"ticks": _ASSUMED, "switches": _ITS_LIMITS, "steps": _ITS_LIMITS}


def is_assumed(spec: Spec) -> bool:
    """Return whether a specification stands in for a missing file; the verdict then says so."""
    return spec.name in (_LIMITS_NAME, _ASSUMED_NAME)


def load_spec(reference: str | Path | None, machine: Machine) -> Spec:
    """Read a specification, or the default one of ``machine``.

    The criteria of ``always_of`` are added for every axis for which the file does not mention them.
    For an axis with a path these are travel, velocity, acceleration and jerk with the machine's
    limits, path deviation, tracking error, and DAC saturation or (driven by pulses) lost steps. For
    an on/off machine these are the vibration of its frame at each step, the cycle time, and the
    limits of its valves. For an embroidery machine these are the residual of the stitches and the
    limits of its step tables and servos. A wider limit in the file does not replace the machine's
    own limit.

    Parameters
    ----------
    reference
        A file; None for the default: the file ``NAME.spec.toml`` or ``spec.toml`` in the folder of
        a machine file ``NAME.toml``, else the library's specification for the machine or its base
        machine. Without any file the machine's own limits are the criteria; with axes that have
        dynamics also 0.5 mm of contour error. The name of the specification says so.
    machine
        The machine with its axes, units and limits.

    Raises
    ------
    SpecError
        If the file cannot be read or does not describe a specification of this machine.
    """
    text, file = _default(machine) if reference is None else (_read(Path(reference)), reference)
    reader = _Reader(text, str(file), machine)
    return replace(reader.spec(), file="" if reference is None else str(reference))


def _default(machine: Machine) -> tuple[str, str]:
    """Return the default specification; without its own, a machine uses its base's."""
    name = machine.name.split("+")[0]
    reference, _ = split_reference(machine.reference)
    own = Path(reference)
    library = resources.files("threadline.machine") / "library"
    file, base = (own if own.suffix == ".toml" else None), name
    for _ in range(_MOST_BASES):
        if file is not None:
            for beside in (file.with_suffix(".spec.toml"), file.with_name("spec.toml")):
                if beside.is_file():
                    return _read(beside), str(beside)
        known = re.fullmatch(r"[A-Za-z0-9_-]+", base) is not None
        if known and (entry := library / f"{base}.spec.toml").is_file():
            note_input(Path(str(entry)))
            return entry.read_text(encoding="utf-8"), f"{base}.spec.toml"
        if file is not None:
            content = _read(file)
        elif known and (entry := library / f"{base}.toml").is_file():
            content = entry.read_text(encoding="utf-8")
        else:
            break
        base, _ = split_reference(str(tomllib.loads(content).get("base", "")))
        here = Path() if file is None else file.parent
        file = here / base if base.endswith(".toml") else None
    if machine.without_dynamics:
        return _LIMITS_ONLY_SPEC, ""
    return _ASSUMED_OF[machine.commanded_by], ""


def _read(path: Path) -> str:
    return read_text(path, _MAX_BYTES, SpecError, "specification file")


class _Reader:
    """Reads one specification file, and knows the line of each entry."""

    def __init__(self, text: str, file: str, machine: Machine) -> None:
        self._text, self._file, self._machine = text, file, machine
        self._always = always_of(machine)

    def spec(self) -> Spec:
        try:
            content = tomllib.loads(self._text)
        except (tomllib.TOMLDecodeError, RecursionError) as error:
            what, line = toml_fault(error, self._text)
            raise SpecError(
                what, place=Place(self._file, line), remedy="Correct that line."
            ) from error
        self._refuse_unknown_keys(content, TOP_KEYS, None)
        name = content.get("name")
        if not isinstance(name, str) or not name:
            self._refuse('name must be a text, like name = "winding at 0.5 mm"', None, "name")
        rows = content.get("criteria")
        if rows is None and not self._file:  # the machine's own criteria are all
            rows = []
        elif not isinstance(rows, list) or not rows or not all(isinstance(r, dict) for r in rows):
            self._refuse(
                "there are no criteria", None, "criteria", "Write [[criteria]] tables, one each."
            )
        criteria: dict[tuple[str, str, str], Criterion] = {}
        for index, row in enumerate(rows):
            for criterion in self._criteria(row, index):
                key = criterion.name, criterion.axis, criterion.step
                # A criterion for one axis replaces a criterion for every axis, in any order.
                if key in criteria and criteria[key].every_axis == criterion.every_axis:
                    axis = f" of axis {key[1]}" if key[1] else ""
                    self._refuse(f"{key[0]}{axis} is there twice", index, "name", "Keep one.")
                if key not in criteria or criteria[key].every_axis:
                    criteria[key] = criterion
        beside: list[Criterion] = []
        for criterion in self._unnamed(criteria):
            key = criterion.name, criterion.axis, ""
            if key in criteria and criteria[key].limit is not None:
                beside.append(criterion)
            else:
                criteria[key] = criterion
        lag_s = self._number(content["lag"], "s", None, "lag") if "lag" in content else _LAG_S
        if lag_s > _MOST_LAG_S:
            self._refuse(f"lag = {content['lag']!r} is above {_MOST_LAG_S:g} s", None, "lag")
        return Spec(
            name=name,
            criteria=(*criteria.values(), *beside),
            lag_s=lag_s,
            sha256=hashlib.sha256(self._text.encode()).hexdigest(),
        )

    def _unnamed(self, named: Mapping[tuple[str, str, str], Criterion]) -> list[Criterion]:
        """Return the criteria that apply although the file does not name them, axis by axis.

        These are the criteria that every verdict lists, and the machine's own limits. A file can
        narrow these limits but not widen them.
        """
        found = []
        for name in self._always.listed:
            row = {"name": name} | ({"limit": _OWN} if name in self._always.limited else {})
            for criterion in self._criteria(row, None):
                given = named.get((name, criterion.axis, ""))
                if given is None:
                    found.append(criterion)
                elif criterion.limit is None or given.hard:
                    continue
                elif given.limit is None or given.limit > criterion.limit * (1.0 + _ROUNDING):
                    note = "" if given.limit is None else _LOOSER
                    found.append(replace(criterion, required=given.required, note=note))
        return found

    def _criteria(self, row: Mapping[str, Any], index: int | None) -> Iterator[Criterion]:
        name = row.get("name")
        if isinstance(name, str) and name not in MEASURES:
            name = re.sub(r"[ -]+", "_", name.strip())  # as people write it
        if not isinstance(name, str):
            self._refuse("a criterion has no name", index, "name", 'Write name = "contour_error".')
        kind = MEASURES.get(name)
        if kind is None:
            remedy = nearest(name, MEASURES)
            self._refuse(f"there is no measure {name[:80]!r}", index, "name", remedy)
        self._refuse_unknown_keys(row, (*COMMON_KEYS, *kind.options, *self._always.keys), index)
        step = row.get("step", "")
        if not isinstance(step, str):
            self._refuse(f"step must be a name, got {step!r}", index, "step")
        required = row.get("required", False)
        if not isinstance(required, bool):
            self._refuse(f"required must be true or false, got {required!r}", index, "required")
        options = {
            key: self._option(row[key], kind.options[key], index, key)
            for key in kind.options
            if key in row
        }
        wanted = row.get("axis", "")
        for axis in self._axes(kind, wanted, index):
            limit = self._limit(kind, row.get("limit"), axis, index)
            yield Criterion(
                name=name,
                axis=axis,
                limit=limit,
                required=required,
                options=options,
                hard=row.get("limit") == _OWN,
                every_axis=bool(axis) and not wanted,
                step=step,
            )

    def _option(self, text: Any, option: Option, index: int | None, key: str) -> float:
        if option.unit:
            value = self._number(text, option.unit, index, key)
            if option.above_0 and value == 0.0:
                self._refuse(
                    f"{key} = {text!r} measures nothing", index, key, f"Give a longer {key}."
                )
            return value
        whole = re.fullmatch(r"[0-9]{1,9}(\.0*)?", str(text).strip())
        if whole is None or float(text) < _FEWEST:
            self._refuse(
                f"{key} = {text!r} is not a whole number of at least {_FEWEST}",
                index,
                key,
                f"Write it like {key} = {option.default:g}.",
            )
        return float(text)

    def _axes(self, kind: MeasureKind, wanted: Any, index: int | None) -> list[str]:
        names = list(self._machine.moving)
        if not kind.per_axis:
            if wanted:
                self._refuse(f"{kind.name} is measured at the tool, not of an axis", index, "axis")
            return [""]
        if wanted == "":
            endless = [n for n, axis in self._machine.axes.items() if axis.endless]
            return [n for n in names if kind.name != "travel" or n not in endless]
        if wanted not in names:
            self._refuse(
                f"machine {self._machine.name!r} has no axis {str(wanted)[:40]!r}",
                index,
                "axis",
                f"It has {', '.join(names)}.",
            )
        return [wanted]

    def _limit(self, kind: MeasureKind, text: Any, axis: str, index: int | None) -> float | None:
        if text is None:
            return None
        if text == _OWN:
            return self._machine_limit(kind, axis, index)
        axis_kind = "rotary" if axis in self._machine.rotary else "linear"
        unit = kind.unit(axis_kind)
        factor = 1.0
        if axis_kind == "rotary" and kind.dimension.startswith("axis"):
            # A length given for a rotary axis is a length at the tool.
            length = "m" + unit.removeprefix("rad")
            if isinstance(text, str) and _is_of(text, length):
                unit, factor = length, 1.0 / self._machine.acts_at_m(axis)
        value = factor * self._number(text, unit, index, "limit")
        if not unit and value > 1.0 and not _has_unit(text):
            self._refuse(
                f"limit = {text!r} is {100.0 * value:g} %",
                index,
                "limit",
                f'{kind.name} is a share: write limit = "{value:g} %", or a number from 0 to 1.',
            )
        return value

    def _machine_limit(self, kind: MeasureKind, axis: str, index: int | None) -> float | None:
        own = self._always.limited
        if kind.name not in own:
            self._refuse(
                f"the machine has no limit of {kind.name}",
                index,
                "limit",
                f'limit = "machine" is for {", ".join(own)}.',
            )
        return self._always.limit(self._machine, kind.name, axis)

    def _number(self, text: Any, unit: str, index: int | None, key: str) -> float:
        example = (
            f'Write it like {key} = "{ {"m": "0.5 mm", "s": "100 ms"}.get(unit, f"1 {unit}") }".'
        )
        if not unit:
            example = f'Write it like {key} = "5 %".'
        written = text if isinstance(text, str) else repr(text)
        if unit and re.fullmatch(r"[0-9.]+", written.strip()):
            # A number without a unit is probably meant in the usual unit: 0.8 mm, not 0.8 m.
            example = f'Write it like {key} = "{written.strip()} {USUAL.get(unit, unit)}".'
            self._refuse(f"{key} = {text!r} has no unit", index, key, example)
        if not isinstance(text, str):
            if isinstance(text, int | float) and not isinstance(text, bool) and not unit:
                text = repr(text)
            else:
                self._refuse(f"{key} = {text!r} has no unit", index, key, example)
        try:
            value = parse_quantity(re.sub(r"^\s*(?:\+-|\+/-|±)", "", text).strip(), unit)
        except UnitError as error:
            self._refuse(f"{key}: {error.message}", index, key, error.remedy or example)
        if value < 0:
            self._refuse(f"{key} = {text!r} is negative", index, key, "Limits are absolute values.")
        return value

    def _refuse_unknown_keys(
        self, table: Mapping[str, Any], known: tuple[str, ...], index: int | None
    ) -> None:
        for key in table:
            if key not in known:
                self._refuse(f"unknown key {key[:80]!r}", index, key, nearest(key, known))

    def _refuse(self, message: str, index: int | None, key: str, remedy: str = "") -> NoReturn:
        line = line_in_rows(self._text, "criteria", index, key)
        raise SpecError(message, place=Place(self._file, line), remedy=remedy)


def _has_unit(text: Any) -> bool:
    return isinstance(text, str) and re.search(r"[a-zA-Z%]\s*$", text) is not None


def _is_of(text: str, unit: str) -> bool:
    try:
        _, found = split_quantity(re.sub(r"^\s*(?:\+-|\+/-|±)", "", text).strip())
    except UnitError:
        return False
    return bool(found) and same_dimension(found, unit)

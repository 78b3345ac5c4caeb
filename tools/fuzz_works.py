"""A short job on a machine, drawn at random, and the ways to write the same job otherwise.

A ``Work`` is a job before it is written. Each kind of machine has a class that draws a work, writes
it plainly, and has a table of changes that must not matter. The jobs are of a few moves.
"""

from __future__ import annotations

import math
import random
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any, Protocol

from tools.fuzz_rewritten import (
    PRINTERS,
    Move,
    Style,
    in_another_order,
    in_other_units,
    text_of,
)

from threadline.machine import Machine, load_machine
from threadline.machine.firmware import machine_text, parse_answers, read_settings
from threadline.machine.load import library_file
from threadline.machine.motion_planner import RepRapPlanner
from threadline.machine.tool import eye_within

_UNIT = Decimal("0.0254")  # a thousandth of an inch, mm: it has few digits in both units


_WORDS = {"frame", "cylinder", "table", "load"}
"""Names of bodies that are keys of a machine file as well."""


@dataclass(frozen=True)
class Work:
    """A job for a machine before it is written.

    Attributes
    ----------
    machine, text, overlays
        The machine, its file, and its overlays with their plus signs.
    words
        Options of ``tl.prove``.
    drawn
        What the job does, in a form of its kind.
    """

    machine: Machine
    text: str
    overlays: str
    words: Mapping[str, Any]
    drawn: Any


@dataclass(frozen=True)
class Written:
    """A job as it is written, and the machine that it is written for.

    Attributes
    ----------
    file, data
        Name and content of its file.
    names
        Axes and steps of before, by their names now; empty if these are the same.
    moved
        Whether the work lies elsewhere between the counts of the machine.
    free
        Criteria whose values the change may alter.
    signs, by
        For axes of before: -1 if it goes the other way, and how far it lies further, m or rad.
    from_start
        Whether the way to where the work begins is another one. Then the head swings otherwise as
        it begins, and the job is compared as it is read, without the way there.
    machine_text
        Content of a machine file, to be loaded in place of ``machine``.
    switched
        Whether the switchings of a move list are compared, and not what the list says.
    """

    file: str
    data: bytes
    machine: Machine
    words: Mapping[str, Any]
    names: Mapping[str, str] = field(default_factory=dict)
    moved: bool = False
    free: tuple[str, ...] = ()
    signs: Mapping[str, int] = field(default_factory=dict)
    by: Mapping[str, float] = field(default_factory=dict)
    from_start: bool = False
    machine_text: str = ""
    overlays: str = ""
    switched: bool = False


Change = Callable[[random.Random, Work], Written]


class Kind(Protocol):
    """A kind of machine."""

    name: str

    @property
    def changes(self) -> Mapping[str, Change]:
        """The changes, by name."""
        ...

    @property
    def often(self) -> Mapping[str, int]:
        """Changes that only one of so many works allows."""
        ...

    def drawn(self, rng: random.Random, number: int, /) -> Work:
        """Return a work; every so many numbers it is of the same machine."""
        ...

    def plain(self, work: Work) -> Written:
        """Return the work as it is usually written."""
        ...

    def lacks(self, change: str, work: Work, /) -> bool:
        """Return whether a change cannot be made to a work."""
        ...


# --- machine files ---


@cache
def library(name: str) -> tuple[Machine, str, str]:
    """Return a machine of the library, its file, and its overlays with their plus signs.

    Overlays of other names, and what a redesign may change, are left out: reading them takes long.
    """
    base, plus, overlays = name.partition("+")
    text = library_file(base).read_text(encoding="utf-8")
    parts = re.split(r"(?m)^(?=\[)", text)
    wanted = [f"[overlays.{overlay}" for overlay in overlays.split("+") if overlay]
    kept = [
        part
        for part in parts
        if not part.startswith(("[overlays.", "[design.")) or part.startswith(tuple(wanted))
    ]
    return load_machine(name), "".join(kept), plus + overlays


def with_machine_file(
    rng: random.Random, written: Written, work: Work, *changes: Callable[..., str]
) -> Written:
    """Return a job for the same machine, whose file is written otherwise."""
    text = work.text
    for change in changes:
        text = change(rng, text)
    return replace(written, machine_text=text, overlays=work.overlays)


def _other_parts(rng: random.Random, written: Written, work: Work) -> Written:
    """Return a job for the same machine, whose bodies and links have other names.

    What is a key of machine files as well keeps its name.
    """
    text = work.text
    names = sorted(set(re.findall(r"(?m)^\[(?:bodies|links)\.(\w+)\]", text)) - _WORDS)
    parts = {f"part{number}": name for number, name in enumerate(rng.sample(names, len(names)))}
    for part, name in parts.items():
        text = re.sub(rf"\b{name}\b(?=[\],\s=\"}}])", part, text)
    return replace(written, machine_text=text, overlays=work.overlays, names=parts)


def machine_changes(plain: Callable[[Work], Written]) -> dict[str, Change]:
    """Return the changes of a machine file, and of the order of its axes."""

    def order(rng: random.Random, work: Work) -> Written:
        machine = work.machine
        axes, cylinders = (dict(_shuffled(rng, of)) for of in (machine.axes, machine.cylinders))
        ordered = replace(machine, axes=axes, cylinders=cylinders)
        return replace(plain(work), machine=ordered, switched=bool(cylinders))

    return {
        "axes in another order": order,
        "machine in other units": lambda rng, work: with_machine_file(
            rng, plain(work), work, in_other_units
        ),
        "machine file in another order, with comments": lambda rng, work: with_machine_file(
            rng, plain(work), work, in_another_order
        ),
        "parts of the machine renamed": lambda rng, work: _other_parts(rng, plain(work), work),
    }


def _shuffled(rng: random.Random, of: Mapping[str, Any]) -> list[tuple[str, Any]]:
    items = list(of.items())
    order = rng.sample(items, len(items))
    return order if order != items else items[::-1]


# --- part programs ---

_SETTINGS = {
    "grbl": """Grbl 1.1h ['$' for help]
$11=0.010
$100=80.000
$101=80.000
$103=26.667
$110=9000.000
$111=6000.000
$113=36000.000
$120=500.000
$121=400.000
$123=2000.000
$130=400.000
$131=400.000
ok
""",
    "fluidnc": """name: "winder"
axes:
  x:
    steps_per_mm: 80.000
    max_rate_mm_per_min: 9000.000
    acceleration_mm_per_sec2: 500.000
    max_travel_mm: 400.000
  y:
    steps_per_mm: 80.000
    max_rate_mm_per_min: 6000.000
    acceleration_mm_per_sec2: 400.000
    max_travel_mm: 400.000
  a:
    steps_per_mm: 26.667
    max_rate_mm_per_min: 36000.000
    acceleration_mm_per_sec2: 2000.000
    max_travel_mm: 360.000
""",
    "marlin": """echo:; Steps per unit:
echo:  M92 X80.00 Y80.00 A26.67 E500.00
echo:; Max feedrates (units/s):
echo:  M203 X300.00 Y200.00 A400.00 E25.00
echo:; Max Acceleration (units/s2):
echo:  M201 X3000.00 Y2000.00 A1500.00 E10000.00
echo:  M204 P3000.00 R3000.00 T3000.00
echo:  M205 B20000.00 S0.00 T0.00 J0.01
ok
""",
    "klipper": """[stepper_x]
microsteps: 16
rotation_distance: 40
position_min: -200
position_max: 200
[stepper_y]
microsteps: 16
rotation_distance: 40
position_min: -200
position_max: 200
[printer]
kinematics: cartesian
max_velocity: 300
max_accel: 3000
""",
    "reprapfirmware": """; config.g
M584 X0.0 Y0.3 A0.1 E0.2
M350 X16 Y16 A16 E16:16 I1
M92 X80.00 Y80.00 A26.67 E420:420
M566 X900.00 Y600.00 A600.00 E120 P1
M203 X6000.00 Y6000.00 A36000.00 E1200
M201 X500.00 Y400.00 A2000.00 E250
M204 P400 T450
M208 X-200 Y-200 S1
M208 X200 Y200 S0
""",
    "linuxcnc": """[KINS]
JOINTS = 3
KINEMATICS = trivkins coordinates=XYA
[RS274NGC]
RS274NGC_STARTUP_CODE = G21 G40 G90 G94 G64 P0.02 Q0.01
[TRAJ]
COORDINATES = X Y A
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
MAX_LINEAR_VELOCITY = 80
[AXIS_X]
MAX_VELOCITY = 50.0
MAX_ACCELERATION = 750.0
MIN_LIMIT = -200.0
MAX_LIMIT = 200.0
[JOINT_0]
SCALE = -320.0
[AXIS_Y]
MAX_VELOCITY = 100.0
MAX_ACCELERATION = 500.0
MIN_LIMIT = -200
MAX_LIMIT = 200
[JOINT_1]
SCALE = 200
[AXIS_A]
MAX_VELOCITY = 90
MAX_ACCELERATION = 300
MIN_LIMIT = -1e99
MAX_LIMIT = 1e99
[JOINT_2]
TYPE = ANGULAR
SCALE = 88.888
""",
}
FIRMWARES = tuple(_SETTINGS)
_OWNER = (
    "torque=1.26 N m", "current=2.8 A", "resistance=0.9 ohm", "inductance=2.5 mH", "supply=36 V",
    "mass=1.2 kg", "inertia=4e-3 kg m^2", "radius=50 mm", "microsteps=16",
)  # fmt: skip
_MORE = {"marlin": ("travel=400 mm",)}
_NO_INCHES = PRINTERS
_OF_THE_CUT = {
    "auto": ("acceleration", "deceleration", "jerk"),
    "linear": ("velocity", "acceleration", "deceleration", "jerk", "path_use"),
}


@cache
def firmware_machine(firmware: str, folder: Path) -> tuple[Machine, str, str]:
    """Return a machine made from settings of a firmware, and its file."""
    settings = folder / f"{firmware}.settings"
    settings.write_text(_SETTINGS[firmware])
    rotary = "none" if firmware == "klipper" else "A"
    answers = [*_OWNER, f"rotary={rotary}", *_MORE.get(firmware, ())]
    text = machine_text(read_settings(settings, firmware), parse_answers(answers), firmware)
    file = folder / f"{firmware}.toml"
    file.write_text(text)
    return load_machine(file), text, ""


def few_moves(rng: random.Random, axes: str) -> list[Move]:
    """Return two to four moves from 0 of a fraction of a second each."""
    place = dict.fromkeys(axes, Decimal(0))
    found: list[Move] = []
    for _ in range(rng.randint(2, 4)):
        for axis in rng.sample(sorted(place), rng.randint(1, len(place))):
            steps = rng.choice((1, -1)) * 2 * rng.randint(15, 60)
            place[axis] += (-steps if abs(place[axis] + steps * _UNIT) > 6 else steps) * _UNIT
        found.append((bool(found) and rng.random() < 0.15, dict(place), 127 * rng.randint(6, 20)))
    return found


class Programs:
    """Part programs: of the winder, in several dialects, or of machines with a firmware."""

    def __init__(self, name: str, folder: Path) -> None:
        self.name, self._folder = name, folder
        self.often: dict[str, int] = {"inches": 3 if name == "winder" else 6}
        plainly = {
            "inches": Style(inches=True),
            "a move split in two": Style(split=True),
            "a dwell of 0": Style(dwell=True),
            "comments": Style(comments=True),
            "other words for the same moves": Style(words=True, absolute=True),
            "other names: labels, numbers, file": Style(numbers=True),
        }
        self.changes: dict[str, Change] = {
            **{change: self._in_style(style) for change, style in plainly.items()},
            "mirrored": self._mirrored,
            "shifted": self._shifted,
            "axes renamed": self._renamed,
            **machine_changes(self.plain),
        }

    def drawn(self, rng: random.Random, number: int) -> Work:
        """Return moves on a machine: firmwares and dialects take turns."""
        if self.name == "winder":
            machine, text, overlays = library("lathe-winder")
            dialect = ("winder", "linuxcnc", "grbl", "fluidnc", "fanuc")[number % 5]
            way = rng.choice(("auto", "auto", "linear", "parabolic"))
            words = {"dialect": dialect, "interpolation": way}
            axes = rng.choice(("XY", "AX", "AXY"))
        else:
            dialect = FIRMWARES[number % len(FIRMWARES)]
            machine, text, overlays = firmware_machine(dialect, self._folder)
            words = {"dialect": dialect}
            axes = "XY" if dialect == "klipper" else rng.choice(("XY", "AX", "AXY"))
        return Work(machine, text, overlays, words, few_moves(rng, axes))

    def lacks(self, change: str, work: Work) -> bool:
        """Return whether a change cannot be made to a work.

        Printers refuse inches, and lines with numbers want checksums there; F of a move of A alone
        is no length.
        """
        if change == "inches":
            return work.words["dialect"] in _NO_INCHES or "A" in work.drawn[0][1]
        return False

    def plain(self, work: Work) -> Written:
        """Return the moves, relative, in mm."""
        return self._styled(random.Random(0), work, Style())

    def _in_style(self, style: Style) -> Change:
        return lambda rng, work: self._styled(rng, work, style)

    def _styled(
        self, rng: random.Random, work: Work, style: Style, moves: list[Move] | None = None
    ) -> Written:
        dialect = work.words["dialect"]
        numbered = style.numbers and dialect not in PRINTERS
        text = text_of(rng, moves or work.drawn, replace(style, numbers=numbered), dialect)
        file = "job.nc"
        if style.numbers:
            file = f"p{rng.randrange(10**6)}.nc"
            if dialect == "fanuc":
                text = f"O{rng.randint(1, 9999)}\n{text}"
        free = _OF_THE_CUT.get(work.words.get("interpolation", ""), ()) if style.split else ()
        sums = style.split or style.inches or style.absolute  # rounded elsewhere at half a count
        return Written(file, text.encode(), work.machine, work.words, moved=sums, free=free)

    def _mirrored(self, rng: random.Random, work: Work) -> Written:
        axis = rng.choice(sorted(work.drawn[0][1]))
        moves = [(r, {**to, axis: -to[axis]}, feed) for r, to, feed in work.drawn]
        return replace(self._styled(rng, work, Style(), moves), moved=True, signs={axis: -1})

    def _shifted(self, rng: random.Random, work: Work) -> Written:
        axis = rng.choice(sorted(work.drawn[0][1]))
        # By whole counts: a stepper between two of them swings otherwise.
        unit, by = ("deg", rng.choice((-18, 9))) if axis == "A" else ("mm", rng.choice((-20, 12.5)))
        words = {**work.words, "offset": f"{axis}={by} {unit}"}
        si = math.radians(by) if axis == "A" else 1e-3 * by
        return replace(self.plain(work), words=words, moved=True, by={axis: si})

    def _renamed(self, rng: random.Random, work: Work) -> Written:
        machine = work.machine
        letters = dict(zip("XYZ", rng.sample("XYZ", 3), strict=True))
        if isinstance(machine.planner, RepRapPlanner):
            # Its corners tell X and Y from all other axes.
            letters = dict(zip("XYZ", [*rng.sample("XY", 2), "Z"], strict=True))
        new = {n: rng.choice("AB") if n == "A" else letters[n] for n in sorted(machine.axes)}
        inputs = {n: replace(one, axis=new[one.axis]) for n, one in machine.inputs.items()}
        axes = {new[axis]: machine.axes[axis] for axis in rng.sample(sorted(new), len(new))}
        tool = eye_within(machine.tool, set(axes) & {a for a, name in new.items() if a == name})
        planner = machine.planner
        for table in ("jump", "alone"):
            known = getattr(planner, table, None)
            if known and planner is not None:
                table_now: dict[str, Any] = {table: {new[a]: v for a, v in known.items()}}
                planner = replace(planner, **table_now)
        renamed = replace(machine, axes=axes, inputs=inputs, tool=tool, planner=planner)
        moves = [(r, {new[a]: x for a, x in to.items()}, feed) for r, to, feed in work.drawn]
        written = self._styled(rng, work, Style(), moves)
        return replace(written, machine=renamed, names={name: axis for axis, name in new.items()})

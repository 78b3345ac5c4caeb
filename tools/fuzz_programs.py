"""Programs of every dialect for ``fuzz.py``."""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable
from itertools import islice
from pathlib import Path

from tools.fuzz_parametric import fluidnc_program, parametric_program

from threadline.jobs import read_job
from threadline.jobs.gcode.dialects import DIALECTS
from threadline.machine import Machine, load_machine
from threadline.machine.firmware import machine_text, parse_answers, read_settings
from threadline.machine.motion_planner import Programs
from threadline.machine.quantity import parse_machine_quantity
from threadline.machine.radii import with_radii

Mutate = Callable[[random.Random, bytes], bytes]
Target = tuple[str, Callable[[random.Random], bytes], Callable[[Path], object], int]

_WINDER = load_machine("lathe-winder")
_LIKE = {"A": "A", "X": "X", "Y": "Y", "Z": "X", "B": "A", "C": "A"}
MACHINE = dataclasses.replace(
    _WINDER,
    axes={name: _WINDER.axes[like] for name, like in _LIKE.items()},
    inputs={},
    programs=Programs(
        offsets={"G54": {}, "G55": {"X": parse_machine_quantity("9 mm exact, assumed", ("m",))}}
    ),
)

SHORT = dataclasses.replace(
    MACHINE, tick_budget=parse_machine_quantity("2e3 tick exact, assumed", ("tick",))
)
"""Its budget ends a loop that moves and has no end of its own."""


def fuzz_programs(mutate: Mutate) -> dict[str, Target]:
    """Return what makes cases of each dialect, and what reads them."""
    found: dict[str, Target] = {
        f"program-{name}": ("a.nc", _cases(dialect_program, mutate), reader_of(name), 4)
        for name in DIALECTS
    }
    for name, made in (("linuxcnc", parametric_program), ("fluidnc", fluidnc_program)):
        target = ("a.nc", _cases(made, mutate), reader_of(name, SHORT), 4)
        found[f"parametric-{name}"] = target
    found["x-winder"] = ("a.X4G", _cases(x_winder_program, mutate), reader_of("x-winder"), 6)
    found["settings"] = ("settings.txt", _cases(settings_file, mutate), read_machine, 3)
    found["planner"] = ("mine.toml", _cases(planner_file, mutate), read_planner, 3)
    found["radii"] = ("radii.txt", _cases(radii, mutate), read_radii, 3)
    return found


_SETTINGS = (
    b"""\
$100=250.000 (x, step/mm)
$103=26.6
$110=500.000
$113=36000
$120=10
$123=9
$130=2
ok""",
    b"""\
echo:  M92 X80.00 A26.67
echo:  M203 X300.00 A400.00
echo:  M201 X3000.00 A1500.00
ok""",
    b"""\
axes:
  x:
    steps_per_mm: 80.0
    max_rate_mm_per_min: 5000
    max_travel_mm: 9
  a:
    steps_per_mm: 26.667
    acceleration_mm_per_sec2: 200.000
""",
    b"""\
$$
$0=10
$11=0.010
$100=80
$103=26.667
$110=6000
$113=36000
$120=500
$123=2000
$130=900
$133=360
ok
""",
    b"""\
echo:  M92 X80.00 Y80.00 A26.67
echo:  M203 X300.00 Y300.00 A400.00
echo:  M201 X3000 Y3000 A1500
echo:  M204 P500.00 R500.00 T500.00
echo:  M205 B20000.00 S0.00 T0.00 J0.01
echo:  M593 X F12.50 D0.15
ok
""",
    b"""\
M669 K0
M92 X80 Y80 A26.67
M203 X18000 Y18000 A36000
M201 X500 Y500 A2000
M566 X900 Y900 A600 P1
M204 P500 T2000
M208 X0 Y0 S1
M208 X900 Y200 S0
M350 X16 Y16 A16 I1
M593 P"zvd" F40
""",
    b"""\
[stepper_x]
step_pin: PA1
microsteps: 16
rotation_distance: 40
position_min: 0
position_max: 895
[manual_stepper a]
microsteps: 16
rotation_distance: 360
velocity: 50
accel: 500
[input_shaper]
shaper_freq_x: 40
shaper_type: mzv
[printer]
kinematics: cartesian
max_velocity: 300
max_accel: 3000
square_corner_velocity: 5
[gcode_macro WIND]
gcode:
  MANUAL_STEPPER STEPPER=a GCODE_AXIS=A LIMIT_VELOCITY=400 LIMIT_ACCEL=1500
#*# <--- SAVE_CONFIG --->
#*# [input_shaper]
#*# shaper_freq_x = 41
""",
    b"""\
name: w
board: x
axes:
  shared_stepper_disable_pin: NO_PIN
  x:
    steps_per_mm: 80
    max_rate_mm_per_min: 5000
    acceleration_mm_per_sec2: 100
    max_travel_mm: 300
    homing:
      cycle: 1
  a:
    steps_per_mm: 26.667
    max_rate_mm_per_min: 9000
junction_deviation_mm: 0.01
""",
    b"""\
[stepper_x]
microsteps: 16
rotation_distance: 40
position_max: 895
gear_ratio: 60:20
[stepper_a]
microsteps = 16
rotation_distance = 360
[printer]
max_velocity: 300
""",
)  # fmt: skip
_ANSWERS = parse_answers(
    [
        "rotary=A", "torque=1 N m", "current=2 A", "resistance=1 ohm", "inductance=2 mH",
        "supply=36 V", "mass=1 kg", "inertia=4e-3 kg m^2", "radius=50 mm", "microsteps=16",
        "travel=600 mm", "rate=1 m/s", "acceleration=1 m/s^2", "rate.A=9 rad/s",
        "acceleration.A=9 rad/s^2",
    ]
)  # fmt: skip


def settings_file(rng: random.Random, mutate: Mutate) -> bytes:
    """A dump of settings, mutated or with a line doubled."""
    data = rng.choice(_SETTINGS)
    if rng.random() < 0.2:
        lines = data.split(b"\n")
        lines.insert(rng.randrange(len(lines)), rng.choice(lines))
        return b"\n".join(lines)
    return mutate(rng, data)


_BASE = """name = "base"
title = "base"
sources = ["assumed"]
tick_budget = "1e9 tick exact, assumed"
tool.radius = "50 mm exact, assumed"
[clocks]
pulse = "1 ms exact, assumed"
[drives]
a = { kind = "kinematic", clock = "pulse" }
x = { kind = "kinematic", clock = "pulse" }
[axes.A]
kind = "rotary"
drive = "a"
counts = "80 count/deg exact, assumed"
velocity = "400 deg/s exact, assumed"
acceleration = "3000 deg/s^2 exact, assumed"
endless = true
[axes.X]
kind = "linear"
drive = "x"
counts = "80 count/mm exact, assumed"
velocity = "100 mm/s exact, assumed"
acceleration = "3 m/s^2 exact, assumed"
travel = ["0 mm exact, assumed", "1 m exact, assumed"]
"""
_MACHINE = """base = "base.toml"
name = "mine"
[axes.A.profile]
along = "X"
at = ["0 mm exact, measured", "100 mm +- 1 mm, measured"]
radius = ["10 mm exact, measured", "50 mm exact, measured"]
[programs]
dialect = "grbl"
feed_mode = "grbl"
[planner]
"""
_PLANNERS = (
    """\
kind = "grbl"
junction_deviation = "0.01 mm exact, printed"
blocks = "16 exact, printed"
""",
    """\
kind = "marlin"
junction_deviation = "0.013 mm exact, printed"
acceleration = "500 mm/s^2 exact, printed"
""",
    """\
kind = "marlin"
jump = { X = "10 mm/s exact, printed", A = "9 deg/s exact, printed" }
""",
    """\
kind = "klipper"
velocity = "300 mm/s exact, printed"
acceleration = "3 m/s^2 exact, printed"
square_corner_velocity = "5 mm/s exact, printed"
minimum_cruise_ratio = "0.5 exact, printed"
""",
    """\
kind = "reprapfirmware"
jump = { X = "15 mm/s exact, printed" }
policy = "1 exact, printed"
""",
)


def planner_file(rng: random.Random, mutate: Mutate) -> bytes:
    """A machine file with a planner, a profile and rules, of which a line or some bytes change."""
    lines = (_MACHINE + rng.choice(_PLANNERS)).split("\n")
    at = rng.randrange(2, len(lines))
    kind = rng.randrange(4)
    if kind == 0:
        return mutate(rng, "\n".join(lines).encode())
    if kind == 1:
        lines.insert(rng.randrange(2, len(lines)), lines[at])
    elif kind == 2:
        del lines[at]
    else:
        data = mutate(rng, lines[at].encode())
        lines[at] = data.decode("utf-8", "surrogateescape")
    return "\n".join(lines).encode("utf-8", "surrogateescape")


_RADII = (
    b"A=40 mm, B=2 mm", b"A=20 mm at X 0 mm; 50 mm at X 100 mm", b"A=mandrel.csv",
    b"A=0.1 in at Y -1 mm; 3 mm at Y 1 in; 2 cm at Y 1 m, B = 4 mm",
)  # fmt: skip


def radii(rng: random.Random, mutate: Mutate) -> bytes:
    """What is written behind --radius."""
    return mutate(rng, rng.choice(_RADII))


def read_radii(path: Path) -> object:
    """Read a text of --radius."""
    text = path.read_bytes().decode("utf-8", "replace")
    return with_radii(MACHINE, text)


def read_planner(path: Path) -> object:
    """Read a machine file that changes a small one, which is read in no time."""
    base = path.with_name("base.toml")
    if not base.exists():
        base.write_text(_BASE, encoding="utf-8")
    return load_machine(path)


def read_machine(path: Path) -> object:
    """Read settings, and the machine file that is made from them."""
    made = path.with_suffix(".toml")
    made.write_text(machine_text(read_settings(path), _ANSWERS, "mine"), encoding="utf-8")
    return load_machine(made)


def _cases(
    make: Callable[[random.Random, Mutate], bytes], mutate: Mutate
) -> Callable[[random.Random], bytes]:
    return lambda rng: make(rng, mutate)


_WORDS = (
    "G0 X1 F60", "G1 X{n} Y{n} F{n}", "G2 X{n} Y{n} I{n} J{n}", "G3 X{n} Y{n} R{n}", "G17", "G18",
    "G19", "G20", "G21", "G90", "G91", "G92 X{n} A{n}", "G92.1", "G92.2", "G92.3", "G28 X Y",
    "G28", "G28.1", "G80", "G4 P{n}", "G5 X{n} Y{n} I{n} J{n} P{n} Q{n}", "M3 S{n}", "M5", "M8",
    "M104 S{n}", "M117 what {n}", "M400", "T1 M6", "G40 G49 G54", "X{n}", "A{n}", "G93", "G94",
    "M98 P2 L3", "O2", "M99", "M30", "G1 X5 F60*{n}", "G53 X{n}", "(a {n})",
    "G54", "G55", "G56", "G54 G55", "G55 G1 X{n} F60", "G91 G53 G0 X{n}", "M2", "M62 P{n}", "M65",
    "G41 D1", "#1 = {n}", "X[#1 + {n}]", "; b {n}",
)  # fmt: skip


def dialect_program(rng: random.Random, mutate: Mutate) -> bytes:
    """Words of every dialect, with numbers of every size, sometimes mutated."""
    lines = ["G21", "G90", "G1 X1. Y1. F100."]
    good = rng.sample(_WORDS, 6)
    for _ in range(rng.randint(1, 12)):
        odd = rng.choice(("0", "1e3", "", "999999999", "-0.001"))
        number = odd if rng.random() < 0.05 else rng.choice(("1.", "-2.5", "30.", "0.5", "2."))
        lines.append(rng.choice(good).replace("{n}", number))
    data = "\n".join([*lines, "M30"]).encode()
    return mutate(rng, data) if rng.random() < 0.4 else data


_X_WINDER = (
    "M4 S{n}", "M5", "G1 F{n} Z{n} B{n} R5", "G1 Z{n}", "G4 C{n} R1 B0", "G4 L601 C{n}", "M601",
    "G4 P{n}", "M0", "G20", "G21", "G1 F1 Z{n} S{n} C{n} A9", "D0 ST=a [b]", "G51 Z1 Z{n}", "[x]",
)  # fmt: skip


def x_winder_program(rng: random.Random, mutate: Mutate) -> bytes:
    """Lines of X-Winder Designer, sometimes mutated behind the first."""
    lines = ["M4 S9", "G1 F1 Z8.00"]
    for _ in range(rng.randint(1, 12)):
        number = rng.choice(("0", "1", "-2.5", "30.", "", "999999999", "-0.001", "0.5", "360"))
        lines.append(rng.choice(_X_WINDER).replace("{n}", number))
    data = "\n".join(lines).encode()
    data = mutate(rng, data) if rng.random() < 0.4 else data
    return b"[G-CODE GENERATED BY X-WINDER DESIGNER]\n" + data


def reader_of(dialect: str, machine: Machine = MACHINE) -> Callable[[Path], object]:
    """Return a reader of programs in a dialect, that follows what it reads for a while."""

    def read(path: Path) -> object:
        return list(islice(read_job(path, machine, dialect=dialect), 20_000))

    return read

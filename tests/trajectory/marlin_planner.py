"""Marlin's own planner: what its ``planner.cpp``, compiled by itself, makes of moves.

``THREADLINE_MARLIN`` names the folder ``Marlin`` of a checkout of Marlin bugfix-2.1.x, with
``Configuration.h`` and ``src`` in it. ``built`` compiles its ``planner.cpp`` and ``motion.cpp``
with ``marlin_oracle.cpp``, which stands for everything else, by ``c++`` (gcc, of x86-64). The
configuration is the one that the checkout comes with, for X, Y, Z and a turning A without heaters
and extruder; limits and steps are those of each program.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray

CORNERS = {"deviation": (), "jumps": ("CLASSIC_JERK",)}
"""What is defined for each of its rules of corners."""
_CONFIGURED = {
    "MOTHERBOARD": "BOARD_SIMULATED",
    "I_DRIVER_TYPE": "A4988",
    "EXTRUDERS": "0",
    "TEMP_SENSOR_0": "0",
    "TEMP_SENSOR_BED": "0",
    "DEFAULT_AXIS_STEPS_PER_UNIT": "{ 80, 80, 80, 80 }",
    "DEFAULT_MAX_FEEDRATE": "{ 300, 300, 300, 300 }",
    "DEFAULT_MAX_ACCELERATION": "{ 3000, 3000, 3000, 3000 }",
    "DEFAULT_IJERK": "0.3",
    "I_MIN_POS": "0",
    "I_MAX_POS": "50",
    "I_HOME_DIR": "-1",
    "I_ENABLE_ON": "0",
    "INVERT_I_DIR": "false",
    "HOMING_FEEDRATE_MM_M": "{ 3000, 3000, 240, 240 }",
    "HOMING_BUMP_MM": "{ 5, 5, 2, 2 }",
    "HOMING_BUMP_DIVISOR": "{ 2, 2, 4, 4 }",
}
_PINS = {"MIN": 70, "STEP": 71, "DIR": 72, "ENABLE": 73, "CS": -1}
# Its table of arc cosines counts leading zeros, of 0 too, which without lzcnt are any number.
_FLAGS = ("-std=gnu++17", "-O1", "-w", "-fpermissive", "-mlzcnt", "-ffunction-sections")
_HELD = re.compile(r"^[ \t]*(?://)?[ \t]*#define[ \t]+(\w+)\b.*$", re.MULTILINE)


def installed() -> Path | None:
    """Return the folder of Marlin; None where it is not named."""
    named = os.environ.get("THREADLINE_MARLIN")
    return None if named is None else Path(named)


def built(marlin: Path, folder: Path) -> dict[tuple[str, bool], Path]:
    """Return the programs by rule of corners and whether speeds follow S-curves."""
    shutil.copytree(
        marlin / "src", folder / "src", ignore=shutil.ignore_patterns("fontdata", "images", "docs")
    )
    for name in ("Configuration.h", "Configuration_adv.h", "Version.h"):
        text = (marlin / name).read_text(encoding="utf-8")
        (folder / name).write_text(_HELD.sub(_configured, text), encoding="utf-8")
    own = Path(__file__).with_name("marlin_oracle.cpp")
    sources = [own, *(folder / "src/module" / name for name in ("planner.cpp", "motion.cpp"))]
    defined = ["__PLAT_LINUX__", "F_CPU=100000000"]
    defined += ["I_ENABLE_ON=0", "INVERT_I_DIR=false"]
    defined += [f"I_{name}_PIN={pin}" for name, pin in _PINS.items()]
    where = [folder, folder / "src/HAL/LINUX/include"]
    made = {}
    for corners, rule in CORNERS.items():
        for curved in (False, True):
            more = [*rule, *(["S_CURVE_ACCELERATION"] if curved else [])]
            made[corners, curved] = folder / f"{corners}-{int(curved)}"
            words = ["c++", *_FLAGS, *(f"-I{path}" for path in where)]
            words += [f"-D{one}" for one in [*defined, *more]]
            words += [*map(str, sources), "-Wl,--gc-sections", "-o", str(made[corners, curved])]
            subprocess.run(words, check=True)
    return made


def _configured(found: re.Match[str]) -> str:
    value = _CONFIGURED.get(found[1])
    return found[0] if value is None else f"#define {found[1]} {value}"


def time_on_marlin(
    program: Path,
    settings: dict[str, FloatArray | float],
    points: FloatArray,
    speed: FloatArray,
) -> float:
    """Return the time in s that moves from 0 through (n, 4) points take at (n,) speeds."""
    words = [f"{name} {' '.join(map(str, np.ravel(value)))}" for name, value in settings.items()]
    moves = [
        " ".join(f"{value:.4f}" for value in (*point, feed))
        for point, feed in zip(points, speed, strict=True)
    ]
    told = subprocess.run(
        [str(program)], input="\n".join([*words, "go", *moves, ""]), capture_output=True,
        text=True, check=True,
    ).stdout  # fmt: skip
    return float(told.rsplit("total ", 1)[1])

"""LinuxCNC's planner on X and Y: arcs in corners, arcs of G2 and G3, and joined moves.

``COUNTED_S`` are servo cycles of 1 ms of LinuxCNC's own planner: its ``tp.c``, ``tc.c``,
``blendmath.c`` and ``spherical_arc.c`` of 2.9.0~pre1, compiled by themselves with the same moves,
on an X of 100 mm/s and 500 mm/s^2 and a Y of 400 mm/s^2.
"""

from __future__ import annotations

import random
import shutil
from dataclasses import fields, replace
from math import cos, pi, sin
from pathlib import Path

import numpy as np
import pytest

from tests.motion.timing.linuxcnc_headless import times_on_linuxcnc
from tests.motion.timing.test_linuxcnc_planner import SQUARE, beginning, plane, planned, planner
from threadline.jobs import read_job
from threadline.machine import Machine
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.path.types import PieceBlock
from threadline.motion.timing.firmware import firmware_blocks
from threadline.motion.timing.firmware import look_ahead as moves_in_hand

__all__ = ["plane"]


def chords() -> str:
    """A circle of 20 mm as 72 chords."""
    steps = [2.0 * pi * i / 72 for i in range(1, 73)]
    lines = [f"X{20 * sin(step):.4f} Y{20 - 20 * cos(step):.4f}" for step in steps]
    return "\n".join(["G1 F3000", *lines]) + "\n"


def walk() -> str:
    """Sixty moves of a few millimetres."""
    rng, lines, x, y = random.Random(3), ["G1 F3000"], 0.0, 0.0
    for _ in range(60):
        x, y = x + rng.uniform(-2, 3), y + rng.uniform(-2, 3)
        lines.append(f"X{x:.3f} Y{y:.3f}")
    return "\n".join(lines) + "\n"


def feeds() -> str:
    """Forty moves of changing feed."""
    rng, lines, x, y = random.Random(5), [], 0.0, 0.0
    for _ in range(40):
        x, y = x + rng.uniform(-4, 6), y + rng.uniform(-4, 6)
        lines.append(f"G1 F{rng.choice([900, 1800, 3600])} X{x:.3f} Y{y:.3f}")
    return "\n".join(lines) + "\n"


def curve() -> str:
    """A curve of 150 moves of 0.6 mm."""
    rng, lines, x, y, way = random.Random(6), ["G1 F3600"], 0.0, 0.0, 0.0
    for _ in range(150):
        way += rng.uniform(-0.3, 0.35)
        x, y = x + 0.6 * cos(way), y + 0.6 * sin(way)
        lines.append(f"X{x:.3f} Y{y:.3f}")
    return "\n".join(lines) + "\n"


ZIGZAG = "G1 F3000\n" + "".join(f"X{10 * i} Y{10 * (i % 2)}\n" for i in range(1, 21))
SLOT = "F3000 G1 X40\nG3 X40 Y20 J10\nG1 X0\nG3 X0 Y0 J-10\nG1 X40\n"
WAVES = "F3000\n" + "".join(f"G{3 - i % 2} X{10 * (i + 1)} Y0 I5\n" for i in range(10))
CORNERS = "F3000 G1 X20\nG3 X40 Y0 I10\nG1 X60\nG2 X60 Y20 J10\nG1 X0 Y0\n"
RAPIDS = "G0 X30 Y10\nG1 F1800 X40 Y20\nX50 Y15\nG0 X20 Y0\nX0 Y0\nG1 X10 Y10\n"
PROGRAMS = {
    "square": SQUARE,
    "chords": chords(),
    "walk": walk(),
    "feeds": feeds(),
    "curve": curve(),
    "zigzag": ZIGZAG,
    "slot": SLOT,
    "waves": WAVES,
    "corners": CORNERS,
    "rapids": RAPIDS,
}
COUNTED_S = {
    ("square", "G64"): 4.634,
    ("square", "G64 P0.02 Q0"): 5.586,
    ("square", "G61"): 5.553,
    ("chords", "G64"): 2.704,
    ("chords", "G64 P0.02 Q0"): 2.704,
    ("chords", "G61"): 9.068,
    ("walk", "G64"): 5.629,
    ("walk", "G64 P0.02 Q0"): 6.879,
    ("walk", "G61"): 8.253,
    ("feeds", "G64"): 6.941,
    ("feeds", "G64 P0.02 Q0"): 8.593,
    ("feeds", "G61"): 9.607,
    ("curve", "G64"): 3.140,
    ("curve", "G64 P0.02 Q0"): 3.236,
    ("curve", "G61"): 10.998,
    ("zigzag", "G64"): 4.682,
    ("zigzag", "G64 P0.02 Q0"): 7.559,
    ("zigzag", "G61"): 7.640,
    ("slot", "G64"): 3.807,
    ("slot", "G64 P0.02 Q0"): 3.807,
    ("slot", "G61"): 3.757,
    ("waves", "G64"): 4.088,
    ("waves", "G64 P0.02 Q0"): 4.088,
    ("waves", "G61"): 3.983,
    ("corners", "G64"): 3.775,
    ("corners", "G64 P0.02 Q0"): 4.189,
    ("corners", "G61"): 4.209,
    ("rapids", "G64"): 2.662,
    ("rapids", "G64 P0.02 Q0"): 2.890,
    ("rapids", "G61"): 2.934,
}
LIVE = (
    "G1 F3000 X20\nY20\nX0\n",
    beginning(PROGRAMS["walk"], 16),
    "F3000 G1 X20\nG3 X20 Y20 J10\nG1 X0\n",
    "F3000 G1 X20\nG3 X40 Y0 I10\nG1 X60\n",
)
"""Moves that LinuxCNC runs in real time: lines and arcs, with corners and without."""
JOINED = {
    # Within 0.02 mm of one line, then of another: two moves.
    "G1 F3000 X10\nX20 Y0.01\nX30 Y-0.01\nX40 Y0\nX40.01 Y15\nX40 Y30\n": "X40\nY30\n",
    # A feed of its own, and a rapid move, are moves of their own.
    "G1 F3000 X10\nX20\nF1200 X30\nX40\nG0 X50\nX60\n": "X20\nF1200 X40\nG0 X50\nX60\n",
    # The second and third corner are further than Q from any single line.
    "G1 F3000 X10\nX20 Y0.5\nX30 Y-0.5\nX40\n": "X10\nX20 Y0.5\nX30 Y-0.5\nX40\n",
    # A short arc is two moves if it is within Q of its chord, and these are joined further.
    "G1 F3000 X20\nG3 X20.2 Y0.002 I0.098 J4.9\nG1 X40 Y0.402\n": "X20.2 Y0.002\nX40 Y0.402\n",
}


@pytest.mark.parametrize(("name", "words"), COUNTED_S)
def test_plane_programs_take_the_time_that_linuxcnc_takes(
    tmp_path: Path, plane: Machine, name: str, words: str
) -> None:
    """It agrees to a few cycles."""
    found = planned(tmp_path, plane, PROGRAMS[name], words).duration_s
    assert found == pytest.approx(COUNTED_S[name, words], rel=1e-3)


@pytest.mark.waits
@pytest.mark.linuxcnc
def test_linuxcnc_itself_takes_that_time_on_x_and_y(tmp_path: Path, plane: Machine) -> None:
    """The bar is 1 %; P alone joins moves, too."""
    if shutil.which("linuxcnc") is None:
        pytest.skip("linuxcnc (Debian's linuxcnc-uspace) is not installed")
    asked = {
        f"{k}-{n}": (moves, words)
        for k, words in enumerate(("G64", "G64 P0.02", "G61"))
        for n, moves in enumerate(LIVE)
    }
    asked["joined"] = (PROGRAMS["curve"], "G64 P0.05 Q0.2")
    programs = {key: f"{words}\n{moves}" for key, (moves, words) in asked.items()}
    took = times_on_linuxcnc(programs, plane, tmp_path)
    for key, (moves, words) in asked.items():
        found = planned(tmp_path, plane, moves, words).duration_s
        assert found == pytest.approx(took[key], rel=0.01), key


@pytest.mark.parametrize("program", JOINED)
def test_moves_within_q_become_one(tmp_path: Path, plane: Machine, program: str) -> None:
    """As its documents say of Q; P alone is Q, too."""
    joined = f"G1 F3000 {JOINED[program]}"
    for words in ("G64 P0.02", "G64 P0.5 Q0.02"):
        q = words.split("Q")[0].strip() + " Q0"
        found = planned(tmp_path, plane, program, words).duration_s
        assert found == pytest.approx(planned(tmp_path, plane, joined, q).duration_s, rel=1e-9)


def test_at_most_101_moves_become_one(tmp_path: Path, plane: Machine) -> None:
    program = "G1 F3000\n" + "".join(f"X{0.3 * i:.1f}\n" for i in range(1, 151))
    (block,) = planned(tmp_path, plane, program, "G64 P0.02")
    assert np.unique(block.operation).tolist() == [100, 149]


def test_lines_and_arcs_go_into_each_other(tmp_path: Path, plane: Machine) -> None:
    """Places are continuous, speeds except for a tenth of a cycle's acceleration; limits hold."""
    for name in ("corners", "walk", "slot"):
        (block,) = planned(tmp_path, plane, PROGRAMS[name], "G64 P0.05 Q0")
        c, lasts = block.coefficients, block.duration_s[:, None]
        assert np.abs(c[:-1].sum(axis=1) - c[1:, 0]).max() < 1e-12
        leaves = (c[:, 1] + 2.0 * c[:, 2] + 3.0 * c[:, 3]) / lasts
        limits = np.array([plane.axes[axis].acceleration.si for axis in plane.axis_names])
        jumps = np.abs(leaves[:-1] - (c[:, 1] / lasts)[1:])
        assert (jumps <= 0.1 * 1e-3 * limits).all()
        for rate in (2.0 * c[:, 2], 2.0 * c[:, 2] + 6.0 * c[:, 3]):
            assert (np.abs(rate) / lasts**2 <= 1.005 * limits).all()


def test_corners_are_left_by_p_at_most(tmp_path: Path, plane: Machine) -> None:
    """An arc passes a corner of 90 degrees within P of it."""
    for p_mm in (0.5, 0.02):
        motion = planned(tmp_path, plane, "G1 F3000 X40\nY40\n", f"G64 P{p_mm} Q0")
        places = motion(np.linspace(0.0, motion.duration_s, 20_001)) * 1e3
        off = np.hypot(places[:, 0] - 40.0, places[:, 1]).min()
        assert 0.99 * p_mm < off <= 1.01 * p_mm  # between samples


def test_an_arc_is_run_along_its_circle(tmp_path: Path, plane: Machine) -> None:
    motion = planned(tmp_path, plane, "F3000 G3 X0 Y20 J10\n", "G64")
    places = motion(np.linspace(0.0, motion.duration_s, 20_001)) * 1e3
    assert np.abs(np.hypot(places[:, 0], places[:, 1] - 10.0) - 10.0).max() < 1e-3


def test_plane_moves_in_parts_are_those_of_the_whole(
    tmp_path: Path, plane: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Moves are released once the read ones settle them, and go on from there."""
    path = tmp_path / "job.ngc"
    lines = PROGRAMS["curve"] + PROGRAMS["walk"]
    path.write_text(f"G21 G90 G94\n{SLOT}{lines}G1 X0 Y0\n{SLOT}M2\n")
    words = planner("G64 P0.02")
    machine = replace(plane, planner=words)
    job = read_job(path, machine)
    path_of = plan_path(programmed_path(job, machine), machine, "firmware")
    (whole,) = path_of
    names = [field.name for field in fields(PieceBlock)]
    parts = [
        PieceBlock(**{name: getattr(whole, name)[i : i + 40] for name in names})
        for i in range(0, len(whole), 40)
    ]
    monkeypatch.setattr(moves_in_hand, "AT_ONCE", 3)
    (at_once,) = firmware_blocks(path_of, machine, words)
    again = list(firmware_blocks(replace(path_of, blocks=parts), machine, words))
    assert len(again) > 2
    for name in ("start_s", "duration_s", "coefficients"):
        columns = [getattr(block, name) for block in again]
        if name == "coefficients":
            columns = [
                np.pad(column, ((0, 0), (0, 4 - column.shape[1]), (0, 0))) for column in columns
            ]
        assert np.abs(np.concatenate(columns) - getattr(at_once, name)).max() < 1e-11

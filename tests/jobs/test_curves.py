"""Arcs and splines of dialects: by their definition, and with LinuxCNC as the reference."""

from __future__ import annotations

import itertools
import math
import random
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.jobs.controls_themselves import interpreted
from tests.jobs.in_dialects import millimetres, moves, read
from tests.jobs.made_machines import made_machine
from threadline.errors import JobError
from threadline.jobs import read_job
from threadline.jobs.gcode.curves import TOLERANCE_MM
from threadline.machine import Machine

CHORD_MM = 1.0001 * TOLERANCE_MM


@pytest.fixture(scope="module")
def xyza(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("xyza"), "XYZ", "A")


@pytest.mark.parametrize("dialect", ["linuxcnc", "grbl", "fluidnc", "marlin"])
def test_an_arc_is_a_circle(tmp_path: Path, xyza: Machine, dialect: str) -> None:
    """A full circle of 30 mm: on the circle to rounding, its chords within 2 um, 2 pi r long."""
    job = read(tmp_path, xyza, "G1 X10 F600\nG2 X10 Y0 I30 J0 A360\nM30\n", dialect)
    points = np.array(millimetres(job))
    chords = np.diff(points, axis=0)
    radius = np.hypot(points[:, 0] - 40.0, points[:, 1])
    middle = (points[1:, :2] + points[:-1, :2]) / 2.0

    assert np.abs(radius - 30.0).max() < 1e-8
    assert (30.0 - np.hypot(middle[:, 0] - 40.0, middle[:, 1])).max() <= CHORD_MM
    # A chord is shorter than its arc by its share of 1 - sin(x)/x, x = sqrt(2 * 2 um / 30 mm).
    assert np.hypot(*chords[:, :2].T).sum() == pytest.approx(2 * math.pi * 30.0, rel=3e-5)
    assert points[2, 1] > 0.0  # clockwise from the left end: up
    assert points[:, 3] == pytest.approx(np.linspace(0, 360, len(points)), abs=1e-6)
    assert tuple(points[-1]) == pytest.approx((10.0, 0.0, 0.0, 360.0), abs=1e-12)


def test_a_spline_is_a_bezier_curve(tmp_path: Path, xyza: Machine) -> None:
    """G5 and a G5 that goes on: within 2 um of Bernstein's formula, tangents continuous."""
    text = "G17 G1 X0 F600\nG5 I0 J30 P0 Q-30 X20 Y20\nG5 P-10 Q20 X50 Y0\nM2\n"
    job = read(tmp_path, xyza, text, "linuxcnc")
    by_line = {n: list(g) for n, g in itertools.groupby(moves(job), lambda m: m.source.line)}
    start = np.zeros(2)
    # P Q lead from the end, I J from the start; without I J the negative P Q of the one before.
    for line, control in ((2, [(0, 30), (20, -10)]), (3, [(20, 50), (40, 20)])):
        points = np.array([[1e3 * p for p in m.target[:2]] for m in by_line[line]])
        end = points[-1]
        t = np.linspace(0, 1, 20_001)[:, None]
        a, b = np.array(control, dtype=float)
        curve = (1 - t) ** 3 * start + 3 * t * (1 - t) ** 2 * a + 3 * t**2 * (1 - t) * b
        curve = curve + t**3 * end
        chain = np.vstack([start, points])
        u = np.linspace(0, 1, 50, endpoint=False)[None, :, None]
        on_chords = (chain[:-1, None] * (1 - u) + chain[1:, None] * u).reshape(-1, 2)
        away = [np.hypot(*(curve - p).T).min() for p in on_chords[:: len(on_chords) // 200]]
        assert max(away) <= CHORD_MM + 1e-3 * 50 / 20
        start = end
    assert tuple(start) == pytest.approx((50.0, 0.0))


@pytest.fixture(scope="module")
def rs274() -> str:
    found = shutil.which("rs274")
    if found is None:
        pytest.skip("rs274 (Debian's linuxcnc-uspace) is not installed")
    return found


def random_program(rng: random.Random) -> list[str]:
    """Return moves, arcs in every plane by centre and by radius, shifted zeros, homes."""
    lines = ["G21 G90 G94 G17 G40 G49 G54 G80 S100 M3", "G1 X1 Y2 Z3 A4 F600"]
    at = {"X": 1.0, "Y": 2.0, "Z": 3.0}
    planes = {"G17": "XYIJ", "G18": "ZXKI", "G19": "YZJK"}
    for _ in range(25):
        kind = rng.random()
        if kind < 0.15:
            shift = {name: round(rng.uniform(-5, 5), 3) for name in rng.sample("XYZ", 2)}
            lines.append("G92 " + " ".join(f"{n}{v}" for n, v in shift.items()))
            at |= shift
        elif kind < 0.2:
            lines += [rng.choice(["G92.1", "G92.2", "G92.2\nG92.3"]), "G1 X0 Y0 Z0"]
            at = dict.fromkeys("XYZ", 0.0)
        elif kind < 0.3:
            lines += ["G28.1", "G0 X9", "G28", "G1 X1 Y1 Z1"]
            at = dict.fromkeys("XYZ", 1.0)
        elif kind < 0.5:
            name = rng.choice("XYZ")
            at[name] = round(rng.uniform(-30, 30), 3)
            lines.append(f"G1 {name}{at[name]} A{rng.randint(-90, 90)}")
        else:
            plane = rng.choice(list(planes))
            u, v, i, j = planes[plane]
            radius, begin = rng.uniform(2, 20), rng.uniform(0, 2 * math.pi)
            swept = rng.uniform(0.2, 6.0)
            clockwise = rng.random() < 0.5
            centre = at[u] - radius * math.cos(begin), at[v] - radius * math.sin(begin)
            end = begin + (-swept if clockwise else swept)
            at[u] = round(centre[0] + radius * math.cos(end), 4)
            at[v] = round(centre[1] + radius * math.sin(end), 4)
            words = f"{u}{at[u]} {v}{at[v]}"
            if rng.random() < 0.5:
                other = ({"X", "Y", "Z"} - {u, v}).pop()
                at[other] += 1.0
                words += f" {other}{at[other]:.4f}"
            if rng.random() < 0.7 or swept > 5.0:
                offset = -radius * math.cos(begin), -radius * math.sin(begin)
                words += f" {i}{offset[0]:.5f} {j}{offset[1]:.5f}"
            else:
                words += f" R{radius if swept <= math.pi else -radius:.5f}"
            lines.append(f"{plane} G{2 if clockwise else 3} {words}")
    return [*lines, "M5", "M2"]


@pytest.mark.linuxcnc
@pytest.mark.parametrize("seed", range(12))
def test_linuxcnc_bends_and_shifts_alike(
    rs274: str, tmp_path: Path, xyza: Machine, seed: int
) -> None:
    """Every block ends where LinuxCNC's does, and an arc stays on its circle, in its direction.

    Ends and centres are printed to 4 decimals; offsets add half of the last decimal each.
    """
    program = tmp_path / "a.ngc"
    lines = "\n".join(random_program(random.Random(seed))).split("\n")
    program.write_text("".join(f"N{n} {line}\n" for n, line in enumerate(lines, start=1)))
    output = interpreted(rs274, program)
    job = read_job(program, xyza, dialect="linuxcnc")
    ours = {
        line: [(*(1e3 * p for p in m.target[:3]), math.degrees(m.target[3])) for m in run]
        for line, run in itertools.groupby(moves(job), lambda m: m.source.line)
    }
    plane, offset, at = "XY", np.zeros(4), np.zeros(4)
    ends = {}
    arcs = 0
    calls = re.findall(r" N(\d+)\.* +([A-Z_0-9]+)\(([^()]*)\)", output)
    for label, name, text in calls:
        numbers = [float(n) for n in re.findall(r"[-+]?[0-9]+\.[0-9]+", text)]
        if name == "SELECT_PLANE":
            plane = text[-2:]
        elif name == "SET_G92_OFFSET":
            offset = np.array(numbers[:4])
        elif name in {"STRAIGHT_FEED", "STRAIGHT_TRAVERSE"}:
            at = ends[int(label)] = np.array(numbers[:4]) + offset
        elif name == "ARC_FEED":
            u, v = {"XY": (0, 1), "XZ": (2, 0), "YZ": (1, 2)}[plane]
            centre = np.array(numbers[2:4]) + offset[[u, v]]
            end = np.zeros(4)
            end[[u, v]] = np.array(numbers[:2]) + offset[[u, v]]
            end[3 - u - v], end[3] = numbers[4] + offset[3 - u - v], numbers[5] + offset[3]
            turn = int(re.findall(r",\s*(-?\d+),", text)[0])
            points = np.vstack([at, ours[int(label)]])[:, [u, v]] - centre
            radius = np.hypot(*points.T)
            assert np.abs(radius - radius[0]).max() < 1e-3
            swept = np.diff(np.unwrap(np.arctan2(points[:, 1], points[:, 0])))
            assert (np.sign(swept) == np.sign(turn)).all()
            assert abs(swept.sum()) <= 2 * math.pi + 1e-3
            at = ends[int(label)] = end
            arcs += 1
    assert arcs > 3
    assert ends.keys() == ours.keys()
    for label, end in ends.items():
        assert ours[label][-1] == pytest.approx(tuple(end), abs=3e-4), lines[label - 1]


@pytest.mark.parametrize("dialect", ["grbl", "fluidnc", "marlin", "linuxcnc"])
def test_a_centre_of_0_along_the_third_axis_is_idle_but_for_linuxcnc(
    tmp_path: Path, xyza: Machine, dialect: str
) -> None:
    """FreeCAD writes I J K in every arc. gcode.c of grbl drops K; LinuxCNC reports an error."""
    text = "G1 X0 Z0 F600\nG2 X10 Y0 I5 J0 K{}\n"
    if dialect == "linuxcnc":
        with pytest.raises(JobError, match="K has no use in an arc of X and Y"):
            list(read(tmp_path, xyza, text.format("0.000") + "M2\n", dialect))
        return
    job = read(tmp_path, xyza, text.format("0.000"), dialect)
    assert millimetres(job) == millimetres(
        read(tmp_path, xyza, text.replace(" K{}", ""), dialect, "plain.nc")
    )
    with pytest.raises(JobError, match="K has no use in an arc of X and Y"):
        list(read(tmp_path, xyza, text.format("2"), dialect))


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ("G2 X10 Y0 R4", "no circle of R 4 mm goes through points 10 mm apart"),
        ("G2 X0 Y0 R4", "ends where it begins"),
        ("G2 X10 Y0 I4 J0", "begins 4 mm from its centre and ends 6 mm from it"),
        ("G2 X10 Y0", "has no centre"),
        ("G2 X10 Y0 I5 J0 R5", "an arc has R or a centre"),
        ("G2 X10 Y0 I5 K1", "K has no use in an arc of X and Y"),
        ("G2 X10 Y0 I5 J0 P0.5", "P 0.5 of an arc is its turns"),
        ("G2 X1e9 I5", "exponent"),
        ("G2 X1000000000 I500000000", "chords"),
        ("G5 X10 Y0 P1 Q2", "the first G5 of a curve needs I and J"),
        ("G5 X10 Y0 I1 J1", "G5 needs P and Q"),
        ("G18 G5 X10 I1 J1 P1 Q1", "G5 is a curve of X and Y"),
        ("G1 X5 I3", "I has no use in this block"),
        ("G80\nX5", "axis words without G0 or G1 behind G80, which ends the cycle"),
        ("G92", "G92 names no axis"),
        ("G41 D1", "G41 is compensation of the cutter's radius"),
        ("G43 H1", "G43 is compensation of the tool's length"),
        ("G86 X1 Z1 R1 P0", "G86 is a canned cycle"),
        ("G59.4 X1", "unknown word G59.4"),
    ],
)
def test_block_that_makes_no_curve_is_refused(
    tmp_path: Path, xyza: Machine, block: str, message: str
) -> None:
    with pytest.raises(JobError, match=re.escape(message)) as caught:
        list(read(tmp_path, xyza, f"G1 F600 X0 Z0\n{block}\nM2\n", "linuxcnc"))
    assert caught.value.place is not None and caught.value.place.line in (2, 3)


def test_an_arc_of_an_axis_that_turns_is_refused(tmp_path: Path) -> None:
    machine = made_machine(tmp_path, "X", "Y")
    with pytest.raises(JobError, match="G2 bends the axis Y, which turns"):
        list(read(tmp_path, machine, "G1 F600 X0\nG2 X10 Y0 I5\nM2\n", "linuxcnc"))

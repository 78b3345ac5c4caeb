"""Dialects: what words do by the documents of their controllers, and LinuxCNC as an oracle."""

from __future__ import annotations

import itertools
import math
import random
import re
import shutil
import subprocess
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from tests.jobs.made_machines import made_machine

from threadline.errors import InputError, JobError, OptionError
from threadline.jobs import Dwell, FeedMode, Job, Move, Stop, ToolEvent, read_job
from threadline.jobs.gcode.arcs import TOLERANCE_MM
from threadline.jobs.gcode.plain_reader import PlainReader
from threadline.jobs.programmed_time import programmed_time_s
from threadline.machine import Machine

CHORD_MM = 1.0001 * TOLERANCE_MM


@pytest.fixture(scope="module")
def xyza(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("xyza"), "XYZ", "A")


def read(folder: Path, machine: Machine, text: str, dialect: str | None, name: str = "a.nc") -> Job:
    path = folder / name
    path.write_text(text if text.endswith("\n") else text + "\n")
    return read_job(path, machine, **({} if dialect is None else {"dialect": dialect}))


def moves(job: Job) -> list[Move]:
    return [operation for operation in job if isinstance(operation, Move)]


def millimetres(job: Job) -> list[tuple[float, ...]]:
    """X Y Z in mm and A in degrees behind every move."""
    return [(*(1e3 * p for p in m.target[:3]), math.degrees(m.target[3])) for m in moves(job)]


# --- arcs and splines ----------------------------------------------------------------------------


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
    # P Q lead from the end, I J from the start; without I J minus the P Q of the one before.
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
    """Moves, arcs in every plane by centre and by radius, shifted zeros, homes."""
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
    """Every block ends where LinuxCNC's does, and an arc stays on its circle, its way round.

    Ends and centres are printed to 4 decimals; offsets add another half of the last one each.
    """
    program = tmp_path / "a.ngc"
    lines = "\n".join(random_program(random.Random(seed))).split("\n")
    program.write_text("".join(f"N{n} {line}\n" for n, line in enumerate(lines, start=1)))
    done = subprocess.run(
        [rs274, "-g", program.name], cwd=tmp_path, capture_output=True, text=True, timeout=60,
        check=True,
    )  # fmt: skip
    job = read_job(program, xyza, dialect="linuxcnc")
    ours = {
        line: [(*(1e3 * p for p in m.target[:3]), math.degrees(m.target[3])) for m in run]
        for line, run in itertools.groupby(moves(job), lambda m: m.source.line)
    }
    plane, offset, at = "XY", np.zeros(4), np.zeros(4)
    ends = {}
    arcs = 0
    calls = re.findall(r" N(\d+)\.* +([A-Z_0-9]+)\(([^()]*)\)", done.stdout)
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


@pytest.mark.parametrize(
    ("block", "said"),
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
        ("G1 X5 I3", "I has no use in a block of G1"),
        ("G80\nX5", "axis words before any G0 or G1"),
        ("G92", "G92 names no axis"),
        ("G41 D1", "G41 is compensation of the cutter's radius"),
        ("G43 H1", "G43 is compensation of the tool's length"),
        ("G81 X1 Z1 R1", "G81 is a canned cycle"),
        ("G59.4 X1", "unknown word G59.4"),
    ],
)
def test_what_makes_no_curve_is_refused(
    tmp_path: Path, xyza: Machine, block: str, said: str
) -> None:
    with pytest.raises(JobError, match=re.escape(said)) as caught:
        list(read(tmp_path, xyza, f"G1 F600 X0\n{block}\nM2\n", "linuxcnc"))
    assert caught.value.place is not None and caught.value.place.line in (2, 3)


def test_an_arc_of_an_axis_that_turns_is_refused(tmp_path: Path) -> None:
    machine = made_machine(tmp_path, "X", "Y")
    with pytest.raises(JobError, match="G2 bends the axis Y, which turns"):
        list(read(tmp_path, machine, "G1 F600 X0\nG2 X10 Y0 I5\nM2\n", "linuxcnc"))


# --- preambles, ends, offsets ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dialect", "preamble", "words"),
    [
        ("linuxcnc", "G17 G21 G40 G49 G54 G80 G90 G94 G64 P0.01\nM3 S100\nM8", "G40 G49 G54 S M8"),
        ("grbl", "G17 G21 G40 G49 G54 G80 G90 G94\nM3 S100\nM8\nT1 M6", "G40 G49 G54 S M8 T"),
        ("fluidnc", "G21 G54\nM4 S5 M7", "G54 S M7"),
        ("marlin", "G21\nM17\nM104 S200\nM82\nM117 wind on! X5\nM30", "M17 M104 M82 M117 M30"),
        ("fanuc", "G17 G40 G49 G80 G69 G15 G21\nT1 M6\nS50 M3\nM8", "G40 G49 G69 G15 T S M8"),
    ],
)
def test_preambles_are_named_once(
    tmp_path: Path, xyza: Machine, dialect: str, preamble: str, words: str
) -> None:
    """Each word without effect on motion stands once in one warning; the motion is the same."""
    text = f"{preamble}\nG1 X5. F60\n{preamble}\nG1 X7.\nM5\nM30\n"
    job = read(tmp_path, xyza, text, dialect)
    (said,) = [w for w in job.warnings if "without effect" in w]
    assert [w.split()[0] for w in said.partition("first seen: ")[2].split(", ")] == words.split()
    assert [p[0] for p in millimetres(job)] == [5.0, 7.0]
    with pytest.raises(InputError):  # the printed winder's program has none of them
        list(read(tmp_path, xyza, text, "winder"))


@pytest.mark.parametrize("dialect", ["grbl", "fluidnc", "marlin"])
def test_a_program_ends_with_its_file(tmp_path: Path, xyza: Machine, dialect: str) -> None:
    job = read(tmp_path, xyza, "G1 X5 F60\nG1 X6\n", dialect)
    assert [p[0] for p in millimetres(job)] == [5.0, 6.0]
    assert list(job)[-1] == Stop(True, list(job)[-1].source)
    for other in ("linuxcnc", "fanuc"):
        with pytest.raises(JobError, match="has no end"):
            read(tmp_path, xyza, "G1 X5. F60\nG1 X6.\n", other)


@pytest.mark.parametrize("dialect", ["grbl", "fluidnc"])
def test_a_program_may_end_twice(tmp_path: Path, xyza: Machine, dialect: str) -> None:
    """Laser posts write M5 M2 M2; what moves behind an end is refused, but by grbl."""
    text = "G1 X10 F600\nX20\nM2\n"
    once = millimetres(read(tmp_path, xyza, text, dialect, "once.nc"))
    assert millimetres(read(tmp_path, xyza, text + "M2\n\nM30\n", dialect, "twice.nc")) == once
    for more in ("X30\n", "F500 M2\n") if dialect == "fluidnc" else ():
        with pytest.raises(JobError, match="never run"):
            moves(read(tmp_path, xyza, text + more, dialect, f"more{len(more)}.nc"))
    with pytest.raises(JobError, match="never run"):
        moves(read(tmp_path, xyza, text + "M2\n", "linuxcnc", "linuxcnc.nc"))


def test_a_shifted_zero_in_a_subroutine_moves_on(tmp_path: Path, xyza: Machine) -> None:
    """G92 A0 behind each circuit: pass after pass begins where the last one ended."""
    text = "G1 X0 F60\nM98 P2 L500\nG92.1\nX0 A0\nM30\nO2\nX5 A90\nX0 A360\nG92 A0\nM99\n"
    job = read(tmp_path, xyza, text, "linuxcnc")
    points = millimetres(job)
    assert len(points) == 1 + 1000 + 1
    assert [p[3] for p in points[1:7]] == pytest.approx([90, 360, 450, 720, 810, 1080])
    assert points[-2][3] == pytest.approx(360.0 * 500) and points[-1][3] == 0.0
    # The same folded: three passes stand for all, and what follows begins where they end.
    folded = sum(times for item, times, _ in job.folded() if isinstance(item, Move))
    runs = sum(t * len(i) for i, t, _ in job.folded() if not isinstance(i, Move) and _sized(i))
    assert folded + runs == len(points)
    by_moves = sum(1e3 * abs(a.target[0] - b.target[0]) for a, b in itertools.pairwise(moves(job)))
    assert by_moves == pytest.approx(5000.0)
    assert programmed_time_s(job, xyza) == pytest.approx(_time_one_by_one(job, xyza), rel=1e-12)


def _sized(item: object) -> bool:
    return hasattr(item, "targets")


def _time_one_by_one(job: Job, machine: Machine) -> float:
    at, total = np.zeros(4), 0.0
    for move in moves(job):
        way = np.array(move.target) - at
        length = math.hypot(*way[:3]) or 1e-3 * math.degrees(abs(way[3]))
        total += length / 1e-3
        at = np.array(move.target)
    return total


def test_marlin_goes_at_the_feed_in_g0_too(tmp_path: Path, xyza: Machine) -> None:
    """F 3000 alone on a G0 is the feed of all that follows (Cyclone and FiberPath write it so)."""
    text = "G0 X0 Y0 Z0\nG0 F3000\nG0 X10 Y0\nG0 X10 Y20\nG92 Y0\nG0 Y5\nG1 X0\n"
    job = read(tmp_path, xyza, text, "marlin")
    first, *others = moves(job)
    assert first.target == (0.0,) * 4  # before any feed, and going nowhere
    assert {(m.feed.mode, m.feed.value) for m in others if m.feed} == {(FeedMode.IN_TURN, 0.05)}
    assert millimetres(job)[3][:2] == pytest.approx((10.0, 25.0))
    assert programmed_time_s(job, xyza) == pytest.approx((10 + 20 + 5 + 10) / 50.0)
    with pytest.raises(JobError, match="before any feed"):
        list(read(tmp_path, xyza, "G0 X5\n", "marlin"))
    with pytest.raises(JobError, match="axis words without a G word, which marlin does not take"):
        list(read(tmp_path, xyza, "G1 X5 F60\nX6\n", "marlin"))


def test_a_rapid_says_what_its_f_does(tmp_path: Path, xyza: Machine) -> None:
    for dialect in ("winder", "linuxcnc", "grbl"):
        job = read(tmp_path, xyza, "G0 X5 F100\nG1 X6\nM30\n", dialect)
        assert any("F of a G0 sets the feed of later moves" in w for w in job.warnings)
        first, second = moves(job)
        assert first.feed and second.feed
        assert first.feed.mode is FeedMode.RAPID
        assert second.feed.value == pytest.approx(0.1 / 60)
    assert read(tmp_path, xyza, "G0 X5 F100\n", "marlin").warnings == ()


@pytest.mark.parametrize(
    ("dialect", "block", "seconds"),
    [
        ("linuxcnc", "G4 P1.5", 1.5),
        ("grbl", "G4 P2", 2.0),
        ("marlin", "G4 P500", 0.5),
        ("marlin", "G4 S3", 3.0),
        ("fanuc", "G4 P500", 0.5),
        ("fanuc", "G4 X2.5", 2.5),
        ("fanuc", "G4 U2.", 2.0),
        ("linuxcnc", "P.5 G4", 0.5),
    ],
)
def test_a_dwell_counts_as_its_controller_does(
    tmp_path: Path, xyza: Machine, dialect: str, block: str, seconds: float
) -> None:
    job = read(tmp_path, xyza, f"G1 X1. F60\n{block}\nM30\n", dialect)
    assert [d.duration_s for d in job if isinstance(d, Dwell)] == [pytest.approx(seconds)]


def test_marlin_homes_and_waits(tmp_path: Path, xyza: Machine) -> None:
    """G28 X: home and zero again there; M400 lets the motion end, M109 waits for a temperature."""
    text = "N1 G1 X5 Y5 F60*93\nG92 X100 Y50\nG28 X\nG1 X1 Y51\nM400\nM109 S200\nM3 S9\nM5\n"
    job = read(tmp_path, xyza, text, "marlin")
    assert [p[:2] for p in millimetres(job)] == [(5, 5), (0, 5), (1, pytest.approx(6))]
    assert [d.duration_s for d in job if isinstance(d, Dwell)] == [0.0, 0.0]
    assert [e.value for e in job if isinstance(e, ToolEvent)] == [1.0, 0.0]
    assert any("waits for a temperature" in w for w in job.warnings)


def test_grbl_goes_home_where_g28_1_says(tmp_path: Path, xyza: Machine) -> None:
    job = read(tmp_path, xyza, "G1 X3 Y4 F60\nG28.1\nX9\nG92 X0\nG28 Y9\nG28\nX1\n", "grbl")
    ends = [p[:2] for p in millimetres(job)]
    assert ends == [pytest.approx(p) for p in [(3, 4), (9, 4), (9, 9), (9, 4), (3, 4), (10, 4)]]


def test_fanuc_numbers_need_a_point(tmp_path: Path, xyza: Machine) -> None:
    with pytest.raises(JobError, match="X1000 has no decimal point: by its parameter DPI"):
        read(tmp_path, xyza, "G1 X1000 F60\nM30\n", "fanuc")
    assert millimetres(read(tmp_path, xyza, "G1 X1. Y0 F60\nM30\n", "fanuc"))[0][0] == 1.0


def test_dialects_are_chosen_and_refused(tmp_path: Path, xyza: Machine) -> None:
    with pytest.raises(OptionError, match="there is no dialect 'gbrl'"):
        read(tmp_path, xyza, "G1 X1 F60\nM30\n", "gbrl")
    with pytest.raises(JobError, match=r"unknown word G5\..*The dialect linuxcnc or marlin has it"):
        read(tmp_path, xyza, "G5 X1\nM30\n", "grbl")
    machine = made_machine(tmp_path, "X", "", '[programs]\ndialect = "grbl"\n')
    job = read(tmp_path, machine, "G17\nG1 X1 F60\n", None, "A.TXT")
    assert job.feed_rule == "grbl"
    assert read(tmp_path, machine, "G1 X1 F60\n", "marlin").feed_rule == "marlin"


# --- the kernel ----------------------------------------------------------------------------------

_PIECES = (
    "G1 X{x} Y{y}", "G0 X{x} F{f}", "X{x} A{y}", "G92 X{x}", "G92.1", "G91", "G90", "G20", "G21",
    "G2 X{x} Y{y} R50", "G1 Z{x} F{f}", "G28 X0", "G0 Y{y}", "G80", "G1", "G4 P1", "G28",
)  # fmt: skip


@pytest.mark.parametrize("dialect", ["linuxcnc", "grbl", "marlin", "winder"])
@pytest.mark.parametrize("seed", range(15))
def test_the_kernel_follows_every_dialect(
    tmp_path: Path, xyza: Machine, dialect: str, seed: int
) -> None:
    """The compiled reader and the plain one: the same operations and warnings, or error."""
    rng = random.Random(seed)
    lines = ["G1 X0 F60"]
    for _ in range(40):
        piece = rng.choice(_PIECES[:3] if rng.random() < 0.6 else _PIECES)
        lines.append(
            piece.format(x=rng.randint(-40, 40), y=rng.randint(-40, 40) / 8, f=rng.randint(1, 999))
        )
    text = "\n".join([*lines, "M30"]) + "\n"

    def outcome(plain: bool) -> tuple[object, ...]:
        usual = PlainReader.worth_trying
        done: list[object] = []
        with patch.object(PlainReader, "worth_trying", usual if plain else lambda _: False):
            try:
                job = read(tmp_path, xyza, text, dialect)
                done.extend(job.suspicions(own_feed=True))
                done.extend(job)
            except InputError as error:
                done.append(str(error))
        return tuple(done)

    assert outcome(plain=True) == outcome(plain=False)

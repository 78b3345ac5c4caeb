"""Dialects: the meaning of words by the documents of their controllers."""

from __future__ import annotations

import itertools
import math
import random
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from tests.jobs.in_dialects import millimetres, moves, numbered, read
from tests.jobs.made_machines import made_machine
from threadline.commands.boards import working_words
from threadline.errors import InputError, JobError, OptionError
from threadline.jobs import Dwell, FeedMode, Job, Move, Stop, ToolEvent
from threadline.jobs.feed_times import programmed_time_s
from threadline.jobs.gcode.plain_blocks import PlainReader
from threadline.machine import Machine


@pytest.fixture(scope="module")
def xyza(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("xyza"), "XYZ", "A")


@pytest.mark.parametrize(
    ("dialect", "preamble", "words"),
    [
        ("linuxcnc", "G17 G21 G40 G49 G54 G80 G90 G94 G64 P0.01\nM3 S100\nM8", "G40 G49 G54 S M8"),
        ("linuxcnc", "G54 G64 P0.01 Q0.02\nG64 P0 Q0", "G54"),
        ("grbl", "G17 G21 G40 G49 G54 G80 G90 G94\nM3 S100\nM8\nT1 M6", "G40 G49 G54 S M8 T"),
        ("fluidnc", "G21 G54\nM4 S5 M7", "G54 S M7"),
        ("marlin", "G21\nM17\nM104 S200\nM82\nM117 wind on! X5\nM30", "M17 M104 M82 M117 M30"),
        ("fanuc", "G17 G40 G49 G80 G69 G15 G21\nT1 M6\nS50 M3\nM8", "G40 G49 G69 G15 T S M8"),
    ],
)
def test_preambles_are_named_once(
    tmp_path: Path, xyza: Machine, dialect: str, preamble: str, words: str
) -> None:
    """One warning names each word without effect on motion once; the motion is the same."""
    text = f"{preamble}\nG1 X5. F60\n{preamble}\nG1 X7. F60\nM5\nM30\n"
    job = read(tmp_path, xyza, text, dialect)
    (warning,) = [w for w in job.warnings if "without effect" in w]
    assert [w.split()[0] for w in warning.partition("first seen: ")[2].split(", ")] == words.split()
    silent = dialect == "marlin"
    assert ("compile leaves out words that only show or store: M117 M30." in warning) == silent
    assert [p[0] for p in millimetres(job)] == [5.0, 7.0]
    with pytest.raises(InputError):  # the printed winder's program has none of them
        list(read(tmp_path, xyza, text, "winder"))


def test_g64_of_linuxcnc_is_said_to_be_the_machine_files(tmp_path: Path, xyza: Machine) -> None:
    """The word is LinuxCNC's own, and the plan takes P from the machine file."""
    job = read(tmp_path, xyza, "G64 P0.01\nG1 X5 F60\nM30\n", "linuxcnc")
    (warning,) = [w for w in job.warnings if "G64" in w]
    assert "this G64 does not count" in warning and "tolerance is P of G64" in warning
    assert "other controllers" not in warning


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
    """Laser posts write M5 M2 M2; moves after an end are refused, except by grbl."""
    text = "G1 X10 F600\nX20\nM2\n"
    once = millimetres(read(tmp_path, xyza, text, dialect, "once.nc"))
    assert millimetres(read(tmp_path, xyza, text + "M2\n\nM30\n", dialect, "twice.nc")) == once
    for more in ("X30\n", "F500 M2\n") if dialect == "fluidnc" else ():
        with pytest.raises(JobError, match="never run"):
            moves(read(tmp_path, xyza, text + more, dialect, f"more{len(more)}.nc"))
    with pytest.raises(JobError, match="never run"):
        moves(read(tmp_path, xyza, text + "M2\n", "linuxcnc", "linuxcnc.nc"))


def test_a_shifted_zero_in_a_subroutine_moves_on(tmp_path: Path, xyza: Machine) -> None:
    """G92 A0 after each circuit: pass after pass begins at the end of the last one."""
    text = "G1 X0 F60\nM98 P2 L500\nG92.1\nX0 A0\nM30\nO2\nX5 A90\nX0 A360\nG92 A0\nM99\n"
    job = read(tmp_path, xyza, text, "linuxcnc")
    points = millimetres(job)
    assert len(points) == 1 + 1000 + 1
    assert [p[3] for p in points[1:7]] == pytest.approx([90, 360, 450, 720, 810, 1080])
    assert points[-2][3] == pytest.approx(360.0 * 500) and points[-1][3] == 0.0
    # The same folded: three passes stand for all, and the next move begins at their end.
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
    """F 3000 alone on a G0 is the feed of all later moves (Cyclone and FiberPath write this)."""
    text = "G0 X0 Y0 Z0\nG0 F3000\nG0 X10 Y0\nG0 X10 Y20\nG92 Y0\nG0 Y5\nG1 X0\n"
    job = read(tmp_path, xyza, text, "marlin")
    first, *others = moves(job)
    assert first.target == (0.0,) * 4  # before any feed, and without motion
    assert {(m.feed.mode, m.feed.value) for m in others if m.feed} == {(FeedMode.IN_TURN, 0.05)}
    assert millimetres(job)[3][:2] == pytest.approx((10.0, 25.0))
    assert programmed_time_s(job, xyza) == pytest.approx((10 + 20 + 5 + 10) / 50.0)
    with pytest.raises(JobError, match="before any feed") as caught:
        list(read(tmp_path, xyza, "G0 X5\n", "marlin"))
    assert "Marlin takes 1500 or 4000, by its version" in caught.value.remedy
    with pytest.raises(JobError, match="because it does not begin with a command"):
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
    """G28 X: home, which becomes zero; M400 lets the motion end, M109 waits for a temperature."""
    first = numbered(1, "G1 X5 Y5 F60")
    text = f"{first}\nG92 X100 Y50\nG28 X\nG1 X1 Y51\nM400\nM109 S200\nM3 S9\nM5\n"
    job = read(tmp_path, xyza, text, "marlin")
    assert [p[:2] for p in millimetres(job)] == [(5, 5), (0, 5), (1, pytest.approx(6))]
    assert [d.duration_s for d in job if isinstance(d, Dwell)] == [0.0]
    worked = [(e.words, e.value) for e in job if isinstance(e, ToolEvent)]
    assert worked == [("G28 X", 0.0), ("M109 S200", 200.0), ("M3 S9", 9.0), ("M5", 0.0)]
    assert any("waits for a temperature" in w for w in job.warnings)


def test_marlin_has_one_tool(tmp_path: Path, xyza: Machine) -> None:
    """T0 selects the only tool; another tool, or one beside a move, is refused."""
    job = read(tmp_path, xyza, "T0\nG1 X5 F60\n", "marlin")
    assert list(working_words(job)) == [(1, "T0")]
    assert [p[0] for p in millimetres(job)] == [5.0]
    with pytest.raises(JobError, match="T1 is no word of a machine with one tool"):
        read(tmp_path, xyza, "G1 X5 F60\nT1\nG1 X7\n", "marlin")
    with pytest.raises(JobError, match=r"first command of a line \(T0\), and not G1"):
        read(tmp_path, xyza, "T0 G1 X5 F60\n", "marlin")


def test_grbl_goes_home_where_g28_1_says(tmp_path: Path, xyza: Machine) -> None:
    job = read(tmp_path, xyza, "G1 X3 Y4 F60\nG28.1\nX9\nG92 X0\nG28 Y9\nG28\nX1\n", "grbl")
    ends = [p[:2] for p in millimetres(job)]
    assert ends == [pytest.approx(p) for p in [(3, 4), (9, 4), (9, 9), (9, 4), (3, 4), (10, 4)]]


def test_fanuc_numbers_need_a_point(tmp_path: Path, xyza: Machine) -> None:
    with pytest.raises(JobError, match="X1000 has no decimal point: by its parameter DPI"):
        read(tmp_path, xyza, "G1 X1000 F60\nM30\n", "fanuc")
    assert millimetres(read(tmp_path, xyza, "G1 X1. Y0 F60\nM30\n", "fanuc"))[0][0] == 1.0


def test_dialects_are_chosen_and_refused(tmp_path: Path, xyza: Machine) -> None:
    with pytest.raises(OptionError, match=r"there is no dialect 'gbrl'.*, fanuc, x-winder\."):
        read(tmp_path, xyza, "G1 X1 F60\nM30\n", "gbrl")
    with pytest.raises(JobError, match=r"unknown word G5\..*The dialect linuxcnc has it"):
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
    """The compiled reader equals the plain one: operations and warnings, or the error."""
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

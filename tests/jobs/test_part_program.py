"""Part programs: modes, calls, feeds, tags, streaming."""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from threadline.errors import JobError, OptionError
from threadline.jobs import Dwell, Feed, FeedMode, Job, Move, Stop, ToolEvent, read_job
from threadline.jobs.operations import MoveRun
from threadline.machine import Machine, load_machine
from threadline.machine.tool import eye_within

MACHINE = load_machine("lathe-winder")


def read(folder: Path, *lines: str, **options: Any) -> Job:
    path = folder / "a.nc"
    path.write_text("\n".join(lines) + "\n")
    return read_job(path, MACHINE, **options)


def moves(job: Job) -> list[Move]:
    return [op for op in job if isinstance(op, Move)]


def millimetres(job: Job) -> list[float]:
    """Return X after each move."""
    return [1e3 * move.target[1] for move in moves(job)]


def test_units_and_modes(tmp_path: Path) -> None:
    """G20 and G21 scale lengths and F, not degrees; G90 and G91 may change in between."""
    job = read(tmp_path, "G20 G91 G1 F60 X1 A90", "X1", "G90 X1", "G21 X5", "G91 X-5", "M30")
    assert millimetres(job) == pytest.approx([25.4, 50.8, 25.4, 5.0, 0.0], abs=1e-12)
    assert moves(job)[0].target[0] == math.radians(90.0)
    assert moves(job)[0].feed == Feed(FeedMode.FASTEST_AXIS, 60 * 0.0254 / 60)


def test_a_machine_without_axes_takes_no_part_program(tmp_path: Path) -> None:
    path = tmp_path / "a.nc"
    path.write_text("G91 G1 F60 X1\nM30\n")
    with pytest.raises(JobError, match=r"a\.nc: 'letter-placer' has no axes for part programs"):
        read_job(path, load_machine("letter-placer"))


def test_increments_are_summed_exactly(tmp_path: Path) -> None:
    """780 times 0.1 mm is 78 mm to the last bit; adding doubles gives 78.00000000000048."""
    job = read(tmp_path, "G91 G1 F60", "M98 P2 L780", "M30", "O2", "X0.1", "A0.1", "M99")
    last = moves(job)[-1]
    assert last.target == (math.radians(78.0), 0.078, 0.0)
    assert functools.reduce(operator.add, [0.1] * 780) != 78.0  # sum is more exact from 3.12 on


def test_g0_g4_g28_and_stops_become_operations(tmp_path: Path) -> None:
    """Rapid moves, dwells in seconds, homing by way of a point, stops, spindle off."""
    job = read(
        tmp_path,
        "G91 G1 F60 X2 Y3 A4",
        "G0 X1",
        "G4 P0.25",
        "G28 X7",
        "X1",
        "G28",
        "M5",
        "M0",
        "M2",
    )
    operations = list(job)
    x = [1e3 * op.target[1] for op in operations if isinstance(op, Move)]
    assert x == pytest.approx([2, 3, 10, 0, 1, 0], abs=1e-12)
    rapid = [
        op.feed.mode is FeedMode.RAPID for op in operations if isinstance(op, Move) and op.feed
    ]
    # G28 moves fast without changing the mode: the next X1 is still under G0.
    assert rapid == [False, True, True, True, True, True]
    via_x_only = [op for op in operations if isinstance(op, Move)][3]
    assert via_x_only.target[2] == 0.003
    assert [op.duration_s for op in operations if isinstance(op, Dwell)] == [0.25]
    assert [op.words for op in operations if isinstance(op, ToolEvent)] == ["M5"]
    assert [op.final for op in operations if isinstance(op, Stop)] == [False, True]


def test_nested_calls_carry_line_and_passes(tmp_path: Path) -> None:
    """The pass of every open call is in the source, outermost first."""
    job = read(tmp_path, "O1", "G91 G1 F60 X1", "M98 P2 L2", "X1 M98 P3", "M30", "O2", "X10",
               "M98 P3 L2", "M99", "O3", "Y1 M99")  # fmt: skip
    assert [(m.source.line, m.source.passes) for m in moves(job)] == [
        (2, ()), (7, (1,)), (11, (1, 1)), (11, (1, 2)), (7, (2,)), (11, (2, 1)), (11, (2, 2)),
        (4, ()), (11, (1,)),
    ]  # fmt: skip


def test_feeds(tmp_path: Path) -> None:
    """F is mm/min, in G93 the inverse of minutes, with the options the speed of the base."""
    lines = ["G91 G1 F600 X1", "A1", "G93 X1 F30", "G94 X1 F60", "M30"]
    feeds = [m.feed for m in moves(read(tmp_path, *lines))]
    assert feeds == [
        Feed(FeedMode.FASTEST_AXIS, 0.01), Feed(FeedMode.FASTEST_AXIS, 0.01),
        Feed(FeedMode.INVERSE_TIME, 0.5), Feed(FeedMode.FASTEST_AXIS, 0.001),
    ]  # fmt: skip
    base = read(tmp_path, *lines, feed_mode=FeedMode.BASE_AXES, base_axes=("A", "X"))
    assert moves(base)[0].feed == Feed(FeedMode.BASE_AXES, 0.01, ("A", "X"))
    assert moves(read(tmp_path, *lines, feed_mode="path"))[0].feed == Feed(FeedMode.PATH, 0.01)


def test_warnings_name_their_line(tmp_path: Path) -> None:
    """F above the normal feed of an axis that moves, milliseconds for seconds, G64."""
    job = read(tmp_path, "G64 P0.1", "G91 G1 F2160 X1", "X1 F2200", "X1 F2200", "G4 P1500", "M30")
    assert [w.split(":")[1] for w in job.suspicions(own_feed=True)] == ["3", "5", "1"]
    assert [w.split(":")[1] for w in job.suspicions(own_feed=False)] == ["5", "1"]
    assert "above the normal feed of 10 count/tick (X 36.1 mm/s)" in job.capped[0]
    home = read(tmp_path, "G91 G1 F9000", "G28", "M30")
    assert "(A 99.2, X 36.1, Y 32.1 mm/s)" in home.capped[0]
    many = [f"X1 F{3000 + k}" for k in range(20)]
    assert read(tmp_path, "G91 G1", *many, "M30").capped[-1] == "15 more warnings of these kinds."


def test_dwells_from_twenty_seconds_on_are_asked_about(tmp_path: Path) -> None:
    """Pens, valves and spindles all take less than that."""
    job = read(tmp_path, "G91 G1 F600 X1", "G4 P19.9", "G4 P20", "G4 P21", "M30")
    (suspicion,) = job.suspicions(own_feed=True)
    assert suspicion.split(":")[1] == "3" and "waits 20 s (1 more line waits as long)" in suspicion


def test_g64_alone_is_warned_of_and_a_thousand_of_them_at_most(tmp_path: Path) -> None:
    """A program may have millions of them; the memory for messages is bounded."""
    modes = ["G21 G90 G94", "G91 G1 F600 X1"]
    assert read(tmp_path, *modes, "M30").suspicions(own_feed=False) == ()
    warnings = read(tmp_path, *modes, *["G64 X1"] * 1500, "M30").suspicions(own_feed=False)
    assert [w.split(":")[1] for w in warnings[:5]] == ["3", "4", "5", "6", "7"]
    assert warnings[5] == "995 more warnings of these kinds."


def test_a_feed_is_judged_in_the_unit_in_force_where_it_is_called(tmp_path: Path) -> None:
    """F 90 is 1.5 mm/s, and in inches 38.1 mm/s: above 36.1, wherever G20 comes from."""
    body, main = ["O9", "G91 G1 X1 F90", "M99"], ["O1", "G20", "M98 P9", "M30"]
    before = read(tmp_path, *body, *main)
    assert [w.split(":")[1] for w in before.capped] == ["2"]
    assert "F 90 is 38.1 mm/s" in before.capped[0]

    setter, plain = ["O8", "G20", "M99"], ["O1", "M98 P9", "M30"]
    left_behind = read(tmp_path, *body, *setter, "O1", "M98 P8", "M98 P9", "M30")
    second_pass = read(tmp_path, "O9", "G91 G1 X1 F90", "G20", "M99", "O1", "M98 P9 L2", "M30")
    not_called = read(tmp_path, *body, *setter, *plain)
    set_in_the_body = read(tmp_path, "O9", "G21 G91 G1 X1 F90", "M99", *main)
    inverse_time = read(tmp_path, *body, "O1", "G20 G93", "M98 P9", "M30")
    assert [len(job.capped) for job in (left_behind, second_pass)] == [1, 1]
    assert [job.capped for job in (not_called, set_in_the_body, inverse_time)] == [(), (), ()]


def test_numbers_in_a_comment_are_tags(tmp_path: Path) -> None:
    """``; tension_N=25 width=4`` belongs to the move of its block; words do not."""
    job = read(tmp_path, "G91 G1 F60 X1 ; tension_N=25.000 width=4", "X1 ; speed = of light", "M30")
    assert [dict(m.tags) for m in moves(job)] == [{"tension_N": 25.0, "width": 4.0}, {}]


@pytest.mark.parametrize(
    ("comment", "message"),
    [
        ("tension_N=abc", "'tension_N=abc' has no number"),
        ("tension_N=nan", "'tension_N=nan' has no number"),
        ("tension_N=inf width=4", "'tension_N=inf' has no number"),
        ("width=4, tension_N=1e3", "'tension_N=1e3' has no number"),
        ("tension_N= width=4", "'tension_N=' has no number"),
        ("tension_N=" + "9" * 400, "has no number"),
        ("tension_N=5 width=4 tension_N=6", "the tag tension_N stands twice in the block"),
    ],
)
def test_a_tag_without_a_number_or_given_twice_is_refused(
    tmp_path: Path, comment: str, message: str
) -> None:
    with pytest.raises(JobError, match=rf"a\.nc:2: .*{message}"):
        read(tmp_path, "G91 G1 F60 X1", f"X1 ; {comment}", "M30")


def test_comments_for_people_are_no_tags(tmp_path: Path) -> None:
    """Text with other words, without a block, or in parentheses is not meant for the reader."""
    comments = ["X1 ; R=5 is the radius", "X1 ; a == b", "; tool=ball", "X1 (speed=fast)", "X1 ; ="]
    job = read(tmp_path, "G91 G1 F60", *comments, "M30")
    assert [dict(m.tags) for m in moves(job)] == [{}] * 4


def test_the_kernel_is_used(tmp_path: Path) -> None:
    """A long plain program arrives in runs of thousands, equal to its moves one by one."""
    job = read(tmp_path, "G91 G1 F100", *["X1", "X-1 Y0.5 ; note", "N7 A1 (b) F90"] * 3000, "M30")
    items = list(job.runs())
    assert sum(isinstance(item, MoveRun) for item in items) <= 5
    expanded = [op for item in items for op in (item if isinstance(item, MoveRun) else [item])]
    assert expanded == list(job)
    assert len(expanded) == 9001


# --- streaming -----------------------------------------------------------------------------------


def test_a_long_program_needs_no_more_memory_than_a_short_one(tmp_path: Path) -> None:
    """Peak memory of reading and going through 400 000 blocks stays below 4 MB (14 MB of text)."""
    path = tmp_path / "long.nc"
    with path.open("w") as stream:
        stream.write("G91 G1 F100\n")
        for k in range(400_000):
            stream.write(f"N{k % 99999} A {k % 7}.125 X {(k % 3) - 1}.5 Y 0.001 (turn)\n")
        stream.write("M30\n")
    list(read(tmp_path, "G91 G1 F100", "X1", "X1", "M30"))  # compile first
    tracemalloc.start()
    try:
        job = read_job(path, MACHINE)
        count = sum(len(item) if isinstance(item, MoveRun) else 1 for item in job.runs())
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert count == 400_001
    assert path.stat().st_size > 12e6
    assert peak < 4e6


def test_a_line_across_two_chunks_is_one_line(tmp_path: Path) -> None:
    """Chunks are 256 KiB: line numbers and positions go on across their borders."""
    count = 60_000
    job = read(tmp_path, "G91 G1 F100", *["X0.001 Y0.002"] * count, "M30")
    last = moves(job)[-1]
    assert last.source.line == count + 1
    assert last.target == (0.0, 0.06, 0.12)


# --- programs of others --------------------------------------------------------------------------


def six_axis_machine() -> Machine:
    """The library winder with axes A Z X B, the carriage called Z as on other winders."""
    axes = MACHINE.axes
    names = {"A": axes["A"], "Z": axes["X"], "X": axes["Y"], "B": axes["A"]}
    return dataclasses.replace(
        MACHINE, name="four-axes", axes=names, inputs={}, tool=eye_within(MACHINE.tool, names)
    )


def test_a_winding_program_of_another_tool(shared_samples: Path) -> None:
    """128 moves on A Z X B with a tension each, to the last position of the file."""
    path = shared_samples / "winding" / "winding_path.nc"
    job = read_job(path, six_axis_machine())
    found = moves(job)
    assert len(found) == 128
    assert job.axes == ("A", "Z", "X", "B")
    last = path.read_text().splitlines()[132]
    words = {w[0]: float(w[1:]) for w in last.split(";")[0].split() if w[0] in "AZXB"}
    expected = [words["A"], words["Z"], words["X"], words["B"]]
    a, z, x, b = found[-1].target
    assert [math.degrees(a), 1e3 * z, 1e3 * x, math.degrees(b)] == pytest.approx(expected, abs=1e-9)
    assert dict(found[0].tags) == {"tension_N": 25.0}
    with pytest.raises(
        JobError, match=r"winding_path\.nc:6: Z 50\.000: the machine 'lathe-winder'"
    ):
        read_job(path, MACHINE)


def test_x_winder_programs_are_told_apart(shared_samples: Path) -> None:
    """Another dialect, in which letters mean other axes: one clear line, not a syntax error."""
    for path in (shared_samples / "winding").glob("*.X4G"):
        with pytest.raises(JobError, match="an X-Winder program turns the mandrel C"):
            read_job(path, MACHINE)
        with pytest.raises(OptionError, match="an X-Winder Designer program, and no grbl one"):
            read_job(path, MACHINE, dialect="grbl")

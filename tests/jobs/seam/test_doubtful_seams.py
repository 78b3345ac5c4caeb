"""Seams that are open, crossed, outside, or too much for the machine: a message or a warning."""

from pathlib import Path

import numpy as np
import pytest

from tests.jobs.seam.test_bad_input import read, seam
from threadline.errors import JobError, LimitError
from threadline.jobs.operations import Move
from threadline.machine import Machine, load_machine


def test_open_by_a_little_is_said(sewer: Machine, tmp_path: Path) -> None:
    almost = "[[0, 0], [30, 0], [30, 30], [0, 30], [0.3, 0.4]]"
    job = read(tmp_path, sewer, "t.seam.toml", seam(almost))
    assert any("open by 0.5 mm at (0, 0) mm" in text for text in job.warnings)
    closed = read(tmp_path, sewer, "t.seam.toml", seam(almost, "[drawing]\ngap = '0.6 mm'"))
    assert not any("open by" in text for text in closed.warnings)


def test_gaps_are_joined_within_the_gap_and_reported(sewer: Machine, tmp_path: Path) -> None:
    parts = "x [mm],y [mm]\n0,0\n30,0\n\n30,20\n30.004,0\n\n0,0\n0,20\n"
    job = read(tmp_path, sewer, "t.csv", parts)
    assert sum(isinstance(op, Move) and op.tags["kind"] == "travel" for op in job) == 1
    assert any("1 gaps between strokes" in t and "0.004 mm" in t for t in job.warnings)
    at = np.array([op.target for op in job if isinstance(op, Move)]) * 1e3
    assert at[0] == pytest.approx([0, 20])  # the first stroke is the middle of the chain
    assert at[-1] == pytest.approx([30, 20])
    wide = read(tmp_path, sewer, "t.csv", parts.replace("30.004", "30.1"))
    assert sum(isinstance(op, Move) and op.tags["kind"] == "travel" for op in wide) == 2


def test_branches_and_short_strokes_are_refused(sewer: Machine, tmp_path: Path) -> None:
    star = "x [mm],y [mm]\n0,0\n10,0\n\n10,0\n20,5\n\n10,0\n20,-5\n"
    with pytest.raises(
        JobError, match=r"three or more ends meet at \(10, 0\) mm \(lines 2, 5, 8\)"
    ):
        read(tmp_path, sewer, "t.csv", star)
    dot = "x [mm],y [mm]\n0,0\n0.005,0\n"
    with pytest.raises(JobError, match="shorter than the gap"):
        read(tmp_path, sewer, "t.csv", dot)


def test_crossings_are_said(sewer: Machine, tmp_path: Path) -> None:
    bow = "[[0, 0], [30, 30], [30, 0], [0, 30]]"
    job = read(tmp_path, sewer, "t.seam.toml", seam(bow))
    assert any("crosses or touches itself" in t and "(15, 15) mm" in t for t in job.warnings)


def test_zero_lengths_are_left_out_with_a_word(sewer: Machine, tmp_path: Path) -> None:
    job = read(tmp_path, sewer, "t.csv", "x [mm],y [mm]\n0,0\n10,0\n10,0\n20,0\n")
    assert any(t.startswith("t.csv:3: a segment of length zero") for t in job.warnings)
    clean = read(tmp_path, sewer, "u.csv", "x [mm],y [mm]\n0,0\n10,0\n20,0\n")
    targets = [op.target for op in job if isinstance(op, Move)]
    assert targets == [op.target for op in clean if isinstance(op, Move)]


def test_stitch_longer_than_the_segment(sewer: Machine, tmp_path: Path) -> None:
    """Steps of 1.2 mm with stitches of 2.5 mm: one stitch each, exempt, with a warning."""
    steps = [[k // 2 * 1.2, (k + 1) // 2 * 1.2] for k in range(9)]
    job = read(tmp_path, sewer, "t.seam.toml", seam(str(steps)))
    assert any("8 legs between corners are shorter than a stitch" in t for t in job.warnings)
    at = np.array([op.target for op in job if isinstance(op, Move)]) * 1e3
    for corner in steps:
        assert np.hypot(*(at - corner).T).min() < 1e-9
    assert all(op.tags["exempt"] for op in job if isinstance(op, Move) and "exempt" in op.tags)


def test_bowed_line_is_refused(sewer: Machine, tmp_path: Path) -> None:
    """Stitches of 2.5 mm around a radius of 1.5 mm leave the line by 0.6 mm."""
    circle = '[[1.5, 0], {to = [1.5, 0], centre = [0, 0], turn = "ccw"}]'
    for needle in ("slowed", "constant"):
        with pytest.raises(JobError, match=r"t\.seam\.toml:\d+: .* bows 0\.\d+ mm out of a stitch"):
            read(tmp_path, sewer, "t.seam.toml", seam(circle), needle=needle, least_stitch="2.5 mm")


def test_outside_the_travel(sewer: Machine, tmp_path: Path) -> None:
    with pytest.raises(
        LimitError, match=r"t\.csv:2: seam 'seam' reaches X .* ends at 10000 mm"
    ) as e:
        read(tmp_path, sewer, "t.csv", "x [m],y [m]\n0,0\n11,0\n")
    assert (e.value.axis, e.value.quantity, e.value.limit_si) == ("X", "travel", 10.0)
    moved = "[drawing]\nfile = 't.csv'\norigin = ['-2 m', '0 m']\n"
    with pytest.raises(LimitError, match="reaches X -2000 mm"):
        read(tmp_path, sewer, "t.seam.toml", moved)


def test_weak_machine_is_said(tmp_path: Path) -> None:
    """The winder's 10.5 and 4.65 m/s^2 do not reach 0.2 m/s within two stitches."""
    winder = load_machine("lathe-winder")
    job = read(
        tmp_path, winder, "t.seam.toml", seam("[[0, 0], [40, 0], [40, 40]]"),
        needle_speed="100 stitch/s", motion="discrete",
    )  # fmt: skip
    assert any("axis Y does 4.65 m/s^2" in t for t in job.warnings)
    fast = read(
        tmp_path, winder, "t.seam.toml", seam("[[0, 0], [40, 0], [40, 40]]"),
        needle_speed="500 stitch/s",
    )  # fmt: skip
    assert any("1250 mm/s; axis X does 1000 mm/s" in t for t in fast.warnings)
    assert any("misses 1 corners by more than 0.5 mm, a turn of 90" in t for t in fast.warnings)


def test_machine_without_x_and_y(tmp_path: Path) -> None:
    file = tmp_path / "m.toml"
    file.write_text(
        'base = "lathe-winder"\n[axes]\nY = "none"\n[inputs]\ny_low = "none"\ny_high = "none"\n'
    )
    with pytest.raises(JobError, match="needs the linear axes X and Y"):
        read(tmp_path, load_machine(file), "t.csv", "x [m],y [m]\n0,0\n1,0\n")


@pytest.mark.parametrize(
    ("acceleration", "makes"),
    [("1e-14", r"1e\+08 stitches on it"), ("1e-7", r"a stitch of \S+ mm")],
)
def test_a_head_that_hardly_accelerates_is_refused(
    acceleration: str, makes: str, tmp_path: Path
) -> None:
    """With a constant needle its stitches took 14 GB, and were then called a loop."""
    weak = tmp_path / "weak.toml"
    weak.write_text(
        f'base = "stitcher"\naxes.X.acceleration = "{acceleration} m/s^2 exact, assumed"\n'
    )
    points = "[[0, 0], [20, 0], [20, 10]]"
    with pytest.raises(JobError, match=f"is so slow.* constant speed makes {makes}"):
        list(read(tmp_path, load_machine(weak), "t.seam.toml", seam(points)))

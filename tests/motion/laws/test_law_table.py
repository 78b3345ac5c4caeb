"""Laws as tables: written tables read back, and wrong ones are refused with their line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from threadline.errors import OptionError
from threadline.motion.laws import law, read_law, write_law


@pytest.mark.parametrize("name", ["modified-sine", "jerk-limited:1,2,1.5,3,0.5,4,2", "3-4-5"])
def test_written_law_reads_back_equal(name: str, tmp_path: Path) -> None:
    """Quintic pieces of a thousandth: a sine of frequency 4 pi is met to 1e-9 and better."""
    file = tmp_path / "law.csv"
    exact = law(name)
    write_law(exact, file)
    read = law(str(file))
    t = np.linspace(0, 1, 12_345)
    for derivative, tolerance in ((0, 1e-12), (1, 1e-10), (2, 1e-7)):
        assert np.abs(read(t, derivative) - exact(t, derivative)).max() < tolerance
    assert read.jerk == pytest.approx(exact.jerk, rel=1e-5)
    assert np.abs(read(read.inverse(t)) - t).max() <= 1e-15


def test_time_and_rise_have_any_scale(tmp_path: Path) -> None:
    """A table of angles in degrees and lengths in mm, without derivatives: scipy's own spline."""
    t = np.linspace(0.0, 1.0, 41)
    s = law("cycloidal")(t)
    file = tmp_path / "cam.csv"
    rows = "\n".join(f"{20 + 120 * a:.12g},{3 - 2 * b:.12g}" for a, b in zip(t, 1 - s, strict=True))
    file.write_text(f"# a comment\nt, s\n{rows}\n")
    read = read_law(file)
    u = np.linspace(0, 1, 999)
    assert read(u) == pytest.approx(CubicSpline(t, s, bc_type="clamped")(u), abs=1e-9)
    assert read.name == "cam"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,s\n0,0\n0.5,0.5\n0.5,0.6\n1,1\n", "bad.csv:4: motion law: time 0.5 follows 0.5"),
        ("t,s\n0,0\n1,x\n", "bad.csv:3: motion law: '1,x' is not a row"),
        ("t,s\n0,0\n1,nan\n2,2\n", "bad.csv:3"),
        ("t,s\n0,0\n1,1\n", "2 rows, at least 3"),
        ("t,s\n0,0\n1e-300,0.5\n1,1\n", "bad.csv': a stretch takes 1e-300 of the time"),
        ("a,b\n0,0\n1,1\n2,2\n", "no column 't'"),
        ("", "no column 't'"),
        ("t,s\n0,1\n1,1\n2,1\n", "its rise is 0"),
        ("t,s\n0,0\n1,0.8\n2,0.2\n3,1\n", "goes back"),
        ("t,s,v,a\n0,0,1,0\n1,0.5,1,0\n2,1,1,0\n", "velocity must be 0"),
    ],
)
def test_table_without_a_law_is_refused(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(OptionError, match=message.replace("(", r"\(")):
        read_law(file)
    with pytest.raises(OptionError, match="cannot read"):
        read_law(tmp_path / "none.csv")


def test_a_table_is_read_anew_where_it_has_changed(tmp_path: Path) -> None:
    """A search needs its law at every speed; once read, the law is used again."""
    file = tmp_path / "own.csv"
    write_law(law("cycloidal"), file)
    first = read_law(file)
    assert read_law(file) is first
    write_law(law("3-4-5"), file)
    at = np.array([0.3])
    assert read_law(file)(at) == pytest.approx(law("3-4-5")(at), abs=1e-9)

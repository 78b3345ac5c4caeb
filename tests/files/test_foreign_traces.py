"""Traces and plots of other programs: read values, and refusals."""

from __future__ import annotations

from fractions import Fraction
from math import radians

import numpy as np
import pytest

from threadline.errors import RecordingError
from threadline.files import ChannelKind, Clock
from threadline.files.formats import read_recording, write_recording
from threadline.files.formats.plt import write_plt

from .makers import recording_of


def test_plt_is_what_the_winder_wrote(tmp_path) -> None:
    """X, Y, A in mm and degrees on a line, every 20 ticks; values by hand."""
    x = [k * 1e-3 for k in range(101)]
    recording = recording_of(
        {"A.measured": [radians(90)] * 101, "X.measured": x, "Y.measured": [0.0] * 101}, rows=7
    )
    path = tmp_path / "r.plt"
    done = write_plt(recording, path, every=20)
    assert path.read_text().splitlines() == [
        "X [mm]\tY [mm]\tA [deg]\tevery 20 ticks of 5 ms",
        *(f"{k}.0000\t0.0000\t90.0000" for k in (0, 20, 40, 60, 80, 100)),
    ]
    assert done.warnings == ()

    again = read_recording(path)
    times, values = again.samples("X.measured")
    assert np.allclose(times, np.arange(6) * 0.1, rtol=1e-15)
    assert np.allclose(values, np.arange(6) * 0.02, atol=5e-8)  # four decimals of a mm
    assert again.samples("A.measured")[1] == pytest.approx([radians(90)] * 6)
    assert again.channels[0].stride == 20
    assert not again.simulated


def test_plt_may_be_cut_as_in_1994_but_says_so(tmp_path) -> None:
    recording = recording_of({"X.measured": np.zeros(6000)}, rows=999)
    cut = write_plt(recording, tmp_path / "r.plt", limit_lines=5000)
    assert cut.warnings == ("r.plt was cut after 5000 lines",)
    assert len((tmp_path / "r.plt").read_text().splitlines()) == 5001
    whole = write_plt(recording, tmp_path / "r.plt")
    assert whole.warnings == ()
    assert len((tmp_path / "r.plt").read_text().splitlines()) == 6001


@pytest.mark.parametrize("period", [Fraction(1, 60), Fraction(17, 125000), Fraction(1, 3 * 10**9)])
def test_plt_keeps_the_tick_exact(tmp_path, period) -> None:
    recording = recording_of({"X.measured": [0.0, 1e-3]}, clock=Clock("servo", period))
    write_recording(recording, tmp_path / "r.plt")
    assert read_recording(tmp_path / "r.plt").channels[0].clock.period_s == period


def test_plt_refuses_lines_between_samples(tmp_path) -> None:
    recording = recording_of({"X.measured": [0.0, 1e-3]}, stride=20)
    with pytest.raises(RecordingError, match=r"every 30 ticks.*20 ticks apart.*multiple of 20"):
        write_plt(recording, tmp_path / "r.plt", every=30)
    with pytest.raises(RecordingError, match=r"no load position.*\.csv or \.npz"):
        write_plt(recording, tmp_path / "r.plt", kind=ChannelKind.LOAD)


FOREIGN = "time [{t}],X [mm],A.load [deg],operation\n"


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize(("unit", "factor"), [("s", 1.0), ("ms", 1e3)])
@pytest.mark.parametrize("first", [0, 7])
def test_traces_from_anywhere(tmp_path, separator, unit, factor, first) -> None:
    """Units, separators, a start after 0, comments, blank lines; compared in SI, by hand."""
    lines = ["# written by something else", FOREIGN.format(t=unit).strip(), ""]
    for k in range(50):
        lines.append(f"{(first + k) * 0.005 * factor:.6f},{k * 0.5},{k * 2},{k // 10}")
    path = tmp_path / "t.csv"
    path.write_text("\n".join(lines).replace(",", separator) + "\n")

    recording = read_recording(path)

    times, x = recording.samples("X.measured")
    assert recording.channels[0].clock.period_s == Fraction(1, 200)
    assert np.array_equal(times, (first + np.arange(50)) * 5 / 1000)
    assert x == pytest.approx(np.arange(50) * 0.0005)
    assert recording.samples("A.load")[1] == pytest.approx(np.radians(np.arange(50) * 2))
    assert recording.samples("operation")[1][-1] == 4.0
    assert recording.find(ChannelKind.LOAD, "A").unit == "rad"
    assert not recording.simulated
    assert recording.job_sha256 == ""


@pytest.mark.parametrize("decimals", [4, 6, 9])
def test_times_that_were_rounded_in_print_lie_on_the_grid(tmp_path, decimals) -> None:
    """40 us printed with four decimals is off by at most half a step, 0.05 ms: only 1 ms fits."""
    path = tmp_path / "t.csv"
    rows = [f"{k * 0.001:.{decimals}f},{k}" for k in range(2000)]
    path.write_text("time [s],X [mm]\n" + "\n".join(rows) + "\n")
    assert read_recording(path).channels[0].clock.period_s == Fraction(1, 1000)


def test_jitter_is_tolerated_up_to_what_is_stated(tmp_path) -> None:
    """4 % of a period passes, 8 % does not; drift counts like jitter."""
    rng = np.random.default_rng(8)
    noise = rng.uniform(-1, 1, 400)
    noise[[0, -1]] = 0.0

    def write(size: float, drift: float = 0.0) -> None:
        k = np.arange(400)
        bend = drift * np.sin(np.pi * k / 399)
        times = (k + size * noise + bend) * 0.005
        text = "\n".join(f"{t!r},0" for t in times.tolist())
        (tmp_path / "t.csv").write_text(f"time [s],X [mm]\n{text}\n")

    write(0.04)
    assert read_recording(tmp_path / "t.csv").channels[0].clock.period_s == Fraction(1, 200)
    write(0.08)
    with pytest.raises(RecordingError, match=r"t\.csv:\d+.*at most 5% of a period"):
        read_recording(tmp_path / "t.csv")
    write(0.0, drift=0.5)  # each step is even to 0.4 %, the middle is half a period late
    with pytest.raises(RecordingError, match="Record at a fixed rate"):
        read_recording(tmp_path / "t.csv")


BAD_TRACES = {
    "empty": ("", "the file is empty"),
    "only comments": ("# a\n# b\n", "the file is empty"),
    "no unit": ("time [s],X\n0,1\n1,1\n", r"t\.csv:1: column 'X' has no unit.*X \[mm\]"),
    "time without unit": ("time,X [mm]\n0,1\n1,1\n", "column 'time' has no unit"),
    "wrong unit": ("time [s],X [kg]\n0,1\n1,1\n", "column 'X' is in 'kg'.*unit like m or rad"),
    "time in mm": ("time [mm],X [mm]\n0,1\n1,1\n", "column 'time' is in 'mm'"),
    "unknown column": ("time [s],X [mm],Xx [mm]\n0,1,1\n", "unknown column 'Xx'.*'X'"),
    "unknown kind": ("time [s],X.laod [mm]\n0,1\n", "unknown column 'X.laod'.*'X.load'"),
    "misspelt time": ("tmie [s],X [mm]\n0,1\n", "unknown column 'tmie'.*'time'"),
    "twice": ("time [s],X [mm],X [mm]\n0,1,1\n1,1,1\n", "column 'X.measured' occurs twice"),
    "no time": ("X [mm],Y [mm]\n0,1\n1,1\n", "needs a column of time"),
    "time alone": (
        "time [s]\n0\n1\n",
        "needs a column of time and at least one column of positions",
    ),
    "one row": ("time [s],X [mm]\n0,1\n", "1 row.*at least 2"),
    "no row": ("time [s],X [mm]\n", "0 row.*at least 2"),
    "same time": ("time [s],X [mm]\n0,1\n1,1\n1,2\n", r"t\.csv:4: time goes from 1 s to 1 s"),
    "backwards": ("time [s],X [mm]\n0,1\n2,1\n1,2\n", r"t\.csv:4: time goes from 2 s to 1 s"),
    "nan": ("time [s],X [mm]\n0,1\n1,nan\n", r"t\.csv:3: 'nan' is not a finite number"),
    "infinite": ("time [s],X [mm]\n0,1\n1,1e999\n", "'1e999' is not a finite number"),
    "underscore": ("time [s],X [mm]\n0,1\n1,1_0\n", "'1_0' is not a finite number"),
    "gap in a row": ("time [s],X [mm],Y [mm]\n0,1,1\n1,,1\n", r"t\.csv:3: '' is not a finite"),
    "decimal comma": ("time [s];X [mm]\n0;1\n1;1,5\n", "'1,5' is not a finite number.*point"),
    "short row": ("time [s],X [mm]\n0,1\n1\n", r"t\.csv:3: the line has 1 cells"),
    "long row": ("time [s],X [mm]\n0,1\n1,2,3\n", r"t\.csv:3: the line has 3 cells"),
    "missing row": (
        "time [s],X [mm]\n" + "".join(f"{k},0\n" for k in range(90) if k != 50),
        r"t\.csv:52: rows are missing from 49 to 51 s",
    ),
    "odd start": (
        "time [s],X [mm]\n0.4,1\n1.4,1\n2.4,1\n",
        "begins at 0.4 s, which is not",
    ),
    "negative start": ("time [s],X [mm]\n-2,1\n-1,1\n0,1\n", "begins at -2 s"),
    "unit of operation": ("time [s],operation [mm]\n0,1\n1,1\n", "'operation' has no unit"),
    "half an operation": (
        "time [s],X [mm],operation\n0,1,0\n1,1,0.5\n",
        r"t\.csv:3: the operation 0\.5 is neither a whole number.*leave the column out",
    ),
    "operation below none": (
        "time [s],operation,X [mm]\n0,-1,1\n1,-2,1\n",
        r"csv:3: .*-2 is neither",
    ),
    "endless operation": ("time [s],operation,X [mm]\n0,1e300,1\n1,1,1\n", r"csv:2: .*1e\+300"),
    "brackets": ("time [s],X [[mm]\n0,1\n1,1\n", "is not the name of a column"),
}


@pytest.mark.parametrize("name", BAD_TRACES)
def test_bad_traces_are_refused_in_one_line(tmp_path, name) -> None:
    text, message = BAD_TRACES[name]
    (tmp_path / "t.csv").write_text(text)
    with pytest.raises(RecordingError, match=message) as caught:
        read_recording(tmp_path / "t.csv")
    assert "\n" not in str(caught.value)


BAD_PLT = {
    "empty": ("", "first line ''"),
    "no heading": ("1.0\t2.0\t3.0\n", "does not give columns, units and rate"),
    "no rate": ("X [mm]\tY [mm]\n1\t2\n", "does not give columns, units and rate"),
    "rate alone": ("every 20 ticks of 5 ms\n", "does not give columns"),
    "rate of nothing": ("X [mm]\tevery 20 ticks of 0 ms\n1\n", "tick '0 ms' cannot be read"),
    "no unit": ("X\tevery 20 ticks of 5 ms\n1\n", "'X' has no unit"),
    "a voltage": ("X.voltage [V]\tevery 2 ticks of 5 ms\n1\n", "position of an axis"),
    "the time": ("time [s]\tevery 2 ticks of 5 ms\n1\n", "position of an axis"),
    "twice": ("X [mm]\tX [mm]\tevery 2 ticks of 5 ms\n1\t1\n", "occurs twice"),
    "short": ("X [mm]\tY [mm]\tevery 2 ticks of 5 ms\n1\t2\n1\n", r"t\.plt:3: the line has 1 n"),
    "nan": ("X [mm]\tevery 2 ticks of 5 ms\nnan\n", r"t\.plt:2: 'nan'"),
    "no rows": ("X [mm]\tevery 2 ticks of 5 ms\n", "no rows"),
}


@pytest.mark.parametrize("name", BAD_PLT)
def test_bad_plots_are_refused_in_one_line(tmp_path, name) -> None:
    text, message = BAD_PLT[name]
    (tmp_path / "t.plt").write_text(text)
    with pytest.raises(RecordingError, match=message) as caught:
        read_recording(tmp_path / "t.plt")
    assert "\n" not in str(caught.value)

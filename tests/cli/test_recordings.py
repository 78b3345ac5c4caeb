"""Recordings of ``prove`` and traces of other programs, read back by ``judge``."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.test_commands import run
from threadline.files import ChannelKind
from threadline.files.formats import read_recording

pytestmark = pytest.mark.usefixtures("coarse_search")


def test_a_recording_is_judged_as_the_run_was(
    examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trace = tmp_path / "run.npz"
    common = ["-m", "lathe-winder", "--interpolation", "b-spline-pulled"]
    _, first, _ = run(
        capsys,
        "prove",
        examples / "x-180.prg",
        *common,
        "--nominal",
        "--recording",
        trace,
        "--json",
    )
    code, second, _ = run(capsys, "judge", trace, "--json")

    assert code == 0
    assert json.loads(second)["criteria"] == json.loads(first)["criteria"]

    code, out, err = run(capsys, "judge", trace, "-m", "lathe-winder+physical")
    assert (code, out) == (2, "")
    assert "run.npz was recorded on another machine" in err


def test_runs_are_judged_by_their_own_plan_and_count_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A copy is no second run, and the plan of another feed is no plan of this run."""
    job = tmp_path / "there-and-back.prg"
    job.write_text("%\nO1;\nG1 F2160;\nG91;\nX20;\nX-20;\nM30;\n%\n")
    runs = {}
    for name, options in (("run.npz", ()), ("slow.csv", ("--feed", "20 mm/s"))):
        runs[name] = tmp_path / name
        run(capsys, "prove", job, "-m", "lathe-winder", *options, "--recording", runs[name])
    copy = tmp_path / "copy.npz"
    copy.write_bytes(runs["run.npz"].read_bytes())
    same = "same run"
    for given, what in (
        ((runs["run.npz"], runs["run.npz"]), same),
        ((runs["run.npz"], runs["slow.csv"], copy), same),
        ((runs["run.npz"], "--feed", "20 mm/s"), "run.npz was recorded with feed programmed"),
        ((runs["run.npz"], "--interpolation", "linear"), "recorded with interpolation auto"),
        ((runs["run.npz"], "--tolerance", "1 mm"), "recorded with tolerance 0.0001 m"),
        ((runs["run.npz"], "--limits", "1 %"), "recorded with limits 100.0 %"),
        ((runs["run.npz"], runs["slow.csv"]), "slow.csv was recorded with feed 0.02 m/s"),
    ):
        code, out, err = run(capsys, "judge", *given)
        assert (code, out) == (2, ""), given
        assert what in err
    code, _, _ = run(capsys, "judge", runs["slow.csv"], "--feed", "1200 mm/min")
    assert code == 0  # the same feed in other words


PARAMETERS = "1994\nwinder\n\n20 ; manual\n15 ; normal\n30 ; limit\n20 ; record\n4 ; knots\n"


@pytest.mark.parametrize(
    "made_with",
    [
        ["--par", "FW-CNC.PAR"],
        ["--actual", "lathe-winder+physical"],
        ["--par", "FW-CNC.PAR", "--actual", "lathe-winder+physical"],
        ["--interpolation", "parabolic", "--shaper", "zv:12Hz:0.02"],
    ],
)
def test_a_recording_says_all_that_its_run_was_made_with(
    made_with: list[str], examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "FW-CNC.PAR").write_text(PARAMETERS)
    options = [str(tmp_path / o) if o == "FW-CNC.PAR" else o for o in made_with]
    trace = tmp_path / "run.npz"
    common = ["-m", "lathe-winder", *options, "--recording", trace, "--json"]
    code, first, _ = run(capsys, "prove", examples / "x-180.prg", *common, "--nominal")
    judged, second, _ = run(capsys, "judge", trace, "--json")

    assert judged == code
    assert json.loads(second)["criteria"] == json.loads(first)["criteria"]


def test_a_plot_file_has_a_line_every_n_ticks_as_the_operator_set_it(
    examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plot, every_tick = tmp_path / "run.plt", tmp_path / "run.csv"
    (tmp_path / "FW-CNC.PAR").write_text(PARAMETERS.replace("20 ; record", "7 ; record"))
    common = ["-m", "lathe-winder", "--par", tmp_path / "FW-CNC.PAR", "--interpolation", "linear"]
    for path in (plot, every_tick):
        run(capsys, "prove", examples / "x-180.prg", *common, "--recording", path)
    head, *lines = plot.read_text().splitlines()
    recording = read_recording(every_tick)
    channel = recording.find(ChannelKind.MEASURED, "X")
    assert channel is not None
    samples = np.concatenate([block.samples[channel.name] for block in recording])

    assert head.endswith("every 7 ticks of 5 ms")
    x_mm = np.array([float(line.split("\t")[0]) for line in lines])
    np.testing.assert_allclose(x_mm, samples[::7] * 1e3, atol=0.51e-4)  # four decimals of a mm


def test_a_trace_of_another_controller_is_judged_or_says_what_it_lacks(
    examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same run as time, positions and velocities: the same contour error, or a reason."""
    common = ["-m", "lathe-winder", "--interpolation", "linear"]
    run_file = tmp_path / "run.npz"
    _, first, _ = run(
        capsys,
        "prove",
        examples / "x-180.prg",
        *common,
        "--nominal",
        "--recording",
        run_file,
        "--json",
    )
    recording = read_recording(run_file)
    times = recording.samples("X.load")[0]
    places, paces = ([f"{axis}.{kind}" for axis in "AXY"] for kind in ("load", "velocity"))
    columns = np.stack([times, *(recording.samples(name)[1] for name in places + paces)], axis=1)
    judged = {}
    for kind in (".load", ".load alone", ""):
        name = kind.removesuffix(" alone")
        head = f"time [s];A{name} [rad];X{name} [m];Y{name} [m]"
        if kind == ".load":
            head += ";A.velocity [rad/s];X.velocity [m/s];Y.velocity [m/s]"
        lines = [";".join(map(repr, row[: head.count(";") + 1])) for row in columns.tolist()]
        trace = tmp_path / f"trace{kind}.csv"
        trace.write_text("\n".join([head, *lines]) + "\n")
        judged[kind] = run(capsys, "judge", trace, "--job", examples / "x-180.prg", *common)
        _, second, _ = run(
            capsys, "judge", trace, "--job", examples / "x-180.prg", *common, "--json"
        )
        contours = [
            next(c for c in json.loads(text)["criteria"] if c["name"] == "contour_error")
            for text in (first, second)
        ]
        if kind == ".load alone":  # at the machine's acceleration, 0.19 mm fit between two ticks
            assert contours[1]["status"] == "not-measured"
            assert "A.velocity, X.velocity, Y.velocity at each tick" in contours[1]["note"]
        elif kind:
            assert contours[1]["measured"] == pytest.approx(contours[0]["measured"], abs=1e-12)
            assert contours[1]["job_line"] == contours[0]["job_line"]
        else:
            assert contours[1]["status"] == "not-measured"

    assert judged[".load"][0] == 0
    assert "by time" in judged[".load"][1]
    assert judged[".load"][1].endswith("not measured)\n")
    assert judged[""][0] == 1
    assert judged[""][1].endswith(
        "NOT PROVEN (nominal: 1 run): contour error and progress error and turning point error "
        "were not measured\n"
    )

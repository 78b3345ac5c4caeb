"""The commands as a shell sees them: output, exit status, and nothing half-written."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from tests.blank_pictures import blank_pictures

from threadline.cli.main import main
from threadline.face import compile as compile_job
from threadline.machine import load_machine
from threadline.pipeline import target_names
from threadline.signals import ChannelKind
from threadline.signals.files import read_recording

pytestmark = pytest.mark.usefixtures("coarse_search")


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    """Run the program in this process; returns exit status, output and errors."""
    with pytest.raises(SystemExit) as stopped:
        main([str(a) for a in arguments])
    captured = capsys.readouterr()
    code = stopped.value.code
    return (0 if code is None else int(code)), captured.out, captured.err


def test_prove_json_has_the_promised_keys(
    examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = examples / "x-180.prg"
    code, out, _ = run(
        capsys, "prove", job, "-m", "lathe-winder", "--interpolation", "linear", "--json"
    )
    content = json.loads(out)

    assert code == 0
    assert content["passed"] is True
    # Fourteen moves of 25.714 mm at 36 mm/s take 142.9 ticks of 5 ms each, in whole ticks.
    assert content["ticks"] == 14 * 143
    assert content["duration_s"] == pytest.approx(14 * 143 * 0.005, rel=1e-9)
    wanted = {"job", "machine", "interpolation", "criteria", "job_sha256", "threadline"}
    assert wanted <= content.keys()
    assert content["machine_sha256"] == load_machine("lathe-winder").sha256
    for criterion in content["criteria"]:
        assert {
            "name",
            "axis",
            "measured",
            "limit",
            "unit",
            "status",
            "time_s",
            "job_line",
        } <= criterion.keys()
    turning = next(
        c for c in content["criteria"] if (c["name"], c["axis"]) == ("turning_point_error", "X")
    )
    # The facts sheet's independent model stops 0.47 mm short at 36 mm/s.
    assert turning["measured"] == pytest.approx(0.47e-3, abs=0.03e-3)
    assert turning["job_line"] == 12


def test_prove_exits_with_one_out_of_spec(
    examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(
        capsys,
        "prove",
        examples / "x-180.prg",
        "-m",
        "lathe-winder",
        "--interpolation",
        "linear",
        "--feed",
        "80 count/tick",
    )
    assert code == 1
    assert "OUT OF SPEC" in out
    assert "failed" in out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-m", "lathe-windr"], ["lathe-windr", "Did you mean 'lathe-winder'"]),
        (["-m", "lathe-winder", "--feed", "0 mm/s"], ["feed", "greater than zero"]),
        (["-m", "lathe-winder", "--feed", "fast"], ["feed 'fast'", "count/tick"]),
        (["-m", "stitcher", "--feed", "30 stitch/s"], ['needle_speed = "30 stitch/s"']),
        (["-m", "lathe-winder", "--tolerance", "1 deg"], ["tolerance", "0.1 mm"]),
        (["-m", "lathe-winder", "--interpolation", "liner"], ["liner", "linear"]),
        (["-m", "lathe-winder", "-s", "no-such.toml"], ["no-such.toml"]),
        (["-m", "lathe-winder+x"], ["no overlay 'x'", "physical"]),
    ],
)
def test_wrong_options_exit_with_two_and_one_line(
    arguments: list[str], words: list[str], examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run(capsys, "prove", examples / "x-180.prg", *arguments)

    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("error: [")
    for word in words:
        assert word in err


@pytest.mark.parametrize(
    ("command", "job", "arguments", "words"),
    [
        ("compile", "letter-cycle.toml", ["--mode", "3 Hz"], ["Give --shaper too"]),
        ("compile", "letter-cycle.toml", ["--shaper", "zv", "--mode", "0 Hz"], ["positive"]),
        (
            "compile",
            "letter-cycle.toml",
            ["--limits", "50 %"],
            ["--limits: ", "switches cylinders on and off"],
        ),
        ("fastest", "letter-cycle.toml", ["--feed-forward"], ["--feed-forward: letter-placer"]),
        ("compile", "x-180.prg", ["--shaper", "zv:12Hz", "--mode", "3 Hz"], ['"zv:12Hz:0.02"']),
        ("compile", "x-180.prg", ["--feed-forward", "--smoothing", ""], ["not a number"]),
        ("fastest", "strap.seam.toml", ["--smoothing", "36 ms"], ["Give --feed-forward too"]),
        ("fastest", "strap.seam.toml", ["--report", "file"], ["not a folder"]),
        ("fastest", "strap.seam.toml", ["--mismatch", "--report", "file"], ["not a folder"]),
        (
            "fastest",
            "strap.seam.toml",
            ["--band", "20 %"],
            ["--band '20 %' does not apply to strap"],
        ),
        ("fastest", "letter-cycle.toml", ["--low", "1 mm/s"], ["of which commands and waits are"]),
        ("fastest", "strap.seam.toml", ["--high", "1e6 stitch/s"], ["at most 1000", "--high"]),
        ("fastest", "strap.seam.toml", ["--margin", "100 %"], ["below 100 %", '"20 %"']),
        ("fastest", "x-180.prg", ["--margin", "1 mm"], ["a percentage is wanted", '"20 %"']),
        ("design", "strap.seam.toml", ["--feed-forward", "--smoothing", ""], ["not a number"]),
        (
            "fastest",
            "x-180.prg",
            ["--interpolation", "optimal", "--low", "1 mm/s"],
            ["a search by feed", "Leave it out"],
        ),
        ("compare", "x-180.prg", ["--contour", "0.2 mm"], ["linear", "--interpolation optimal"]),
        (
            "design",
            "strap.seam.toml",
            ["--interpolation", "optimal", "--feed-forward", "--contour", "0.2 mm"],
            ["--contour", "the loads follow"],
        ),
    ],
)
def test_options_that_do_not_fit_are_refused_before_the_work(
    command: str,
    job: str,
    arguments: list[str],
    words: list[str],
    examples: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    machine = {".toml": "letter-placer", ".prg": "lathe-winder"}.get("".join(Path(job).suffixes))
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    out_file = ["--target", "st", "-o", "made.st"] if command == "compile" else []
    code, out, err = run(
        capsys, command, examples / job, "-m", machine or "stitcher", *out_file, *arguments
    )
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
    for word in words:
        assert word in err


def test_the_table_of_a_shaped_motion_is_what_was_proved(
    examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The counts written add up to the positions that the simulated machine was commanded."""
    common = [examples / "x-180.prg", "-m", "lathe-winder", "--interpolation", "parabolic"]
    shaped = ["--shaper", "zv:12Hz:0.02"]
    table, trace = tmp_path / "table.csv", tmp_path / "run.npz"
    run(capsys, "prove", *common, *shaped, "--recording", trace)
    code, _, _ = run(capsys, "compile", *common, *shaped, "--target", "csv", "-o", table)
    assert code == 0
    plain = tmp_path / "plain.csv"
    run(capsys, "compile", *common, "--target", "csv", "-o", plain)
    counts, unshaped = (
        np.array([int(x) for x in re.findall(r"^\d+,-?\d+,(-?\d+),", f.read_text(), re.M)])
        for f in (table, plain)
    )
    commanded = read_recording(trace).samples("X.commanded")[1] * 55.358e3
    np.testing.assert_allclose(np.cumsum(counts), commanded[1 : len(counts) + 1], atol=1e-6)
    assert len(counts) > len(unshaped)


def test_missing_job_exits_with_two(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "prove", "no-such-job.prg", "-m", "lathe-winder")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "no-such-job.prg" in err


def test_a_refused_job_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The last line leaves the travel: not a byte of the table may be there."""
    job = tmp_path / "far.prg"
    job.write_text("%\nO 1;\nN 10 G01 G90 F 600;\nN 20 X 10;\nN 30 X 900;\nN 40 M30;\n%\n")
    out_file = tmp_path / "far.csv"
    code, _, err = run(
        capsys, "compile", job, "-m", "lathe-winder", "--target", "csv", "-o", out_file
    )

    assert code == 2
    assert "far.prg:5" in err
    assert "900" in err
    assert [p.name for p in tmp_path.iterdir()] == ["far.prg"]


@pytest.mark.parametrize(
    "command",
    [
        ["prove"],
        ["prove", "--json"],
        ["compile", "--target", "csv", "-o", "inches.csv"],
        ["compare", "--no-fastest", "--interpolation", "linear"],
    ],
    ids=lambda command: " ".join(command[:2]),
)
def test_every_command_that_plans_gives_the_warnings(
    command: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("inches.prg").write_text("O9\nG91 G1 X 0.1 F 90\nM99\nO1\nG20\nM98 P9\nM30\n")
    verb, *options = command
    code, _, err = run(capsys, verb, "inches.prg", "-m", "lathe-winder", *options)

    assert code == 0
    assert err.count("warning: inches.prg:2: F 90 is 38.1 mm/s, above the normal feed") == 1


@pytest.mark.parametrize(
    "command",
    [
        ["prove", "--feed", "10 mm/s"],
        ["fastest", "--low", "10 mm/s", "--high", "11 mm/s", "--interpolation", "linear"],
    ],
    ids=lambda command: command[0],
)
def test_a_feed_that_is_not_in_force_is_no_doubt(
    command: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("inches.prg").write_text("G91 G64 G1 X 2 F 2400\nX -2\nM30\n")
    verb, *options = command
    _, _, err = run(capsys, verb, "inches.prg", "-m", "lathe-winder", "--nominal", *options)

    assert "G64 is for other controllers" in err  # its other warnings stay
    assert "normal feed" not in err


def test_fastest_prints_the_command_that_proves_its_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Typed as it stands, it gives the same verdict; the search ends at --high, and says so."""
    monkeypatch.chdir(tmp_path)
    job = tmp_path / "a job.prg"
    job.write_text("G91\nG1 X10 F1200\nG1 X10\nG1 X-20\nM30\n")
    words = ["fastest", job.name, "-m", "lathe-winder", "--interpolation", "cubic"]
    words += ["--low", "20 mm/s", "--high", "21.1 mm/s"]
    code, out, _ = run(capsys, *words)
    assert code == 0
    assert "limited by the end of the search (--high)" in out
    assert re.search(r"tried in steps of 0\.\d+ %, about the edges of the fastest of 0\.\d+ %", out)
    (command,) = re.findall(r"To prove it: threadline (.*)", out)
    # All shares of the limits give the same job here: one row.
    assert len(re.findall(r"100 % to [0-9.]+ %\s+20\s+21\.1\s", out)) == 1

    blank_pictures(monkeypatch)
    _, found, _ = run(capsys, *words, "--json", "--report", tmp_path / "report")
    assert (tmp_path / "report" / "report.html").is_file()
    code, again, _ = run(capsys, *shlex.split(command), "--json")
    assert code == 0
    assert json.loads(again)["criteria"] == json.loads(found)["verdict"]["criteria"]
    assert json.loads(found)["command"] == f"threadline {command}"
    assert json.loads(found)["limited_by"] == "range"


@pytest.mark.parametrize("extra", [["--contour", "0.4 mm"], ["--feed-forward"]])
def test_the_fastest_of_optimal_is_a_plan_that_prove_makes_again(
    examples: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str], extra: list[str],
) -> None:  # fmt: skip
    """No feed is searched; the limits alone are said, and the report is that of the plan.

    It is drawn in the first case.
    """
    if extra == ["--feed-forward"]:
        blank_pictures(monkeypatch)
    words = ["fastest", examples / "x-180.prg", "-m", "lathe-winder", "--interpolation", "optimal"]
    code, out, _ = run(capsys, *words, *extra, "--json", "--report", tmp_path)
    found = json.loads(out)
    assert code == 0
    assert (tmp_path / "report-limits.svg").exists()
    assert 0.1 < found["binds"]["voltage"] < 1.0
    assert ("lag" in found["binds"]) == ("--contour" in extra)
    assert found["tried"] == 1
    own, driven = found["bounds"]
    assert own["duration_s"] < driven["duration_s"] < found["duration_s"]

    code, again, _ = run(capsys, *shlex.split(found["command"])[1:], "--json")
    assert code == 0
    assert json.loads(again)["duration_s"] == found["duration_s"]
    assert json.loads(again)["criteria"] == found["verdict"]["criteria"]


def test_a_margin_is_kept_free_of_every_limit_of_the_specification(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The whole window is in spec; with a fifth kept free it ends where the error is 4/5 of it."""
    job = tmp_path / "turn.prg"
    job.write_text("G91\nG1 X25.714 F2160\nG1 X-25.714\nM30\n")
    words = ["fastest", job, "-m", "lathe-winder", "--interpolation", "linear"]
    words += ["--low", "29 mm/s", "--high", "33 mm/s", "--json"]
    _, out, _ = run(capsys, *words)
    assert json.loads(out)["limited_by"] == "range"
    code, out, _ = run(capsys, *words, "--margin", "20 %")
    found = json.loads(out)
    assert (code, found["margin"], found["limited_by"]) == (0, 0.2, "contour_error")

    for factor, within in ((1.0, True), (1.03, False)):
        feed = f"{factor * found['best']!r} m/s"
        _, out, _ = run(capsys, "prove", *words[1:6], "--feed", feed, "--json")
        proof = json.loads(out)
        worst = {c["name"]: c for c in proof["criteria"]}["contour_error"]
        assert proof["passed"]
        assert worst["limit"] == 0.5e-3
        assert (worst["measured"] <= 0.8 * worst["limit"]) is within


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
    """A copy is no second run, and another feed's plan says nothing of what was run."""
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


def test_prove_says_how_many_points_auto_added(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One on either side of each of the two corners: a square's three sides."""
    job = tmp_path / "corners.prg"
    job.write_text("O1\nG91 G1 X50 F600\nY50\nX-50\nM30\n")
    _, out, _ = run(capsys, "prove", job, "-m", "lathe-winder")
    assert re.search(r"^Points added: +4 \(", out, re.MULTILINE)
    _, out, _ = run(capsys, "prove", job, "-m", "lathe-winder", "--interpolation", "linear")
    assert "Points added" not in out


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


@pytest.mark.parametrize(
    ("mode", "length_mm"),
    [
        (None, 100.0),  # of the fastest axis: 1 rad of A at 100 mm
        ("fastest-axis", 100.0),
        ("base-axes:A", 100.0),  # CADFIL's mode 1
        ("base-axes:A,X", np.hypot(100.0, 50.0)),  # CADFIL's mode 2
        ("base-axes:X", 50.0),
        ("path", np.hypot(50.0, 20.0)),
    ],
)
def test_what_f_means_can_be_chosen(
    mode: str | None, length_mm: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A move takes its length, counted as the mode says, over F: docs/part-programs.md."""
    job, trace = tmp_path / "wind.prg", tmp_path / "wind.npz"
    job.write_text("O1\nG91 G1 A57.29577951 X50 Y20 F600\nM30\n")
    chosen = [] if mode is None else ["--feed-mode", mode]
    common = ["-m", "lathe-winder", "--interpolation", "linear", "--json"]
    _, first, _ = run(capsys, "prove", job, *common, *chosen, "--nominal", "--recording", trace)
    _, second, _ = run(capsys, "judge", trace, "--json")

    # 600 mm/min is 10 mm/s; linear takes whole ticks of 5 ms.
    assert json.loads(first)["duration_s"] == pytest.approx(length_mm / 10.0, abs=0.0051)
    assert json.loads(second)["criteria"] == json.loads(first)["criteria"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--feed-mode", "cadfill"], "F cannot be read as 'cadfill'"),
        (["--feed-mode", "base-axes"], "base axes go with the feed mode base-axes"),
        (["--feed-mode", "base-axes:Q"], "the base axis 'Q' is not one of"),
        (["--feed-mode", "path", "--feed", "10 mm/s"], "--feed '10 mm/s' replaces every F"),
    ],
)
def test_a_meaning_that_f_cannot_have_is_refused(
    options: list[str], said: str, examples: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run(capsys, "prove", examples / "x-180.prg", "-m", "lathe-winder", *options)
    assert (code, out) == (2, "")
    assert said in err


def test_a_trace_of_another_controller_is_judged_or_says_what_it_lacks(
    examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same run as time and positions alone: the same contour error, or none and why."""
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
    columns = np.stack([times, *(recording.samples(f"{axis}.load")[1] for axis in "AXY")], axis=1)
    lines = [";".join(map(repr, row)) for row in columns.tolist()]
    judged = {}
    for kind in (".load", ""):
        head = f"time [s];A{kind} [rad];X{kind} [m];Y{kind} [m]"
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
        if kind:
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


def test_report_and_table_files(
    examples: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, _ = run(
        capsys,
        "prove",
        examples / "x-180.prg",
        "-m",
        "lathe-winder",
        "--interpolation",
        "linear",
        "--report",
        tmp_path / "report",
    )
    assert code == 0
    page = (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
    assert "IN SPEC" in page
    assert page.count("<svg") == 2  # the profile of X and the errors: nothing else has a shape
    assert "src=" not in page  # self-contained
    assert load_machine("lathe-winder").sha256 in page
    assert (tmp_path / "report" / "report.pdf").read_bytes().startswith(b"%PDF")
    assert (tmp_path / "report" / "report-profile-X.png").stat().st_size > 10_000
    assert [p.name for p in tmp_path.iterdir()] == ["report"]
    assert "report.html" in out


def test_help_has_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    for command in ("prove", "compare", "fastest", "compile", "judge"):
        code, out, _ = run(capsys, command, "--help")
        assert code == 0
        assert f"Example: threadline {command}" in " ".join(out.split())


def test_help_and_face_name_every_target(capsys: pytest.CaptureFixture[str]) -> None:
    """Of every kind of machine: a target that nobody is told of is used by nobody."""
    _, out, _ = run(capsys, "compile", "--help")
    for told in (out, str(compile_job.__doc__)):
        assert set(target_names()) <= set(re.findall(r"\w+", told))

"""A machine with limits alone: limits and time are judged, and no position is invented."""

from __future__ import annotations

import json
import math
import random
import re
from pathlib import Path

import pytest

import threadline as tl
from tests.blank_pictures import blank_pictures
from tests.cli.test_commands import run
from threadline.cli.from_settings import settings_files
from threadline.cli.main import main
from threadline.errors import MachineError, OptionError
from threadline.files import ChannelKind
from threadline.jobs import read_job
from threadline.machine import Machine, load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import REPEATED, TOLERANCES, Proof, prove, yielding
from threadline.report.lines import feed_lines
from threadline.search.paced import Effort, searching_with
from threadline.verdict import Status, closing, load_spec
from threadline.verdict.types import Level

MACHINE = """name = "limits"
title = "two axes of which limits alone are known"
sources = ["assumed"]
tick_budget = "1e9 tick exact, assumed"
[clocks]
pulse = "1 ms exact, assumed"
[programs]
dialect = "grbl"
[planner]
kind = "grbl"
junction_deviation = "0.01 mm exact, assumed"
[drives.x]
kind = "kinematic"
clock = "pulse"
[drives.a]
kind = "kinematic"
clock = "pulse"
[axes.A]
kind = "rotary"
drive = "a"
counts = "100 count/deg exact, assumed"
velocity = "900 deg/s exact, assumed"
acceleration = "60 rad/s^2 exact, assumed"
endless = true
[axes.X]
kind = "linear"
drive = "x"
counts = "800 count/mm exact, assumed"
velocity = "100 mm/s +- 5 %, assumed"
acceleration = "500 mm/s^2 exact, assumed"
travel = ["-500 mm exact, assumed", "500 mm exact, assumed"]
[tool]
radius = "50 mm exact, assumed"
"""
PLACE = """name = "place"
[[criteria]]
name = "contour_error"
limit = "0.5 mm"
"""


def files(folder: Path, program: str, machine: str = MACHINE) -> tuple[Path, Path]:
    """Return a machine file and a job."""
    (folder / "limits.toml").write_text(machine)
    (folder / "job.gcode").write_text(f"G21\nG90\n{program}\n")
    return folder / "limits.toml", folder / "job.gcode"


def proof_of(folder: Path, program: str, options: Options, machine: str = MACHINE) -> Proof:
    file, job = files(folder, program, machine)
    chosen = load_machine(file)
    return prove(job, chosen, load_spec(None, chosen), options, trials=REPEATED)


def broken(folder: Path, old: str, new: str) -> MachineError:
    assert old in MACHINE
    file, _ = files(folder, "G1 X1 F100", MACHINE.replace(old, new))
    with pytest.raises(MachineError) as caught:
        load_machine(file)
    return caught.value


def test_a_machine_file_of_limits_alone_is_read(tmp_path: Path) -> None:
    machine = load_machine(files(tmp_path, "")[0])
    assert machine.without_dynamics and machine.takes_positions
    assert machine.moving == {"A": "kinematic", "X": "kinematic"}
    assert float(machine.tick_clock.period_s) == 1e-3
    assert machine.velocity_limit.tolist() == pytest.approx([5.0 * math.pi, 0.1])
    for other in ("stepper-winder", "lathe-winder", "letter-placer", "schiffli-frame"):
        assert not load_machine(other).without_dynamics, other


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ('drive = "x"\n', 'drive = "x"\nload = { x = "1 exact, assumed" }\n', 28, "axes.X.load"),
        ('drive = "x"\n', 'drive = "x"\nframe = { x = "1 exact, assumed" }\n', 28, "axes.X.frame"),
        ('[drives.x]\nkind = "kinematic"\n', '[drives.x]\nkind = "kinematic"\nbody = "x"\n', 14,
         "unknown key 'drives.x.body'"),
        ('[drives.x]\nkind = "kinematic"\nclock = "pulse"', '[drives.x]\nkind = "kinematic"', 12,
         "'drives.x.clock' is missing"),
        ('clock = "pulse"\n[axes.A]', 'clock = "beat"\n[axes.A]', 17, "'beat'"),
        ("[tool]", '[bodies.x]\nkind = "linear"\ninertia = "1 kg exact, assumed"\n[tool]', 32,
         "[bodies] is not allowed with kinematic drives"),
        ('[drives.x]\nkind = "kinematic"\nclock = "pulse"',
         '[bodies.x]\nkind = "linear"\ninertia = "1 kg exact, assumed"\n[drives.x]\n'
         'kind = "pulse-servo"\nbody = "x"\nclock = "pulse"\nbandwidth = "10 Hz exact, assumed"\n'
         'resolution = "800 count/mm exact, assumed"\ntorque_limit = "9 N exact, assumed"', 15,
         "drives.x: a drive of another kind is not allowed with kinematic drives"),
    ],
)  # fmt: skip
def test_dynamics_are_refused_in_a_machine_of_limits_alone(
    tmp_path: Path, old: str, new: str, line: int, message: str
) -> None:
    """One line: the key, the reason, the file and its line, the remedy."""
    error = broken(tmp_path, old, new)
    assert message in str(error) and "\n" not in str(error)
    assert error.place is not None and error.place.line == line


def test_a_machine_with_motors_still_needs_bodies(tmp_path: Path) -> None:
    error = broken(tmp_path, 'kind = "kinematic"\nclock = "pulse"\n[axes.A]',
                   'kind = "pulse-servo"\nclock = "pulse"\n[axes.A]')  # fmt: skip
    assert "'drives.a.body'" in str(error)
    text = re.sub(r'\[drives\.\w\]\nkind = "kinematic"\nclock = "pulse"\n', "", MACHINE)
    file, _ = files(tmp_path, "", text.replace("[clocks]", "[not_clocks]"))
    with pytest.raises(MachineError):
        load_machine(file)


@pytest.mark.parametrize("interpolation", ["auto", "optimal", "firmware"])
@pytest.mark.parametrize("way_mm", [100.0, 10.0])
def test_the_time_is_that_of_a_trapezoid(tmp_path: Path, interpolation: str, way_mm: float) -> None:
    """From rest to rest: s/v + v/a, and 2 sqrt(s/a) if the speed limit is not reached.

    Planned rows end on whole ticks, hence the tolerance of two ticks of 1 ms; firmwares have no
    such grid.
    """
    v, a, s = 0.1, 0.5, way_mm / 1e3
    expected = s / v + v / a if s >= v * v / a else 2.0 * math.sqrt(s / a)
    options = Options(interpolation=interpolation)
    proof = proof_of(tmp_path, f"G1 X{way_mm:g} F9000", options)
    within_s = 1e-6 if interpolation == "firmware" else 2e-3
    assert proof.plan.duration_s == pytest.approx(expected, abs=within_s)
    assert proof.verdict.passed
    assert proof.verdict.result("velocity", "X").measured == pytest.approx(
        min(v, math.sqrt(s * a)), rel=5e-3
    )


def test_the_twin_makes_no_load_up(tmp_path: Path) -> None:
    proof = proof_of(tmp_path, "G1 X100 F6000\nG1 A90 X0", Options())
    kinds = {channel.name: channel.kind for channel in proof.recording.channels}
    assert kinds == {
        "A.commanded": ChannelKind.COMMANDED,
        "X.commanded": ChannelKind.COMMANDED,
        "operation": ChannelKind.OPERATION,
    }
    time_s, x = proof.recording.samples("X.commanded")
    assert x.max() == pytest.approx(0.1, abs=2e-4)  # the corner is rounded within 0.1 mm
    assert abs(x[-1]) < 1e-9 and time_s[-1] == pytest.approx(proof.plan.duration_s + 0.5, abs=2e-3)
    _, a = proof.recording.samples("A.commanded")
    assert a[-1] == pytest.approx(math.pi / 2.0, abs=1e-4)


def test_the_verdict_says_that_placement_is_not_proven(tmp_path: Path) -> None:
    """No criterion of position is measured, wherever it comes from; the level has its own name."""
    file, job = files(tmp_path, "G1 X100 F6000\nG1 A90 X0")
    machine = load_machine(file)
    spec = tmp_path / "place.toml"
    names = (
        "contour_error", "progress_error", "turning_point_error", "repeatability",
        "tracking_error", "velocity_ripple", "residual_vibration", "settling_time", "step_loss",
        "dac_saturation", "current_peak", "stitch_placement_error", "seam_error",
    )  # fmt: skip
    spec.write_text('name = "place"\n' + "".join(f'[[criteria]]\nname = "{n}"\n' for n in names))
    verdict = prove(job, machine, load_spec(spec, machine), Options(), trials=REPEATED).verdict
    for name in names:
        for result in (r for r in verdict.results if r.name == name):
            assert result.status is Status.NOT_MEASURED, name
            assert result.measured is None and "no dynamics" in result.note, name
    assert verdict.result("path_deviation").measured is not None
    assert verdict.passed and verdict.level is Level.LIMITS and verdict.runs == 1
    assert closing(verdict).startswith(
        "LIMITS KEPT (limits and time alone: placement is not proven, the machine file has no dyn"
    )
    text = PLACE + "required = true\n"
    spec.write_text(text)
    verdict = prove(job, machine, load_spec(spec, machine), Options()).verdict
    assert not verdict.passed
    assert closing(verdict).startswith("NOT PROVEN (limits and time alone: placement is not")


def test_a_recording_of_the_real_machine_is_judged_by_what_it_holds(tmp_path: Path) -> None:
    """Measured loads are positions: then the level is the usual one of runs."""
    file, job = files(tmp_path, "G1 X10 F600")
    machine = load_machine(file)
    proof = prove(job, machine, load_spec(None, machine), Options())
    time_s, x = proof.recording.samples("X.commanded")
    measured = tmp_path / "measured.csv"
    rows = "".join(
        f"{t!r},0,{1e3 * p!r}\n" for t, p in zip(time_s.tolist(), x.tolist(), strict=True)
    )
    measured.write_text("time [s],A.load [deg],X.load [mm]\n" + rows)
    (tmp_path / "place.toml").write_text(PLACE)
    verdict = tl.judge(measured, job=job, machine=str(file), spec=tmp_path / "place.toml").verdict
    assert verdict.level is Level.NOMINAL
    assert verdict.result("contour_error").measured is not None


def test_the_time_of_the_motion_comes_first(tmp_path: Path) -> None:
    """The time by F alone, which no machine can keep, comes after it."""
    text = "\n".join(feed_lines(proof_of(tmp_path, "G1 X20 F600\nG1 X0", Options()).plan))
    match = re.search(r"^Time: +([\d.]+) s .* as planned; ([\d.]+) s by F alone", text, re.M)
    assert match is not None and 4.0 == float(match[2]) < float(match[1])


def test_a_plan_of_the_firmware_says_which_limits_it_does_not_keep(tmp_path: Path) -> None:
    """Its velocity steps at corners, as its setting for corners says, so this is no failure."""
    verdict = proof_of(
        tmp_path, "G1 X20 A90 F600\nG1 X0", Options(interpolation="firmware")
    ).verdict
    assert verdict.passed and verdict.result("acceleration", "X").limit is None
    assert closing(verdict).startswith("LIMITS KEPT (limits and time alone: placement")
    assert closing(verdict).endswith(
        "; corners jump in speed, as on the controller, beyond limits of acceleration and jerk)"
    )
    kept = proof_of(tmp_path, "G1 X20 A90 F600\nG1 X0", Options(interpolation="auto")).verdict
    assert "corners jump" not in closing(kept) and kept.result("acceleration", "X").limit == 0.5


def test_limits_that_are_broken_are_out_of_spec(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Chords at programmed times step in velocity, and F may be too fast: exit status 1."""
    file, job = files(tmp_path, "G1 X20 F600")
    verdict = proof_of(tmp_path, "G1 X20 F600", Options(interpolation="linear")).verdict
    assert {r.name for r in verdict.results if r.status is Status.FAILED} == {"acceleration"}
    file, job = files(tmp_path, "G1 X100 F9000")
    code, out, _ = run(capsys, "prove", job, "-m", file, "--interpolation", "linear")
    assert code == 1
    assert "OUT OF SPEC (limits and time alone: placement is not proven" in out
    assert "Asked:                the limits of the machine file, which has no spec" in out


def test_json_exit_and_report_say_the_level(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    blank_pictures(monkeypatch)
    file, job = files(tmp_path, "G1 X50 F3000\nG1 A90 X0")
    report = tmp_path / "report"
    code, out, _ = run(capsys, "prove", job, "-m", file, "--json", "--report", report)
    answer = json.loads(out)
    assert code == 0 and answer["passed"] is True
    assert answer["level"] == "limits and time alone" and answer["runs"] == 1
    page = (report / "report.html").read_text()
    assert "limits and time alone: placement is not proven" in page
    assert ">IN SPEC<" not in page and "actual" not in page.split("<svg")[0].lower()
    drawn = {path.stem for path in report.glob("*.png")}
    assert drawn == {f"report-{n}" for n in ("path-AX", "profile-A", "profile-X", "criteria")}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["prove", "JOB", "-m", "M", "--tolerances"], "has no dynamics"),
        (["prove", "JOB", "-m", "M", "--yield", "99 %"], "has no dynamics"),
        (["prove", "JOB", "-m", "M", "--actual", "M"], "has no dynamics"),
        (["prove", "JOB", "-m", "M", "--feed-forward"], "drives.a receives positions"),
        (["prove", "JOB", "-m", "M", "--interpolation", "optimal", "--contour", "0.1 mm"],
         "drives.a receives positions"),
        (["fastest", "JOB", "-m", "M", "--tolerances"], "has no dynamics"),
        (["yield", "JOB", "-m", "M"], "has no dynamics"),
        (["design", "JOB", "-m", "M"], "what a change of its parts would do cannot"),
        (["analyse", "M"], "has no dynamics"),
        (["analyse", "M", "--experiments"], "--experiments needs a loop"),
    ],
)  # fmt: skip
def test_command_that_needs_dynamics_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    file, job = files(tmp_path, "G1 X10 F600")
    given = [{"JOB": str(job), "M": str(file)}.get(word, word) for word in words]
    code, out, err = run(capsys, *given)
    assert code == 2 and not out and message in err
    assert len(err.strip().splitlines()) == 1


def test_trials_of_other_machines_are_refused_from_python(tmp_path: Path) -> None:
    file, job = files(tmp_path, "G1 X10 F600")
    machine: Machine = load_machine(file)
    for trials in (TOLERANCES, yielding(0.9)):
        with pytest.raises(OptionError, match="no dynamics"):
            prove(job, machine, load_spec(None, machine), Options(), trials=trials)


def test_the_fastest_optimal_plan_is_that_of_the_limits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without loops, a contour, a reserve or feed-forward would have no meaning."""
    file, job = files(tmp_path, "G1 X100 F600")
    words = ["fastest", job, "-m", file, "--interpolation", "optimal", "--json"]
    with searching_with(Effort(least_plans=2, most_plans=2)):
        code, out, _ = run(capsys, *words)
    found = json.loads(out)
    assert code == 0 and found["verdict"]["level"] == "limits and time alone"
    assert not {"--contour", "--reserve", "--feed-forward"} & set(found["command"].split())


def test_hostile_files_of_limits_alone_have_one_line_each(tmp_path: Path) -> None:
    """Random keys of other kinds of machines, added or removed: read, or refused in one line."""
    draw = random.Random(13)
    lines = MACHINE.splitlines()
    others = [
        'body = "x"', 'load = { x = "1 exact, assumed" }', "[bodies.x]", 'kind = "stepper"',
        "[links.y]", "[tables]", "[cylinders.Z]", 'kind = "kinematic"', "[shaft]", 'clock = ""',
        "[design]", "[controllers.x]", 'drive = "x"', "[inputs.i]", "drives = 3", "endless = 7",
    ]  # fmt: skip
    file = tmp_path / "hostile.toml"
    for _ in range(400):
        kept = [line for line in lines if draw.random() > 0.05]
        for _ in range(draw.randrange(3)):
            kept.insert(draw.randrange(len(kept)), draw.choice(others))
        file.write_text("\n".join(kept) + "\n")
        try:
            load_machine(file)
        except MachineError as error:
            assert "\n" not in str(error)


@pytest.mark.parametrize("kind", ["kinematic", "pulse-servo"])
def test_seams_are_read_for_machines_without_loops(
    tmp_path: Path, examples: Path, kind: str
) -> None:
    """Two axes whose drives take positions sew; rigid ones have no mode to wait for."""
    head = MACHINE[: MACHINE.index("[programs]")]
    parts = []
    for name in "XY":
        low = name.lower()
        if kind == "kinematic":
            parts.append(f'[drives.{low}]\nkind = "kinematic"\nclock = "pulse"\n')
        else:
            parts.append(
                f'[bodies.{low}]\nkind = "linear"\ninertia = "9 kg exact, assumed"\n'
                f'[drives.{low}]\nkind = "pulse-servo"\nbody = "{low}"\nclock = "pulse"\n'
                'resolution = "800 count/mm exact, assumed"\nbandwidth = "40 Hz exact, assumed"\n'
                'torque_limit = "900 N exact, assumed"\n'
            )
        parts.append(
            f'[axes.{name}]\nkind = "linear"\ndrive = "{low}"\n'
            'counts = "800 count/mm exact, assumed"\nvelocity = "500 mm/s exact, assumed"\n'
            'acceleration = "20 m/s^2 exact, assumed"\n'
            'travel = ["-5 m exact, assumed", "5 m exact, assumed"]\n'
        )
    file = tmp_path / "sewer.toml"
    file.write_text(head + "".join(parts))
    job = read_job(examples / "stitcher-test-path.seam.toml", load_machine(file))
    assert sum(1 for _ in job) > 10


def test_a_proof_of_limits_alone_is_not_verified_as_in_spec(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    limits, job = files(tmp_path, "G1 X20 A90 F1000\nG1 X0")
    proof = tmp_path / "job.proof.json"
    with pytest.raises(SystemExit) as ended:
        main(["prove", str(job), "-m", str(limits), "--proof", str(proof)])
    assert ended.value.code == 0
    capsys.readouterr()
    with pytest.raises(SystemExit) as ended:
        main(["verify", str(proof)])
    output = capsys.readouterr().out
    assert ended.value.code == 0 and "limits kept" in output and "in spec" not in output


@pytest.mark.long(shown_by="test_the_fastest_optimal_plan_is_that_of_the_limits")
@pytest.mark.usefixtures("coarse_scan")
def test_no_lower_acceleration_is_tried_where_none_can_win(tmp_path: Path) -> None:
    """The answer equals the whole search's; a tighter specification is searched in whole."""
    machine, job = files(tmp_path, "G1 X20 A90 F1000\nG1 X0\nG1 X30")
    words = {"interpolation": "auto", "level": "nominal"}
    found = tl.fastest(job, machine, **words)  # type: ignore[arg-type]
    assert [candidate.share for candidate in found.of.candidates] == [1.0]
    (tmp_path / "tight.toml").write_text(
        'name = "gently"\n[[criteria]]\nname = "acceleration"\naxis = "X"\nlimit = "200 mm/s^2"\n'
    )
    gently = tl.fastest(job, machine, spec=tmp_path / "tight.toml", **words)  # type: ignore[arg-type]
    assert len(gently.of.candidates) > 1
    (tmp_path / "loose.toml").write_text(
        'name = "any"\n[[criteria]]\nname = "acceleration"\naxis = "X"\nlimit = "1e9 mm/s^2"\n'
    )
    whole = tl.fastest(job, machine, spec=tmp_path / "loose.toml", **words)  # type: ignore[arg-type]
    assert whole.best == found.best and len(whole.of.candidates) > 1
    assert whole.of.best.duration_s == found.of.best.duration_s


def test_the_feed_is_named_above_which_the_job_gets_no_faster(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A triangle of d at a ends at sqrt(d a); with 0.956 of that feed it takes 0.1 % longer."""
    machine, job = files(tmp_path, "G1 X2 F60")
    axis = load_machine(machine).axes["X"]
    peak = math.sqrt(2e-3 * axis.acceleration.si)
    assert peak < 0.5 * axis.velocity.si  # the limit of velocity is out of reach
    found = tl.fastest(job, machine, interpolation="auto", level="nominal").of
    assert found.enough is not None and found.best.found.best is not None
    assert found.best.found.tried == 2
    assert 0.95 * peak < found.enough < 1.0 * peak < found.best.found.best
    code, out, _ = run(capsys, "fastest", job, "-m", machine, "--interpolation", "auto")
    assert code == 0 and "takes the same time within 0.1 %: above it acceleration" in out
    assert "limited by acceleration, corners and rapid moves; " in out
    assert "velocity limits" not in out  # relative accuracy of the feed, not of the time


@pytest.mark.parametrize(
    ("dwell_s", "limit"),
    [
        (150.0, r"dwells \(100 % of the time\); "),
        (0.1, r"dwells \(\d+ % of the time\), acceleration, corners and rapid moves; "),
    ],
)
def test_dwells_limit_a_job_that_waits(
    dwell_s: float, limit: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Plotter files wait 150 ms for the pen, and grbl waits 150 s: both are reported."""
    machine, job = files(tmp_path, f"G1 X2 F6000\nG4 P{dwell_s:g}\nG1 X0\nG4 P{dwell_s:g}")
    code, out, err = run(capsys, "fastest", job, "-m", machine, "--interpolation", "firmware")
    assert code == 0 and re.search(f"limited by {limit}", out)
    text = f"this G4 waits {dwell_s:g} s (1 more line waits as long): grbl takes P as seconds"
    assert (text in err and "write P0.15." in err) == (dwell_s > 20.0)
    code, out, _ = run(capsys, "prove", job, "-m", machine, "--interpolation", "firmware")
    assert f"; {2.0 * dwell_s:g} s of both are dwells" in out


def test_small_helices_keep_the_acceleration(tmp_path: Path) -> None:
    """On symmetric pieces only the begin of a part reached the limit, and rounding decided.

    A pocket's entry with a radius of 0.175 mm was planned 7 % above the acceleration, and refused.
    """
    dump = "".join(
        f"${100 + k}={20 if k < 2 else 200}\n${110 + k}={15000 if k < 2 else 600}\n"
        f"${120 + k}=400\n${130 + k}=2000\n"
        for k in range(3)
    )
    (tmp_path / "dump.txt").write_text(dump)
    for name, content in settings_files("grbl", tmp_path / "dump.txt", []).contents.items():
        (tmp_path / name).write_bytes(content)
    turns = "\n".join(
        f"G3 X{135.825 if k % 2 else 136.175} Y35 Z{-0.25 * k} I{-0.175 if k % 2 else 0.175} J0"
        for k in range(1, 14)
    )
    lead = "G1 X136 Y34 Z1 F1000\nX136.121 Y34.919\nX136.149 Y34.938\nX136.168 Y34.967"
    job = files(tmp_path, f"{lead}\nX136.175 Y35\n{turns}")[1]
    proof = tl.prove(job, tmp_path / "machine.toml", interpolation="auto", level="nominal")
    used = [one for one in proof.verdict.results if one.name == "acceleration"]
    assert proof.passed and all(one.measured <= 1.0001 * one.limit for one in used)

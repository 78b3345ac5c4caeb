"""``threadline fit``: the written machine file, known combinations, wrong input."""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest

from threadline.cli.main import main
from threadline.machine import load_machine
from threadline.machine.numbers import number_at

from . import forward

LOAD = "links.x_belt.stiffness,bodies.x_head.inertia,bodies.x_head.damping,drives.x.delay"
MOTOR = "bodies.x_motor.inertia,bodies.x_motor.damping,drives.x.amplifier.gain"
OFF = """base = "stitcher"
name = "off"
[links.x_belt]
stiffness = "4.4e5 N/m +- 20 %, assumed"
[bodies.x_head]
inertia = "144 kg +- 10 %, assumed"
damping = "2331 N s/m +- 20 %, assumed"
[bodies.x_motor]
inertia = "6.2e-4 kg m^2 +- 5 %, assumed"
damping = "0.17 N m s/rad +- 10 %, assumed"
[drives.x]
delay = "3.9 ms +- 10 %, assumed"
[drives.x.amplifier]
gain = "28 +- 5 %, assumed"
"""


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as left:
        main(["fit", *map(str, arguments)])
    out = capsys.readouterr()
    return left.value.code or 0, out.out, out.err


def sweep(path, seed=1, loaded=True, unit="rad/s/V", **numbers):
    speed = forward.stitcher_x(loaded=loaded, **numbers) * forward.S
    return write(path, speed, seed, unit)


def write(path, response, seed=1, unit="rad/s/V", head="# axis: X\n"):
    return forward.write_csv(path, forward.noisy(response, seed), unit, head)


def test_from_a_file_that_is_30_percent_off_two_sweeps_give_every_number(capsys, tmp_path):
    """As in the thesis: the motor uncoupled, then loaded; here both at once."""
    (tmp_path / "off.toml").write_text(OFF)
    out_file = tmp_path / "mine.toml"
    code, out, err = run(
        capsys,
        sweep(tmp_path / "loaded.csv"),
        f"+unloaded:{sweep(tmp_path / 'motor.csv', 2, loaded=False)}",
        "-m",
        tmp_path / "off.toml",
        "--numbers",
        f"{LOAD},{MOTOR}",
        "-o",
        out_file,
    )
    assert (code, err) == (0, "")
    assert "The fit explains the data everywhere within its noise" in out
    fitted, true = load_machine(str(out_file)), load_machine("stitcher")
    for name in f"{LOAD},{MOTOR}".split(","):
        found = number_at(fitted, name)
        assert found.provenance.value == "measured"
        # The tolerance is a 95 % interval, so the truth is within 1.6 of it in 99.8 of 100 files.
        assert abs(found.si - number_at(true, name).si) < 1.6 * found.tolerance_si
        assert 0.001 < found.tolerance_si / found.si < 0.06


def test_fit_compares_the_fastest_before_and_after_for_a_job(capsys, tmp_path, monkeypatch):
    """The search itself is tested elsewhere, and takes minutes over the tolerances."""
    asked = []

    def fastest(job, machine, **words):
        asked.append((str(job), machine, words))
        return SimpleNamespace(best=0.1 * len(asked), unit="m/s")

    monkeypatch.setattr("threadline.face.fastest", fastest)
    out_file = tmp_path / "mine.toml"
    words = (sweep(tmp_path / "x.csv"), "-m", "stitcher", "--numbers", LOAD, "--job", "path.toml")
    code, out, _ = run(capsys, *words, "-o", out_file)
    assert code == 0
    assert "path.toml over the tolerances: 0.1 m/s before the fit, 0.2 m/s after it" in out
    level = {"level": "over tolerances"}
    assert asked == [("path.toml", "stitcher", level), ("path.toml", str(out_file), level)]
    code, _, err = run(capsys, *words)
    assert code == 2 and "--job needs the fitted machine as a file" in err


def test_json_has_intervals_bounds_and_correlations(capsys, tmp_path):
    file = sweep(tmp_path / "x.csv")
    code, out, _ = run(capsys, file, "-m", "stitcher", "--numbers", LOAD, "--json")
    content = json.loads(out)
    assert code == 0 and list(content["numbers"]) == LOAD.split(",")
    for number in content["numbers"].values():
        assert number["interval"][0] < number["value"] < number["interval"][1]
        assert number["deviation"] == pytest.approx(number["least_deviation"], rel=0.1)
    assert content["noise"] == {"x.csv": pytest.approx(0.02, rel=0.15)}
    assert len(content["correlation"]) == 4


def test_numbers_that_only_act_together_are_refused_by_the_name_of_their_combination(
    capsys, tmp_path
):
    """The coil can be told apart, but a motor's constants scale each other."""
    numbers = f"{MOTOR},drives.x.torque_constant,drives.x.back_emf"
    file = tmp_path / "no.toml"
    data = sweep(tmp_path / "x.csv", loaded=False)
    arguments = (f"+unloaded:{data}", "-m", "stitcher", "--numbers", numbers, "-o", file)
    code, out, err = run(capsys, *arguments)
    assert code == 2 and not out and err.count("\n") == 1 and not file.exists()
    assert "5 numbers, but the data determines only" in err
    assert "drives.x.torque_constant" in err and "Leave out 2 of the 5 numbers" in err


def test_a_gain_needs_an_absolute_magnitude(capsys, tmp_path):
    relative = sweep(tmp_path / "x.csv", unit="")
    code, _, err = run(
        capsys, relative, "-m", "stitcher", "--numbers", f"{LOAD},drives.x.amplifier.gain"
    )
    assert code == 2 and "or give responses with an absolute magnitude" in err
    code, out, _ = run(capsys, relative, "-m", "stitcher", "--numbers", LOAD)
    assert code == 0 and "Fitted to x.csv" in out


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ("links.x_belt.stifness", "has no number 'links.x_belt.stifness'. Did you mean"),
        ("links.x_belt.stiffness,links.x_belt.stiffness", "is named twice"),
        ("axes.X.counts", "axes.X.counts cannot be fitted"),
        ("controllers.x.dac.bits", "cannot be fitted"),
        ("links.x_belt.damping", "has no number"),
        (
            "links.y_belt.stiffness",
            "the data tells nothing of links.y_belt.stiffness. Name",
        ),
        (" ,", "no number is named"),
    ],
)
def test_numbers_that_cannot_be_fitted_are_one_line(capsys, tmp_path, numbers, message):
    file = sweep(tmp_path / "x.csv")
    code, out, err = run(capsys, file, "-m", "stitcher", "--numbers", numbers)
    assert code == 2 and message in err and err.count("\n") == 1 and not out


def test_more_numbers_than_data_are_refused(capsys, tmp_path):
    file = tmp_path / "few.csv"
    file.write_text("# axis: X\nfrequency_hz,magnitude [rad/s/V],phase_deg\n2,40,-2\n")
    code, _, err = run(capsys, file, "-m", "stitcher", "--numbers", LOAD)
    assert code == 2 and "4 numbers cannot be fitted to 2 values" in err


@pytest.mark.parametrize(
    ("head", "row", "message"),
    [
        ("magnitude [rad/s],phase_deg", "40,-2", "'rad/s' is not an output per volt"),
        ("magnitude [kg/V],phase_deg", "40,-2", "'kg/V' is not an output per volt"),
        ("magnitude [m/s/V],phase_deg", "-1,-2", "magnitude -1 is not above 0"),
        ("magnitude_db,phase_deg", "99999,-2", "magnitude inf at 2 Hz is not from 1e-100"),
        ("magnitude [m/s/V],phase_deg", "5e-324,-2", "at 2 Hz is not from 1e-100 to 1e+100"),
        ("magnitude_db,phase_deg,coherence", "1,-2,1.5", "coherence 1.5 is not from 0 to 1"),
        ("magnitude_db,phase_deg,coherence", "1,-2", "does not hold four numbers"),
        ("magnitude_db,phase_deg,coherence", "1,-2,0.5", "1 of 1 points have a coherence below"),
        ("magnitude [count/s/V],phase [rad]", "40,-2", "X.load is in m"),
        ("magnitude_db [V/V],phase [rad]", "40,-2", "X.load is in m"),
    ],
)
def test_wrong_responses_are_one_line(capsys, tmp_path, head, row, message):
    file = tmp_path / "x.csv"
    file.write_text(f"# axis: X\n# output: X.load\nfrequency_hz,{head}\n2,{row}\n")
    code, out, err = run(capsys, file, "-m", "stitcher", "--numbers", LOAD)
    assert code == 2 and message in err and err.count("\n") == 1 and not out


@pytest.mark.parametrize(
    ("head", "message"),
    [
        ("", "does not name its axis, and stitcher has X, Y"),
        ("# axis: Q\n", "has no axis 'Q' with a control loop"),
        ("# axis: X\n# output: sensors.q\n", "has no output 'sensors.q'"),
        ("# axis: X\n# output: sensors.y\n", "sensors.y does not move with drives.x"),
    ],
)
def test_an_axis_or_output_that_is_not_there_is_named(capsys, tmp_path, head, message):
    file = tmp_path / "x.csv"
    forward.write_csv(file, forward.stitcher_x(), "count/V", head)
    code, _, err = run(capsys, file, "-m", "stitcher", "--numbers", LOAD)
    assert code == 2 and message in err and err.count("\n") == 1


def test_a_response_is_read_in_any_unit_and_separator(capsys, tmp_path):
    """The same sweep in degrees, rad/s of frequency, dB and semicolons gives the same numbers."""
    value = forward.noisy(forward.stitcher_x() * forward.S, 1)
    rows = zip(
        (2 * 3.141592653589793 * forward.HERTZ).tolist(),
        value.tolist(),
        strict=True,
    )
    import cmath

    text = "".join(
        f"{cmath.phase(v)!r};{20 * cmath.log10(abs(v) * 180 / cmath.pi).real!r};{w!r}\n"
        for w, v in rows
    )
    other = tmp_path / "other.csv"
    other.write_text(
        "# axis: X\n# output: motor\nphase [rad];magnitude_db [deg/s/V];frequency [rad/s]\n" + text
    )
    usual = forward.write_csv(tmp_path / "x.csv", value)
    found = []
    for file in (usual, other):
        _, out, _ = run(capsys, file, "-m", "stitcher", "--numbers", LOAD, "--json")
        found.append([n["value"] for n in json.loads(out)["numbers"].values()])
    assert found[0] == pytest.approx(found[1], rel=1e-6)

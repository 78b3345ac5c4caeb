"""``threadline measure``: predicted limits, the response of a sweep, a broken link, and its fit."""

from __future__ import annotations

import json

import numpy as np
import pytest

import threadline as tl
from threadline.cli.main import main
from threadline.errors import OptionError, Place, RecordingError
from threadline.files.formats import read_recording
from threadline.identify.experiment_run import response_of
from threadline.machine import load_machine
from threadline.machine.numbers import number_at

OFF = """base = "lathe-winder"
name = "off"
[bodies.x]
inertia = "4.7e-4 kg m^2 +- 30 %, assumed"
[drives.x.amplifier]
gain = "0.315 +- 30 %, assumed"
"""
STICKS = """base = "lathe-winder+stiction"
name = "sticks"
[bodies.x]
friction = "0.065 N m +- 30 %, assumed"
stiction = "0.08 N m +- 30 %, assumed"
"""


def run(capsys, *arguments):
    with pytest.raises(SystemExit) as left:
        main([*map(str, arguments)])
    out = capsys.readouterr()
    return left.value.code or 0, out.out, out.err


def winder_plant(hertz):
    """Return X of the winder from its printed numbers: counts per volt of the controller."""
    s = 2j * np.pi * hertz
    J, Kt, Ke, R = 3.606e-4, 0.082, 8.6 * 60 / (2 * np.pi * 1000), 0.4
    return 4000 / (2 * np.pi) * 0.45 * Kt / (R * J) / (s * (s + Kt * Ke / (R * J)))


@pytest.mark.usefixtures("forked_machine")
def test_from_a_file_that_is_30_percent_off_to_one_that_agrees(capsys, tmp_path, monkeypatch):
    """Measure over the link, fit, and analyse: the whole chain, as in a workshop."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "off.toml").write_text(OFF)
    sweep = ("--axis", "X", "--band", "1 Hz, 20 Hz", "--actual", "lathe-winder", "-o", "x.npz")
    code, out, err = run(capsys, "measure", "off.toml", *sweep, "--json")
    assert (code, err) == (0, "")
    answer = json.loads(out)
    assert set(answer["predicted"]) == {"duration_s", "lowest", "highest", "speed", "current_a"}
    found = response_of(read_recording("x.npz").origin)
    assert found is not None and found.coherence.min() > 0.99
    assert answer["response"]["frequency_hz"] == found.frequency_hz.tolist()
    plant = winder_plant(found.frequency_hz)
    slow = found.frequency_hz < 8.0  # above it, aliases at 200 Hz reach a percent
    assert np.abs(found.value / plant - 1.0)[slow].max() < 0.015
    stiffness = ("--numbers", "links.x_belt.stiffness")
    code, _, err = run(capsys, "fit", "response:x.npz", "-m", "stitcher", *stiffness)
    assert code == 2 and "a sample each 5 ms, but the tick of stitcher is 1 ms" in err
    numbers = "bodies.x.inertia,drives.x.amplifier.gain"
    for data in ("x.npz", "response:x.npz"):
        code, _, _ = run(
            capsys, "fit", data, "-m", "off.toml", "--numbers", numbers, "-o", "fitted.toml"
        )
        assert code == 0
        fitted, true = load_machine("fitted.toml"), load_machine("lathe-winder")
        for name in numbers.split(","):
            assert number_at(fitted, name).si == pytest.approx(number_at(true, name).si, rel=0.01)
    margins = []
    for machine in ("fitted.toml", "lathe-winder", "off.toml"):
        _, out, _ = run(capsys, "analyse", machine, "--axis", "X", "--json")
        margins.append(json.loads(out)["axes"]["X"]["bandwidth_hz"])
    assert margins[0] == pytest.approx(margins[1], rel=0.01)
    assert margins[2] != pytest.approx(margins[1], rel=0.1)


@pytest.mark.usefixtures("forked_machine")
@pytest.mark.long(shown_by="test_from_a_file_that_is_30_percent_off_to_one_that_agrees")
def test_friction_and_stiction_are_found_from_slow_reversals(capsys, tmp_path, monkeypatch):
    """Within 10 %; fast moves do not show stiction, because a body breaks away at once."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sticks.toml").write_text(STICKS)
    slow = ("--axis", "X", "--experiment", "backlash", "--amplitude", "20 mm", "-o", "x.npz")
    code, out, _ = run(capsys, "measure", "lathe-winder+stiction", *slow)
    assert code == 0 and "backlash of X in" in out and "Wrote x.npz" in out
    numbers = ("bodies.x.friction", "bodies.x.stiction")
    code, out, _ = run(
        capsys, "fit", "x.npz", "-m", "sticks.toml", "--numbers", ",".join(numbers), "--json"
    )
    assert code == 0
    for name, true in zip(numbers, (0.05, 0.06), strict=True):
        assert json.loads(out)["numbers"][name]["value"] == pytest.approx(true, rel=0.1)


@pytest.mark.long(shown_by="test_from_a_file_that_is_30_percent_off_to_one_that_agrees")
def test_the_same_from_python(tmp_path):
    (tmp_path / "off.toml").write_text(OFF)
    file, out = tmp_path / "x.npz", tmp_path / "fitted.toml"
    found = tl.measure(tmp_path / "off.toml", "X", file, band="2 Hz, 20 Hz", actual="lathe-winder")
    assert found.response is not None and len(found.response.value) > 5
    numbers = ["bodies.x.inertia", "drives.x.amplifier.gain"]
    fitted = tl.fit(file, tmp_path / "off.toml", numbers, out)
    assert [number.name for number in fitted.numbers] == numbers
    assert fitted.numbers[0].value == pytest.approx(3.606e-4, rel=0.015)
    again = number_at(load_machine(str(out)), numbers[0])
    assert again.si == pytest.approx(fitted.numbers[0].value, rel=1e-5)
    with pytest.raises(OptionError, match="has no number"):
        tl.fit(file, "lathe-winder", ["bodies.q.inertia"])


@pytest.mark.usefixtures("forked_machine")
@pytest.mark.parametrize("kind", ["steps", "constant"])
def test_moves_stay_within_a_share_of_the_limits_and_end_where_they_began(capsys, tmp_path, kind):
    file = tmp_path / "x.npz"
    words = ("measure", "lathe-winder", "--axis", "X", "--experiment", kind, "--amplitude", "10 mm")
    code, _, _ = run(capsys, *words, "-o", file)
    assert code == 0
    position = np.concatenate([b.samples["X.commanded"] for b in read_recording(file)])
    assert position[0] == position[-1] == 0.0
    assert np.abs(position).max() == pytest.approx(0.01, abs=2e-5)
    speed = np.diff(position) / 0.005
    assert 0.05 < np.abs(speed).max() < 1.0
    # A count of rounding at each end of a tick.
    assert np.abs(np.diff(speed)).max() / 0.005 < 0.5 * 10.5 + 2 / 55358 / 0.005**2


def test_a_sweep_that_would_leave_the_travel_moves_nothing(capsys, tmp_path):
    file = tmp_path / "x.npz"
    words = ("measure", "lathe-winder", "--axis", "Y", "--experiment", "constant")
    code, out, err = run(capsys, *words, "--amplitude", "60 mm", "-o", file)
    assert code == 2 and not out and not file.exists() and err.count("\n") == 1
    assert "axis Y: the constant would reach a position of" in err
    assert "limit 0.05 m; nothing has moved. Give a smaller --amplitude." in err


def test_without_running_it_says_what_would_move(capsys, tmp_path):
    file = tmp_path / "x.npz"
    code, out, _ = run(capsys, "measure", "stitcher", "--axis", "X", "--dry", "-o", file)
    assert code == 0 and "sweep of X in 12 s: from" in out and not file.exists()
    words = ("measure", "stitcher", "--axis", "X", "--dry", "-o", file, "--json")
    code, out, _ = run(capsys, *words)
    assert code == 0 and json.loads(out)["predicted"]["current_a"] < 27.0


@pytest.mark.usefixtures("forked_machine")
def test_a_link_that_drops_leaves_what_was_recorded(capsys, tmp_path):
    file = tmp_path / "x.npz"
    words = ("measure", "lathe-winder", "--axis", "X", "--band", "1 Hz, 20 Hz", "-o", file)
    code, _, err = run(capsys, *words, "--inject", "lost-link@2.5 s")
    assert code == 3 and "the measurement ended early: the link is gone" in err
    recording = read_recording(file)
    length = sum(len(block.samples["X.measured"]) for block in recording)
    assert 400 <= length <= 525  # 2.5 s of 5 ms, and the braking
    assert response_of(recording.origin) is None
    code, out, _ = run(
        capsys, "fit", file, "-m", "lathe-winder", "--numbers", "bodies.x.inertia", "--json"
    )
    assert code == 0
    value = json.loads(out)["numbers"]["bodies.x.inertia"]["value"]
    assert value == pytest.approx(3.606e-4, rel=0.02)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("lathe-winder", "--axis", "Q"), "has no axis 'Q' with a control loop. It has: A, X, Y"),
        (("stepper-winder", "--axis", "X"), "has no axis 'X' with a control loop"),
        (("lathe-winder", "--axis", "X", "--dry", "--inject", "lost-link"), "inject"),
        (("lathe-winder", "--axis", "X", "--dry", "--actual", "nope"), "no machine 'nope'"),
        (("letter-placer", "--axis", "X"), "has no axis 'X' with a control loop"),
        (("lathe-winder", "--axis", "X", "--experiment", "shake"), "no experiment 'shake'"),
        (("lathe-winder", "--axis", "X", "--band", "20 Hz"), "is not two frequencies"),
        (("lathe-winder", "--axis", "X", "--band", "5 Hz, 2 Hz"), "does not increase"),
        (("lathe-winder", "--axis", "X", "--band", "5 Hz, 90 Hz"), "or goes beyond 80 Hz"),
        (("lathe-winder", "--axis", "X", "--band", "1e-4 Hz, 9 Hz"), "is too long"),
        (("lathe-winder", "--axis", "X", "--amplitude", "0 mm"), "--amplitude is 0"),
        (("lathe-winder", "--axis", "X", "--amplitude", "3 deg"), "does not measure the same"),
        (("lathe-winder", "--axis", "X", "--link", "grbl:x"), "there is no link 'grbl:x'"),
        (("lathe-winder", "--axis", "X", "--actual", "stitcher"), "has other axes than"),
        (
            ("lathe-winder", "--axis", "X", "--experiment", "steps", "--band", "1 Hz, 2 Hz"),
            "a sweep",
        ),
    ],
)
def test_wrong_input_is_one_line_and_writes_nothing(capsys, tmp_path, words, message):
    file = tmp_path / "x.npz"
    code, _, err = run(capsys, "measure", *words, "-o", file)
    assert code == 2 and message in err and err.count("\n") == 1 and not file.exists()


@pytest.mark.usefixtures("forked_machine")
def test_a_response_that_was_not_measured_is_refused(capsys, tmp_path):
    file = tmp_path / "x.npz"
    words = ("measure", "lathe-winder", "--axis", "X", "--experiment", "steps", "-o", file)
    assert run(capsys, *words, "--amplitude", "5 mm")[0] == 0
    words = ("fit", f"response:{file}", "-m", "lathe-winder", "--numbers", "bodies.x.inertia")
    code, _, err = run(capsys, *words)
    assert code == 2 and "x.npz: it has no response" in err


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("frequency_hz", [2.0, 1.0], "frequency 1 Hz does not increase"),
        ("frequency_hz", [-1.0, 1.0], "frequency -1 Hz is not from 1e-06"),
        ("real", [0.0, 0.0], "magnitude 0 at 1 Hz is not from 1e-100"),
        ("real", [10**400, 1.0], "its response is damaged: int too large"),
        ("coherence", [1.0, 7.0], "coherence 7 is not from 0 to 1"),
        ("unit", "furlong/V", "its response is damaged: 'furlong/V' is no output per volt"),
        ("output", 3, "its unit, axis or output is no text"),
        ("output", None, "its response is damaged: 'output' is missing"),
        ("all", [], "the response has no points"),
    ],
)
def test_a_response_that_no_model_can_have_is_refused(key, value, message):
    content = {"frequency_hz": [1.0, 2.0], "real": [3.0, 4.0], "imag": [0.0, 0.0]}
    content |= {"coherence": [1.0, 0.9], "unit": "count/V", "axis": "X", "output": "sensors.x"}
    if key == "all":
        content |= dict.fromkeys(("frequency_hz", "real", "imag", "coherence"), value)
    content[key] = value
    if value is None:
        del content[key]
    with pytest.raises(RecordingError, match=message) as raised:
        response_of({"response": json.dumps(content)}, Place("x.npz"))
    assert str(raised.value).startswith("[RECORDING] x.npz: ") and "\n" not in str(raised.value)


OFF_STITCHER = """base = "stitcher"
name = "off"
[links.x_belt]
stiffness = "4.4e5 N/m +- 30 %, assumed"
[bodies.x_head]
inertia = "144 kg +- 30 %, assumed"
damping = "2331 N s/m +- 30 %, assumed"
[drives.x]
delay = "3.9 ms +- 30 %, assumed"
"""


@pytest.mark.usefixtures("forked_machine")
def test_a_controller_that_is_faster_than_its_references_is_measured_by_its_error(
    capsys, tmp_path, monkeypatch
):
    """The volts are recorded at some ticks only; the error gives belt and load within 3 %."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "off.toml").write_text(OFF_STITCHER)
    words = ("measure", "off.toml", "--axis", "X", "--actual", "stitcher", "-o", "x.npz")
    assert run(capsys, *words)[0] == 0
    found = response_of(read_recording("x.npz").origin)
    s = 2j * np.pi * found.frequency_hz
    # The head behind its belt as seen from the motor, from the printed numbers.
    ratio, k, M, B = 29e-3 / 6, 6.24e5, 111.0, 3330.0
    load = M * s**2 + B * s
    torque = 4.75e-4 * s**2 + 0.24 * s + ratio**2 / (1 / k + 1 / load)
    back_emf = 60 * 60 / (2 * np.pi * 1000)
    plant = 40 / (torque * (0.8 + 4e-3 * s) / 0.5 + back_emf * s) * np.exp(-3e-3 * s)
    apart = np.log(found.value / (8000 / (2 * np.pi) * plant))
    assert np.sqrt(np.mean(np.abs(apart) ** 2)) < 0.02
    numbers = ("links.x_belt.stiffness", "bodies.x_head.inertia", "bodies.x_head.damping",
               "drives.x.delay")  # fmt: skip
    words = ("fit", "response:x.npz", "-m", "off.toml", "--numbers", ",".join(numbers), "--json")
    code, out, _ = run(capsys, *words)
    assert code == 0
    true = load_machine("stitcher")
    for name, one in json.loads(out)["numbers"].items():
        off = one["value"] / number_at(true, name).si - 1.0
        assert abs(off) < 0.03 and abs(off) < 3.0 * one["deviation"]
        assert one["deviation"] < 0.025

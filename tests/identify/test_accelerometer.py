"""Files of accelerometers, the mode in them, and ``threadline shaper --measured``."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.blank_pictures import blank_pictures
from tests.conftest import NO_FIRMWARE
from tests.identify.shaken import (
    RATE_HZ,
    klipper_psd,
    shaken,
    sweep,
    three_axes,
    write_raw,
    write_spectrum,
)
from threadline.base.arrays import FloatArray
from threadline.cli.main import main
from threadline.errors import Place, RecordingError
from threadline.identify.accelerometer import Spectrum, Vibration, read_accelerometer
from threadline.identify.modes import klipper_spectrum, measured_mode
from threadline.motion.shaping.klipper_choice import klipper_choice, klipper_weighted

EXAMPLES = Path(__file__).parents[2] / "examples"


def run(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    """Run ``threadline shaper``; returns exit status, output and errors."""
    with pytest.raises(SystemExit) as stopped:
        main(["shaper", *(str(a) for a in arguments)])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


@pytest.fixture(scope="module")
def command() -> FloatArray:
    return sweep()


def test_the_mode_is_found_with_its_interval(command: FloatArray) -> None:
    """Every frequency is within 1 %; the damping's intervals hold 95 % of 16.

    Fewer than 14 of 16 would have a probability of 4 % at 95 %. Both come from whole runs and from
    Klipper's spectra, whose window widens the peak by up to five times the mode's own width.
    """
    rng = np.random.default_rng(4)
    held = {"run": 0, "spectrum": 0}
    for seed in range(8):
        f, ratio = rng.uniform(25.0, 70.0), np.exp(rng.uniform(np.log(0.02), np.log(0.12)))
        noisy = three_axes(shaken(command, f, ratio), rng.uniform(50.0, 1000.0), seed)
        whole = Vibration(rate_hz=RATE_HZ, acceleration_m_s2=noisy, place=Place("run"))
        for name, data in (("run", whole), ("spectrum", klipper_spectrum(whole))):
            found = measured_mode(data)
            assert found.axis == "x"
            assert found.frequency_hz.value == pytest.approx(f, rel=0.01)
            held[name] += found.damping_ratio.low <= ratio <= found.damping_ratio.high
            assert found.damping_ratio.half_width < 0.2 * ratio
    assert sum(held.values()) >= 14, held


def test_a_second_mode_widens_the_interval(command: FloatArray) -> None:
    """Its tail bends the first peak; it is named, with its height, as another peak."""
    along = shaken(command, 40.0, 0.045) + 0.25 * shaken(command, 75.0, 0.03)
    whole = Vibration(
        rate_hz=RATE_HZ, acceleration_m_s2=three_axes(along, 200.0, 1), place=Place("run")
    )
    found = measured_mode(whole)
    assert found.damping_ratio.low <= 0.045 <= found.damping_ratio.high
    assert found.others[0][0] == pytest.approx(75.0, rel=0.02)


def test_klippers_files_are_read(tmp_path: Path, command: FloatArray) -> None:
    """The raw run, its spectrum, the one with shapers (already divided), and Kalico's, agree."""
    noisy = three_axes(shaken(command, 45.0, 0.08), 100.0, 2)
    f, psd = klipper_psd(noisy)
    divided = psd / (f[:, None] + 0.1)
    files = {
        "raw": write_raw(tmp_path / "raw.csv", noisy),
        "plain": write_spectrum(tmp_path / "plain.csv", f, psd),
        "shapers": write_spectrum(
            tmp_path / "shapers.csv", f, divided, ",shapers:,zv(45.0)", ",,0.500"
        ),
        "kalico": write_spectrum(tmp_path / "kalico.csv", f, psd, ",accel_per_hz", ",60.0"),
    }
    data = {name: read_accelerometer(path) for name, path in files.items()}
    for one in data.values():
        found = measured_mode(one, "x")
        assert found.frequency_hz.value == pytest.approx(45.0, rel=0.01)
        assert found.damping_ratio.value == pytest.approx(0.08, rel=0.05)
    shapers, raw = data["shapers"], data["raw"]
    assert isinstance(shapers, Spectrum)
    assert isinstance(raw, Vibration)
    assert shapers.normalised
    # Lines of the file are rounded to 0.1 Hz.
    own = klipper_spectrum(raw)
    assert own.step_hz == pytest.approx(shapers.step_hz, rel=1e-3)
    np.testing.assert_allclose(own.psd[5:80], 1e-6 * psd[5:80], rtol=2e-3)


@pytest.mark.parametrize(
    ("head", "step"),
    [
        ('"Time (s)","Linear Acceleration x (m/s^2)","Linear Acceleration y (m/s^2)",'
         '"Linear Acceleration z (m/s^2)","Absolute acceleration (m/s^2)"', 1.0),
        ("time (ms),gFx (g),gFy (g),gFz (g)", 1e3),
        ("time,ax (m/s^2),ay (m/s^2),az (m/s^2)", 1.0),
        ("timestamp_us;acc_x;acc_y;acc_z", 1e6),
        ("t,x,y,z", 1.0),
    ],
)  # fmt: skip
def test_a_tap_on_a_phone(tmp_path: Path, head: str, step: float) -> None:
    """Taps ring down; a jitter of a tenth of the step is usual on phones."""
    rng = np.random.default_rng(6)
    rate, f, ratio = 400.0, 12.0, 0.03
    time = np.arange(0.0, 10.0, 1.0 / rate)
    taps = np.zeros(len(time))
    taps[100] = 500.0
    table = np.column_stack(
        [time * step + 0.1 * step / rate * rng.uniform(-1, 1, len(time)),
         three_axes(shaken(taps, f, ratio, rate), 0.02, 3) * [1, 1, 1e-3]]
    )  # fmt: skip
    mark = ";" if ";" in head else ","
    if "Absolute" in head:
        table = np.column_stack([table, np.linalg.norm(table[:, 1:], axis=1)])
    rows = "\n".join(mark.join(f"{cell:.9E}" for cell in row) for row in table.tolist())
    (tmp_path / "phone.csv").write_text(f"{head}\n{rows}\n")
    found = measured_mode(read_accelerometer(tmp_path / "phone.csv"), "x")
    assert found.frequency_hz.value == pytest.approx(f, rel=0.01)
    assert found.damping_ratio.low <= ratio <= found.damping_ratio.high


def test_the_shaper_stands_beside_klippers(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    command: FloatArray,
) -> None:
    """It leaves less of the measured mode than any of Klipper's shapers of its length or less."""
    noisy = three_axes(shaken(command, 45.0, 0.06), 100.0, 2)
    path = write_spectrum(tmp_path / "spectrum.csv", *klipper_psd(noisy))
    blank_pictures(monkeypatch)
    code, out, err = run(
        capsys, "--measured", path, "--axis", "x", "--kind", "mzv", "--klipper", "--json",
        "--report", tmp_path / "report",
    )  # fmt: skip
    assert code == 0, err
    content = json.loads(out)
    seen = content["measured"]
    assert seen["frequency_hz"] == pytest.approx(45.0, rel=0.01)
    assert "shaper_type_x: mzv" in content["klipper"]
    assert "shaper_type_y" not in content["klipper"]
    for one in seen["klipper_tried"]:
        if one["type"] in ("zv", "mzv"):
            assert seen["worst_vibration"] < one["worst_vibration"]
    assert (tmp_path / "report" / "shaper-measured.png").exists()
    code, _, err = run(capsys, "--measured", path, "--axis", "y")
    assert code == 0
    assert "the mode swings along x" in err.replace("\n", " ")


def test_a_spectrum_too_coarse_for_its_damping(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: FloatArray
) -> None:
    """A mode of 0.3 Hz width on lines 1.56 Hz apart is one line; --damping accepts it."""
    f, psd = klipper_psd(three_axes(shaken(command, 30.0, 0.005), 20.0, 2))
    path = write_spectrum(tmp_path / "coarse.csv", f, psd)
    code, out, err = run(capsys, "--measured", path, "--axis", "x")
    assert (code, out) == (2, "")
    assert "too coarse for the damping of a mode at" in " ".join(err.split())
    code, out, _ = run(capsys, "--measured", path, "--axis", "x", "--damping", "0.005", "--json")
    assert code == 0
    assert json.loads(out)["measured"]["frequency_hz"] == pytest.approx(30.0, rel=0.01)


def test_bad_files(tmp_path: Path) -> None:
    """One line each, with the line of the file if there is one."""
    time = np.arange(2000) / 1000.0
    good = three_axes(1000.0 * np.sin(2.0 * np.pi * 40.0 * time), 50.0, 1)

    def refused(match: str, table: FloatArray, head: str = "#time,accel_x,accel_y,accel_z") -> None:
        path = tmp_path / "bad.csv"
        np.savetxt(path, table, "%.6f", delimiter=",", header=head, comments="")
        with pytest.raises(RecordingError, match=match) as raised:
            measured_mode(read_accelerometer(path))
        assert "\n" not in str(raised.value)

    whole = np.column_stack([time, good])
    refused(r"bad.csv:1002.* ms are missing after", np.delete(whole, slice(1000, 1200), axis=0))
    refused("1000 ms are missing|from 1e-06 to 0.05 s", whole * [1000.0, 1, 1, 1])
    refused("samples of x are at -?700", np.column_stack([time, np.clip(good, -700.0, 700.0)]))
    refused("100 samples, at least 200", whole[:100])
    refused("does not increase", whole[::-1])
    hole = whole.copy()
    hole[50] = np.nan
    refused(r"bad.csv:52.*finite numbers", hole)
    hole[50] = whole[50] * [1.0, 1e200, 1.0, 1.0]
    refused(r"bad.csv:52.* an acceleration of .*, limit 1e.09 m/s", hole)
    refused("nothing rings|unknown", np.column_stack([time, three_axes(0.0 * time, 50.0, 1)]))
    refused("no column is a time", whole, "when,accel_x,accel_y,accel_z")
    refused("no column is the acceleration along z", whole, "time,accel_x,accel_y,temperature")
    refused("is no unit", whole, "time (s),x (furlong),y (furlong),z (furlong)")
    refused("no column 'psd_x'", whole, "freq,adxl345,adxl345_bed,other")
    refused("negative power", whole - 9.0, "freq,psd_x,psd_y,psd_z")
    wild = np.abs(whole) * [1.0, 1e200, 1.0, 1.0]
    refused("holds a power of .*, limit 1e.100", wild, "freq,psd_x,psd_y,psd_z")
    uneven = np.abs(whole) * [100.0, 1.0, 1.0, 1.0]
    uneven[9:, 0] += 3.0
    refused("not even", uneven, "freq,psd_x,psd_y,psd_z")
    head = "#time,accel_x,accel_y,accel_z\n"
    for text, match in (
        ("", "file is empty"),
        ("1,2,3,4\n" * 300, "no line names time"),
        (head, "no samples"),
        (f"{head}0,1,2\n", r"bad.csv:2.*finite numbers"),
    ):
        (tmp_path / "bad.csv").write_text(text)
        with pytest.raises(RecordingError, match=match):
            read_accelerometer(tmp_path / "bad.csv")


@pytest.mark.parametrize("factor", [1e-40, 1e40])
def test_the_unit_of_a_spectrum_does_not_matter(tmp_path: Path, factor: float) -> None:
    """A mode is at the peak of a spectrum, with any numbers: these are beyond any usual unit."""
    text = (EXAMPLES / "printer-x-spectrum.csv").read_text()
    head, *lines = text.splitlines()
    found = []
    for by in (1.0, factor):
        rows = [
            ",".join([f, *(f"{by * float(power):.9e}" for power in powers)])
            for f, *powers in (line.split(",") for line in lines)
        ]
        (tmp_path / "x.csv").write_text("\n".join([head, *rows]))
        found.append(measured_mode(read_accelerometer(tmp_path / "x.csv"), "x"))
    usual, odd = found
    assert odd.frequency_hz.value == pytest.approx(usual.frequency_hz.value, rel=1e-4)
    assert odd.damping_ratio.value == pytest.approx(usual.damping_ratio.value, rel=1e-2)


def test_options_that_exclude_each_other(capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in (
        ((), "no mode is given"),
        (("--axis", "x", "--mode", "3Hz"), "--axis names the axis of --measured"),
        (("--measured", "a.csv", "--mode", "3Hz"), "both give a mode"),
        (("--measured", "none.csv"), "cannot read"),
    ):
        code, _, err = run(capsys, *words)
        assert code == 2
        assert message in " ".join(err.split())


_ORACLE = """
import importlib, json, sys
import numpy as np
sys.path.insert(0, sys.argv[1])
calibrate = importlib.import_module("extras.shaper_calibrate").ShaperCalibrate(None)
data = calibrate.process_accelerometer_data("x", np.load(sys.argv[2]))
data.set_numpy(np)
data.normalize_to_frequencies()
best, tried = calibrate.find_best_shaper(data, scv=5.0)
print(json.dumps([best.name, [[s.name, s.freq, s.vibrs, s.smoothing, s.max_accel] for s in tried]]))
"""


@pytest.mark.parametrize("second", [0.0, 0.6])
def test_klippers_choice_is_klippers(tmp_path: Path, command: FloatArray, second: float) -> None:
    """Equal to Klipper itself on the same run."""
    named = os.environ.get("THREADLINE_KLIPPER")
    if not named:
        pytest.skip(f"{NO_FIRMWARE}THREADLINE_KLIPPER names a checkout of Klipper")
    along = shaken(command, 45.0, 0.06) + second * shaken(command, 78.0, 0.04)
    noisy = three_axes(along, 300.0, 5)
    np.save(tmp_path / "run.npy", np.column_stack([np.arange(len(noisy)) / RATE_HZ, noisy]))
    done = subprocess.run(
        [sys.executable, "-c", _ORACLE, str(Path(named) / "klippy"), str(tmp_path / "run.npy")],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    name, theirs = json.loads(done.stdout)
    found = klipper_spectrum(
        Vibration(rate_hz=RATE_HZ, acceleration_m_s2=noisy, place=Place("run"))
    )
    weighted = klipper_weighted(found.frequency_hz, found.psd.sum(axis=1))
    choice, tried = klipper_choice(found.frequency_hz, weighted)
    assert choice.shaper_type == name
    for one, (kind, hz, left, smoothing, most) in zip(tried, theirs, strict=True):
        assert one.shaper_type == kind
        assert one.frequency_hz == pytest.approx(hz, abs=1e-6)
        assert one.vibration == pytest.approx(left, abs=1e-9)
        assert one.smoothing_mm == pytest.approx(smoothing, rel=1e-9)
        assert one.max_accel_mm_s2 == pytest.approx(most, rel=1e-6)

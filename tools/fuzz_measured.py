"""Hostile measured data: responses, sweeps, recordings of a fit, and files of accelerometers.

Data that is accepted must be usable: residuals of a response are finite for the machine's own
numbers, commands and positions of a recording are whole and finite, and every sixteenth file of an
accelerometer is searched for its mode, which must be finite.
"""

from __future__ import annotations

import math
import random
import tempfile
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path

import numpy as np
from tools.fuzz_files import odd_archive, odd_text

from threadline.files.formats import write_recording
from threadline.identify.accelerometer import Vibration, read_accelerometer
from threadline.identify.experiment_run import measure
from threadline.identify.frequency_domain import ResponseData
from threadline.identify.measured_data import read_data
from threadline.identify.modes import measured_mode
from threadline.identify.planned_experiment import experiment
from threadline.identify.time_domain import RecordingData
from threadline.machine import load_machine
from threadline.machine.numbers import number_at

Mutate = Callable[[random.Random, bytes], bytes]
Target = tuple[str, Callable[[random.Random], bytes], Callable[[Path], object], int]

WINDER = load_machine("lathe-winder")
STITCHER = load_machine("stitcher")
_MODES = 16
_RATE_HZ = 400.0
_SAMPLES = 240
_NUMBERS = (
    "1e-320",
    "1e160",
    "-1e308",
    "1e308",
    "5e-324",
    "-0.0",
    "nan",
    "inf",
    "1_0",
    "1,5",
    "٣",
    "",
    "0",
)
_HEADINGS = """
frequency_hz frequency freq magnitude_db magnitude phase_deg phase coherence [rad/s] [Hz] [kHz]
[rad] [deg] [turn] [rad/s/V] [count/V] [mm/s^2/V] [dB] [1/V] [/V] [kg/V] [m^0/V] # axis: X output:
motor sensors.x sensors.x_pot X.load time accel_x accel_y accel_z psd_x psd_y (g) (mg) (ms) (ns)
Time(us) shapers: zv(10.5) accel_per_hz
""".split()  # noqa: SIM905 - a table of words
_RAW = "#time,accel_x,accel_y,accel_z\n"
_PSD = "freq,psd_x,psd_y,psd_z,psd_xyz"


def _run(header: str, mark: str = ",", step: float = 1.0, scale: float = 1.0) -> bytes:
    """A damped oscillation along x with noise, as a file of an accelerometer."""
    rng = random.Random(header)
    lines = []
    for k in range(_SAMPLES):
        t = k / _RATE_HZ
        ringing = math.exp(-9.0 * t) * math.sin(2.0 * math.pi * 48.0 * t)
        row = [900.0 * ringing, 90.0 * ringing, 9806.65]
        cells = [f"{scale * (v + rng.gauss(0.0, 2.0)):.6f}" for v in row]
        lines.append(mark.join([f"{t / step:.6f}", *cells]))
    return (header + "\n".join(lines) + "\n").encode()


def _spectrum(more: str = "", tail: str = "") -> bytes:
    """A mode of 48 Hz under noise, as Klipper writes it."""
    lines = [_PSD + more]
    for k in range(128):
        f = k * 1.5625
        r = f / 48.0
        power = r * r / ((1.0 - r * r) ** 2 + (0.2 * r) ** 2) + 0.01
        x, y, z = 1e4 * power, 90.0 * power, 9.0
        lines.append(f"{f:.1f},{x:.3e},{y:.3e},{z:.3e},{x + y + z:.3e}{tail}")
    return ("\n".join(lines) + "\n").encode()


def _response(header: str, mark: str = ",", coherence: bool = False) -> bytes:
    lines = []
    for k in range(24):
        f = 1.2**k
        size = 40.0 / math.hypot(1.0, f / 7.0)
        cells = [f"{f:.5f}", f"{size:.5f}", f"{-math.degrees(math.atan(f / 7.0)):.3f}"]
        lines.append(mark.join([*cells, *(["0.97"] if coherence else [])]))
    return (header + "\n".join(lines) + "\n").encode()


TEXTS: dict[str, tuple[bytes, ...]] = {
    "measured-response": (
        _response("# axis: X\nfrequency_hz,magnitude_db,phase_deg\n"),
        _response("frequency [rad/s];magnitude [rad/s/V];phase [deg]\n", ";"),
        _response(
            "# axis: X\n# output: sensors.x_pot\nfrequency_hz\tmagnitude_db [V/V]\tphase_deg"
            "\tcoherence\n",
            "\t",
            coherence=True,
        ),
        _response("phase [rad],frequency_hz,magnitude [count/s/V]\n"),
    ),
    "klipper-run": (_run(_RAW),),
    "klipper-spectrum": (
        _spectrum(),
        _spectrum(",shapers:,zv(43.2),mzv(40.8)", ",,0.432,0.181"),
    ),
    "kalico-spectrum": (_spectrum(",accel_per_hz", ",60.0"),),
    "phone-csv": (
        _run(
            "Time (s),Linear Acceleration x (m/s^2),Linear Acceleration y (m/s^2),"
            "Linear Acceleration z (m/s^2)\n",
            scale=1e-3,
        ),
        _run('"Time (s)";"a x (m/s²)";"a y (m/s²)";"a z (m/s²)"\n', ";", scale=1e-3),
    ),
    "adxl-csv": (
        _run("time (ms),ax,ay,az\n", step=1e-3, scale=1e-3),
        _run("timestamp_us\tx [mg]\ty [mg]\tz [mg]\n", "\t", step=1e-6, scale=0.1),
    ),
}


@cache
def _sweep() -> dict[str, bytes]:
    """Return a measured sweep of the winder's X in each form, 240 ticks long."""
    found = measure(WINDER, experiment(WINDER, "X", "sweep", band_hz=(5.0, 20.0)))
    made = {}
    with tempfile.TemporaryDirectory() as folder:
        for ending in ("npz", "csv"):
            path = Path(folder) / f"sweep.{ending}"
            write_recording(found.recording, path)
            made[ending] = path.read_bytes()
    return made


def _odd_table(rng: random.Random, name: str, mutate: Mutate) -> bytes:
    """A table with another heading, another number, a gap, a clipped column, or bytes anywhere."""
    data = rng.choice(TEXTS[name])
    kind = rng.randrange(8)
    if kind < 2:
        return odd_text(rng, data, mutate)
    lines = data.decode().split("\n")
    first = next(k for k, line in enumerate(lines) if line[:1].isdigit())
    mark = max(",;\t", key=lines[first].count)
    if kind < 4:
        heads = lines[first - 1].split(mark)
        at = rng.randrange(len(heads))
        word = rng.choice(_HEADINGS)
        heads[at] = rng.choice((word, f"{heads[at].split('[')[0]}{word}", f"{word} {heads[at]}"))
        lines[first - 1] = mark.join(heads)
    elif kind < 6:
        for _ in range(rng.choice((1, 1, 3))):
            at = rng.randrange(first, len(lines))
            cells = lines[at].split(mark)
            cells[rng.randrange(len(cells))] = rng.choice(_NUMBERS)
            lines[at] = mark.join(cells)
    elif kind == 6:
        begin = rng.randrange(first, len(lines))
        del lines[begin : begin + rng.choice((1, 2, 9, 200))]
    else:
        column, value = rng.randrange(len(lines[first].split(mark))), rng.choice(_NUMBERS)
        for at in range(first + rng.choice((0, 0, 40)), len(lines)):
            cells = lines[at].split(mark)
            if column < len(cells):
                cells[column] = value
            lines[at] = mark.join(cells)
    return "\n".join(lines).encode()


def check_response(data: object) -> None:
    """Ask for finite residuals at increasing frequencies."""
    assert isinstance(data, ResponseData)
    assert (np.diff(data.omega) > 0.0).all() and (data.omega > 0.0).all()
    assert np.isfinite(data.omega).all() and len(data.omega)
    gain = f"{data.path.drive}.amplifier.gain"
    own = np.array([number_at(data.machine, gain).si])
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        residual = data.residuals({gain: own})
    if (data.omega > 1e-3).all() and (data.omega < 1e6).all():
        assert np.isfinite(residual).all()


def read_response_file(path: Path) -> None:
    """Read a table as data of a fit of the stitcher's X."""
    data = read_data(str(path), STITCHER, "X")
    if isinstance(data, ResponseData):
        check_response(data)


def read_sweep(path: Path) -> None:
    """Read a measured sweep as its response and as its raw run."""
    check_response(read_data(f"response:{path}", WINDER, "X"))
    read_run(path)


def read_run(path: Path) -> None:
    """Read a recording as data of a fit of the winder."""
    data = read_data(str(path), WINDER)
    if isinstance(data, ResponseData):
        check_response(data)
        return
    assert isinstance(data, RecordingData)
    (block,) = data.commands
    assert np.abs(block.counts).max() < 2**62
    for values in data.measured.values():
        assert np.isfinite(values).all()


def read_vibration(path: Path) -> None:
    """Read a file of an accelerometer; every sixteenth is searched for its mode."""
    data = read_accelerometer(path)
    values = data.acceleration_m_s2 if isinstance(data, Vibration) else data.psd
    assert np.isfinite(values).all()
    if sum(path.read_bytes()) % _MODES == 0:
        found = measured_mode(data)
        for known in (found.frequency_hz, found.damping_ratio):
            assert math.isfinite(known.value) and math.isfinite(known.half_width), known


def fuzz_measured(mutate: Mutate) -> dict[str, Target]:
    """Return, by name: the file to write, what makes a case, what reads it, and its weight."""

    def text(name: str) -> Callable[[random.Random], bytes]:
        return partial(_odd_table, name=name, mutate=mutate)

    return {
        "measured-response": ("a.csv", text("measured-response"), read_response_file, 4),
        "measured-sweep": (
            "a.npz",
            lambda rng: odd_archive(rng, _sweep()["npz"], mutate),
            read_sweep,
            2,
        ),
        "fit-recording": (
            "a.csv",
            lambda rng: odd_text(rng, _sweep()["csv"], mutate),
            read_run,
            2,
        ),
        **{
            name: ("a.csv", text(name), read_vibration, 2)
            for name in TEXTS
            if name != "measured-response"
        },
    }

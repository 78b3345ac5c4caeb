"""Mass and friction of a real ball-screw axis: EMPS, by Janot, Gautier and Brunot.

"Data Set and Reference Models of EMPS", Workshop on Nonlinear System Identification Benchmarks,
Eindhoven, 2019. ``DATA_EMPS.mat`` has ``t`` in s, the reference ``qg`` and the measured position
``qm`` in m, the volts ``vir`` at the amplifier, and ``gtau`` in N/V, every millisecond. The package
``nonlinear-benchmarks`` fetches the file from a page of its authors; it contains no data itself.

The published reference is a least-squares fit of Newton's equation, ``gtau vir = M a + Fv v +
Fc sign(v) + offset``. A machine file has no constant force. It is taken from the volts beforehand,
as the same least squares find it. The other three numbers are then Threadline's: from the error of
the simulated position, without differentiating it.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat, savemat
from scipy.signal import butter, filtfilt

from tests.conftest import NO_SAMPLES, SHARED_SAMPLES
from threadline.files import ChannelKind, Recording, RecordingBlock, Stream
from threadline.files.recording import Channel
from threadline.identify.parameter_fit import fit
from threadline.identify.time_domain import recording_data
from threadline.machine import load_machine

PUBLISHED = {"inertia": 95.1089, "damping": 203.5034, "friction": 20.3935}
OFFSET, GTAU, TICK = -3.1648, 35.15065, 1e-3
POSITION_GAIN, SPEED_GAIN = 160.18, 243.45  # of the rig's cascade, 1/s and V/(m/s)
NAMES = [f"bodies.car.{name}" for name in PUBLISHED]
MACHINE = """name = "emps"
title = "electro-mechanical positioning system"
sources = ["Janot, Gautier and Brunot, Data Set and Reference Models of EMPS, 2019"]
tick_budget = "1e8 tick exact, assumed"
[clocks]
servo = "1 ms exact, printed"
[bodies.car]
kind = "linear"
inertia = "120 kg +- 50 %, assumed"
damping = "150 N s/m +- 50 %, assumed"
friction = "28 N +- 50 %, assumed"
[drives.motor]
kind = "dc-motor"
acts_on = {{ car = "1 exact, printed" }}
torque_constant = "{gtau} N/A exact, printed: gtau, at 1 A/V"
back_emf = "{gtau} V s/m exact, assumed: a current amplifier does not feel it"
resistance = "1 ohm exact, assumed"
amplifier = {{ mode = "current", gain = "1 A/V exact, printed" }}
[sensors.scale]
kind = "encoder"
reads = {{ car = "1e6 count/m exact, assumed" }}
[controllers.car]
kind = "p"
clock = "servo"
sensor = "scale"
drive = "motor"
kp = "1 dac/count exact, assumed: the volts are recorded"
dac = {{ bits = "16 bit exact, assumed", range = "10 V exact, printed" }}
[axes.X]
kind = "linear"
controller = "car"
counts = "1e6 count/m exact, assumed"
velocity = "0.2 m/s exact, assumed"
acceleration = "2 m/s^2 exact, assumed"
jerk = "2000 m/s^3 exact, assumed"
travel = ["-1 m exact, assumed", "1 m exact, assumed"]
load = {{ car = "1 exact, printed" }}
"""


def least_squares(position, force):
    """Mass, damping, friction and offset by the authors' method: filter, differentiate, solve."""
    smooth = filtfilt(*butter(4, 100.0 / 500.0), position)
    speed = np.gradient(smooth, TICK)
    columns = [np.gradient(speed, TICK), speed, np.sign(speed), np.ones(len(speed))]
    basis = filtfilt(*butter(4, 20.0 / 500.0), np.stack(columns, axis=1), axis=0)[200:-200:20]
    return np.linalg.lstsq(basis, filtfilt(*butter(4, 20.0 / 500.0), force)[200:-200:20])[0]


def fitted(file: Path, folder: Path) -> dict[str, float]:
    """Fit mass, viscous and Coulomb friction to a file in the format of the benchmark."""
    content = loadmat(file)
    goal, position, volts = (np.ravel(content[key]).astype(float) for key in ("qg", "qm", "vir"))
    gtau = float(np.ravel(content["gtau"])[0])
    *_, offset = least_squares(position, gtau * volts)
    (folder / "emps.toml").write_text(MACHINE.format(gtau=gtau))
    machine = load_machine(str(folder / "emps.toml"))
    start = position[0]
    # The volts of a sample act after it; Threadline's act before it.
    acting = np.concatenate([[0.0], volts[:-1] - offset / gtau])
    goal = np.rint((goal - goal[0]) * 1e6) / 1e6  # whole counts, which the fit uses as times only
    samples = {"X.commanded": goal, "X.measured": position - start, "X.voltage": acting}
    kinds = (ChannelKind.COMMANDED, ChannelKind.MEASURED, ChannelKind.VOLTAGE)
    recording = Recording(
        channels=tuple(
            Channel(name=name, kind=kind, axis="X", unit=unit, clock=machine.tick_clock)
            for name, kind, unit in zip(samples, kinds, ("m", "m", "V"), strict=True)
        ),
        blocks=Stream.of([RecordingBlock(first_tick={"servo": 0}, samples=samples, events=())]),
        job_sha256="",
        machine_sha256="",
        simulated=False,
    )
    found = fit(machine, [recording_data(recording, machine, file)], NAMES, starts=0)
    return {one.name.rpartition(".")[2]: one.value for one in found.numbers}


def simulated(seconds: float = 9.0):
    """The rig by its published numbers, in steps of 20 us: reference, position, volts."""
    time = np.arange(round(seconds / TICK)) * TICK
    # To and fro at two speeds, with ramps of 0.83 m/s^2 as in the recorded program.
    goal, speed = np.zeros(len(time)), 0.0
    wanted = np.where((time // 1.5) % 2 == 0, 0.1, -0.1) * np.where(time < 4.5, 1.0, 0.5)
    for k in range(1, len(time)):
        speed += np.clip(wanted[k] - speed, -0.83 * TICK, 0.83 * TICK)
        goal[k] = goal[k - 1] + speed * TICK
    position, volts, x, v, before = np.zeros(len(time)), np.zeros(len(time)), 0.0, 0.0, 0.0
    M, viscous, coulomb = PUBLISHED.values()
    for k in range(len(time)):
        position[k] = x
        speed = (x - before) / TICK
        volts[k] = np.clip(SPEED_GAIN * (POSITION_GAIN * (goal[k] - x) - speed), -10.0, 10.0)
        before = x
        for _ in range(50):
            push = GTAU * volts[k] - viscous * v - OFFSET
            if v == 0.0 and abs(push) <= coulomb:
                continue
            along = np.sign(v) if v else np.sign(push)
            new = v + (push - coulomb * along) / M * TICK / 50
            v = 0.0 if v * new < 0.0 else new
            x += v * TICK / 50
    return time, goal, position, volts


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    file = tmp_path_factory.mktemp("emps") / "DATA_EMPS.mat"
    time, goal, position, volts = simulated()
    columns = {"t": time, "qg": goal, "qm": position, "vir": volts}
    savemat(file, {**{key: value[:, None] for key, value in columns.items()}, "gtau": GTAU})
    return file


def test_a_rig_with_the_published_numbers_gives_them_back(rig, tmp_path):
    """Simulated by explicit steps of 20 us, with stick and slip; the starts are off by 30 %."""
    found = fitted(rig, tmp_path)
    for name, value in PUBLISHED.items():
        assert found[name] == pytest.approx(value, rel=0.02), name


def test_the_recorded_rig_has_the_published_numbers(tmp_path):
    file = SHARED_SAMPLES / "emps" / "DATA_EMPS.mat"
    if not file.exists() and find_spec("nonlinear_benchmarks") is not None:
        from nonlinear_benchmarks import EMPS

        file = Path(EMPS(data_file_locations=True)[0])
    if not file.exists():
        pytest.skip(f"{NO_SAMPLES}: emps/DATA_EMPS.mat, which nonlinear-benchmarks fetches")
    found = fitted(file, tmp_path)
    for name, share in (("inertia", 0.02), ("damping", 0.05), ("friction", 0.1)):
        assert found[name] == pytest.approx(PUBLISHED[name], rel=share), name

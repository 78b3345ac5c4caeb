"""The rig EMPS as a machine file, and its recording as data of a fit; see ``test_emps``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.signal import butter, filtfilt

from threadline.files import ChannelKind, Recording, RecordingBlock, Stream
from threadline.files.recording import Channel
from threadline.identify.time_domain import RecordingData, recording_data
from threadline.machine import load_machine

PUBLISHED = {"inertia": 95.1089, "damping": 203.5034, "friction": 20.3935}
OFFSET, GTAU, TICK = -3.1648, 35.15065, 1e-3
POSITION_GAIN, SPEED_GAIN = 160.18, 243.45
"""Gains of the rig's cascade, 1/s and V/(m/s): a speed over two ticks is subtracted from the
position error times the first, and the difference is multiplied by the second. The recorded volts
are those of this law within 4 mV."""
COUNTS = 1e7
"""Counts of the simulated scale a metre: the recorded position has steps of 0.05 um."""
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
reads = {{ car = "1e7 count/m exact, assumed" }}
[controllers.car]
kind = "state-space"
clock = "servo"
references = ["X"]
sensors = ["scale"]
drives = ["motor"]
A = [[0.0, 0.0], [1.0, 0.0]]
B = [[0.0, 1.0], [0.0, 0.0]]
C = [[0.0, {speed_gain}]]
D = [[{position_gain}, {both_gains}]]
dac = {{ bits = "24 bit exact, assumed", range = "10 V exact, printed" }}
[axes.X]
kind = "linear"
controller = "car"
counts = "1e7 count/m exact, assumed"
velocity = "0.2 m/s exact, assumed"
acceleration = "2 m/s^2 exact, assumed"
jerk = "2000 m/s^3 exact, assumed"
travel = ["-1 m exact, assumed", "1 m exact, assumed"]
load = {{ car = "1 exact, printed" }}
"""


def least_squares(position, force):
    """Return mass, damping, friction and offset by filtering, differentiating, solving."""
    smooth = filtfilt(*butter(4, 100.0 / 500.0), position)
    speed = np.gradient(smooth, TICK)
    columns = [np.gradient(speed, TICK), speed, np.sign(speed), np.ones(len(speed))]
    basis = filtfilt(*butter(4, 20.0 / 500.0), np.stack(columns, axis=1), axis=0)[200:-200:20]
    return np.linalg.lstsq(basis, filtfilt(*butter(4, 20.0 / 500.0), force)[200:-200:20])[0]


def machine_text(gtau: float) -> str:
    """Return the rig's machine file: its cascade as one controller that keeps two positions."""
    levels = 2.0**23 / 10.0 / COUNTS  # for 1 V, in counts
    position, speed = POSITION_GAIN * SPEED_GAIN * levels, SPEED_GAIN / (2.0 * TICK) * levels
    return MACHINE.format(
        gtau=gtau, position_gain=position, speed_gain=speed, both_gains=-position - speed
    )


def recorded(file: Path, folder: Path) -> RecordingData:
    """Return a file in the format of the benchmark as data, on a machine file in ``folder``."""
    content = loadmat(file)
    goal, position, volts = (np.ravel(content[key]).astype(float) for key in ("qg", "qm", "vir"))
    gtau = float(np.ravel(content["gtau"])[0])
    *_, offset = least_squares(position, gtau * volts)
    (folder / "emps.toml").write_text(machine_text(gtau))
    machine = load_machine(str(folder / "emps.toml"))
    goal = goal - offset / (gtau * POSITION_GAIN * SPEED_GAIN)
    samples = {
        "X.commanded": np.rint((goal - position[0]) * COUNTS) / COUNTS,
        "X.measured": position - position[0],
    }
    kinds = (ChannelKind.COMMANDED, ChannelKind.MEASURED)
    recording = Recording(
        channels=tuple(
            Channel(name=name, kind=kind, axis="X", unit="m", clock=machine.tick_clock)
            for name, kind in zip(samples, kinds, strict=True)
        ),
        blocks=Stream.of([RecordingBlock(first_tick={"servo": 0}, samples=samples, events=())]),
        job_sha256="",
        machine_sha256="",
        simulated=False,
    )
    return recording_data(recording, machine, file)

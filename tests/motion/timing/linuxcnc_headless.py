"""LinuxCNC without a screen: the time of its own motion controller for programs.

The commanded place of each joint is sampled in every servo cycle of 1 ms, so that the time is a
count of cycles, however busy the machine is.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.one_hal import one_hal
from threadline.machine import Machine

_DEBIANS = "/usr/bin/python3"  # the Python with LinuxCNC's module
_CYCLE_S = 1e-3
_REST = 300  # cycles: the pause before the measured moves
_BEFORE = "G0 {first}0 {second}0\nG4 P0.4\n"
_INI = """[EMC]
MACHINE = measured
VERSION = 1.1
[DISPLAY]
DISPLAY = {folder}/drive
[RS274NGC]
PARAMETER_FILE = {folder}/measured.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 5.0
BASE_PERIOD = 0
SERVO_PERIOD = 1000000
[TASK]
TASK = milltask
CYCLE_TIME = 0.005
[HAL]
HALFILE = measured.hal
[TRAJ]
SPINDLES = 1
COORDINATES = {first} {second}
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
MAX_LINEAR_VELOCITY = 1e4
MAX_ANGULAR_VELOCITY = 1e5
MAX_LINEAR_ACCELERATION = 1e5
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.100
[KINS]
KINEMATICS = trivkins coordinates={first}{second}
JOINTS = 2
"""
_AXIS = """[AXIS_{axis}]
{limits}
[JOINT_{joint}]
TYPE = {kind}
HOME = 0
FERROR = 50
MIN_FERROR = 50
HOME_SEQUENCE = 0
{limits}
"""
_LIMITS = """MIN_LIMIT = -99999
MAX_LIMIT = 99999
MAX_VELOCITY = {velocity!r}
MAX_ACCELERATION = {acceleration!r}"""
_HAL = """loadrt [KINS]KINEMATICS
loadrt motmod servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
loadrt sampler depth=200000 cfg=ff
addf motion-command-handler servo-thread
addf motion-controller servo-thread
addf sampler.0 servo-thread
net x joint.0.motor-pos-cmd => joint.0.motor-pos-fb sampler.0.pin.0
net a joint.1.motor-pos-cmd => joint.1.motor-pos-fb sampler.0.pin.1
net enable iocontrol.0.user-enable-out iocontrol.0.emc-enable-in
net prepared iocontrol.0.tool-prepare iocontrol.0.tool-prepared
net changed iocontrol.0.tool-change iocontrol.0.tool-changed
"""
_DRIVE = """#!{python}
import subprocess, sys, time
from pathlib import Path
import linuxcnc
folder = Path({folder!r})
c, s = linuxcnc.command(), linuxcnc.stat()


def until(what, reached, ask=None, within_s=30.0):
    end, asked = time.monotonic() + within_s, 0.0
    while True:
        s.poll()
        if reached():
            return
        now = time.monotonic()
        if now > end:
            sys.exit("not reached within %g s: %s" % (within_s, what))
        # A command that comes before the state that it needs is dropped without a word.
        if ask is not None and now > asked + 2.0:
            ask()
            c.wait_complete(5)
            asked = now
        time.sleep(0.02)


until("no emergency stop",
      lambda: s.task_state in (linuxcnc.STATE_ESTOP_RESET, linuxcnc.STATE_ON),
      lambda: c.state(linuxcnc.STATE_ESTOP_RESET))
until("on", lambda: s.task_state == linuxcnc.STATE_ON, lambda: c.state(linuxcnc.STATE_ON))
until("by hand", lambda: s.task_mode == linuxcnc.MODE_MANUAL,
      lambda: c.mode(linuxcnc.MODE_MANUAL))
until("homed", lambda: all(s.homed[:2]), lambda: c.home(-1))
for program in sorted(folder.glob("*.ngc")):
    ended = program.with_suffix(".ended")
    if ended.exists():
        continue
    until("automatic", lambda: s.task_mode == linuxcnc.MODE_AUTO,
          lambda: c.mode(linuxcnc.MODE_AUTO))
    until("opened " + program.name, lambda: s.file == str(program),
          lambda: c.program_open(str(program)))
    with program.with_suffix(".samples").open("w") as samples:
        sampler = subprocess.Popen(["halsampler"], stdout=samples)
        until("samples of " + program.name, lambda: Path(samples.name).stat().st_size)
        c.auto(linuxcnc.AUTO_RUN, 0)
        # Every program begins with a pause of 0.4 s, in which it is seen to run.
        until("start of " + program.name, lambda: s.interp_state != linuxcnc.INTERP_IDLE)
        until("end of " + program.name,
              lambda: s.interp_state == linuxcnc.INTERP_IDLE and s.inpos and s.queue == 0)
        rows = Path(samples.name).stat().st_size
        until("last samples of " + program.name,
              lambda: Path(samples.name).stat().st_size > rows + 4096)
        sampler.terminate()
        sampler.wait(100)
    ended.touch()
"""
_TRIES_WITHOUT_PROGRESS = 3
"""Debian's LinuxCNC stands still now and then, at another program each time, where a computer is
busy: a new start goes on behind the programs that ended."""
_LASTS_S = 150.0  # s for one try, on a busy computer


def times_on_linuxcnc(programs: dict[str, str], machine: Machine, folder: Path) -> dict[str, float]:
    """Return the time of each program, in s, on the two axes of ``machine``.

    Parameters
    ----------
    programs
        Moves from zero on, by name.
    """
    first, second = machine.axis_names
    text = _INI.format(folder=folder, first=first, second=second)
    for joint, axis in enumerate((first, second)):
        own = machine.axes[axis]
        turns = axis in machine.rotary
        scale = float(np.degrees(1.0)) if turns else 1e3
        limits = _LIMITS.format(
            velocity=own.velocity.si * scale, acceleration=own.acceleration.si * scale
        )
        kind = "ANGULAR" if turns else "LINEAR"
        text += _AXIS.format(axis=axis, joint=joint, kind=kind, limits=limits)
    (folder / "measured.ini").write_text(text)
    (folder / "measured.hal").write_text(_HAL)
    (folder / "measured.var").touch()
    drive = folder / "drive"
    drive.write_text(_DRIVE.format(python=_DEBIANS, folder=str(folder)))
    drive.chmod(0o755)
    for name, moves in programs.items():
        before = _BEFORE.format(first=first, second=second)
        (folder / f"{name}.ngc").write_text(f"G21 G90 G94\n{before}{moves}M2\n")
    missing, stalls = set(programs), 0
    while missing and stalls < _TRIES_WITHOUT_PROGRESS:
        _run(folder)
        left = {name for name in programs if not (folder / f"{name}.ended").exists()}
        stalls = stalls + 1 if left == missing else 0
        missing = left
    assert not missing, f"LinuxCNC did not end {', '.join(sorted(missing))}"
    return {name: _moving_s(folder / f"{name}.samples") for name in programs}


def _run(folder: Path) -> None:
    """Have LinuxCNC run the programs once; leave nothing of it behind."""
    # Its real-time part refuses to run as root without another user to fall back on, who then needs
    # a folder of his own.
    with tempfile.TemporaryDirectory() as theirs, one_hal():
        Path(theirs).chmod(0o777)
        started = subprocess.Popen(
            ["linuxcnc", "-r", str(folder / "measured.ini")],
            env=os.environ
            | {"HOME": theirs, "RTAPI_UID": "65534", "RTAPI_FIFO_PATH": f"{theirs}/fifo"},
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            output, _ = started.communicate(timeout=_LASTS_S)
        except subprocess.TimeoutExpired:
            os.killpg(started.pid, signal.SIGKILL)
            output, _ = started.communicate()
            subprocess.run(["halrun", "-U"], check=False, timeout=60)
    sys.stdout.write(output)


def _moving_s(samples: Path) -> float:
    """Return the time in which the joints move after the last pause."""
    rows = [line.split() for line in samples.read_text().splitlines()]
    places = np.array([[float(word) for word in row] for row in rows if len(row) == 2])
    moves = np.flatnonzero((np.abs(np.diff(places, axis=0)) > 1e-12).any(axis=1))
    pauses = np.flatnonzero(np.diff(moves, prepend=-2 * _REST) > _REST)
    begin = moves[pauses[-1]]
    return float(moves[-1] - begin + 1) * _CYCLE_S

"""LinuxCNC's ``pid`` tunes itself on a plant of HAL's components; Threadline tunes the same plant.

It swings the plant by a relay (Astrom and Hagglund, 1984), whose first harmonic gives the ultimate
gain, exact to a fifth on a plant of third order. Its gains follow by the rule of Ziegler and
Nichols.
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.live.hal_bench import hal_alone
from threadline.live.hal_session import as_user
from threadline.machine import load_machine
from threadline.search.ziegler_nichols import Ultimate, foreseen_ultimate, ultimate

GAIN, KT, KE, R, L, J = 0.45, 0.082, 8.6 * 60 / (2 * np.pi * 1000), 0.4, 8e-3, 3.606e-4
LEVEL, COUNTS, TICK = 20 / 4096, 4000 / (2 * np.pi), 2e-4
MACHINE = """base = "lathe-winder"
name = "with-a-coil"
[clocks]
servo = "200 us exact, assumed"
[drives.x]
inductance = "8 mH exact, assumed"
[controllers.x.dac]
zero_on_reversal = false
"""
HAL = f"""loadrt threads name1=servo period1=200000
loadrt pid num_chan=1 debug=1
loadrt sum2 count=2
loadrt integ count=3
addf pid.0.do-pid-calcs servo
addf sum2.0 servo
addf sum2.1 servo
addf integ.0 servo
addf integ.1 servo
addf integ.2 servo
net volts pid.0.output => sum2.0.in0
net speed integ.1.out => sum2.0.in1 integ.2.in
net drop sum2.0.out => sum2.1.in0
net current integ.0.out => sum2.1.in1 integ.1.in
net slope sum2.1.out => integ.0.in
net counts integ.2.out => pid.0.feedback
setp sum2.0.gain0 {GAIN * LEVEL / L}
setp sum2.0.gain1 {-KE / L}
setp sum2.1.gain0 1
setp sum2.1.gain1 {-R / L}
setp integ.1.gain {KT / J}
setp integ.2.gain {COUNTS}
setp pid.0.maxoutput 2000
setp pid.0.tune-cycles 60
setp pid.0.tune-effort 200
setp pid.0.enable 1
start
setp pid.0.tune-mode 1
setp pid.0.tune-start 1
loadusr -w sleep SECONDS
show pin pid.0
"""


@pytest.fixture(autouse=True)
def hal_lock(monkeypatch):
    with hal_alone(monkeypatch):
        yield


def tuned_by_linuxcnc(folder: Path) -> dict[str, float]:
    for parent in (folder, *folder.parents[:4]):  # HAL reads the file as another user
        if parent.name.startswith(("pytest", "popen", "test_")):
            parent.chmod(0o755)
    for seconds in (8, 24):  # sixty half periods are four seconds on an idle computer
        file, log = folder / "autotune.hal", folder / "said.txt"
        file.write_text(HAL.replace("SECONDS", str(seconds)))
        file.chmod(0o644)
        words = ["timeout", "-k", "2", str(seconds + 20), "halrun", "-f", str(file)]
        place = Path("/tmp") / f"threadline-hal-{os.geteuid() or 65534}"
        with log.open("w") as stream:  # HAL's children would keep a pipe open
            subprocess.run(
                [*as_user(), "env", f"RTAPI_FIFO_PATH={place}", *words],
                cwd="/", stdin=subprocess.DEVNULL, stdout=stream, stderr=stream, check=False,
            )  # fmt: skip
        found = re.findall(r"(\S+)\s+pid\.0\.([\w-]+)", log.read_text())
        pins = {name: value for value, name in found}
        if pins.get("tune-start") == "FALSE":
            names = ("Pgain", "Igain", "Dgain", "ultimate-gain", "ultimate-period")
            return {name: float(pins[name]) for name in names}
    raise AssertionError(log.read_text()[-2000:])


def test_ultimate_gain_and_rule_agree_with_linuxcnc_autotune(tmp_path):
    theirs = tuned_by_linuxcnc(tmp_path)
    file = tmp_path / "coil.toml"
    file.write_text(MACHINE)
    machine = load_machine(str(file))
    ours, foreseen = ultimate(machine, "X"), foreseen_ultimate(machine, "X")
    # Routh: R J Kt Ke = L J Kt kp gain; the tick of 0.2 ms costs another half percent.
    routh = R * KE / (L * GAIN * LEVEL * COUNTS)
    assert ours.kp == pytest.approx(foreseen.kp, rel=0.01)
    assert ours.kp == pytest.approx(routh, rel=0.01)
    assert ours.period_s == pytest.approx(2 * np.pi / np.sqrt(KT * KE / (L * J)), rel=0.01)
    assert theirs["ultimate-gain"] == pytest.approx(ours.kp, rel=0.2)
    assert theirs["ultimate-period"] == pytest.approx(ours.period_s, rel=0.15)
    by_rule = Ultimate(kp=theirs["ultimate-gain"], period_s=theirs["ultimate-period"])
    gains = by_rule.gains("pid", TICK)
    assert gains["kp"] == pytest.approx(theirs["Pgain"], rel=1e-4)
    assert gains["ki"] / TICK == pytest.approx(theirs["Igain"], rel=1e-4)
    assert gains["kd"] * TICK == pytest.approx(theirs["Dgain"], rel=1e-4)

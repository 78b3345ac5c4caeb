"""The equations of a machine, compared with textbook, thesis figures and python-control."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from threadline.dynamics.groups import connected_groups
from threadline.dynamics.linear_model import linear_model
from threadline.dynamics.network import piecewise_linear
from threadline.dynamics.plausibility import plausibility_warnings
from threadline.dynamics.values import Values
from threadline.errors import MachineError, OptionError
from threadline.files import Stream, TickBlock, TickTable
from threadline.machine.load import load_machine
from threadline.twin import simulate

HEAD = """
name = "two masses"
title = "head and frame of a stitcher, motor held by its inertia"
sources = ["made for a test"]
tick_budget = "1e9 tick exact, assumed"
[clocks]
servo = "1 ms exact, assumed"
[bodies.motor]
kind = "rotary"
inertia = "1e9 kg m^2 exact, assumed"
[bodies.head]
kind = "linear"
inertia = "70 kg exact, printed"
damping = "2080 N s/m exact, printed"
[bodies.frame]
kind = "linear"
inertia = "175 kg exact, printed"
damping = "1000 N s/m exact, printed"
[links.belt]
stiffness = "1e6 N/m exact, printed"
[links.belt.stretch]
motor = "0.004833333 m/rad exact, printed"
head = "-1 exact, printed"
frame = "-1 exact, printed"
[links.rack]
stretch = { frame = "1 exact, printed" }
stiffness = "5e6 N/m exact, printed"
[drives.m]
kind = "dc-motor"
acts_on = { motor = "1 exact, assumed" }
torque_constant = "0.5 N m/A exact, printed"
back_emf = "0.5 V s/rad exact, assumed"
resistance = "0.8 ohm exact, printed"
amplifier = { mode = "voltage", gain = "40 exact, printed" }
delay = "3 ms exact, printed"
[sensors.e]
kind = "encoder"
reads = { motor = "8000 count/rev exact, printed" }
[controllers.c]
kind = "pd"
clock = "servo"
sensor = "e"
drive = "m"
kp = "1 dac/count exact, assumed"
kd = "0 dac/count exact, assumed"
dac = { bits = "8 bit exact, printed", range = "10 V exact, printed" }
[axes.Y]
kind = "linear"
controller = "c"
counts = "263000 count/m exact, assumed"
velocity = "1 m/s exact, assumed"
acceleration = "10 m/s^2 exact, assumed"
endless = true
load = { head = "1 exact, printed" }
frame = { frame = "1 exact, printed" }
[tool]
radius = "100 mm exact, assumed"
"""


@pytest.fixture
def stitcher_y(tmp_path):
    def build(**swaps):
        text = HEAD
        for old, new in swaps.values():
            assert old in text
            text = text.replace(old, new)
        file = tmp_path / "y.toml"
        file.write_text(text)
        return load_machine(str(file))

    return build


def test_winder_axis_is_eq_7_11():
    """570 / (s (s + 46.7)) rad per motor volt; with DAC and encoder 1772 Kamp."""
    model = next(m for m in linear_model(load_machine("lathe-winder")) if "X.load" in m.outputs)
    assert sorted(model.poles().real) == pytest.approx([-46.7, 0.0], abs=0.05)
    high = model.select(["drives.x"], ["sensors.x"]).response(np.array([1e5]))[0, 0, 0]
    gain = abs(high) * 1e10 * 20 / 4096 / 0.45
    # The printed constants give 570 and 46.7 only to three figures.
    assert gain == pytest.approx(1772, rel=4e-3)
    assert len(linear_model(load_machine("lathe-winder"))) == 3


def test_stitcher_y_modes_with_the_motor_held(stitcher_y):
    """103.96 and 194.33 rad/s undamped: the frame's coordinate points away from the head's."""
    machine = stitcher_y(
        head=('damping = "2080 N s/m exact, printed"\n', ""),
        frame=('damping = "1000 N s/m exact, printed"\n', ""),
    )
    (model,) = linear_model(machine)
    rates = np.abs(model.poles().imag)
    assert sorted(rates[rates > 1])[::2] == pytest.approx([103.96, 194.33], abs=0.01)
    assert model.delay_s.tolist() == [0.003]
    assert "Y.frame" in model.outputs


def test_coil_adds_its_state(stitcher_y):
    """With 4 mH the current is a state: R/L among the poles of the held motor."""
    machine = stitcher_y(
        coil=('resistance = "0.8 ohm', 'inductance = "4 mH exact, printed"\nresistance = "0.8 ohm')
    )
    (model,) = linear_model(machine)
    assert "m.i" in model.states
    assert np.abs(model.poles() + 200.0).min() < 1e-3


def test_sampled_loop_is_python_controls():
    """Without quantisers the twin's step is python-control's closed loop of the c2d plant."""
    import control  # with half of matplotlib: for one worker alone

    machine = load_machine("lathe-winder")
    model = next(m for m in linear_model(machine) if "X.load" in m.outputs)
    seen = model.select(["drives.x"], ["sensors.x"])
    plant = control.c2d(control.ss(seen.A, seen.B, seen.C, seen.D), 0.005, "zoh")
    kp, kd, volt = 2.0, 4.0, 20 / 4096
    controller = volt * control.tf([kp + kd, -kd], [1, 0], 0.005)
    closed = control.feedback(plant * control.ss(controller), 1)
    rows = np.concatenate((np.full(60, 5), np.full(60, -5), np.zeros(80, dtype=int)))
    counts = np.zeros((len(rows), 3), dtype=np.int64)
    counts[:, 1] = rows
    machine = load_machine("lathe-winder")
    commands = TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=np.zeros(3, dtype=np.int64),
        blocks=Stream.of([TickBlock(first_tick=0, counts=counts, operation=counts[:, 0])]),
        job_sha256="",
        machine_sha256="",
    )
    free = _without_reversal(machine)
    recording = simulate(commands, free, quantised=False, settle_s=0.0)
    _, load = recording.samples("X.load")
    _, commanded = recording.samples("X.commanded")
    times = np.arange(len(load)) * 0.005
    expected = control.forced_response(closed, times, commanded * 55.358e3).outputs
    # 1e-9 counts are enough for one product; these are two hundred, in another order.
    np.testing.assert_allclose(load * 55.358e3, expected, atol=1e-8)
    assert np.abs(expected).max() > 250


def _without_reversal(machine):
    controllers = {
        name: dataclasses.replace(c, dac=dataclasses.replace(c.dac, zero_on_reversal=False))
        for name, c in machine.controllers.items()
    }
    return dataclasses.replace(machine, controllers=controllers)


def test_groups_are_the_connected_pieces(stitcher_y):
    groups = connected_groups(load_machine("lathe-winder"))
    assert [g.axes for g in groups] == [("X",), ("Y",), ("A",)]
    assert groups[0].inputs == ("x_low", "x_high")
    (group,) = connected_groups(stitcher_y())
    assert group.bodies == ("motor", "head", "frame")


def test_shared_drive_is_refused():
    machine = load_machine("lathe-winder")
    controllers = dict(machine.controllers)
    controllers["y"] = dataclasses.replace(controllers["y"], drive="x")
    with pytest.raises(MachineError, match=r"share the drive 'x'.*separate drive"):
        connected_groups(dataclasses.replace(machine, controllers=controllers))


def test_preload_with_play_is_refused(stitcher_y):
    machine = stitcher_y(
        link=(
            'stiffness = "1e6 N/m exact, printed"',
            'stiffness = "1e6 N/m exact, printed"\npreload = "9 N exact, assumed"\n'
            'play = "1 mm exact, assumed"',
        )
    )
    with pytest.raises(MachineError, match="both a preload and a play"):
        piecewise_linear(machine)


def test_values_name_the_nearest_number():
    machine = load_machine("lathe-winder")
    with pytest.raises(OptionError, match=r"Did you mean 'bodies\.x\.inertia'"):
        Values.of(machine, {"bodies.x.inertja": np.ones(2)})
    with pytest.raises(OptionError, match="different lengths"):
        Values.of(machine, {"bodies.x.inertia": np.ones(2), "bodies.y.inertia": np.ones(3)})


def test_variants_fill_their_own_equations():
    """Twice the inertia halves the pole, in that variant alone."""
    machine = load_machine("lathe-winder")
    values = Values.of(machine, {"bodies.x.inertia": np.array([3.606e-4, 7.212e-4])})
    piece = piecewise_linear(machine, values)[0]
    free = (
        piece.base
        + piece.elements[0].direction[:, :, None] * (piece.elements[0].modes[0].law[:, None, :])
    )
    assert free[:, 1, 1] == pytest.approx([-46.687, -23.344], abs=1e-3)


def test_a_current_amplifier_with_supply_and_coil_is_taken_and_said(tmp_path: Path) -> None:
    """The voltage limit holds against resistance and back EMF; the coil changes no current."""
    changes = """base = "lathe-winder"
name = "torque-mode"
[drives.x]
{coil}
[drives.x.amplifier]
mode = "current"
gain = "1.2 A/V exact, assumed"
voltage_limit = "9 V exact, assumed"
"""
    coil = 'inductance = "12 mH exact, assumed"'
    made = []
    for name, extra in (("with", coil), ("without", "")):
        (tmp_path / f"{name}.toml").write_text(changes.format(coil=extra))
        made.append(load_machine(tmp_path / f"{name}.toml"))
    for ours, theirs in zip(*map(piecewise_linear, made), strict=True):
        assert ours.states == theirs.states
        np.testing.assert_array_equal(ours.base, theirs.base)
        for one, other in zip(ours.elements, theirs.elements, strict=True):
            for mode, like in zip(one.modes, other.modes, strict=True):
                np.testing.assert_array_equal(mode.law, like.law)
    message = "1.3 ms for each ampere at 9 V, is not simulated"
    assert [any(message in one for one in plausibility_warnings(machine)) for machine in made] == [
        True,
        False,
    ]

"""Vibration under a cylinder, compared with the equations of two masses written down here."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import eigh

from threadline.cli.main import main
from threadline.dynamics.without_loop import analyse_cylinder, analyse_moving
from threadline.machine import load_machine

TWO_PI = 2.0 * np.pi


def test_standing_modes_are_those_of_two_masses() -> None:
    """Table on its feet, cylinder and head as one on the beam: K v = w^2 M v, solved by scipy.

    Damping is left out there: at a ratio of 0.01 it shifts a frequency by half of its square, 5e-5.
    Undamped frequencies are compared with the modulus of the poles, which it does not change.
    """
    table, cylinder, head = 73.54, 1.0, 6.0
    feet, beam = 2.7e4, 1e8
    stiffness = np.array([[feet + beam, -beam], [-beam, beam]])
    squares = eigh(stiffness, np.diag([table, cylinder + head]), eigvals_only=True)
    found = analyse_cylinder(load_machine("letter-placer"), "X")

    ours = [mode.frequency_hz for mode in found.standing]
    assert ours == pytest.approx(np.sqrt(squares) / TWO_PI, rel=1e-6)
    # The dashpot of the feet alone: c / (2 sqrt(k m)).
    assert found.standing[0].damping == pytest.approx(
        24.0 / (2.0 * np.sqrt(feet * (table + cylinder + head))), rel=1e-3
    )


def test_air_without_stiffness_and_damping_leaves_the_free_piston() -> None:
    """Then the head does not move along: 3.029 Hz, and the air no longer rings."""
    machine = load_machine("letter-placer")
    x = machine.cylinders["X"]
    loose = replace(
        x,
        air_stiffness=replace(x.air_stiffness, si=1e-6),
        air_damping=replace(x.air_damping, si=0.0),
    )
    machine = replace(machine, cylinders={**machine.cylinders, "X": loose})
    slowest = analyse_cylinder(machine, "X").sliding[0]
    assert slowest.frequency_hz == pytest.approx(3.029, abs=5e-4)  # printed, to its digits
    assert slowest.damping == pytest.approx(0.0090, abs=5e-5)


def test_the_command_gives_modes_and_says_that_there_is_no_loop(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["analyse", "letter-placer", "--json"])
    content = json.loads(capsys.readouterr().out)
    assert ended.value.code == 0
    assert content["stable"]
    assert set(content["axes"]) == {"X", "Z"}
    for axis, found in content["axes"].items():
        assert found["bandwidth_hz"] is found["gain_margin"] is found["phase_margin_deg"] is None
        assert found["modes_hz"][0] == pytest.approx(2.9, abs=0.03)
        assert found["verdict"].startswith(f"axis {axis} has no loop")
        assert "\n" not in found["verdict"]
    with pytest.raises(SystemExit):
        main(["analyse", "letter-placer", "--axis", "Z"])
    out = capsys.readouterr().out
    assert "axis Z has no loop" in out
    assert "axis X" not in out


def test_every_thing_that_moves_can_be_analysed() -> None:
    machine = load_machine("lathe-winder")
    for name in machine.moving:
        assert analyse_moving(machine, name).as_json()["modes_hz"] is not None


def test_demand_on_a_drive_has_the_unit_of_its_body() -> None:
    """A linear servo gives a force: at 40 m/s^2 and 1.5 m/s, 7 kg and 30 N s/m need 325 N."""
    servo = analyse_moving(load_machine("table-embroiderer"), "X")
    assert servo.verdict().endswith("rings at 70.01 Hz; at the axis' limits it needs "
                                    "325 of 900 N")  # fmt: skip
    assert servo.as_json()["torque_unit"] == "N"
    stepper = analyse_moving(load_machine("stepper-winder"), "X")
    assert stepper.verdict().endswith(" N m")
    assert "its load does not ring" in replace(stepper, locked=()).verdict()

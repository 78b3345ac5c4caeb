"""A varied machine differs in friction and supply, and in nothing else."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from threadline.machine import load_machine
from threadline.machine.vary import derate, off_tolerance, vary


def test_friction_and_supply_are_scaled() -> None:
    machine = load_machine("lathe-winder+stiction")
    other = vary(machine, friction=1.3, supply=0.95)
    body, drive = other.bodies["x"], other.drives["x"]

    assert body.friction is not None
    assert body.friction.si == pytest.approx(1.3 * 0.05)
    assert body.stiction is not None
    assert body.stiction.si == pytest.approx(1.3 * 0.06)
    assert drive.amplifier.current_limit is not None
    assert drive.amplifier.current_limit.si == pytest.approx(0.95 * 4.0)
    amplifier = machine.drives["x"].amplifier
    assert amplifier.current_limit is not None
    supplied = replace(amplifier, voltage_limit=replace(amplifier.current_limit, si=24.0, unit="V"))
    drives = {**machine.drives, "x": replace(machine.drives["x"], amplifier=supplied)}
    low = vary(replace(machine, drives=drives), supply=0.95).drives["x"].amplifier.voltage_limit
    assert low is not None
    assert low.si == pytest.approx(0.95 * 24.0)
    # The gain is set by feedback, so it stays.
    assert drive.amplifier.gain == machine.drives["x"].amplifier.gain
    assert replace(other, bodies=machine.bodies, drives=machine.drives) == machine


@pytest.mark.parametrize("factors", [{"friction": 0.0}, {"supply": -1.0}])
def test_factors_must_be_positive(factors: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="positive"):
        vary(load_machine("lathe-winder"), **factors)


def test_derating_touches_acceleration_and_jerk_alone() -> None:
    machine = load_machine("lathe-winder")
    gentle = derate(machine, 0.25)

    assert (gentle.acceleration_limit == 0.25 * machine.acceleration_limit).all()
    assert (gentle.jerk_limit == 0.25 * machine.jerk_limit).all()
    assert (gentle.velocity_limit == machine.velocity_limit).all()
    with pytest.raises(ValueError, match="share"):
        derate(machine, 1.5)


def test_off_tolerance_changes_load_feet_and_air_of_a_cylinder_machine() -> None:
    """The file's 6 kg +- 5 %, 27 kN/m +- 10 % and 35.7 kN/m +- 30 %."""
    machine = load_machine("letter-placer")
    other = off_tolerance(machine, mass=1.0, stiffness=-1.0)

    assert other.bodies["head"].inertia.si == pytest.approx(1.05 * 6.0, rel=1e-12)
    assert other.links["feet"].stiffness.si == pytest.approx(0.9 * 2.7e4, rel=1e-12)
    assert other.cylinders["X"].air_stiffness.si == pytest.approx(0.7 * 35.7e3, rel=1e-12)
    assert other.bodies["table"] == machine.bodies["table"]
    same = replace(other, bodies=machine.bodies, links=machine.links, cylinders=machine.cylinders)
    assert same == machine


def test_off_tolerance_changes_only_loads_and_links() -> None:
    """For the printed 111 kg +- 10 % and 6.24e5 N/m +- 20 %, one end and a quarter of the way."""
    machine = load_machine("stitcher")
    other = off_tolerance(machine, mass=-1.0, stiffness=0.25)

    assert other.bodies["x_head"].inertia.si == pytest.approx(0.9 * 111.0, rel=1e-12)
    assert other.bodies["y_head"].inertia.si == pytest.approx(0.9 * 70.0, rel=1e-12)
    for name in ("x_motor", "y_motor", "frame"):
        assert other.bodies[name] == machine.bodies[name]
    assert other.links["x_belt"].stiffness.si == pytest.approx(1.05 * 6.24e5, rel=1e-12)
    assert other.links["frame_mount"].stiffness.si == pytest.approx(1.05 * 5e6, rel=1e-12)
    assert replace(other, bodies=machine.bodies, links=machine.links) == machine


def test_a_stepper_without_a_load_carries_its_own_body(tmp_path: Path) -> None:
    """``threadline new`` writes such axes from a firmware's settings; rotors vary by 10 %."""
    file = tmp_path / "m.toml"
    file.write_text(
        'base = "stepper-winder"\n[axes.X]\nload = "none"\n[axes.A]\nload = "none"\n'
        '[bodies.x_motor]\ninertia = "6e-5 kg m^2 +- 10 %, assumed"\n'
    )
    machine = load_machine(file)
    other = off_tolerance(machine, mass=1.0)

    assert other.bodies["x_motor"].inertia.si == pytest.approx(1.1 * 6e-5, rel=1e-12)
    assert other.bodies["x_eye"] == machine.bodies["x_eye"]

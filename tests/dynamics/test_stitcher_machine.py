"""The stitcher's machine files: strict, layered, and open about suspicious numbers."""

from __future__ import annotations

import importlib.resources

import numpy as np
import pytest

from threadline.dynamics.eccentric import current_needed, rigid_motion
from threadline.dynamics.linear_model import linear_model
from threadline.dynamics.plausibility import plausibility_warnings
from threadline.errors import MachineError
from threadline.machine import load_machine
from threadline.machine.load import library_file

RATIO = 29e-3 / 6
OVERLAYS = (
    "unloaded",
    "head-feedback",
    "moving-fabric",
    "rigid-frame",
    "stiff-drive",
    "half-mass",
    "backlash",
    "slack-belt",
    "rigid-frame+stiff-drive+half-mass",
)


@pytest.mark.parametrize(
    "reference",
    [
        "stitcher",
        *(f"stitcher+{o}" for o in OVERLAYS),
        "stitcher-rigid",
        "stitcher-rigid+no-load-damping",
        "stitcher-rigid+proportional",
        "stitcher-rigid-half-mass",
        "stitcher-rigid-half-mass+no-load-damping",
    ],
)
def test_variants_load_and_have_equations(reference):
    machine = load_machine(reference)
    assert machine.axis_names == ("X", "Y")
    assert len(linear_model(machine)) == 2
    assert machine.tick_clock.period_s == machine.clock("reference").period_s
    assert float(machine.clock("filter").period_s) == pytest.approx(136e-6, rel=1e-12)


@pytest.mark.parametrize(
    ("reference", "x_kg", "y_kg"),
    [("stitcher-rigid", 111, 70), ("stitcher-rigid-half-mass", 55.5, 35)],
)
def test_rigid_variants_carry_the_loads(reference, x_kg, y_kg):
    """J + M (r/N)^2 and B + b (r/N)^2; the file rounds to seven digits."""
    machine = load_machine(reference)
    x, y = machine.bodies["x_motor"], machine.bodies["y_motor"]
    assert x.inertia.si == pytest.approx(4.75e-4 + x_kg * RATIO**2, rel=1e-6)
    assert y.inertia.si == pytest.approx(8.1e-4 + y_kg * RATIO**2, rel=1e-6)
    assert x.damping.si == pytest.approx(0.24 + 3330 * RATIO**2, rel=1e-6)
    assert y.damping.si == pytest.approx(0.29 + 2080 * RATIO**2, rel=1e-6)


def test_the_stiff_flexible_machine_tends_to_the_rigid_one():
    """Below 20 Hz the 100 x stiffer belt is within 2 % of the machine without a belt."""
    omega = 2 * np.pi * np.geomspace(0.5, 20, 40)
    stiff = linear_model(load_machine("stitcher+rigid-frame+stiff-drive"))
    soft = linear_model(load_machine("stitcher+rigid-frame"))
    rigid = linear_model(load_machine("stitcher-rigid"))
    for index, axis in enumerate("xy"):
        responses = [
            model[index].select([f"drives.{axis}"], [f"sensors.{axis}"]).response(omega)[:, 0, 0]
            for model in (stiff, soft, rigid)
        ]
        assert np.abs(responses[0] / responses[2] - 1).max() < 0.02
        assert np.abs(responses[1] / responses[2] - 1).max() > 0.5


def test_suspicions_name_the_matter():
    """18.9 and 22.9 of 27 A at 7.5 in/s; Kt = 0.5, Kv = 60 V/krpm = 0.573."""
    found = plausibility_warnings(load_machine("stitcher"))
    assert any("x_motor" not in t and "18.9 A of the 27 A of drives.x" in t for t in found)
    assert any("22.9 A of the 27 A of drives.y" in t for t in found)
    assert sum("disagree by 15 %" in t for t in found) == 2
    assert any("needs 60.3 A, more than the 27 A" in t for t in found)
    # 0.5 (1 + B) / (K (1 - A)) = 23.5 counts of 3.796 um
    assert any("an error of up to 24 counts (0.0892 mm) on axis X" in t for t in found)


def test_the_ceiling_of_a_drive_is_named_beside_the_limit_of_its_axis(tmp_path) -> None:
    """By hand: 10 V times 0.45 over 8.6 V/krpm, through the counts of the axes; no friction."""
    found = plausibility_warnings(load_machine("lathe-winder"))
    motor_rad_s = 10.0 * 0.45 / (8.6 * 60.0 / (2.0 * np.pi * 1000.0))
    turn = motor_rad_s / (2.0 * np.pi) * 4000.0  # counts per second
    expected = {
        "A": "2842 deg/s in the machine file, "
        f"but drives.a reaches at most {turn / 35.18159:.4g} deg/s",
        "X": f"1 m/s in the machine file, but drives.x reaches at most {turn / 55.358e3:.4g} m/s",
        "Y": f"1 m/s in the machine file, but drives.y reaches at most {turn / 62.294e3:.4g} m/s",
    }
    assert len(found) == 3
    for text, (axis, message) in zip(found, expected.items(), strict=True):
        assert text.startswith(f"axes.{axis}: velocity is {message}, with the full output of")
        assert "10 V" in text

    slower = tmp_path / "slower.toml"
    within = {"A": "900 deg/s", "X": "0.6 m/s", "Y": "0.55 m/s"}
    lines = [f'[axes.{k}]\nvelocity = "{v} exact, assumed"' for k, v in within.items()]
    slower.write_text('base = "lathe-winder"\nname = "slower"\n' + "\n".join(lines))
    assert plausibility_warnings(load_machine(str(slower))) == []


def test_the_acceleration_of_a_drive_is_what_its_current_leaves() -> None:
    """The stitcher's X by hand: (J + M r^2) a / r = Kt 27 A, with no friction at rest."""
    torque = 0.5 * 27.0
    reached = torque * RATIO / (4.75e-4 + 111 * RATIO**2)
    (warning,) = [
        t for t in plausibility_warnings(load_machine("stitcher")) if "acceleration is" in t
    ]
    assert (
        f"27.74 m/s^2 in the machine file, but drives.x reaches at most {reached:.4g} m/s^2"
        in warning
    )
    assert "current_limit of 27 A" in warning


def test_current_of_a_rigid_axis_by_hand():
    """(J w/v + M v/w) a + ... with w/v = N/r, by hand."""
    machine = load_machine("stitcher")
    speed, acceleration = 0.1905, 5.0
    for axis, J, B, M, b in (("X", 4.75e-4, 0.24, 111, 3330), ("Y", 8.1e-4, 0.29, 70, 2080)):
        torque = (J + M * RATIO**2) * acceleration / RATIO + (B + b * RATIO**2) * speed / RATIO
        got = current_needed(machine, axis, speed, acceleration)
        assert got == pytest.approx(torque / 0.5, rel=1e-6)
    rates = rigid_motion(machine, "Y")
    assert rates["y_motor"] == pytest.approx(1 / RATIO, rel=1e-6)
    assert abs(rates["frame"]) < 1e-12 and abs(rates["x_head"]) < 1e-12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('zero = "0.976', 'zero = "0.998'), "controllers.x: zero of a lead filter is 0.998"),
        (('pole = "0.004', 'pole = "0.003'), "controllers.x: pole of a lead filter is 0.003"),
        (
            ('zero = "0.976', 'zerro = "0.976'),
            "unknown key 'controllers.x.zerro'. Did you mean 'zero'?",
        ),
        (('kind = "lead"', 'kind = "leed"'), "leed"),
        (('kind = "encoder"\n', ""), "'sensors.x.kind' is missing"),
        (('sensor = "x"', 'sensor = "x_pot"'), "names the encoder 'x_pot'"),
        (('reference_clock = "reference"', 'reference_clock = "refs"'), "names the clock 'refs'"),
    ],
)
def test_wrong_files_are_refused(change, message, tmp_path):
    text = (importlib.resources.files("threadline.machine") / "library/stitcher.toml").read_text()
    file = tmp_path / "mine.toml"
    assert change[0] in text
    file.write_text(text.replace(*change, 1))
    with pytest.raises(MachineError) as caught:
        load_machine(str(file))
    assert message in str(caught.value) and "mine.toml" in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        # A slipped decimal point, four edges in a line forgotten, and a pulley of 21 teeth, not 20.
        (
            '[axes.X]\ncounts = "26.34289 count/mm +- 2 %, assumed"',
            "gives 263429: the load would move 0.1 times as far",
        ),
        (
            '[sensors.y]\nreads = { y_motor = "2000 count/rev exact, assumed" }',
            "gives 65857.2: the load would move 4 times as far",
        ),
        (
            '[links.x_belt]\nstretch = { x_motor = "5.075 mm/rad exact, assumed" }\n'
            '[axes.X]\ncounts = "263.4289 count/mm exact, assumed"',
            "gives 250885: the load would move 1.05 times as far",
        ),
    ],
)
def test_counts_that_the_encoder_does_not_give_are_named(tmp_path, change, message):
    """By hand: 8000 counts a turn, 29 mm behind 6:1."""
    file = tmp_path / "mine.toml"
    file.write_text(f'base = "stitcher"\n{change}\n')
    before = plausibility_warnings(load_machine("stitcher"))
    (found,) = [
        text for text in plausibility_warnings(load_machine(str(file))) if "counts is" in text
    ]
    assert message in found
    assert not any("counts is" in text for text in before)


def test_a_motor_without_back_emf_is_suspicious(tmp_path) -> None:
    """It would turn without end at any voltage; to a current amplifier it does not matter."""
    text = (
        library_file("lathe-winder")
        .read_text()
        .replace('back_emf = "8.6 V/krpm', 'back_emf = "0 V/krpm')
    )
    file = tmp_path / "no-back-emf.toml"
    file.write_text(text)
    found = plausibility_warnings(load_machine(str(file)))
    assert len(found) == 3
    assert all("back_emf 0 V s/rad" in text and "100 %" in text for text in found)
    assert not any(
        "back_emf" in text for text in plausibility_warnings(load_machine(f"{file}+current"))
    )

"""A machine's numbers have usable sizes: no overflow, no underflow, no endless clock."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from threadline.dynamics.analysis import analyse_axis
from threadline.dynamics.linear_model import locked_modes
from threadline.dynamics.loop import axis_loop
from threadline.dynamics.plausibility import plausibility_warnings
from threadline.dynamics.values import Values
from threadline.errors import MachineError
from threadline.machine import load_machine
from threadline.machine.quantity import LEAST_SI, MOST_SI
from threadline.twin.prescribed import advances_of
from threadline.twin.switching import SAMPLE_S
from threadline.twin.switching_cylinder import cylinders_of

PLACER = {
    "bodies.head.inertia": "1e-300 kg",
    "bodies.table.damping": "1e30 N s/m",
    "cylinders.X.air_damping": "1e30 N s/m",
    "links.feet.stretch.table": "1e30",
}
WINDER = {"axes.X.velocity": "1e300 m/s", "axes.A.counts": "-1e-300 count/deg"}


def overlaid(folder: Path, base: str, key: str, value: str) -> str:
    file = folder / "m.toml"
    file.write_text(f'base = "{base}"\n{key} = "{value} exact, assumed"\n')
    return str(file)


@pytest.mark.parametrize("key", [*PLACER, *WINDER])
def test_sizes_that_no_machine_has_are_refused_with_their_line(key: str, tmp_path: Path) -> None:
    base, value = ("letter-placer", PLACER[key]) if key in PLACER else ("lathe-winder", WINDER[key])
    with pytest.raises(MachineError) as caught:
        load_machine(overlaid(tmp_path, base, key, value))
    assert f"m.toml:2: {key}: '{value}" in str(caught.value)
    assert "a machine's numbers are 0 or from 1e-15 to 1e+15" in str(caught.value)


def test_the_ends_of_the_range_are_in_it(tmp_path: Path) -> None:
    for size in (LEAST_SI, MOST_SI, -MOST_SI):
        file = overlaid(tmp_path, "letter-placer", "links.feet.stretch.table", repr(size))
        assert load_machine(file).links["feet"].stretch["table"].si == size


@pytest.mark.parametrize(("digits", "fits"), [(15, True), (16, False), (40, False)])
def test_a_clock_has_as_many_digits_as_can_be_counted(
    digits: int, fits: bool, tmp_path: Path
) -> None:
    """In milliseconds; 1/1e18 s is the finest part."""
    file = overlaid(tmp_path, "letter-placer", "clocks.scan", f"1.{'3' * digits} ms")
    if fits:
        assert load_machine(file).clocks["scan"].exact_s is not None
        return
    with pytest.raises(MachineError, match="has too many digits for a time"):
        load_machine(file)


@pytest.mark.parametrize(("base", "clock"), [("stitcher", "filter"), ("letter-placer", "scan")])
def test_a_clock_that_ticks_once_in_a_lifetime_is_refused(
    base: str, clock: str, tmp_path: Path
) -> None:
    """Within 1e9 s the motion of a plant leaves the range of numbers."""
    with pytest.raises(MachineError, match="must be at most 3600"):
        load_machine(overlaid(tmp_path, base, f"clocks.{clock}", "1e9 s"))


def test_a_load_or_a_frame_of_nothing_is_refused(tmp_path: Path) -> None:
    (body, *_) = load_machine("stitcher").axes["X"].load or {}
    for base, key in (
        ("stitcher", f"axes.X.load.{body}"),
        ("letter-placer", "cylinders.X.frame.table"),
    ):
        with pytest.raises(MachineError, match="every coefficient is 0"):
            load_machine(overlaid(tmp_path, base, key, "0"))


def test_every_small_number_of_the_stitcher_is_answered_or_refused(tmp_path: Path) -> None:
    """And every large number, one after the other: loaded, checked for suspicions, analysed."""
    base = load_machine("stitcher")
    keys = [
        f"links.{link}.stretch.{body}" for link in base.links for body in base.links[link].stretch
    ]
    keys += [
        f"drives.{drive}.acts_on.{body}"
        for drive in base.drives
        for body in base.drives[drive].acts_on
    ]
    answered = 0
    for key in keys:
        for size in ("0", "1e-15", "1e15"):
            try:
                machine = load_machine(overlaid(tmp_path, "stitcher", key, size))
                found = plausibility_warnings(machine)
                analyse_axis(machine, "X")
            except MachineError:
                continue
            answered += 1
            assert all("nan" not in text for text in found)
    assert answered > 3


@pytest.mark.parametrize("key", ["lag", "delay"])
def test_air_that_takes_more_than_minutes_is_refused(key: str, tmp_path: Path) -> None:
    """A lag of 1e5 s was simulated for hours."""
    with pytest.raises(MachineError, match="must be at most 100"):
        load_machine(overlaid(tmp_path, "letter-placer", f"cylinders.X.{key}", "1e5 s"))


def test_a_body_that_nothing_holds_is_named(tmp_path: Path) -> None:
    file = tmp_path / "m.toml"
    body = '[bodies.loose]\nkind = "linear"\ninertia = "1 kg exact, assumed"\n'
    file.write_text(f'base = "lathe-winder"\n{body}')
    with pytest.raises(MachineError, match=r"bodies\.loose: no drive, sensor or axis"):
        analyse_axis(load_machine(str(file)), "X")


def test_a_window_of_no_thousandth_of_a_degree_is_refused(tmp_path: Path) -> None:
    """Angles are kept in thousandths: the window would be 0, and dividing by it would fail."""
    for angle, fits in (("0.0004 deg", False), ("1e-6 deg", False), ("0.001 deg", True)):
        file = overlaid(tmp_path, "schiffli-frame", "shaft.window", angle)
        if fits:
            shaft = load_machine(file).shaft
            assert shaft is not None
            assert shaft.window_share == Fraction(1, 360_000)
            continue
        with pytest.raises(MachineError, match="the resolution is a thousandth of a degree"):
            load_machine(file)


def test_a_dead_time_of_too_many_ticks_is_refused(tmp_path: Path) -> None:
    """3 ms of the stitcher: 1500 states at 2 us, 2e10 at 136 fs, which no memory holds."""
    for period, fits in (("2 us", True), ("0.1 us", False), ("1e-6 us", False)):
        loop = axis_loop(load_machine(overlaid(tmp_path, "stitcher", "clocks.filter", period)), "X")
        if fits:
            assert len(loop.closed().A) > 1500
            continue
        with pytest.raises(MachineError, match=r"ticks of .* s fit into the dead time"):
            loop.closed()


def test_a_cylinder_whose_motion_grows_beyond_numbers_is_refused(tmp_path: Path) -> None:
    """Air that a stroke strains 1e12 times: exp(383) in a sample; its square is not needed.

    The pole grows with the root of the strain: ten times as much is exp(1200), beyond doubles.
    """
    for strained, fits in (("1e12", True), ("1e13", False)):
        file = overlaid(tmp_path, "letter-placer", "links.air_up.stretch.table_up", strained)
        machine = load_machine(file)
        every = machine, tuple(machine.cylinders), Values(machine, {}, 1), float(SAMPLE_S)
        if fits:
            assert np.log(np.abs(cylinders_of(*every).step).max()) == pytest.approx(383, rel=0.01)
            continue
        with pytest.raises(MachineError, match="its motion grows beyond all numbers within"):
            cylinders_of(*every)


def test_a_stepper_that_carries_too_much_to_swing_is_refused(tmp_path: Path) -> None:
    """Its acceleration is averaged over half a swing, whose ticks would take 12 GB."""
    for inertia, fits in (("1 kg m^2", True), ("1e12 kg m^2", False)):
        machine = load_machine(
            overlaid(tmp_path, "stepper-winder", "bodies.a_motor.inertia", inertia)
        )
        if fits:
            assert max(int(a.averaged.max()) for a in advances_of(machine)) < 1_000_000
            continue
        with pytest.raises(MachineError, match="the acceleration is averaged over at most 1000000"):
            advances_of(machine)


def test_a_mode_damped_beyond_measure_has_a_ratio_of_one(tmp_path: Path) -> None:
    """Of two real poles the slower is 0 by rounding: its -Re/|s| is 0/0."""
    file = overlaid(tmp_path, "lathe-winder", "overlays.springy.links.x_arm.stretch.x_eye", "1e15")
    (mode,) = locked_modes(load_machine(f"{file}+springy"), "X")
    assert mode.damping == 1.0

"""Machine files: the read values, and the messages about wrong keys and values, with their line."""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import FrozenInstanceError
from fractions import Fraction

import numpy as np
import pytest

from tests.machine.machine_text import LIBRARY, WINDER, edit, line_of
from threadline.errors import MachineError
from threadline.machine import library_names, load_machine
from threadline.machine.quantity import Provenance


def test_the_printed_winder() -> None:
    """The numbers of the facts, converted to SI by hand."""
    machine = load_machine("lathe-winder")
    assert machine.axis_names == ("A", "X", "Y")
    assert machine.tick_clock.period_s == Fraction(1, 200)
    assert machine.counts_per_unit == pytest.approx([35.18159 * 180 / math.pi, 55_358.0, 62_294.0])
    assert machine.velocity_limit == pytest.approx([math.radians(2842), 1.0, 1.0])
    assert machine.acceleration_limit == pytest.approx([576.8, 10.5, 4.65])
    assert machine.jerk_limit == pytest.approx([115_360, 2100, 930])
    assert machine.travel.tolist() == [[-np.inf, np.inf], [-0.5, 0.5], [-0.05, 0.25]]
    assert machine.radius_m.tolist() == [0.1, 1.0, 1.0]
    assert machine.operator.record_every.si == 20
    motor = machine.drives["x"]
    # Kt / (R J) = 570 and Kt Ke / (R J) = 46.7, as printed for the X plant
    inertia = machine.bodies["x"].inertia.si
    gain = motor.torque_constant.si / (motor.resistance.si * inertia)
    assert gain == pytest.approx(570, rel=0.003)
    assert gain * motor.back_emf.si == pytest.approx(46.7, rel=0.003)
    # 20 V in 4096 levels
    assert machine.controllers["x"].dac.volt_per_level == 20 / 4096
    assert motor.torque_constant.provenance is Provenance.PRINTED


def test_every_machine_of_the_library_is_read_with_every_overlay() -> None:
    assert "lathe-winder" in library_names()
    for name in library_names():
        machine = load_machine(name)
        assert machine.sha256
        text = (LIBRARY / f"{name}.toml").read_text(encoding="utf-8")
        overlays = tomllib.loads(text).get("overlays", {})
        for overlay in (o for o, content in overlays.items() if content != "none"):
            over = load_machine(f"{name}+{overlay}")
            assert over.sha256 != machine.sha256
            assert over.name == f"{machine.name}+{overlay}"


def test_overlays_change_what_they_name_and_nothing_else() -> None:
    printed, physical = load_machine("lathe-winder"), load_machine("lathe-winder+physical")
    assert physical.bodies["x"].inertia.si == pytest.approx(6.49e-4)
    assert physical.drives == printed.drives
    both = load_machine("lathe-winder+current+8A")
    assert both.drives["x"].amplifier.mode == "current"
    assert both.drives["x"].amplifier.current_limit.si == 8.0
    assert both.drives["x"].amplifier.gain.unit == "A/V"
    # an overlay merges: the current limit of the base stays if the overlay has none
    assert load_machine("lathe-winder+current").drives["x"].amplifier.current_limit.si == 4.0


def test_8_a_give_twice_the_acceleration_of_4_a() -> None:
    """Kt I r / J by hand, from the motor's data and the effective radii from the counts."""
    over = load_machine("lathe-winder+8A")
    torque, per_turn = 8.0 * 0.082, 4000.0 / (2.0 * np.pi)
    for name, body in (("A", "a"), ("X", "x"), ("Y", "y")):
        axis = over.axes[name]
        radius = per_turn / axis.counts.si
        at_8_a = torque * radius / over.bodies[body].inertia.si
        assert axis.acceleration.si == pytest.approx(at_8_a, rel=2e-3)
        assert axis.jerk is not None
        assert axis.jerk.si == pytest.approx(axis.acceleration.si / 5e-3, rel=1e-9)
        assert "8 A" in axis.acceleration.note


def test_unused_operator_keys_may_be_left_out(tmp_path) -> None:
    text = WINDER
    for key in ("manual_feed", "limit_feed", "knots_between"):
        text = re.sub(rf"^{key} = .*\n", "", text, flags=re.MULTILINE)
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    operator = load_machine(path).operator
    assert operator is not None and operator.normal_feed.si == 10.0
    assert operator.manual_feed is operator.limit_feed is operator.knots_between is None


def test_a_tool_is_asked_for_only_where_an_axis_turns(tmp_path, refused) -> None:
    without = re.sub(r"\[tool\]\n(?:\w.*\n)+", "", WINDER)
    assert without != WINDER
    message = refused(without)
    assert "'tool' is missing" in message and "axis A" in message and "radius = " in message
    both = refused(without.replace('resistance = "0.4 ohm', 'x = "0.4 ohm', 1))
    assert "unknown key" in both
    both = refused(
        without.replace('tick_budget = "5e8 tick exact, assumed: 29 days at 5 ms"\n', "")
    )
    assert "2 keys are missing" in both and "'tool' (like [tool] radius" in both
    for name in ("letter-placer", "stitcher"):
        assert load_machine(name).tool is None
    assert load_machine("stitcher").radius_m.tolist() == [1.0, 1.0]


def test_the_hash_is_of_the_content_and_not_of_its_layout(tmp_path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(WINDER, encoding="utf-8")
    one = load_machine(path).sha256
    assert one == load_machine("lathe-winder").sha256
    path.write_text("# a comment\n" + WINDER, encoding="utf-8")
    assert load_machine(path).sha256 == one
    path.write_text(edit("4 A +- 10 %", "5 A +- 10 %"), encoding="utf-8")
    assert load_machine(path).sha256 != one


def test_a_machine_based_on_another(tmp_path) -> None:
    (tmp_path / "mine.toml").write_text(
        'base = "lathe-winder+physical"\nname = "mine"\n'
        '[tool]\nradius = "50 mm exact, assumed"\n[inputs]\nx_low = "none"\n'
    )
    (tmp_path / "yours.toml").write_text('base = "mine.toml"\nname = "yours"\n')
    machine = load_machine(tmp_path / "yours.toml")
    assert machine.name == "yours"
    assert machine.tool.radius.si == 0.05
    assert machine.bodies["x"].inertia.si == pytest.approx(6.49e-4)
    assert "x_low" not in machine.inputs
    assert "x_high" in machine.inputs


def test_machines_are_frozen() -> None:
    machine = load_machine("lathe-winder")
    with pytest.raises(FrozenInstanceError):
        machine.name = "other"


def test_six_axes_and_no_seventh(tmp_path, refused) -> None:
    def axes(names: str) -> str:
        axis = WINDER[WINDER.index("[axes.X]") : WINDER.index("[axes.Y]")]
        return WINDER + "".join(axis.replace("axes.X", f"axes.{n}") for n in names)

    (tmp_path / "six.toml").write_text(axes("ZBC"), encoding="utf-8")
    assert load_machine(tmp_path / "six.toml").axis_names == tuple("AXYZBC")
    assert "at most 6" in refused(axes("ZBCU"))


def test_a_body_may_have_no_jerk_limit(tmp_path) -> None:
    jerk = 'jerk = "2100 m/s^3 +- 15 %, assumed: the acceleration in one tick"\n'
    (tmp_path / "mine.toml").write_text(edit(jerk, ""), encoding="utf-8")
    assert load_machine(tmp_path / "mine.toml").jerk_limit[1] == np.inf


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("lathe-windr", "no machine 'lathe-windr' in the library. Did you mean 'lathe-winder'?"),
        ("zzz", "The library has: "),
        (
            "lathe-winder+physicl",
            "no overlay 'physicl'. Did you mean 'physical'? It has: phys",
        ),
        ("nowhere/mine.toml", "cannot read 'nowhere/mine.toml'"),
        ("", "no machine '' in the library"),
        ("a\0.toml", "cannot read 'a\\x00.toml': "),
        ("a\0.toml", "embedded null "),  # byte or character, by the version of Python
        ("../secrets", "no machine '../secrets' in the library"),
    ],
)
def test_unknown_machines(reference, message) -> None:
    with pytest.raises(MachineError) as caught:
        load_machine(reference)
    assert message in str(caught.value)


MISTAKES = {
    "top key": ("tick_budget =", "tick_bugdet =", "tick_bugdet", "'tick_budget'"),
    "table": ("[tool]", "[toool]", "toool", "'tool'"),
    "key": ('inertia = "3.606e-4', 'inertai = "3.606e-4', "bodies.x.inertai", "'inertia'"),
    "deep key": ("bits = ", "bitts = ", "bitts", "'bits'"),
    "axis key": ('velocity = "1 m/s', 'velocty = "1 m/s', "axes.X.velocty", "'velocity'"),
    "operator": ("normal_feed =", "normal_fed =", "operator.normal_fed", "'normal_feed'"),
    "motor key": ("back_emf =", "back_enf =", "drives.x.back_enf", "'back_emf'"),
    "amplifier key": ("current_limit = ", "curent_limit = ", "amplifier.curent_limit", "'current_"),
    "switch key": ("beyond =", "beyound =", "inputs.x_low.beyound", "'beyond'"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_unknown_keys_name_the_nearest_and_their_line(refused, name) -> None:
    """The right key is missing, too, but the message names the misspelt one."""
    old, new, key, near = MISTAKES[name]
    text = edit(old, new)
    message = refused(text)
    assert re.search(rf"unknown key '[\w.]*{key}'", message)
    assert f"Did you mean {near}" in message
    first = next(n for n, line in enumerate(text.splitlines(), 1) if new in line)
    assert f"mine.toml:{first}: " in message


def test_derived_fields_are_not_listed_as_known_keys(refused) -> None:
    message = refused("zzqqxx = 1\n" + edit("", ""))
    known = re.search(r"unknown key 'zzqqxx'. Known: (.*)\.", message)
    assert known is not None
    offered = known[1].split(", ")
    assert {"name", "axes", "drives"} <= set(offered)
    assert not {"sha256", "file", "reference", "parameters"} & set(offered)


VALUES = {
    "no unit": ('"4 A +- 10 %, printed', '"4 +- 10 %, printed', "'4' is not in 'A'"),
    "wrong unit": ('"3.606e-4 kg m^2', '"3.606e-4 kg', "inertia of a rotary body is in kg*m^2"),
    "other dimension": ('"3.606e-4 kg m^2', '"3.606e-4 s', "is not in 'kg' or 'kg*m^2'"),
    "no tolerance": ('radius = "100 mm exact', 'radius = "100 mm', "has no tolerance. The prov"),
    "plain number": (
        'radius = "100 mm exact, assumed: half the largest mandrel"',
        "radius = 100",
        "100 has no unit, tolerance and provenance",
    ),
    "negative count": ('"55.358 count/mm', '"-55.358 count/mm', "must be greater than zero"),
    "zero tick": ('servo = "5 ms', 'servo = "0 ms', "must be greater than zero"),
    "negative gain": ('kp = "2 dac', 'kp = "-2 dac', "must not be negative"),
    "infinite": ('"0.4 ohm', '"1e999 ohm', "not a finite number"),
    "travel backwards": ('["-500 mm exact', '["600 mm exact', "travel must increase"),
    "travel of an endless axis": ("endless = true", "endless = false", "either travel"),
    "angle for a linear axis": (
        'counts = "55.358 count/mm',
        'counts = "55.358 count/deg',
        "count/m",
    ),
    "gain of the other mode": (
        'gain = "0.45 exact, printed',
        'gain = "0.45 A/V exact, printed',
        "V/V",
    ),
    "plain gain of a current amplifier": (
        'mode = "voltage"',
        'mode = "current"',
        "is in A/V, not V/V, a plain number",
    ),
    "kind": ('kind = "encoder"', 'kind = "encodr"', "encoder"),
    "amplifier mode": ('mode = "voltage"', 'mode = "volts"', "'voltage' or 'current'"),
    "bits in parts": ('bits = "12 bit', 'bits = "0.5 bit', "must be a whole number"),
    "bits without end": ('bits = "12 bit', 'bits = "1000000 bit', "must be at most 32"),
    "part of a tick": ('record_every = "20 tick', 'record_every = "0.5 tick', "whole number"),
    "part of a knot": ('knots_between = "4 exact', 'knots_between = "4.5 exact', "whole number"),
    "yes for true": ("endless = true", 'endless = "yes"', "must be true or false"),
    "1 for true": ("zero_on_reversal = true", "zero_on_reversal = 1", "must be true or false"),
    "axis name": ("[axes.A]", "[axes.mandrel]", "axes.mandrel"),
}


@pytest.mark.parametrize("name", VALUES)
def test_wrong_values_say_what_and_where(refused, name) -> None:
    old, new, message = VALUES[name]
    found = refused(edit(old, new))
    assert message in found
    assert "mine.toml:" in found


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ('acts_on = { x = "1 exact', 'acts_on = { x = "0 exact', "drives.x.acts_on: every"),
        ('stretch = { x = "1 ex', 'stretch = { x = "0 ex', "links.belt.stretch: every"),
    ],
)
def test_part_with_zero_coefficients_is_refused(refused, old, new, where) -> None:
    """A drive with its only coefficient 0, and a spring that never stretches."""
    link = (
        "\n[links.belt]\n"
        'stretch = { x = "1 exact, assumed" }\n'
        'stiffness = "1 N m/rad exact, assumed"\n'
    )
    text = edit(old, new) if old in WINDER else WINDER + link.replace(old, new)
    message = refused(text)
    assert f"mine.toml:{line_of(text, new)}: {where} coefficient is 0 (x)" in message


def test_a_tolerance_that_reaches_zero_is_refused(refused, tmp_path) -> None:
    """For a number that must stay above zero: at the lower end the mass would be none."""
    link = (
        "\n[links.belt]\n"
        'stretch = { x = "1 exact, assumed" }\n'
        'stiffness = "1 N m/rad +- STIFFNESS, assumed"\ndamping = "1 N m s/rad +- 100 %, assumed"\n'
    )
    mass = 'inertia = "3.606e-4 kg m^2 +- 5 %'
    for tolerance in ("100 %", "150 %", "4e-4 kg m^2"):
        text = edit(mass, mass.replace("5 %", tolerance))
        message = refused(text)
        line = next(n for n, row in enumerate(text.splitlines(), 1) if f"+- {tolerance}" in row)
        assert f"mine.toml:{line}: bodies." in message
        assert "would not be above zero at the lower end of its tolerance" in message
        assert "below 100 %" in message
    text = WINDER + link.replace("STIFFNESS", "100 %")
    message = refused(text)
    assert f"mine.toml:{line_of(text, '1 N m/rad +-')}: links.belt.stiffness: " in message
    accepted = tmp_path / "accepted.toml"
    accepted.write_text(
        edit(mass, mass.replace("5 %", "99 %")) + link.replace("STIFFNESS", "99 %"),
        encoding="utf-8",
    )
    assert load_machine(accepted).links["belt"].damping.tolerance_si == 1.0

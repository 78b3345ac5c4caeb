"""Units against their definitions and against pint's own registry."""

from __future__ import annotations

import math
from contextlib import suppress
from fractions import Fraction
from functools import cache
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline import units
from threadline import units as usual_units
from threadline.errors import InputError, UnitError
from threadline.units import (
    parse_exact_time_s,
    parse_quantity,
    same_dimension,
    split_quantity,
    unit_factor,
)


@cache
def pints_own() -> Any:
    """Return a registry of pint; it takes a third of a second, in this worker alone."""
    import pint

    return pint.UnitRegistry()


@pytest.mark.parametrize(
    ("unit", "target"),
    [
        ("in/s", "m/s"),
        ("ft/min", "m/s"),
        ("mm", "m"),
        ("µm", "m"),
        ("deg", "rad"),
        ("deg/s^2", "rad/s^2"),
        ("rpm", "rad/s"),
        ("rev/min", "rad/s"),
        ("krpm", "rad/s"),
        ("kg cm^2", "kg*m^2"),
        ("N mm", "N*m"),
        ("mN/mm", "N/m"),
        ("V/krpm", "V*s/rad"),
        ("mH", "H"),
        ("kohm", "ohm"),
        ("bar", "N/m^2"),
        ("tex", "kg/m"),
        ("h", "s"),
        ("kHz", "1/s"),
    ],
)
def test_factors_agree_with_pint(unit: str, target: str) -> None:
    """pint has its own table; angles are plain numbers there, so radians drop out."""
    pints = unit.replace("krpm", "kilorpm").replace("rev", "turn").replace("N mm", "N*mm")
    plain = target.replace("V*s/rad", "V*s")
    registry = pints_own()
    expected = registry.Quantity(1.0, registry.parse_units(pints)).to(plain)
    assert unit_factor(unit, target) == pytest.approx(expected.magnitude, rel=1e-12)


def test_usual_factors_are_those_of_the_registry(monkeypatch: pytest.MonkeyPatch) -> None:
    """To the bit, and refused where the registry refuses; no two kinds share a dimension."""
    usual = units.usual_factor
    monkeypatch.setattr(units, "usual_factor", lambda *_: None)
    asked = unit_factor.__wrapped__
    kinds = {kind: set(of_kind) for kind, of_kind in usual_units._FACTORS.items()}
    assert len(usual_units._USUAL) > 60
    for unit, (own, _) in usual_units._USUAL.items():
        for target in kinds:
            found = usual(unit, target)
            if own == target:
                assert found == asked(unit, target), (unit, target)
            else:
                assert found == 0.0
                with pytest.raises(UnitError, match=r"does not measure the same|is a unit, but"):
                    asked(unit, target)


def test_a_usual_unit_of_another_kind_is_refused_as_by_the_registry(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for unit, target in (("deg", "m"), ("mm", ""), ("%", "m")):
        with pytest.raises(UnitError) as caught:
            unit_factor(unit, target)
        monkeypatch.setattr(units, "usual_factor", lambda *_: None)
        with pytest.raises(UnitError) as registrys:
            unit_factor.__wrapped__(unit, target)
        monkeypatch.undo()
        assert str(caught.value) == str(registrys.value)


@pytest.mark.parametrize(
    ("text", "target", "value"),
    [
        ("7.5 in/s", "m/s", 7.5 * 0.0254),
        ("55.358 count/mm", "count/m", 55_358.0),
        ("35.18159 count/deg", "count/rad", 35.18159 * 180 / math.pi),
        ("10 count/tick", "count/tick", 10.0),
        ("4000 counts/rev", "count/rad", 4000 / (2 * math.pi)),
        ("8.6 V/krpm", "V*s/rad", 8.6 / (1000 * 2 * math.pi / 60)),
        ("-1e-3 mm", "m", -1e-6),
        (".5 mm", "m", 0.0005),
        ("+5. ms", "s", 0.005),
        ("12 bit", "bit", 12.0),
        ("5 %", "", 0.05),
        ("3", "", 3.0),
        ("2 N·m", "N*m", 2.0),
        ("2 kg m²", "kg*m^2", 2.0),
        ("4e9 tick", "tick", 4e9),
    ],
)
def test_quantities_by_hand(text: str, target: str, value: float) -> None:
    assert parse_quantity(text, target) == pytest.approx(value, rel=1e-12)


@given(
    value=st.floats(-1e12, 1e12).filter(lambda v: v == 0 or abs(v) > 1e-12),
    unit=st.sampled_from(["m", "mm", "in", "deg", "count/mm", "N*m/A"]),
)
def test_a_number_in_its_own_unit_is_unchanged(value: float, unit: str) -> None:
    assert parse_quantity(f"{value!r} {unit}", unit) == value


@pytest.mark.parametrize(
    ("text", "target", "message"),
    [
        ("", "m", "not a number with a unit"),
        ("fast", "m/s", "'fast' is not a number with a unit"),
        ("1 mm", "s", r"'mm' does not measure the same quantity as 's'"),
        ("1 deg", "m", "does not measure the same quantity"),
        ("1 rad", "", "'rad' is a unit, but this value is a plain number or a percentage.*20 %"),
        ("320", "m", r"'320' has no unit. Write it like .320 mm."),
        ("1", "kg", r"'1' has no unit. Write it like .1 kg."),
        ("1 furlong", "m", "unknown unit 'furlong'"),
        ("1 m/", "m", "unknown unit"),
        ("1e400 mm", "m", "not a finite number"),
        ("1e308 km", "m", "too large"),
        ("nan mm", "m", "not a number with a unit"),
        ("inf mm", "m", "not a number with a unit"),
        ("1_0 mm", "m", "unknown unit|not a number"),
        ("1,5 mm", "m", "decimal comma.*Write 1\\.5"),
        ("1 mm; drop", "m", "unknown unit"),
        ("1 " + "m" * 500, "m", "not a number with a unit"),
        ("1 mm\n2", "m", "not a number|unknown unit"),
        ("1 (((", "m", "unknown unit"),
        ("1 m**1e9", "m", "unknown unit|not a unit|not a number"),
        ("36 mm/s,", "m/s", "unknown unit 'mm/s,'"),
        ("36 mm;", "m", "unknown unit 'mm;'"),
        ("36,", "m", "unknown unit ','"),
        ("\uff13\uff16 mm", "m", "is not a number with a unit"),  # full-width 36
        ("36 \uff4d\uff4d", "m", "unknown unit"),
        ("36 mm\uff0fs", "m/s", "unknown unit"),
    ],
)
def test_bad_quantities_say_what_and_how(text: str, target: str, message: str) -> None:
    with pytest.raises(UnitError, match=message) as caught:
        parse_quantity(text, target)
    assert isinstance(caught.value, InputError)
    assert str(caught.value).startswith("[UNIT] ")
    assert len(str(caught.value)) < 400


@given(text=st.text(max_size=130))
def test_any_text_is_read_or_refused(text: str) -> None:
    for target in ("m", "", "count/tick"):
        with suppress(UnitError):
            assert math.isfinite(parse_quantity(text, target))


def test_dimensions() -> None:
    assert same_dimension("mm", "m")
    assert same_dimension("count/deg", "count/rad")
    assert not same_dimension("count/mm", "count/rad")
    assert not same_dimension("bogus", "m")
    assert not same_dimension("rad/s", "1/s")  # an angle is no plain number here


@pytest.mark.parametrize(
    ("text", "period"),
    [
        ("5 ms", Fraction(1, 200)),
        ("136 us", Fraction(17, 125_000)),
        ("136 µs", Fraction(17, 125_000)),
        ("0.1 s", Fraction(1, 10)),
        ("16 MHz", Fraction(1, 16_000_000)),
        ("60 Hz", Fraction(1, 60)),
        ("1.5 min", Fraction(90)),
        ("1e-3 s", Fraction(1, 1000)),
    ],
)
def test_times_are_exact(text: str, period: Fraction) -> None:
    assert parse_exact_time_s(text) == period


@pytest.mark.parametrize("text", ["0 ms", "-5 ms", "5", "5 mm", "ms", "5 rpm", "0 Hz"])
def test_bad_times_are_refused(text: str) -> None:
    with pytest.raises(UnitError):
        parse_exact_time_s(text)


def test_a_quantity_splits_as_it_is_written() -> None:
    assert split_quantity(" -7.50 in/s ") == ("-7.50", "in/s")
    assert split_quantity("12") == ("12", "")

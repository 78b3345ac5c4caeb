"""Numbers of machine files: value, unit, tolerance, provenance."""

from __future__ import annotations

import math
from fractions import Fraction

import pytest

from threadline.errors import UnitError
from threadline.machine.quantity import Provenance, parse_machine_quantity


@pytest.mark.parametrize(
    ("text", "units", "si", "tolerance", "provenance", "note"),
    [
        ("4 kg +- 5 %, printed: section 6.2", ("kg",), 4.0, 0.2, "printed", "section 6.2"),
        ("4 kg ± 5%, measured", ("kg",), 4.0, 0.2, "measured", ""),
        ("4 kg +/- 5%, measured", ("kg",), 4.0, 0.2, "measured", ""),
        ("-510 mm +- 2 mm, assumed", ("m", "rad"), -0.51, 0.002, "assumed", ""),
        ("90 deg +- 1 deg, assumed", ("m", "rad"), math.pi / 2, math.pi / 180, "assumed", ""),
        ("1 exact, printed", ("", "m/rad"), 1.0, 0.0, "printed", ""),
        ("2 mm/rad exact, checked: a: b, c", ("", "m/rad"), 0.002, 0.0, "checked", "a: b, c"),
        ("-2 kg +- 50 %, assumed", ("kg",), -2.0, 1.0, "assumed", ""),
    ],
)
def test_by_hand(text, units, si, tolerance, provenance, note) -> None:
    found = parse_machine_quantity(text, units)
    assert found.si == pytest.approx(si, rel=1e-12)
    assert found.tolerance_si == pytest.approx(tolerance, rel=1e-12)
    assert found.provenance is Provenance(provenance)
    assert found.note == note


def test_times_keep_their_exact_fraction() -> None:
    found = parse_machine_quantity("136 us exact, printed", ("s",))
    assert found.exact_s == Fraction(17, 125_000)
    assert parse_machine_quantity("1 kg exact, printed", ("kg",)).exact_s is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("4 kg", "has no tolerance and no provenance.*printed, checked, assumed or measured"),
        ("4 kg, printed", "has no tolerance\\b(?! and)"),
        ("4 kg +- 5 %", "has no provenance.*Write it like"),
        ("4 kg exact", "has no provenance"),
        ("4 kg +- 5 %, guessed", "has no provenance but 'guessed'"),
        ("0,6 kg +- 10 %, printed", r"has a decimal comma.*Write 0\.6\."),
        ("4 kg +- 0,5 %, printed", r"has a decimal comma.*Write 0\.5\."),
        ("4 kgm2 exact, printed", r"unknown unit 'kgm2'.*Did you mean 'kg m\^2'"),
        ("4 kg +- -5 %, assumed", "the tolerance is negative"),
        ("4 kg +- 5 mm, assumed", "'mm' does not measure the same quantity as 'kg'"),
        ("4 exact, assumed", "'4' is not in 'kg'"),
        ("4 mm exact, assumed", "'4 mm' is not in 'kg'"),
        ("four kg exact, assumed", "not a number with a unit"),
        ("nan kg exact, assumed", "not a number with a unit"),
        ("1e999 kg exact, assumed", "not a finite number"),
        ("4 kg +- 1e999 kg, assumed", "not a finite number"),
        ("", "no tolerance and no provenance"),
    ],
)
def test_bad_numbers_say_what_and_how(text, message) -> None:
    with pytest.raises(UnitError, match=message):
        parse_machine_quantity(text, ("kg", "kg*m^2") if "kgm2" in text else ("kg",))

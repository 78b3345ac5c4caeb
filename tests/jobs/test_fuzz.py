"""A small share of the long fuzz run, so that it stays runnable and its readers robust."""

from __future__ import annotations

import warnings

import pytest
from tools import fuzz

from threadline.errors import UnitError
from threadline.units import parse_exact_time_s, parse_quantity

CASES = {
    "part-program": 300, "units": 300, "par": 100, "radii": 150, "program-winder": 150,
    "winding": 300,  # a winding combines all of its numbers: few changed ones are accepted
}  # fmt: skip
JUDGED = (
    "judge-channels", "judge-blocks", "judge-axes",
    "same-recording", "same-program", "same-winding", "same-machine",
)  # fmt: skip
"""Classes of which tests/verdict has cases."""


@pytest.mark.long(shown_by="test_a_traceback_is_counted")
def test_no_reader_answers_with_a_traceback() -> None:
    """Every reader both refuses and accepts; otherwise the cases would prove nothing."""
    for name in fuzz.READERS.keys() - set(JUDGED):
        with warnings.catch_warnings():
            tally = fuzz.run(7, name, 0, CASES.get(name, 50))
        assert tally.failures == []
        assert 0 < tally.accepted[name] < tally.cases[name]


def test_a_traceback_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that divides by zero is a failure, with the command that repeats it."""
    bad = fuzz.Reader("x", lambda rng: b"", lambda path: 1 / 0, 1)
    monkeypatch.setitem(fuzz.READERS, "bad", bad)
    with warnings.catch_warnings():
        tally = fuzz.run(7, "bad", 3, 2)
    assert len(tally.failures) == 2
    assert "--seed 7 --reader bad --first 3 --cases 1" in tally.failures[0]
    assert "ZeroDivisionError" in tally.failures[0]


def test_a_time_of_a_billion_digits_is_refused_at_once() -> None:
    """Found by fuzzing: the exact fraction of 1e999999999 took minutes to compute."""
    for text in ("1e999999999 s", "1e-999999999 s"):
        with pytest.raises(UnitError, match="must be"):
            parse_exact_time_s(text)


def test_a_unit_that_is_a_tower_of_powers_is_refused_at_once() -> None:
    """Found by fuzzing: pint computes 9**99999999, and overflows in ((m/mm)^9)^9..."""
    for text in ("1 m*9**99999999", "1 m^9^9^9", "1 ((((m/mm)^9)^9)^9)^9"):
        with pytest.raises(UnitError):
            parse_quantity(text, "" if "mm" in text else "m")

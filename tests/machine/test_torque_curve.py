"""Impossible torque curves of steppers are refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.jobs.made_machines import made_machine
from threadline.errors import MachineError
from threadline.machine import load_machine


@pytest.mark.parametrize(
    ("first", "last", "message"),
    [
        ("9", "9.5", "rises, from 9 at 0 to 9.5 at 5000"),
        ("9", "-1", "greater than zero"),
        ("0", "9", "greater than zero"),
    ],
)
def test_curves_that_rise_or_cross_zero(
    tmp_path: Path, first: str, last: str, message: str
) -> None:
    file = Path(made_machine(tmp_path, "X", "").file)
    begin, held, end = file.read_text().partition("5000 rad/s")
    begin = begin.replace('"9 N m', f'"{first} N m')
    file.write_text(begin + held + end.replace('"9 N m', f'"{last} N m'))
    with pytest.raises(MachineError, match=message) as refused:
        load_machine(file)
    assert "\n" not in str(refused.value)

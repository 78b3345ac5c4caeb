"""Mistakes in the parts of an on/off machine that only show together, each with its line."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest

from threadline.errors import MachineError
from threadline.machine import load_machine

PLACER = (resources.files("threadline.machine") / "library" / "letter-placer.toml").read_text(
    encoding="utf-8"
)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            'watchdog = "25 ms exact',
            'watchdog = "10 ms exact',
            "plc.watchdog: 10 ms is not longer than a scan, 10 ms: every scan would be a fault",
        ),
        (
            '"%QX0.5"',
            '"%QX0.2"',
            "outputs.x_left_a1.address: %QX0.2 is that of x_right_a1 already",
        ),
    ],
)
def test_what_does_not_fit_together(tmp_path: Path, old: str, new: str, told: str) -> None:
    path = tmp_path / "mine.toml"
    text = PLACER.replace(old, new, 1)
    assert text != PLACER
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MachineError) as caught:
        load_machine(path)
    line = next(n for n, row in enumerate(text.splitlines(), start=1) if new in row)
    if "address" in told:
        line = next(
            n for n, row in enumerate(text.splitlines(), start=1) if "x_left_a1 = { kind" in row
        )
    assert str(caught.value).startswith(f"[MACHINE] mine.toml:{line}: {told}")

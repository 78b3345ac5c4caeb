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
    ("old", "new", "message"),
    [
        (
            'watchdog = "25 ms exact',
            'watchdog = "10 ms exact',
            "plc.watchdog: 10 ms is not longer than a scan, 10 ms: every scan would be a fault",
        ),
        (
            'watchdog = "25 ms exact',
            'watchdog = "1e6 ms exact',
            "plc.watchdog: 1e+06 ms is longer than 100 scans, 1000 ms: it would protect nothing",
        ),
        (
            '"%QX0.5"',
            '"%QX0.2"',
            "outputs.x_left_a1.address: x_right_a1 already has %QX0.2",
        ),
    ],
)
def test_inconsistent_parts_of_an_on_off_machine_are_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / "mine.toml"
    text = PLACER.replace(old, new, 1)
    assert text != PLACER
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MachineError) as caught:
        load_machine(path)
    line = next(n for n, row in enumerate(text.splitlines(), start=1) if new in row)
    if "address" in message:
        line = next(
            n for n, row in enumerate(text.splitlines(), start=1) if "x_left_a1 = { kind" in row
        )
    assert str(caught.value).startswith(f"[MACHINE] mine.toml:{line}: {message}")


@pytest.mark.parametrize("address", ["%IX00.3", "%IX0.03", "%IX0.8", "%IX1.9", "%IX0.", "%QX0.1"])
def test_an_address_is_a_byte_and_a_bit_in_one_spelling(tmp_path: Path, address: str) -> None:
    """A byte has the bits 0 to 7, and %IX00.3 would be %IX0.3 under another name."""
    path = tmp_path / "mine.toml"
    path.write_text(PLACER.replace('"%IX0.4"', f'"{address}"'), encoding="utf-8")
    with pytest.raises(MachineError, match="a byte without leading zeros, a bit from 0 to 7"):
        load_machine(path)


def test_a_bit_by_its_number_alone_is_the_same_bit(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(PLACER.replace('"%IX1.1"', '"%IX8"'), encoding="utf-8")
    with pytest.raises(MachineError, match=r"acknowledge already has %IX8"):
        load_machine(path)


LEFT, RIGHT = "6 mm +- 2 mm, assumed", "194 mm +- 2 mm, assumed"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (LEFT, "196 mm +- 2 mm, assumed", "on below 196 mm +- 2 mm, and x_is_right above 194 mm"),
        (LEFT, "191 mm +- 2 mm, assumed", "both end switches of X can be on at once"),
        (
            LEFT,
            "1 mm +- 2 mm, assumed",
            "the end of the stroke of X at 0 mm, so that the switch may never",
        ),
        (
            LEFT,
            "199 mm +- 2 mm, assumed",
            "stroke of X at 200 mm, so that the switch may always be on",
        ),
        (
            RIGHT,
            "199 mm +- 2 mm, assumed",
            "stroke of X at 200 mm, so that the switch may never be on",
        ),
    ],
)
def test_end_switches_that_tolerances_make_useless_are_refused(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    """With both on at once, the interlock of the knife would hold all along the stroke."""
    path = tmp_path / "mine.toml"
    text = PLACER.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(MachineError) as caught:
        load_machine(path)
    line = next(n for n, row in enumerate(text.splitlines(), start=1) if new in row)
    assert f"mine.toml:{line}: contacts.x_is_" in str(caught.value)
    assert message in str(caught.value)
    assert "ove " in caught.value.remedy


def test_end_switches_as_far_apart_as_their_tolerances_are_taken(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(PLACER.replace(LEFT, "189 mm +- 2 mm, assumed", 1), encoding="utf-8")
    assert load_machine(path).contacts["x_is_left"].at is not None

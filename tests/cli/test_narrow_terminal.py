"""Tables on a terminal that is narrower than they are: nothing is cut off."""

from __future__ import annotations

import pytest

from threadline.cli.on_terminal import laid_out

HEADER = ("criterion", "axis", "measured", "limit", "status", "at", "line")
ROWS = [
    ("contour_error", "", "0.4503 mm", "0.5 mm", "passed", "5.035 s", "12"),
    ("turning_point_error", "X", "0.009043 mm", "0.5 mm", "passed", "10.245 s", "19 (pass 3)"),
    ("repeatability", "", "-", "0.1 mm", "not-measured (required)", "-", "-"),
    ("acceleration", "X", "6.522 m/s^2", "10.5 m/s^2", "passed", "5.008 s", "13"),
]


def shown(width: int) -> str:
    console, table, _ = laid_out("x-180", HEADER, ROWS, width)
    with console.capture() as captured:
        console.print(table)
    return captured.get()


@pytest.mark.parametrize("width", [40, 60, 80, 100, 120])
def test_no_character_is_cut_off(width: int) -> None:
    cells = "".join(["x-180", *HEADER, *(cell for row in ROWS for cell in row)])
    found = shown(width).replace("─", "")
    assert sorted("".join(found.split())) == sorted(cells.replace(" ", ""))
    assert max(map(len, found.splitlines())) <= width


def test_names_of_criteria_stay_whole_on_80_columns() -> None:
    for name, *_ in ROWS:
        assert name in shown(80)

"""Tables on a narrower terminal: nothing is cut off."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from threadline.cli.on_terminal import laid_out

HEADER = ("criterion", "axis", "measured", "limit", "status", "at", "line")
ROWS = [
    ("contour_error", "", "0.4503 mm", "0.5 mm", "passed", "5.035 s", "12"),
    ("turning_point_error", "X", "0.009043 mm", "0.5 mm", "passed", "10.245 s", "19 (pass 3)"),
    ("repeatability", "", "-", "0.1 mm", "not-measured (required)", "-", "-"),
    ("acceleration", "X", "6.522 m/s^2", "10.5 m/s^2", "passed", "5.008 s", "13"),
]
WOUND = ("layer", "angle", "turns at", "pattern", "closed by", "slip tendency", "fibre", "dwells",
         "mass", "thickness", "at most")  # fmt: skip
LAYER = ("1 helical", "39.792 deg", "32.001 mm", "44/19", "friction", "0.00%", "23.40 m", "0.00 m",
         "28.1 g", "0.510 mm", "1.803 mm")  # fmt: skip


def shown(width: int, header: Sequence[str] = HEADER, rows: Sequence[Sequence[str]] = ROWS) -> str:
    console, table, _ = laid_out("x-180", header, rows, width)
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


def test_words_and_numbers_stay_whole_where_they_fit() -> None:
    words = [word for cell in [*HEADER, *(c for row in ROWS for c in row)] for word in cell.split()]
    for width in (81, 90, 100):
        assert not set(words) - set(shown(width).split()), width


@pytest.mark.parametrize("width", [60, 80, 100, 120])
def test_few_rows_of_many_columns_are_turned_where_their_words_do_not_fit(width: int) -> None:
    found = shown(width, WOUND, [LAYER])
    for cell in (*WOUND, *LAYER):
        assert set(cell.split()) <= set(found.split()), cell
    assert max(map(len, found.splitlines())) <= width
    assert ("  thickness         0.510 mm" in found) == (width < 120)

"""Printed answers: a few lines with the answer, and a table in a notebook."""

from __future__ import annotations

import threadline as tl

MACHINE = "stepper-winder"
HELIX = "examples/helix.gcode"


def _short(answer: object) -> str:
    text = repr(answer)
    assert len(text.splitlines()) <= 10
    assert max(map(len, text.splitlines())) <= 200
    return text


def test_a_comparison_prints_a_row_for_each_plan() -> None:
    found = tl.compare(HELIX, MACHINE, ["auto", "linear"], level="nominal")
    text = _short(found)
    assert "helix.gcode on stepper-winder, nominal" in text
    assert "auto" in text and "linear" in text
    assert text.endswith("1 of 2 cases in spec (nominal: 1 run each)")
    page = found._repr_html_()
    assert page.count("<tr>") == 3
    assert "<td>linear</td>" in page
    for part in (found.proofs[0].verdict, found.proofs[0].plan, found.proofs[0].spec):
        assert repr(part).startswith("<")
        assert "\n" not in _short(part)
    assert "helix.gcode" in repr(found.proofs[0].plan)


def test_a_yield_and_a_machine_print_what_they_are() -> None:
    found = tl.yields(HELIX, MACHINE, variants=20)
    text = _short(found)
    assert "of 20 machines in spec" in text
    assert "contour_error" in text
    assert _short(tl.load_machine(MACHINE)).startswith("<Machine 'stepper-winder': ")


def test_long_tables_say_how_many_rows_are_left_out() -> None:
    from threadline.base.summary import MOST_ROWS, Summarised, Summary

    class Many(Summarised):
        def _summary(self) -> Summary:
            return Summary("title", ["n"], [[str(n)] for n in range(20)], "below")

    assert _short(Many()).endswith(f"below; and {20 - MOST_ROWS} more rows")
    assert Many()._repr_html_().count("<td>") == MOST_ROWS

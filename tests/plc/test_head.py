"""The head of the emitted text says what it was made for."""

from __future__ import annotations

from tests.plc.texts import text_of


def test_the_head_names_the_shaper_and_the_mode_that_was_asked_for() -> None:
    head = text_of("letter-placer", "um-2ei").split("VAR_INPUT")[0]
    for axis in "XZ":
        assert f"(* {axis}: shaped by um-2ei for 3.04 Hz, damping ratio 0.17 *)" in head
    assert "no safety function" in head
    assert "(* X: unshaped *)" in text_of("letter-placer", "none").split("VAR_INPUT")[0]

"""The output of ``threadline shaper --move``: the shaped move beside the fastest."""

from __future__ import annotations

import json
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO

import numpy as np
import pytest

from threadline.cli.main import main
from threadline.motion.shaping.onoff.body_and_modes import (
    Command,
    RestToRest,
    simulate,
    worst_ringing,
)
from threadline.motion.shaping.onoff.switched import switched_command
from threadline.motion.shaping.types import FlexibleMode


def run(*words: str) -> tuple[int, str, str]:
    out, errors = StringIO(), StringIO()
    with pytest.raises(SystemExit) as stopped, redirect_stdout(out), redirect_stderr(errors):
        main(["shaper", "--mode", "3.04Hz", *words])
    return int(stopped.value.code or 0), out.getvalue(), errors.getvalue()


MOVE = ("--move", "200 mm", "--acceleration", "1 m/s^2")


def test_shaped_move_stands_beside_the_optima() -> None:
    """The published times: 0.920678 s is the fastest, UM-ZV takes 1.0041 s, unshaped 0.8944 s."""
    code, text, _ = run("--kind", "um-zv", *MOVE, "--json")
    move = json.loads(text)["move"]
    assert code == 0
    assert move["time_optimal_s"] == pytest.approx(0.920678, abs=5e-7)
    assert move["robust_optimum_s"] == pytest.approx(1.0847, abs=2e-3)
    unshaped, shaped = move["moves"]
    assert unshaped["duration_s"] == pytest.approx(0.8944, abs=5e-5)
    assert shaped["duration_s"] == pytest.approx(1.0041, abs=5e-5)
    assert shaped["over_optimal"] == pytest.approx(1.0041 / 0.920678, abs=1e-4)
    assert move["front"] == []
    assert move["switched"] is None


def test_on_off_command_is_found_on_the_tick_and_keeps_its_word() -> None:
    """5 % over +-10 % on a 10 ms scan: replayed by matrix exponential at 41 frequencies."""
    words = ("--band", "0.1", "--still", "0.05", "--tick", "10 ms")
    code, text, _ = run("--kind", "zv", *MOVE, *words, "--json")
    move = json.loads(text)["move"]
    assert code == 0
    found = move["switched"]
    assert found["over_robust"] <= 1.1
    command = Command(np.array(found["times_s"]), np.array(found["levels"]))
    assert set(found["levels"]) <= {-1.0, 0.0, 1.0}
    assert np.array(found["times_s"]) / 0.01 == pytest.approx(np.arange(len(command.times_s)))
    for ratio in np.linspace(0.9, 1.1, 41):
        end = simulate(command, FlexibleMode(3.04 * float(ratio)), 1.0)
        assert end[:2] == pytest.approx([0.2, 0.0], abs=1e-9)
        assert end[2] <= 0.05 + 1e-9
    shorter = [p for p in move["front"] if p["duration_s"] < found["duration_s"] - 1e-9]
    assert shorter
    assert all(p["switched"] is None for p in shorter)
    # The least ringing falls with time, except for the scan's coarseness.
    free = [p["free"] for p in move["front"] if p["free"] is not None]
    assert free[-1] < free[0]


def test_half_a_move_and_impossible_numbers_are_refused() -> None:
    for words, message in (
        (("--move", "200 mm"), "Add --acceleration"),
        (("--move", "3 s", "--acceleration", "1 m/s^2"), "--move '3 s'"),
        ((*MOVE, "--still", "0"), "tolerance must be positive"),
        (("--move", "1 km", "--acceleration", "1 mm/s^2"), "periods of the mode at"),
        (("--move", "1e300 m", "--acceleration", "1e-300 m/s^2"), "limit 100"),
        ((*MOVE, "--still", "inf"), "--still 'inf': 'inf' is not a number"),
    ):
        code, _, errors = run(*words)
        assert code == 2
        assert message in errors


def test_a_move_needs_a_positive_distance() -> None:
    with pytest.raises(ValueError, match="distance_m must be positive"):
        RestToRest(0.0, 1.0, (FlexibleMode(3.04),))


def test_on_off_levels_hold_as_long_as_the_valves_need() -> None:
    """Without the dwell the command for the same demand holds levels for a single tick."""
    move = RestToRest(0.2, 1.0, (FlexibleMode(3.04),))
    shortest = {}
    for dwell in (1, 2):
        command = switched_command(
            move, relative=0.2, tolerance=0.3, tick_s=0.01, ticks=117, dwell_ticks=dwell
        )
        assert command is not None
        edges = np.flatnonzero(np.diff(command.levels, prepend=0.0, append=0.0))
        shortest[dwell] = int(np.diff(edges).min())
        assert worst_ringing(command, move.modes, 0.2) <= 0.3
        end = simulate(command, move.modes[0], 1.0)
        assert end[:2] == pytest.approx([0.2, 0.0], abs=1e-9)
    assert shortest == {1: 1, 2: 2}


def test_valves_slower_than_the_move_are_refused() -> None:
    code, out, errors = run("--kind", "zv", "--tick", "10ms", "--dwell", "900ms", *MOVE)
    assert (code, out) == (2, "")
    assert "the valves need 0.9 s between two switchings" in errors

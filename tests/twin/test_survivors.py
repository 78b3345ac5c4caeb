"""Details of a step of the engine, each compared with a result known without it."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.dynamics.network import piecewise_linear
from threadline.dynamics.values import Values
from threadline.machine import load_machine
from threadline.twin import simulate
from threadline.twin.kernel.piece import prepared

from .test_reference import OUT_AND_BACK, assert_twin_is_the_reference


def test_a_peak_is_of_its_own_sample(table) -> None:
    """After the motion the current of largest magnitude since the last sample is small."""
    machine = load_machine("lathe-winder")
    rows = {"X": np.concatenate((np.full(20, 60), np.zeros(80, dtype=np.int64)))}
    recording = simulate(table(machine, rows), machine, record_every=5)
    peak = np.abs(recording.samples("X.current_peak")[1])
    current = np.abs(recording.samples("X.current")[1])
    assert peak.max() > 1.0
    assert peak[-10:].max() < 0.05 * peak.max()
    assert (peak[1:] >= current[1:] - 1e-12).all()
    # At the far end of the motion the peaks fall with the current, they do not stay.
    assert (np.diff(peak) < -0.1 * peak.max()).any()


def test_a_clamped_filter_remembers_what_it_put_out(table) -> None:
    """A lead filter far beyond its 8-bit word, compared with the slow twin.

    Both must agree to 1e-6 counts, as for every machine there; the unclamped output has no effect.
    """
    machine = load_machine("stitcher-rigid-half-mass")
    # B of the printed filters makes the previous output count: 0.047 and 0.188.
    rows = {"X": 400 * OUT_AND_BACK, "Y": 400 * OUT_AND_BACK}
    assert_twin_is_the_reference(machine, rows, table, True)
    # The first row needs more than the word has, for one period of the filter.
    assert all(c.gain.si * 400 > 127 for c in machine.controllers.values())


@pytest.mark.parametrize("rate", [190.0, 700.0, 9000.0])
def test_advances_are_as_short_as_what_escapes_a_guard_is_stated_for(rate: float) -> None:
    """``mode_changes.py``: the fastest rate times an advance is at most 1, times a cell 1/2.

    Longer ones hide larger excursions of a guard, with the fourth power, and no figure of a job
    need show it. A tick of the winder is 5 ms; ``rate`` belongs to its fastest variant.
    """
    machine = load_machine("lathe-winder+stiction")
    values = Values.of(machine)
    for piece in piecewise_linear(machine, values, np.zeros(len(machine.axes))):
        ready = prepared(machine, piece, values, least_rate=rate)
        assert ready.plant.guards.sum() > 0 and ready.rate == rate
        lengths_s = np.array(ready.steps.lengths_s)
        assert (rate * lengths_s).max() <= 1.0 + 1e-12
        assert (rate * lengths_s / ready.steps.cells).max() <= 0.5 + 1e-12
        # They still add up to a tick, and are no finer than needed.
        assert lengths_s[ready.steps.length].sum() == pytest.approx(0.005, rel=1e-12)
        assert len(ready.steps.length) == np.ceil(0.005 * rate)

"""``threadline measure`` over LinuxCNC's real HAL, with a plant of its components."""

from __future__ import annotations

import numpy as np
import pytest

from tests.live.hal_bench import awake, hal_alone, refuse_slept, unhurried
from threadline.files.recording import columns_of
from threadline.identify.experiment_run import measure, predict, response_of
from threadline.identify.planned_experiment import experiment
from threadline.machine import load_machine


@pytest.fixture(autouse=True)
def hal_lock(monkeypatch):
    with hal_alone(monkeypatch), unhurried(monkeypatch):
        yield


@pytest.mark.long(but="hal:plant")
@pytest.mark.parametrize("link", ["hal:plant", "hal:loopback"])
@awake
def test_a_sweep_is_recorded_whole_without_volts_and_without_a_response(tmp_path, link):
    """HAL has positions and no amplifier. Its commands come back as they were sent."""
    machine = load_machine("lathe-winder")
    planned = experiment(machine, "X", "sweep", amplitude=0.002, band_hz=(4.0, 20.0))
    predict(machine, planned)
    found = measure(machine, planned, link=link)
    refuse_slept((found.ended, found.why))
    assert found.ended.value == "completed", found.why
    assert found.response is None and response_of(found.recording.origin) is None
    columns = {n.partition(" ")[0]: v for n, v in columns_of(found.recording).items()}
    counts = np.rint(columns["X.commanded"] * machine.axes["X"].counts.si)
    sent = np.concatenate([block.counts[:, 1] for block in planned.commands]).cumsum()
    first = int(np.flatnonzero(counts)[0]) - int(np.flatnonzero(sent)[0])
    np.testing.assert_array_equal(counts[first : first + len(sent)], sent)
